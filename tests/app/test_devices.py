"""The search for devices: its exit status."""

from pathlib import Path

import pytest

from goniotwin.app.cli.device_search import PortStatus, exit_status, find_devices
from tests.conftest import RIG, Writer


def test_the_status_is_0_if_all_devices_of_a_rig_respond() -> None:
    assert exit_status(find_devices(RIG)) == 0


def test_the_status_is_1_if_a_device_of_a_rig_does_not_respond(write_rig: Writer, tmp_path: Path) -> None:
    found = find_devices(write_rig(("twin://virtual/mono", str(tmp_path / "no-device"))))
    assert [each.address for each in found if each.tried] == ["monochromator"]
    assert exit_status(found) == 1


@pytest.mark.parametrize("found", [[], [PortStatus("serial", "COM1", None, "TMCL at 9600 Bd: silent")]])
def test_the_status_is_0_for_a_port_of_this_computer_without_a_device(found: list[PortStatus]) -> None:
    assert exit_status(found) == 0
