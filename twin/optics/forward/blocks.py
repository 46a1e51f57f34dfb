"""A block of forward paths from the source to the detectors: stratum by stratum, each as plain loops.

A stratum is a fixed number of each block's paths, all drawn in the same way: those of one lobe, or those that land on the
frame.
"""

from typing import NamedTuple

import numpy as np

from goniotwin.arrays import Floats, Ints, Singles, Words
from goniotwin.twin.optics.bsdf.packed_lobes import TRANSMITS, Lobes
from goniotwin.twin.optics.forward.bounces import Surfaces, trace_bounces
from goniotwin.twin.optics.forward.paths import BLOCK, DX, DY, DZ, PX, PY, ROWS, STOP, WEIGHT, Beam, trace_to_sample
from goniotwin.twin.optics.forward.scattering import (
    leave_by_cosine,
    leave_by_lobe,
    leave_by_model,
    leave_frame,
    path_key,
    reset_stops,
    stop_at_frame,
    stop_at_mirror,
    weigh_lobe,
)
from goniotwin.twin.optics.forward.scoring import Targets, find_cells, make_hit_buffer, score
from goniotwin.twin.optics.forward.spread import BINS, Spread, spread_block
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.optics.montecarlo import item_key, scramble, word_key

U64 = np.uint64
COSINE, SHAPE, REST, MODEL, FRAME = range(5)
"""Ways to draw: a Lambertian lobe; the shape of a Gaussian; the rest of a Gaussian, by the cosine; any other lobe;
the frame.
"""
SINGLE, STRAY = 0, 2
"""Columns of the sums: light that the sample scattered once, all other light."""
FRAMES_STREAM = 1 << 16
"""Stream of the frame's random numbers, independent of the sample's lobes.

So in a difference of two samples, or of one and none, the noise of the light scattered by the frame cancels, as the light does.
"""


class Strata(NamedTuple):
    """Strata: `ways` (n, 3) are the way to draw, the lobe, the number of a block's paths.

    `gains` (n, 2) are the factor of the weights, and for a Gaussian the share of its paths that follow its shape. `lit` is the
    width of the lit square relative to the hole.
    """

    ways: Ints
    gains: Floats
    lit: float


@kernel(nogil=True)
def scatter_stratum(buffer: Singles, strata: Strata, k: int, key: np.uint64, keys: Words, lobes: Lobes) -> None:
    """Directions and weights of the paths of stratum k that have arrived at the sample, or on the frame."""
    way, which, count = strata.ways[k, 0], strata.ways[k, 1], strata.ways[k, 2]
    gain, share, transmits = strata.gains[k, 0], strata.gains[k, 1], lobes.models.heads[which, TRANSMITS] == 1
    if way == FRAME:
        leave_frame(buffer, count, key, FRAMES_STREAM, gain)
    elif way == SHAPE:
        leave_by_lobe(buffer, count, keys[2:], lobes.models.params[which], share, transmits, gain)
    elif way == MODEL:
        leave_by_model(buffer, count, key, k, which, gain, lobes)
    else:
        # Lambert's law has the density cosine / pi.
        leave_by_cosine(buffer, count, keys[2:], transmits, gain * lobes.models.params[which, 0] * np.pi)
        if way == REST:
            weigh_lobe(buffer, count, lobes.models.params[which], share, transmits, gain)


@kernel(nogil=True)
def trace(
    first: int,
    last: int,
    seed: np.uint64,
    beam: Beam,
    strata: Strata,
    lobes: Lobes,
    surfaces: Surfaces,
    targets: Targets,
    spread: Spread,
    longest: int,
    detectors: int,
) -> Floats:
    """Sums (detectors, 4) over blocks first..last-1.

    Columns: weights and their squares of light scattered once, then the same of all other light. With a map its bins follow as
    further rows. `longest` is the greatest number of detectors in a cell.
    """
    sums = np.zeros((detectors + BINS if spread.wanted else detectors, 4))
    buffer, path_cells, hit_buffer = np.empty(ROWS * BLOCK, np.float32), np.empty(BLOCK, np.uint32), make_hit_buffer(longest)
    start, keys = scramble(U64(seed)), np.empty(4, np.uint32)
    for block in range(first, last):
        key = item_key(start, block)
        for k in range(strata.ways.shape[0]):
            count, inside = strata.ways[k, 2], strata.ways[k, 0] != FRAME
            stream, height, column = (k, 0.0, SINGLE) if inside else (FRAMES_STREAM, surfaces.gap, STRAY)
            for n in range(4):
                keys[n] = word_key(key, 4 * stream + n)
            trace_to_sample(buffer, count, keys, beam, inside, strata.lit)
            scatter_stratum(buffer, strata, k, key, keys, lobes)
            reset_stops(buffer, count)
            if surfaces.obstruction:
                for m in range(3):
                    stop_at_mirror(buffer, count, height, surfaces.mirrors[m], surfaces.blocking_half)
            if inside and surfaces.gap > 0.0:
                stop_at_frame(buffer, count, surfaces.hole_half, surfaces.gap)
            if detectors > 0:
                find_cells(buffer, count, targets.cells, path_cells)
                score(buffer, count, height, path_cells, targets, hit_buffer, sums, column)
            if spread.wanted and not inside:
                spread_block(buffer, count, height, spread, sums)
            for i in range(count):
                if buffer[i + STOP] < np.inf and buffer[i + WEIGHT] > 0.0:
                    weight = np.float64(buffer[i + WEIGHT])
                    dx, dy, dz = np.float64(buffer[i + DX]), np.float64(buffer[i + DY]), np.float64(buffer[i + DZ])
                    trace_bounces(
                        surfaces,
                        lobes,
                        targets,
                        spread,
                        path_key(key, stream, i),
                        np.float64(buffer[i + PX]),
                        np.float64(buffer[i + PY]),
                        height,
                        dx,
                        dy,
                        dz,
                        weight,
                        sums,
                    )
    return sums


@kernel(nogil=True)
def trace_geometry(blocks: int, seed: np.uint64, beam: Beam, strata: Strata, lobes: Lobes) -> float:
    """Paths up to the scattering alone, to measure its speed: the sum of the last path's direction of each block."""
    buffer, keys, total = np.empty(ROWS * BLOCK, np.float32), np.empty(4, np.uint32), 0.0
    start = scramble(U64(seed))
    for block in range(blocks):
        key = item_key(start, block)
        for k in range(strata.ways.shape[0]):
            if strata.ways[k, 0] != FRAME:
                for n in range(4):
                    keys[n] = word_key(key, 4 * k + n)
                trace_to_sample(buffer, strata.ways[k, 2], keys, beam, True, strata.lit)
                scatter_stratum(buffer, strata, k, key, keys, lobes)
                total += buffer[strata.ways[k, 2] - 1 + DX]
    return total
