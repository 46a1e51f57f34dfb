"""The beam reaches the sample over three mirrors, at every sigma."""

import numpy as np
import pytest

from goniotwin.twin.optics import Instrument, light_direction, pupil_image
from goniotwin.twin.optics.geometry.mirrors import mirrors_at, reflect
from goniotwin.twin.optics.geometry.scene import scene_at

EVERY_SIGMA = np.arange(0.0, 180.1, 7.5)


@pytest.mark.parametrize("sigma_deg", EVERY_SIGMA)
def test_the_axis_of_the_beam_ends_at_the_sample(sigma_deg: float) -> None:
    unit = mirrors_at(Instrument(), sigma_deg)
    point, direction = np.array([0.0, -400.0, 0.0]), np.array([0.0, 1.0, 0.0])
    for mirror in range(3):
        leg = (unit.centres[mirror] - point) @ unit.normals[mirror] / (direction @ unit.normals[mirror])
        assert leg == pytest.approx(200.0)
        point, direction = point + leg * direction, reflect(direction, unit.normals[mirror])
        assert point == pytest.approx(unit.centres[mirror], abs=1e-9)
    assert direction == pytest.approx(-light_direction(sigma_deg), abs=1e-12)
    assert point + 200.0 * direction == pytest.approx(np.zeros(3), abs=1e-9)


@pytest.mark.parametrize("sigma_deg", EVERY_SIGMA)
def test_the_image_of_the_pupil_is_800_mm_away_along_the_light(sigma_deg: float) -> None:
    centre, axis_u, axis_v = pupil_image(Instrument(), sigma_deg)
    light = light_direction(sigma_deg)
    assert centre == pytest.approx(800.0 * light, abs=1e-9)
    axes = np.array([axis_u, axis_v, light])
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-12)


def test_the_beams_section_turns_with_the_mirror_unit() -> None:
    # Relative to the plane of incidence, whose normal is y: turned by 90 deg for a mirror unit turned by 90 deg.
    turned = [
        np.degrees(np.arctan2(axis[1], abs(axis[0]) + abs(axis[2])))
        for axis in (pupil_image(Instrument(), 0.0)[1], pupil_image(Instrument(), 90.0)[1])
    ]
    assert abs(turned[1] - turned[0]) == pytest.approx(90.0)


@pytest.mark.parametrize("sigma_deg", [0.0, 37.0, 120.0])
def test_unfolded_mirrors_lie_along_the_light(sigma_deg: float) -> None:
    images = scene_at(Instrument(), sigma_deg).images
    light = light_direction(sigma_deg if sigma_deg < 90.0 else 180.0 - sigma_deg)  # the lit side is up
    assert images[:, 0] == pytest.approx(np.outer([600.0, 400.0, 200.0], light), abs=1e-9)
    assert abs(images[:, 1] @ light) == pytest.approx(np.sqrt(0.5))


def test_an_invalid_sigma_is_refused() -> None:
    with pytest.raises(ValueError, match="sigma_deg"):
        mirrors_at(Instrument(), float("nan"))
