"""An instrument that cannot be is refused, by the name of what is wrong with it."""

import math

import pytest

from goniotwin.twin.optics import Instrument


def test_the_beam_of_the_default_has_the_divergence_that_the_paper_asks_for() -> None:
    # paper, section 3.1: 0.5 to 1 deg.
    assert 0.5 < Instrument().divergence_deg < 1.0
    assert Instrument().pupil_distance_mm == 800.0


@pytest.mark.parametrize("name", ["pupil_radius_mm", "mirror_distance_mm", "spot_side_mm", "field_deg"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_dimension_must_be_positive_and_finite(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Instrument(**{name: value})  # type: ignore[arg-type]


def test_a_mirror_reflects_at_most_all_and_a_cone_is_narrower_than_a_plane() -> None:
    with pytest.raises(ValueError, match="mirror_reflectance"):
        Instrument(mirror_reflectance=1.01)
    with pytest.raises(ValueError, match="field_deg"):
        Instrument(field_deg=180.0)
