"""The two estimators of one integral, which share no ray, hold each other."""

import math
from typing import Any

import numba
import numpy as np
import pytest

from twin.optics import (
    Instrument,
    Scatterer,
    forward,
    from_specular,
    gaussian,
    lambertian,
    tabulated,
    throughput,
    visible_fraction,
)
from twin.optics.forward import CHUNK

# Wider detectors than the instrument's, so that few paths make many hits; mirrors and beam are the instrument's own.
WIDE = Instrument(detector_diameter_mm=12.0, field_deg=3.0)
TABLE = tabulated(
    np.arange(0.0, 91.0, 30.0), [0.0, 90.0, 180.0], np.arange(0.0, 91.0, 15.0),
    0.1 + 0.1 * np.cos(np.arange(4))[:, None, None] ** 2 + 0.05 * np.arange(3)[:, None] + 0.3 / (1.0 + np.arange(7.0)),
)  # fmt: skip


def rings(sigma_deg: float, step_deg: float, count: int) -> Any:
    """The specular direction and rings round it, in and out of the plane: so far apart that no path meets two."""
    theta = np.concatenate([[0.0], *(np.full(6 * k, step_deg * k) for k in range(1, count + 1))])
    phi = np.concatenate([[0.0], *(np.arange(6 * k) * 60.0 / k for k in range(1, count + 1))])
    directions = from_specular(sigma_deg, theta, phi)
    return directions[directions[:, 2] > math.cos(math.radians(85.0))]


def hold_each_other(
    instrument: Instrument, sigma_deg: float, directions: Any, scatterer: Scatterer, paths: int, gamma_deg: float = 0.0
) -> None:
    """Chi-square of difference over error within its quantiles of 0.0005 and 0.9995, the largest below 5.5."""
    estimate = forward(instrument, sigma_deg, directions, scatterer, paths, seed=2026, gamma_deg=gamma_deg)
    expected = throughput(instrument, sigma_deg, directions, scatterer, rays=1 << 18, gamma_deg=gamma_deg)
    shown = np.ones(len(directions))
    if instrument.obstruction:
        shown = visible_fraction(instrument, sigma_deg, directions, rays=1 << 12, gamma_deg=gamma_deg)
    # What is hidden is hidden for both; slivers of a detector have too few hits for an error that is known.
    assert not np.any(estimate.throughput_m2sr[shown == 0.0])
    assert not np.any(expected[shown == 0.0])
    seen = shown > 0.1
    assert np.count_nonzero(seen) >= 25
    deviation = (estimate.throughput_m2sr - expected)[seen] / estimate.standard_error[seen]
    freedom = deviation.size
    # The normal approximation of Wilson and Hilferty.
    chi = (np.sum(deviation**2) / freedom) ** (1 / 3)
    assert abs(chi - 1.0 + 2.0 / (9 * freedom)) < 3.29 * math.sqrt(2.0 / (9 * freedom))
    assert np.max(np.abs(deviation)) < 5.5
    total = estimate.throughput_m2sr[seen].sum(), float(np.sqrt(np.sum(estimate.standard_error[seen] ** 2)))
    assert total[0] == pytest.approx(expected[seen].sum(), abs=4.0 * total[1])


@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize(
    ("scatterer", "step_deg"),
    [(lambertian(), 13.0), (gaussian(5.0), 4.0), (TABLE, 13.0)],
    ids=["lambertian", "gaussian", "table"],
)
def test_fast_and_forward_agree_in_and_out_of_plane(sigma_deg: float, scatterer: Scatterer, step_deg: float) -> None:
    hold_each_other(WIDE, sigma_deg, rings(sigma_deg, step_deg, 4), scatterer, paths=4_000_000)


def test_they_agree_for_the_instruments_own_detectors() -> None:
    theta = np.arange(-10.0, 10.1, 0.6)
    in_plane = from_specular(30.0, np.abs(theta), np.where(theta < 0.0, 180.0, 0.0))
    hold_each_other(Instrument(), 30.0, in_plane, gaussian(5.0), paths=6_000_000)


def test_they_agree_for_a_turned_hole() -> None:
    hold_each_other(WIDE, 60.0, rings(60.0, 13.0, 4), lambertian(), paths=3_000_000, gamma_deg=30.0)


def test_they_agree_where_the_mirrors_are_too_small_for_the_beam() -> None:
    small = Instrument(detector_diameter_mm=12.0, field_deg=3.0, mirror_side_mm=7.0, obstruction=False)
    hold_each_other(small, 30.0, rings(30.0, 13.0, 4), lambertian(), paths=3_000_000)


def test_they_agree_where_the_detector_is_smaller_than_the_spot() -> None:
    # Here the fast estimator's rays start in a small part of the hole.
    small = Instrument(spot_side_mm=8.0, detector_diameter_mm=4.0, field_deg=4.0)
    hold_each_other(small, 30.0, rings(30.0, 13.0, 4), lambertian(), paths=6_000_000)


def test_the_standard_error_is_that_of_repeated_runs() -> None:
    directions = rings(30.0, 13.0, 3)
    runs = [forward(WIDE, 30.0, directions, lambertian(), 60_000, seed) for seed in range(40)]
    scatter = np.std([run.throughput_m2sr for run in runs], axis=0, ddof=1)
    stated = np.sqrt(np.mean([run.standard_error**2 for run in runs], axis=0))
    # 40 runs tell a standard deviation to 11 %, and the mean over more than 30 detectors to 2 %.
    assert np.mean(scatter / stated) == pytest.approx(1.0, abs=0.08)


def test_the_same_seed_gives_the_same_bits_for_any_number_of_threads() -> None:
    directions, paths = rings(30.0, 13.0, 1), 2 * CHUNK + 77
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = forward(WIDE, 30.0, directions, gaussian(5.0), paths, seed=3)
        numba.set_num_threads(threads)
        many = forward(WIDE, 30.0, directions, gaussian(5.0), paths, seed=3)
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(one.throughput_m2sr, many.throughput_m2sr)
    assert np.array_equal(one.standard_error, many.standard_error)
    other = forward(WIDE, 30.0, directions, gaussian(5.0), paths, seed=4)
    assert not np.array_equal(one.throughput_m2sr, other.throughput_m2sr)


def test_what_cannot_be_run_is_refused() -> None:
    with pytest.raises(ValueError, match="paths"):
        forward(WIDE, 30.0, [[0.0, 0.0, 1.0]], lambertian(), 1, seed=0)
    with pytest.raises(ValueError, match="seed"):
        forward(WIDE, 30.0, [[0.0, 0.0, 1.0]], lambertian(), 100, seed=-1)
