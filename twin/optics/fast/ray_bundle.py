"""Bundle of rays: the same for every detector and every sample, so that errors of the quadrature cancel in ratios."""

import math
from typing import Any, TypeVar

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.scene import SceneArrays, detector_frame, reaches_over
from goniotwin.twin.optics.illumination.slit_image import cut_ray_chord
from goniotwin.twin.optics.kernel import kernel

Number = TypeVar("Number", float, Floats)
TILE = 64
"""Rays of a bundle are computed in tiles, in one buffer with a row for each number: see twin.optics.fast.aperture."""
SHARED_ROWS = 7
# Start of each row in the buffer, the first seven also rows of a bundle: the point in the hole (from -1 to 1), slopes to the
# detector's axis, away from the normal and level, component along it, and the point of the pupil's disc.
HOLE_U, HOLE_V, SLOPE_P, SLOPE_Q, ALONG, PUPIL_U, PUPIL_V = (row * TILE for row in range(SHARED_ROWS))
# The detector's end of a ray: weight, point on the sample, direction and distance to the detector. Then weight and light.
END_WEIGHT, END_U, END_V, END_LENGTH, END_X, END_Y, END_Z = (row * TILE for row in range(7, 14))
RAY_WEIGHT, RAY_X, RAY_Y, RAY_Z = (row * TILE for row in range(14, 18))
# Ends of the chord of the hole, before the light is known.
LOW_U, HIGH_U = RAY_X, RAY_Y
TILE_ROWS = 18


@kernel()
def fill_view(centre: Floats, d: Floats, axes: Floats) -> None:
    """Fill `axes` (4, 3) of a detector: away (from the normal), level, along d; and its centre along these."""
    e1x, e1y, e1z, e2x, e2y = detector_frame(d[0], d[1], d[2])
    axes[0, 0], axes[0, 1], axes[0, 2] = e1x, e1y, e1z
    axes[1, 0], axes[1, 1], axes[1, 2] = e2x, e2y, 0.0
    axes[2, 0], axes[2, 1], axes[2, 2] = d[0], d[1], d[2]
    for k in range(3):
        axes[3, k] = centre[0] * axes[k, 0] + centre[1] * axes[k, 1] + centre[2] * axes[k, 2]


@kernel(forceinline=True, fastmath={"contract"})
def map_to_disc(
    e1x: Number, e1y: Number, e2x: Number, e2y: Number, dx: Number, dy: Number, beside1: Number, beside2: Number, ahead: Number,
    p: Number, q: Number,
) -> tuple[Number, Number, Number, Number, Number, Number]:  # fmt: skip
    """Map of the hole to a detector's disc along the slopes p and q, for axes as in `fill_view`: a0, au, av, b0, bu, bv.

    A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
    """
    return (
        ahead * p - beside1, e1x - p * dx, e1y - p * dy,
        ahead * q - beside2, e2x - q * dx, e2y - q * dy,
    )  # fmt: skip


