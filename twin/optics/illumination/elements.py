"""Elements of the illumination unit: kernels that the estimators in both directions share.

A ray is a point (x, y, z) in mm and a unit vector (p, q, r), as six numbers: these stay in registers, where two small arrays
would take several times as long. `frames` (elements, 4, 3) and `sizes` are those of `IlluminationUnit`, and `e` is the number
of an element: a view of one frame would cost more than its use. Kernels for one direction only are in the file of its
estimator.
"""

import math

from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.unit import ARC, INPUT, OUTPUT, REFLECTOR, SLIT
from goniotwin.twin.optics.kernel import kernel

Triple = tuple[float, float, float]


@kernel(forceinline=True)
def along_axes(frames: Floats, e: int, p: float, q: float, r: float) -> Triple:
    """Components of a vector along the three axes of an element's frame."""
    return (
        p * frames[e, 1, 0] + q * frames[e, 1, 1] + r * frames[e, 1, 2],
        p * frames[e, 2, 0] + q * frames[e, 2, 1] + r * frames[e, 2, 2],
        p * frames[e, 3, 0] + q * frames[e, 3, 1] + r * frames[e, 3, 2],
    )


@kernel(forceinline=True)
def to_plane(
    frames: Floats, e: int, x: float, y: float, z: float, p: float, q: float, r: float
) -> tuple[float, float, float, float, float]:
    """Point where the ray, forwards or backwards, meets the element's plane, and its coordinates (x, z) in the element's frame.

    The coordinates are NaN or inf if it never meets the plane.
    """
    dx, dy, dz = x - frames[e, 0, 0], y - frames[e, 0, 1], z - frames[e, 0, 2]
    step = -(dx * frames[e, 2, 0] + dy * frames[e, 2, 1] + dz * frames[e, 2, 2]) / (
        p * frames[e, 2, 0] + q * frames[e, 2, 1] + r * frames[e, 2, 2]
    )
    dx, dy, dz = dx + step * p, dy + step * q, dz + step * r
    u = dx * frames[e, 1, 0] + dy * frames[e, 1, 1] + dz * frames[e, 1, 2]
    v = dx * frames[e, 3, 0] + dy * frames[e, 3, 1] + dz * frames[e, 3, 2]
    return x + step * p, y + step * q, z + step * r, u, v


@kernel(forceinline=True)
def bend(
    frames: Floats, e: int, u: float, v: float, power: float, p: float, q: float, r: float
) -> tuple[float, float, float, float]:
    """Refract a ray at an ideal lens at its own (u, v): tangents decrease by u and v times the power (1 / focal length).

    A negative power traces light backwards. Returns the direction, and the fourth power of the cosine before over the cosine
    after. Along the light the radiance is multiplied by that, and the etendue of a pencil by its inverse: their product, the
    flux, is conserved.
    """
    s, along, t = along_axes(frames, e, p, q, r)
    before = along * along
    s, t = s / along - power * u, t / along - power * v
    after = 1.0 / (1.0 + s * s + t * t)
    forward = math.copysign(math.sqrt(after), along)
    return (
        forward * (s * frames[e, 1, 0] + frames[e, 2, 0] + t * frames[e, 3, 0]),
        forward * (s * frames[e, 1, 1] + frames[e, 2, 1] + t * frames[e, 3, 1]),
        forward * (s * frames[e, 1, 2] + frames[e, 2, 2] + t * frames[e, 3, 2]),
        (before * before) / (after * after),
    )


@kernel(forceinline=True)
def reflect_at_sphere(
    frames: Floats, e: int, radius: float, least: float, x: float, y: float, z: float, p: float, q: float, r: float
) -> tuple[bool, tuple[float, float, float], tuple[float, float, float]]:
    """Propagate a ray from near the reflector's centre to its sphere and reflect it; false if it misses the reflector.

    `least` is the cosine of the half-angle at the centre of curvature, which is a radius from the vertex along y.
    """
    cx, cy, cz = (
        frames[e, 0, 0] + radius * frames[e, 2, 0],
        frames[e, 0, 1] + radius * frames[e, 2, 1],
        frames[e, 0, 2] + radius * frames[e, 2, 2],
    )
    dx, dy, dz = x - cx, y - cy, z - cz
    middle = dx * p + dy * q + dz * r
    root = middle * middle - (dx * dx + dy * dy + dz * dz) + radius * radius
    met = root > 0.0
    step = math.sqrt(root if met else 0.0) - middle
    x, y, z = x + step * p, y + step * q, z + step * r
    inverse = 1.0 / radius
    nx, ny, nz = (cx - x) * inverse, (cy - y) * inverse, (cz - z) * inverse
    depth = nx * frames[e, 2, 0] + ny * frames[e, 2, 1] + nz * frames[e, 2, 2]
    twice = 2.0 * (nx * p + ny * q + nz * r)
    return met & (depth >= least), (x, y, z), (p - twice * nx, q - twice * ny, r - twice * nz)


