"""The slit's image on the sample: which rays from the exit pupil through the hole of the frame carry light, and how much.

The output condenser images the slit onto the sample: a lit square of 7 mm about a hole of 5 mm. A tilt of a mirror or of the
unit moves it (twice the tilt times the path, for a mirror), and part of the hole stays dark. A ray passes on the inner side of
an edge of the slit if the determinant of the two lines is positive: for an ideal lens that is linear in the point of the exit
pupil and linear in the point of the hole, so that four small matrices are the exact image of the slit, sharp or not.

Within the image the radiance is relative to that of the unit without deviations, along the ray through the same points of slit
and exit pupil: 1 unless an element within the unit is off. So a unit without deviations has an evenly lit hole and a uniform
exit pupil, which is what the estimators of the light on the detectors begin with, wherever the mirrors carry it. Elsewhere the
ray is traced back to the arc, directly and by the reflector (`lit_length`).
"""

import math
from dataclasses import replace
from functools import lru_cache
from itertools import permutations
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION, Deviation
from goniotwin.twin.optics.geometry.instrument import Instrument
from goniotwin.twin.optics.geometry.scene import SCENES_KEPT, Scene
from goniotwin.twin.optics.illumination.elements import lit_length, to_plane
from goniotwin.twin.optics.illumination.unit import OUTPUT, SLIT, IlluminationUnit, unit_of
from goniotwin.twin.optics.kernel import kernel

STEEP = 1e-9
"""An edge with a smaller quotient of its slopes is taken as parallel: the ends of the lit part of the hole limit it."""
ALONG_U, ALONG_V = 0, 1
"""Order of `chords`: along u at a given v, along v at a given u."""
LINES = 4
"""Number of edges, each of which may limit either end of a chord."""


EVERYWHERE = np.zeros((LINES, 3, 4))
"""Edges that no ray is beyond."""
EVERYWHERE[:, 0, 0] = 1.0


class Slit(NamedTuple):
    """The illumination unit's elements, in the frame of its output condenser: all that its image needs besides the pupil.

    `edges` (4, 3, 4) of the slit, see `slit_edges`; `frames` (5, 4, 3) of the elements, `straight` those without deviations;
    `sizes` (13,) as those of `IlluminationUnit`. `even`: the radiance is 1 within the edges.
    """

    edges: Floats
    frames: Floats
    straight: Floats
    sizes: Floats
    even: bool


class SlitImage(NamedTuple):
    """Image of the slit at one pose, in the frame of a scene; points (u, v) of the hole in mm, (a, b) of the pupil's unit disc.

    `edges` (4, 3, 3): a ray from (a, b) to (u, v) passes inside edge k if (1, a, b) edges[k] (1, u, v) >= 0, which is about the
    distance from the edge in mm. `chords` (2, 10, 2): the lit part of the hole, as seen from the pupil's centre, see
    `_clear_chords`. `hole` (3, 3): the hole's centre and its two axes in the output condenser's frame.

    `everywhere`: no ray of pupil and hole is beyond an edge.
    """

    slit: Slit
    edges: Floats
    chords: Floats
    hole: Floats
    everywhere: bool


@lru_cache(maxsize=SCENES_KEPT)
def slit_image(instrument: Instrument, scene: Scene, height_mm: float = 0.0) -> SlitImage:
    """Image of the slit in a scene of an instrument, for a hole `height_mm` above the sample. Shared: do not write to it."""
    return place_slit(slit_of(instrument), scene.pupil, 0.5 * instrument.spot_side_mm, height_mm, *empty_image())


def slit_of(instrument: Instrument) -> Slit:
    """Slit of an instrument. Its illumination unit as a whole moves the pupil, and is in the scene."""
    slit = _elements(
        instrument.pupil_radius_mm,
        instrument.pupil_distance_mm,
        instrument.spot_side_mm,
        tuple((name, each) for name, each in instrument.illumination.items() if each != NO_DEVIATION and name != "unit"),
    )
    return slit._replace(edges=EVERYWHERE) if instrument.lit_everywhere else slit


@lru_cache(maxsize=SCENES_KEPT)
def _elements(
    pupil_radius_mm: float, pupil_distance_mm: float, spot_side_mm: float, deviations: tuple[tuple[str, Deviation], ...]
) -> Slit:
    distance = 0.25 * pupil_distance_mm
    instrument = Instrument(
        pupil_radius_mm=pupil_radius_mm,
        pupil_to_mirror_mm=pupil_distance_mm - 3.0 * distance,
        mirror_distance_mm=distance,
        spot_side_mm=spot_side_mm,
    )
    unit = unit_of(replace(instrument, illumination=dict(deviations)))
    frames, straight = _within_condenser(unit.frames), _within_condenser(unit_of(instrument).frames)
    return Slit(slit_edges(frames[SLIT], unit), frames, straight, unit.sizes, not deviations)


