"""Scoring: the detectors that count a ray.

A look-up gives the candidates from the ray's direction. The exact test of disc and cone follows or, for real sensors, of lens,
diaphragm and detector. Directions of either hemisphere, projected along the normal, fall into square cells. A cell lists every
detector whose cone contains some direction of it, so that a ray costs the same with 83,000 detectors as with 30.

Most of the time of a forward run is spent here, and most of that by wrong guesses of the processor, so no branch depends on a
path: each step writes all that may be needed and advances by as many as count. First the paths whose cell has a list, then
their pairs with its detectors, then the pairs within the cone, then the hits, which are added up last. Indices have no sign
(64 bits): numba tests any other for being negative, at each access.
"""

import math
from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Bytes, Floats, Indices, Singles, Words
from goniotwin.twin.optics.forward.paths import BLOCK, DX, DY, DZ, PX, PY, STOP, WEIGHT
from goniotwin.twin.optics.geometry.sensor import RealSensor
from goniotwin.twin.optics.kernel import kernel

F32 = np.float32
U64 = np.uint64
I32 = np.int32
ONE, ZERO = np.float32(1.0), np.float32(0.0)
FEWEST_CELLS, MOST_CELLS = 8, 460
"""Limits of the cells per side of the square: as many as 0.5 deg of field need, with both hemispheres in 1.7 MB, the size of a
core's own cache.
"""
HITS = 4 * BLOCK
AT_ONCE = 4
"""Number of detectors of a list that are copied without a test; `numbers` is that much longer than its lists."""
AT_PX, AT_PY, AT_DX, AT_DY, AT_DZ, AT_WEIGHT, AT_STOP = (U64(row) for row in (PX, PY, DX, DY, DZ, WEIGHT, STOP))
# Margin for the rounding of directions to single precision.
SLACK = 2e-6


class Targets(NamedTuple):
    """Detectors by cells: cell c lists those of `numbers` from starts[c] to starts[c + 1]; `listed` is 1 where there are any.

    A row of `frames` (detectors, 6) has viewing direction and centre in mm. `cells` per side; the chord of half a detector's
    field and its disc's radius in mm, both squared. The last list is empty: it is for rays without weight.

    For real sensors the rows are longer (., 9), with the side of the detector that lies along the arc, and `sensor` has the
    sensor's constants. For virtual detectors `sensor` is None, and numba compiles kernels without sensors: functions that test
    it have it as an argument of its own. A test inside the kernels would cost virtual detectors 3 to 9 % of their speed.
    """

    starts: Words
    listed: Bytes
    numbers: Words
    frames: Singles
    cells: int
    chord2: float
    radius2: float
    sensor: Floats | None


@kernel()
def _fill_lists(axes: Floats, half: float, cells: int, starts: Indices, numbers: Indices) -> Indices:
    """Number of detectors in each cell; also fills `numbers`, if it is not empty.

    Projected along the normal the cone of a detector is an ellipse along and across its own azimuth, cut by the horizon.
    """
    count = np.zeros(2 * cells * cells + 1, np.int32)
    step, across = 2.0 / cells, math.sin(half)
    for k in range(axes.shape[0]):
        sine = math.hypot(axes[k, 0], axes[k, 1])
        cos, sin = (axes[k, 0] / sine, axes[k, 1] / sine) if sine > 0.0 else (1.0, 0.0)
        polar = math.atan2(sine, abs(axes[k, 2]))
        horizon = polar + half >= 0.5 * math.pi
        near, far = math.sin(polar - half), 1.0 if horizon else math.sin(polar + half)
        middle, along = 0.5 * (near + far), 0.5 * (far - near)
        reach_x, reach_y = along * abs(cos) + across * abs(sin), along * abs(sin) + across * abs(cos)
        first_i, last_i = (middle * cos - reach_x + 1.0) / step, (middle * cos + reach_x + 1.0) / step
        first_j, last_j = (middle * sin - reach_y + 1.0) / step, (middle * sin + reach_y + 1.0) / step
        margin = 0.5 * step * (abs(cos) + abs(sin))
        for i in range(max(0, int(first_i)), min(cells - 1, int(last_i)) + 1):
            for j in range(max(0, int(first_j)), min(cells - 1, int(last_j)) + 1):
                x, y = (i + 0.5) * step - 1.0, (j + 0.5) * step - 1.0
                beyond = max(0.0, abs(x * cos + y * sin - middle) - margin) / along
                aside = max(0.0, abs(y * cos - x * sin) - margin) / across
                if max(beyond, aside) > 1.0 or (not horizon and beyond * beyond + aside * aside > 1.0):
                    continue
                for side in range(2):
                    if horizon or (axes[k, 2] < 0.0) == (side == 1):
                        cell = (side * cells + i) * cells + j
                        if numbers.size > 0:
                            numbers[starts[cell] + count[cell]] = k
                        count[cell] += 1
    return count


