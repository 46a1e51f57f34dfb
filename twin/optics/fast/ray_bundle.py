"""Bundle of rays: the same for every detector and every sample, so that errors of the quadrature cancel in ratios.

The rays of a detector are computed in tiles of LANES, in its block (twin.optics.fast.detector_block). See docs/decisions/0009.
"""

import math
from typing import Any

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.bundle import COSINE
from goniotwin.twin.optics.fast.detector_block import (
    AWAY,
    HOLE_U,
    HOLE_V,
    LEVEL,
    LIGHT,
    OBSERVER,
    PUPIL_A,
    PUPIL_B,
    SLOPE_P,
    SLOPE_Q,
    VIEW,
    WEIGHT,
    Block,
    X,
    Y,
    Z,
)
from goniotwin.twin.optics.geometry.scene import SceneArrays, image_coordinates, reaches_over
from goniotwin.twin.optics.illumination.slit_image import cut_ray_chord
from goniotwin.twin.optics.kernel import kernel


@kernel(forceinline=True, fastmath={"contract"})
def map_to_disc(
    e1x: float,
    e1y: float,
    e2x: float,
    e2y: float,
    dx: float,
    dy: float,
    beside1: float,
    beside2: float,
    ahead: float,
    p: float,
    q: float,
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Map of the hole to a detector's disc along the slopes p and q, for a detector's axes: (a0, au, av) and (b0, bu, bv).

    A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
    """
    return (
        (ahead * p - beside1, e1x - p * dx, e1y - p * dy),
        (ahead * q - beside2, e2x - q * dx, e2y - q * dy),
    )


@kernel(nogil=True, fastmath={"contract"})
def fill_ends(
    block: Block,
    k: int,
    bundle: Floats,
    first: int,
    count: int,
    sign: float,
    sizes: Floats,
    first_v: float,
    last_v: float,
    edges: Floats,
    other: float,
) -> None:
    """Fill the ends at detector k of `count` rays of a bundle from number `first` on, of the given sign, a lane for each.

    A ray is from the part of the hole that the disc of the detector covers along it: weight (0 if disc and hole do not meet),
    point on the sample, direction towards the detector, length.

    No ray is dropped: v is set within the range where disc and hole can meet, then u on their common chord, and the weight
    includes their share of the hole. So the result changes smoothly with the detector's direction. This is needed because
    etalon and sample are measured at slightly different poses. Likewise v is within `first_v` and `last_v`, and u within the
    `edges` (n, 3, 3) of the slit's image, if there are any (`SlitImage`), for the ray's point of the pupil, of sign `other`.
    Directions are uniform over the cone's projection on the disc, so the weight includes the other cosines.
    """
    tile, low, high = block.tile, block.low, block.high
    for row in range(7):
        for i in range(count):
            tile[row, i] = bundle[row, first + i]
    fill_chords(block, k, count, sign, sizes, first_v, last_v)
    for edge in range(edges.shape[0]):
        for i in range(count):
            a, b = other * tile[PUPIL_A, i], other * tile[PUPIL_B, i]
            low[i], high[i] = cut_ray_chord(edges, edge, a, b, block.point[HOLE_V, i], low[i], high[i])
    dx, dy, ahead = block.axes[VIEW, X, k], block.axes[VIEW, Y, k], block.centre[VIEW, k]
    for i in range(count):
        p, q, along, v = sign * tile[SLOPE_P, i], sign * tile[SLOPE_Q, i], tile[COSINE, i], block.point[HOLE_V, i]
        share_u = high[i] - low[i]
        u = 0.5 * (low[i] + high[i] + share_u * (sign * tile[HOLE_U, i]))
        counts = (share_u > 0.0) & (block.end_weight[i] > 0.0)
        u, v = (u if counts else 0.0), (v if counts else 0.0)
        block.end_weight[i] = block.end_weight[i] * share_u if counts else 0.0
        block.point[HOLE_U, i], block.point[HOLE_V, i] = u, v
        # The direction's component along the axis is 1 / sqrt(1 + p^2 + q^2), so this is the length without a division.
        block.length[i] = (ahead - u * dx - v * dy) * along * (1.0 + p * p + q * q)


@kernel(nogil=True, fastmath={"contract"})
def fill_chords(block: Block, k: int, count: int, sign: float, sizes: Floats, first_v: float, last_v: float) -> None:
    """Fill the chord of the hole, along u, from which each ray meets the disc of detector k; its weight and its direction."""
    radius, half, spot = sizes[0], sizes[1], 0.25 / (sizes[1] * sizes[1])
    axes, tile, ray = block.axes, block.tile, block.ray
    e1x, e1y, e1z, e2x, e2y = axes[AWAY, X, k], axes[AWAY, Y, k], axes[AWAY, Z, k], axes[LEVEL, X, k], axes[LEVEL, Y, k]
    dx, dy, dz = axes[VIEW, X, k], axes[VIEW, Y, k], axes[VIEW, Z, k]
    beside1, beside2, ahead = block.centre[AWAY, k], block.centre[LEVEL, k], block.centre[VIEW, k]
    for i in range(count):
        p, q, along = sign * tile[SLOPE_P, i], sign * tile[SLOPE_Q, i], tile[COSINE, i]
        (a0, au, av), (b0, bu, bv) = map_to_disc(e1x, e1y, e2x, e2y, dx, dy, beside1, beside2, ahead, p, q)
        square = au * au + bu * bu
        area = au * bv - av * bu
        whole, part = 1.0 / area, 1.0 / square  # few divisions and roots: they are half of the time
        middle, reach = (bu * a0 - au * b0) * whole, radius * math.sqrt(square) * abs(whole)
        # Plain comparisons: Python's max and min prevent vectorisation of the loop.
        low, high = middle - reach, middle + reach
        low, high = (low if low > first_v else first_v), (high if high < last_v else last_v)
        share_v = high - low
        v = 0.5 * (low + high + share_v * (sign * tile[HOLE_V, i]))
        a1, b1 = a0 + av * v, b0 + bv * v
        beside = a1 * bu - b1 * au
        inside = radius * radius * square - beside * beside
        middle, reach = -(a1 * au + b1 * bu) * part, math.sqrt(inside if inside > 0.0 else 0.0) * part
        low, high = middle - reach, middle + reach
        wz = along * (dz + p * e1z)
        # NaN (a detector in the sample's plane) and rays from the far side of the sample do not count.
        block.end_weight[i] = abs(area) * share_v * spot if (share_v > 0.0) & (wz * dz > 0.0) else 0.0
        block.low[i], block.high[i] = (low if low > -half else -half), (high if high < half else half)
        block.point[HOLE_V, i] = v
        ray[OBSERVER + X, i], ray[OBSERVER + Y, i] = along * (dx + p * e1x + q * e2x), along * (dy + p * e1y + q * e2y)
        ray[OBSERVER + Z, i] = wz


@kernel(forceinline=True, fastmath={"contract"})
def is_blocked(
    cx: float,
    cy: float,
    cz: float,
    nx: float,
    ny: float,
    nz: float,
    ux: float,
    uy: float,
    uz: float,
    vx: float,
    vy: float,
    vz: float,
    half: float,
    u: float,
    v: float,
    wx: float,
    wy: float,
    wz: float,
    length: float,
) -> Any:
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
def hide_ends(block: Block, mirrors: Floats, near: Floats, half: float, count: int) -> None:
    """Set the weight of `count` rays in `block` to 0 where one of the near mirrors, of half side `half`, blocks them."""
    ray, point = block.ray, block.point
    for m in range(3):
        if near[m] > 0.0:
            cx, cy, cz = mirrors[m, 0, 0], mirrors[m, 0, 1], mirrors[m, 0, 2]
            nx, ny, nz = mirrors[m, 1, 0], mirrors[m, 1, 1], mirrors[m, 1, 2]
            ux, uy, uz = mirrors[m, 2, 0], mirrors[m, 2, 1], mirrors[m, 2, 2]
            vx, vy, vz = mirrors[m, 3, 0], mirrors[m, 3, 1], mirrors[m, 3, 2]
            for i in range(count):
                blocked = is_blocked(
                    cx,
                    cy,
                    cz,
                    nx,
                    ny,
                    nz,
                    ux,
                    uy,
                    uz,
                    vx,
                    vy,
                    vz,
                    half,
                    point[HOLE_U, i],
                    point[HOLE_V, i],
                    ray[OBSERVER + X, i],
                    ray[OBSERVER + Y, i],
                    ray[OBSERVER + Z, i],
                    block.length[i],
                )
                block.end_weight[i] = 0.0 if blocked else block.end_weight[i]


@kernel(nogil=True, fastmath={"contract"})
def fill_arrivals(block: Block, scene: SceneArrays, half: float, sign: float, share: float, count: int) -> None:
    """Continue `count` rays in `block` to the pupil's points of the given sign.

    The weight includes `share` and cos(light) cos(pupil) / r^2; it is 0 for light from behind, and for a ray that misses one of
    the unfolded mirrors, of half side `half`.
    """
    pupil, ray, point = scene.pupil, block.ray, block.point
    cx, cy, cz = pupil[0, 0], pupil[0, 1], pupil[0, 2]
    ax, ay, az = pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz = pupil[2, 0], pupil[2, 1], pupil[2, 2]
    nx, ny, nz = pupil[3, 0], pupil[3, 1], pupil[3, 2]
    for i in range(count):
        a, b = sign * block.tile[PUPIL_A, i], sign * block.tile[PUPIL_B, i]
        lx = cx + a * ax + b * bx - point[HOLE_U, i]
        ly = cy + a * ay + b * by - point[HOLE_V, i]
        lz = cz + a * az + b * bz
        shrink = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
        x, y, z = lx * shrink, ly * shrink, lz * shrink
        gain = (z if z > 0.0 else 0.0) * (x * nx + y * ny + z * nz) * shrink * shrink
        point[PUPIL_A, i], point[PUPIL_B, i] = a, b
        ray[WEIGHT, i] = share * block.end_weight[i] * gain
        ray[LIGHT + X, i], ray[LIGHT + Y, i], ray[LIGHT + Z, i] = x, y, z
    for m in range(3):
        if scene.missed[m] > 0.0:
            image = scene.images[m]
            for i in range(count):
                u, v, a, b = point[HOLE_U, i], point[HOLE_V, i], point[PUPIL_A, i], point[PUPIL_B, i]
                x, y, z = cx + a * ax + b * bx, cy + a * ay + b * by, cz + a * az + b * bz
                reaches = reaches_over(image_coordinates(image, u, v, 0.0), image_coordinates(image, x, y, z), half)
                ray[WEIGHT, i] = ray[WEIGHT, i] if reaches else 0.0
