"""`goniotwin verify-device`: a rig that is as its file states passes, and each wrong rig is found and named.

What is wrong is set in the virtual rig, behind the wire; the operator's part of the rig file stays right.
"""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.cli.work import device_verification
from goniotwin.app.cli.work.device_verification import VerificationRecord, verify_devices
from goniotwin.drivers import TmclModule
from goniotwin.drivers.checks import CHECKS, CheckSession, CheckVerdict
from goniotwin.protocols.clock import Clock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.encoder import Encoder
from goniotwin.twin.devices.ramp_generator import RampGenerator
from tests.app.campaign.running.faulty_campaign import RTU
from tests.conftest import Change, Writer
from tests.system.command import invoke

Wrong = Callable[[VirtualRig], object]
UPPER = tuple(range(0, 90, 5))
FILTERS: Change = (
    "[photodiodes]\n",
    'filters = [{ position = 1, name = "none", from_nm = 380, to_nm = 600 }, '
    '{ position = 2, name = "OG 550", from_nm = 600, to_nm = 780, cut_on_nm = 550 }]\n\n[photodiodes]\n',
)


@pytest.fixture
def built(monkeypatch: pytest.MonkeyPatch) -> Callable[[Wrong], list[VirtualRig]]:
    """Has something done to each virtual rig that is built; returns the list of them."""
    build, rigs = VirtualRig.build, list[VirtualRig]()

    def arrange(wrong: Wrong) -> list[VirtualRig]:
        def build_wrong(model: Any, clock: Clock) -> VirtualRig:
            rigs.append(build(model, clock))
            wrong(rigs[-1])
            return rigs[-1]

        monkeypatch.setattr(VirtualRig, "build", build_wrong)
        return rigs

    return arrange


def verified(rig: Path, *devices: str, yes: bool = True, transcript: Path | None = None) -> VerificationRecord:
    return verify_devices(rig, list(devices), yes=yes, report=None, transcript=transcript, quiet=True)


def differing(found: VerificationRecord) -> dict[str, str]:
    """What came where something differs, by subject."""
    return {each.subject: each.outcome.came for each in found.records if each.outcome.verdict is CheckVerdict.DIFFERS}


def test_a_rig_as_its_file_states_passes_and_is_left_as_it_was_found(
    write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]], tmp_path: Path
) -> None:
    rigs = built(lambda _: None)
    report = tmp_path / "report.txt"
    found = json.loads(invoke("verify-device", "--rig", write_rig(FILTERS), "--yes", "--json", "--report", report).stdout)
    assert found["simulated"]
    assert {each["verdict"] for each in found["records"]} == {"ok", "cannot be checked here"}
    moved = {each["check"] for each in found["records"] if each["moves"] and each["verdict"] == "ok"}
    scale = {each.what for each in CHECKS["axes"] if "scale" in each.what}  # nobody reads it
    assert moved == {each.what for checks in CHECKS.values() for each in checks if each.moves} - scale
    text = report.read_text(encoding="utf-8")
    assert [each for each in ("(SIMULATED)", found["date"], "monitor: Thorlabs,PM100D,TWIN") if each not in text] == []
    (rig,) = rigs
    plant, now = rig.plant, rig.clock.now()
    assert [plant.angle_deg(axis, now) for axis in ("gamma", "sigma", "beta", "shift")] == pytest.approx([0.0] * 4, abs=0.01)
    assert (plant.shutter_open.at(now), plant.filter_position(now)) == (False, 1)
    assert plant.wavelength_nm.at(now) == pytest.approx(550.0, abs=0.01)


