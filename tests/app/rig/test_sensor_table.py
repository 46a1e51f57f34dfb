"""`[twin.sensor]` of a virtual rig's file: the real sensor unit, and the estimator that computes its light."""

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import Instrument, RealSensor
from tests.conftest import Writer

LIGHT = "[twin.light]"
FORWARD = '[twin.optics]\nestimator = "forward"\n\n'


def instrument(write_rig: Writer, text: str) -> Instrument:
    model = read_rig(write_rig((LIGHT, f"{text}\n\n{LIGHT}"))).model()
    assert model is not None
    return model.instrument


def test_without_the_table_the_detectors_are_virtual(write_rig: Writer) -> None:
    assert instrument(write_rig, "").sensor is None


def test_the_table_gives_the_dimensions_of_the_sensor_or_their_defaults(write_rig: Writer) -> None:
    assert instrument(write_rig, "[twin.sensor]").sensor == RealSensor()
    given = "[twin.sensor]\nlens_diameter_mm = 6.0\nfocal_length_mm = 25.0\naperture_mm = 0.4\ndiaphragm_mm = 25.0\n"
    result = instrument(write_rig, given + "detector_mm = 26.0\ndetector_side_mm = 2.0")
    assert result.sensor == RealSensor(6.0, 25.0, 0.4, 25.0, 26.0, 2.0)
    assert result.detector_diameter_mm == 6.0


def test_a_sensor_that_is_not_a_simple_disc_needs_the_forward_estimator(write_rig: Writer) -> None:
    other = "[twin.sensor]\ndiaphragm_mm = 18.0"
    assert instrument(write_rig, FORWARD + other).sensor == RealSensor(diaphragm_mm=18.0)
    with pytest.raises(
        UserError, match=r"twin\.sensor: its diaphragm is at 18 mm .* set optics\.estimator = \"forward\""
    ) as caught:
        instrument(write_rig, other)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[twin.sensor]\naperture_mm = 0.0", r"twin\.sensor\.aperture_mm: .*greater than 0"),
        ("[twin.sensor]\naperture = 0.1", r"twin\.sensor\.aperture: there is no such key; did you mean 'aperture_mm'\?"),
        ("[twin.sensor]\ndetector_mm = 5.0", r"twin\.sensor: detector_mm is 5, before the diaphragm at 20 mm"),
        ("[twin.optics]\nfield_deg = 0.5\n[twin.sensor]", r"twin\.optics\.field_deg: is of virtual detectors.*remove one of"),
        ("[twin.optics]\ndetector_diameter_mm = 5.0\n[twin.sensor]", r"twin\.optics\.detector_diameter_mm: is of virtual"),
    ],
)
def test_an_impossible_sensor_is_refused_with_its_key(write_rig: Writer, text: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        instrument(write_rig, text)


def test_the_model_hash_covers_the_sensor(write_rig: Writer) -> None:
    texts = ["", "[twin.sensor]", "[twin.sensor]\naperture_mm = 0.2", "[twin.sensor]\ndetector_side_mm = 3.5"]
    digests = {read_rig(write_rig((LIGHT, f"{text}\n\n{LIGHT}"))).model_hash() for text in texts}
    assert len(digests) == len(texts)
