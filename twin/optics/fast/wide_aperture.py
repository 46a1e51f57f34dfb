"""What a detector's aperture takes where its acceptance cone is as wide as its disc, or wider: the moments of `aperture`.

From a point of the hole a detector is a disc, and its acceptance cone another one in the same plane: what the point gives is
what the two have in common, whose moments are known in closed form. Over the hole Gauss-Legendre nodes are taken. Where the
cone is so wide that it holds the whole disc, nothing is left to be approximated; where it is narrow the few nodes of the
hole are too far apart, and `aperture` goes through the slopes instead.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import CLOSER
from goniotwin.twin.optics.fast.detector_block import (  # fmt: skip
    AHEAD,
    BESIDE1,
    BESIDE2,
    BLOCK,
    DX,
    DY,
    DZ,
    E1X,
    E1Y,
    E1Z,
    E2X,
    E2Y,
    MOMENTS,
    MP,
    MPP,
    MPQ,
    MQ,
    MQQ,
    MU,
    MUP,
    MUQ,
    MUU,
    MUV,
    MV,
    MVP,
    MVQ,
    MVV,
    M,
)
from goniotwin.twin.optics.kernel import kernel

WIDE = 0.7
"""From here on, radius of the cone where the disc is over that of the disc, this is the better one (held against 400 nodes)."""


def hole_nodes(count: int) -> Floats:
    """Places within -1..1 and their weights (n, 2), which sum up to 2."""
    return np.stack(np.polynomial.legendre.leggauss(count), axis=1)


@kernel(forceinline=True)
def disc_beyond(radius: float, cut: float) -> tuple[float, float, float, float]:
    """Of the part x > cut of a disc round the origin: area, and the integrals of x, x x and y y."""
    root = math.sqrt(max(radius * radius - cut * cut, 0.0))
    area = radius * radius * math.atan2(root, cut) - cut * root
    cube = root * root * root
    quarter = 0.25 * radius * radius * area
    return area, 2.0 / 3.0 * cube, quarter + 0.5 * cut * cube, quarter - cut * cube / 6.0


@kernel()
def common_disc(radius: float, x: float, y: float, other: float) -> tuple[float, float, float, float, float, float]:
    """Of what a disc round the origin has in common with a disc of radius `other` round (x, y): area, and the integrals of
    x, y, x x, x y and y y.
    """
    apart = math.sqrt(x * x + y * y)
    if apart >= radius + other:
        return 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    if apart <= other - radius:
        area = math.pi * radius * radius
        own = 0.25 * radius * radius * area
        return area, 0.0, 0.0, own, 0.0, own
    if apart <= radius - other:
        area = math.pi * other * other
        own = 0.25 * other * other * area
        return area, area * x, area * y, own + area * x * x, area * x * y, own + area * y * y
    cut = (apart * apart + radius * radius - other * other) / (2.0 * apart)
    a1, s1, xx1, yy1 = disc_beyond(radius, cut)
    a2, s2, xx2, yy2 = disc_beyond(other, apart - cut)  # seen from its own centre, the other way round
    area, first = a1 + a2, s1 + a2 * apart - s2
    along, across = xx1 + xx2 - 2.0 * apart * s2 + apart * apart * a2, yy1 + yy2
    c, s = x / apart, y / apart
    mixed = (along - across) * c * s
    return area, first * c, first * s, along * c * c + across * s * s, mixed, along * s * s + across * c * c


@kernel(nogil=True)
def wide_apertures(w: Floats, count: int, hole: Floats, sizes: Floats) -> None:
    """Fills the moments of the detectors in `w` as `apertures` does; `hole` are the nodes of a side, see `hole_nodes`.

    The cosines of a ray are taken to second order in its slopes, and what a node sees of the disc as symmetrical in them:
    of cones of some degrees both are right to 1e-5.
    """
    w[M : M + MOMENTS * BLOCK] = 0.0
    for k in range(count):
        _one(w, k, hole, sizes)


@kernel()
def _one(w: Floats, k: int, hole: Floats, sizes: Floats) -> None:
    radius, half, sine = sizes[0], sizes[1], sizes[2]
    tangent, seen_sr = sine / math.sqrt(1.0 - sine * sine), math.pi * sine * sine
    dx, dy, dz, ahead = w[k + DX], w[k + DY], w[k + DZ], w[k + AHEAD]
    e1x, e1y, e1z, e2x, e2y = w[k + E1X], w[k + E1Y], w[k + E1Z], w[k + E2X], w[k + E2Y]
    beside1, beside2 = w[k + BESIDE1], w[k + BESIDE2]
    up_side = 1.0 if dz > 0.0 else -1.0
    across, tilt = up_side * dz, up_side * e1z  # the cosine on the sample of a ray of slopes (p, q) is about across + p tilt
    # What it can see at all is an ellipse about where its axis meets the sample, stretched away from the normal.
    reach = radius + CLOSER * ahead * tangent
    long, foot1, foot2 = reach / across, beside1 / dz, beside2
    mid_u, wide_u = e2y * foot1 + e2x * foot2, math.sqrt((e2y * long) ** 2 + (e2x * reach) ** 2)
    mid_v, wide_v = e2y * foot2 - e2x * foot1, math.sqrt((e2x * long) ** 2 + (e2y * reach) ** 2)
    first_u, last_u = max(-half, mid_u - wide_u), min(half, mid_u + wide_u)
    first_v, last_v = max(-half, mid_v - wide_v), min(half, mid_v + wide_v)
    if not (last_u > first_u and last_v > first_v):
        return
    part = 0.25 * (last_u - first_u) * (last_v - first_v) / seen_sr
    for i in range(hole.shape[0]):
        u = 0.5 * (first_u + last_u + (last_u - first_u) * hole[i, 0])
        for j in range(hole.shape[0]):
            v = 0.5 * (first_v + last_v + (last_v - first_v) * hole[j, 0])
            away = ahead - u * dx - v * dy
            x, y = u * e1x + v * e1y - beside1, u * e2x + v * e2y - beside2
            area, sx, sy, sxx, sxy, syy = common_disc(radius, x, y, away * tangent)
            if not area > 0.0:
                continue
            one = 1.0 / away
            p, q = (sx - x * area) * one, (sy - y * area) * one
            pp = (sxx - 2.0 * x * sx + x * x * area) * one * one
            pq = (sxy - x * sy - y * sx + x * y * area) * one * one
            qq = (syy - 2.0 * y * sy + y * y * area) * one * one
            mean_p, mean_q = p / area, q / area
            cov = pq - p * mean_q
            ppp, ppq, pqq = (
                mean_p * (3.0 * pp - 2.0 * p * mean_p),
                mean_q * pp + 2.0 * mean_p * cov,
                mean_p * qq + 2.0 * mean_q * cov,
            )
            weight = part * hole[i, 1] * hole[j, 1] * one * one
            s = weight * (across * area + tilt * p - 2.0 * across * (pp + qq))
            if not s > 0.0:
                continue
            w1, w2 = weight * (across * p + tilt * pp), weight * (across * q + tilt * pq)
            w[k + M] += s
            w[k + MU] += u * s
            w[k + MV] += v * s
            w[k + MP] += w1
            w[k + MQ] += w2
            w[k + MUU] += u * u * s
            w[k + MUV] += u * v * s
            w[k + MVV] += v * v * s
            w[k + MUP] += u * w1
            w[k + MUQ] += u * w2
            w[k + MVP] += v * w1
            w[k + MVQ] += v * w2
            w[k + MPP] += weight * (across * pp + tilt * ppp)
            w[k + MPQ] += weight * (across * pq + tilt * ppq)
            w[k + MQQ] += weight * (across * qq + tilt * pqq)
