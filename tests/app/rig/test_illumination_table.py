"""`[twin.illumination]` of a virtual rig's file: deviations of the elements within the illumination unit."""

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.simulation.source import illumination_unit
from goniotwin.twin.optics import Deviation, Instrument
from tests.conftest import Writer

LIGHT = "[twin.light]"
SLIT = "[twin.illumination.slit]\nx_mm = 0.05\n[twin.illumination.reflector]\nrz_deg = 0.1\n"


def instrument(write_rig: Writer, text: str) -> Instrument:
    model = read_rig(write_rig((LIGHT, f"{text}\n\n{LIGHT}"))).model()
    assert model is not None
    return model.instrument


def test_the_tables_are_the_deviations_of_the_unit(write_rig: Writer) -> None:
    rig = instrument(write_rig, SLIT)
    wanted = {"reflector": Deviation(rz_deg=0.1), "slit": Deviation(x_mm=0.05)}
    assert dict(rig.illumination) == wanted
    assert illumination_unit(rig, 555.0, 0.0, 5.0).deviations == wanted
    assert dict(instrument(write_rig, "").illumination) == {}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[twin.illumination.lens]\nx_mm = 0.1", "twin: illumination of 'lens': no such element; known are arc, reflector, "),
        ("[twin.illumination.slit]\nx_m = 0.1", r"twin\.illumination\.slit\.x_m: there is no such key; did you mean 'x_mm'\?"),
        ("[twin.illumination.slit]\nx_mm = inf", r"twin\.illumination\.slit.*finite"),
        ('[twin.illumination.slit]\nx_mm = "wide"', r"twin\.illumination\.slit\.x_mm: "),
    ],
)
def test_an_impossible_deviation_is_refused_in_one_line(write_rig: Writer, text: str, message: str) -> None:
    with pytest.raises(UserError, match=message) as caught:
        instrument(write_rig, text)
    assert "\n" not in str(caught.value)


def test_the_model_hash_covers_the_deviations_and_a_rig_without_them_keeps_its_hash(write_rig: Writer) -> None:
    texts = ["", SLIT, "[twin.illumination.slit]\nx_mm = 0.06", "[twin.illumination.arc]\nx_mm = 0.06"]
    digests = {read_rig(write_rig((LIGHT, f"{text}\n\n{LIGHT}"))).model_hash() for text in texts}
    assert len(digests) == len(texts)
    assert read_rig(write_rig()).model_hash() in digests