def _within_condenser(frames: Floats) -> Floats:
    """Frames (5, 4, 3) in that of the output condenser."""
    moved = frames.copy()
    moved[:, 0] -= frames[OUTPUT, 0]
    return np.ascontiguousarray(moved @ frames[OUTPUT, 1:].T)


def slit_edges(slit: Floats, unit: IlluminationUnit) -> Floats:
    """Edges (4, 3, 4) of a slit with this frame (4, 3): inside where (1, a, b) edges[k] (1, x, y, z) >= 0.

    (x, y, z) is a point beyond the output condenser in its frame. The condenser images it to a point behind itself, at the
    homogeneous coordinates (f - y, f x, f y, f z); whether the line from there to the point of the pupil passes an edge inside
    is the determinant of the four points.
    """
    focal, radius, width, height = unit.sizes[6], unit.exit_pupil_radius_mm, unit.sizes[8], unit.sizes[9]
    turn = ((-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0))
    corners = np.array([np.append(1.0, slit[0] + s * width * slit[1] + t * height * slit[3]) for s, t in turn])
    lens = np.zeros((3, 4))
    lens[0, 0], lens[1, 1], lens[2, 3] = 1.0, radius, radius
    conjugate = focal * np.eye(4)
    conjugate[2, 0] = -1.0
    edges = np.empty((LINES, 3, 4))
    for k in range(LINES):
        joined = np.einsum("ijkl,k,l->ij", _DETERMINANT, corners[k], corners[(k + 1) % LINES])
        inside = math.copysign(1.0, joined[0] @ np.append(1.0, slit[0]))
        # The point behind the condenser has a negative first coordinate: the sample is beyond the focus.
        edges[k] = -inside * (lens @ joined @ conjugate.T)
        edges[k] /= math.hypot(edges[k, 0, 1], edges[k, 0, 3])
    return edges


def _determinant() -> Floats:
    """Signs (4, 4, 4, 4) of the permutations."""
    signs = np.zeros((4, 4, 4, 4))
    for order in permutations(range(4)):
        signs[order] = round(np.linalg.det(np.eye(4)[list(order)]))
    return signs


_DETERMINANT = _determinant()


@kernel()
def empty_image() -> tuple[Floats, Floats, Floats]:
    """Arrays for `place_slit`."""
    return np.empty((LINES, 3, 3)), np.empty((2, 2 + 2 * LINES, 2)), np.empty((3, 3))


@kernel()
def place_slit(slit: Slit, pupil: Floats, half: float, height: float, edges: Floats, chords: Floats, hole: Floats) -> SlitImage:
    """Image of a slit for a `pupil` (4, 3) as in a `Scene`, in the arrays of `empty_image`.

    `half` is half the hole's side, `height` its height above the sample, mm.
    """
    radius = math.sqrt(pupil[1, 0] ** 2 + pupil[1, 1] ** 2 + pupil[1, 2] ** 2)
    for c in range(3):
        # The frame of the condenser: x and z along the pupil's axes, y along the light.
        row, scale = (1, 1.0 / radius) if c == 0 else (3, -1.0) if c == 1 else (2, 1.0 / radius)
        x, y, z = scale * pupil[row, 0], scale * pupil[row, 1], scale * pupil[row, 2]
        hole[0, c] = (height - pupil[0, 2]) * z - pupil[0, 0] * x - pupil[0, 1] * y
        hole[1, c], hole[2, c] = x, y
    everywhere = True
    for k in range(LINES):
        for i in range(3):
            for j in range(3):
                total = slit.edges[k, i, 0] if j == 0 else 0.0
                for c in range(3):
                    total += slit.edges[k, i, 1 + c] * hole[j, c]
                edges[k, i, j] = total
        for corner in range(4):
            u, v = (half if corner & 1 else -half), (half if corner & 2 else -half)
            a = edges[k, 1, 0] + edges[k, 1, 1] * u + edges[k, 1, 2] * v
            b = edges[k, 2, 0] + edges[k, 2, 1] * u + edges[k, 2, 2] * v
            if edges[k, 0, 0] + edges[k, 0, 1] * u + edges[k, 0, 2] * v < math.sqrt(a * a + b * b):
                everywhere = False
    _clear_chords(half, chords)
    if not everywhere:
        _fill_chords(edges, half, chords)
    return SlitImage(slit, edges, chords, hole, everywhere)


