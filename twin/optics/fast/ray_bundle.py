"""Bundle of rays: the same for every detector and every sample, so that errors of the quadrature cancel in ratios."""

import math
from functools import lru_cache

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import detector_frame
from goniotwin.twin.optics.geometry.mirrors import distance_to
from goniotwin.twin.optics.illumination.slit_image import cut_ray_chord
from goniotwin.twin.optics.kernel import kernel

# Offset of the sequence: the best of 120, chosen when rays beyond the disc's edge were still dropped; any other would do.
SHIFT = (0.42, 0.25, 0.22, 0.65, 0.05, 0.24)


def _r_sequence(count: int, shift: tuple[float, ...]) -> Floats:
    """Points (count, len(shift)) in 0..1: additive recurrence with the generalised golden ratio (Roberts 2018)."""
    dimensions = len(shift)
    ratio = 2.0
    for _ in range(64):
        ratio = (1.0 + ratio) ** (1.0 / (dimensions + 1))
    steps = (1.0 / ratio) ** np.arange(1, dimensions + 1)
    return (0.5 + np.array(shift) + np.arange(1, count + 1)[:, None] * steps) % 1.0


def _disc(square: Floats) -> Floats:
    """Map of the square from -1 to 1 (n, 2) to the unit disc that keeps areas (concentric map, Shirley and Chiu 1997)."""
    x, y = square[:, 0], square[:, 1]
    wide = np.abs(x) > np.abs(y)
    radius = np.where(wide, x, y)
    divisor = np.where(radius == 0.0, 1.0, radius)
    angle = np.where(wide, np.pi / 4 * y / divisor, np.pi / 2 - np.pi / 4 * x / divisor)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)


@lru_cache(maxsize=16)
def ray_bundle(rays: int) -> Floats:
    """Rays (rays, 6): a point in the hole (from -1 to 1), and points of unit discs: acceptance cone, exit pupil.

    The same for every call. Every ray comes with three more: with opposite signs at the detector's end, at the pupil's end, and
    at both. In the lobe of a Gaussian the terms that are odd in a ray's offset from the axis are by far the largest; so they
    cancel, with the products of the two ends. Raises ValueError unless `rays` is a multiple of 4 and at least 4.
    """
    if rays < 4 or rays % 4:
        raise ValueError(f"rays is {rays}: give a multiple of 4, at least 4")
    squares = 2.0 * _r_sequence(rays // 4, SHIFT) - 1.0
    quarter = np.hstack([squares[:, 0:2], _disc(squares[:, 2:4]), _disc(squares[:, 4:6])])
    ends = np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])
    signs = np.repeat(ends, (4, 2), axis=1)
    bundle = np.ascontiguousarray((signs[:, None, :] * quarter).reshape(rays, 6))
    bundle.flags.writeable = False
    return bundle


@kernel()
def cone_slopes(rays: Floats, sizes: Floats) -> Floats:
    """Slopes of each ray to the detector's axis, away from the normal and level, and its component along it: (rays, 3)."""
    result = np.empty((rays.shape[0], 3))
    for j in range(rays.shape[0]):
        away, level = sizes[2] * rays[j, 2], sizes[2] * rays[j, 3]
        along = math.sqrt(1.0 - away * away - level * level)
        result[j, 0], result[j, 1], result[j, 2] = away / along, level / along, along
    return result


@kernel()
def fill_view(centre: Floats, d: Floats, axes: Floats) -> None:
    """Fill `axes` (4, 3) of a detector: away (from the normal), level, along d; and its centre along these."""
    e1x, e1y, e1z, e2x, e2y = detector_frame(d[0], d[1], d[2])
    axes[0, 0], axes[0, 1], axes[0, 2] = e1x, e1y, e1z
    axes[1, 0], axes[1, 1], axes[1, 2] = e2x, e2y, 0.0
    axes[2, 0], axes[2, 1], axes[2, 2] = d[0], d[1], d[2]
    for k in range(3):
        axes[3, k] = centre[0] * axes[k, 0] + centre[1] * axes[k, 1] + centre[2] * axes[k, 2]


