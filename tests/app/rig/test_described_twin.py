"""The virtual rig that a real rig's file describes."""

from dataclasses import replace
from pathlib import Path

import pytest
import tomlkit

from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, axis_settings, open_rig, parse_rig
from goniotwin.app.rig.alignment import AlignmentFile, alignment_text
from goniotwin.app.rig.described_twin import DescribedTwin, described_twin
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import TwinModel
from goniotwin.twin.optics import Deviation
from tests.conftest import RIG, Change, changed, tmcl_axis


def real_rig(*changes: Change) -> RigDescription:
    """The example rig's file, changed into the file of a real rig, with further changes."""
    document = tomlkit.parse(changed(RIG.read_text(encoding="utf-8"), changes))
    document.remove("twin")
    document.remove("simulated")
    text = tomlkit.dumps(document).replace("twin://virtual/axes", "/dev/ttyACM0").replace("twin://virtual/mono", "/dev/ttyUSB0")
    for k in range(5):
        text = text.replace(f"twin://virtual/adc-{k}", f"adam-{k}:502")
    return parse_rig(text.replace("twin://virtual/monitor", "1313:8078:P0012345"), Path(), "real.toml")


def described(*changes: Change, **models: str) -> DescribedTwin:
    return described_twin(real_rig(*changes), "etalon", ["paper"], models)


def model(twin: DescribedTwin) -> TwinModel:
    made = twin.rig.model()
    assert made is not None
    return made


def test_a_standard_has_its_certified_radiance_factor() -> None:
    twin = described_twin(real_rig(), {"etalon": None, "grey": 0.5}, [], {})
    assert twin.rig.file.twin is not None
    factors = {name: getattr(table, "reflectance", None) for name, table in twin.rig.file.twin.samples.items()}
    assert factors == {"etalon": real_rig().file.etalon.radiance_factor, "grey": 0.5}
    assert any("grey is an ideal diffuser" in each and "0.5, its certified" in each for each in twin.assumptions)


def test_its_mechanics_are_the_operators_nominal_ones() -> None:
    nominal = "[axes.sigma]\nsense = -1\nzero_offset_deg = 12.5\nbacklash_deg = 0.05\nencoder_counts = 40000"
    twin = model(described(("[axes.sigma]", nominal)))
    sigma = twin.axes["sigma"]
    assert (sigma.motor, sigma.gear, sigma.sense, sigma.zero_deg) == (4, 36.0, -1, 12.5)
    assert (sigma.backlash_deg, sigma.encoder_counts, sigma.encoder) == (0.05, 40_000, True)
    assert twin.axes["shift"].encoder is False


def test_its_photodiodes_times_and_geometry_are_the_operators_nominal_ones() -> None:
    twin = model(
        described(
            ("upper_deg = [0, 5,", "upper_deg = [1, 5,"),
            ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e5, 1e7]\nconversions_per_s = 10"),
            ("baudrate = 9600", "baudrate = 9600\nslew_nm_per_s = 90.0\nshutter_s = 0.4"),
            ("arc_radius_mm = 300.0", "arc_radius_mm = 320.0\nfield_deg = 1.5"),
        )
    )
    assert twin.photodiodes.upper_deg[:2] == (1.0, 5.0)
    assert twin.electronics.gains_v_per_a == (1e5, 1e7)
    assert twin.electronics.conversions_per_s == 10
    assert (twin.monochromator.slew_nm_per_s, twin.monochromator.shutter_s) == (90.0, 0.4)
    assert (twin.instrument.arc_radius_mm, twin.instrument.field_deg) == (320.0, 1.5)


@pytest.mark.parametrize("change", [[], [("[axes.sigma]", "[axes.sigma]\nsense = -1"), ("gear = 36.0 ", "gear = 35.0 ")]])
def test_an_axis_reaches_its_target_also_with_a_wrong_sense_or_gear(change: list[Change]) -> None:
    """A wrong sense or gear cancels, and cannot be found with the described twin."""
    twin = described(*change)
    with open_rig(twin.rig, VirtualClock()) as opened:
        opened.connect()
        axis = opened.rig.axes["sigma"]
        pending = axis.start(30.0)
        while not pending.poll():
            opened.rig.clock.sleep_until(pending.due)
        assert opened.virtual is not None
        assert opened.virtual.plant.angle_deg("sigma", opened.rig.clock.now()) == pytest.approx(30.0, abs=0.001)


def test_properties_that_the_file_does_not_have_are_listed_as_assumptions() -> None:
    twin = described()
    assert [each.partition(" ")[0] for each in twin.assumptions] == ["lamp,", "etalon", "paper"]
    assert "Gaussian of 5 deg" in twin.assumptions[2]
    assert "--sample paper=MODEL" in twin.assumptions[2]
    assert "ideal diffuser on both sides with a reflectance of 0.99" in twin.assumptions[1]


def test_a_sample_with_a_given_model_is_not_an_assumption() -> None:
    twin = described(paper="lambertian:reflectance=0.5+gaussian:width_deg=3,reflectance=0.3")
    assert not any("paper" in each for each in twin.assumptions)
    assert model(twin).samples["paper"].name == "lambertian 0.5 + gaussian 3 deg one_over_e luminance"


