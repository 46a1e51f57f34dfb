"""A small campaign on a virtual rig of which any wire can be made to fail, at any of its exchanges."""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.record import CommittedRow
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.row import SKIPPED
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
NOT_AS_AFTER_POWER_ON = ("gain_uncertainty", "range_code = 0x0142\ngain_uncertainty")
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
"""docs/faults.md: Modbus TCP has no checksum of its own. Over RTU both are seen."""


@dataclass
class Wires:
    """All of a rig's, well until they are told to suffer."""

    opened: OpenRig
    misfortunes: dict[str, FaultPlan] = field(default_factory=dict)
    _set: dict[str, Callable[[FaultPlan], None]] = field(default_factory=dict)
    _tcp: list[FaultyLine] = field(default_factory=list)

    @property
    def virtual(self) -> VirtualRig:
        """What is behind them."""
        assert self.opened.virtual is not None
        return self.opened.virtual

    def suffer(self, wire: str, misfortune: FaultPlan) -> None:
        """From now on."""
        self.misfortunes[wire] = misfortune
        self._set[wire](misfortune)

    def break_up(self) -> None:
        """Puts what may fail between the devices and the drivers, which are connected anew."""
        virtual, clock = self.virtual, self.virtual.clock
        for name, late_s, foreign in (("axes", 0.1, foreign_tmcl), ("mono", 1.5, None)):
            line = FaultyLine(virtual.serial[name], ScriptedFaults(()), late_s, foreign)
            plug_in(line, clock, partial(virtual.serial.__setitem__, name))
            self._set[name] = partial(setattr, line, "misfortune")
        if "adcs" in virtual.serial:
            line = FaultyLine(virtual.serial["adcs"], ScriptedFaults(()), 1.05, foreign_rtu, exception_rtu)
            plug_in(line, clock, lambda end: virtual.serial.update(adcs=end))
            self._set["adc"] = lambda misfortune: setattr(line, "misfortune", misfortune)
        else:
            virtual.modbus_wires = dict.fromkeys(virtual.modbus, self._connection)
            self._set["adc"] = self._all_connections
        bus = FaultyUsb(virtual.usb["monitor"], ScriptedFaults(()), clock)
        virtual.usb["monitor"] = bus
        self._set["monitor"] = lambda misfortune: setattr(bus, "misfortune", misfortune)
        for device, error in self.opened.rig.connect().items():
            assert error is None, (device, error)
        for wire in self._set:
            self.suffer(wire, ScriptedFaults(()))

    def _connection(self, station: SerialDevice) -> SerialDevice:
        misfortune = self.misfortunes.get("adc", ScriptedFaults(()))
        self._tcp.append(FaultyLine(station, misfortune, 1.05, foreign_tcp, exception_tcp))
        return FaultyEnd(self._tcp[-1])

    def _all_connections(self, misfortune: FaultPlan) -> None:
        for line in self._tcp:
            line.misfortune = misfortune


FAULTS: dict[tuple[str, bool], tuple[Fault, ...]] = {
    ("axes", False): ON_A_SERIAL_LINE,
    ("mono", False): ON_A_TEXT_LINE,
    ("monitor", False): ON_USB,
    ("adc", False): tuple(each for each in ON_MODBUS if each not in UNDETECTABLE_OVER_TCP),
    ("adc", True): ON_MODBUS_RTU,
}
"""By wire, and whether the photodiodes are behind a serial line."""


def failing_plan(rtu: bool, tables: str = POLICIES) -> Plan:
    """Two wavelengths, two shifts; automatic gains where there are several; every axis can be homed."""
    changes: list[Change] = [*QUIET, *(RTU if rtu else (NOT_AS_AFTER_POWER_ON,))]
    homes = {"gamma": (5.0, -4.0), "sigma": (5.0, -4.0), "beta": (20.0, -6.0), "shift": (2.0, -1.0)}
    tables_of_axes = "".join(HOMING.format(axis=axis, speed=speed, angle=angle) for axis, (speed, angle) in homes.items())
    changes.append(("[monochromator]\n", f"{tables_of_axes}[monochromator]\n"))
    for axis, (_, angle) in homes.items():
        begin = f"{axis} = {{ motor = {dict(gamma=3, sigma=4, beta=5, shift=0)[axis]},"
        changes.append((begin, f"{begin} home_deg = {angle - 1.0},"))
    rig: RigDescription = parse_rig(changed(RIG.read_text(encoding="utf-8"), tuple(changes)), RIG.parent, "failing rig")
    gains = "[1e11]" if rtu else "[1e8, 1e10, 1e11]"
    text = changed(SMALL, (("[550]", "[550, 600]"), ("[1e8, 1e10]", gains))) + tables
    schedule: ScheduleDescription = parse_schedule(text, "failing schedule")
    return change_rows(make_plan(schedule, rig), lambda row: replace(row, automatic=not rtu and row.kind == "measure"))


def run_with(
    plan: Plan,
    path: Path,
    misfortunes: dict[str, FaultPlan],
    listeners: list[Listener] | None = None,
    made: Callable[[Engine], Any] = lambda _: None,
    broken: Callable[[Wires], Any] = lambda _: None,
) -> tuple[RunResult, Wires]:
    """The plan, with what happens to its wires from the beginning on."""
    found: list[Wires] = []

    def prepare(opened: OpenRig) -> None:
        wires = Wires(opened)
        wires.break_up()
        for wire, misfortune in misfortunes.items():
            wires.suffer(wire, misfortune)
        found.append(wires)
        broken(wires)

    return run_plan(plan, path, prepare, listeners=listeners, made=made), found[0]


def wrong(found: CommittedRow, right: CommittedRow, *, homed: bool) -> str:
    """What of a committed row is not as in an undisturbed run, to the last digit; empty where all is. A skipped row has nothing
    that could be.

    An axis that has been `homed` stands where it stood to a few microsteps, 2e-3 deg, which is up to a permille where a lobe
    is steep.
    """
    if found.data.flags == (SKIPPED,):
        return "readings of a row that was skipped" if found.data.readings else ""
    if found.data.flags != right.data.flags:
        return f"flags {found.data.flags}"
    if [each.gain_v_per_a for each in found.data.readings] != [each.gain_v_per_a for each in right.data.readings]:
        return "other gains"
    for mine, theirs in zip(found.data.readings, right.data.readings, strict=True):
        if mine.counts.shape != theirs.counts.shape:
            return "another number of readings"
        allowed = np.maximum(3.0, 1e-3 * np.abs(theirs.counts - 32768.0)) if homed else 0.0
        if np.any(np.abs(mine.counts.astype(int) - theirs.counts.astype(int)) > allowed):
            return f"counts at {mine.gain_v_per_a:g} V/A"
        if mine.monitor_a != theirs.monitor_a:
            return f"the monitor: {mine.monitor_a} instead of {theirs.monitor_a}"
    where, there = found.data.positions or {}, right.data.positions or {}
    apart = [
        axis for axis, angle in there.items() if angle is not None and abs((where[axis] or 0.0) - angle) > 2e-3
    ]  # the encoder's noise
    return f"positions of {apart}" if apart else ""
