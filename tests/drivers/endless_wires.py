"""Wires on which a device never stops sending, and what must hold of their drivers."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain

from goniotwin.app.rig import OpenRig
from goniotwin.drivers import DeviceError, Rig, wait
from goniotwin.mocks.faulty_line import foreign_tmcl
from goniotwin.protocols import usbip
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.tmcl import Command, ReplyFrame
from goniotwin.twin.devices.modbus import TcpStation
from tests.conftest import Change, RigOpener
from tests.drivers.bounded_calls import BoundedCalls
from tests.drivers.endless_sender import EndlessSender, EndlessUsb, Stream
from tests.drivers.photodiode_bench import SERIAL

MOST_S = 5.0
STOP_S = 0.2
Sender = EndlessSender | EndlessUsb
Calls = Iterator[Callable[[], object]]
"""Calls of a driver, one after the other; one that returns an action is followed by its polls."""
REPLY = ReplyFrame(2, 1, 100, Command.GAP, 0).encode()


@dataclass(frozen=True)
class Wire:
    """A wire of the virtual rig: `insert` puts the endless sender into it, `calls` use its driver."""

    insert: Callable[[OpenRig], list[Sender]]
    calls: Callable[[Rig], Calls]
    device: str
    changes: tuple[Change, ...] = ()


def on_a_line(name: str, stream: Stream) -> Callable[[OpenRig], list[Sender]]:
    def insert(opened: OpenRig) -> list[Sender]:
        assert opened.virtual is not None
        sender = EndlessSender(opened.virtual.serial[name], stream)
        opened.virtual.serial[name] = sender
        return [sender]

    return insert


def on_tcp(stream: Stream) -> Callable[[OpenRig], list[Sender]]:
    """One module of several, on each of its connections."""

    def insert(opened: OpenRig) -> list[Sender]:
        assert opened.virtual is not None
        sender = EndlessSender(TcpStation(opened.virtual.modbus["adc-1"]), stream)
        opened.virtual.modbus_wires["adc-1"] = lambda _: sender
        return [sender]

    return insert


def on_usb(period_s: float, *, wrong_tag: bool = False) -> Callable[[OpenRig], list[Sender]]:
    def insert(opened: OpenRig) -> list[Sender]:
        assert opened.virtual is not None
        sender = EndlessUsb(opened.virtual.usb["monitor"], opened.virtual.clock, period_s, wrong_tag=wrong_tag)
        opened.virtual.usb["monitor"] = sender
        return [sender]

    return insert


def axes(rig: Rig) -> Calls:
    axis = rig.axes["sigma"]
    target = 20.0 if axis.position_deg() < 10.0 else 0.0
    yield axis.position_deg
    yield lambda: axis.start(target)
    yield axis.encoder_deg
    yield rig.stop
    yield rig.controllers[0].reconnect


def monochromator(rig: Rig) -> Calls:
    driver = rig.monochromator
    target = 700.0 if driver.wavelength_nm() < 650.0 else 600.0
    yield driver.wavelength_nm
    yield lambda: driver.start_wavelength(target)
    yield lambda: driver.start_shutter(opened=target > 650.0)
    yield driver.stop
    yield driver.reconnect


def photodiodes(rig: Rig) -> Calls:
    array = rig.photodiodes
    yield lambda: array.start_gain(0)
    yield lambda: array.start_readings(2)
    yield array.reconnect
    yield array.connect


def monitor(rig: Rig) -> Calls:
    driver = rig.monitor
    yield lambda: driver.start_mean(0.1)
    yield driver.status_byte
    yield driver.start_zero
    yield driver.reconnect


WIRES = {
    "axes: nulls": Wire(on_a_line("axes", Stream(b"\0")), axes, "axes"),
    "axes: replies": Wire(on_a_line("axes", Stream(REPLY)), axes, "axes"),
    "axes: replies of another module": Wire(on_a_line("axes", Stream(foreign_tmcl(REPLY))), axes, "axes"),
    "axes: drops": Wire(on_a_line("axes", Stream(b"\x02", 0.009)), axes, "axes"),
    "monochromator: no line ends": Wire(on_a_line("mono", Stream(b"x")), monochromator, "monochromator"),
    "monochromator: states": Wire(on_a_line("mono", Stream(b"00\r\n")), monochromator, "monochromator"),
    "monochromator: numbers": Wire(on_a_line("mono", Stream(b"600.000\r\n", 0.05)), monochromator, "monochromator"),
    "monochromator: drops": Wire(on_a_line("mono", Stream(b"0", 0.09)), monochromator, "monochromator"),
    "Modbus TCP: zeros": Wire(on_tcp(Stream(b"\0", 1e-3)), photodiodes, "photodiodes"),
    "Modbus TCP: noise": Wire(on_tcp(Stream(b"\xff" * 200)), photodiodes, "photodiodes"),
    "Modbus TCP: old replies": Wire(on_tcp(Stream(b"\xee\xee\0\0\0\5\1\3\2\0\0", 1e-3)), photodiodes, "photodiodes"),
    "Modbus TCP: drops": Wire(on_tcp(Stream(b"\0", 0.9)), photodiodes, "photodiodes"),
    "Modbus RTU: noise": Wire(on_a_line("adcs", Stream(b"\xff")), photodiodes, "photodiodes", SERIAL),
    "Modbus RTU: replies of another unit": Wire(
        on_a_line("adcs", Stream(bytes.fromhex("63 03 02 00 00 b1 8e"))), photodiodes, "photodiodes", SERIAL
    ),
    "Modbus RTU: drops": Wire(on_a_line("adcs", Stream(b"\0", 0.09)), photodiodes, "photodiodes", SERIAL),
    "USBTMC: no end": Wire(on_usb(1e-3), monitor, "monitor"),
    "USBTMC: no end, slowly": Wire(on_usb(0.9), monitor, "monitor"),
    "USBTMC: another tag": Wire(on_usb(1e-3, wrong_tag=True), monitor, "monitor"),
}


QUICK = ("axes: replies", "monochromator: states", "Modbus TCP: noise", "Modbus RTU: noise", "USBTMC: no end, slowly")
"""One stream on each wire."""


def check_calls(opened: RigOpener, name: str, begins: tuple[int, ...]) -> None:
    """Every call of the driver ends within MOST_S, at whichever request the device begins to send without end.

    When it has stopped, the driver connects at the second attempt at the latest, and every call succeeds.
    """
    wire = WIRES[name]
    opened_rig = opened(*wire.changes, clock=VirtualClock(1.0))
    rig = opened_rig.rig
    rig.close()
    (sender,) = wire.insert(opened_rig)
    opened_rig.connect()
    failed = 0
    for after in begins:
        calls = BoundedCalls(rig.clock, "", MOST_S)
        for index, call in enumerate(wire.calls(rig)):
            if index == 0:
                sender.begin(after)
            with calls.attempt():
                with calls.call():
                    pending = call()
                if hasattr(pending, "poll"):
                    calls.wait(pending)  # type: ignore[arg-type]
        failed += len(calls.errors)
        sender.end()
        _recover(rig, wire)
    assert failed >= 2  # the calls may be over before a late beginning


def _recover(rig: Rig, wire: Wire) -> None:
    device = rig.device(wire.device)
    rig.clock.sleep_until(rig.clock.now() + 5.0)
    with contextlib.suppress(DeviceError):
        device.reconnect()
    device.reconnect()
    for axis in rig.axes.values():
        axis.set_position()
    for call in wire.calls(rig):
        pending = call()
        if hasattr(pending, "poll"):
            wait(rig.clock, [pending])  # type: ignore[list-item]


def check_stops(opened: RigOpener, name: str) -> None:
    """Whatever the axes' line brings, the stop frames of all axes are on it within STOP_S, also while a driver's call waits."""
    opened_rig = opened(clock=VirtualClock(1.0))
    rig, clock = opened_rig.rig, opened_rig.rig.clock
    rig.close()
    (sender,) = WIRES[name].insert(opened_rig)
    assert isinstance(sender, EndlessSender)
    opened_rig.connect()
    sender.begin(0)
    for delay_s in (0.0, 0.03, 0.1, 0.6):
        for call in (rig.axes["sigma"].position_deg, rig.controllers[0].reconnect):
            started = clock.now()
            clock.at(started + delay_s, rig.stop)
            with contextlib.suppress(DeviceError):
                call()
            clock.sleep_until(started + delay_s + 1.0)
            frames = [t for t, data in sender.received if t >= started + delay_s and data[1] == Command.MST]
            assert len(frames) >= len(rig.axes)
            assert frames[len(rig.axes) - 1] - started - delay_s < STOP_S


class FloodedPort:
    """A serial port at which there is always more to read: its sender is faster than the reader, for a read takes READ_S."""

    READ_S = 4e-3
    in_waiting = 4096

    def __init__(self, clock: VirtualClock, piece: bytes) -> None:
        self._clock = clock
        self._piece = piece
        self.timeout = self.write_timeout = 0.0
        self.written: list[tuple[float, bytes]] = []

    def read(self, size: int) -> bytes:
        self._clock.sleep_until(self._clock.now() + self.READ_S)
        return (self._piece * size)[:size]

    def write(self, data: bytes) -> None:
        self.written.append((self._clock.now(), data))

    def close(self) -> None:
        pass


def check_flood(clock: VirtualClock, *calls: Callable[[], object]) -> None:
    """Each call fails, and in time."""
    bounded = BoundedCalls(clock, "", MOST_S)
    for call in calls:
        with bounded.attempt(), bounded.call():
            call()
    assert len(bounded.errors) == len(calls)


class EndlessServer:
    """The connection to a USB/IP server that exports a device, and then sends `stream` without end, a piece for each read.

    It is the clock too: each read takes READ_S.
    """

    READ_S = 0.01

    def __init__(self, stream: Iterator[bytes]) -> None:
        device = usbip.ExportedDevice("/x", "1-1", 1, 1, usbip.FULL_SPEED, 0x1313, 0x8078, 0x0100, (0, 0, 0), 1, 1, 0)
        self._stream = chain([usbip.Imported(device).encode()], stream)
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def settimeout(self, _: float | None) -> None:
        pass

    def sendall(self, _: bytes) -> None:
        pass

    def recv(self, _: int) -> bytes:
        self._now += self.READ_S
        return next(self._stream)

    def close(self) -> None:
        pass
