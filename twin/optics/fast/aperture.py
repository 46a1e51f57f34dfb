"""Moments of the rays that a detector's aperture accepts from the illuminated hole.

A detector counts a ray that crosses its disc within its acceptance cone. The moments up to the second order, over all rays
between hole and disc that it counts, with equal weights, give their total, the mean and the spread of their origin on the
sample, and the correlation of origin and direction (optics.md, section 5, without its random rays). The moments change
smoothly with the detector's position, and are exact up to the quadrature: four nodes over the cone (exact to the third
degree), Gauss-Legendre over one side of the hole, closed form over the other side. That holds for cones narrower than the
disc.

A cone as wide as the disc, or wider, is treated the other way round (`fill_wide_apertures`). From a point of the hole a
detector is a disc, and its acceptance cone is another disc in the same plane: the point contributes their intersection, whose
moments are known in closed form. The hole takes Gauss-Legendre nodes. A cone that contains the whole disc leaves nothing to
approximate; for a narrow one the few nodes of the hole are too far apart, and `fill_apertures` integrates over the slopes
instead. See docs/decisions/0009.
"""

import math
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.bundle import CLOSER
from goniotwin.twin.optics.fast.clipped_pupil import clip_terms, clip_value
from goniotwin.twin.optics.fast.detector_block import (
    AWAY,
    CLIPPED,
    HOLE_U,
    HOLE_V,
    LEVEL,
    ONE,
    PUPIL_A,
    PUPIL_B,
    SLOPE_P,
    SLOPE_Q,
    VIEW,
    Block,
    X,
    Y,
    Z,
    whole_lanes,
)
from goniotwin.twin.optics.geometry.scene import detector_frame
from goniotwin.twin.optics.illumination.slit_image import ALONG_U, ALONG_V, Lines, chord_lines, cut_chord, is_cut
from goniotwin.twin.optics.kernel import kernel

CHORD_PLACE = math.sqrt(0.6)
"""Outer place of three Gauss-Legendre nodes."""
WIDE = 0.7
"""Ratio of the cone's radius at the disc to the disc's radius: from here on `fill_wide_apertures` is the better one (compared
with 400 nodes).
"""


def cone_nodes(rings: int = 1) -> Floats:
    """Points on the unit disc and their weights (n, 3): four nodes, or with more rings a product rule of higher degree."""
    if rings == 1:
        side = math.sqrt(0.5)
        return np.array([[side * math.cos(a), side * math.sin(a), 0.25] for a in np.pi / 4 + np.pi / 2 * np.arange(4)])
    nodes, weights = np.polynomial.legendre.leggauss(rings)
    spokes = 4 * rings
    angles = (np.arange(spokes) + 0.5) * 2.0 * np.pi / spokes
    radii, shares = np.sqrt(0.5 * (nodes + 1.0)), 0.5 * weights / spokes
    rows = [(r * math.cos(a), r * math.sin(a), share) for r, share in zip(radii, shares, strict=True) for a in angles]
    return np.array(rows)


def side_nodes(count: int = 3) -> Floats:
    """Points within -1..1 and their weights (n, 2): Gauss-Legendre, stretched towards the ends to suit a chord of the disc.

    Where the disc limits the hole the chord ends as a square root; the map t (3 - t^2) / 2 makes it smooth.
    """
    t, weights = np.polynomial.legendre.leggauss(count)
    return np.stack([0.5 * t * (3.0 - t * t), 0.75 * (1.0 - t * t) * weights], axis=1)


def hole_nodes(count: int) -> Floats:
    """Points within -1..1 and their weights (n, 2), which sum to 2."""
    return np.stack(np.polynomial.legendre.leggauss(count), axis=1)


