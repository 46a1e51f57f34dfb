"""The fast estimator's rays: seven for a detector, which stand for all that its aperture takes of the beam.

What a lobe gives depends on two offsets above all: how far the observer is from the mirrored light along the great circle
between them, and how far across it. Both are linear in six numbers: place in the hole, slopes to the detector's axis, place
on the exit pupil. So their covariance follows from the aperture's moments, and a seven-node rule of the fifth degree
(Stroud, Secrest 1963) takes its place; its radius is that of the fourth moments, which for discs and squares are below
a Gaussian's. Each node is a real ray: the six numbers are those to be expected for its offsets.
"""

import math

import numpy as np
from numba import njit

from twin.optics.aperture import detector_frame
from twin.optics.frames import Floats

NODES = 7
TINY = 1e-30
FLATTEST = 1.8
"""Fourth moment over the square of the second of a uniform distribution: no sum of discs and sides is flatter."""
HEXAGON = np.array([[math.cos(0.26 + k * math.pi / 3), math.sin(0.26 + k * math.pi / 3)] for k in range(6)])
"""Turned out of the plane of incidence, so that no two nodes are mirror images in it."""


@njit(cache=True, error_model="numpy")
def place_nodes(m: Floats, d: Floats, pupil: Floats, hexagon: Floats, rays: Floats, first: int) -> None:
    """Fills rays[:, first : first + 7]: weight, light's direction (3), observer's direction (3).

    From the moments `m` of a detector in direction d; `pupil` (4, 3) is the exit pupil's centre, its two axes as long as
    its radius, and its normal, mm. Weights have the beam's solid angle in them: cos(light) cos(pupil) / r^2, 1/mm^2, and
    the aperture's mm^2.
    """
    if m[0] <= 0.0:
        for j in range(NODES):
            rays[0, first + j] = 0.0
            for c in range(1, 7):
                rays[c, first + j] = 0.0
            rays[3, first + j] = rays[6, first + j] = 1.0
        return
    e1x, e1y, e1z, e2x, e2y = detector_frame(d[0], d[1], d[2])
    one = 1.0 / m[0]
    u0, v0, p0, q0 = m[1] * one, m[2] * one, m[3] * one, m[4] * one
    uu, uv, vv = m[5] * one - u0 * u0, m[6] * one - u0 * v0, m[7] * one - v0 * v0
    up, uq, vp, vq = m[8] * one - u0 * p0, m[9] * one - u0 * q0, m[10] * one - v0 * p0, m[11] * one - v0 * q0
    pp, pq, qq = m[12] * one - p0 * p0, m[13] * one - p0 * q0, m[14] * one - q0 * q0
    # The mean ray: mirrored light r, observer o, and the great circle between them with its normal n.
    rx, ry, rz = u0 - pupil[0, 0], v0 - pupil[0, 1], pupil[0, 2]
    inverse = 1.0 / math.sqrt(rx * rx + ry * ry + rz * rz)
    rx, ry, rz = rx * inverse, ry * inverse, rz * inverse
    up_side = 1.0 if d[2] > 0.0 else -1.0  # what is transmitted is seen in the sample's plane as in a mirror
    ox, oy, oz = d[0] + p0 * e1x + q0 * e2x, d[1] + p0 * e1y + q0 * e2y, up_side * (d[2] + p0 * e1z)
    shrink = 1.0 / math.sqrt(ox * ox + oy * oy + oz * oz)
    ox, oy, oz = ox * shrink, oy * shrink, oz * shrink
    nx, ny, nz = ry * oz - rz * oy, rz * ox - rx * oz, rx * oy - ry * ox
    sine2 = nx * nx + ny * ny + nz * nz
    if sine2 > 1e-18:
        grow = 1.0 / math.sqrt(sine2)
        nx, ny, nz = nx * grow, ny * grow, nz * grow
    else:
        nx, ny, nz = e2x, e2y, 0.0
    tx, ty, tz = ny * oz - nz * oy, nz * ox - nx * oz, nx * oy - ny * ox
    sx, sy, sz = ny * rz - nz * ry, nz * rx - nx * rz, nx * ry - ny * rx
    # Offsets along (j) and across (k) the circle, by hole (u, v), pupil (a, b) and slopes (p, q).
    ju, jv = -sx * inverse, -sy * inverse
    ja = (sx * pupil[1, 0] + sy * pupil[1, 1] - sz * pupil[1, 2]) * inverse
    jb = (sx * pupil[2, 0] + sy * pupil[2, 1] - sz * pupil[2, 2]) * inverse
    ku, kv = -nx * inverse, -ny * inverse
    ka = (nx * pupil[1, 0] + ny * pupil[1, 1] - nz * pupil[1, 2]) * inverse
    kb = (nx * pupil[2, 0] + ny * pupil[2, 1] - nz * pupil[2, 2]) * inverse
    jp, jq = tx * e1x + ty * e1y + up_side * tz * e1z, tx * e2x + ty * e2y
    kp, kq = nx * e1x + ny * e1y + up_side * nz * e1z, nx * e2x + ny * e2y
    gu1, gu2 = uu * ju + uv * jv + up * jp + uq * jq, uu * ku + uv * kv + up * kp + uq * kq
    gv1, gv2 = uv * ju + vv * jv + vp * jp + vq * jq, uv * ku + vv * kv + vp * kp + vq * kq
    gp1, gp2 = up * ju + vp * jv + pp * jp + pq * jq, up * ku + vp * kv + pp * kp + pq * kq
    gq1, gq2 = uq * ju + vq * jv + pq * jp + qq * jq, uq * ku + vq * kv + pq * kp + qq * kq
    ga1, ga2, gb1, gb2 = 0.25 * ja, 0.25 * ka, 0.25 * jb, 0.25 * kb
    s11 = ju * gu1 + jv * gv1 + ja * ga1 + jb * gb1 + jp * gp1 + jq * gq1
    s12 = ju * gu2 + jv * gv2 + ja * ga2 + jb * gb2 + jp * gp2 + jq * gq2
    s22 = ku * gu2 + kv * gv2 + ka * ga2 + kb * gb2 + kp * gp2 + kq * gq2
    t11 = math.sqrt(s11)
    t21 = s12 / t11
    t22 = math.sqrt(max(s22 - t21 * t21, 1e-12 * s22 + 1e-30))
    # Fourth cumulants: of a disc -r^4/16 along each of its axes, of a side of the hole -6/5 of its variance squared. Slopes go
    # with the place in the hole where the disc limits them; what is left of them then is the disc's own.
    j2, k2 = ja * ja + jb * jb, ka * ka + kb * kb
    ru, rv = 1.0 / max(uu, TINY), 1.0 / max(vv, TINY)
    slope2 = max(pp + qq - (up * up + uq * uq) * ru - (vp * vp + vq * vq) * rv, 0.0)
    sides = (gu1 * gu1 * ru) ** 2 + (gv1 * gv1 * rv) ** 2 + (gu2 * gu2 * ru) ** 2 + (gv2 * gv2 * rv) ** 2
    fourth = 3.0 - ((j2 * j2 + k2 * k2) / 16.0 + 0.5 * slope2 * slope2 + 1.2 * sides) / (s11 * s11 + s22 * s22)
    radius = math.sqrt(4.0 / 3.0 * max(fourth, FLATTEST))
    share = 1.0 / (3.0 * radius * radius)
    for j in range(NODES):
        z1, z2 = (0.0, 0.0) if j == 0 else (radius * hexagon[j - 1, 0], radius * hexagon[j - 1, 1])
        y2 = z2 / t22
        y1 = (z1 - t21 * y2) / t11
        u, v = u0 + gu1 * y1 + gu2 * y2, v0 + gv1 * y1 + gv2 * y2
        a, b = ga1 * y1 + ga2 * y2, gb1 * y1 + gb2 * y2
        p, q = p0 + gp1 * y1 + gp2 * y2, q0 + gq1 * y1 + gq2 * y2
        lx = pupil[0, 0] + a * pupil[1, 0] + b * pupil[2, 0] - u
        ly = pupil[0, 1] + a * pupil[1, 1] + b * pupil[2, 1] - v
        lz = pupil[0, 2] + a * pupil[1, 2] + b * pupil[2, 2]
        inverse = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
        lx, ly, lz = lx * inverse, ly * inverse, lz * inverse
        cosine = lx * pupil[3, 0] + ly * pupil[3, 1] + lz * pupil[3, 2]
        wx, wy, wz = d[0] + p * e1x + q * e2x, d[1] + p * e1y + q * e2y, d[2] + p * e1z
        shrink = 1.0 / math.sqrt(wx * wx + wy * wy + wz * wz)
        part = 1.0 - 6.0 * share if j == 0 else share
        i = first + j
        rays[0, i] = part * m[0] * max(lz, 0.0) * cosine * inverse * inverse
        rays[1, i], rays[2, i], rays[3, i] = lx, ly, lz
        rays[4, i], rays[5, i], rays[6, i] = wx * shrink, wy * shrink, wz * shrink
