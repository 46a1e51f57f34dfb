"""The forward estimator: absolute value, stated error, reproducibility."""

import math
from dataclasses import replace
from typing import Any

import numba
import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    Reflectance,
    Scatterer,
    albedo,
    apply_spectrum,
    arc_direction,
    forward_throughput,
    from_specular,
    light_direction,
    regular,
    sum_samples,
)
from goniotwin.twin.optics.forward.paths import BLOCK
from goniotwin.twin.optics.montecarlo import CHUNK
from tests.sizes import parted
from tests.twin.optics.models import MODELS, gaussian, lambertian, model_name

REFLECTED = 0.95**3
PUPIL_SINE2 = math.sin(math.atan(5.0 / 800.0)) ** 2
OPEN = Instrument(obstruction=False)
WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
# One detector that receives all light on its side of the sample, up to 0.05 deg from the horizon.
ALL = replace(OPEN, detector_diameter_mm=1e7, field_deg=179.9)
UP, DOWN = [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]


def spread_out(count: int) -> Floats:
    """Evenly spread directions over the upper hemisphere, none below 80 deg (a spiral)."""
    height = 1.0 - (np.arange(count) + 0.5) / count * (1.0 - math.cos(math.radians(80.0)))
    return arc_direction(np.degrees(np.arccos(height)), (np.arange(count) * 137.50776405003785) % 360.0)