@kernel(nogil=True)
def place_detectors(block: Block, centres: Floats, views: Floats) -> None:
    """Place n detectors, at most LANES, at `centres` (n, 3) with viewing directions `views` (n, 3), and fill their axes."""
    last = views.shape[0] - 1
    for k in range(whole_lanes(last + 1)):
        i = min(k, last)
        x, y, z = centres[i, 0], centres[i, 1], centres[i, 2]
        dx, dy, dz = views[i, 0], views[i, 1], views[i, 2]
        ax, ay, az, lx, ly = detector_frame(dx, dy, dz)
        block.position[X, k], block.position[Y, k], block.position[Z, k] = x, y, z
        block.axes[AWAY, X, k], block.axes[AWAY, Y, k], block.axes[AWAY, Z, k] = ax, ay, az
        block.axes[LEVEL, X, k], block.axes[LEVEL, Y, k], block.axes[LEVEL, Z, k] = lx, ly, 0.0
        block.axes[VIEW, X, k], block.axes[VIEW, Y, k], block.axes[VIEW, Z, k] = dx, dy, dz
        block.centre[AWAY, k], block.centre[LEVEL, k] = x * ax + y * ay + z * az, x * lx + y * ly
        block.centre[VIEW, k] = x * dx + y * dy + z * dz


@kernel(nogil=True)
def clear(moments: Floats, last: int, count: int) -> None:
    """Set moments up to the number `last` to 0."""
    for i in range(last + 1):
        for j in range(i, last + 1):
            for k in range(count):
                moments[i, j, k] = 0.0


@kernel(nogil=True, fastmath={"contract"})
def fill_apertures(block: Block, count: int, cone: Floats, side: Floats, sizes: Floats, chords: Floats, clip: bool) -> None:
    """Fill the moments of the detectors in `block`, the first in mm^2, from nodes over the slopes.

    `sizes`: the disc's radius, the hole's half side, mm, and the sine of half the field. See `cone_nodes`, `side_nodes`.
    `chords` (2, 10, 2) are those of the lit part of the hole, see `SlitImage`. With `clip` mirrors leave of the pupil what
    `fill_clip` has found.
    """
    half, lines, cut = sizes[1], chord_lines(chords, ALONG_U), is_cut(chords)
    first, last, number = chords[ALONG_U, 0, 0], chords[ALONG_U, 0, 1], PUPIL_B if clip else HOLE_V
    clear(block.moments, SLOPE_Q, count)
    for c in range(cone.shape[0]):
        away, level = sizes[2] * cone[c, 0], sizes[2] * cone[c, 1]
        along = math.sqrt(1.0 - away * away - level * level)
        p, q = away / along, level / along
        find_strip(block, count, p, q, cone[c, 2], sizes[0], first, last)
        clear(block.sums, number, count)
        for node in range(side.shape[0]):
            if clip:
                add_clipped_chord(block, count, side[node, 0], side[node, 1], half, lines, cut)
            else:
                add_chord(block, count, side[node, 0], side[node, 1], half, lines, cut)
        add_strip(block, count, p, q, number)
    if not clip:
        fill_whole_pupil(block, count)


@kernel(nogil=True, fastmath={"contract"})
def find_strip(block: Block, count: int, p: float, q: float, share: float, radius: float, first: float, last: float) -> None:
    """Find the strip of the hole from which rays of the slopes p and q cross the disc, within `first` and `last` along v.

    A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
    """
    axes = block.axes
    for k in range(count):
        dx, dy, dz, ahead = axes[VIEW, X, k], axes[VIEW, Y, k], axes[VIEW, Z, k], block.centre[VIEW, k]
        a0, au, av = ahead * p - block.centre[AWAY, k], axes[AWAY, X, k] - p * dx, axes[AWAY, Y, k] - p * dy
        b0, bu, bv = ahead * q - block.centre[LEVEL, k], axes[LEVEL, X, k] - q * dx, axes[LEVEL, Y, k] - q * dy
        square = au * au + bu * bu
        area = au * bv - av * bu
        inverse, one = 1.0 / square, 1.0 / area
        middle, reach = (bu * a0 - au * b0) * one, radius * math.sqrt(square) * abs(one)
        low, high = middle - reach, middle + reach
        # Plain comparisons: Python's max and min prevent vectorisation of the loop.
        low, high = (low if low > first else first), (high if high < last else last)
        # NaN (a detector in the sample's plane) and rays from the other side of the sample do not count.
        seen = (high > low) & ((dz + p * axes[AWAY, Z, k]) * dz > 0.0)
        low, high = (low if seen else 0.0), (high if seen else 0.0)
        block.foot[0, k], block.foot[1, k] = -(a0 * au + b0 * bu) * inverse, -(av * au + bv * bu) * inverse
        block.beside[0, k], block.beside[1, k] = (a0 * bu - b0 * au) * inverse, -area * inverse
        block.middle[k], block.half[k] = 0.5 * (high + low), 0.5 * (high - low)
        block.reach_square[k], block.share[k] = radius * radius * inverse, share * abs(area) * (high - low)


