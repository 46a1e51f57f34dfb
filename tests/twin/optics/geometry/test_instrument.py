"""Validation of an instrument's dimensions, with the name of the invalid field."""

import math

import pytest

from goniotwin.twin.optics import Instrument


def test_the_default_beam_has_the_divergence_of_the_paper() -> None:
    # paper, section 3.1: 0.5 to 1 deg.
    assert 0.5 < Instrument().divergence_deg < 1.0
    assert Instrument().pupil_distance_mm == 800.0


@pytest.mark.parametrize("name", ["pupil_radius_mm", "mirror_distance_mm", "spot_side_mm", "field_deg"])
@pytest.mark.parametrize("value", [0.0, -1.0, math.nan, math.inf])
def test_a_dimension_must_be_positive_and_finite(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        Instrument(**{name: value})  # type: ignore[arg-type]


def test_a_reflectance_is_at_most_one_and_a_field_below_180_deg() -> None:
    with pytest.raises(ValueError, match="mirror_reflectance"):
        Instrument(mirror_reflectance=1.01)
    with pytest.raises(ValueError, match="field_deg"):
        Instrument(field_deg=180.0)
