"""Rays of the fast estimator: seven nodes per detector, which represent all accepted rays of the beam.

The value of a lobe depends mainly on two offsets: the angle between observer and specular direction along the great circle
between them, and the angle across it. Both are linear in six numbers: point in the hole, slopes to the detector's axis, point
on the exit pupil. So their covariance follows from the aperture's moments, and a seven-node rule of the fifth degree (Stroud,
Secrest 1963) replaces the distribution. Its radius follows from the fourth moments, which for discs and squares are smaller
than a Gaussian's. Each node is a real ray: the six numbers are the expected ones for its offsets.

The moments of a beam that a mirror clips are over what is left of the pupil (twin.optics.fast.clipped_pupil).

A detector that a mirror partly hides has a whole bundle of rays instead (twin.optics.fast.ray_bundle); one that is hidden
completely has none.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import (  # fmt: skip
    DX,
    DY,
    DZ,
    E1X,
    E1Y,
    E1Z,
    E2X,
    E2Y,
    GA1,
    GA2,
    GB1,
    GB2,
    GP1,
    GP2,
    GQ1,
    GQ2,
    GU1,
    GU2,
    GV1,
    GV2,
    LX,
    LY,
    LZ,
    MA,
    MAA,
    MAB,
    MB,
    MBB,
    MEAN_A,
    MEAN_B,
    MP,
    MPA,
    MPB,
    MPP,
    MPQ,
    MQ,
    MQA,
    MQB,
    MQQ,
    MU,
    MUA,
    MUB,
    MUP,
    MUQ,
    MUU,
    MUV,
    MV,
    MVA,
    MVB,
    MVP,
    MVQ,
    MVV,
    ONE11,
    ONE22,
    P0,
    PART,
    Q0,
    RADIUS,
    T21,
    U0,
    V0,
    WEIGHT,
    WX,
    WY,
    WZ,
    A,
    B,
    M,
    U,
    V,
    whole_lanes,
)
from goniotwin.twin.optics.kernel import kernel

NODES = 7
TINY = 1e-30
FLATTEST = 1.8
"""Fourth moment over the square of the second of a uniform distribution: no sum of discs and sides has a smaller ratio."""
PLACES = np.array([[0.0, 0.0], *([math.cos(0.26 + k * math.pi / 3), math.sin(0.26 + k * math.pi / 3)] for k in range(6))])
"""Places of the nodes: in the middle, and on a hexagon.

