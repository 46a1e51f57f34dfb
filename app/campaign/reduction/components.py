"""Components of the uncertainty: the one convention of the reduction, and the one place where u is computed from them.

A component is the *variance* that one named contribution (`noise`, `monitor`, `certificate`) adds to a value, in the square of
the value's unit, in an array of the value's shape. Variances, because the contributions of a value are uncorrelated: they add,
and a component of several inputs (the dark readings before and after) needs no more room than one. Absolute, because a value
may be 0 or negative. What two quantities of one quotient share is removed where the quotient is made (the instrument signature
of sample and etalon). Which inputs a component is made of, and which values share them, is recomputed where it is needed
(effects_of_points.py). For tables a component is wholly shared between neighbouring directions or, if it is in INDEPENDENT, not
at all.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from goniotwin.arrays import Flags, Floats, Ints

Components = Mapping[str, Floats]
DETECTED = 3.0
"""A value below so many of its standard uncertainties is lost in its noise: below the detection limit."""
INDEPENDENT = frozenset({"noise", "resolution", "ray_tracing", "etalon_reading", "field_noise"})
"""Components whose errors differ between neighbouring directions: each has readings of its own at the sample and at the etalon.

All others count as shared, also those that are shared in part (`dark`, `monitor`, `gain`, `signature`): that the errors average
out would be a claim, so u is at most too large. A new contribution is shared unless it is named here.
"""
NOISE = INDEPENDENT | {"dark", "etalon_dark", "crosstalk", "signature"}
"""Components that are there without light: what a value is lost in. All others are shares of the value."""
ADDED = frozenset({"noise", "resolution", "ray_tracing", "dark", "signature", "crosstalk", "field_noise"})
"""Components that are added to a value whatever its size; all others are shares of it."""
COVERAGE = 1.96
"""Standard uncertainties from a value to the ends of its interval of 95 %."""
LOGARITHMIC = 0.15
"""Relative standard uncertainty above which an interval is one of the logarithm."""
INTERVAL_RULE = (
    f"an interval of k u is value +- k u; where u is above {100.0 * LOGARITHMIC:g} % of the value and at least half of its "
    f"variance is of shares of the value (all components but {', '.join(sorted(ADDED))}), it is value exp(+-k u / value)"
)
"""The rule of `interval` in words."""


def mostly_added(components: Components) -> Flags:
    """Whether more than half of a variance is of ADDED components: then a deviation is one of the value at any u."""
    added = total_variance({name: each for name, each in components.items() if name in ADDED})
    return np.asarray(added > 0.5 * total_variance(components))


def logarithmic(value: Floats, u: Floats, added: Flags) -> Flags:
    """Whether the interval of a value is one of the logarithm: u is above 15 % of it, and not for the most part `added`.

    On a lobe's flank an error of an angle moves a value by a factor; noise does not know how large the value is.
    """
    return np.asarray((value > 0.0) & (u > LOGARITHMIC * value) & ~added)


def interval(value: Floats, u: Floats, added: Flags, coverage: float = COVERAGE) -> tuple[Floats, Floats]:
    """Lower and upper ends of the values' intervals, so many standard uncertainties `u` away; `added` of `mostly_added`."""
    chosen = logarithmic(value, u, added)
    factor = np.exp(coverage * np.where(chosen, u, 0.0) / np.where(chosen, value, 1.0))
    return np.where(chosen, value / factor, value - coverage * u), np.where(chosen, value * factor, value + coverage * u)


def deviation_in_u(value: Floats, u: Floats, added: Flags, expected: Floats) -> Floats:
    """Deviations (n,) of values from what is expected, in their u: within `interval` where they are within its coverage."""
    u = np.maximum(u, np.finfo(float).tiny)
    chosen = logarithmic(value, u, added) & (expected > 0.0)
    ratio = np.where(chosen, value, 1.0) / np.where(chosen, expected, 1.0)
    return np.where(chosen, np.log(ratio) * value / u, (value - expected) / u)


COMMON = frozenset(
    {
        "etalon_age", "etalon_edge", "open_beam", "mounting", "uniformity", "wavelength", "bandwidth", "band_shape",
        "monochromator_stray", "polarisation",
    }
)  # fmt: skip
"""Components whose errors are the same for two values of one direction, or of a direction and its mirror image."""


def total_variance(components: Components) -> Floats:
    """The variance of values from all of their components."""
    return np.asarray(sum(components.values()), dtype=float)


def standard_uncertainty(components: Components) -> Floats:
    """The combined standard uncertainty u of values, in their unit."""
    return np.sqrt(total_variance(components))


def shared_variance(components: Components) -> Floats:
    """The part of the variance whose errors have one sign in neighbouring directions, so that no interpolation reduces them."""
    none = np.zeros_like(total_variance(components))
    return none + total_variance({name: each for name, each in components.items() if name not in INDEPENDENT})


@dataclass(frozen=True)
class Estimate:
    """Values with the components of their uncertainty: arrays of one shape."""

    value: Floats
    components: Components

    @property
    def variance(self) -> Floats:
        """The variance from all components."""
        return total_variance(self.components)

    @property
    def lost_in_noise(self) -> Flags:
        """Whether values are below the detection limit."""
        return np.isfinite(self.value) & (self.value < DETECTED * np.sqrt(self.variance))

    def scaled(self, factor: Floats | float) -> Self:
        """The values times an exactly known factor."""
        squared = np.square(factor)
        scaled = {name: variance * squared for name, variance in self.components.items()}
        return replace(self, value=self.value * factor, components=scaled)

    def divided(self, divisor: Floats | float) -> Self:
        """The values over an exactly known divisor."""
        squared = np.square(divisor)
        divided = {name: variance / squared for name, variance in self.components.items()}
        return replace(self, value=self.value / divisor, components=divided)

    def with_component(self, name: str, variance: Floats | float) -> Self:
        """The values with a further variance; it is added to that of a component of the same name."""
        added = np.broadcast_to(variance, self.value.shape)
        return replace(self, components={**self.components, name: self.components.get(name, 0.0) + added})


@dataclass(frozen=True)
class Signal(Estimate):
    """Photocurrents over the monitor's current, one element for each photodiode, or (rows, photodiodes).

    `gain` is the index of the gain that is used, -1 where all gains are saturated. `link` has one axis more: the relative
    variance of the ratio of that gain to each of the rig's gains; None where only the certificate is known.
    """

    gain: Ints
    link: Floats | None = None

    def at(self, index: Ints | Flags) -> "Signal":
        """The signals (rows, photodiodes) of some rows, or of all in another order."""
        return self._each(lambda values: values[index])

    def of(self, channels: Ints) -> "Signal":
        """The signals (rows, photodiodes) of some photodiodes."""
        return self._each(lambda values: np.take(values, channels, axis=1))

    def _each(self, part: Callable[[Any], Any]) -> "Signal":
        components = {name: part(each) for name, each in self.components.items()}
        return Signal(part(self.value), components, part(self.gain), None if self.link is None else part(self.link))