@kernel(nogil=True, fastmath={"contract"})
def fill_ends(
    axes: Floats, bundle: Floats, first: int, count: int, sign: float, sizes: Floats, first_v: float, last_v: float,
    edges: Floats, other: float, t: Floats,
) -> None:  # fmt: skip
    """Fill the detector's ends of `count` rays of a bundle from number `first` on, of the given sign, in the buffer `t`.

    A ray is from the part of the hole that the disc of the detector, with the given axes, covers along it: weight (0 if disc
    and hole do not meet), point on the sample, direction towards the detector, length.

    No ray is dropped: v is set within the range where disc and hole can meet, then u on their common chord, and the weight
    includes their share of the hole. So the result changes smoothly with the detector's direction. This is needed because
    etalon and sample are measured at slightly different poses. Likewise v is within `first_v` and `last_v`, and u within the
    `edges` (n, 3, 3) of the slit's image, if there are any (`SlitImage`), for the ray's point of the pupil, of sign `other`.
    Directions are uniform over the cone's projection on the disc, so the weight includes the other cosines.
    """
    radius, half, spot = sizes[0], sizes[1], 0.25 / (sizes[1] * sizes[1])
    e1x, e1y, e1z, e2x, e2y = axes[0, 0], axes[0, 1], axes[0, 2], axes[1, 0], axes[1, 1]
    dx, dy, dz, beside1, beside2, ahead = axes[2, 0], axes[2, 1], axes[2, 2], axes[3, 0], axes[3, 1], axes[3, 2]
    for row in range(SHARED_ROWS):
        for i in range(count):
            t[i + row * TILE] = bundle[row, first + i]
    for i in range(count):
        p, q, along = sign * t[i + SLOPE_P], sign * t[i + SLOPE_Q], t[i + ALONG]
        a0, au, av, b0, bu, bv = map_to_disc(e1x, e1y, e2x, e2y, dx, dy, beside1, beside2, ahead, p, q)
        square = au * au + bu * bu
        area = au * bv - av * bu
        whole, part = 1.0 / area, 1.0 / square  # few divisions and roots: they are half of the time
        middle, reach = (bu * a0 - au * b0) * whole, radius * math.sqrt(square) * abs(whole)
        # Plain comparisons: Python's max and min prevent vectorisation of the loop.
        low, high = middle - reach, middle + reach
        low, high = (low if low > first_v else first_v), (high if high < last_v else last_v)
        share_v = high - low
        v = 0.5 * (low + high + share_v * (sign * t[i + HOLE_V]))
        a1, b1 = a0 + av * v, b0 + bv * v
        beside = a1 * bu - b1 * au
        inside = radius * radius * square - beside * beside
        middle, reach = -(a1 * au + b1 * bu) * part, math.sqrt(inside if inside > 0.0 else 0.0) * part
        low, high = middle - reach, middle + reach
        wz = along * (dz + p * e1z)
        # NaN (a detector in the sample's plane) and rays from the far side of the sample do not count.
        t[i + END_WEIGHT] = abs(area) * share_v * spot if (share_v > 0.0) & (wz * dz > 0.0) else 0.0
        t[i + LOW_U], t[i + HIGH_U] = (low if low > -half else -half), (high if high < half else half)
        t[i + END_V] = v
        t[i + END_X], t[i + END_Y] = along * (dx + p * e1x + q * e2x), along * (dy + p * e1y + q * e2y)
        t[i + END_Z] = wz
    for k in range(edges.shape[0]):
        for i in range(count):
            a, b = other * t[i + PUPIL_U], other * t[i + PUPIL_V]
            t[i + LOW_U], t[i + HIGH_U] = cut_ray_chord(edges, k, a, b, t[i + END_V], t[i + LOW_U], t[i + HIGH_U])
    for i in range(count):
        p, q, along = sign * t[i + SLOPE_P], sign * t[i + SLOPE_Q], t[i + ALONG]
        low, high, v = t[i + LOW_U], t[i + HIGH_U], t[i + END_V]
        share_u = high - low
        u = 0.5 * (low + high + share_u * (sign * t[i + HOLE_U]))
        counts = (share_u > 0.0) & (t[i + END_WEIGHT] > 0.0)
        u, v = (u if counts else 0.0), (v if counts else 0.0)
        t[i + END_WEIGHT] = t[i + END_WEIGHT] * share_u if counts else 0.0
        t[i + END_U], t[i + END_V] = u, v
        # The direction's component along the axis is 1 / sqrt(1 + p^2 + q^2), so this is the length without a division.
        t[i + END_LENGTH] = (ahead - u * dx - v * dy) * along * (1.0 + p * p + q * q)


@kernel(forceinline=True, fastmath={"contract"})
def is_blocked(
    cx: float, cy: float, cz: float, nx: float, ny: float, nz: float, ux: float, uy: float, uz: float,
    vx: float, vy: float, vz: float, half: float,
    u: Number, v: Number, wx: Number, wy: Number, wz: Number, length: Number,
) -> Any:  # fmt: skip
    """Whether a square of half side `half` (centre c, normal n, axes u and v) blocks a ray.

    The ray is from the point (u, v, 0) in the direction w, a unit vector, and ends at `length`.
    """
    hx, hy = cx - u, cy - v
    # A ray within the mirror's plane divides by zero: the result is inf or NaN, and the condition is false.
    distance = (hx * nx + hy * ny + cz * nz) / (wx * nx + wy * ny + wz * nz)
    x, y, z = distance * wx - hx, distance * wy - hy, distance * wz - cz
    inside = (abs(x * ux + y * uy + z * uz) <= half) & (abs(x * vx + y * vy + z * vz) <= half)
    return (distance > 0.0) & (distance < length) & inside


