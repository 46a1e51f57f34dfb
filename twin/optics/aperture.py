"""What a detector's aperture takes of the illuminated hole, as moments.

A detector counts a ray that crosses its disc within its acceptance cone. Of all the rays between hole and disc that it
counts, each weighing alike, the moments up to the second say how much they carry together, where on the sample they
begin on the average, how far about it, and how that goes with their direction. They change smoothly with the
detector's place, and are exact up to the quadrature: over the cone by four nodes (exact to the third degree), over one side
of the hole by Gauss-Legendre, over the other side in closed form. That is for cones narrower than the disc: for others
see twin.optics.wide_aperture.

Everything is in the sample's frame: the hole's sides lie along x and y, its plane is z = 0.
"""

import math

import numpy as np
from numba import njit

from twin.optics.frames import Floats
from twin.optics.instrument import Instrument

CLOSER = 1.1
"""With deviations a detector may be so much nearer to some of the hole than the arc's radius."""
MOMENTS = 15
"""1, u, v, p, q, uu, uv, vv, up, uq, vp, vq, pp, pq, qq: place in the hole (mm) and slopes to the detector's axis."""


def aperture_sizes(instrument: Instrument) -> Floats:
    """For the kernels: the disc's radius and the hole's half side, mm, and the sine of half the field.

    A field wider than what hole and disc can see of each other is as good as one that is just so wide, and costs less.
    """
    radius, half = 0.5 * instrument.detector_diameter_mm, 0.5 * instrument.spot_side_mm
    most = math.atan(CLOSER * (radius + math.sqrt(2.0) * half) / instrument.arc_radius_mm)
    return np.array([radius, half, math.sin(min(math.radians(0.5 * instrument.field_deg), most))])


def cone_nodes(rings: int = 1) -> Floats:
    """Places on the unit disc and their shares (n, 3): four nodes, or with more rings a product rule of higher degree."""
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
    """Places within -1..1 and their shares (n, 2): Gauss-Legendre, drawn to the ends as a chord of the disc wants it.

    Where the disc limits the hole the chord ends like a square root; the map t (3 - t^2) / 2 makes that smooth.
    """
    t, weights = np.polynomial.legendre.leggauss(count)
    return np.stack([0.5 * t * (3.0 - t * t), 0.75 * (1.0 - t * t) * weights], axis=1)


@njit(cache=True, error_model="numpy", forceinline=True)
def detector_frame(dx: float, dy: float, dz: float) -> tuple[float, float, float, float, float]:
    """Of a detector that is seen along d: its axes e1 = (a, b, c), away from the normal, and e2 = (f, g, 0), level."""
    sine = math.sqrt(dx * dx + dy * dy)
    cos, sin = (dx / sine, dy / sine) if sine > 0.0 else (1.0, 0.0)
    return dz * cos, dz * sin, -sine, -sin, cos


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def aperture(centre: Floats, d: Floats, cone: Floats, side: Floats, sizes: Floats, m: Floats) -> None:
    """Fills `m` (15,) with the moments of a detector at `centre` that looks along -d; the first is in mm^2.

    `sizes`: the disc's radius, the hole's half side, mm, and the sine of half the field. See `cone_nodes`, `side_nodes`.
    """
    radius, half, sine = sizes[0], sizes[1], sizes[2]
    for i in range(MOMENTS):
        m[i] = 0.0
    dx, dy, dz = d[0], d[1], d[2]
    e1x, e1y, e1z, e2x, e2y = detector_frame(dx, dy, dz)
    beside1 = centre[0] * e1x + centre[1] * e1y + centre[2] * e1z
    beside2 = centre[0] * e2x + centre[1] * e2y
    ahead = centre[0] * dx + centre[1] * dy + centre[2] * dz
    for c in range(cone.shape[0]):
        away, level = sine * cone[c, 0], sine * cone[c, 1]
        along = math.sqrt(1.0 - away * away - level * level)
        p, q = away / along, level / along
        # A point (u, v) of the hole meets the disc's plane at (au u + av v + a0, bu u + bv v + b0) from the disc's centre.
        a0, au, av = ahead * p - beside1, e1x - p * dx, e1y - p * dy
        b0, bu, bv = ahead * q - beside2, e2x - q * dx, e2y - q * dy
        square = au * au + bu * bu
        area = au * bv - av * bu
        middle, reach = (bu * a0 - au * b0) / area, radius * math.sqrt(square) / abs(area)
        low, high = max(-half, middle - reach), min(half, middle + reach)
        # NaN, from within the sample's plane, is no ray; nor is one from the other side of the sample.
        if not high > low or not (dz + p * e1z) * dz > 0.0:
            continue
        inverse, mid_v, half_v = 1.0 / square, 0.5 * (high + low), 0.5 * (high - low)
        limit = radius * radius * square
        s, su, sv, suu, suv, svv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(side.shape[0]):
            v = mid_v + half_v * side[k, 0]
            a1, b1 = a0 + av * v, b0 + bv * v
            beside = a1 * bu - b1 * au
            foot = -(a1 * au + b1 * bu) * inverse
            # Plain comparisons, for max and min of Python keep the loop from being vectorised.
            inside = limit - beside * beside
            chord = math.sqrt(inside if inside > 0.0 else 0.0) * inverse
            left, right = foot - chord, foot + chord
            left, right = (left if left > -half else -half), (right if right < half else half)
            width = right - left if right > left else 0.0
            u, w = 0.5 * (right + left), side[k, 1] * width
            s += w
            su += w * u
            sv += w * v
            suu += w * (u * u + width * width / 12.0)
            suv += w * u * v
            svv += w * v * v
        share = cone[c, 2] * abs(area) * (high - low)
        s, su, sv = s * share, su * share, sv * share
        m[0] += s
        m[1] += su
        m[2] += sv
        m[3] += s * p
        m[4] += s * q
        m[5] += suu * share
        m[6] += suv * share
        m[7] += svv * share
        m[8] += su * p
        m[9] += su * q
        m[10] += sv * p
        m[11] += sv * q
        m[12] += s * p * p
        m[13] += s * p * q
        m[14] += s * q * q
