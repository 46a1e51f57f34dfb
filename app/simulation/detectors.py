"""Grids of a simulation: lists of angles as people write them, detectors on the paper's geocentric grid, output nodes."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction

HIGHEST_POLAR_DEG = 87.0
NEAR_STEP_DEG, FAR_STEP_DEG = 0.5, 5.0
"""Of detectors, near the specular direction and in diffuse directions (paper, section 3.1)."""
NEAR_DEG = 10.0
GROWTH = 0.2
"""Beyond `NEAR_DEG` from the specular direction steps grow by so much a degree."""
LONGEST = 20_000
THETA_DEG: Floats = np.concatenate(
    [np.arange(0.0, 12.0, 0.5), np.arange(12.0, 30.0, 1.0), np.arange(30.0, 60.0, 2.0), np.arange(60.0, 181.0, 5.0)]
)
PHI_STEP_DEG = 10.0


def parse_list(text: str, name: str, low: float, high: float) -> Floats:
    """The list (n,) that a text says: numbers with commas between, or ranges `start:stop:step`, the stop included.

    Raises UserError, naming the list, for what is no number, for one outside low..high, and for a list that does not
    ascend.
    """
    found: list[float] = []
    for part in text.split(","):
        words = part.split(":")
        try:
            values = [float(word) for word in words]
        except ValueError:
            raise UserError(f"{name}: {part.strip()!r} is no number; write 0,30,60 or start:stop:step") from None
        if len(values) == 3:
            values = _range(name, part.strip(), *values)
        elif len(values) != 1:
            raise UserError(f"{name}: {part.strip()!r} is no range; write start:stop:step")
        found += values
    for value in found:
        if not (math.isfinite(value) and low <= value <= high):
            raise UserError(f"{name}: {value:g} is out of range; give {low:g} to {high:g}")
    result = np.array(found)
    if np.any(np.diff(result) <= 0.0):
        raise UserError(f"{name}: {text!r} does not ascend; sort it, and give each number once")
    return result


def _range(name: str, part: str, start: float, stop: float, step: float) -> list[float]:
    if not (all(map(math.isfinite, (start, stop, step))) and step > 0.0 and stop >= start):
        raise UserError(f"{name}: {part!r} is no range; write start:stop:step with a positive step")
    count = (stop - start) / step
    if count > LONGEST:
        raise UserError(f"{name}: {part!r} has {count:.0f} numbers; give at most {LONGEST}")
    return [start + k * step for k in range(math.floor(count + 1e-9) + 1)]


@dataclass(frozen=True, eq=False)
class Detectors:
    """Detectors on the grid of polar angles (p,) and azimuths (a,), degrees, of the rig's frame; n = p a, azimuth fastest.

    `mirrored`: the azimuths are 0 to 180, and the other half is its mirror image in the plane of incidence.
    """

    polar_deg: Floats
    azimuth_deg: Floats
    mirrored: bool

    def directions(self, lower: bool) -> Floats:
        """Unit vectors (n, 3); those of the `lower` arc are the upper one's, mirrored in the sample's plane."""
        return arc_direction(self.polar_deg[:, None], self.azimuth_deg[None, :], lower).reshape(-1, 3)


def detector_grid(sigma_deg: float, mirrored: bool, also_deg: Sequence[float] = ()) -> Detectors:
    """Detectors round the specular direction of sigma: steps of 0.5 deg near it, growing to 5 deg in diffuse directions.

    Polar angles go from 0 to 87 deg or to where the lobe's fine steps end, below 90. Steps are fine near the polar angles
    `also_deg` too: where lobes are that a refraction has bent away from the specular direction.
    """
    centres = sorted({sigma_deg, *also_deg})
    highest = max(HIGHEST_POLAR_DEG, min(89.5, centres[-1] + 2.0))
    borders = [0.0, *(0.5 * (left + right) for left, right in itertools.pairwise(centres)), highest]
    parts = []
    for centre, start, stop in zip(centres, borders[:-1], borders[1:], strict=True):
        # Without its last: on a border it is the next one's first.
        parts += [centre - _graded(centre - start, 1.0)[:0:-1], centre + _graded(stop - centre, 1.0)[:-1]]
    polar = np.concatenate([*parts, [highest]])
    # A step in azimuth is as long as its polar angle's sine makes it.
    away = _graded(180.0, max(math.sin(math.radians(centres[-1])), 0.05))
    azimuth = 180.0 - away[::-1]
    return Detectors(polar, azimuth if mirrored else np.concatenate([azimuth, 180.0 + away[1:]]), mirrored)


def _graded(last: float, scale: float) -> Floats:
    """Distances (n,) from 0 to `last` in steps that grow; `scale` deg of the sky for each deg of them."""
    found = [0.0]
    while True:
        near = NEAR_STEP_DEG + GROWTH * max(0.0, found[-1] * scale - NEAR_DEG)
        found.append(found[-1] + min(FAR_STEP_DEG, near / scale))
        if found[-1] >= last - 1e-9:
            break
    if last <= 0.0:
        return np.zeros(1)
    # The last one to where it should end: all steps a little shorter.
    return np.array(found) * (last / found[-1])


def output_theta(theta_deg: Floats | None) -> Floats:
    """Nodes of theta (n,) from 0 to 180: readers of a table extrapolate outside its list."""
    given = THETA_DEG if theta_deg is None else theta_deg
    return np.unique(np.concatenate([[0.0], given, [180.0]]))


def output_phi(phi_deg: Floats | None, mirrored: bool) -> Floats:
    """Nodes of phi (n,), from 0 to 180 for a sample with mirror symmetry and to 360 for another."""
    last = 180.0 if mirrored else 360.0
    given = np.arange(0.0, last + 1.0, PHI_STEP_DEG) if phi_deg is None else phi_deg
    if given[-1] > last:
        wrong = f"--phi: {given[-1]:g} is out of range"
        raise UserError(f"{wrong}; this sample is its own mirror image in the plane of incidence: give 0 to 180")
    return np.unique(np.concatenate([[0.0], given, [last]]))
