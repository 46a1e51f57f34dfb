"""What a mirror smaller than the beam leaves of the exit pupil, as seen from each point of the hole (optics.md, section 7).

A ray from a point (u, v) of the hole to a point (a, b) of the pupil passes an edge of an unfolded mirror on its inner side
where an expression is positive that is linear in either point, as for the edges of the slit's image. So from a point of the
hole the pupil is a disc without what is beyond some straight lines: its area, mean and second moments are known in closed form.
They are a property of the scene and not of a detector, and smooth over the hole, because the pupil is not sharp in a mirror's
plane: polynomials in (u, v), fitted to the nodes of a grid. The moments of a detector's rays take them as weights
(twin.optics.fast.aperture), and seven rays follow from these as from those of a whole pupil.
"""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.detector_block import CLIPPED, TERMS
from goniotwin.twin.optics.geometry.scene import SceneArrays
from goniotwin.twin.optics.illumination.slit_image import cut_polygon
from goniotwin.twin.optics.kernel import kernel

DEGREE = 4
Terms = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float, float, float]
SIDE = 6
"""Nodes along a side of the hole."""
CORNERS = 20
POOR_FIT = 0.01
"""Largest mean error of the fitted share, of its mean: beyond, the edge is too sharp for a polynomial."""


def clip_grid() -> Floats:
    """Nodes over the hole, from -1 to 1 along its sides, and their weights, which sum to 1 (n, 3)."""
    places, weights = np.polynomial.legendre.leggauss(SIDE)
    x, y = np.meshgrid(places, places, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), 0.25 * np.outer(weights, weights).ravel()], axis=1)


def clip_fit(grid: Floats) -> Floats:
    """Matrix (TERMS, n) from values at the nodes of `grid` to the terms of the polynomial of `clip_value`."""
    powers = [(i, j) for i in range(DEGREE + 1) for j in range(DEGREE + 1 - i)]
    root = np.sqrt(grid[:, 2])
    terms = np.stack([grid[:, 0] ** i * grid[:, 1] ** j for i, j in powers], axis=1)
    return np.ascontiguousarray(np.linalg.pinv(root[:, None] * terms) * root)


GRID = clip_grid()
FIT = clip_fit(GRID)


@kernel(forceinline=True)
def clip_terms(clip: Floats, m: int) -> Terms:
    """Terms of moment m of a `clip` as numbers: outside a loop, so that it does not read them again each time."""
    return (
        clip[m, 0],
        clip[m, 1],
        clip[m, 2],
        clip[m, 3],
        clip[m, 4],
        clip[m, 5],
        clip[m, 6],
        clip[m, 7],
        clip[m, 8],
        clip[m, 9],
        clip[m, 10],
        clip[m, 11],
        clip[m, 12],
        clip[m, 13],
        clip[m, 14],
    )


@kernel(forceinline=True)
def clip_value(c: Terms, x: float, y: float) -> float:
    """Moment of what is left of the pupil, seen from (x, y) of the hole, from -1 to 1."""
    first = c[0] + y * (c[1] + y * (c[2] + y * (c[3] + y * c[4])))
    second = c[5] + y * (c[6] + y * (c[7] + y * c[8]))
    return first + x * (second + x * (c[9] + y * (c[10] + y * c[11]) + x * (c[12] + y * c[13] + x * c[14])))


@kernel()
def fill_clip(scene: SceneArrays, half: float, spot: float, clip: Floats) -> bool:
    """Fill `clip` (CLIPPED, TERMS) for mirrors of half side `half`, a hole of half side `spot`, mm; whether it is good enough.

    Each row is the polynomial of one moment of what is left, over the whole disc's area: share, a, b, a a, a b, b b.
    """
    values, points, cut = np.empty((GRID.shape[0], CLIPPED)), np.empty((CORNERS, 2)), np.empty((CORNERS, 2))
    for n in range(GRID.shape[0]):
        count = left_polygon(scene, half, spot * GRID[n, 0], spot * GRID[n, 1], points, cut)
        if count < 0:
            return False
        fill_disc_moments(points, count, values[n])
    for m in range(CLIPPED):
        for term in range(TERMS):
            clip[m, term] = 0.0
            for n in range(GRID.shape[0]):
                clip[m, term] += FIT[term, n] * values[n, m]
    error, share, terms = 0.0, 0.0, clip_terms(clip, 0)
    for n in range(GRID.shape[0]):
        error += GRID[n, 2] * abs(clip_value(terms, GRID[n, 0], GRID[n, 1]) - values[n, 0])
        share += GRID[n, 2] * values[n, 0]
    return error < POOR_FIT * share