@kernel(forceinline=True)
def chord(block: Block, k: int, place: float, half: float, lines: Lines, cut: bool) -> tuple[float, float, float]:
    """Chord at `place` of a strip, from -1 to 1, within the hole of half side `half` and its lit part: v, middle, length."""
    v = block.middle[k] + block.half[k] * place
    foot, beside = block.foot[0, k] + block.foot[1, k] * v, block.beside[0, k] + block.beside[1, k] * v
    inside = block.reach_square[k] - beside * beside
    reach = math.sqrt(inside if inside > 0.0 else 0.0)
    left, right = foot - reach, foot + reach
    left, right = (left if left > -half else -half), (right if right < half else half)
    if cut:
        left, right = cut_chord(lines, v, left, right)
    return v, 0.5 * (right + left), right - left if right > left else 0.0


@kernel(nogil=True, fastmath={"contract"})
def add_chord(block: Block, count: int, place: float, weight: float, half: float, lines: Lines, cut: bool) -> None:
    """Add a chord of each strip to the sums over it, in closed form."""
    sums = block.sums
    for k in range(count):
        v, u, width = chord(block, k, place, half, lines, cut)
        part = weight * width
        sums[ONE, ONE, k] += part
        sums[ONE, HOLE_U, k] += part * u
        sums[ONE, HOLE_V, k] += part * v
        sums[HOLE_U, HOLE_U, k] += part * (u * u + width * width * (1.0 / 12.0))
        sums[HOLE_U, HOLE_V, k] += part * u * v
        sums[HOLE_V, HOLE_V, k] += part * v * v


@kernel(nogil=True, fastmath={"contract"})
def add_clipped_chord(block: Block, count: int, place: float, weight: float, half: float, lines: Lines, cut: bool) -> None:
    """Add a chord of each strip to the sums over it, three points of it with what is left of the pupil there."""
    sums, of_pupil, points, scale = block.sums, block.clip_moments, block.chord_point, 1.0 / half
    for node in range(3):
        beside = 0.0 if node == 0 else CHORD_PLACE if node == 1 else -CHORD_PLACE
        share = 2.0 * weight * (4.0 / 9.0 if node == 0 else 5.0 / 18.0)
        for k in range(count):
            v, middle, width = chord(block, k, place, half, lines, cut)
            points[0, k], points[1, k], points[2, k] = middle + beside * (0.5 * width), v, share * (0.5 * width)
        for m in range(CLIPPED):
            terms = clip_terms(block.clip, m)
            for k in range(count):
                of_pupil[m, k] = points[2, k] * clip_value(terms, points[0, k] * scale, points[1, k] * scale)
        for k in range(count):
            u, v, part, a, b = points[0, k], points[1, k], of_pupil[0, k], of_pupil[1, k], of_pupil[2, k]
            sums[ONE, ONE, k] += part
            sums[ONE, HOLE_U, k] += part * u
            sums[ONE, HOLE_V, k] += part * v
            sums[ONE, PUPIL_A, k] += a
            sums[ONE, PUPIL_B, k] += b
            sums[HOLE_U, HOLE_U, k] += part * u * u
            sums[HOLE_U, HOLE_V, k] += part * u * v
            sums[HOLE_U, PUPIL_A, k] += a * u
            sums[HOLE_U, PUPIL_B, k] += b * u
            sums[HOLE_V, HOLE_V, k] += part * v * v
            sums[HOLE_V, PUPIL_A, k] += a * v
            sums[HOLE_V, PUPIL_B, k] += b * v
            sums[PUPIL_A, PUPIL_A, k] += of_pupil[3, k]
            sums[PUPIL_A, PUPIL_B, k] += of_pupil[4, k]
            sums[PUPIL_B, PUPIL_B, k] += of_pupil[5, k]


