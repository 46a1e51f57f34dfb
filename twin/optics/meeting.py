"""Where a ray meets a mirror."""

import math

from goniotwin.arrays import Floats
from goniotwin.twin.optics.kernel import kernel


@kernel(forceinline=True)
def distance_to(
    mirrors: Floats, m: int, half: float, px: float, py: float, pz: float, wx: float, wy: float, wz: float
) -> float:
    """Distance from p along the unit vector w to the square m of half side `half`; infinite where the ray misses it."""
    cx, cy, cz = mirrors[m, 0, 0] - px, mirrors[m, 0, 1] - py, mirrors[m, 0, 2] - pz
    slope = wx * mirrors[m, 1, 0] + wy * mirrors[m, 1, 1] + wz * mirrors[m, 1, 2]
    # A ray within the mirror's plane divides by zero: infinite or NaN, and then the last line says no.
    distance = (cx * mirrors[m, 1, 0] + cy * mirrors[m, 1, 1] + cz * mirrors[m, 1, 2]) / slope
    x, y, z = distance * wx - cx, distance * wy - cy, distance * wz - cz
    u = x * mirrors[m, 2, 0] + y * mirrors[m, 2, 1] + z * mirrors[m, 2, 2]
    v = x * mirrors[m, 3, 0] + y * mirrors[m, 3, 1] + z * mirrors[m, 3, 2]
    if distance > 0.0 and abs(u) <= half and abs(v) <= half:
        return distance  # type: ignore[no-any-return]
    return math.inf
