"""Test benches: each driver of a virtual rig on a wire with faults, and a task with a known result."""

from abc import ABC, abstractmethod
from functools import cache
from pathlib import Path
from typing import ClassVar

import numpy as np

from goniotwin.app.rig import OpenRig, RigDescription, open_rig, parse_rig
from goniotwin.arrays import Ints
from goniotwin.drivers import wait
from goniotwin.mocks.faults import (
    ON_A_SERIAL_LINE,
    ON_A_TEXT_LINE,
    ON_MODBUS,
    ON_MODBUS_RTU,
    ON_USB,
    Fault,
    FaultPlan,
    ScriptedFaults,
)
from goniotwin.mocks.faulty_line import (
    FaultyEnd,
    FaultyLine,
    exception_rtu,
    exception_tcp,
    foreign_rtu,
    foreign_tcp,
    foreign_tmcl,
    plug_in,
)
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.devices.line import SerialDevice

RIG = Path(__file__).resolve().parents[2] / "examples" / "rigs" / "virtual.toml"
RANGE = ("gain_uncertainty", "range_code = 0x0142\ngain_uncertainty")
"""Not the power-on range of a module, so that a reset changes it."""
QUIET = (("noise = true", "noise = false"), RANGE)
ON_RTU = (
    ('kind = "adam-6017"', 'kind = "adam-4117"'),
    ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e11]"),
    ("[twin.light]", '[twin.electronics]\nmodule = "adam-4117"\ngains_v_per_a = [1e11]\n\n[twin.light]'),
)


class WrongValueError(Exception):
    """A driver returned a wrong value."""


class FaultBench(ABC):
    """One driver of a virtual rig, and its wire. `undetectable` are faults that cannot be detected on this wire."""

    name: ClassVar[str]
    devices: ClassVar[tuple[str, ...]]
    faults: ClassVar[tuple[Fault, ...]]
    undetectable: ClassVar[tuple[Fault, ...]] = ()
    changes: ClassVar[tuple[tuple[str, str], ...]] = ()

    def __init__(self) -> None:
        self.opened: OpenRig = open_rig(_description(QUIET + self.changes), VirtualClock(1.0))
        assert self.opened.virtual is not None
        self.rig, self.virtual = self.opened.rig, self.opened.virtual
        self.clock = self.virtual.clock
        self.insert_faulty_wire()
        self.run_task()

    @abstractmethod
    def insert_faulty_wire(self) -> None:
        """Insert the faulty wire between driver and device, and connect again."""

    @abstractmethod
    def set_faults(self, misfortune: FaultPlan) -> None:
        """Set the faults of the wire from now on."""

    @abstractmethod
    def run_task(self) -> None:
        """Carry out the task. Raises DeviceError, WrongValueError."""

    def recover(self) -> None:
        """Recover from an error as the engine or the operator does; by default nothing is needed. Raises DeviceError."""
        return

    def reset_noticed(self) -> bool:
        """True if the driver has detected a reset of its device without raising Forgotten."""
        return False


class AxesFaultBench(FaultBench):
    """TMCL over USB or RS485: a move of one axis, its counter, its encoder."""

    name, devices = "axes (TMCL)", ("axes", "sigma")
    faults = ON_A_SERIAL_LINE

    def insert_faulty_wire(self) -> None:
        self._target = 10.0
        self._line = FaultyLine(self.virtual.serial["axes"], ScriptedFaults(()), 0.1, foreign_tmcl)
        plug_in(self._line, self.clock, lambda end: self.virtual.serial.update(axes=end))
        self.rig.reconnect("axes")

    def set_faults(self, misfortune: FaultPlan) -> None:
        self._line.misfortune = misfortune

    def run_task(self) -> None:
        self._target = 30.0 - self._target
        axis = self.rig.axes["sigma"]
        wait(self.clock, [axis.start(self._target)])
        truth = self._truth("sigma")
        _compare([truth, axis.position_deg(), axis.encoder_deg() or 0.0], self._target, 2e-3)

    def recover(self) -> None:
        self.rig.reconnect("axes")
        for name, axis in self.rig.axes.items():
            axis.set_position(self._truth(name))

    def reset_noticed(self) -> bool:
        return any("reset" in axis.unreferenced_reason for axis in self.rig.axes.values())

    def _truth(self, name: str) -> float:
        return self.virtual.plant.angle_deg(name, self.clock.now())


