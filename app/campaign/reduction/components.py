"""Components of the uncertainty of a value: their names, which of them are alike, and the rules of u and its interval.

A component is the *variance* by one family of inputs, or by what a value has alone, in the square of the value's unit and in an
array of the values' shape. For tables a component is wholly shared between neighbouring directions or, if it is in INDEPENDENT,
not at all. `Quantity` has the effects that they come from.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from goniotwin.app.campaign.measurement_model.quantity import Components, Quantity
from goniotwin.app.campaign.reduction.reading_inputs import BETWEEN_ROWS
from goniotwin.app.rig.inputs import CROSSTALK, MONOCHROMATOR_STRAY, WAVELENGTH, inputs
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.plant.disturbances import SharedBy

DETECTED = 3.0
"""A value below so many of its standard uncertainties is lost in its noise: below the detection limit."""
INDEPENDENT = frozenset({"noise", "resolution", "ray_tracing", "etalon_reading", "signature_reading", "field_noise"})
"""Components whose errors differ between neighbouring directions: each has readings of its own at the sample and at the etalon.

All others count as shared, also those that are shared in part (`dark`, `monitor`, `gain`, `signature`): that the errors average
out would be a claim, so u is at most too large. A new contribution is shared unless it is named here.
"""
NOISE = INDEPENDENT | {"dark", CROSSTALK.name, "signature"}
"""Components that are there without light: what a value is lost in. All others are shares of the value."""
ADDED = frozenset(
    {"noise", "resolution", "ray_tracing", "dark", "signature", "signature_reading", CROSSTALK.name, "field_noise"}
)
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


def common_names() -> frozenset[str]:
    """Components whose errors are the same for two values of one direction, or of a direction and its mirror image."""
    factors = {each.name for each in inputs() if each.paths and each.shared_by is not SharedBy.MOVE}
    declared = factors | {WAVELENGTH.name, MONOCHROMATOR_STRAY.name}
    return frozenset(declared | {"open_beam", "bandwidth", "band_shape", "polarisation"})


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


OF_A_QUOTIENT = frozenset({"monitor", "gain", *(each.name for each in BETWEEN_ROWS)})
"""Components that count where two signals are divided: no light is lost in them."""


@dataclass(frozen=True)
class Signal(Quantity):
    """Photocurrents over the monitor's current, one element for each photodiode, or (rows, photodiodes).

    `gain` is the index of the gain that is used, -1 where all gains are saturated.
    """

    gain: Ints = field(kw_only=True)

    @classmethod
    def of(cls, quantity: Quantity, gain: Ints) -> Self:
        """The signals of a quantity, read at these gains."""
        return cls(quantity.value, quantity.own, quantity.common, quantity.grouped, gain=gain)

    @property
    def reading_variance(self) -> Floats:
        """The variance by the readings alone, without OF_A_QUOTIENT: whether there is light."""
        alone = [each for name, each in self.components.items() if name not in OF_A_QUOTIENT]
        return np.zeros(self.value.shape) + sum(alone)

    @property
    def lost_in_noise(self) -> Flags:
        """Whether values are below the detection limit."""
        return np.isfinite(self.value) & (self.value < DETECTED * np.sqrt(self.reading_variance))

    def each(self, part: Callable[[NDArray[Any]], NDArray[Any]]) -> Self:
        """As of any quantity; of the gains too."""
        return replace(super().each(part), gain=part(self.gain))

    def at(self, index: Ints | Flags) -> "Signal":
        """The signals (rows, photodiodes) of some rows, or of all in another order."""
        return self.each(lambda array: array[index])

    def of_photodiodes(self, channels: Ints) -> "Signal":
        """The signals (rows, photodiodes) of some photodiodes."""
        return self.each(lambda array: np.take(array, channels, axis=1))