@pytest.mark.parametrize("text", ["plaster", "gaussian:width=3", "table:"])
def test_an_invalid_model_is_refused(text: str) -> None:
    with pytest.raises(UserError, match=r"sample"):
        described(paper=text)


def test_its_text_is_a_complete_rig_file() -> None:
    """The journal of a rehearsal contains it, and can be reduced without any other file."""
    twin = described(paper="gaussian:width_deg=2,form=half_width")
    again = parse_rig(twin.rig.text, twin.rig.folder, "again")
    assert again.simulated
    assert again.model_hash() == twin.rig.model_hash()
    assert all(address.startswith("twin://") for address in again.file.addresses)
    nominal = axis_settings(real_rig().file)
    assert {name: axis_settings(again.file)[name] for name in AXES} == nominal


def test_it_is_off_by_what_an_alignment_has_found() -> None:
    """The values of the rehearsal are corrected by the alignment: without this they would be wrong by it."""
    found = AlignmentFile(
        alignment=1,
        simulated=False,
        rig="r",
        rig_sha256="",
        campaign="c",
        journal="",
        measured="",
        sample="s",
        mountings=(),
        values=0,
        chi_square=1.0,
        open_beam=0,
        combinations=(),
        covariance=(),
        inputs={"beta_zero": 0.1, "mirror_3_tilt_x": 0.05, "arc_tilt_y": 0.0},
    )
    text = alignment_text(found)
    twin = described_twin(replace(real_rig(), alignment=text), "etalon", ["paper"], {})
    assert twin.rig.alignment == text
    assert model(twin).axes["beta"].zero_deg == pytest.approx(model(described()).axes["beta"].zero_deg + 0.1)
    assert dict(model(twin).instrument.deviations) == {"mirror_3": Deviation(rx_deg=0.05)}


def test_a_virtual_rig_is_not_changed() -> None:
    virtual = parse_rig(RIG.read_text(encoding="utf-8"), RIG.parent, str(RIG))
    assert described_twin(virtual, "etalon", ["gaussian-5"], {}) == DescribedTwin(virtual, ())
    other = described_twin(virtual, "etalon", ["gaussian-5"], {"gaussian-5": "gaussian:width_deg=7"})
    assert other.assumptions == ()
    assert other.rig.file.twin is not None
    assert virtual.file.twin is not None
    assert other.rig.file.twin.axes == virtual.file.twin.axes
    assert other.rig.file.twin.samples["etalon"] == virtual.file.twin.samples["etalon"]


def test_limit_switches_are_beyond_the_soft_limits() -> None:
    switches = "[axes.beta]\nswitches = true\nright_polarity = 1\nleft_polarity = 1"
    twin = described(("[axes.beta]", switches))
    beta = model(twin).axes["beta"]
    assert (beta.lower_switch_deg, beta.upper_switch_deg) == (-6.0, 361.0)
    assert sum("beta's limit switches" in each for each in twin.assumptions) == 2
    with open_rig(twin.rig, VirtualClock()) as opened:
        opened.connect()
        switched = tmcl_axis(opened.rig, "beta").switches()
        assert not switched.right
        assert not switched.left


def test_devices_of_other_kinds_become_the_twins_and_are_listed_as_assumptions() -> None:
    twin = described(
        ("baudrate = 9600", "baudrate = 19200"),
        ("range_a = 500e-9", 'range_a = 50e-9\ndialect = "b2980"'),
        ("gain_uncertainty = 0.001", "conversions_per_s = 60.0"),
    )
    assumptions = " ".join(twin.assumptions)
    assert all(each in assumptions for each in ("9600 Bd", "PM100D", "2.8e-07 A", "100 conversions"))
    with open_rig(twin.rig, VirtualClock()) as opened:
        opened.connect()


def test_modules_of_one_motor_each_share_a_bus() -> None:
    changes = [
        (f"motor = {motor}\ngear", f"motor = 0\nmodule = {module}\ngear") for module, motor in ((1, 3), (2, 4), (3, 5), (4, 0))
    ]
    twin = described(*changes)
    controller = model(twin).controller
    assert (controller.kind, controller.wire) == ("tmcm-1240", "rs485")
    with open_rig(twin.rig, VirtualClock()) as opened:
        opened.connect()


def test_converters_on_a_serial_line_stay_on_a_serial_line() -> None:
    units = ", ".join(f'"twin://virtual/adc-{k}"' for k in range(5))
    lines = ", ".join(f'"rtu:/dev/ttyUSB1?unit={k + 1}&baudrate=19200"' for k in range(5))
    twin = described(
        (f"units = [{units}]", f"units = [{lines}]"),
        ('kind = "adam-6017"', 'kind = "adam-4117"\nraw_format = "twos-complement"'),
        ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e10]"),
    )
    assert (model(twin).electronics.module, model(twin).electronics.baudrate) == ("adam-4117", 19200)
    assert model(twin).electronics.raw_format == "twos-complement"
    with open_rig(twin.rig, VirtualClock()) as opened:
        opened.connect()
