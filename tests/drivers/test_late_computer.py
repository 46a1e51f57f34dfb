"""A computer that is late, at whichever look at the clock: a reply that came in time is accepted, and nothing is repeated."""

import os
import sys
from collections.abc import Callable
from dataclasses import dataclass

import pytest
from pymodbus.client import ModbusSerialClient

from goniotwin.drivers import DeviceError, Rig, TmclController, wait
from goniotwin.drivers.photodiodes.modbus import RtuClient
from goniotwin.mocks.faults import Fault, FaultPlan
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols.clock import VirtualClock
from tests.conftest import Change, RigOpener
from tests.drivers.photodiode_bench import QUIET, SERIAL

LATE_S = 10.0


class LeapingClock(VirtualClock):
    """A clock that leaps by LATE_S at the `leap_at`-th look at it."""

    looks, leap_at = 0, 0

    def now(self) -> float:
        self.looks += 1
        if self.looks == self.leap_at:
            self._now += LATE_S
        return super().now()


@dataclass(frozen=True)
class Question:
    """`ask` makes one exchange, or a few; `repetitions` counts what the driver did because of a fault."""

    ask: Callable[[Rig], object]
    repetitions: Callable[[Rig], int]
    changes: tuple[Change, ...] = (QUIET,)


def resynchronisations(rig: Rig) -> int:
    (controller,) = rig.controllers
    assert isinstance(controller, TmclController)
    return len(controller.module.events)


def unverified(rig: Rig) -> int:
    return sum(module.registers.unverified for module in rig.photodiodes.modules)


QUESTIONS = {
    "axes (TMCL)": Question(lambda rig: rig.axes["sigma"].position_deg(), resynchronisations),
    "monochromator (ASCII)": Question(lambda rig: rig.monochromator.filter(), lambda rig: len(rig.monochromator.events)),
    "photodiodes (Modbus TCP)": Question(lambda rig: rig.photodiodes.modules[0].counts(), unverified),
    "photodiodes (Modbus RTU)": Question(lambda rig: rig.photodiodes.modules[0].counts(), unverified, (QUIET, *SERIAL)),
    "monitor (USBTMC)": Question(lambda rig: rig.monitor.check(), lambda rig: len(rig.monitor.events)),
}


@pytest.mark.parametrize("wire", QUESTIONS)
def test_a_reply_that_came_while_the_computer_was_late_is_accepted(opened: RigOpener, wire: str) -> None:
    question = QUESTIONS[wire]
    clock = LeapingClock(1.0)
    rig = opened(*question.changes, clock=clock).rig
    wait(clock, [rig.monitor.start_mean(0.1)])
    expected, first = question.ask(rig), clock.looks
    assert question.ask(rig) == expected
    looks = clock.looks - first
    assert looks > 0
    for look in range(1, looks + 1):
        clock.leap_at = clock.looks + look
        assert question.ask(rig) == expected
        clock.leap_at = 0  # a leap may make a later look needless
        assert question.repetitions(rig) == 0, f"at look {look} of {looks}"


@pytest.mark.skipif(sys.platform == "win32", reason="it has no pseudo-terminals")
@pytest.mark.parametrize(("client", "found"), [(RtuClient, b"reply"), (ModbusSerialClient, b"")])
def test_a_serial_client_of_modbus_takes_what_is_there_though_the_calendar_leaps(
    client: type[ModbusSerialClient], found: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """pymodbus's own does not, which is why there is another one."""
    device, port = os.openpty()
    opened = client(os.ttyname(port), baudrate=9600, timeout=0.5)
    try:
        assert opened.connect()
        times = iter(range(0, 10_000, 10))
        monkeypatch.setattr("pymodbus.client.serial.time.time", lambda: float(next(times)))
        os.write(device, b"reply")
        assert opened.recv(None) == found
    finally:
        opened.close()
        os.close(device)
        os.close(port)


class LateClock(VirtualClock):
    """A clock with which every wait lasts longer, by `late_s`."""

    late_s = 0.0

    def sleep_until(self, t: float) -> None:
        super().sleep_until(t + self.late_s)


@pytest.mark.parametrize("wire", QUESTIONS)
@pytest.mark.parametrize("late_s", [0.0, 2.0])
def test_a_message_blames_a_computer_that_was_late_and_not_the_cable(opened: RigOpener, wire: str, late_s: float) -> None:
    clock = LateClock(1.0)
    opened_rig = opened(*QUESTIONS[wire].changes, clock=clock)
    rig, virtual = opened_rig.rig, opened_rig.virtual
    assert virtual is not None
    rig.close()
    silent = FaultPlan(1, (Fault.UNHEARD,), share=1.0)
    virtual.serial |= {name: FaultyLine(device, silent) for name, device in virtual.serial.items()}
    virtual.modbus_wires = dict.fromkeys(virtual.modbus, lambda station: FaultyLine(station, silent))
    virtual.usb["monitor"] = FaultyUsb(virtual.usb["monitor"], silent, clock)
    clock.late_s = late_s
    with pytest.raises(DeviceError) as error:
        rig.device(wire.partition(" ")[0]).connect()
    assert (error.value.remedy == "close other programs and try again") == bool(late_s)
    assert ("this computer was busy" in str(error.value)) == bool(late_s)
    assert not (late_s and "cable" in str(error.value))