It is turned out of the plane of incidence, so that no two nodes are mirror images in it.
"""


@kernel(nogil=True, fastmath={"contract"})
def find_offsets(w: Floats, count: int, pupil: Floats) -> None:
    """Fill what `place_node` needs of the detectors in `w`, whose frames and moments are there.

    See twin.optics.fast.aperture. `pupil` (4, 3) is the exit pupil's centre, its two axes as long as its radius, its normal,
    mm.
    """
    cx, cy, cz, ax, ay, az = pupil[0, 0], pupil[0, 1], pupil[0, 2], pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz = pupil[2, 0], pupil[2, 1], pupil[2, 2]
    for k in range(whole_lanes(count)):
        dx, dy, dz = w[k + DX], w[k + DY], w[k + DZ]
        e1x, e1y, e1z, e2x, e2y = w[k + E1X], w[k + E1Y], w[k + E1Z], w[k + E2X], w[k + E2Y]
        taken = w[k + M]
        one = 1.0 / taken if taken > 0.0 else 1.0
        u0, v0, p0, q0 = w[k + MU] * one, w[k + MV] * one, w[k + MP] * one, w[k + MQ] * one
        uu, uv, vv = w[k + MUU] * one - u0 * u0, w[k + MUV] * one - u0 * v0, w[k + MVV] * one - v0 * v0
        up, uq = w[k + MUP] * one - u0 * p0, w[k + MUQ] * one - u0 * q0
        vp, vq = w[k + MVP] * one - v0 * p0, w[k + MVQ] * one - v0 * q0
        pp, pq, qq = w[k + MPP] * one - p0 * p0, w[k + MPQ] * one - p0 * q0, w[k + MQQ] * one - q0 * q0
        a0, b0 = w[k + MA] * one, w[k + MB] * one
        aa, ab, bb = w[k + MAA] * one - a0 * a0, w[k + MAB] * one - a0 * b0, w[k + MBB] * one - b0 * b0
        ua, ub = w[k + MUA] * one - u0 * a0, w[k + MUB] * one - u0 * b0
        va, vb = w[k + MVA] * one - v0 * a0, w[k + MVB] * one - v0 * b0
        pa, pb = w[k + MPA] * one - p0 * a0, w[k + MPB] * one - p0 * b0
        qa, qb = w[k + MQA] * one - q0 * a0, w[k + MQB] * one - q0 * b0
        # The mean ray: mirrored light r, observer o, and the great circle between them with its normal n.
        rx, ry, rz = u0 - cx - a0 * ax - b0 * bx, v0 - cy - a0 * ay - b0 * by, cz + a0 * az + b0 * bz
        inverse = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
        rx, ry, rz = rx * inverse, ry * inverse, rz * inverse
        up_side = 1.0 if dz > 0.0 else -1.0  # transmitted light is mirrored in the sample's plane
        ox, oy, oz = dx + p0 * e1x + q0 * e2x, dy + p0 * e1y + q0 * e2y, up_side * (dz + p0 * e1z)
        shrink = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz)
        ox, oy, oz = ox * shrink, oy * shrink, oz * shrink
        nx, ny, nz = ry * oz - rz * oy, rz * ox - rx * oz, rx * oy - ry * ox
        sine2 = nx * nx + ny * ny + nz * nz
        apart = sine2 > 1e-18
        grow = 1.0 / math.sqrt(sine2 if apart else 1.0)
        nx, ny, nz = (nx * grow if apart else e2x), (ny * grow if apart else e2y), (nz * grow if apart else 0.0)
        tx, ty, tz = ny * oz - nz * oy, nz * ox - nx * oz, nx * oy - ny * ox
        sx, sy, sz = ny * rz - nz * ry, nz * rx - nx * rz, nx * ry - ny * rx
        # Offsets along (j) and across (k) the circle, by hole (u, v), pupil (a, b) and slopes (p, q).
        ju, jv = -sx * inverse, -sy * inverse
        ja = (sx * ax + sy * ay - sz * az) * inverse
        jb = (sx * bx + sy * by - sz * bz) * inverse
        ku, kv = -nx * inverse, -ny * inverse
        ka = (nx * ax + ny * ay - nz * az) * inverse
        kb = (nx * bx + ny * by - nz * bz) * inverse
        jp, jq = tx * e1x + ty * e1y + up_side * tz * e1z, tx * e2x + ty * e2y
        kp, kq = nx * e1x + ny * e1y + up_side * nz * e1z, nx * e2x + ny * e2y
        gu1 = uu * ju + uv * jv + up * jp + uq * jq + ua * ja + ub * jb
        gu2 = uu * ku + uv * kv + up * kp + uq * kq + ua * ka + ub * kb
        gv1 = uv * ju + vv * jv + vp * jp + vq * jq + va * ja + vb * jb
        gv2 = uv * ku + vv * kv + vp * kp + vq * kq + va * ka + vb * kb
        gp1 = up * ju + vp * jv + pp * jp + pq * jq + pa * ja + pb * jb
        gp2 = up * ku + vp * kv + pp * kp + pq * kq + pa * ka + pb * kb
        gq1 = uq * ju + vq * jv + pq * jp + qq * jq + qa * ja + qb * jb
        gq2 = uq * ku + vq * kv + pq * kp + qq * kq + qa * ka + qb * kb
        # What the pupil alone does, and what comes with hole and slopes.
        oa1, ob1, oa2, ob2 = aa * ja + ab * jb, ab * ja + bb * jb, aa * ka + ab * kb, ab * ka + bb * kb
        ga1, gb1 = oa1 + ua * ju + va * jv + pa * jp + qa * jq, ob1 + ub * ju + vb * jv + pb * jp + qb * jq
        ga2, gb2 = oa2 + ua * ku + va * kv + pa * kp + qa * kq, ob2 + ub * ku + vb * kv + pb * kp + qb * kq
        s11 = ju * gu1 + jv * gv1 + ja * ga1 + jb * gb1 + jp * gp1 + jq * gq1
        s12 = ju * gu2 + jv * gv2 + ja * ga2 + jb * gb2 + jp * gp2 + jq * gq2
        s22 = ku * gu2 + kv * gv2 + ka * ga2 + kb * gb2 + kp * gp2 + kq * gq2
        one11 = 1.0 / math.sqrt(s11 if s11 > TINY else 1.0)  # a detector that accepts no rays has neither spread nor weight
        t21 = s12 * one11
        rest, least = s22 - t21 * t21, 1e-12 * s22 + 1e-30
        one22 = 1.0 / math.sqrt(rest if rest > least else least)
        # Fourth cumulants, over the square of the variance: of a disc -1, of a side of the hole -6/5. A clipped disc is taken
        # as a smaller one. Where the detector's disc limits the rays the slopes are correlated with the point in the hole; the
        # rest is due to the disc.
        j2, k2 = ja * oa1 + jb * ob1, ka * oa2 + kb * ob2
        ru, rv = 1.0 / (uu if uu > TINY else TINY), 1.0 / (vv if vv > TINY else TINY)
        slope2 = pp + qq - (up * up + uq * uq) * ru - (vp * vp + vq * vq) * rv
        slope2 = slope2 if slope2 > 0.0 else 0.0
        sides = (gu1 * gu1 * ru) ** 2 + (gv1 * gv1 * rv) ** 2 + (gu2 * gu2 * ru) ** 2 + (gv2 * gv2 * rv) ** 2
        fourth = 3.0 - (j2 * j2 + k2 * k2 + 0.5 * slope2 * slope2 + 1.2 * sides) / (s11 * s11 + s22 * s22)
        fourth = fourth if fourth > FLATTEST else FLATTEST
        w[k + MEAN_A], w[k + MEAN_B], w[k + RADIUS], w[k + PART] = a0, b0, math.sqrt(4.0 / 3.0 * fourth), 0.25 / fourth
        w[k + U0], w[k + V0], w[k + P0], w[k + Q0] = u0, v0, p0, q0
        w[k + GU1], w[k + GU2], w[k + GV1], w[k + GV2] = gu1, gu2, gv1, gv2
        w[k + GA1], w[k + GA2], w[k + GB1], w[k + GB2] = ga1, ga2, gb1, gb2
        w[k + GP1], w[k + GP2], w[k + GQ1], w[k + GQ2] = gp1, gp2, gq1, gq2
        w[k + ONE11], w[k + T21], w[k + ONE22] = one11, t21, one22


@kernel(nogil=True, fastmath={"contract"})
def place_node(w: Floats, count: int, pupil: Floats, away: float, level: float, points: bool) -> None:
    """Fill the rows of one ray in `w` for each detector: weight, light's direction (3), observer's direction (3).

    `away` and `level` are the node's place on the unit circle, 0 and 0 for the one in the middle. Weights include the beam's
    solid angle, cos(light) cos(pupil) / r^2, 1/mm^2, and the aperture's mm^2. A detector that accepts no rays has weights of
    0. With `points` also each ray's point of the pupil's unit disc and of the hole, mm.
    """
    cx, cy, cz, ax, ay, az = pupil[0, 0], pupil[0, 1], pupil[0, 2], pupil[1, 0], pupil[1, 1], pupil[1, 2]
    bx, by, bz, fx, fy, fz = pupil[2, 0], pupil[2, 1], pupil[2, 2], pupil[3, 0], pupil[3, 1], pupil[3, 2]
    middle, count = away == 0.0 and level == 0.0, whole_lanes(count)
    own, others = (1.0, -6.0) if middle else (0.0, 1.0)
    for k in range(count):
        y2 = w[k + RADIUS] * level * w[k + ONE22]
        y1 = (w[k + RADIUS] * away - w[k + T21] * y2) * w[k + ONE11]
        u, v = w[k + U0] + w[k + GU1] * y1 + w[k + GU2] * y2, w[k + V0] + w[k + GV1] * y1 + w[k + GV2] * y2
        a, b = w[k + MEAN_A] + w[k + GA1] * y1 + w[k + GA2] * y2, w[k + MEAN_B] + w[k + GB1] * y1 + w[k + GB2] * y2
        p, q = w[k + P0] + w[k + GP1] * y1 + w[k + GP2] * y2, w[k + Q0] + w[k + GQ1] * y1 + w[k + GQ2] * y2
        lx = cx + a * ax + b * bx - u
        ly = cy + a * ay + b * by - v
        lz = cz + a * az + b * bz
        inverse = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
        lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
        cosine = lx * fx + ly * fy + lz * fz
        wx = w[k + DX] + p * w[k + E1X] + q * w[k + E2X]
        wy = w[k + DY] + p * w[k + E1Y] + q * w[k + E2Y]
        wz = w[k + DZ] + p * w[k + E1Z]
        shrink = 1.0 / math.sqrt(wx * wx + wy * wy + wz * wz)
        part = own + others * w[k + PART]
        w[k + WEIGHT] = part * w[k + M] * (lz if lz > 0.0 else 0.0) * cosine * inverse * inverse
        w[k + LX], w[k + LY], w[k + LZ] = lx, ly, lz
        w[k + WX], w[k + WY], w[k + WZ] = wx * shrink, wy * shrink, wz * shrink
    if points:
        for k in range(count):
            y2 = w[k + RADIUS] * level * w[k + ONE22]
            y1 = (w[k + RADIUS] * away - w[k + T21] * y2) * w[k + ONE11]
            w[k + A] = w[k + MEAN_A] + w[k + GA1] * y1 + w[k + GA2] * y2
            w[k + B] = w[k + MEAN_B] + w[k + GB1] * y1 + w[k + GB2] * y2
            w[k + U] = w[k + U0] + w[k + GU1] * y1 + w[k + GU2] * y2
            w[k + V] = w[k + V0] + w[k + GV1] * y1 + w[k + GV2] * y2
