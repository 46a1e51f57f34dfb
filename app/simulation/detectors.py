"""Grids of a simulation: lists of numbers in options, the detectors' geocentric grid (paper, section 3.1), the output grid."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.formats.specular_grid import PolarGrid
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction

HIGHEST_POLAR_DEG = 87.0
NEAR_STEP_DEG, FAR_STEP_DEG = 0.5, 5.0
"""Steps of the detectors near the specular direction and in diffuse directions (paper, section 3.1)."""
NEAR_DEG = 10.0
GROWTH = 0.2
"""Growth of the steps per degree beyond `NEAR_DEG` from the specular direction."""
LONGEST_LIST = 20_000
THETA_DEG: Floats = np.concatenate(
    [np.arange(0.0, 12.0, 0.5), np.arange(12.0, 30.0, 1.0), np.arange(30.0, 60.0, 2.0), np.arange(60.0, 181.0, 5.0)]
)
PHI_STEP_DEG = 10.0


def parse_list(text: str, name: str, low: float, high: float, reason: str = "") -> Floats:
    """The list (n,) of a text: numbers separated by commas, or ranges `start:stop:step` with the stop included.

    Raises UserError with the name of the list for a text that is not a number, for a number outside low..high (with the
    `reason` of the limit), and for a list that does not ascend.
    """
    numbers: list[float] = []
    for part in text.split(","):
        words = part.split(":")
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise UserError(f"{name}: {part.strip()!r} is not a number; write 0,30,60 or start:stop:step") from None
        if len(values) == 3:
            values = _range(name, part.strip(), *values)
        elif len(values) != 1:
            raise UserError(f"{name}: {part.strip()!r} is not a range; write start:stop:step")
        numbers += values
    for value in numbers:
        if not (math.isfinite(value) and low <= value <= high):
            because = f" ({reason})" if reason else ""
            raise UserError(f"{name}: {value:g} is out of range; give {low:g} to {high:g}{because}")
    result = np.array(numbers)
    if np.any(np.diff(result) <= 0.0):
        raise UserError(f"{name}: {text!r} does not ascend; sort it, and give each number once")
    return result


def _range(name: str, part: str, start: float, stop: float, step: float) -> list[float]:
    if not (all(map(math.isfinite, (start, stop, step))) and step > 0.0 and stop >= start):
        raise UserError(f"{name}: {part!r} is not a range; write start:stop:step with a positive step")
    count = (stop - start) / step
    if count > LONGEST_LIST:
        raise UserError(f"{name}: {part!r} has {count:.0f} numbers; give at most {LONGEST_LIST}")
    return [start + k * step for k in range(math.floor(count + 1e-9) + 1)]


@dataclass(frozen=True, eq=False)
class Detectors:
    """Detectors on a grid of polar angles (p,) and azimuths (a,), degrees, in the rig's frame; n = p a, azimuth fastest.

    With `mirrored` the azimuths are 0 to 180, and the other half is their mirror image in the plane of incidence.
    """

    polar_deg: Floats
    azimuth_deg: Floats
    mirrored: bool

    def grid(self, values: Floats, u: Floats) -> PolarGrid:
        """Values and standard uncertainties (n,) of the detectors, for the resampling."""
        shape = self.polar_deg.size, self.azimuth_deg.size
        none = np.zeros(shape)
        return PolarGrid(self.polar_deg, self.azimuth_deg, values.reshape(shape), u.reshape(shape), none, self.mirrored)

    def directions(self, lower: bool) -> Floats:
        """Unit vectors (n, 3); those of the `lower` arc are those of the upper one mirrored in the sample's plane."""
        return arc_direction(self.polar_deg[:, None], self.azimuth_deg[None, :], lower).reshape(-1, 3)


def detector_grid(sigma_deg: float, mirrored: bool, also_deg: Sequence[float] = ()) -> Detectors:
    """Detectors about the specular direction of sigma: steps of 0.5 deg near it, growing to 5 deg in diffuse directions.

    Polar angles go from 0 to 87 deg, or to the end of the fine steps near the lobe, below 90. Steps are also fine near the
    polar angles `also_deg`, the axes of refracted lobes.
    """
    centres = sorted({sigma_deg, *also_deg})
    highest = max(HIGHEST_POLAR_DEG, min(89.5, centres[-1] + 2.0))
    borders = [0.0, *(0.5 * (left + right) for left, right in itertools.pairwise(centres)), highest]
    parts = []
    for centre, start, stop in zip(centres, borders[:-1], borders[1:], strict=True):
        # Without the last angle: on a border it is the first of the next part.
        parts += [centre - _graded(centre - start, 1.0)[:0:-1], centre + _graded(stop - centre, 1.0)[:-1]]
    polar = np.concatenate([*parts, [highest]])
    # The length of a step in azimuth is in proportion to the sine of the polar angle.
    away = _graded(180.0, max(math.sin(math.radians(centres[-1])), 0.05))
    azimuth = 180.0 - away[::-1]
    return Detectors(polar, azimuth if mirrored else np.concatenate([azimuth, 180.0 + away[1:]]), mirrored)


def _graded(last: float, scale: float) -> Floats:
    """Distances (n,) from 0 to `last` in growing steps; one degree of distance is `scale` degrees of angle."""
    distances = [0.0]
    while True:
        near = NEAR_STEP_DEG + GROWTH * max(0.0, distances[-1] * scale - NEAR_DEG)
        distances.append(distances[-1] + min(FAR_STEP_DEG, near / scale))
        if distances[-1] >= last - 1e-9:
            break
    if last <= 0.0:
        return np.zeros(1)
    # All steps are made a little shorter, so that the last one ends at `last`.
    return np.array(distances) * (last / distances[-1])


def output_theta(theta_deg: Floats | None) -> Floats:
    """Nodes of theta (n,) from 0 to 180, because readers of a table extrapolate outside its list."""
    given = THETA_DEG if theta_deg is None else theta_deg
    return np.unique(np.concatenate([[0.0], given, [180.0]]))


def output_phi(phi_deg: Floats | None, mirrored: bool) -> Floats:
    """Nodes of phi (n,) from 0 to 180 where sample and rig have mirror symmetry, else to 360. Raises UserError."""
    last = 180.0 if mirrored else 360.0
    given = np.arange(0.0, last + 1.0, PHI_STEP_DEG) if phi_deg is None else phi_deg
    if given[-1] > last:
        wrong = f"--phi: {given[-1]:g} is out of range"
        raise UserError(f"{wrong}; sample and rig are symmetric about the plane of incidence: give 0 to 180")
    return np.unique(np.concatenate([[0.0], given, [last]]))