def make_targets(centres: Floats, axes: Floats, field_deg: float, diameter_mm: float) -> Targets:
    """Targets of detectors at `centres` (n, 3), mm, that look along -`axes` (n, 3), all with the same field and disc."""
    half = math.radians(0.5 * field_deg)
    cells = min(MOST_CELLS, max(FEWEST_CELLS, math.ceil(2.0 / math.sin(half))))
    starts, margin = np.zeros(2 * cells * cells + 2, np.int32), min(half + SLACK, 0.5 * math.pi)
    counts = _fill_lists(axes, margin, cells, starts, np.zeros(0, np.int32))
    if counts.sum(dtype=np.int64) >= 2**31:
        raise ValueError(
            f"{len(axes)} detectors with a field of {field_deg:g} deg overlap too much: give fewer, or a smaller one"
        )
    starts[1:] = np.cumsum(counts)
    numbers = np.zeros(int(starts[-1]) + AT_ONCE, np.int32)
    _fill_lists(axes, margin, cells, starts, numbers)
    frames = np.hstack([axes, centres]).astype(np.float32)
    chord2 = (2.0 * math.sin(0.5 * half)) ** 2
    return Targets(
        starts.astype(np.uint32),
        (counts > 0).astype(np.uint8),
        numbers.astype(np.uint32),
        frames,
        cells,
        chord2,
        (0.5 * diameter_mm) ** 2,
        None,
    )


def make_sensor_targets(centres: Floats, axes: Floats, sides: Floats, sensor: RealSensor) -> Targets:
    """Targets of sensors with lenses at `centres` (n, 3), mm, that look along -`axes` (n, 3), `sides` (n, 3) along the arc.

    The lists are those of a cone that contains every ray that can pass, with a margin for rounding.
    """
    listed = make_targets(centres, axes, sensor.widest_deg + math.degrees(2.0 * SLACK), sensor.lens_diameter_mm)
    return listed._replace(frames=np.hstack([listed.frames, sides.astype(np.float32)]), sensor=sensor.constants)


@kernel(fastmath={"contract"})
def find_cells(buffer: Singles, count: int, cells: int, path_cells: Words) -> None:
    """Cell of each path of a block."""
    scale, last, nowhere = F32(0.5 * cells), I32(cells - 1), I32(2 * cells * cells)
    row, below = I32(cells), I32(cells * cells)
    for i in range(count):
        a, b = I32((buffer[i + DX] + ONE) * scale), I32((buffer[i + DY] + ONE) * scale)
        cell = I32(I32(min(max(a, I32(0)), last) * row) + min(max(b, I32(0)), last))
        cell = cell if buffer[i + DZ] >= ZERO else I32(cell + below)
        path_cells[i] = cell if buffer[i + WEIGHT] > ZERO else nowhere


class HitBuffer(NamedTuple):
    """Buffer for a block: `candidates` are the paths whose cell has a list; detector, path and weight of pairs and hits."""

    candidates: Words
    places: Words
    paths: Words
    weights: Singles


@kernel()
def make_hit_buffer(longest: int) -> HitBuffer:
    """Buffer for HITS pairs, the longest list of detectors and what is copied beyond."""
    size = HITS + longest + AT_ONCE
    return HitBuffer(
        np.empty(BLOCK, np.uint32), np.empty(size, np.uint32), np.empty(size, np.uint32), np.empty(size, np.float32)
    )


