"""Regular reflection and transmission: the pupil's image compared with closed forms and with drawn rays."""

import math

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    apply_spectrum,
    gaussian,
    light_direction,
    regular,
    spectral_throughput,
    specular_direction,
    sum_samples,
    throughput,
)
from goniotwin.twin.optics.geometry.scene import scene_at
from tests.sizes import parted

OPEN = Instrument(obstruction=False)
REFLECTED = 0.95**3
RAYS = 2_000_000


def monte_carlo(
    instrument: Instrument, sigma_deg: float, directions: Floats, transmits: bool, rays: int
) -> tuple[Floats, Floats]:
    """Throughputs and their standard errors from rays through pupil and hole, each traced to the detectors."""
    scene, random = scene_at(instrument, sigma_deg), np.random.Generator(np.random.Philox(2026))
    radius, turn = np.sqrt(random.random(rays)), 2.0 * np.pi * random.random(rays)
    start = scene.pupil[0] + np.outer(radius * np.cos(turn), scene.pupil[1]) + np.outer(radius * np.sin(turn), scene.pupil[2])
    half = 0.5 * instrument.spot_side_mm
    place = np.column_stack([random.uniform(-half, half, (rays, 2)), np.zeros(rays)])
    light = start - place
    distance = np.linalg.norm(light, axis=1)
    light /= distance[:, None]
    weight = light[:, 2] * (light @ scene.pupil[3]) / distance**2
    leaving = -light if transmits else light * [-1.0, -1.0, 1.0]
    result = []
    for centre, axis in zip(*scene.detectors(instrument, directions), strict=True):
        along = leaving @ axis
        reach = ((centre - place) @ axis) / along
        off = np.linalg.norm(place + reach[:, None] * leaving - centre, axis=1)
        inside = (off <= 0.5 * instrument.detector_diameter_mm) & (along >= math.cos(math.radians(0.5 * instrument.field_deg)))
        result.append(weight * (inside & (reach > 0.0)))
    scale = REFLECTED * math.pi * instrument.pupil_radius_mm**2 * instrument.spot_side_mm**2 * 1e-6 / instrument.spot_side_mm**2
    values = np.array(result) * scale * instrument.spot_side_mm**2
    return values.mean(axis=1), values.std(axis=1) / math.sqrt(rays)


@parted(32)
@pytest.mark.parametrize(("sigma_deg", "transmits"), [(0.0, False), (30.0, False), (60.0, False), (30.0, True), (150.0, True)])
def test_the_image_of_the_pupil_agrees_with_traced_rays(sigma_deg: float, transmits: bool, part: int) -> None:
    centre = -light_direction(sigma_deg) if transmits else specular_direction(sigma_deg)
    directions = centre + np.array([[0, 0, 0], [4e-3, 0, 0], [0, 6e-3, 0], [0, 0, 8e-3], [0, 1.1e-2, 0], [0.05, 0, 0]])
    mirror = regular(1.0, transmits=transmits, side="both")
    exact = throughput(OPEN, sigma_deg, directions, mirror)
    mean, error = monte_carlo(OPEN, sigma_deg, directions, transmits, RAYS // part)
    seen = error > 0.0
    deviation = (exact[seen] - mean[seen]) / error[seen]
    assert np.sum(seen) >= 4
    assert np.sum(deviation**2) < 20.0  # 4 or 5 degrees of freedom: exceeded once in a thousand
    assert exact[-1] == 0.0


def test_a_wide_detector_receives_the_whole_beam() -> None:
    """Closed form: the beam's etendue, two coaxial apertures of 5 mm radius and 5 mm side at 800 mm."""
    wide = Instrument(detector_diameter_mm=60.0, field_deg=20.0, obstruction=False)
    etendue_m2sr = math.pi * 0.005**2 * 0.005**2 / 0.8**2
    for sigma_deg, transmits in ((0.0, False), (0.0, True)):
        centre = -light_direction(sigma_deg) if transmits else specular_direction(sigma_deg)
        flux = throughput(wide, sigma_deg, centre[None], regular(0.5, transmits=transmits))[0]
        assert flux == pytest.approx(0.5 * REFLECTED * etendue_m2sr, rel=2e-3)


def test_a_mirror_in_front_hides_the_image() -> None:
    """At normal incidence mirror 3 is in the specular direction."""
    assert throughput(Instrument(), 0.0, specular_direction(0.0)[None], regular(1.0))[0] == 0.0
    assert throughput(Instrument(), 30.0, specular_direction(30.0)[None], regular(1.0))[0] > 0.0


def test_a_sum_of_samples_adds_up_with_the_weights_of_each_wavelength() -> None:
    directions = specular_direction(30.0)[None]
    lobe, mirror = gaussian(5.0, reflectance=0.4), regular(0.05)
    both = apply_spectrum([400.0, 700.0], [1.0, 0.5], sum_samples(lobe, mirror))
    parts = throughput(OPEN, 30.0, directions, lobe) + throughput(OPEN, 30.0, directions, mirror)
    assert throughput(OPEN, 30.0, directions, both, wavelength_nm=550.0) == pytest.approx(0.75 * parts)
    at_once = spectral_throughput(OPEN, 30.0, directions, both, [400.0, 550.0, 700.0])
    one_by_one = [throughput(OPEN, 30.0, directions, both, wavelength_nm=each) for each in (400.0, 550.0, 700.0)]
    np.testing.assert_allclose(at_once, one_by_one, rtol=1e-12)
