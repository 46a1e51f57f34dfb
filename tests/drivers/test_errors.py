"""Errors of devices for people: a headline in plain words, with the device and what to do, and behind it the wire's words."""

import ast
from pathlib import Path

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, Refused, errors
from goniotwin.drivers.errors import LimitError, Overrange, Taken, WrongDevice
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.monochromator.line import CornerstoneLine
from goniotwin.drivers.motion.tmcl.rules import check_reply
from goniotwin.drivers.tap import no_tap
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.cornerstone import ErrorCode, Statement
from goniotwin.protocols.tmcl import HOST_ADDRESS, Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import GlobalParameter
from tests.conftest import REPOSITORY, RigOpener

WITHOUT_REMEDY = {"Interrupted"}
"""A person has stopped the axes: there is nothing to do."""


@pytest.mark.parametrize(
    ("error", "headline", "detail"),
    [
        (
            NoAnswer("axes", "GGP 254 motor 2 = 0", "0 of 9 bytes within 0.072 s", "check cable and power"),
            "Axes (TMCM-6214) are not responding: check cable and power",
            "GGP 254 motor 2 = 0: 0 of 9 bytes within 0.072 s",
        ),
        (
            NoAnswer("monitor", "READ?", "not responding within 2 s", "check cable and power"),
            "Monitor (PM100D) is not responding: check cable and power",
            "READ?: not responding within 2 s",
        ),
        (
            BadAnswer("sigma", "GAP 1 motor 0", "a checksum of 3", "check cable and grounding"),
            "Axis sigma (TMCM-6214) has sent a wrong or damaged reply: check cable and grounding",
            "GAP 1 motor 0: a checksum of 3",
        ),
        (
            Refused("photodiodes module 2", "write the range", "exception 3", "check the kind"),
            "Photodiodes module 2 (ADAM-6017) has refused a command: check the kind",
            "write the range: exception 3",
        ),
        (
            Forgotten("photodiodes", "read", "ranges", "reconnect it"),
            "Photodiodes (ADAM-6017) have lost their settings: reconnect it",
            "read: ranges",
        ),
        (Taken("axes", "GGP 254", "5", "end it"), "Axes (TMCM-6214) are in use by another program: end it", "GGP 254: 5"),
        (Overrange("monitor", "READ?", "9.9e37", "widen it"), "Monitor (PM100D) is overrange: widen it", "READ?: 9.9e37"),
        (
            WrongDevice("monochromator", "identify it", "A is connected, not B", "connect B"),
            "monochromator: identify it: A is connected, not B; connect B",
            "",
        ),
        (LimitError("sigma", "move to 99 deg", "outside 0 to 90", "x"), "sigma: move to 99 deg: outside 0 to 90; x", ""),
        (NoAnswer("pump", "PING", "silence"), "Pump is not responding", "PING: silence"),
    ],
)
def test_a_fault_has_a_headline_and_the_words_of_the_wire_behind_it(
    opened: RigOpener, error: DeviceError, headline: str, detail: str
) -> None:
    words = opened().rig.in_words(error)
    assert (words.headline, words.detail) == (headline, detail)
    assert str(words) == (f"{headline} ({detail})" if detail else headline)


def test_the_model_of_axes_and_monochromator_is_known_once_they_have_been_identified(opened: RigOpener) -> None:
    rig = opened().rig
    assert rig.plain_name("monochromator") == "Monochromator (Cornerstone 260)"
    rig.close()
    assert rig.plain_name("axes") == "Axes (TMCM-6214)"


def test_a_module_whose_settings_are_locked_refuses_them_with_the_way_to_unlock_it(opened: RigOpener) -> None:
    """Global parameter 73. The heartbeat is one of those that it locks."""
    rig = opened().rig
    (controller,) = rig.controllers
    module = controller.module  # type: ignore[attr-defined]
    module.exchange(CommandFrame(1, Command.SGP, GlobalParameter.EEPROM_LOCK, 0, 1234))
    controller.set_heartbeat(5.0)
    with pytest.raises(Refused) as refused:
        controller.connect()
    words = rig.in_words(refused.value)
    assert words.headline.startswith("Axes (TMCM-6214) have refused a command: unlock ")
    assert "73 to 4321" in words.headline
    assert "EEPROM_LOCKED" in words.detail


@pytest.mark.parametrize("status", [each for each in ReplyStatus if each < 10 and each is not ReplyStatus.WRONG_CHECKSUM])
def test_each_status_with_which_a_tmcl_module_refuses_has_a_remedy(status: ReplyStatus) -> None:
    request = CommandFrame(1, Command.SAP, 4, 0, 9)
    reply = ReplyFrame(HOST_ADDRESS, 1, status, Command.SAP, 0)
    with pytest.raises(Refused) as refused:
        check_reply(request, reply.encode(), "axes", str)
    assert refused.value.remedy


@pytest.mark.parametrize("code", ErrorCode)
def test_each_error_of_a_monochromator_has_a_remedy(opened: RigOpener, code: ErrorCode) -> None:
    line = CornerstoneLine(opened().wires().serial("twin://virtual/mono"), 9600, VirtualClock(), no_tap, FoundSettings())
    assert line.refused(Statement("GOWAVE", parameter="500"), f"error {int(code)}, {code.in_words()}").remedy


def test_every_error_of_a_driver_has_a_remedy() -> None:
    """Where the drivers' sources make one."""
    kinds = {name for name, each in vars(errors).items() if isinstance(each, type) and issubclass(each, DeviceError)}
    made = [
        (path, call)
        for path in sorted(Path(REPOSITORY / "drivers").rglob("*.py"))
        for call in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(call, ast.Call)
        and isinstance(call.func, ast.Name)
        and call.func.id in kinds - WITHOUT_REMEDY
        and "collision" not in map(ast.unparse, call.args)  # whose text ends with what to do
    ]
    assert len(made) > 60
    starred = [any(isinstance(each, ast.Starred) for each in call.args) for _, call in made]
    lacking = [
        f"{path.name}:{call.lineno}" for (path, call), star in zip(made, starred, strict=True) if len(call.args) < 4 - 2 * star
    ]
    assert lacking == []