@kernel()
def _clear_chords(half: float, chords: Floats) -> None:
    """Fill `chords` (2, 10, 2) for a hole that is lit everywhere.

    Row 0 has the ends of the lit part in the direction across the chord; rows 1 to 4 an offset and a slope of each line that
    limits a chord's lower end, rows 5 to 8 the same for its upper end. The last row has the ends of what any point of the pupil
    lights.
    """
    last = 1 + 2 * LINES
    for across in range(2):
        chords[across, 0, 0] = chords[across, last, 0] = -half
        chords[across, 0, 1] = chords[across, last, 1] = half
        for line in range(LINES):
            chords[across, 1 + line, 0], chords[across, 1 + line, 1] = -math.inf, 0.0
            chords[across, 1 + LINES + line, 0], chords[across, 1 + LINES + line, 1] = math.inf, 0.0


@kernel()
def _fill_chords(edges: Floats, half: float, chords: Floats) -> None:
    """Limit `chords` to the hole's part within the edges, as seen from the middle of the pupil, see `_clear_chords`."""
    last = 1 + 2 * LINES
    points, cut = np.empty((2 * LINES + 4, 2)), np.empty((2 * LINES + 4, 2))
    for row in (0, last):
        count = _lit_polygon(edges, half, row == last, points, cut)
        for across in range(2):
            low, high = math.inf, -math.inf
            for n in range(count):
                place = points[n, 1 - across]
                low, high = min(low, place), max(high, place)
            chords[across, row, 0], chords[across, row, 1] = low, high
    for across in range(2):
        for k in range(LINES):
            along, beside = edges[k, 0, 1 + across], edges[k, 0, 2 - across]
            if abs(along) > STEEP * abs(beside):
                row = 1 + k if along > 0.0 else 1 + LINES + k
                chords[across, row, 0], chords[across, row, 1] = -edges[k, 0, 0] / along, -beside / along


@kernel()
def _lit_polygon(edges: Floats, half: float, blurred: bool, points: Floats, cut: Floats) -> int:
    """Fill `points` (n, 2) with the corners of the hole's part within the edges; their number.

    From the middle of the pupil, or with `blurred` with all that some point of the pupil lights.
    """
    count = 4
    for corner in range(4):
        points[corner, 0] = half if corner == 1 or corner == 2 else -half
        points[corner, 1] = half if corner >= 2 else -half
    for k in range(LINES):
        offset = edges[k, 0, 0]
        if blurred:
            widest = 0.0
            for corner in range(4):
                u, v = (half if corner & 1 else -half), (half if corner & 2 else -half)
                a = edges[k, 1, 0] + edges[k, 1, 1] * u + edges[k, 1, 2] * v
                b = edges[k, 2, 0] + edges[k, 2, 1] * u + edges[k, 2, 2] * v
                widest = max(widest, math.sqrt(a * a + b * b))
            offset += widest
        count = cut_polygon(points, count, cut, offset, edges[k, 0, 1], edges[k, 0, 2])
    return count


def lit_corners(instrument: Instrument, scene: Scene) -> Floats:
    """Corners (n, 2) in mm of the hole's lit part in a scene, in order, as seen from the middle of the exit pupil.

    None of them where no light reaches the hole. The blur of its edges is 0.03 mm.
    """
    points, cut = np.empty((2 * LINES + 4, 2)), np.empty((2 * LINES + 4, 2))
    count = _lit_polygon(slit_image(instrument, scene).edges, 0.5 * instrument.spot_side_mm, False, points, cut)
    return points[:count]


@kernel()
def cut_polygon(points: Floats, count: int, cut: Floats, a: float, b: float, c: float) -> int:
    """Replace a polygon, the first `count` of `points` (n, 2), by its part where a + b u + c v >= 0; its number of corners.

    `cut` is room for as many points (Sutherland, Hodgman 1974).
    """
    kept = 0
    for n in range(count):
        u, v = points[n, 0], points[n, 1]
        nu, nv = points[(n + 1) % count, 0], points[(n + 1) % count, 1]
        here, there = a + b * u + c * v, a + b * nu + c * nv
        if here >= 0.0:
            cut[kept, 0], cut[kept, 1] = u, v
            kept += 1
        if (here >= 0.0) != (there >= 0.0):
            share = here / (here - there)
            cut[kept, 0], cut[kept, 1] = u + share * (nu - u), v + share * (nv - v)
            kept += 1
    for n in range(kept):
        points[n, 0], points[n, 1] = cut[n, 0], cut[n, 1]
    return kept


Lines = tuple[float, float, float, float, float, float, float, float, float, float, float, float, float, float, float, float]


