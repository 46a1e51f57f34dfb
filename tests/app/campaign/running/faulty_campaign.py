"""A small campaign on a virtual rig whose wires can fail at any exchange."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import SKIPPED, CommittedRow
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.rig import OpenRig, RigDescription, parse_rig
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
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.line import SerialDevice
from tests.app.campaign.campaign_bench import QUIET, RunResult, change_rows, run_plan
from tests.conftest import RIG, SMALL, Change, changed

RTU: tuple[Change, ...] = (
    ('kind = "adam-6017"', 'kind = "adam-4117"'),
    ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e11]"),
    ("[twin.light]", '[twin.electronics]\nmodule = "adam-4117"\ngains_v_per_a = [1e11]\n\n[twin.light]'),
)
NON_DEFAULT_RANGE = ("gain_uncertainty", "range_code = 0x0142\ngain_uncertainty")
HOMING = "[axes.{axis}.homing]\nmode = 8\nspeed_deg_s = {speed}\nswitch_speed_deg_s = 0.5\nangle_deg = {angle}\n\n"
POLICIES = """
[faults]
wire = "reconnect"
reset = "reconnect"
refused = "reconnect"
axis = "reconnect"
attempts = 6
"""
UNDETECTABLE_OVER_TCP = (Fault.CORRUPTED, Fault.NOISE)
"""docs/rig/faults.md: Modbus TCP has no checksum of its own. Over RTU both are detected."""


@dataclass
class Wires:
    """All wires of a rig, without faults until `set_fault_plan`."""

    opened: OpenRig
    fault_plans: dict[str, FaultPlan] = field(default_factory=dict)
    _set: dict[str, Callable[[FaultPlan], None]] = field(default_factory=dict)
    _tcp: list[FaultyLine] = field(default_factory=list)

    @property
    def virtual(self) -> VirtualRig:
        """The virtual rig behind the wires."""
        assert self.opened.virtual is not None
        return self.opened.virtual

    def set_fault_plan(self, wire: str, fault_plan: FaultPlan) -> None:
        """Set the faults of a wire, from its next exchange on."""
        self.fault_plans[wire] = fault_plan
        self._set[wire](fault_plan)

    def insert_faulty_lines(self) -> None:
        """Insert lines that can fail between devices and drivers, and connect the drivers again."""
        virtual, clock = self.virtual, self.virtual.clock
        for name, late_s, foreign in (("axes", 0.1, foreign_tmcl), ("mono", 1.5, None)):
            line = FaultyLine(virtual.serial[name], ScriptedFaults(()), late_s, foreign)
            plug_in(line, clock, partial(virtual.serial.__setitem__, name))
            self._set[name] = partial(setattr, line, "misfortune")
        if "adcs" in virtual.serial:
            line = FaultyLine(virtual.serial["adcs"], ScriptedFaults(()), 1.05, foreign_rtu, exception_rtu)
            plug_in(line, clock, lambda end: virtual.serial.update(adcs=end))
            self._set["adc"] = lambda fault_plan: setattr(line, "misfortune", fault_plan)
        else:
            virtual.modbus_wires = dict.fromkeys(virtual.modbus, self._connection)
            self._set["adc"] = self._all_connections
        bus = FaultyUsb(virtual.usb["monitor"], ScriptedFaults(()), clock)
        virtual.usb["monitor"] = bus
        self._set["monitor"] = lambda fault_plan: setattr(bus, "misfortune", fault_plan)
        for device, error in self.opened.rig.connect().items():
            assert error is None, (device, error)
        for wire in self._set:
            self.set_fault_plan(wire, ScriptedFaults(()))

    def _connection(self, station: SerialDevice) -> SerialDevice:
        fault_plan = self.fault_plans.get("adc", ScriptedFaults(()))
        self._tcp.append(FaultyLine(station, fault_plan, 1.05, foreign_tcp, exception_tcp))
        return FaultyEnd(self._tcp[-1])

    def _all_connections(self, fault_plan: FaultPlan) -> None:
        for line in self._tcp:
            line.misfortune = fault_plan


FAULTS: dict[tuple[str, bool], tuple[Fault, ...]] = {
    ("axes", False): ON_A_SERIAL_LINE,
    ("mono", False): ON_A_TEXT_LINE,
    ("monitor", False): ON_USB,
    ("adc", False): tuple(each for each in ON_MODBUS if each not in UNDETECTABLE_OVER_TCP),
    ("adc", True): ON_MODBUS_RTU,
}
"""Detectable faults by (wire, whether the photodiodes are on a serial line)."""


def faulty_plan(rtu: bool, tables: str = POLICIES) -> Plan:
    """Plan with two wavelengths and two shifts; auto-range where there are several gains; every axis can home."""
    changes: list[Change] = [*QUIET, *(RTU if rtu else (NON_DEFAULT_RANGE,))]
    homes = {"gamma": (5.0, -4.0), "sigma": (5.0, -4.0), "beta": (20.0, -6.0), "shift": (2.0, -1.0)}
    tables_of_axes = "".join(HOMING.format(axis=axis, speed=speed, angle=angle) for axis, (speed, angle) in homes.items())
    changes.append(("[monochromator]\n", f"{tables_of_axes}[monochromator]\n"))
    for axis, (_, angle) in homes.items():
        begin = f"{axis} = {{ motor = {dict(gamma=3, sigma=4, beta=5, shift=0)[axis]},"
        changes.append((begin, f"{begin} home_deg = {angle - 1.0},"))
    rig: RigDescription = parse_rig(changed(RIG.read_text(encoding="utf-8"), tuple(changes)), RIG.parent, "faulty rig")
    gains = "[1e11]" if rtu else "[1e8, 1e10, 1e11]"
    text = changed(SMALL, (("[550]", "[550, 600]"), ("[1e8, 1e10]", gains))) + tables
    schedule: ScheduleDescription = parse_schedule(text, "faulty schedule")
    return change_rows(make_plan(schedule, rig), lambda row: replace(row, automatic=not rtu and row.kind == "measure"))


def run_with_faults(
    plan: Plan,
    path: Path,
    fault_plans: dict[str, FaultPlan],
    listeners: list[Listener] | None = None,
    use_engine: Callable[[Engine], Any] = lambda _: None,
    use_wires: Callable[[Wires], Any] = lambda _: None,
) -> tuple[RunResult, Wires]:
    """Run a plan with faults by wire. `use_engine` and `use_wires` get engine and wires before the run."""
    found: list[Wires] = []

    def prepare(opened: OpenRig) -> None:
        wires = Wires(opened)
        wires.insert_faulty_lines()
        for wire, fault_plan in fault_plans.items():
            wires.set_fault_plan(wire, fault_plan)
        found.append(wires)
        use_wires(wires)

    return run_plan(plan, path, prepare, listeners=listeners, use_engine=use_engine), found[0]


def row_difference(found: CommittedRow, expected: CommittedRow, *, homed: bool) -> str:
    """Describe how a committed row differs from the expected one, to the last digit; empty if it does not.

    A skipped row must have no readings. An axis that was `homed` returns to its position within a few microsteps, 2e-3 deg;
    that changes a signal by up to 0.1 % where a lobe is steep.
    """
    if found.data.flags == (SKIPPED,):
        return "readings of a skipped row" if found.data.readings else ""
    if found.data.flags != expected.data.flags:
        return f"flags {found.data.flags}"
    if [each.gain_v_per_a for each in found.data.readings] != [each.gain_v_per_a for each in expected.data.readings]:
        return "other gains"
    for mine, other in zip(found.data.readings, expected.data.readings, strict=True):
        if mine.counts.shape != other.counts.shape:
            return "another number of readings"
        allowed = np.maximum(3.0, 1e-3 * np.abs(other.counts - 32768.0)) if homed else 0.0
        if np.any(np.abs(mine.counts.astype(int) - other.counts.astype(int)) > allowed):
            return f"counts at {mine.gain_v_per_a:g} V/A"
        if mine.monitor_a != other.monitor_a:
            return f"the monitor: {mine.monitor_a} instead of {other.monitor_a}"
    positions, targets = found.data.positions or {}, expected.data.positions or {}
    deviating = [
        axis for axis, angle in targets.items() if angle is not None and abs((positions[axis] or 0.0) - angle) > 2e-3
    ]  # the encoder's noise
    return f"positions of {deviating}" if deviating else ""
