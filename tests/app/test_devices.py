"""Who answers: the status that a program reads."""

from pathlib import Path

import pytest

from goniotwin.app.cli.device_search import PortStatus, exit_status, find_devices
from tests.conftest import RIG, Writer


def test_all_devices_of_a_rig_that_answer_are_status_0() -> None:
    assert exit_status(find_devices(RIG)) == 0


def test_a_device_of_a_rig_that_does_not_answer_is_status_1(write_rig: Writer, tmp_path: Path) -> None:
    found = find_devices(write_rig(("twin://virtual/mono", str(tmp_path / "nobody"))))
    assert [each.address for each in found if each.tried] == ["monochromator"]
    assert exit_status(found) == 1


@pytest.mark.parametrize("found", [[], [PortStatus("serial", "COM1", None, "TMCL at 9600 Bd: silent")]])
def test_a_port_of_this_computer_on_which_nobody_answers_is_no_fault(found: list[PortStatus]) -> None:
    assert exit_status(found) == 0
