"""Measure of the rays that a detector receives from a regular reflection or transmission: an image of the exit pupil.

A mirror conserves radiance. So a detector of the open beam (optics.md, section 7), or of a mirror, sees the pupil through
the hole, mirrored in the sample's plane or directly. It receives the measure of all rays that cross the hole and the disc,
lie within the acceptance cone, and come from the pupil. From a point of the hole the last three are discs in the plane of
slopes (the pupil is an ellipse), so that along one slope each gives a chord, in closed form; the other slope and the hole
take Gauss-Legendre nodes. The result is smooth except for kinks, and no random ray is drawn.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.aperture import side_nodes
from goniotwin.twin.optics.fast.detector_block import HOLE_U, HOLE_V, PUPIL_A, PUPIL_B
from goniotwin.twin.optics.geometry.scene import SceneArrays, detector_frame, image_coordinates, reaches_over
from goniotwin.twin.optics.illumination.slit_image import (
    ALONG_V,
    SlitImage,
    chord_lines,
    cut_chord,
    cut_ray_chord,
    relative_radiance,
)
from goniotwin.twin.optics.kernel import kernel


def line_nodes(count: int) -> Floats:
    """Gauss-Legendre points within -1..1 and their weights (n, 2), which sum to 1."""
    places, weights = np.polynomial.legendre.leggauss(count)
    return np.stack([places, 0.5 * weights], axis=1)


HOLE, LINE = line_nodes(12), side_nodes(16)
"""Nodes over a side of the hole, and over a slope."""


@kernel(forceinline=True)
def conic(
    q: float, d: Floats, e1: Floats, e2: Floats, image: Floats, square_radius: float, hn: float, ha: float, hb: float
) -> tuple[float, float, float]:
    """Condition on the slope p of rays of slope q from the image: a p^2 + 2 b p + c <= 0; returns a, b, c.

    A ray h + s w, with h from the image's centre to the hole, meets the image's plane at coordinates (x, y) / (w n), where x =
    (h a)(w n) - (h n)(w a), and y alike with its other axis, are linear in w = d + q e2 + p e1.
    """
    wx, wy, wz = d[0] + q * e2[0], d[1] + q * e2[1], d[2] + q * e2[2]
    n0 = wx * image[3, 0] + wy * image[3, 1] + wz * image[3, 2]
    n1 = e1[0] * image[3, 0] + e1[1] * image[3, 1] + e1[2] * image[3, 2]
    x0 = ha * n0 - hn * (wx * image[1, 0] + wy * image[1, 1] + wz * image[1, 2])
    x1 = ha * n1 - hn * (e1[0] * image[1, 0] + e1[1] * image[1, 1] + e1[2] * image[1, 2])
    y0 = hb * n0 - hn * (wx * image[2, 0] + wy * image[2, 1] + wz * image[2, 2])
    y1 = hb * n1 - hn * (e1[0] * image[2, 0] + e1[1] * image[2, 1] + e1[2] * image[2, 2])
    limit = square_radius * square_radius
    return x1 * x1 + y1 * y1 - limit * n1 * n1, x0 * x1 + y0 * y1 - limit * n0 * n1, x0 * x0 + y0 * y0 - limit * n0 * n0


@kernel(nogil=True)
def image_measures(
    centres: Floats, axes: Floats, sizes: Floats, pupil: Floats, chords: Floats, transmits: bool, result: Floats
) -> None:
    """Fill `result` (n,) with the measures of n detectors, mm^2 sr: 0 for those that do not see the pupil's image.

    `pupil` (4, 3) as in `SceneArrays`, `chords` those of the lit part of the hole, see `SlitImage`.
    """
    half, e1, e2, lines, image = sizes[1], np.zeros(3), np.zeros(3), chord_lines(chords, ALONG_V), pupil.copy()
    if not transmits:
        for row in range(4):
            image[row, 2] *= -1.0
    first_u, last_u = chords[ALONG_V, 0, 0], chords[ALONG_V, 0, 1]
    for n in range(axes.shape[0]):
        d, total = axes[n], 0.0
        result[n] = 0.0
        if (d[2] < 0.0) != transmits:  # reflected light leaves on the light's side, transmitted light on the other
            continue
        e1[0], e1[1], e1[2], e2[0], e2[1] = detector_frame(d[0], d[1], d[2])
        for i in range(HOLE.shape[0]):
            u = 0.5 * (first_u + last_u) + 0.5 * (last_u - first_u) * HOLE[i, 0]
            first_v, last_v = cut_chord(lines, u, -half, half)
            if not (last_u > first_u and last_v > first_v):
                continue
            lit_mm2 = (last_u - first_u) * (last_v - first_v)
            for j in range(HOLE.shape[0]):
                v = 0.5 * (first_v + last_v) + 0.5 * (last_v - first_v) * HOLE[j, 0]
                total += HOLE[i, 1] * HOLE[j, 1] * slope_integral(u, v, centres[n], d, e1, e2, image, sizes) * lit_mm2
        result[n] = total


@kernel()
def slope_integral(
    u: float, v: float, centre: Floats, d: Floats, e1: Floats, e2: Floats, image: Floats, sizes: Floats
) -> float:
    """Integral of the cosine on the sample over the directions from (u, v) of the hole that a detector counts, sr."""
    tangent = sizes[2] / math.sqrt(1.0 - sizes[2] * sizes[2])
    square_radius = image[1, 0] ** 2 + image[1, 1] ** 2 + image[1, 2] ** 2
    # The disc's centre and radius as slopes from (u, v).
    cx, cy, cz = centre[0] - u, centre[1] - v, centre[2]
    distance = cx * d[0] + cy * d[1] + cz * d[2]
    p0, q0 = (cx * e1[0] + cy * e1[1] + cz * e1[2]) / distance, (cx * e2[0] + cy * e2[1]) / distance
    reach = sizes[0] / distance
    low, high = max(-tangent, q0 - reach), min(tangent, q0 + reach)
    hx, hy, hz = u - image[0, 0], v - image[0, 1], -image[0, 2]
    hn = hx * image[3, 0] + hy * image[3, 1] + hz * image[3, 2]
    ha = hx * image[1, 0] + hy * image[1, 1] + hz * image[1, 2]
    hb = hx * image[2, 0] + hy * image[2, 1] + hz * image[2, 2]
    # There are rays from the image where b^2 - a c, which is quadratic in q, is not negative.
    a, b, c = conic(0.0, d, e1, e2, image, square_radius, hn, ha, hb)
    middle = b * b - a * c
    a, b, c = conic(1.0, d, e1, e2, image, square_radius, hn, ha, hb)
    above = b * b - a * c
    a, b, c = conic(-1.0, d, e1, e2, image, square_radius, hn, ha, hb)
    below = b * b - a * c
    bend, lean = 0.5 * (above + below) - middle, 0.5 * (above - below)
    square = lean * lean - 4.0 * bend * middle
    if not (a > 0.0 and bend < 0.0 and square > 0.0):
        return 0.0
    root = math.sqrt(square)
    low, high = max(low, (-lean + root) / (2.0 * bend)), min(high, (-lean - root) / (2.0 * bend))
    total = 0.0
    for k in range(LINE.shape[0] if high > low else 0):
        q = 0.5 * (high + low) + 0.5 * (high - low) * LINE[k, 0]
        chord = math.sqrt(max(0.0, reach * reach - (q - q0) * (q - q0)))
        cone = math.sqrt(max(0.0, tangent * tangent - q * q))
        a, b, c = conic(q, d, e1, e2, image, square_radius, hn, ha, hb)
        root = math.sqrt(max(0.0, b * b - a * c))
        left, right = max(p0 - chord, -cone, (-b - root) / a), min(p0 + chord, cone, (-b + root) / a)
        if right > left:
            p = 0.5 * (left + right)
            stretch = 1.0 + p * p + q * q
            # Radiance is conserved: the measure is area, the cosine with the sample's normal, solid angle.
            total += LINE[k, 1] * (right - left) * abs(d[2] + p * e1[2]) / (stretch * stretch)
    return total * (high - low)  # type: ignore[no-any-return]


@kernel(nogil=True)
def light_shares(
    centres: Floats,
    axes: Floats,
    sizes: Floats,
    scene: SceneArrays,
    half: float,
    light: SlitImage,
    transmits: bool,
    bundle: Floats,
    result: Floats,
) -> None:
    """Multiply `result` (n,) by the mean relative radiance of each detector's rays, 0 for those that miss a mirror.

    Over those rays of a `bundle` from pupil to hole that the detector accepts; a detector that accepts none of them keeps its
    value. `half` is the half side of a mirror.
    """
    accepted, carried = np.zeros(result.size), np.zeros(result.size)
    for j in range(bundle.shape[1]):
        for sign in (1.0, -1.0):
            u, v = sign * sizes[1] * bundle[HOLE_U, j], sign * sizes[1] * bundle[HOLE_V, j]
            for other in (1.0, -1.0):
                a, b = other * bundle[PUPIL_A, j], other * bundle[PUPIL_B, j]
                add_light(centres, axes, sizes, scene, half, light, transmits, result, u, v, a, b, accepted, carried)
    for n in range(result.size):
        if accepted[n] > 0.0:
            result[n] *= carried[n] / accepted[n]


@kernel()
def add_light(
    centres: Floats,
    axes: Floats,
    sizes: Floats,
    scene: SceneArrays,
    half: float,
    light: SlitImage,
    transmits: bool,
    result: Floats,
    u: float,
    v: float,
    a: float,
    b: float,
    accepted: Floats,
    carried: Floats,
) -> None:
    """Add the ray from (a, b) of the pupil to (u, v) of the hole to what the detectors accept, and to what it carries."""
    low = high = u
    for k in range(light.edges.shape[0]):
        low, high = cut_ray_chord(light.edges, k, a, b, v, low, high)
    if low > high:
        return
    pupil = scene.pupil
    x = pupil[0, 0] + a * pupil[1, 0] + b * pupil[2, 0]
    y = pupil[0, 1] + a * pupil[1, 1] + b * pupil[2, 1]
    z = pupil[0, 2] + a * pupil[1, 2] + b * pupil[2, 2]
    lx, ly, lz = x - u, y - v, z
    shrink = 1.0 / math.sqrt(lx * lx + ly * ly + lz * lz)
    lx, ly, lz = lx * shrink, ly * shrink, lz * shrink
    gain = max(lz, 0.0) * (lx * pupil[3, 0] + ly * pupil[3, 1] + lz * pupil[3, 2]) * shrink * shrink
    passing = gain
    for m in range(3):
        if scene.missed[m] > 0.0:
            near, far = image_coordinates(scene.images[m], u, v, 0.0), image_coordinates(scene.images[m], x, y, z)
            passing = passing if reaches_over(near, far, half) else 0.0
    if passing > 0.0 and not light.slit.even:
        passing *= relative_radiance(light, a, b, u, v)
    radius, least = sizes[0], math.sqrt(1.0 - sizes[2] * sizes[2])
    wx, wy, wz = -lx, -ly, -lz if transmits else lz
    for n in range(result.size):
        cosine = wx * axes[n, 0] + wy * axes[n, 1] + wz * axes[n, 2]
        if result[n] == 0.0 or cosine < least:
            continue
        dx, dy, dz = centres[n, 0] - u, centres[n, 1] - v, centres[n, 2]
        step = (dx * axes[n, 0] + dy * axes[n, 1] + dz * axes[n, 2]) / cosine
        dx, dy, dz = dx - step * wx, dy - step * wy, dz - step * wz
        if dx * dx + dy * dy + dz * dz <= radius * radius:
            accepted[n] += gain
            carried[n] += passing
