"""Stray light as a smooth map over directions: each ray contributes to all detectors that would count it.

A ray is counted by detectors about its direction whose field of view contains it and whose disc it crosses. Relative to the ray
both are circles of directions, one about its own direction and one about its point on the arc's sphere; their intersection is a
solid angle. So every ray contributes, and not one in a hundred thousand.
"""

import math
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats, Singles
from goniotwin.twin.optics.forward.paths import DX, DY, DZ, PX, PY, WEIGHT
from goniotwin.twin.optics.kernel import kernel

POLAR_STEP_DEG, AZIMUTH_STEP_DEG = 5.0, 10.0
POLAR_BINS, AZIMUTH_BINS = 18, 36
BINS = 2 * POLAR_BINS * AZIMUTH_BINS


class Spread(NamedTuple):
    """Parameters of the map; without `wanted` there is none.

    The bins, over side, polar angle and azimuth in the sample's frame, follow in the sums after those of the `detectors`. The
    arc's radius and a detector's, in mm; half its field in rad.
    """

    wanted: bool
    detectors: int
    arc: float
    disc: float
    half_field: float


@kernel()
def common_area(a: float, b: float, apart: float) -> float:
    """Area of the intersection of two circles of radii a and b with a distance `apart` between their centres."""
    if apart >= a + b:
        return 0.0
    if apart <= abs(a - b):
        return math.pi * min(a, b) ** 2
    x = (apart * apart + a * a - b * b) / (2.0 * apart)
    y = apart - x
    half = math.sqrt(max(0.0, a * a - x * x))
    return a * a * math.acos(max(-1.0, min(1.0, x / a))) + b * b * math.acos(max(-1.0, min(1.0, y / b))) - apart * half


@kernel()
def spread_segment(
    spread: Spread, px: float, py: float, pz: float, dx: float, dy: float, dz: float, ends: bool, weight: float, sums: Floats
) -> None:
    """Add a ray from p along d, unless it `ends` at the sample unit, before the arc."""
    along = px * dx + py * dy + pz * dz
    if ends or along >= spread.arc:
        return
    aside = math.sqrt(max(0.0, px * px + py * py + pz * pz - along * along))
    area = common_area(spread.half_field, spread.disc / spread.arc, aside / spread.arc)
    i = min(int(math.degrees(math.acos(min(1.0, abs(dz)))) / POLAR_STEP_DEG), POLAR_BINS - 1)
    j = int(math.degrees(math.atan2(dy, dx)) / AZIMUTH_STEP_DEG + AZIMUTH_BINS) % AZIMUTH_BINS
    side = 0 if dz >= 0.0 else 1
    row = spread.detectors + (side * POLAR_BINS + i) * AZIMUTH_BINS + j
    sums[row, 2] += weight * area
    sums[row, 3] += (weight * area) ** 2


@kernel()
def spread_block(buffer: Singles, count: int, height: float, spread: Spread, sums: Floats) -> None:
    """Add the paths of a block from points `height` above the sample; nothing of the sample unit is in their way."""
    for i in range(count):
        weight = np.float64(buffer[i + WEIGHT])
        if weight > 0.0:
            dx, dy, dz = np.float64(buffer[i + DX]), np.float64(buffer[i + DY]), np.float64(buffer[i + DZ])
            px, py = np.float64(buffer[i + PX]), np.float64(buffer[i + PY])
            spread_segment(spread, px, py, height, dx, dy, dz, False, weight, sums)


@kernel()
def projected_solid_angles() -> Floats:
    """Projected solid angle in sr of the bins of each polar angle, (18,)."""
    result = np.empty(POLAR_BINS)
    for i in range(POLAR_BINS):
        low, high = math.radians(i * POLAR_STEP_DEG), math.radians((i + 1) * POLAR_STEP_DEG)
        result[i] = 0.5 * (math.sin(high) ** 2 - math.sin(low) ** 2) * math.radians(AZIMUTH_STEP_DEG)
    return result
