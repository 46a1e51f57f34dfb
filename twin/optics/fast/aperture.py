"""Moments of the rays that a detector's aperture accepts from the illuminated hole.

A detector counts a ray that crosses its disc within its acceptance cone. The moments up to the second order, over all rays
between hole and disc that it counts, with equal weights, give their total, the mean and the spread of their origin on the
sample, and the correlation of origin and direction. The moments change smoothly with the detector's position, and are exact up
to the quadrature: four nodes over the cone (exact to the third degree), Gauss-Legendre over one side of the hole, closed form
over the other side. That holds for cones narrower than the disc.

A cone as wide as the disc, or wider, is treated the other way round (`fill_wide_apertures`). From a point of the hole a
detector is a disc, and its acceptance cone is another disc in the same plane: the point contributes their intersection, whose
moments are known in closed form. The hole takes Gauss-Legendre nodes. A cone that contains the whole disc leaves nothing to
approximate; for a narrow one the few nodes of the hole are too far apart, and `fill_apertures` integrates over the slopes
instead.

Everything is in the sample's frame: the hole's sides lie along x and y, its plane is z = 0.

Detectors are computed in blocks: one buffer with a row for each number of a detector. All rows have the same length, a constant
of the compiled code, so LLVM can prove that they do not overlap, and vectorises every loop over the detectors.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.bundle import CLOSER
from goniotwin.twin.optics.fast.clipped_pupil import CLIPPED, clip_terms, clip_value
from goniotwin.twin.optics.geometry.scene import detector_frame
from goniotwin.twin.optics.illumination.slit_image import ALONG_U, ALONG_V, chord_lines, cut_chord, is_cut
from goniotwin.twin.optics.kernel import kernel

BLOCK = 64
# Start of each row in the buffer. Detector: position (mm) and viewing direction, away from the sample.
PX, PY, PZ, DX, DY, DZ = (row * BLOCK for row in range(6))
# Its frame, e1 away from the normal and e2 level, and its position along e1, e2 and the viewing direction.
E1X, E1Y, E1Z, E2X, E2Y, BESIDE1, BESIDE2, AHEAD = (row * BLOCK for row in range(6, 14))
# Moments of the accepted rays: point in the hole (u, v), mm, and slopes to the detector's axis (p, q).
MOMENTS = 15
M, MU, MV, MP, MQ, MUU, MUV, MVV, MUP, MUQ, MVP, MVQ, MPP, MPQ, MQQ = (row * BLOCK for row in range(14, 29))
# For one slope, lengths along u: middle of a chord of the hole and distance from the disc's centre (and their slopes over v),
# square of the disc's radius; the strip of the hole within the disc; and the sums over it.
FOOT, FOOT_V, BESIDE, BESIDE_V, REACH2, MIDDLE, HALF, SHARE = (row * BLOCK for row in range(29, 37))
S, SU, SV, SUU, SUV, SVV = (row * BLOCK for row in range(39, 45))
# For the nodes: means, covariances of each number with the offsets along and across, square root of the covariance.
U0, V0, P0, Q0, GU1, GU2, GV1, GV2, GP1, GP2, GQ1, GQ2 = (row * BLOCK for row in range(29, 41))
GA1, GA2, GB1, GB2, ONE11, T21, ONE22, RADIUS = (row * BLOCK for row in range(41, 49))
# One ray: weight, direction of the light, direction of the observer.
RAY = 49 * BLOCK
WEIGHT, LX, LY, LZ, WX, WY, WZ = (row * BLOCK for row in range(49, 56))
# Its points of the pupil's unit disc and of the hole.
POINT = 56 * BLOCK
A, B, U, V = (row * BLOCK for row in range(56, 60))
# Moments with the point of the pupil's unit disc (a, b), and its mean.
MA, MB, MAA, MAB, MBB, MUA, MUB, MVA, MVB, MPA, MPB, MQA, MQB, MEAN_A, MEAN_B = (row * BLOCK for row in range(60, 75))
PUPIL_MOMENTS = 13
# Sums over the strip with the pupil's point, where mirrors clip the beam; a chord; one of its points, and the terms there.
CA, CAU, CAV, CB, CBU, CBV, CAA, CAB, CBB = (row * BLOCK for row in range(75, 84))
CLIP_V, MIDDLE_U, HALF_U, CLIP_U, CLIP_PART, TERM = (row * BLOCK for row in range(84, 90))
# For the nodes: weight of the outer ones.
PART = 95 * BLOCK
ROWS = 96
AT_ONCE = 3
"""Number of chords whose sums are added at once."""
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


@kernel(forceinline=True)
def whole_lanes(count: int) -> int:
    """Number of detectors up to which loops run: a multiple of 8, so that none of them is computed by itself.

    Rows have the room. What is computed beyond `count` is of no meaning.
    """
    return (count + 7) & -8


@kernel(nogil=True)
def fill_frames(w: Floats, count: int) -> None:
    """Fill the frames of detectors whose positions and viewing directions are in `w`."""
    for k in range(whole_lanes(count)):
        dx, dy, dz = w[k + DX], w[k + DY], w[k + DZ]
        e1x, e1y, e1z, e2x, e2y = detector_frame(dx, dy, dz)
        x, y, z = w[k + PX], w[k + PY], w[k + PZ]
        w[k + E1X], w[k + E1Y], w[k + E1Z], w[k + E2X], w[k + E2Y] = e1x, e1y, e1z, e2x, e2y
        w[k + BESIDE1], w[k + BESIDE2] = x * e1x + y * e1y + z * e1z, x * e2x + y * e2y
        w[k + AHEAD] = x * dx + y * dy + z * dz


@kernel(forceinline=True)
def _chord(w: Floats, k: int, place: float, half: float) -> tuple[float, float, float]:
    """v at `place` of the strip of the hole that detector k sees, and the ends along u of what it sees there."""
    v = w[k + MIDDLE] + w[k + HALF] * place
    foot, beside = w[k + FOOT] + w[k + FOOT_V] * v, w[k + BESIDE] + w[k + BESIDE_V] * v
    inside = w[k + REACH2] - beside * beside
    chord = math.sqrt(inside if inside > 0.0 else 0.0)
    left, right = foot - chord, foot + chord
    return v, (left if left > -half else -half), (right if right < half else half)


@kernel(forceinline=True)
def _chord_sums(
    v: float, left: float, right: float, weight: float
) -> tuple[float, float, float, float, float, float]:  # fmt: skip
    """What a chord of the hole adds to the sums over the strip."""
    width = right - left if right > left else 0.0
    u, part = 0.5 * (right + left), weight * width
    return part, part * u, part * v, part * (u * u + width * width * (1.0 / 12.0)), part * u * v, part * v * v


@kernel(nogil=True, fastmath={"contract"})
def fill_apertures(
    w: Floats, count: int, cone: Floats, side: Floats, sizes: Floats, chords: Floats, clip: Floats | None
) -> None:  # fmt: skip
    """Fill the moments of detectors whose frames are in `w`; the first is in mm^2.

    `sizes`: the disc's radius, the hole's half side, mm, and the sine of half the field. See `cone_nodes`, `side_nodes`.
    `chords` (2, 10, 2) are those of the lit part of the hole, see `SlitImage`. `clip` has what the mirrors leave of the
    pupil, see `fill_clip`; None, or no rows, for all of it.
    """
    radius, half, sine = sizes[0], sizes[1], sizes[2]
    first, last, lines = chords[ALONG_U, 0, 0], chords[ALONG_U, 0, 1], chord_lines(chords, ALONG_U)
    cut, count = is_cut(chords), whole_lanes(count)
    w[M : M + MOMENTS * BLOCK] = 0.0
    if clip is not None:
        w[MA : MA + PUPIL_MOMENTS * BLOCK] = 0.0
    for c in range(cone.shape[0]):
        away, level = sine * cone[c, 0], sine * cone[c, 1]
        along = math.sqrt(1.0 - away * away - level * level)
        p, q, share = away / along, level / along, cone[c, 2]
        for k in range(count):
            dx, dy, dz, ahead = w[k + DX], w[k + DY], w[k + DZ], w[k + AHEAD]
            # A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
            a0, au, av = ahead * p - w[k + BESIDE1], w[k + E1X] - p * dx, w[k + E1Y] - p * dy
            b0, bu, bv = ahead * q - w[k + BESIDE2], w[k + E2X] - q * dx, w[k + E2Y] - q * dy
            square = au * au + bu * bu
            area = au * bv - av * bu
            inverse, one = 1.0 / square, 1.0 / area
            middle, reach = (bu * a0 - au * b0) * one, radius * math.sqrt(square) * abs(one)
            low, high = middle - reach, middle + reach
            # Plain comparisons: Python's max and min prevent vectorisation of the loop.
            low, high = (low if low > first else first), (high if high < last else last)
            # NaN (a detector in the sample's plane) and rays from the other side of the sample do not count.
            seen = (high > low) & ((dz + p * w[k + E1Z]) * dz > 0.0)
            low, high = (low if seen else 0.0), (high if seen else 0.0)
            w[k + FOOT], w[k + FOOT_V] = -(a0 * au + b0 * bu) * inverse, -(av * au + bv * bu) * inverse
            w[k + BESIDE], w[k + BESIDE_V] = (a0 * bu - b0 * au) * inverse, -area * inverse
            w[k + MIDDLE], w[k + HALF] = 0.5 * (high + low), 0.5 * (high - low)
            w[k + REACH2], w[k + SHARE] = radius * radius * inverse, share * abs(area) * (high - low)
            w[k + S] = w[k + SU] = w[k + SV] = w[k + SUU] = w[k + SUV] = w[k + SVV] = 0.0
        if clip is not None:
            w[CA : CA + 9 * BLOCK] = 0.0
        # Two loops: four lines of the slit's image cost a seventh of the time, and most scenes have none.
        if cut or (clip is not None and clip.shape[0] > 0):
            for node in range(side.shape[0]):
                place, weight = side[node, 0], side[node, 1]
                if clip is not None and clip.shape[0] > 0:
                    for k in range(count):
                        v, left, right = _chord(w, k, place, half)
                        left, right = cut_chord(lines, v, left, right)
                        w[k + CLIP_V], w[k + MIDDLE_U] = v, 0.5 * (right + left)
                        w[k + HALF_U] = 0.5 * (right - left) if right > left else 0.0
                    _add_clipped(w, count, weight, 1.0 / half, clip)
                    continue
                for k in range(count):
                    v, left, right = _chord(w, k, place, half)
                    left, right = cut_chord(lines, v, left, right)
                    s, su, sv, suu, suv, svv = _chord_sums(v, left, right, weight)
                    w[k + S] += s
                    w[k + SU] += su
                    w[k + SV] += sv
                    w[k + SUU] += suu
                    w[k + SUV] += suv
                    w[k + SVV] += svv
        else:
            # Three chords at once: what is stored is a third, and storing takes longer than computing.
            for node in range(0, side.shape[0], AT_ONCE):
                place, weight = side[node, 0], side[node, 1]
                place1, weight1 = (side[node + 1, 0], side[node + 1, 1]) if node + 1 < side.shape[0] else (0.0, 0.0)
                place2, weight2 = (side[node + 2, 0], side[node + 2, 1]) if node + 2 < side.shape[0] else (0.0, 0.0)
                for k in range(count):
                    v, left, right = _chord(w, k, place, half)
                    s, su, sv, suu, suv, svv = _chord_sums(v, left, right, weight)
                    v, left, right = _chord(w, k, place1, half)
                    t, tu, tv, tuu, tuv, tvv = _chord_sums(v, left, right, weight1)
                    s, su, sv, suu, suv, svv = s + t, su + tu, sv + tv, suu + tuu, suv + tuv, svv + tvv
                    v, left, right = _chord(w, k, place2, half)
                    t, tu, tv, tuu, tuv, tvv = _chord_sums(v, left, right, weight2)
                    w[k + S] += s + t
                    w[k + SU] += su + tu
                    w[k + SV] += sv + tv
                    w[k + SUU] += suu + tuu
                    w[k + SUV] += suv + tuv
                    w[k + SVV] += svv + tvv
        for k in range(count):
            taken = w[k + SHARE]
            s, su, sv = w[k + S] * taken, w[k + SU] * taken, w[k + SV] * taken
            w[k + M] += s
            w[k + MU] += su
            w[k + MV] += sv
            w[k + MP] += s * p
            w[k + MQ] += s * q
            w[k + MUU] += w[k + SUU] * taken
            w[k + MUV] += w[k + SUV] * taken
            w[k + MVV] += w[k + SVV] * taken
            w[k + MUP] += su * p
            w[k + MUQ] += su * q
            w[k + MVP] += sv * p
            w[k + MVQ] += sv * q
            w[k + MPP] += s * p * p
            w[k + MPQ] += s * p * q
            w[k + MQQ] += s * q * q
        if clip is not None:
            for k in range(count):
                taken = w[k + SHARE]
                sa, sb = w[k + CA] * taken, w[k + CB] * taken
                w[k + MA] += sa
                w[k + MB] += sb
                w[k + MAA] += w[k + CAA] * taken
                w[k + MAB] += w[k + CAB] * taken
                w[k + MBB] += w[k + CBB] * taken
                w[k + MUA] += w[k + CAU] * taken
                w[k + MUB] += w[k + CBU] * taken
                w[k + MVA] += w[k + CAV] * taken
                w[k + MVB] += w[k + CBV] * taken
                w[k + MPA] += sa * p
                w[k + MPB] += sb * p
                w[k + MQA] += sa * q
                w[k + MQB] += sb * q
    if clip is None or clip.shape[0] == 0:
        fill_whole_pupil(w, count)


@kernel()
def fill_whole_pupil(w: Floats, count: int) -> None:
    """Fill the moments with the point of the pupil where the light comes from all of it."""
    w[MA : MA + PUPIL_MOMENTS * BLOCK] = 0.0
    for k in range(whole_lanes(count)):
        w[k + MAA] = w[k + MBB] = 0.25 * w[k + M]


@kernel(nogil=True, fastmath={"contract"})
def _add_clipped(w: Floats, count: int, weight: float, scale: float, clip: Floats) -> None:
    """Add chords of the hole to the sums over the strip, each point with what is left of the pupil there."""
    for node in range(3):
        place = 0.0 if node == 0 else CHORD_PLACE if node == 1 else -CHORD_PLACE
        share = 2.0 * weight * (4.0 / 9.0 if node == 0 else 5.0 / 18.0)
        for k in range(count):
            w[k + CLIP_U], w[k + CLIP_PART] = w[k + MIDDLE_U] + place * w[k + HALF_U], share * w[k + HALF_U]
        for m in range(CLIPPED):
            terms, row = clip_terms(clip, m), TERM + m * BLOCK
            for k in range(count):
                w[k + row] = w[k + CLIP_PART] * clip_value(terms, w[k + CLIP_U] * scale, w[k + CLIP_V] * scale)
        for k in range(count):
            u, v, part, a, b = w[k + CLIP_U], w[k + CLIP_V], w[k + TERM], w[k + TERM + BLOCK], w[k + TERM + 2 * BLOCK]
            w[k + S] += part
            w[k + SU] += part * u
            w[k + SV] += part * v
            w[k + SUU] += part * u * u
            w[k + SUV] += part * u * v
            w[k + SVV] += part * v * v
            w[k + CA] += a
            w[k + CAU] += a * u
            w[k + CAV] += a * v
            w[k + CB] += b
            w[k + CBU] += b * u
            w[k + CBV] += b * v
            w[k + CAA] += w[k + TERM + 3 * BLOCK]
            w[k + CAB] += w[k + TERM + 4 * BLOCK]
            w[k + CBB] += w[k + TERM + 5 * BLOCK]


def hole_nodes(count: int) -> Floats:
    """Points within -1..1 and their weights (n, 2), which sum to 2."""
    return np.stack(np.polynomial.legendre.leggauss(count), axis=1)


@kernel(forceinline=True)
def disc_segment(radius: float, cut: float) -> tuple[float, float, float, float]:
    """Area of the part x > cut of a disc about the origin, and the integrals of x, x x and y y over it."""
    root = math.sqrt(max(radius * radius - cut * cut, 0.0))
    area = radius * radius * math.atan2(root, cut) - cut * root
    cube = root * root * root
    quarter = 0.25 * radius * radius * area
    return area, 2.0 / 3.0 * cube, quarter + 0.5 * cut * cube, quarter - cut * cube / 6.0


@kernel()
def common_disc(radius: float, x: float, y: float, other: float) -> tuple[float, float, float, float, float, float]:
    """Intersection of a disc about the origin and a disc of radius `other` about (x, y).

    Returns its area, and the integrals of x, y, x x, x y and y y over it.
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
    a1, s1, xx1, yy1 = disc_segment(radius, cut)
    a2, s2, xx2, yy2 = disc_segment(other, apart - cut)  # relative to its own centre, opposite direction
    area, first = a1 + a2, s1 + a2 * apart - s2
    along, across = xx1 + xx2 - 2.0 * apart * s2 + apart * apart * a2, yy1 + yy2
    c, s = x / apart, y / apart
    mixed = (along - across) * c * s
    return area, first * c, first * s, along * c * c + across * s * s, mixed, along * s * s + across * c * c


