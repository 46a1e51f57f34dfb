"""`goniotwin verify-device` with a motion controller of another make."""

from collections.abc import Callable
from pathlib import Path

from goniotwin.app.cli.work.device_verification import verify_devices
from goniotwin.drivers.checks import CheckVerdict


def test_its_axes_are_moved_and_stopped_like_others(mixed_rig: Callable[..., Path]) -> None:
    found = verify_devices(mixed_rig(), ["shift"], yes=True, report=None, transcript=None, quiet=True)
    verdicts = {each.check: each.outcome for each in found.records}
    assert [each for each in found.records if each.outcome.verdict is CheckVerdict.DIFFERS] == []
    for check in ("identity", "a small move there and back: time, counter, encoder", "a stop in the middle of a move"):
        assert verdicts[check].verdict is CheckVerdict.OK, verdicts[check]
    assert {each.device for each in found.records} == {"axes-shift"}
