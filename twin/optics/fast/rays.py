"""Rays of the fast estimator: seven nodes per detector, which represent all accepted rays of the beam.

The value of a lobe depends mainly on two offsets: the angle between observer and specular direction along the great circle
between them, and the angle across it. Both are linear in six numbers: point in the hole, slopes to the detector's axis, point
on the exit pupil. So their covariance follows from the aperture's moments, and a seven-node rule of the fifth degree (Stroud,
Secrest 1963) replaces the distribution. Its radius follows from the fourth moments, which for discs and squares are smaller
than a Gaussian's (optics.md, section 6). Each node is a real ray: the six numbers are the expected ones for its offsets.

The moments of a beam that a mirror clips are over what is left of the pupil (twin.optics.fast.clipped_pupil).

A detector that a mirror partly hides has a whole bundle of rays instead (twin.optics.fast.ray_bundle); one that is hidden
completely has none. See docs/decisions/0009.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.detector_block import (
    ACROSS,
    ALONG,
    AWAY,
    HOLE_U,
    HOLE_V,
    LEVEL,
    LIGHT,
    OBSERVER,
    ONE,
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
from goniotwin.twin.optics.kernel import kernel

TINY = 1e-30
FLATTEST = 1.8
"""Fourth moment over the square of the second of a uniform distribution: no sum of discs and sides has a smaller ratio."""
PLACES = np.array([[0.0, 0.0], *([math.cos(0.26 + k * math.pi / 3), math.sin(0.26 + k * math.pi / 3)] for k in range(6))])
"""Places of the nodes: in the middle, and on a hexagon.

It is turned out of the plane of incidence, so that no two nodes are mirror images in it.
"""


@kernel(nogil=True, fastmath={"contract"})
def fill_covariance(block: Block, count: int) -> None:
    """Fill the mean and the covariance of the six numbers of a ray from the moments."""
    moments, mean, covariance = block.moments, block.mean, block.covariance
    for k in range(count):
        mean[ONE, k] = 1.0 / moments[ONE, ONE, k] if moments[ONE, ONE, k] > 0.0 else 1.0
    for i in range(HOLE_U, SLOPE_Q + 1):
        for k in range(count):
            mean[i, k] = moments[ONE, i, k] * mean[ONE, k]
    for i in range(HOLE_U, SLOPE_Q + 1):
        for j in range(i, SLOPE_Q + 1):
            for k in range(count):
                covariance[i, j, k] = covariance[j, i, k] = moments[i, j, k] * mean[ONE, k] - mean[i, k] * mean[j, k]


@kernel(nogil=True, fastmath={"contract"})
def fill_slopes(block: Block, count: int, pupil: Floats) -> None:
    """Fill how the offsets along and across the great circle change with each of a ray's numbers, about the mean ray.

    `pupil` (4, 3) is the exit pupil's centre, its two axes as long as its radius, its normal, mm.
    """
    axes, mean, along, across = block.axes, block.mean, block.slope[ALONG], block.slope[ACROSS]
    cx, cy, cz = pupil[0, 0], pupil[0, 1], pupil[0, 2]
    ax, ay, az = pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz = pupil[2, 0], pupil[2, 1], pupil[2, 2]
    for k in range(count):
        e1x, e1y, e1z, e2x, e2y = axes[AWAY, X, k], axes[AWAY, Y, k], axes[AWAY, Z, k], axes[LEVEL, X, k], axes[LEVEL, Y, k]
        u, v, a, b = mean[HOLE_U, k], mean[HOLE_V, k], mean[PUPIL_A, k], mean[PUPIL_B, k]
        p, q = mean[SLOPE_P, k], mean[SLOPE_Q, k]
        # The mean ray: mirrored light r, observer o, and the great circle between them with its normal n.
        rx, ry, rz = u - cx - a * ax - b * bx, v - cy - a * ay - b * by, cz + a * az + b * bz
        inverse = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx * inverse, ry * inverse, rz * inverse
        up_side = 1.0 if axes[VIEW, Z, k] > 0.0 else -1.0  # transmitted light is mirrored in the sample's plane
        ox, oy = axes[VIEW, X, k] + p * e1x + q * e2x, axes[VIEW, Y, k] + p * e1y + q * e2y
        oz = up_side * (axes[VIEW, Z, k] + p * e1z)
        shrink = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz)
        ox, oy, oz = ox * shrink, oy * shrink, oz * shrink
        nx, ny, nz = ry * oz - rz * oy, rz * ox - rx * oz, rx * oy - ry * ox
        sine2 = nx * nx + ny * ny + nz * nz
        apart = sine2 > 1e-18
        grow = 1.0 / math.sqrt(sine2 if apart else 1.0)
        nx, ny, nz = (nx * grow if apart else e2x), (ny * grow if apart else e2y), (nz * grow if apart else 0.0)
        # Directions along the circle, at the observer (t) and at the mirrored light (s).
        tx, ty, tz = ny * oz - nz * oy, nz * ox - nx * oz, nx * oy - ny * ox
        sx, sy, sz = ny * rz - nz * ry, nz * rx - nx * rz, nx * ry - ny * rx
        along[HOLE_U, k], along[HOLE_V, k] = -sx * inverse, -sy * inverse
        along[PUPIL_A, k] = (sx * ax + sy * ay - sz * az) * inverse
        along[PUPIL_B, k] = (sx * bx + sy * by - sz * bz) * inverse
        along[SLOPE_P, k], along[SLOPE_Q, k] = tx * e1x + ty * e1y + up_side * tz * e1z, tx * e2x + ty * e2y
        across[HOLE_U, k], across[HOLE_V, k] = -nx * inverse, -ny * inverse
        across[PUPIL_A, k] = (nx * ax + ny * ay - nz * az) * inverse
        across[PUPIL_B, k] = (nx * bx + ny * by - nz * bz) * inverse
        across[SLOPE_P, k], across[SLOPE_Q, k] = nx * e1x + ny * e1y + up_side * nz * e1z, nx * e2x + ny * e2y


@kernel(forceinline=True, fastmath={"contract"})
def product(rows: Floats, others: Floats, k: int) -> float:
    """Sum over a ray's six numbers of the products of two rows each, in lane k."""
    total: float = (
        rows[HOLE_U, k] * others[HOLE_U, k]
        + rows[HOLE_V, k] * others[HOLE_V, k]
        + rows[PUPIL_A, k] * others[PUPIL_A, k]
        + rows[PUPIL_B, k] * others[PUPIL_B, k]
        + rows[SLOPE_P, k] * others[SLOPE_P, k]
        + rows[SLOPE_Q, k] * others[SLOPE_Q, k]
    )
    return total