class MonochromatorFaultBench(FaultBench):
    """Cornerstone: a slew, the shutter, and the wavelength read back."""

    name, devices = "monochromator (ASCII)", ("monochromator",)
    faults = ON_A_TEXT_LINE

    def insert_faulty_wire(self) -> None:
        self._target = 600.0
        self._line = FaultyLine(self.virtual.serial["mono"], ScriptedFaults(()), 1.5)
        plug_in(self._line, self.clock, lambda end: self.virtual.serial.update(mono=end))
        self.rig.monochromator.connect()

    def set_faults(self, misfortune: FaultPlan) -> None:
        self._line.misfortune = misfortune

    def run_task(self) -> None:
        self._target = 1233.1 - self._target
        driver, plant = self.rig.monochromator, self.virtual.plant
        wait(self.clock, [driver.start_wavelength(self._target)])
        _compare([plant.wavelength_nm.at(self.clock.now()), driver.wavelength_nm()], self._target, 0.011)
        opened = self._target > 620.0
        wait(self.clock, [driver.start_shutter(opened=opened)])
        _compare([plant.shutter_open.at(self.clock.now())], opened, 0)


class TcpPhotodiodesFaultBench(FaultBench):
    """ADAM-6017: a gain, two readings of all channels, the canary."""

    name, devices = "photodiodes (Modbus TCP)", ("photodiodes",)
    faults = (*ON_MODBUS, Fault.GARBLED)
    undetectable: ClassVar[tuple[Fault, ...]] = (Fault.CORRUPTED, Fault.GARBLED, Fault.NOISE)

    def insert_faulty_wire(self) -> None:
        self.rig.photodiodes.close()
        self._gain = 0
        self._expected: dict[int, Ints] = {}
        self._misfortune: FaultPlan = ScriptedFaults(())
        self._lines: list[FaultyLine] = []
        self._connect()
        self.rig.photodiodes.connect()
        for _ in self.rig.photodiodes.settings.gains_v_per_a[:2]:
            self.run_task()

    def _connect(self) -> None:
        def connection(station: SerialDevice) -> SerialDevice:
            self._lines.append(FaultyLine(station, self._misfortune, 1.05, foreign_tcp, exception_tcp))
            return FaultyEnd(self._lines[-1])

        self.virtual.modbus_wires = dict.fromkeys(self.virtual.modbus, connection)

    def set_faults(self, misfortune: FaultPlan) -> None:
        self._misfortune = misfortune
        for line in self._lines:
            line.misfortune = misfortune

    def run_task(self) -> None:
        array = self.rig.photodiodes
        self._gain = (self._gain + 1) % min(2, len(array.settings.gains_v_per_a))
        wait(self.clock, [array.start_gain(self._gain)])
        taken = array.start_readings(2)
        wait(self.clock, [taken])
        expected = self._expected.setdefault(self._gain, taken.counts[1].astype(int))
        _compare(taken.counts.astype(int), expected, 1)

    def recover(self) -> None:
        self.rig.photodiodes.reconnect()


class RtuPhotodiodesFaultBench(TcpPhotodiodesFaultBench):
    """ADAM-4117 on one serial line."""

    name = "photodiodes (Modbus RTU)"
    faults = ON_MODBUS_RTU
    undetectable = ()
    changes = ON_RTU

    def _connect(self) -> None:
        self._lines = [FaultyLine(self.virtual.serial["adcs"], self._misfortune, 1.05, foreign_rtu, exception_rtu)]
        plug_in(self._lines[0], self.clock, lambda end: self.virtual.serial.update(adcs=end))


class MonitorFaultBench(FaultBench):
    """USBTMC: a mean."""

    name, devices = "monitor (USBTMC)", ("monitor",)
    faults = ON_USB

    def insert_faulty_wire(self) -> None:
        self.virtual.plant.shutter_open.set(0.0, True)
        self.rig.monitor.close()
        self._wire = FaultyUsb(self.virtual.usb["monitor"], ScriptedFaults(()), self.clock)
        self.virtual.usb["monitor"] = self._wire
        self.rig.monitor.connect()
        self._expected: float | None = None

    def set_faults(self, misfortune: FaultPlan) -> None:
        self._wire.misfortune = misfortune

    def run_task(self) -> None:
        mean = self.rig.monitor.start_mean(0.1)
        wait(self.clock, [mean])
        self._expected = self._expected or mean.current_a
        _compare([mean.current_a], self._expected, 2e-3 * self._expected)  # the lamp drifts by 2 % an hour


BENCHES: tuple[type[FaultBench], ...] = (
    AxesFaultBench,
    MonochromatorFaultBench,
    TcpPhotodiodesFaultBench,
    RtuPhotodiodesFaultBench,
    MonitorFaultBench,
)


@cache
def _description(changes: tuple[tuple[str, str], ...]) -> RigDescription:
    text = RIG.read_text(encoding="utf-8")
    for old, new in changes:
        if old not in text:
            raise LookupError(f"{old!r} is not in {RIG} any more")
        text = text.replace(old, new)
    return parse_rig(text, RIG.parent, str(RIG))


def _compare(values: object, truth: object, tolerance: float) -> None:
    if not np.allclose(np.asarray(values, float), np.asarray(truth, float), rtol=0.0, atol=tolerance):
        raise WrongValueError(f"{values} instead of {truth}")
