"""The worst corner of the deviations: every element as far off as its tolerance allows, each to the worse side.

Linearised sensitivities rank all corners; the best of them, and then every corner that differs in one sign from the
worst found, are evaluated as they are.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.paper.gaussian_cut import gaussian_cuts
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument

TILT_DEG = 0.05
SHIFT_MM = 0.1
EVALUATED = 32
"""Of the corners that the linear model ranks first."""


@dataclass(frozen=True)
class Component:
    """One deviation of one element and how large it may be, in degrees or mm; `title` says what it is."""

    element: str
    name: str
    amount: float
    title: str


@dataclass(frozen=True)
class Corner:
    """A corner: signs of the components, its relative RMS in percent, and what the linear model makes of it."""

    components: tuple[Component, ...]
    signs: tuple[int, ...]
    relative_rms_percent: float
    linear_percent: float

    def in_words(self) -> str:
        """Which components go which way."""
        return ", ".join(f"{'+' if s > 0 else '-'}{c.title}" for c, s in zip(self.components, self.signs, strict=True))


def tilts(instrument: Instrument, tolerance_deg: float = TILT_DEG) -> tuple[Component, ...]:
    """The twelve tilts of Table 2 and figure 11: three mirrors, sample, beam and arc, meridional and sagittal each.

    The beam turns about the sample: a tilt of it is a shift of the exit pupil, for a pupil tilted about its own centre
    sends the same light.
    """
    aside = instrument.pupil_distance_mm * math.tan(math.radians(tolerance_deg))
    found = [
        Component(f"mirror_{k}", f"{axis}_deg", tolerance_deg, f"mirror {k} {axis}") for k in (1, 2, 3) for axis in ("rx", "ry")
    ]
    found += [
        Component(name, f"{axis}_deg", tolerance_deg, f"{name} {axis}") for name in ("sample", "arc") for axis in ("rx", "ry")
    ]
    found += [Component("pupil", f"{axis}_mm", aside, f"beam {axis}") for axis in ("x", "z")]
    return tuple(found)


def shifts(tolerance_mm: float = SHIFT_MM) -> tuple[Component, ...]:
    """The fifteen shifts of Table 2: three mirrors, sample and arc along three axes."""
    names = ("mirror_1", "mirror_2", "mirror_3", "sample", "arc")
    return tuple(
        Component(name, f"{axis}_mm", tolerance_mm, f"{name.replace('_', ' ')} {axis}")
        for name in names
        for axis in ("x", "y", "z")
    )


def with_deviations(instrument: Instrument, components: Sequence[Component], signs: Sequence[int]) -> Instrument:
    """The instrument with each component at so many times its amount."""
    elements: dict[str, dict[str, float]] = {}
    for component, sign in zip(components, signs, strict=True):
        if sign:
            elements.setdefault(component.element, {})[component.name] = sign * component.amount
    return replace(instrument, deviations={name: Deviation(**amounts) for name, amounts in elements.items()})


def worst_corner(instrument: Instrument, sigma_deg: float, width_deg: float, components: Sequence[Component]) -> Corner:
    """Of all 2^n corners of n components, the one with the largest relative RMS (formula 5) of a Gaussian in plane."""

    def residual(signs: Sequence[int]) -> Floats:
        (cut,) = gaussian_cuts(with_deviations(instrument, components, signs), [sigma_deg], width_deg)
        return cut.relative_deviation

    known: dict[tuple[int, ...], float] = {}

    def percent(signs: tuple[int, ...]) -> float:
        if signs not in known:
            known[signs] = 100.0 * _rms(residual(signs))
        return known[signs]

    count = len(components)
    units = np.eye(count, dtype=int)
    straight = residual([0] * count)
    slopes = np.array([0.5 * (residual(list(unit)) - residual(list(-unit))) for unit in units])
    corners = np.array(list(itertools.product((-1, 1), repeat=count)))
    ranked = np.sqrt(np.mean((straight + corners @ slopes) ** 2, axis=1))
    order = np.argsort(-ranked, kind="stable")[:EVALUATED]
    worst = max((tuple(int(sign) for sign in corners[k]) for k in order), key=percent)
    while True:
        beside = [tuple(-sign if i == flipped else sign for i, sign in enumerate(worst)) for flipped in range(count)]
        better = max(beside, key=percent)
        if percent(better) <= percent(worst):
            break
        worst = better
    linear = 100.0 * _rms(straight + np.array(worst) @ slopes)
    return Corner(tuple(components), worst, percent(worst), linear)


def with_shifts(instrument: Instrument, sigma_deg: float, width_deg: float, corner: Corner) -> Corner:
    """The corner with the shifts added, each to the side that makes it worse there."""
    every = (*corner.components, *shifts())

    def percent(more: Sequence[int]) -> float:
        (cut,) = gaussian_cuts(with_deviations(instrument, every, (*corner.signs, *more)), [sigma_deg], width_deg)
        return cut.relative_rms_percent

    units = np.eye(len(every) - len(corner.signs), dtype=int)
    more = tuple(1 if percent(list(unit)) >= percent(list(-unit)) else -1 for unit in units)
    return Corner(every, (*corner.signs, *more), percent(more), math.nan)


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2)))
