"""What a detector's aperture takes of the illuminated hole, as moments.

A detector counts a ray that crosses its disc within its acceptance cone. Of all the rays between hole and disc that it
counts, each weighing alike, the moments up to the second say how much they carry together, where on the sample they
begin on the average, how far about it, and how that goes with their direction. They change smoothly with the
detector's place, and are exact up to the quadrature: over the cone by four nodes (exact to the third degree), over one side
of the hole by Gauss-Legendre, over the other side in closed form. That is for cones narrower than the disc: for others
see twin.optics.fast.wide_aperture.

Everything is in the sample's frame: the hole's sides lie along x and y, its plane is z = 0.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.detector_block import (  # fmt: skip
    A0,
    AHEAD,
    AU,
    AV,
    B0,
    BESIDE1,
    BESIDE2,
    BLOCK,
    BU,
    BV,
    DX,
    DY,
    DZ,
    E1X,
    E1Y,
    E1Z,
    E2X,
    E2Y,
    HALF,
    INVERSE,
    MIDDLE,
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
    PX,
    PY,
    PZ,
    SHARE,
    SU,
    SUU,
    SUV,
    SV,
    SVV,
    M,
    S,
)
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.kernel import kernel

CLOSER = 1.1
"""With deviations a detector may be so much nearer to some of the hole than the arc's radius."""


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


@kernel(forceinline=True)
def detector_frame(dx: float, dy: float, dz: float) -> tuple[float, float, float, float, float]:
    """Of a detector that is seen along d: its axes e1 = (a, b, c), away from the normal, and e2 = (f, g, 0), level."""
    sine = math.sqrt(dx * dx + dy * dy)
    cos, sin = (dx / sine, dy / sine) if sine > 0.0 else (1.0, 0.0)
    return dz * cos, dz * sin, -sine, -sin, cos


@kernel(nogil=True)
def detector_frames(w: Floats, count: int) -> None:
    """Fills the frames of detectors whose places and views are in `w`."""
    for k in range(count):
        dx, dy, dz = w[k + DX], w[k + DY], w[k + DZ]
        e1x, e1y, e1z, e2x, e2y = detector_frame(dx, dy, dz)
        x, y, z = w[k + PX], w[k + PY], w[k + PZ]
        w[k + E1X], w[k + E1Y], w[k + E1Z], w[k + E2X], w[k + E2Y] = e1x, e1y, e1z, e2x, e2y
        w[k + BESIDE1], w[k + BESIDE2] = x * e1x + y * e1y + z * e1z, x * e2x + y * e2y
        w[k + AHEAD] = x * dx + y * dy + z * dz


@kernel(nogil=True, fastmath={"contract"})
def apertures(w: Floats, count: int, cone: Floats, side: Floats, sizes: Floats) -> None:
    """Fills the moments of detectors whose frames are in `w`; the first is in mm^2.

    `sizes`: the disc's radius, the hole's half side, mm, and the sine of half the field. See `cone_nodes`, `side_nodes`.
    """
    radius, half, sine = sizes[0], sizes[1], sizes[2]
    w[M : M + MOMENTS * BLOCK] = 0.0
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
            middle, reach = (bu * a0 - au * b0) / area, radius * math.sqrt(square) / abs(area)
            low, high = middle - reach, middle + reach
            # Plain comparisons, for max and min of Python keep a loop from being vectorised.
            low, high = (low if low > -half else -half), (high if high < half else half)
            # NaN, from within the sample's plane, is no ray; nor is one from the other side of the sample.
            seen = (high > low) & ((dz + p * w[k + E1Z]) * dz > 0.0)
            low, high = (low if seen else 0.0), (high if seen else 0.0)
            w[k + A0], w[k + AU], w[k + AV], w[k + B0], w[k + BU], w[k + BV] = a0, au, av, b0, bu, bv
            w[k + MIDDLE], w[k + HALF], w[k + INVERSE] = 0.5 * (high + low), 0.5 * (high - low), 1.0 / square
            w[k + SHARE] = share * abs(area) * (high - low)
        w[S : S + 6 * BLOCK] = 0.0
        for node in range(side.shape[0]):
            place, weight = side[node, 0], side[node, 1]
            for k in range(count):
                au, bu, inverse = w[k + AU], w[k + BU], w[k + INVERSE]
                v = w[k + MIDDLE] + w[k + HALF] * place
                a1, b1 = w[k + A0] + w[k + AV] * v, w[k + B0] + w[k + BV] * v
                beside = a1 * bu - b1 * au
                foot = -(a1 * au + b1 * bu) * inverse
                inside = radius * radius / inverse - beside * beside
                chord = math.sqrt(inside if inside > 0.0 else 0.0) * inverse
                left, right = foot - chord, foot + chord
                left, right = (left if left > -half else -half), (right if right < half else half)
                width = right - left if right > left else 0.0
                u, part = 0.5 * (right + left), weight * width
                w[k + S] += part
                w[k + SU] += part * u
                w[k + SV] += part * v
                w[k + SUU] += part * (u * u + width * width / 12.0)
                w[k + SUV] += part * u * v
                w[k + SVV] += part * v * v
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