@kernel(forceinline=True)
def is_counted(
    targets: Targets,
    sensor: Floats | None,
    j: int,
    px: float,
    py: float,
    pz: float,
    dx: float,
    dy: float,
    dz: float,
    stop: float,
) -> bool:
    """Whether the detector of row j counts a ray within its cone from p along d, up to the distance `stop`."""
    frames = targets.frames
    ex, ey, ez = frames[j, 0], frames[j, 1], frames[j, 2]
    x, y, z = px - frames[j, 3], py - frames[j, 4], pz - frames[j, 5]
    along = dx * ex + dy * ey + dz * ez
    distance = -(x * ex + y * ey + z * ez) / along
    x, y, z = x + distance * dx, y + distance * dy, z + distance * dz
    if sensor is None:
        return bool(0.0 < distance < stop and x * x + y * y + z * z <= targets.radius2)
    ux, uy, uz = np.float64(frames[j, 6]), np.float64(frames[j, 7]), np.float64(frames[j, 8])
    vx, vy, vz = ey * uz - ez * uy, ez * ux - ex * uz, ex * uy - ey * ux
    p, q = (dx * ux + dy * uy + dz * uz) / along, (dx * vx + dy * vy + dz * vz) / along
    return 0.0 < distance < stop and passes_sensor(x * ux + y * uy + z * uz, x * vx + y * vy + z * vz, p, q, sensor)


@kernel()
def find_candidates(count: int, path_cells: Words, targets: Targets, hit_buffer: HitBuffer) -> np.uint64:
    """Fill `candidates`; their number."""
    candidates, listed, found = hit_buffer.candidates, targets.listed, U64(0)
    for i in range(count):
        candidates[found] = i
        found += U64(listed[U64(path_cells[i])])
    return found


@kernel(fastmath={"contract"})
def select_pairs(buffer: Singles, pairs: np.uint64, targets: Targets, hit_buffer: HitBuffer) -> np.uint64:
    """Keep those of the first `pairs` of path and detector whose path is within the detector's cone; their number."""
    frames, places, paths = targets.frames, hit_buffer.places, hit_buffer.paths
    chord2, kept = F32(targets.chord2), U64(0)
    for n in range(pairs):
        path, place = paths[n], places[n]
        i, j = U64(path), U64(place)
        ox, oy, oz = buffer[i + AT_DX] - frames[j, 0], buffer[i + AT_DY] - frames[j, 1], buffer[i + AT_DZ] - frames[j, 2]
        paths[kept], places[kept] = path, place
        kept += U64(ox * ox + oy * oy + oz * oz <= chord2)
    return kept


@kernel()
def add_sensor_hits(
    buffer: Singles, pairs: np.uint64, height: float, targets: Targets, hit_buffer: HitBuffer, sums: Floats, column: int
) -> None:
    """`add_hits` of real sensors."""
    for n in range(pairs):
        i, j = int(hit_buffer.paths[n]), int(hit_buffer.places[n])
        px, py, stop = np.float64(buffer[i + PX]), np.float64(buffer[i + PY]), np.float64(buffer[i + STOP])
        dx, dy, dz = np.float64(buffer[i + DX]), np.float64(buffer[i + DY]), np.float64(buffer[i + DZ])
        if is_counted(targets, targets.sensor, j, px, py, height, dx, dy, dz, stop):
            weight = np.float64(buffer[i + WEIGHT])
            sums[j, column] += weight
            sums[j, column + 1] += weight * weight


@kernel(fastmath={"contract"})
def add_hits(
    buffer: Singles,
    pairs: np.uint64,
    height: float,
    targets: Targets,
    sensor: Floats | None,
    hit_buffer: HitBuffer,
    sums: Floats,
    column: int,
) -> None:
    """Add those of the first `pairs`, within the cone, that cross the detector's disc, or pass its sensor: see `score`."""
    if sensor is not None:
        add_sensor_hits(buffer, pairs, height, targets, hit_buffer, sums, column)
        return
    frames, places, paths, weights = targets.frames, hit_buffer.places, hit_buffer.paths, hit_buffer.weights
    radius2, above, hits = F32(targets.radius2), F32(height), U64(0)
    for n in range(pairs):
        place, i = places[n], U64(paths[n])
        j = U64(place)
        dx, dy, dz = buffer[i + AT_DX], buffer[i + AT_DY], buffer[i + AT_DZ]
        ex, ey, ez = frames[j, 0], frames[j, 1], frames[j, 2]
        x, y, z = buffer[i + AT_PX] - frames[j, 3], buffer[i + AT_PY] - frames[j, 4], above - frames[j, 5]
        distance = -(x * ex + y * ey + z * ez) / (dx * ex + dy * ey + dz * ez)
        x, y, z = x + distance * dx, y + distance * dy, z + distance * dz
        inside = (x * x + y * y + z * z <= radius2) & (distance > ZERO) & (distance < buffer[i + AT_STOP])
        places[hits], weights[hits] = place, buffer[i + AT_WEIGHT]
        hits += U64(inside)
    for n in range(hits):
        j, weight = U64(places[n]), np.float64(weights[n])
        sums[j, column] += weight
        sums[j, column + 1] += weight * weight


