"""The fast estimator: absolute value, error, reproducibility."""

import math
from typing import Any

import numba
import numpy as np
import pytest

from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    arc_direction,
    from_specular,
    gaussian,
    lambertian,
    luminance_factor,
    throughput,
)
from tests.sizes import parted

REFLECTED = 0.95**3
PUPIL_SINE2 = math.sin(math.atan(5.0 / 800.0)) ** 2


@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("polar_deg", [0.0, 20.0, 50.0])
def test_a_detector_with_a_wide_spot_receives_its_own_etendue(sigma_deg: float, polar_deg: float) -> None:
    wide = Instrument(spot_side_mm=40.0, mirror_side_mm=200.0, obstruction=False)
    flux = throughput(wide, sigma_deg, arc_direction([polar_deg], [130.0]), lambertian(0.6), rays=1 << 14)[0]
    # Irradiance pi L sin^2 cos of a round pupil on the axis, f = 0.6 / pi, the disc's area times its projected cone.
    etendue_m2sr = math.pi * 0.0025**2 * math.pi * math.sin(math.radians(0.25)) ** 2
    closed = REFLECTED * 0.6 * PUPIL_SINE2 * math.cos(math.radians(sigma_deg)) * etendue_m2sr
    assert flux == pytest.approx(closed, rel=2e-4)


@pytest.mark.parametrize("polar_deg", [0.0, 60.0])
def test_a_detector_that_sees_a_whole_small_spot_receives_the_light_on_its_disc(polar_deg: float) -> None:
    small = Instrument(spot_side_mm=0.05, field_deg=1.2, obstruction=False)
    flux = throughput(small, 30.0, arc_direction([polar_deg], [0.0]), lambertian(), rays=1 << 14)[0]
    disc = math.pi * math.sin(math.atan(2.5 / 300.0)) ** 2
    spot_m2 = (0.05e-3) ** 2 * math.cos(math.radians(polar_deg))
    closed = REFLECTED * PUPIL_SINE2 * math.cos(math.radians(30.0)) * spot_m2 * disc
    # Two rays in three miss the disc; the error is that of their count.
    assert flux == pytest.approx(closed, rel=3e-3)


def cut(sigma_deg: float, theta_max: float) -> Any:
    """Directions about the specular one, at 9 azimuths, no lower than 85 deg."""
    theta, phi = np.meshgrid(np.append(np.arange(0.0, theta_max, 1.3), theta_max), np.arange(0.0, 360.0, 40.0))
    directions = from_specular(sigma_deg, theta.ravel(), phi.ravel())
    return directions[directions[:, 2] > math.cos(math.radians(85.0))]


@parted(4)
@pytest.mark.parametrize("sigma_deg", [0.0, 20.0, 30.0, 60.0, 80.0])
def test_seven_rays_give_the_ratio_of_a_gaussian_of_5_deg_to_one_in_a_thousand_parts(sigma_deg: float, part: int) -> None:
    instrument, directions = Instrument(obstruction=False), cut(sigma_deg, 10.0)
    few = luminance_factor(instrument, sigma_deg, directions, gaussian(5.0))
    many = luminance_factor(instrument, sigma_deg, directions, gaussian(5.0), rays=(1 << 18) // part)
    assert np.max(np.abs(few / many - 1.0)) < 1e-3


def test_the_throughput_changes_smoothly_with_the_direction() -> None:
    # Etalon and sample are measured at poses that differ by a few steps of an axis: here 0.002 deg, of a bundle 1.5 deg wide.
    polar = np.arange(20.0, 22.0, 0.002)
    signal = throughput(Instrument(obstruction=False), 30.0, arc_direction(polar, 77.0), lambertian())
    assert np.max(np.abs(np.diff(signal) / signal[1:])) < 2e-4


@parted(4)
def test_seven_rays_give_the_flux_to_a_few_parts_in_a_thousand(part: int) -> None:
    directions = cut(30.0, 10.0)
    few = throughput(Instrument(obstruction=False), 30.0, directions, lambertian())
    many = throughput(Instrument(obstruction=False), 30.0, directions, lambertian(), rays=(1 << 18) // part)
    assert np.max(np.abs(few / many - 1.0)) < 4e-3


def test_the_ratio_of_the_etalon_to_itself_is_one_and_nan_in_hidden_directions() -> None:
    factors = luminance_factor(Instrument(), 0.0, [[0.0, 0.0, 1.0], [0.5, 0.0, 0.8]], lambertian())
    assert np.isnan(factors[0])
    assert factors[1] == 1.0


def test_results_are_bit_identical_for_any_number_of_threads_and_directions() -> None:
    directions = cut(30.0, 10.0)
    first = throughput(Instrument(), 30.0, directions, gaussian(5.0))
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert np.array_equal(throughput(Instrument(), 30.0, directions, gaussian(5.0)), first)
    finally:
        numba.set_num_threads(threads)
    alone = [throughput(Instrument(), 30.0, directions[k : k + 1], gaussian(5.0))[0] for k in range(10)]
    assert np.array_equal(alone, first[:10])


def test_detectors_and_light_behind_the_sample_give_zero() -> None:
    below = arc_direction(np.arange(0.0, 91.0, 10.0), 0.0, lower=True)
    assert not np.any(throughput(Instrument(), 30.0, below, lambertian()))
    assert not np.any(throughput(Instrument(), 150.0, np.vstack([below, -below]), lambertian()))


def test_a_square_hole_turned_by_90_deg_gives_the_same_result() -> None:
    directions = cut(40.0, 8.0)
    straight = throughput(Instrument(), 40.0, directions, lambertian(), rays=1 << 14)
    # Other rays, the same integral: they differ by the error of the quadrature.
    turned = throughput(Instrument(), 40.0, directions, lambertian(), rays=1 << 14, gamma_deg=90.0)
    assert turned == pytest.approx(straight, rel=2e-3)


def test_mirrors_smaller_than_the_beam_reduce_the_flux() -> None:
    directions = cut(30.0, 8.0)
    whole = throughput(Instrument(obstruction=False), 30.0, directions, lambertian())
    # The paper's mirrors of 20 mm are wider than the beam; mirrors of 6 mm are not.
    larger = throughput(Instrument(obstruction=False, mirror_side_mm=60.0), 30.0, directions, lambertian())
    smaller = throughput(Instrument(obstruction=False, mirror_side_mm=6.0), 30.0, directions, lambertian())
    assert np.array_equal(whole, larger)
    assert np.all(smaller < 0.8 * whole)


def test_an_invalid_number_of_rays_is_refused() -> None:
    with pytest.raises(ValueError, match="multiple of 4"):
        throughput(Instrument(), 30.0, [[0.0, 0.0, 1.0]], lambertian(), rays=6)


@pytest.mark.parametrize("tilt_deg", [1.0, 3.0, 6.0])
def test_photodiodes_that_look_past_the_spot_have_no_light(tilt_deg: float) -> None:
    """A number, and not none: where cone and disc have no ray in common there is neither spread nor weight."""
    directions = arc_direction(np.arange(0.0, 86.0, 2.5), 180.0)
    for axis in ("rx_deg", "ry_deg"):
        seen = throughput(Instrument(deviations={"sensor": Deviation(**{axis: tilt_deg})}), 30.0, directions, lambertian(1.0))
        assert np.isfinite(seen).all()
        assert np.all(seen >= 0.0)
        assert tilt_deg < 2.0 or np.all(seen < 1e-3 * throughput(Instrument(), 30.0, directions, lambertian(1.0)).max())