@kernel(nogil=True, fastmath={"contract"})
def fill_shifts(block: Block, count: int) -> None:
    """Fill the covariance of each of a ray's numbers with either offset."""
    for offset in range(2):
        slope = block.slope[offset]
        for i in range(HOLE_U, SLOPE_Q + 1):
            row = block.covariance[i]
            for k in range(count):
                block.shift[offset, i, k] = product(row, slope, k)


@kernel(nogil=True, fastmath={"contract"})
def fill_factors(block: Block, count: int) -> None:
    """Fill the root of the offsets' covariance, inverted, and the rule's radius and weight from the fourth moments.

    Fourth cumulants, over the square of the variance: of a disc -1, of a side of the hole -6/5. A clipped disc is taken as a
    smaller one. Where the detector's disc limits the rays the slopes are correlated with the point in the hole; the rest is due
    to the disc.
    """
    covariance, along, across = block.covariance, block.slope[ALONG], block.slope[ACROSS]
    to_along, to_across = block.shift[ALONG], block.shift[ACROSS]
    for k in range(count):
        s11, s12, s22 = product(along, to_along, k), product(along, to_across, k), product(across, to_across, k)
        one11 = 1.0 / math.sqrt(s11 if s11 > TINY else 1.0)  # a detector that accepts no rays has neither spread nor weight
        t21 = s12 * one11
        rest, least = s22 - t21 * t21, 1e-12 * s22 + 1e-30
        block.inverse[ALONG, k], block.mixed[k] = one11, t21
        block.inverse[ACROSS, k] = 1.0 / math.sqrt(rest if rest > least else least)
        aa, ab, bb = covariance[PUPIL_A, PUPIL_A, k], covariance[PUPIL_A, PUPIL_B, k], covariance[PUPIL_B, PUPIL_B, k]
        a1, b1, a2, b2 = along[PUPIL_A, k], along[PUPIL_B, k], across[PUPIL_A, k], across[PUPIL_B, k]
        of_pupil1 = a1 * (aa * a1 + ab * b1) + b1 * (ab * a1 + bb * b1)
        of_pupil2 = a2 * (aa * a2 + ab * b2) + b2 * (ab * a2 + bb * b2)
        uu, vv = covariance[HOLE_U, HOLE_U, k], covariance[HOLE_V, HOLE_V, k]
        ru, rv = 1.0 / (uu if uu > TINY else TINY), 1.0 / (vv if vv > TINY else TINY)
        up, uq = covariance[HOLE_U, SLOPE_P, k], covariance[HOLE_U, SLOPE_Q, k]
        vp, vq = covariance[HOLE_V, SLOPE_P, k], covariance[HOLE_V, SLOPE_Q, k]
        slope2 = covariance[SLOPE_P, SLOPE_P, k] + covariance[SLOPE_Q, SLOPE_Q, k]
        slope2 -= (up * up + uq * uq) * ru + (vp * vp + vq * vq) * rv
        slope2 = slope2 if slope2 > 0.0 else 0.0
        u1, v1, u2, v2 = to_along[HOLE_U, k], to_along[HOLE_V, k], to_across[HOLE_U, k], to_across[HOLE_V, k]
        sides = (u1 * u1 * ru) ** 2 + (v1 * v1 * rv) ** 2 + (u2 * u2 * ru) ** 2 + (v2 * v2 * rv) ** 2
        discs = of_pupil1 * of_pupil1 + of_pupil2 * of_pupil2 + 0.5 * slope2 * slope2
        fourth = 3.0 - (discs + 1.2 * sides) / (s11 * s11 + s22 * s22)
        fourth = fourth if fourth > FLATTEST else FLATTEST
        block.radius[k], block.outer_weight[k] = math.sqrt(4.0 / 3.0 * fourth), 0.25 / fourth