@kernel(forceinline=True)
def linear_coordinates(
    image: Floats, axis: int, pupil: Floats
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Coordinate along an axis of a mirror's image, from its centre: constant and slopes over the hole and over the pupil."""
    ex, ey, ez = image[axis, 0], image[axis, 1], image[axis, 2]
    own = image[0, 0] * ex + image[0, 1] * ey + image[0, 2] * ez
    centre = pupil[0, 0] * ex + pupil[0, 1] * ey + pupil[0, 2] * ez
    along_u = pupil[1, 0] * ex + pupil[1, 1] * ey + pupil[1, 2] * ez
    along_v = pupil[2, 0] * ex + pupil[2, 1] * ey + pupil[2, 2] * ez
    return (-own, ex, ey), (centre - own, along_u, along_v)


@kernel()
def left_polygon(scene: SceneArrays, half: float, u: float, v: float, points: Floats, cut: Floats) -> int:
    """Fill `points` with the square about the pupil's unit disc within the mirrors' edges, seen from (u, v) of the hole.

    Returns the number of its corners; -1 where a mirror is not between hole and pupil.
    """
    for corner in range(4):
        points[corner, 0] = 1.0 if corner == 0 or corner == 3 else -1.0
        points[corner, 1] = 1.0 if corner < 2 else -1.0
    count = 4
    for m in range(3):
        if scene.missed[m] > 0.0:
            (hn, hnu, hnv), (gn, gna, gnb) = linear_coordinates(scene.images[m], 1, scene.pupil)
            near = hn + hnu * u + hnv * v
            if not near * gn < 0.0:
                return -1
            side = half if near > gn else -half
            for axis in range(2, 4):
                (h, hu, hv), (g, ga, gb) = linear_coordinates(scene.images[m], axis, scene.pupil)
                beside = h + hu * u + hv * v
                for edge in range(2):
                    # As in `reaches_over`, for one of the two opposite edges.
                    sign = 1.0 if edge == 0 else -1.0
                    offset = side * (near - gn) + sign * (near * g - gn * beside)
                    a = sign * (near * ga - gna * beside) - side * gna
                    b = sign * (near * gb - gnb * beside) - side * gnb
                    if offset < math.sqrt(a * a + b * b):
                        count = cut_polygon(points, count, cut, offset, a, b)
    return count


@kernel()
def fill_disc_moments(points: Floats, count: int, result: Floats) -> None:
    """Fill `result` (CLIPPED,) with the moments of a polygon's part within the unit disc, over the area of the disc.

    The polygon is convex, its first `count` of `points` are counter-clockwise. The sum over its sides of what is between each
    and the origin: a triangle where it is within the disc, else a sector.
    """
    for m in range(CLIPPED):
        result[m] = 0.0
    for n in range(count):
        x, y = points[n, 0], points[n, 1]
        dx, dy = points[(n + 1) % count, 0] - x, points[(n + 1) % count, 1] - y
        square, first, last = dx * dx + dy * dy, 1.0, 1.0
        if square == 0.0:
            continue
        middle = -(x * dx + y * dy) / square
        inside = middle * middle - (x * x + y * y - 1.0) / square
        if inside > 0.0:
            low, high = max(0.0, middle - math.sqrt(inside)), min(1.0, middle + math.sqrt(inside))
            if high > low:
                first, last = low, high
        for part in range(3):
            start, end = (
                (0.0 if part == 0 else first if part == 1 else last),
                (first if part == 0 else last if part == 1 else 1.0),
            )
            if start < end:
                add_part(x + start * dx, y + start * dy, x + end * dx, y + end * dy, part != 1, result)
    for m in range(CLIPPED):
        result[m] /= math.pi


@kernel()
def add_part(x: float, y: float, nx: float, ny: float, sector: bool, result: Floats) -> None:
    """Add the moments of the triangle of the origin, (x, y) and (nx, ny), or of the sector of the unit disc between them."""
    if sector:
        one, other = 1.0 / math.sqrt(x * x + y * y), 1.0 / math.sqrt(nx * nx + ny * ny)
        x, y, nx, ny = x * one, y * one, nx * other, ny * other
        angle = math.atan2(x * ny - y * nx, x * nx + y * ny)
        twist = 0.125 * (nx * ny - x * y)
        result[0] += 0.5 * angle
        result[1] += (ny - y) / 3.0
        result[2] += (x - nx) / 3.0
        result[3] += 0.125 * angle + twist
        result[4] += 0.125 * (ny * ny - y * y)
        result[5] += 0.125 * angle - twist
    else:
        area = 0.5 * (x * ny - y * nx)
        result[0] += area
        result[1] += area * (x + nx) / 3.0
        result[2] += area * (y + ny) / 3.0
        result[3] += area * (x * x + x * nx + nx * nx) / 6.0
        result[4] += area * (2.0 * x * y + x * ny + nx * y + 2.0 * nx * ny) / 12.0
        result[5] += area * (y * y + y * ny + ny * ny) / 6.0