@kernel(forceinline=True)
def detector_ray(
    axes: Floats, rays: Floats, slopes: Floats, j: int, sizes: Floats, first_v: float, last_v: float, edges: Floats
) -> tuple[float, float, float, float, float, float, float]:
    """Ray j of the bundle of a detector with the given axes, from the part of the hole that its disc covers along the ray.

    Returns its weight (0 if disc and hole do not meet), point (x, y) on the sample, direction (x, y, z) towards the detector,
    length.

    No ray is dropped: v is set within the range where disc and hole can meet, then u on their common chord, and the weight
    includes their share of the hole. So the result changes smoothly with the detector's direction. This is needed because
    etalon and sample are measured at slightly different poses. Likewise v is within `first_v` and `last_v`, and u within the
    `edges` (n, 3, 3) of the slit's image for the ray's point of the pupil, if there are any (`SlitImage`). Directions are
    uniform over the cone's projection on the disc, so the weight includes the other cosines.
    """
    radius, half, p, q = sizes[0], sizes[1], slopes[j, 0], slopes[j, 1]
    # A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
    a0, au, av = axes[3, 2] * p - axes[3, 0], axes[0, 0] - p * axes[2, 0], axes[0, 1] - p * axes[2, 1]
    b0, bu, bv = axes[3, 2] * q - axes[3, 1], axes[1, 0] - q * axes[2, 0], axes[1, 1] - q * axes[2, 1]
    square = au * au + bu * bu
    area = au * bv - av * bu
    middle, reach = (bu * a0 - au * b0) / area, radius * math.sqrt(square) / abs(area)
    low, high = max(first_v, middle - reach), min(last_v, middle + reach)
    share_v = high - low
    v = 0.5 * (low + high + share_v * rays[j, 1])
    a1, b1 = a0 + av * v, b0 + bv * v
    beside = a1 * bu - b1 * au
    middle = -(a1 * au + b1 * bu) / square
    reach = math.sqrt(max(0.0, radius * radius * square - beside * beside)) / square
    low, high = max(-half, middle - reach), min(half, middle + reach)
    low, high = cut_ray_chord(edges, rays[j, 4], rays[j, 5], v, low, high)
    share_u = high - low
    u = 0.5 * (low + high + share_u * rays[j, 0])
    along = slopes[j, 2]
    wx = along * (axes[2, 0] + p * axes[0, 0] + q * axes[1, 0])
    wy = along * (axes[2, 1] + p * axes[0, 1] + q * axes[1, 1])
    wz = along * (axes[2, 2] + p * axes[0, 2])
    weight = 0.0
    # NaN (a detector in the sample's plane) and rays from the far side of the sample do not count.
    if share_u > 0.0 and share_v > 0.0 and wz * axes[2, 2] > 0.0:
        weight = abs(area) * share_u * share_v / (4.0 * half * half)
    length = (axes[3, 2] - u * axes[2, 0] - v * axes[2, 1]) / along
    return weight, u, v, wx, wy, wz, length


@kernel(forceinline=True)
def arrival(
    px: float, py: float, u: float, v: float, pupil: Floats, images: Floats, half: float, clipped: bool
) -> tuple[float, float, float, float]:
    """Direction (x, y, z) to the pupil's point (u, v) from (px, py) on the sample, and its cos(l) cos(pupil) / r^2.

    The latter is 0 for light from behind, or for a ray that misses one of the unfolded mirrors.
    """
    lx = pupil[0, 0] + u * pupil[1, 0] + v * pupil[2, 0] - px
    ly = pupil[0, 1] + u * pupil[1, 1] + v * pupil[2, 1] - py
    lz = pupil[0, 2] + u * pupil[1, 2] + v * pupil[2, 2]
    shrink = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * shrink, ly * shrink, lz * shrink
    gain = max(lz, 0.0) * (lx * pupil[3, 0] + ly * pupil[3, 1] + lz * pupil[3, 2]) * shrink * shrink
    if clipped:
        for m in range(3):
            if distance_to(images, m, half, px, py, 0.0, lx, ly, lz) == math.inf:
                gain = 0.0
    return lx, ly, lz, gain