@kernel(nogil=True, fastmath={"contract"})
def hide_ends(mirrors: Floats, near: Floats, half: float, count: int, t: Floats) -> None:
    """Set the weight of the rays in `t` to 0 where one of the near mirrors, of half side `half`, blocks them."""
    for m in range(3):
        if near[m] > 0.0:
            cx, cy, cz = mirrors[m, 0, 0], mirrors[m, 0, 1], mirrors[m, 0, 2]
            nx, ny, nz = mirrors[m, 1, 0], mirrors[m, 1, 1], mirrors[m, 1, 2]
            ux, uy, uz = mirrors[m, 2, 0], mirrors[m, 2, 1], mirrors[m, 2, 2]
            vx, vy, vz = mirrors[m, 3, 0], mirrors[m, 3, 1], mirrors[m, 3, 2]
            for i in range(count):
                blocked = is_blocked(
                    cx, cy, cz, nx, ny, nz, ux, uy, uz, vx, vy, vz, half,
                    t[i + END_U], t[i + END_V], t[i + END_X], t[i + END_Y], t[i + END_Z], t[i + END_LENGTH],
                )  # fmt: skip
                t[i + END_WEIGHT] = 0.0 if blocked else t[i + END_WEIGHT]


@kernel(forceinline=True)
def linear_coordinates(image: Floats, axis: int, pupil: Floats) -> tuple[float, float, float, float, float, float]:
    """Coordinate along an axis of a mirror's image, from its centre: constant and slopes over the hole and over the pupil."""
    ex, ey, ez = image[axis, 0], image[axis, 1], image[axis, 2]
    own = image[0, 0] * ex + image[0, 1] * ey + image[0, 2] * ez
    centre = pupil[0, 0] * ex + pupil[0, 1] * ey + pupil[0, 2] * ez
    along_u = pupil[1, 0] * ex + pupil[1, 1] * ey + pupil[1, 2] * ez
    return -own, ex, ey, centre - own, along_u, pupil[2, 0] * ex + pupil[2, 1] * ey + pupil[2, 2] * ez


@kernel(nogil=True, fastmath={"contract"})
def fill_arrivals(
    scene: SceneArrays, half: float, sign: float, share: float, count: int, t: Floats, rays: Floats, column: int
) -> None:
    """Fill `rays` (7, n) from `column` on with the rays in `t`, on to the pupil's points of the given sign.

    The weight includes `share` and cos(light) cos(pupil) / r^2; it is 0 for light from behind, and for a ray that misses one of
    the unfolded mirrors, of half side `half`.
    """
    pupil = scene.pupil
    cx, cy, cz, ax, ay, az = pupil[0, 0], pupil[0, 1], pupil[0, 2], pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz, nx, ny, nz = pupil[2, 0], pupil[2, 1], pupil[2, 2], pupil[3, 0], pupil[3, 1], pupil[3, 2]
    for i in range(count):
        u, v = sign * t[i + PUPIL_U], sign * t[i + PUPIL_V]
        lx = cx + u * ax + v * bx - t[i + END_U]
        ly = cy + u * ay + v * by - t[i + END_V]
        lz = cz + u * az + v * bz
        shrink = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
        x, y, z = lx * shrink, ly * shrink, lz * shrink
        gain = (z if z > 0.0 else 0.0) * (x * nx + y * ny + z * nz) * shrink * shrink
        t[i + RAY_WEIGHT], t[i + RAY_X], t[i + RAY_Y], t[i + RAY_Z] = share * t[i + END_WEIGHT] * gain, x, y, z
    for m in range(3):
        if scene.missed[m] > 0.0:
            # `image_coordinates` of the point on the sample are linear in (u, v), and so are those of the point of the pupil.
            hn, hnu, hnv, gn, gnu, gnv = linear_coordinates(scene.images[m], 1, pupil)
            hu, huu, huv, gu, guu, guv = linear_coordinates(scene.images[m], 2, pupil)
            hv, hvu, hvv, gv, gvu, gvv = linear_coordinates(scene.images[m], 3, pupil)
            for i in range(count):
                x, y, u, v = t[i + END_U], t[i + END_V], sign * t[i + PUPIL_U], sign * t[i + PUPIL_V]
                near = hn + hnu * x + hnv * y, hu + huu * x + huv * y, hv + hvu * x + hvv * y
                far = gn + gnu * u + gnv * v, gu + guu * u + guv * v, gv + gvu * u + gvv * v
                t[i + RAY_WEIGHT] = t[i + RAY_WEIGHT] if reaches_over(near, far, half) else 0.0
    for row in range(4):
        for i in range(count):
            rays[row, column + i] = t[i + RAY_WEIGHT + row * TILE]
    for row in range(3):
        for i in range(count):
            rays[4 + row, column + i] = t[i + END_X + row * TILE]