@kernel(nogil=True, fastmath={"contract"})
def add_strip(block: Block, count: int, p: float, q: float, last: int) -> None:
    """Add the sums over the strip, up to the number `last`, to the moments; all its rays have the slopes p and q."""
    moments, sums = block.moments, block.sums
    for i in range(last + 1):
        for j in range(i, last + 1):
            for k in range(count):
                moments[i, j, k] += sums[i, j, k] * block.share[k]
        for k in range(count):
            first = sums[ONE, i, k] * block.share[k]
            moments[i, SLOPE_P, k] += first * p
            moments[i, SLOPE_Q, k] += first * q
    for k in range(count):
        total = sums[ONE, ONE, k] * block.share[k]
        moments[SLOPE_P, SLOPE_P, k] += total * p * p
        moments[SLOPE_P, SLOPE_Q, k] += total * p * q
        moments[SLOPE_Q, SLOPE_Q, k] += total * q * q


@kernel()
def fill_whole_pupil(block: Block, count: int) -> None:
    """Fill the moments of the pupil's point where the light comes from all of it: those of a disc."""
    for k in range(count):
        block.moments[PUPIL_A, PUPIL_A, k] = block.moments[PUPIL_B, PUPIL_B, k] = 0.25 * block.moments[ONE, ONE, k]


@kernel(forceinline=True)
def disc_segment(radius: float, cut: float) -> tuple[float, float, float, float]:
    """Area of the part x > cut of a disc about the origin, and the integrals of x, x x and y y over it."""
    root = math.sqrt(max(radius * radius - cut * cut, 0.0))
    area = radius * radius * math.atan2(root, cut) - cut * root
    cube = root * root * root
    quarter = 0.25 * radius * radius * area
    return area, 2.0 / 3.0 * cube, quarter + 0.5 * cut * cube, quarter - cut * cube / 6.0


class DiscIntegrals(NamedTuple):
    """Integrals of 1, x, y, x x, x y and y y over a part of a disc."""

    area: float
    x: float
    y: float
    xx: float
    xy: float
    yy: float