@kernel(forceinline=True)
def chord_lines(chords: Floats, across: int) -> Lines:
    """Lines of `cut_chord` as numbers: outside a loop, so that it does not read them again each time."""
    return (
        chords[across, 1, 0],
        chords[across, 1, 1],
        chords[across, 2, 0],
        chords[across, 2, 1],
        chords[across, 3, 0],
        chords[across, 3, 1],
        chords[across, 4, 0],
        chords[across, 4, 1],
        chords[across, 5, 0],
        chords[across, 5, 1],
        chords[across, 6, 0],
        chords[across, 6, 1],
        chords[across, 7, 0],
        chords[across, 7, 1],
        chords[across, 8, 0],
        chords[across, 8, 1],
    )


@kernel()
def is_cut(chords: Floats) -> bool:
    """Whether an edge may limit a chord."""
    for line in range(LINES):
        if chords[ALONG_U, 1 + line, 0] > -math.inf or chords[ALONG_U, 1 + LINES + line, 0] < math.inf:
            return True
    return False


@kernel(forceinline=True)
def cut_chord(lines: Lines, place: float, low: float, high: float) -> tuple[float, float]:
    """Lit part of a chord of the hole from `low` to `high`, along u at v = `place`, or along v at u = `place`."""
    # Plain comparisons, so that a loop over detectors is vectorised.
    a, b = lines[0] + lines[1] * place, lines[2] + lines[3] * place
    c, d = lines[4] + lines[5] * place, lines[6] + lines[7] * place
    a, c = (a if a > b else b), (c if c > d else d)
    a = a if a > c else c
    low = low if low > a else a
    a, b = lines[8] + lines[9] * place, lines[10] + lines[11] * place
    c, d = lines[12] + lines[13] * place, lines[14] + lines[15] * place
    a, c = (a if a < b else b), (c if c < d else d)
    a = a if a < c else c
    return low, (high if high < a else a)


@kernel(forceinline=True)
def cut_ray_chord(edges: Floats, k: int, a: float, b: float, v: float, low: float, high: float) -> tuple[float, float]:
    """Part along u of a chord of the hole at v that (a, b) of the pupil lights within edge k of `edges` (4, 3, 3), exactly."""
    along = edges[k, 0, 1] + a * edges[k, 1, 1] + b * edges[k, 2, 1]
    offset = edges[k, 0, 0] + a * edges[k, 1, 0] + b * edges[k, 2, 0]
    offset += v * (edges[k, 0, 2] + a * edges[k, 1, 2] + b * edges[k, 2, 2])
    limit = -offset / along
    # Plain comparisons, so that a loop over rays is vectorised. An edge along u lights all of the chord or nothing.
    high = limit if (along < 0.0) & (limit < high) else high
    low = limit if (along > 0.0) & (limit > low) else low
    return low, (low if (along == 0.0) & (offset < 0.0) else high)


@kernel(nogil=True)
def relative_radiance(image: SlitImage, a: float, b: float, u: float, v: float) -> float:
    """Radiance from (a, b) of the pupil to (u, v) of the hole over that without deviations, on either side of the edges.

    Both along the ray through the same points of slit and pupil. 1 where a unit without deviations sends no light.
    """
    pa, pb = image.slit.sizes[7] * a, image.slit.sizes[7] * b
    hx = image.hole[0, 0] + u * image.hole[1, 0] + v * image.hole[2, 0]
    hy = image.hole[0, 1] + u * image.hole[1, 1] + v * image.hole[2, 1]
    hz = image.hole[0, 2] + u * image.hole[1, 2] + v * image.hole[2, 2]
    slit = image.slit
    found, s, t = _radiance(slit.frames, slit.sizes, pa, pb, (hx - pa) / hy, (hz - pb) / hy)
    # The ray through the same points of slit and pupil at their places, and on to the sample.
    distance, focal = -slit.straight[SLIT, 0, 1], slit.sizes[6]
    p, q = (pa - s) / distance - pa / focal, (pb - t) / distance - pb / focal
    whole, _, _ = _radiance(slit.straight, slit.sizes, pa, pb, p, q)
    relative: float = found / whole if whole > 0.0 else 1.0
    return relative


@kernel()
def _radiance(frames: Floats, sizes: Floats, pa: float, pb: float, p: float, q: float) -> tuple[float, float, float]:
    """Length in the arc of the ray that leaves the condenser at (pa, pb), mm, with slopes (p, q); its point of the slit, mm.

    With the change of radiance in the condenser: the fourth power of the cosines.
    """
    behind_p, behind_q = p + pa / sizes[6], q + pb / sizes[6]
    change = (1.0 + p * p + q * q) / (1.0 + behind_p * behind_p + behind_q * behind_q)
    along = -1.0 / math.sqrt(1.0 + behind_p * behind_p + behind_q * behind_q)
    x, y, z, s, t = to_plane(frames, SLIT, pa, 0.0, pb, along * behind_p, along, along * behind_q)
    return lit_length(frames, sizes, x, y, z, along * behind_p, along, along * behind_q) * change * change, s, t
