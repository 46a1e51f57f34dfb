"""Flux on the central field and uniformity for many sets of deviations of the illumination unit at once (paper, Table 1).

No random ray: what a point of the exit pupil lights of the field is a quadrilateral, the slit's image as that point sees it, so
its part of each cell of the field has a closed form, in focus or not. From the centroid of this part the radiance of the exit
pupil is integrated by a product rule, each ray traced back to the arc. So the result is smooth in the deviations, and
differences of a ten-thousandth are real.
"""

import math
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.illumination.adjoint import ROWS, TILE, WEIGHT, U, V, X, Z, emission_per_mm3_sr, weigh_tile
from goniotwin.twin.optics.illumination.elements import along_axes
from goniotwin.twin.optics.illumination.slit_image import cut_polygon
from goniotwin.twin.optics.illumination.unit import OUTPUT, SLIT, IlluminationUnit
from goniotwin.twin.optics.kernel import kernel, thread_count

RINGS, SPOKES = 4, 8
CHUNK = 256
CORNERS = 4


def pupil_nodes(rings: int = RINGS, spokes: int = SPOKES) -> Floats:
    """Points of the unit disc and their weights (n, 3), which sum to 1: Gauss-Legendre over the square of the radius."""
    places, weights = np.polynomial.legendre.leggauss(rings)
    radii = np.sqrt(0.5 * (places + 1.0))
    turns = 2.0 * np.pi * (np.arange(spokes)[None, :] + 0.5 * (np.arange(rings)[:, None] % 2)) / spokes
    points = radii[:, None] * np.cos(turns), radii[:, None] * np.sin(turns)
    return np.stack([each.ravel() for each in (*points, np.repeat(0.5 * weights / spokes, spokes))], axis=1)


NODES = pupil_nodes()


@kernel(nogil=True)
def _fill_fluxes(all_frames: Floats, sizes: Floats, nodes: Floats, side: float, cells: int, result: Floats) -> None:
    """Fill `result` (n, 2): sum and least of the weights of the cells, in mm^2 / mm, for frames (n, 5, 4, 3)."""
    cell, least_corner = side / cells, -0.5 * side
    edges, points, cut = np.empty((CORNERS, 3)), np.empty((12, 2)), np.empty((12, 2))
    images, weights = np.empty((CORNERS, 3)), np.empty(cells * cells)
    tile, areas, places, count = np.empty(ROWS * TILE), np.empty(TILE), np.empty(TILE, np.int64), 0
    for n in range(all_frames.shape[0]):
        frames = all_frames[n]
        _fill_images(frames, sizes, images)
        weights[:] = 0.0
        for m in range(nodes.shape[0]):
            a, b = nodes[m, 0], nodes[m, 1]
            _fill_edges(frames, sizes, images, a, b, edges)
            whole = _within(edges, least_corner, least_corner, side)
            for i in range(cells):
                for j in range(cells):
                    x0, z0 = least_corner + i * cell, least_corner + j * cell
                    area, x, z = cell * cell, x0 + 0.5 * cell, z0 + 0.5 * cell
                    if not (whole or _within(edges, x0, z0, cell)):
                        area, x, z = _lit_part(edges, x0, z0, cell, points, cut)
                    if area > 0.0:
                        tile[count + U], tile[count + V] = sizes[7] * a, sizes[7] * b
                        tile[count + X], tile[count + Z] = x, z
                        areas[count], places[count] = area * nodes[m, 2], i * cells + j
                        count += 1
                    if count == TILE:
                        _add_rays(tile, count, frames, sizes, areas, places, weights)
                        count = 0
        _add_rays(tile, count, frames, sizes, areas, places, weights)
        count = 0
        total, least = 0.0, math.inf
        for place in range(cells * cells):
            total += weights[place]
            least = min(least, weights[place])
        result[n, 0], result[n, 1] = total, least


@kernel()
def _fill_images(frames: Floats, sizes: Floats, images: Floats) -> None:
    """Fill `images` (4, 3) with the points to which the condenser images the slit's corners, in its own frame."""
    for k in range(CORNERS):
        s, t = (sizes[8] if k == 1 or k == 2 else -sizes[8]), (sizes[9] if k >= 2 else -sizes[9])
        px = frames[SLIT, 0, 0] + s * frames[SLIT, 1, 0] + t * frames[SLIT, 3, 0] - frames[OUTPUT, 0, 0]
        py = frames[SLIT, 0, 1] + s * frames[SLIT, 1, 1] + t * frames[SLIT, 3, 1] - frames[OUTPUT, 0, 1]
        pz = frames[SLIT, 0, 2] + s * frames[SLIT, 1, 2] + t * frames[SLIT, 3, 2] - frames[OUTPUT, 0, 2]
        x, y, z = along_axes(frames, OUTPUT, px, py, pz)
        larger = sizes[6] / (sizes[6] + y)
        images[k, 0], images[k, 1], images[k, 2] = larger * x, larger * y, larger * z