@kernel(nogil=True)
def fill_wide_apertures(w: Floats, count: int, hole: Floats, sizes: Floats, chords: Floats) -> None:
    """Fill the moments of the detectors in `w` as `fill_apertures` does; `hole` are the nodes of a side, see `hole_nodes`.

    The cosines of a ray are taken to second order in its slopes, and the part of the disc visible from a node is taken as
    symmetrical in them: for cones of some degrees both are accurate to 1e-5.
    """
    w[M : M + MOMENTS * BLOCK] = 0.0
    for k in range(whole_lanes(count)):
        _fill_wide_aperture(w, k, hole, sizes, chords)
    fill_whole_pupil(w, count)


@kernel()
def _fill_wide_aperture(w: Floats, k: int, hole: Floats, sizes: Floats, chords: Floats) -> None:
    """Add up the moments of detector k."""
    radius, half, sine = sizes[0], sizes[1], sizes[2]
    tangent, seen_sr = sine / math.sqrt(1.0 - sine * sine), math.pi * sine * sine
    dx, dy, dz, ahead = w[k + DX], w[k + DY], w[k + DZ], w[k + AHEAD]
    e1x, e1y, e1z, e2x, e2y = w[k + E1X], w[k + E1Y], w[k + E1Z], w[k + E2X], w[k + E2Y]
    beside1, beside2 = w[k + BESIDE1], w[k + BESIDE2]
    up_side = 1.0 if dz > 0.0 else -1.0
    across, tilt = up_side * dz, up_side * e1z  # the cosine on the sample of a ray of slopes (p, q) is about across + p tilt
    # The visible part of the plane is an ellipse about the axis' point on the sample, stretched away from the normal.
    reach = radius + CLOSER * ahead * tangent
    long, foot1, foot2 = reach / across, beside1 / dz, beside2
    mid_u, wide_u = e2y * foot1 + e2x * foot2, math.sqrt((e2y * long) ** 2 + (e2x * reach) ** 2)
    mid_v, wide_v = e2y * foot2 - e2x * foot1, math.sqrt((e2x * long) ** 2 + (e2y * reach) ** 2)
    first_u, last_u = max(chords[ALONG_V, 0, 0], mid_u - wide_u), min(chords[ALONG_V, 0, 1], mid_u + wide_u)
    lines = chord_lines(chords, ALONG_V)
    lowest_v, highest_v = max(-half, mid_v - wide_v), min(half, mid_v + wide_v)
    if not (last_u > first_u and highest_v > lowest_v):
        return
    for i in range(hole.shape[0]):
        u = 0.5 * (first_u + last_u + (last_u - first_u) * hole[i, 0])
        first_v, last_v = cut_chord(lines, u, lowest_v, highest_v)
        if not last_v > first_v:
            continue
        part = 0.25 * (last_u - first_u) * (last_v - first_v) / seen_sr
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
