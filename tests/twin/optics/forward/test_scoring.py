"""The look-up from directions to detectors finds exactly the detectors that count a ray."""

import math
from typing import Any

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics.forward.paths import BLOCK, DX, PX, ROWS, STOP, WEIGHT
from goniotwin.twin.optics.forward.scoring import find_cells, make_hit_buffer, make_targets, score, score_segment


def random_directions(count: int, seed: int) -> Floats:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    unit: Floats = vectors / np.linalg.norm(vectors, axis=1)[:, None]
    return unit


def expected_counts(centres: Floats, axes: Floats, field_deg: float, diameter_mm: float, places: Floats, rays: Floats) -> Any:
    """For rays (m, 3) from `places`, whether each of the detectors (n,) counts it, by direct evaluation: (m, n)."""
    along = rays @ axes.T
    distance = ((centres - places[:, None]) * axes).sum(axis=2) / along
    off = places[:, None] + distance[..., None] * rays[:, None] - centres
    # The length of a direction in single precision is 1 but for 3e-8, which is a thousandth of half a degree.
    cosine = along / np.linalg.norm(rays, axis=1)[:, None]
    inside = np.arccos(np.clip(cosine, -1.0, 1.0)) <= math.radians(0.5 * field_deg)
    return inside & (np.linalg.norm(off, axis=2) <= 0.5 * diameter_mm) & (distance > 0.0)


@pytest.mark.parametrize(
    ("field_deg", "count"),
    [
        (0.5, 300),
        pytest.param(0.5, 4000, marks=pytest.mark.long),
        (2.5, 100),
        pytest.param(2.5, 400, marks=pytest.mark.long),
        (20.0, 100),
        (90.0, 40),
        (179.0, 10),
    ],
)
def test_every_ray_is_counted_by_the_detectors_in_whose_cone_and_disc_it_is(field_deg: float, count: int) -> None:
    axes = random_directions(count, 1)
    axes[:6] = np.array([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, 1, 0], [-1, 0, 0], [0.6, -0.8, 0]])
    centres, diameter_mm = 300.0 * axes, 6.0 + 12.0 * field_deg
    # Half of the rays are close to the axis of a detector.
    rays = random_directions(BLOCK, 2)
    rays[::2] = axes[np.arange(BLOCK // 2) % count] + 0.6 * math.radians(field_deg) * random_directions(BLOCK // 2, 3)
    rays = (rays / np.linalg.norm(rays, axis=1)[:, None]).astype(np.float32).astype(np.float64)
    places = np.column_stack([np.random.default_rng(4).uniform(-2.5, 2.5, (BLOCK, 2)).astype(np.float32), np.zeros(BLOCK)])
    result = make_targets(centres, axes, field_deg, diameter_mm)
    expected = expected_counts(centres, axes, field_deg, diameter_mm, places, rays)
    surely = expected == expected_counts(centres, axes, field_deg * 0.99999, diameter_mm - 1e-3, places, rays)
    surely &= expected == expected_counts(centres, axes, field_deg * 1.00001, diameter_mm + 1e-3, places, rays)
    assert np.count_nonzero(expected) > 200
    assert np.mean(surely) > 0.999

    buffer = np.zeros(ROWS * BLOCK, np.float32)
    buffer[WEIGHT : WEIGHT + BLOCK], buffer[STOP : STOP + BLOCK] = 1.0, np.inf
    for c in range(3):
        buffer[DX + c * BLOCK : DX + (c + 1) * BLOCK] = rays[:, c]
    for c in range(2):
        buffer[PX + c * BLOCK : PX + (c + 1) * BLOCK] = places[:, c]
    cells, hit_buffer = np.empty(BLOCK, np.uint32), make_hit_buffer(int(np.diff(result.starts).max()))
    sums = np.zeros((count, 4))
    find_cells(buffer, BLOCK, result.cells, cells)
    score(buffer, BLOCK, 0.0, cells, result, hit_buffer, sums, 0)
    unsure = np.count_nonzero(~surely, axis=0)
    assert np.all(np.abs(sums[:, 0] - expected.sum(axis=0)) <= unsure)
    for k in range(BLOCK):
        (px, py, pz), (dx, dy, dz) = places[k], rays[k]
        score_segment(result, px, py, pz, dx, dy, dz, math.inf, 1.0, sums)
    assert np.all(np.abs(sums[:, 2] - expected.sum(axis=0)) <= unsure)


def test_a_ray_that_is_blocked_before_a_detector_is_not_counted() -> None:
    axes = np.array([[0.0, 0.0, 1.0]])
    result, sums = make_targets(300.0 * axes, axes, 1.0, 5.0), np.zeros((1, 4))
    for stop, counts in ((299.0, 0.0), (301.0, 1.0)):
        score_segment(result, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, stop, 1.0, sums)
        assert sums[0, 2] == counts
    score_segment(result, 0.0, 0.0, 310.0, 0.0, 0.0, 1.0, math.inf, 1.0, sums)
    assert sums[0, 2] == 1.0
