"""What the mirrors hide from a detector.

The mirror unit stands between sample and arc: mirror 3 hides a zone round the retro-direction, which at sigma = 0 is
the specular direction, and mirror 2 a zone 45 deg from it. That is a fact of the instrument: campaigns plan around it.
"""

import math

import numpy as np
import numpy.typing as npt
from numba import njit

from twin.optics.bundle import cone, detector_ray, detector_sizes, hole_turn, ray_bundle, view
from twin.optics.frames import Floats, direction_rows
from twin.optics.instrument import Instrument
from twin.optics.mirrors import mirrors_at


@njit(cache=True, error_model="numpy", forceinline=True)
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


@njit(cache=True, error_model="numpy")
def may_hide(mirrors: Floats, m: int, half: float, radius: float, d: Floats, width: float) -> bool:
    """Whether square m reaches into the tube of radius `width` round the line of length `radius` along d.

    A sphere round the mirror stands for it: most detectors are told free of a mirror without tracing a single ray.
    """
    along, square = 0.0, 0.0
    for c in range(3):
        along += mirrors[m, 0, c] * d[c]
        square += mirrors[m, 0, c] * mirrors[m, 0, c]
    foot = min(radius, max(0.0, along))
    gap2 = square - 2.0 * foot * along + foot * foot
    return gap2 < (width + math.sqrt(2.0) * half) ** 2


@njit(cache=True, error_model="numpy", forceinline=True)
def hidden(
    mirrors: Floats, near: Floats, half: float, reach: float,
    px: float, py: float, wx: float, wy: float, wz: float,
) -> bool:  # fmt: skip
    """Whether a mirror, of those that are near, cuts the ray from (px, py) on the sample within `reach`."""
    for m in range(3):  # noqa: SIM110 - a generator in numba is slower
        if near[m] > 0.0 and distance_to(mirrors, m, half, px, py, 0.0, wx, wy, wz) < reach:
            return True
    return False


@njit(cache=True, error_model="numpy")
def mirrors_near(mirrors: Floats, half: float, d: Floats, sizes: Floats, near: Floats) -> None:
    """Sets near[m] to 1 where mirror m may hide some of the bundle of a detector in direction d, and else to 0."""
    width = max(sizes[1], math.sqrt(2.0) * sizes[3])
    for m in range(3):
        near[m] = 1.0 if may_hide(mirrors, m, half, sizes[0], d, width) else 0.0


@njit(cache=True, error_model="numpy")
def _visible(directions: Floats, rays: Floats, sizes: Floats, turn: Floats, mirrors: Floats, half: float) -> Floats:
    result = np.zeros(directions.shape[0])
    near, axes, slopes = np.zeros(3), np.zeros((5, 3)), cone(rays, sizes)
    for k in range(directions.shape[0]):
        view(directions[k, 0], directions[k, 1], directions[k, 2], turn, axes)
        mirrors_near(mirrors, half, directions[k], sizes, near)
        seen, free = 0.0, 0.0
        for j in range(rays.shape[0]):
            weight, px, py, wx, wy, wz, length = detector_ray(axes, rays, slopes, j, sizes, turn)
            seen += weight
            if weight > 0.0 and not hidden(mirrors, near, half, length, px, py, wx, wy, wz):
                free += weight
        if seen > 0.0:
            result[k] = free / seen
    return result


def visible_fraction(
    instrument: Instrument, sigma_deg: float, directions: npt.ArrayLike, rays: int = 256, gamma_deg: float = 0.0
) -> Floats:
    """Share (n,) of each detector's rays from the illuminated spot that no mirror cuts, for `directions` (n, 3).

    Whether or not the instrument's `obstruction` is on. 0 for a detector in the sample's plane, which sees nothing.
    From `rays` deterministic rays a detector. Raises ValueError for a wrong shape or a vector of no length.
    """
    return np.asarray(
        _visible(
            direction_rows(directions), ray_bundle(rays), detector_sizes(instrument), hole_turn(gamma_deg),
            mirrors_at(instrument, sigma_deg).packed, 0.5 * instrument.mirror_side_mm,
        )
    )  # fmt: skip
