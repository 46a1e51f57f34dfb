"""How many of a block's paths each lobe of the sample has, and the frame."""

import math

import numpy as np

from goniotwin.twin.optics.bsdf.models import GAUSSIAN, LAMBERTIAN
from goniotwin.twin.optics.bsdf.packed_lobes import ABOVE, Lobes, lobe_share
from goniotwin.twin.optics.forward.blocks import COSINE, FRAME, MODEL, REST, SHAPE, Strata
from goniotwin.twin.optics.forward.paths import BLOCK, MARGIN, Beam
from goniotwin.twin.optics.geometry.mirrors import reflect
from goniotwin.twin.optics.geometry.sample_frames import SampleFrames

SHAPE_SHARE = 0.875
"""Of a Gaussian's paths, those that follow its shape."""
LEAST = 16
"""Paths of a block for each stratum; all have a multiple of it, which suits vectors."""
MM2_TO_M2 = 1e-6


def strata(pupil_radius_mm: float, beam: Beam, lobes: Lobes, frames: SampleFrames, beside: float, stray: bool) -> Strata:
    """How a block's paths are shared out: by what each lobe scatters, and the frame, which gets `beside` of the hole's light.

    The frame never has more than half, and half for a map of `stray` light. Raises ValueError for more lobes than there is
    room for.
    """
    area = math.pi * pupil_radius_mm**2 * 4.0 * beam.hole_half**2
    hole_gain, frame_gain = MM2_TO_M2 * area * MARGIN**2, MM2_TO_M2 * area * (frames.lit**2 - 1.0)
    if beam.rays.shape[0]:
        hole_gain = frame_gain = float(beam.rays.shape[0])
    middle = beam.aim[0] - beam.pupil[0]
    for normal in beam.mirrors[:, 1]:
        middle = reflect(middle, normal)
    sine = min(1.0, float(np.hypot(middle[0], middle[1]) / np.linalg.norm(middle)))
    worth = [lobe_share(lobes, k, True, sine) for k in range(len(lobes.weights))]
    ways: list[tuple[int, int, float, float]] = []
    for k, share in enumerate(worth):
        if share <= 0.0 or lobes.heads[k, ABOVE] != 1:
            continue
        gain, kind = hole_gain * float(lobes.weights[k]), int(lobes.heads[k, 0])
        if kind == GAUSSIAN:
            ways += [(SHAPE, k, SHAPE_SHARE * share, gain), (REST, k, (1.0 - SHAPE_SHARE) * share, gain)]
        else:
            ways.append((COSINE if kind == LAMBERTIAN else MODEL, k, share, gain))
    on_frame = beside * frames.reflectance
    if on_frame > 0.0:
        total = sum(way[2] for way in ways)
        share = total if stray else min(on_frame, total)
        share = share if total > 0.0 else 1.0
        ways.append((FRAME, 0, share, frame_gain * frames.reflectance))
    counts = _counts([way[2] for way in ways])
    table, gains = np.zeros((len(ways), 3), dtype=np.int64), np.zeros((len(ways), 2))
    for i, (way, k, _, gain) in enumerate(ways):
        table[i] = way, k, counts[i]
        paths, share = counts[i], 0.0
        if way in (SHAPE, REST):
            shape = i if way == SHAPE else i - 1
            paths = counts[shape] + counts[shape + 1]
            share = counts[shape] / paths
        gains[i] = gain * BLOCK / paths, share
    return Strata(table, gains, frames.lit)


def _counts(shares: list[float]) -> list[int]:
    """Of a block's paths, multiples of LEAST, to each of some shares, at least LEAST."""
    if not shares:
        return []
    if len(shares) > BLOCK // LEAST // 2:
        raise ValueError(f"the sample has {len(shares)} lobes at once: the forward estimator takes {BLOCK // LEAST // 4}")
    total = sum(shares)
    counts = [max(LEAST, LEAST * round(share / total * BLOCK / LEAST)) for share in shares]
    largest = counts.index(max(counts))
    counts[largest] += BLOCK - sum(counts)
    if counts[largest] < LEAST:
        counts = [LEAST * (BLOCK // LEAST // len(shares))] * len(shares)
        counts[0] += BLOCK - sum(counts)
    return counts
