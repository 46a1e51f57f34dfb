"""The worst corner of the deviations: every element at the limit of its tolerance, with the signs of the largest error.

Linearised sensitivities rank all corners. The first of them, and then every corner that differs from the worst in one sign,
are simulated.
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
SIMULATED_CORNERS = 32
"""Number of corners, the first by the linear model, that are simulated."""


@dataclass(frozen=True)
class Tolerance:
    """One deviation of one element and its largest amount, in degrees or mm; `title` is its name in messages."""

    element: str
    name: str
    amount: float
    title: str


@dataclass(frozen=True)
class Corner:
    """A corner: signs of the tolerances, its relative RMS in percent, and the value of the linear model."""

    tolerances: tuple[Tolerance, ...]
    signs: tuple[int, ...]
    relative_rms_percent: float
    linear_percent: float

    def describe(self) -> str:
        """The tolerances with their signs, as text."""
        return ", ".join(f"{'+' if s > 0 else '-'}{c.title}" for c, s in zip(self.tolerances, self.signs, strict=True))


def tilts(instrument: Instrument, tolerance_deg: float = TILT_DEG) -> tuple[Tolerance, ...]:
    """The twelve tilts of Table 2 and figure 11: three mirrors, sample, beam and arc, meridional and sagittal each.

    The beam turns about the sample: its tilt is a shift of the exit pupil, because a tilt of the pupil about its own centre
    does not change the light.
    """
    shift_mm = instrument.pupil_distance_mm * math.tan(math.radians(tolerance_deg))
    tolerances = [
        Tolerance(f"mirror_{k}", f"{axis}_deg", tolerance_deg, f"mirror {k} {axis}") for k in (1, 2, 3) for axis in ("rx", "ry")
    ]
    tolerances += [
        Tolerance(name, f"{axis}_deg", tolerance_deg, f"{name} {axis}") for name in ("sample", "arc") for axis in ("rx", "ry")
    ]
    tolerances += [Tolerance("pupil", f"{axis}_mm", shift_mm, f"beam {axis}") for axis in ("x", "z")]
    return tuple(tolerances)


def shifts(tolerance_mm: float = SHIFT_MM) -> tuple[Tolerance, ...]:
    """The fifteen shifts of Table 2: three mirrors, sample and arc along three axes."""
    names = ("mirror_1", "mirror_2", "mirror_3", "sample", "arc")
    return tuple(
        Tolerance(name, f"{axis}_mm", tolerance_mm, f"{name.replace('_', ' ')} {axis}")
        for name in names
        for axis in ("x", "y", "z")
    )


def with_deviations(instrument: Instrument, tolerances: Sequence[Tolerance], signs: Sequence[int]) -> Instrument:
    """The instrument with each tolerance at its amount times its sign, -1, 0 or 1, and the hole lit everywhere.

    A shifted pupil is a beam turned about the sample, which stays on the hole, and Table 3 has no light to lose.
    """
    elements: dict[str, dict[str, float]] = {}
    for tolerance, sign in zip(tolerances, signs, strict=True):
        if sign:
            elements.setdefault(tolerance.element, {})[tolerance.name] = sign * tolerance.amount
    deviations = {name: Deviation(**amounts) for name, amounts in elements.items()}
    return replace(instrument, deviations=deviations, lit_everywhere=True)


def worst_corner(instrument: Instrument, sigma_deg: float, width_deg: float, tolerances: Sequence[Tolerance]) -> Corner:
    """The corner, of all 2^n of n tolerances, with the largest relative RMS (formula 5) of a Gaussian in plane."""

    def residual(signs: Sequence[int]) -> Floats:
        (cut,) = gaussian_cuts(with_deviations(instrument, tolerances, signs), [sigma_deg], width_deg)
        return cut.relative_deviation

    known: dict[tuple[int, ...], float] = {}

    def percent(signs: tuple[int, ...]) -> float:
        if signs not in known:
            known[signs] = 100.0 * _rms(residual(signs))
        return known[signs]

    count = len(tolerances)
    units = np.eye(count, dtype=int)
    nominal = residual([0] * count)
    slopes = np.array([0.5 * (residual(list(unit)) - residual(list(-unit))) for unit in units])
    corners = np.array(list(itertools.product((-1, 1), repeat=count)))
    linear_rms = np.sqrt(np.mean((nominal + corners @ slopes) ** 2, axis=1))
    order = np.argsort(-linear_rms, kind="stable")[:SIMULATED_CORNERS]
    worst = max((tuple(int(sign) for sign in corners[k]) for k in order), key=percent)
    while True:
        neighbours = [tuple(-sign if i == flipped else sign for i, sign in enumerate(worst)) for flipped in range(count)]
        worse = max(neighbours, key=percent)
        if percent(worse) <= percent(worst):
            break
        worst = worse
    linear = 100.0 * _rms(nominal + np.array(worst) @ slopes)
    return Corner(tuple(tolerances), worst, percent(worst), linear)


def with_shifts(instrument: Instrument, sigma_deg: float, width_deg: float, corner: Corner) -> Corner:
    """The corner with the shifts added, each with the sign that increases the error there."""
    every = (*corner.tolerances, *shifts())

    def percent(more: Sequence[int]) -> float:
        (cut,) = gaussian_cuts(with_deviations(instrument, every, (*corner.signs, *more)), [sigma_deg], width_deg)
        return cut.relative_rms_percent

    units = np.eye(len(every) - len(corner.signs), dtype=int)
    more = tuple(1 if percent(list(unit)) >= percent(list(-unit)) else -1 for unit in units)
    return Corner(every, (*corner.signs, *more), percent(more), math.nan)


def _rms(values: Floats) -> float:
    return math.sqrt(float(np.mean(values**2)))
