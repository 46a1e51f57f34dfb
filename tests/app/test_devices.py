"""The search for devices: its exit status."""

from pathlib import Path

import pytest

from goniotwin.app.cli.work import device_search
from goniotwin.app.cli.work.device_search import PortStatus, exit_status, find_devices
from goniotwin.drivers.device import PortOpener
from tests.conftest import RIG, RigOpener, Writer


def test_the_status_is_0_if_all_devices_of_a_rig_respond() -> None:
    assert exit_status(find_devices(RIG)) == 0


def test_the_status_is_1_if_a_device_of_a_rig_does_not_respond(write_rig: Writer, tmp_path: Path) -> None:
    found = find_devices(write_rig(("twin://virtual/mono", str(tmp_path / "no-device"))))
    assert [each.address for each in found if each.tried] == ["monochromator"]
    assert exit_status(found) == 1


@pytest.mark.parametrize("found", [[], [PortStatus("serial", "COM1", None, "TMCL at 9600 Bd: silent")]])
def test_the_status_is_0_for_a_port_of_this_computer_without_a_device(found: list[PortStatus]) -> None:
    assert exit_status(found) == 0


def test_a_monochromator_on_a_port_of_this_computer_gets_info_alone(opened: RigOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    """Anything else is error 1 to it, which its next user finds (MCS260 p. 58). Motion controllers are found after it."""
    rig = opened()
    assert rig.virtual is not None
    rig.rig.close()
    unit, received = rig.virtual.serial["mono"], b""
    receive = unit.receive

    def hear(data: bytes, t: float) -> None:
        nonlocal received
        received += data
        receive(data, t)

    unit.receive = hear  # type: ignore[method-assign]
    ports: dict[str, PortOpener] = {
        "mono": rig.wires().serial("twin://virtual/mono"),
        "axes": rig.wires().serial("twin://virtual/axes"),
    }
    monkeypatch.setattr(device_search, "open_serial", lambda port, baudrate, timeout: ports[port](baudrate, timeout))
    assert device_search.probe_port("mono", rig.rig.clock).identity == "Cornerstone 260 virtual"
    assert received == b"INFO?\n"
    assert device_search.probe_port("axes", rig.rig.clock).identity == "TMCM-6214"