@kernel(nogil=True, fastmath={"contract"})
def place_node(block: Block, count: int, pupil: Floats, away: float, level: float) -> None:
    """Fill one ray of each detector in `block`, with its point of the pupil's unit disc and of the hole, mm.

    `away` and `level` are the node's place on the unit circle, 0 and 0 for the one in the middle. Weights include the beam's
    solid angle, cos(light) cos(pupil) / r^2, 1/mm^2, and the aperture's mm^2. A detector that accepts no rays has weights of
    0.
    """
    cx, cy, cz = pupil[0, 0], pupil[0, 1], pupil[0, 2]
    ax, ay, az = pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz = pupil[2, 0], pupil[2, 1], pupil[2, 2]
    fx, fy, fz = pupil[3, 0], pupil[3, 1], pupil[3, 2]
    own, others = (1.0, -6.0) if away == 0.0 and level == 0.0 else (0.0, 1.0)
    axes, mean, to_along, to_across = block.axes, block.mean, block.shift[ALONG], block.shift[ACROSS]
    ray, point = block.ray, block.point
    for k in range(count):
        y2 = block.radius[k] * level * block.inverse[ACROSS, k]
        y1 = (block.radius[k] * away - block.mixed[k] * y2) * block.inverse[ALONG, k]
        u = mean[HOLE_U, k] + to_along[HOLE_U, k] * y1 + to_across[HOLE_U, k] * y2
        v = mean[HOLE_V, k] + to_along[HOLE_V, k] * y1 + to_across[HOLE_V, k] * y2
        a = mean[PUPIL_A, k] + to_along[PUPIL_A, k] * y1 + to_across[PUPIL_A, k] * y2
        b = mean[PUPIL_B, k] + to_along[PUPIL_B, k] * y1 + to_across[PUPIL_B, k] * y2
        p = mean[SLOPE_P, k] + to_along[SLOPE_P, k] * y1 + to_across[SLOPE_P, k] * y2
        q = mean[SLOPE_Q, k] + to_along[SLOPE_Q, k] * y1 + to_across[SLOPE_Q, k] * y2
        lx = cx + a * ax + b * bx - u
        ly = cy + a * ay + b * by - v
        lz = cz + a * az + b * bz
        inverse = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
        lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
        cosine = lx * fx + ly * fy + lz * fz
        wx = axes[VIEW, X, k] + p * axes[AWAY, X, k] + q * axes[LEVEL, X, k]
        wy = axes[VIEW, Y, k] + p * axes[AWAY, Y, k] + q * axes[LEVEL, Y, k]
        wz = axes[VIEW, Z, k] + p * axes[AWAY, Z, k]
        shrink = 1.0 / math.sqrt(wx * wx + wy * wy + wz * wz)
        part = own + others * block.outer_weight[k]
        ray[WEIGHT, k] = part * block.moments[ONE, ONE, k] * (lz if lz > 0.0 else 0.0) * cosine * inverse * inverse
        ray[LIGHT + X, k], ray[LIGHT + Y, k], ray[LIGHT + Z, k] = lx, ly, lz
        ray[OBSERVER + X, k], ray[OBSERVER + Y, k], ray[OBSERVER + Z, k] = wx * shrink, wy * shrink, wz * shrink
        point[HOLE_U, k], point[HOLE_V, k], point[PUPIL_A, k], point[PUPIL_B, k] = u, v, a, b
