"""A rayset as the source instead of the uniform exit pupil."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    IlluminationUnit,
    Instrument,
    apply_spectrum,
    forward_throughput,
    from_specular,
    record,
    replay,
)
from goniotwin.twin.optics.geometry.instrument import SampleFrames
from goniotwin.twin.optics.geometry.mirrors import pupil
from goniotwin.twin.optics.illumination.rayset import RaySource
from tests.sizes import parted
from tests.twin.optics.agreement import agree
from tests.twin.optics.models import gaussian, lambertian

WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
UNIT = IlluminationUnit()
X_MM, Y_MM, Z_MM = (float(each) for each in pupil(Instrument())[0])
PLACE = (X_MM, Y_MM, Z_MM)
RADIANCE = 7.0


def around(sigma_deg: float) -> Floats:
    theta, phi = np.meshgrid([0.0, 7.0, 14.0, 21.0, 28.0], np.arange(0.0, 360.0, 72.0))
    return from_specular(sigma_deg, theta.ravel(), phi.ravel())[4:]


def uniform_rays(count: int, side_mm: float = 7.5) -> RaySource:
    """Rays of a uniform exit pupil through a square that contains the hole, each with its part of the flux."""
    random = np.random.default_rng(1)
    radius, turn = 5.0 * np.sqrt(random.random(count)), 2.0 * np.pi * random.random(count)
    starts = np.stack([radius * np.cos(turn), np.zeros(count), radius * np.sin(turn)], axis=1)
    ends = np.stack([*random.uniform(-0.5 * side_mm, 0.5 * side_mm, (2, count)), np.full(count, 800.0)], axis=1)[:, [0, 2, 1]]
    along = ends - starts
    distance = np.linalg.norm(along, axis=1)
    along /= distance[:, None]
    flux = RADIANCE * along[:, 1] ** 2 / distance**2 * math.pi * 25.0 * side_mm**2 / count * 1e-6
    return RaySource(np.hstack([starts + PLACE, along]), flux, np.full(count, 555.0), "W")


@parted(8)
@pytest.mark.parametrize("sigma_deg", [20.0, 150.0])
def test_rays_of_a_uniform_pupil_give_the_result_of_the_pupil(sigma_deg: float, part: int) -> None:
    directions, sample = around(sigma_deg), gaussian(15.0, side="both")
    plain = forward_throughput(WIDE, sigma_deg, directions, sample, 5_000_000 // part, seed=1)
    source = uniform_rays(400_000 // part)
    result = forward_throughput(WIDE, sigma_deg, directions, sample, 10_000_000 // part, seed=2, source=source)
    agree(plain.single_m2sr, plain.single_error, result.single_m2sr, result.single_error)
    error = math.sqrt(float(np.sum(plain.single_error**2 + result.single_error**2)))
    assert result.single_m2sr.sum() == pytest.approx(plain.single_m2sr.sum(), abs=4.0 * error)
    assert error < 2e-3 * math.sqrt(part) * plain.single_m2sr.sum()
    # 400,000 rays, half of them in the hole: the error of the mean flux is 0.2 %.
    assert result.radiance == pytest.approx(RADIANCE, rel=8e-3 * math.sqrt(part))
    assert (result.unit, plain.unit, plain.radiance) == ("W", None, 1.0)


def test_light_beside_the_hole_lights_the_frame() -> None:
    everything = Instrument(obstruction=False, detector_diameter_mm=1e7, field_deg=179.9)
    frames = SampleFrames(reflectance=0.4)
    result = forward_throughput(
        everything, 0.0, [[0.0, 0.0, 1.0]], lambertian(), 300_000, source=uniform_rays(200_000), sample_frames=frames
    )
    expected = 0.4 * (7.5**2 / 5.0**2 - 1.0) * result.single_m2sr[0]
    assert result.stray_m2sr[0] == pytest.approx(expected, rel=0.02)


@parted(4)
def test_a_recorded_rayset_differs_by_the_nonuniformity_of_its_light_at_most(part: int) -> None:
    source = replay(record(UNIT, 300_000, seed=3), UNIT, PLACE)
    directions = around(30.0)
    for sample, most in ((lambertian(), 0.01), (gaussian(15.0), 0.02)):
        plain = forward_throughput(WIDE, 30.0, directions, sample, 2_000_000 // part, seed=1)
        result = forward_throughput(WIDE, 30.0, directions, sample, 2_000_000 // part, seed=2, source=source)
        error = np.hypot(plain.single_error, result.single_error) / plain.single_m2sr
        # The same flux in the hole; its distribution over the hole and the pupil differs by a few percent.
        assert np.all(np.abs(result.single_m2sr / plain.single_m2sr - 1.0) < most + 4.5 * error)


def test_the_default_wavelength_is_the_mean_of_the_rays() -> None:
    source = uniform_rays(10_000)
    source = replace(source, wavelength_nm=np.where(np.arange(10_000) % 2, 500.0, 600.0))
    sample = apply_spectrum([500.0, 600.0], [0.2, 0.8], lambertian())
    result = forward_throughput(WIDE, 30.0, around(30.0), sample, 100_000, source=source)
    mean = float(np.average(source.wavelength_nm, weights=source.flux))
    same = forward_throughput(WIDE, 30.0, around(30.0), sample, 100_000, source=source, wavelength_nm=mean)
    assert np.array_equal(result.throughput_m2sr, same.throughput_m2sr)


def test_rays_that_miss_the_hole_are_refused() -> None:
    source = uniform_rays(100)
    elsewhere = replace(source, rays=source.rays + np.array([50.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    with pytest.raises(ValueError, match="none of its rays reaches the hole over the mirrors"):
        forward_throughput(WIDE, 30.0, around(30.0), lambertian(), 1000, source=elsewhere)
