"""The worst corner of the deviations: every element at the limit of its tolerance, with the signs of the largest error.

It is found without an enumeration (app.simulation.corner_search).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.corner_search import search_worst
from goniotwin.app.simulation.paper.gaussian_cut import (
    gaussian_cuts,
    gaussian_theory,
    in_plane_directions,
    in_plane_theta,
    relative_deviation,
)
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, Pose, Scenes, deviation_array, gaussian

TILT_DEG = 0.05
SHIFT_MM = 0.1
SIGNS = {1: "+", 0: "0 ", -1: "-"}


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
        return ", ".join(f"{SIGNS[s]}{c.title}" for c, s in zip(self.tolerances, self.signs, strict=True))


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
    """The corner of n tolerances with the largest relative RMS (formula 5) of a Gaussian in plane; see `search_worst`."""
    theta = in_plane_theta(sigma_deg, width_deg)
    theory = gaussian_theory(theta, width_deg, "one_over_e")
    pose = Pose(sigma_deg, in_plane_directions(sigma_deg, theta))
    lit = with_deviations(instrument, (), ())
    scenes = Scenes(lit, [pose], [gaussian(width_deg, peak=1.0 / math.pi)])

    def residuals(levels: Floats) -> Floats:
        rigs = deviation_array(with_deviations(instrument, tolerances, each).deviations for each in levels.tolist())
        return relative_deviation(scenes.ratios(rigs)[:, 0, 0], theory)

    found = search_worst(residuals, len(tolerances))
    signs = tuple(int(level) for level in found.levels)
    return Corner(tuple(tolerances), signs, found.percent, found.linear_percent)


def with_shifts(instrument: Instrument, sigma_deg: float, width_deg: float, corner: Corner) -> Corner:
    """The corner with the shifts added, each with the sign that increases the error there."""
    every = (*corner.tolerances, *shifts())

    def percent(more: Sequence[int]) -> float:
        (cut,) = gaussian_cuts(with_deviations(instrument, every, (*corner.signs, *more)), [sigma_deg], width_deg)
        return cut.relative_rms_percent

    units = np.eye(len(every) - len(corner.signs), dtype=int)
    more = tuple(1 if percent(list(unit)) >= percent(list(-unit)) else -1 for unit in units)
    return Corner(every, (*corner.signs, *more), percent(more), math.nan)
