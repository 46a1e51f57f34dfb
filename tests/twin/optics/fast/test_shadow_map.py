"""Shadow of the mirror unit, compared with its geometry."""

import numpy as np
import pytest

from goniotwin.twin.optics import Instrument, shadow_map


def test_at_normal_incidence_mirror_3_hides_the_normal_and_its_own_area_only() -> None:
    """Half sides of 10 mm, and of 7.1 mm where it is tilted, at 200 mm, plus and minus spot and disc: 1.2 to 4.5 deg."""
    result = shadow_map(Instrument(), 0.0, 0.5)
    assert not np.any(result.visible[result.polar_deg <= 1.0])
    clear = result.visible[(result.polar_deg >= 4.5) & (result.polar_deg < 40.0)]
    assert np.all(clear == 1.0)
    assert np.all(result.visible[:, 0] == result.visible[:, -1])


def test_two_shadows_turn_with_the_mirror_unit() -> None:
    result = shadow_map(Instrument(), 30.0)
    polar, azimuth = np.meshgrid(result.polar_deg, result.azimuth_deg, indexing="ij")
    hidden = (result.visible < 0.5) & (polar < 89.0)
    around_mirror_3 = hidden & (np.abs(polar - 30.0) < 6.0) & ((azimuth < 12.0) | (azimuth > 348.0))
    assert np.any(around_mirror_3)
    rest = hidden & ~around_mirror_3
    assert np.any(rest)
    assert np.all(np.abs(azimuth[rest] - 270.0) < 60.0)  # mirror 2 is on the lamp's side of the arc


def test_a_mirror_unit_above_does_not_hide_the_lower_arc() -> None:
    result = shadow_map(Instrument(), 30.0, 5.0, lower=True)
    assert np.all(result.visible[result.polar_deg < 85.0] == 1.0)


@pytest.mark.parametrize("step_deg", [0.0, -1.0, 0.05, 0.7, float("nan")])
def test_an_invalid_step_is_refused(step_deg: float) -> None:
    with pytest.raises(ValueError, match="step_deg"):
        shadow_map(Instrument(), 0.0, step_deg)