@kernel(forceinline=True)
def chord(
    frames: Floats, e: int, radius: float, half: float, x: float, y: float, z: float, p: float, q: float, r: float
) -> float:
    """Length in mm, within the arc's cylinder, of the whole straight line through the point along the direction.

    The cylinder's axis is its own z.
    """
    p0, q0, start = along_axes(frames, e, x - frames[e, 0, 0], y - frames[e, 0, 1], z - frames[e, 0, 2])
    p1, q1, slope = along_axes(frames, e, p, q, r)
    a, b, c = p1 * p1 + q1 * q1, p0 * p1 + q0 * q1, p0 * p0 + q0 * q0 - radius * radius
    # Conditional values instead of branches, so that a loop over rays is vectorised. A ray along the axis has a = 0.
    root = b * b - a * c
    met = root > 0.0 if a > 0.0 else c < 0.0
    root, inverse = math.sqrt(root if root > 0.0 else 0.0), 1.0 / a
    low, high = ((-b - root) * inverse, (-b + root) * inverse) if a > 0.0 else (-math.inf, math.inf)
    inverse = 1.0 / slope
    first, last = (-half - start) * inverse, (half - start) * inverse
    near, far = (first, last) if first < last else (last, first)
    low, high = (near if near > low else low), (far if far < high else high)
    return high - low if met & (high > low) else 0.0


@kernel(forceinline=True)
def lit_length(frames: Floats, sizes: Floats, x: float, y: float, z: float, p: float, q: float, r: float) -> float:
    """Weighted length in mm within the arc of a backward ray that starts between slit and condenser; 0 if vignetted.

    Directly and by the reflector, each times its share of the light; with the change of radiance in the input condenser.
    """
    x, y, z, u, v = to_plane(frames, INPUT, x, y, z, p, q, r)
    passes = u * u + v * v <= sizes[5] * sizes[5]
    p, q, r, gain = bend(frames, INPUT, u, v, -1.0 / sizes[4], p, q, r)
    direct = chord(frames, ARC, sizes[0], sizes[1], x, y, z, p, q, r)
    on, (x, y, z), (p, q, r) = reflect_at_sphere(frames, REFLECTOR, sizes[2], sizes[3], x, y, z, p, q, r)
    reflected = chord(frames, ARC, sizes[0], sizes[1], x, y, z, p, q, r)
    length: float = sizes[10] * direct + (sizes[11] * reflected if on else 0.0)
    return length / gain if passes else 0.0


@kernel(forceinline=True)
def field_ray(frames: Floats, sizes: Floats, u: float, v: float, x: float, z: float) -> tuple[float, float, float, float]:
    """Backward ray from (x, z) of the field to (u, v) of the exit pupil, in mm, bent there, and on to the arc.

    Its weight in 1/mm, wherever it crosses the slit's plane; its point (s, t) there, mm; the tangent of its angle to the axis
    at the field.
    """
    px = frames[OUTPUT, 0, 0] + u * frames[OUTPUT, 1, 0] + v * frames[OUTPUT, 3, 0]
    py = frames[OUTPUT, 0, 1] + u * frames[OUTPUT, 1, 1] + v * frames[OUTPUT, 3, 1]
    pz = frames[OUTPUT, 0, 2] + u * frames[OUTPUT, 1, 2] + v * frames[OUTPUT, 3, 2]
    p, q, r = px - x, py - sizes[12], pz - z
    square = p * p + q * q + r * r
    shrink = 1.0 / math.sqrt(square)
    p, q, r = p * shrink, q * shrink, r * shrink
    leaving, cosine, tangent = -along_axes(frames, OUTPUT, p, q, r)[1], -q, math.sqrt(p * p + r * r) / -q
    p, q, r, gain = bend(frames, OUTPUT, u, v, -1.0 / sizes[6], p, q, r)
    px, py, pz, s, t = to_plane(frames, SLIT, px, py, pz, p, q, r)
    return lit_length(frames, sizes, px, py, pz, p, q, r) * cosine * leaving / (square * gain), s, t, tangent