@kernel()
def common_disc(radius: float, x: float, y: float, other: float) -> DiscIntegrals:
    """Intersection of a disc about the origin and a disc of radius `other` about (x, y)."""
    apart = math.sqrt(x * x + y * y)
    if apart >= radius + other:
        return DiscIntegrals(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    if apart <= other - radius:
        area = math.pi * radius * radius
        own = 0.25 * radius * radius * area
        return DiscIntegrals(area, 0.0, 0.0, own, 0.0, own)
    if apart <= radius - other:
        area = math.pi * other * other
        own = 0.25 * other * other * area
        return DiscIntegrals(area, area * x, area * y, own + area * x * x, area * x * y, own + area * y * y)
    cut = (apart * apart + radius * radius - other * other) / (2.0 * apart)
    a1, s1, xx1, yy1 = disc_segment(radius, cut)
    a2, s2, xx2, yy2 = disc_segment(other, apart - cut)  # relative to its own centre, opposite direction
    area, first = a1 + a2, s1 + a2 * apart - s2
    along, across = xx1 + xx2 - 2.0 * apart * s2 + apart * apart * a2, yy1 + yy2
    c, s = x / apart, y / apart
    mixed = (along - across) * c * s
    return DiscIntegrals(
        area,
        first * c,
        first * s,
        along * c * c + across * s * s,
        mixed,
        along * s * s + across * c * c,
    )


@kernel(nogil=True)
def fill_wide_apertures(block: Block, count: int, hole: Floats, sizes: Floats, chords: Floats) -> None:
    """Fill the moments of the detectors in `block` as `fill_apertures` does; `hole` are the nodes of a side, see `hole_nodes`.

    The cosines of a ray are taken to second order in its slopes, and the part of the disc visible from a node is taken as
    symmetrical in them: for cones of some degrees both are accurate to 1e-5.
    """
    clear(block.moments, SLOPE_Q, count)
    lines, half = chord_lines(chords, ALONG_V), sizes[1]
    for k in range(count):
        low_u, high_u, low_v, high_v = visible_ellipse(block, k, sizes)
        first_u, last_u = max(chords[ALONG_V, 0, 0], low_u), min(chords[ALONG_V, 0, 1], high_u)
        low_v, high_v = max(-half, low_v), min(half, high_v)
        if not (last_u > first_u and high_v > low_v):
            continue
        for i in range(hole.shape[0]):
            u = 0.5 * (first_u + last_u + (last_u - first_u) * hole[i, 0])
            first_v, last_v = cut_chord(lines, u, low_v, high_v)
            if not last_v > first_v:
                continue
            part = 0.25 * (last_u - first_u) * (last_v - first_v) / (math.pi * sizes[2] * sizes[2])
            for j in range(hole.shape[0]):
                v = 0.5 * (first_v + last_v + (last_v - first_v) * hole[j, 0])
                add_point(block, k, sizes, u, v, part * hole[i, 1] * hole[j, 1])
    fill_whole_pupil(block, count)


@kernel()
def visible_ellipse(block: Block, k: int, sizes: Floats) -> tuple[float, float, float, float]:
    """Ends along u and along v of the part of the sample's plane that detector k sees.

    It is an ellipse about the axis' point on the sample, stretched away from the normal.
    """
    axes, centre, sine = block.axes, block.centre, sizes[2]
    dz, x, y = axes[VIEW, Z, k], axes[LEVEL, X, k], axes[LEVEL, Y, k]
    reach = sizes[0] + CLOSER * centre[VIEW, k] * (sine / math.sqrt(1.0 - sine * sine))
    long, foot1, foot2 = reach / abs(dz), centre[AWAY, k] / dz, centre[LEVEL, k]
    mid_u, wide_u = y * foot1 + x * foot2, math.sqrt((y * long) ** 2 + (x * reach) ** 2)
    mid_v, wide_v = y * foot2 - x * foot1, math.sqrt((x * long) ** 2 + (y * reach) ** 2)
    return mid_u - wide_u, mid_u + wide_u, mid_v - wide_v, mid_v + wide_v


@kernel()
def add_point(block: Block, k: int, sizes: Floats, u: float, v: float, part: float) -> None:
    """Add the rays from (u, v) of the hole to detector k to its moments: those within its disc and its cone."""
    axes, centre, sine = block.axes, block.centre, sizes[2]
    up_side = 1.0 if axes[VIEW, Z, k] > 0.0 else -1.0
    # The cosine on the sample of a ray of slopes (p, q) is about across + p tilt.
    across, tilt = up_side * axes[VIEW, Z, k], up_side * axes[AWAY, Z, k]
    away = centre[VIEW, k] - u * axes[VIEW, X, k] - v * axes[VIEW, Y, k]
    x = u * axes[AWAY, X, k] + v * axes[AWAY, Y, k] - centre[AWAY, k]
    y = u * axes[LEVEL, X, k] + v * axes[LEVEL, Y, k] - centre[LEVEL, k]
    common = common_disc(sizes[0], x, y, away * (sine / math.sqrt(1.0 - sine * sine)))
    area, sx, sy = common.area, common.x, common.y
    if not area > 0.0:
        return
    one = 1.0 / away
    p, q = (sx - x * area) * one, (sy - y * area) * one
    pp = (common.xx - 2.0 * x * sx + x * x * area) * one * one
    pq = (common.xy - x * sy - y * sx + x * y * area) * one * one
    qq = (common.yy - 2.0 * y * sy + y * y * area) * one * one
    mean_p, mean_q = p / area, q / area
    cov = pq - p * mean_q
    ppp, ppq = mean_p * (3.0 * pp - 2.0 * p * mean_p), mean_q * pp + 2.0 * mean_p * cov
    pqq, weight = mean_p * qq + 2.0 * mean_q * cov, part * one * one
    s = weight * (across * area + tilt * p - 2.0 * across * (pp + qq))
    if not s > 0.0:
        return
    first_p, first_q = weight * (across * p + tilt * pp), weight * (across * q + tilt * pq)
    moments, numbers = block.moments, (1.0, u, v)
    for i in range(3):
        for j in range(i, 3):
            moments[i, j, k] += numbers[i] * numbers[j] * s
        moments[i, SLOPE_P, k] += numbers[i] * first_p
        moments[i, SLOPE_Q, k] += numbers[i] * first_q
    moments[SLOPE_P, SLOPE_P, k] += weight * (across * pp + tilt * ppp)
    moments[SLOPE_P, SLOPE_Q, k] += weight * (across * pq + tilt * ppq)
    moments[SLOPE_Q, SLOPE_Q, k] += weight * (across * qq + tilt * pqq)