def test_nothing_moves_without_a_yes(
    write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    rigs = built(lambda _: None)
    questions: list[str] = []
    monkeypatch.setattr(device_verification, "_ask", lambda question: questions.append(question))
    found = verified(write_rig(), yes=False, transcript=tmp_path / "wires")
    assert len(questions) == 1
    assert "Type yes" in questions[0]
    assert all(each.outcome.verdict is CheckVerdict.NOT_CHECKED for each in found.records if each.moves)
    assert rigs[0].plant.shutter_open.last_change == float("-inf")
    sent = "".join(each.read_text(encoding="utf-8") for each in (tmp_path / "wires").iterdir())
    assert "GAP" in sent
    assert not [
        each for each in ("MVP", "ROR", "ROL", "RFS", "GOWAVE", "SHUTTER O", "FILTER 2") if re.search(rf"\b{each}\b", sent)
    ]


@pytest.mark.parametrize(
    ("changes", "devices", "subject", "named"),
    [
        (
            [("gamma = { motor = 3, gear = 18.0 }", "gamma = { motor = 3, gear = 18.0, encoder_counts = 40000 }")],
            ["gamma"],
            "gamma",
            "by the factor 1.28",
        ),
        (
            [("[twin.axes]", '[twin.controller]\nwire = "rs485"\nbaudrate = 9600\n\n[twin.axes]')],
            ["axes"],
            "axes",
            "not responding",
        ),
        ([("[twin.light]", "[twin.monochromator]\nslew_nm_per_s = 40\n\n[twin.light]")], ["mono"], "monochromator", "1.4"),
        ([("[twin.axes]", "[twin.monitor]\ndark_a = 2e-8\n\n[twin.axes]")], ["monitor"], "monitor", "e-08 A"),
    ],
    ids=["encoder counts", "baud rate", "slow grating", "light on the monitor"],
)
def test_a_wrong_property_of_the_rig_is_named(
    write_rig: Writer, changes: list[Change], devices: list[str], subject: str, named: str
) -> None:
    wrong = differing(verified(write_rig(*changes), *devices))
    assert set(wrong) == {subject}
    assert named in wrong[subject]


def test_two_exchanged_channels_are_named(write_rig: Writer) -> None:
    exchanged = list(UPPER)
    exchanged[3], exchanged[12] = exchanged[12], exchanged[3]
    table = f"[twin.photodiodes]\nupper_deg = {exchanged}\nlower_deg = {list(UPPER)}\n\n[twin.light]"
    wrong = differing(verified(write_rig(("[twin.light]", table)), "photodiodes"))
    assert set(wrong) == {"photodiodes"}
    assert (
        "channel 3 (module 0, input 3; upper arc, 15 deg) and channel 12 (module 1, input 4; upper arc, 60 deg) are exchanged"
        in (wrong["photodiodes"])
    )


def test_modules_on_a_serial_line_pass_and_a_wrong_raw_format_is_seen_in_the_dark(write_rig: Writer) -> None:
    assert not differing(verified(write_rig(*RTU), "photodiodes"))
    wrong = differing(
        verified(
            write_rig(*RTU, ('module = "adam-4117"', 'module = "adam-4117"\nraw_format = "twos-complement"')), "photodiodes"
        )
    )
    assert "channel 0 (module 0, input 0; upper arc, 0 deg) has" in wrong["photodiodes"]


def exchange_cables(rig: VirtualRig) -> None:
    rig.serial["mono"], rig.serial["axes"] = rig.serial["axes"], rig.serial["mono"]


def keep_shut(rig: VirtualRig) -> None:
    rig.plant.shutter_open.set = lambda t, value: None  # type: ignore[method-assign]  # a shutter that does not move


@pytest.mark.parametrize(
    ("wrong", "devices", "subjects", "named"),
    [
        (
            lambda rig: rig.plant.fade(5, 0.0),
            ["photodiodes"],
            {"photodiodes"},
            "channel 5 (module 0, input 5; upper arc, 25 deg)",
        ),
        (
            lambda rig: rig.plant.fade(20, 0.0),
            ["photodiodes"],
            {"photodiodes"},
            "channel 20 (module 2, input 4; lower arc, 10 deg)",
        ),
        (keep_shut, ["mono"], {"monochromator"}, "SHUTTER O"),
        (
            lambda rig: rig.plant.set_lamp(0.0, level=1e-9),
            ["mono"],
            {"monochromator"},
            "the shutter stays shut, or there is no light",
        ),
        (exchange_cables, ["mono", "axes"], {"monochromator", "axes"}, "not responding"),
    ],
    ids=["dead channel in the light", "dead channel in the dark", "shutter stays shut", "no light", "exchanged cables"],
)
def test_a_wrong_device_is_named(
    write_rig: Writer,
    built: Callable[[Wrong], list[VirtualRig]],
    wrong: Wrong,
    devices: list[str],
    subjects: set[str],
    named: str,
) -> None:
    built(wrong)
    found = differing(verified(write_rig(), *devices))
    assert set(found) == subjects
    assert any(named in came for came in found.values()), found


def test_an_encoder_that_counts_the_other_way_is_named(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    read = Encoder.read
    monkeypatch.setattr(Encoder, "read", lambda encoder, t, resolution: -read(encoder, t, resolution))
    wrong = differing(verified(write_rig(), "gamma"))
    assert "the encoder counts the other way" in wrong["gamma"]


def test_an_axis_that_does_not_stop_is_named_and_moved_no_more(write_rig: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    turn = RampGenerator.turn
    monkeypatch.setattr(RampGenerator, "turn", lambda ramp, velocity, t: None if velocity == 0 else turn(ramp, velocity, t))
    found = verified(write_rig(), "sigma")
    assert "does not stop" in differing(found)["sigma"]
    later = [each for each in found.records if each.moves][2:]
    assert later
    assert all("an earlier check of this axis differs" in each.outcome.came for each in later)


def test_a_wrong_gear_and_an_axis_that_turns_the_other_way_are_seen_on_the_scale(
    write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The module counts the encoder in microsteps of its motor, so that counter and encoder agree."""
    rigs = built(lambda _: None)

    def at_the_rig(question: str) -> str:
        axis = question.split(":")[0]
        return f"{rigs[0].plant.angle_deg(axis, rigs[0].clock.now()):.1f}" if "scale" in question else "yes"

    monkeypatch.setattr(device_verification, "_ask", at_the_rig)
    assert not differing(verified(write_rig(), "axes", yes=False))
    for key, named in (("gear = 20.0", "by the factor 1.111"), ("gear = 18.0, sense = -1", "the axis turns the other way")):
        rigs.clear()
        wrong = differing(verified(write_rig(("motor = 3, gear = 18.0", f"motor = 3, {key}")), "axes", yes=False))
        assert set(wrong) == {"gamma"}
        assert named in wrong["gamma"]


def test_an_unreferenced_axis_is_not_moved(write_rig: Writer) -> None:
    found = verified(write_rig(("power_up_at_reference = true   # only", "# only")), "gamma")
    assert not differing(found)
    assert all("reference it first: goniotwin here" in each.outcome.came for each in found.records if each.moves)


def test_ctrl_c_stops_all_axes_before_it_closes_the_shutter(
    write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]], monkeypatch: pytest.MonkeyPatch
) -> None:
    rigs = built(lambda _: None)
    stopped: dict[str, bool] = {}
    begin_stop = TmclModule.begin_stop

    def shutter_is_open() -> bool:
        return rigs[0].plant.shutter_open.at(rigs[0].clock.now())

    def record(module: TmclModule, targets: Any) -> Any:
        stopped.update({name: shutter_is_open() for name, _ in targets})
        return begin_stop(module, targets)

    def interrupt(_session: CheckSession, _gain: int) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(TmclModule, "begin_stop", record)
    monkeypatch.setattr(CheckSession, "monitor_a", lambda session: interrupt(session, 0) if shutter_is_open() else 0.0)
    with pytest.raises(KeyboardInterrupt):
        verified(write_rig(), "mono")
    assert stopped == dict.fromkeys(("gamma", "sigma", "beta", "shift"), True)
    assert not shutter_is_open()


def test_a_move_on_which_the_arc_would_meet_the_beam_is_refused(
    write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]]
) -> None:
    """With the arc shifted by 5 deg its top is at 90 deg, and the beam comes from beta = 270 deg (258 + 20 deg)."""
    rigs = built(lambda _: None)
    away = (
        ("upper_deg = 5.5", "upper_deg = 5.5\nzero_offset_deg = 5.0"),
        ("lower_deg = -5.0", "lower_deg = -5.0\nzero_offset_deg = 258.0"),
    )
    found = verified(write_rig(*away), "beta", "photodiodes")
    assert not differing(found)
    refused = {each.check for each in found.records if "would collide" in each.outcome.came}
    assert refused == {"a stop in the middle of a move"}
    assert abs(rigs[0].plant.angle_deg("beta", rigs[0].clock.now())) < 0.01  # of the twin, whose zero is elsewhere


def test_an_axis_that_could_not_come_back_is_not_moved(write_rig: Writer, built: Callable[[Wrong], list[VirtualRig]]) -> None:
    """Gamma stands at its lower limit, and against a backlash it would arrive there from below the limit."""
    rigs = built(lambda _: None)
    backlash: tuple[Change, ...] = (
        ("[axes.gamma] ", "[axes.gamma]\nbacklash_deg = 0.1 "),
        ("motor = 3, gear = 18.0 }", "motor = 3, gear = 18.0, backlash_deg = 0.1 }"),
    )
    found = verified(write_rig(*backlash), "gamma")
    assert not differing(found)
    moving = [each.outcome for each in found.records if each.moves]
    assert {each.verdict for each in moving} == {CheckVerdict.NOT_CHECKED}
    assert "approaches from below" in moving[0].came
    assert abs(rigs[0].plant.angle_deg("gamma", rigs[0].clock.now())) <= 0.1
    assert not differing(
        verified(write_rig(*backlash, ("lower_deg = 0.0\nupper_deg = 360", "lower_deg = -5.0\nupper_deg = 360")), "gamma")
    )


def test_an_unknown_device_is_refused(write_rig: Writer) -> None:
    for name in ("lamp", "mo", ""):
        refused = invoke("verify-device", "--rig", write_rig(), name)
        assert refused.returncode == 2
        assert "give axes, monochromator, photodiodes, monitor, gamma" in refused.stderr