@kernel()
def _fill_edges(frames: Floats, sizes: Floats, images: Floats, a: float, b: float, edges: Floats) -> None:
    """Fill `edges` (4, 3) of what (a, b) of the pupil's unit disc lights of the field: inside where e0 + e1 x + e2 z >= 0.

    Each point of the pupil has its own: the slit's image is before or behind the field where an element is off along the light.
    """
    u, v = sizes[7] * a, sizes[7] * b
    px = frames[OUTPUT, 0, 0] + u * frames[OUTPUT, 1, 0] + v * frames[OUTPUT, 3, 0]
    py = frames[OUTPUT, 0, 1] + u * frames[OUTPUT, 1, 1] + v * frames[OUTPUT, 3, 1]
    pz = frames[OUTPUT, 0, 2] + u * frames[OUTPUT, 1, 2] + v * frames[OUTPUT, 3, 2]
    corners = np.empty((CORNERS, 2))
    for k in range(CORNERS):
        p, q, r = images[k, 0] - u, images[k, 1], images[k, 2] - v
        along = p * frames[OUTPUT, 1, 1] + q * frames[OUTPUT, 2, 1] + r * frames[OUTPUT, 3, 1]
        step = (sizes[12] - py) / along
        corners[k, 0] = px + step * (p * frames[OUTPUT, 1, 0] + q * frames[OUTPUT, 2, 0] + r * frames[OUTPUT, 3, 0])
        corners[k, 1] = pz + step * (p * frames[OUTPUT, 1, 2] + q * frames[OUTPUT, 2, 2] + r * frames[OUTPUT, 3, 2])
    for k in range(CORNERS):
        # Inside of an edge is the side of the corner opposite to it.
        x0, z0, x1, z1 = corners[k, 0], corners[k, 1], corners[(k + 1) % CORNERS, 0], corners[(k + 1) % CORNERS, 1]
        across, along = z0 - z1, x1 - x0
        x2, z2 = corners[(k + 2) % CORNERS, 0], corners[(k + 2) % CORNERS, 1]
        sign = 1.0 if across * (x2 - x0) + along * (z2 - z0) >= 0.0 else -1.0
        edges[k, 1], edges[k, 2] = sign * across, sign * along
        edges[k, 0] = -sign * (across * x0 + along * z0)


@kernel()
def _within(edges: Floats, x: float, z: float, side: float) -> bool:
    """Whether a square with its least corner at (x, z) is inside all edges."""
    for k in range(CORNERS):
        least = edges[k, 0] + edges[k, 1] * x + edges[k, 2] * z
        if least + side * (min(edges[k, 1], 0.0) + min(edges[k, 2], 0.0)) < 0.0:
            return False
    return True


@kernel()
def _lit_part(edges: Floats, x: float, z: float, side: float, points: Floats, cut: Floats) -> tuple[float, float, float]:
    """Area and centroid of the part inside all edges of a square with its least corner at (x, z); room for its corners."""
    count = CORNERS
    for k in range(CORNERS):
        points[k, 0] = x + (side if k == 1 or k == 2 else 0.0)
        points[k, 1] = z + (side if k >= 2 else 0.0)
    for k in range(CORNERS):
        count = cut_polygon(points, count, cut, edges[k, 0], edges[k, 1], edges[k, 2])
    area = middle_x = middle_z = 0.0
    for k in range(1, count - 1):
        x0, z0 = points[0, 0], points[0, 1]
        ax, az, bx, bz = points[k, 0] - x0, points[k, 1] - z0, points[k + 1, 0] - x0, points[k + 1, 1] - z0
        part = 0.5 * (ax * bz - az * bx)
        area += part
        middle_x += part * (x0 + (ax + bx) / 3.0)
        middle_z += part * (z0 + (az + bz) / 3.0)
    if not area > 0.0:
        return 0.0, 0.0, 0.0
    return area, middle_x / area, middle_z / area


@kernel()
def _add_rays(tile: Floats, count: int, frames: Floats, sizes: Floats, areas: Floats, places: Ints, weights: Floats) -> None:
    """Add `count` rays of a tile, times the areas that they stand for, to the weights of their cells."""
    weigh_tile(tile, count, frames, sizes)
    for n in range(count):
        weights[places[n]] += areas[n] * tile[n + WEIGHT]


def field_fluxes(unit: IlluminationUnit, deviations: Floats, cells: int = 5) -> tuple[Floats, Floats]:
    """Flux (n,) on the unit's field, in the lamp's unit, and uniformity (n,) for n sets of `deviations` (n, 6, 6).

    The sets replace the unit's own deviations: of arc, reflector, input condenser, slit, output condenser and the whole unit,
    each with three angles in deg and three shifts in mm, as a `Deviation`. The uniformity is the least irradiance of `cells` x
    `cells` over the mean; NaN without light. Independent of the number of threads. Raises ValueError for another shape, values
    that are not finite, and a number of cells out of 1 to 100.
    """
    if not 1 <= cells <= 100:
        raise ValueError(f"cells is {cells}: give 1 to 100")
    sums = np.empty((len(deviations), 2))
    frames = unit.frames_of(np.asarray(deviations, dtype=np.float64))

    def fill(first: int) -> None:
        piece = slice(first, first + CHUNK)
        _fill_fluxes(frames[piece], unit.sizes, NODES, unit.field_side_mm, cells, sums[piece])

    starts = range(0, len(frames), CHUNK)
    if len(starts) > 1:
        with ThreadPoolExecutor(thread_count()) as pool:
            list(pool.map(fill, starts))
    else:
        for first in starts:
            fill(first)
    scale = emission_per_mm3_sr(unit) * math.pi * unit.exit_pupil_radius_mm**2
    mean = sums[:, 0] / cells**2
    uniformity = np.divide(sums[:, 1], mean, out=np.full(len(frames), np.nan), where=mean > 0.0)
    return scale * sums[:, 0], uniformity