@parted(16)
@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0])
def test_detectors_with_a_wide_spot_receive_their_own_etendue(sigma_deg: float, part: int) -> None:
    wide = Instrument(spot_side_mm=24.0, mirror_side_mm=200.0, obstruction=False, detector_diameter_mm=10.0, field_deg=2.0)
    directions = spread_out(200)
    directions = directions[directions[:, 2] > math.cos(math.radians(45.0))]
    result = forward_throughput(wide, sigma_deg, directions, lambertian(0.6), 20_000_000 // part, seed=1)
    # Irradiance pi L sin^2 cos of a round pupil on the axis, f = 0.6 / pi, the disc's area times its projected cone.
    etendue_m2sr = math.pi * 0.005**2 * math.pi * math.sin(math.radians(1.0)) ** 2
    closed = REFLECTED * 0.6 * PUPIL_SINE2 * math.cos(math.radians(sigma_deg)) * etendue_m2sr
    deviation = (result.single_m2sr - closed) / result.single_error
    assert np.max(np.abs(deviation)) < 5.0
    # The detectors overlap slightly; the irradiance decreases off the centre of the spot, by 1e-4.
    assert result.single_m2sr.mean() == pytest.approx(closed, rel=2e-3 * math.sqrt(part))


@parted(4)
def test_a_small_detector_in_the_open_beam_receives_the_pupils_radiance(part: int) -> None:
    small = replace(OPEN, detector_diameter_mm=4.0, field_deg=0.1)
    result = forward_throughput(small, 30.0, [-light_direction(30.0), light_direction(30.0)], None, 4_000_000 // part, seed=2)
    closed = REFLECTED * math.pi * 0.002**2 * math.pi * math.sin(math.radians(0.05)) ** 2
    assert result.throughput_m2sr[0] == pytest.approx(closed, abs=4.0 * result.standard_error[0])
    assert result.standard_error[0] < 0.01 * math.sqrt(part) * closed
    assert result.throughput_m2sr[1] == 0.0


@parted(4)
@pytest.mark.parametrize("scatterer", MODELS, ids=model_name)
@pytest.mark.parametrize("sigma_deg", [25.0, 140.0])
def test_the_scattered_flux_is_the_albedo_times_the_incident_flux(scatterer: Scatterer, sigma_deg: float, part: int) -> None:
    arriving = forward_throughput(ALL, sigma_deg, [UP, DOWN], None, 300_000 // part, seed=4).single_m2sr.sum()
    result = forward_throughput(ALL, sigma_deg, [UP, DOWN], scatterer, 400_000 // part, seed=4, gamma_deg=35.0)
    back = sigma_deg > 90.0
    for k, transmitted in ((0, back), (1, not back)):
        share = albedo(scatterer, sigma_deg, transmitted, gamma_deg=35.0)
        error = result.single_error[k] / arriving
        # Light within 0.05 deg of the horizon is not received; the beam is 0.7 deg wide.
        assert result.single_m2sr[k] / arriving == pytest.approx(share, abs=5.0 * error + 2e-3 * share + 1e-9)


def test_a_spectral_sample_equals_its_value_at_the_wavelength() -> None:
    coloured = sum_samples(
        apply_spectrum([400.0, 700.0], [0.2, 0.8], lambertian()), apply_spectrum([400.0, 700.0], [1.0, 0.0], gaussian(20.0))
    )
    arriving = forward_throughput(ALL, 30.0, [UP, DOWN], None, 300_000, seed=4).single_m2sr.sum()
    for wavelength in (400.0, 500.0, 700.0):
        result = forward_throughput(ALL, 30.0, [UP], coloured, 300_000, seed=5, wavelength_nm=wavelength)
        share = albedo(coloured, 30.0, wavelength_nm=wavelength)
        assert result.single_m2sr[0] / arriving == pytest.approx(share, rel=1e-2)
    with pytest.raises(ValueError, match="wavelength_nm is missing"):
        forward_throughput(ALL, 30.0, [UP], coloured, 300_000)


def test_mirrors_reflect_their_share_of_the_beam_and_of_scattered_light() -> None:
    # A mirror in place of the sample, at normal incidence, reflects all light back over the mirrors.
    seen = forward_throughput(Instrument(), 0.0, [UP], regular(), 100_000, seed=1)
    assert seen.throughput_m2sr[0] == 0.0
    dull, bright = (replace(OPEN, mirror_reflectance=share) for share in (0.5, 1.0))
    directions = spread_out(10)
    halves = forward_throughput(dull, 30.0, directions, lambertian(), 1_000_000, seed=1).single_m2sr
    wholes = forward_throughput(bright, 30.0, directions, lambertian(), 1_000_000, seed=1).single_m2sr
    assert halves == pytest.approx(wholes / 8.0, rel=1e-5)


def test_mirrors_with_a_table_reflect_its_value_at_the_wavelength_and_angle() -> None:
    table = Reflectance(np.array([400.0, 600.0]), np.array([40.0, 45.0, 50.0]), np.array([[0.5, 0.6, 0.7], [0.8, 0.85, 0.9]]))
    instrument = replace(OPEN, detector_diameter_mm=30.0, field_deg=6.0, mirror_reflectance=table)
    perfect = replace(instrument, mirror_reflectance=1.0)
    directions = spread_out(10)
    for wavelength, expected in ((400.0, 0.6), (500.0, 0.725), (600.0, 0.85)):
        result = forward_throughput(
            instrument, 30.0, directions, lambertian(), 500_000, seed=1, wavelength_nm=wavelength
        ).single_m2sr
        whole = forward_throughput(perfect, 30.0, directions, lambertian(), 500_000, seed=1).single_m2sr
        # The beam's 0.7 deg are symmetrical about 45 deg, and the table is linear there.
        assert result.sum() / whole.sum() == pytest.approx(expected**3, rel=1e-3)


def test_the_standard_error_is_that_of_repeated_runs() -> None:
    directions, sample = spread_out(40), sum_samples(lambertian(0.5), gaussian(30.0, reflectance=0.4))
    runs = [forward_throughput(WIDE, 30.0, directions, sample, 60_000, seed) for seed in range(60)]
    scatter = np.var([run.throughput_m2sr for run in runs], axis=0, ddof=1)
    stated = np.mean([run.standard_error**2 for run in runs], axis=0)
    # 60 runs give a variance to 18 %, and the mean over about 40 detectors to 3 %.
    lit = stated > 0.0
    assert np.mean(scatter[lit] / stated[lit]) == pytest.approx(1.0, abs=0.12)


def test_a_relative_error_can_be_requested() -> None:
    directions = spread_out(30)
    result = forward_throughput(WIDE, 30.0, directions, lambertian(), relative_error=0.02, seed=1)
    lit = result.throughput_m2sr > 0.0
    assert np.median(result.standard_error[lit] / result.throughput_m2sr[lit]) < 0.02
    again = forward_throughput(WIDE, 30.0, directions, lambertian(), paths=result.paths, seed=1)
    assert np.array_equal(result.throughput_m2sr, again.throughput_m2sr)
    coarse = forward_throughput(WIDE, 30.0, directions, lambertian(), relative_error=0.06, seed=1)
    assert coarse.paths < result.paths
    with pytest.raises(ValueError, match="undefined without light"):
        forward_throughput(WIDE, 150.0, directions, lambertian(), relative_error=0.01)


def fields(result: Any) -> list[Floats]:
    return [result.throughput_m2sr, result.standard_error, result.stray_m2sr, result.stray_error]


@pytest.mark.parametrize("scatterer", [gaussian(5.0), MODELS[-1]], ids=model_name)
def test_results_are_bit_identical_for_one_seed_and_any_number_of_threads(scatterer: Scatterer) -> None:
    directions, paths = spread_out(100), 4 * CHUNK + 77
    threads, result = numba.get_num_threads(), []
    try:
        for count in (1, threads, threads):
            numba.set_num_threads(count)
            result.append(fields(forward_throughput(WIDE, 30.0, directions, scatterer, paths, seed=3)))
    finally:
        numba.set_num_threads(threads)
    assert all(np.array_equal(one, other) for run in result[1:] for one, other in zip(result[0], run, strict=True))
    assert np.any(result[0][2] > 0.0)
    other_seed = forward_throughput(WIDE, 30.0, directions, scatterer, paths, seed=4)
    assert not np.array_equal(result[0][0], other_seed.throughput_m2sr)


def test_detectors_do_not_depend_on_each_other() -> None:
    directions = np.concatenate([from_specular(30.0, np.arange(0.0, 20.0, 0.05), 40.0), spread_out(50)])
    together = forward_throughput(WIDE, 30.0, directions, gaussian(10.0), 200_000, seed=1)
    alone = [forward_throughput(WIDE, 30.0, directions[k : k + 1], gaussian(10.0), 200_000, seed=1) for k in (0, 77, 399, 420)]
    assert [each.throughput_m2sr[0] for each in alone] == together.throughput_m2sr[[0, 77, 399, 420]].tolist()


def test_the_number_of_paths_is_rounded_up_to_blocks_also_without_detectors() -> None:
    assert forward_throughput(WIDE, 30.0, [UP], lambertian(), 5, seed=0).paths == BLOCK
    assert forward_throughput(WIDE, 30.0, np.zeros((0, 3)), lambertian(), BLOCK + 1).throughput_m2sr.shape == (0,)


def test_a_sample_without_a_lobe_for_this_light_gives_zero() -> None:
    result = forward_throughput(WIDE, 150.0, spread_out(20) * [1.0, 1.0, -1.0], lambertian(), 100_000)
    assert not np.any(result.single_m2sr)


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        (dict(paths=1), "paths is 1"),
        (dict(seed=-1), "seed is -1"),
        (dict(paths=None), "either paths or relative_error"),
        (dict(relative_error=0.1), "either paths or relative_error"),
        (dict(paths=None, relative_error=1.5), "relative_error is 1.5"),
        (dict(max_interactions=0), "max_interactions is 0"),
        (dict(directions=[[0.0, 0.0, 0.0]]), "a finite vector with a length"),
        (dict(directions=[[math.nan, 0.0, 1.0]]), "a finite vector with a length"),
        (dict(directions=[0.0, 0.0, 1.0]), "one row per detector"),
        (dict(sigma_deg=math.nan), "sigma_deg is nan"),
        (dict(gamma_deg=math.inf), "gamma_deg inf"),
    ],
)
def test_invalid_arguments_are_refused(change: dict[str, Any], wrong: str) -> None:
    arguments: dict[str, Any] = dict(sigma_deg=30.0, directions=[UP], scatterer=lambertian(), paths=100, seed=0)
    with pytest.raises(ValueError, match=wrong):
        forward_throughput(WIDE, **{**arguments, **change})