@kernel()
def score(
    buffer: Singles,
    count: int,
    height: float,
    path_cells: Words,
    targets: Targets,
    hit_buffer: HitBuffer,
    sums: Floats,
    column: int,
) -> None:
    """Add the paths of a block, from points `height` above the sample, to a column of `sums`, their squares to the next."""
    starts, numbers, places, paths = targets.starts, targets.numbers, hit_buffer.places, hit_buffer.paths
    pairs = U64(0)
    for n in range(find_candidates(count, path_cells, targets, hit_buffer)):
        i = hit_buffer.candidates[n]
        cell = U64(path_cells[U64(i)])
        first = U64(starts[cell])
        length = U64(starts[cell + U64(1)]) - first
        a, b, c, d = numbers[first], numbers[first + U64(1)], numbers[first + U64(2)], numbers[first + U64(3)]
        places[pairs], places[pairs + U64(1)], places[pairs + U64(2)], places[pairs + U64(3)] = a, b, c, d
        paths[pairs], paths[pairs + U64(1)], paths[pairs + U64(2)], paths[pairs + U64(3)] = i, i, i, i
        if length > U64(AT_ONCE):
            for k in range(U64(AT_ONCE), length):
                places[pairs + k], paths[pairs + k] = numbers[first + k], i
        pairs += length
        if pairs > U64(HITS):
            pairs = select_pairs(buffer, pairs, targets, hit_buffer)
            add_hits(buffer, pairs, height, targets, targets.sensor, hit_buffer, sums, column)
            pairs = U64(0)
    pairs = select_pairs(buffer, pairs, targets, hit_buffer)
    add_hits(buffer, pairs, height, targets, targets.sensor, hit_buffer, sums, column)


@kernel()
def score_segment(
    targets: Targets, px: float, py: float, pz: float, dx: float, dy: float, dz: float, stop: float, weight: float, sums: Floats
) -> None:
    """Add one ray from p along d, up to the distance `stop`, to the last two columns of `sums`."""
    cells = targets.cells
    i, j = int(0.5 * cells * (dx + 1.0)), int(0.5 * cells * (dy + 1.0))
    cell = min(max(i, 0), cells - 1) * cells + min(max(j, 0), cells - 1)
    if dz < 0.0:
        cell += cells * cells
    for n in range(targets.starts[cell], targets.starts[cell + 1]):
        j = int(targets.numbers[n])
        ex, ey, ez = targets.frames[j, 0], targets.frames[j, 1], targets.frames[j, 2]
        if (dx - ex) ** 2 + (dy - ey) ** 2 + (dz - ez) ** 2 > targets.chord2:
            continue
        if is_counted(targets, targets.sensor, j, px, py, pz, dx, dy, dz, stop):
            sums[j, 2] += weight
            sums[j, 3] += weight * weight


@kernel(forceinline=True)
def passes_sensor(x: float, y: float, p: float, q: float, constants: Floats) -> bool:
    """Whether a ray that crosses the lens' plane at (x, y), mm, with slopes (p, q) to its axis reaches the detector."""
    if x * x + y * y > constants[0]:
        return False
    p, q = p - x * constants[2], q - y * constants[2]
    a, b = x + p * constants[3], y + q * constants[3]
    if a * a + b * b > constants[1]:
        return False
    return bool(abs(x + p * constants[4]) <= constants[5] and abs(y + q * constants[4]) <= constants[5])
