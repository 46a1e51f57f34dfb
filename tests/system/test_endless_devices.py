"""A device that never stops sending holds no call, stop or transfer for longer than is stated."""

from collections.abc import Iterator
from itertools import chain, repeat
from typing import Any

import pytest
import usb.core

from goniotwin.app.rig import AXES
from goniotwin.drivers import Monochromator, MonochromatorSettings
from goniotwin.drivers.motion.stop import stop_all
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.usb.usbip import UsbIpLink
from goniotwin.protocols import usbip
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from tests.conftest import RigOpener
from tests.drivers.endless_wires import QUICK, WIRES, EndlessServer, FloodedPort, check_calls, check_flood, check_stops


@pytest.mark.parametrize("name", QUICK)
def test_every_call_of_a_driver_ends_within_five_seconds_though_its_device_never_stops_sending(
    opened: RigOpener, name: str
) -> None:
    check_calls(opened, name, (0, 5))


@pytest.mark.long
@pytest.mark.parametrize("name", WIRES)
def test_every_call_ends_at_whichever_request_the_device_begins_to_send_without_end(opened: RigOpener, name: str) -> None:
    check_calls(opened, name, (*range(20), 34, 55, 89))


@pytest.mark.parametrize(
    "name",
    [each if each in QUICK else pytest.param(each, marks=pytest.mark.long) for each in WIRES if each.startswith("axes")],
)
def test_a_stop_is_on_the_wire_in_time_though_the_module_never_stops_sending(opened: RigOpener, name: str) -> None:
    check_stops(opened, name)


@pytest.mark.parametrize("piece", [b"x", b"00\r\n"])
def test_a_flooded_monochromator_holds_no_call_for_longer_than_five_seconds(piece: bytes) -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, piece)
    driver = Monochromator(lambda *_: port, MonochromatorSettings(), clock)
    check_flood(clock, driver.connect, driver.wavelength_nm, lambda: driver.start_wavelength(600.0), driver.shutter_is_open)


def test_stop_frames_are_on_a_flooded_line_within_200_ms() -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, b"\2\1")
    module = TmclModule(lambda *_: port, clock)
    check_flood(clock, module.connect, module.identify)
    started = clock.now()
    stops = {"axes": module.begin_stop([(name, CommandFrame(1, Command.MST, 0, k)) for k, name in enumerate(AXES)])}
    assert [each.device for each in stop_all(stops)] == list(AXES)
    frames = [t - started for t, data in port.written if t >= started and data[1] == Command.MST]
    assert frames[len(AXES) - 1] < 0.2
    assert clock.now() - started < 5.0


@pytest.mark.parametrize(
    "stream",
    [repeat(usbip.Submitted(999, 0, 0).encode()), chain([usbip.Submitted(1, 0, 1 << 20).encode()], repeat(b"x"))],
    ids=["results of other transfers", "a byte at a time"],
)
def test_a_transfer_over_usbip_ends_though_the_server_never_stops_sending(stream: Iterator[bytes]) -> None:
    server: Any = EndlessServer(stream)
    link = UsbIpLink("host", 3240, "1-1", server, server)
    with pytest.raises(usb.core.USBError):
        link.read(1, 1 << 20, 1000)
    assert 1.0 < server.now() < 5.0
