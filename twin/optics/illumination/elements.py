"""Elements of the illumination unit: kernels that the estimators in both directions share.

A ray is a point x (3,) in mm and a unit vector w (3,), both changed in place. Frames and sizes are those of `IlluminationUnit`.
Kernels for one direction only are in the file of its estimator.
"""

import math

from goniotwin.arrays import Floats
from goniotwin.twin.optics.kernel import kernel


@kernel(forceinline=True)
def to_plane(frame: Floats, x: Floats, w: Floats) -> tuple[float, float]:
    """Propagate the ray, forwards or backwards, to the element's plane.

    Returns its coordinates (x, z) in the element's frame; NaN or inf if it never meets the plane.
    """
    away = along = 0.0
    for c in range(3):
        away += (frame[0, c] - x[c]) * frame[2, c]
        along += w[c] * frame[2, c]
    step = away / along
    u = v = 0.0
    for c in range(3):
        x[c] += step * w[c]
        u += (x[c] - frame[0, c]) * frame[1, c]
        v += (x[c] - frame[0, c]) * frame[3, c]
    return u, v


@kernel(forceinline=True)
def bend(frame: Floats, u: float, v: float, power: float, w: Floats) -> float:
    """Refract a ray at an ideal lens at its own (u, v): tangents decrease by u and v times the power (1 / focal length).

    A negative power traces light backwards. Returns the fourth power of the cosine before over the cosine after. Along the
    light the radiance is multiplied by that, and the etendue of a pencil by its inverse: their product, the flux, is conserved.
    """
    p = q = along = 0.0
    for c in range(3):
        p += w[c] * frame[1, c]
        along += w[c] * frame[2, c]
        q += w[c] * frame[3, c]
    before = along * along
    p, q = p / along - power * u, q / along - power * v
    after = 1.0 / (1.0 + p * p + q * q)
    forward = math.copysign(math.sqrt(after), along)
    for c in range(3):
        w[c] = forward * (p * frame[1, c] + frame[2, c] + q * frame[3, c])
    return (before * before) / (after * after)


@kernel(forceinline=True)
def reflect_at_sphere(frame: Floats, radius: float, least: float, x: Floats, w: Floats) -> bool:
    """Propagate a ray from near the reflector's centre to its sphere and reflect it; False if it misses the reflector.

    `least` is the cosine of the half-angle at the centre of curvature, which is a radius from the vertex along y.
    """
    middle = square = 0.0
    for c in range(3):
        offset = x[c] - frame[0, c] - radius * frame[2, c]
        middle += offset * w[c]
        square += offset * offset
    root = middle * middle - square + radius * radius
    if not root > 0.0:
        return False
    step = math.sqrt(root) - middle
    depth = along = 0.0
    for c in range(3):
        x[c] += step * w[c]
        inward = (frame[0, c] + radius * frame[2, c] - x[c]) / radius
        depth += inward * frame[2, c]
        along += inward * w[c]
    for c in range(3):
        w[c] -= 2.0 * along * (frame[0, c] + radius * frame[2, c] - x[c]) / radius
    return depth >= least


@kernel(forceinline=True)
def chord(frame: Floats, radius: float, half: float, x: Floats, w: Floats) -> float:
    """Length in mm, within the arc's cylinder, of the whole straight line through x along w.

    The cylinder's axis is its own z.
    """
    a = b = c0 = start = slope = p0 = q0 = p1 = q1 = 0.0
    for c in range(3):
        offset = x[c] - frame[0, c]
        p0 += offset * frame[1, c]
        q0 += offset * frame[2, c]
        start += offset * frame[3, c]
        p1 += w[c] * frame[1, c]
        q1 += w[c] * frame[2, c]
        slope += w[c] * frame[3, c]
    a, b, c0 = p1 * p1 + q1 * q1, p0 * p1 + q0 * q1, p0 * p0 + q0 * q0 - radius * radius
    low, high = -math.inf, math.inf
    if a > 0.0:
        root = b * b - a * c0
        if root <= 0.0:
            return 0.0
        low, high = (-b - math.sqrt(root)) / a, (-b + math.sqrt(root)) / a
    elif c0 >= 0.0:
        return 0.0
    if slope != 0.0:
        first, last = (-half - start) / slope, (half - start) / slope
        low, high = max(low, min(first, last)), min(high, max(first, last))
    elif abs(start) >= half:
        return 0.0
    return max(0.0, high - low)
