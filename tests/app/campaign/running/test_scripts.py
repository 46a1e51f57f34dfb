"""Exchanges handed to a wire together are those made one after the other: the same bytes at the same times, the same journal.

Both ways run the same campaign, with the same faults at the same places: of the wires, of the devices, and events between.
"""

import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import open_rig, read_rig
from goniotwin.mocks.faults import ON_A_SERIAL_LINE, ON_MODBUS, ON_USB, Fault, ScriptedFaults
from goniotwin.mocks.faulty_line import FaultyEnd, FaultyLine, exception_tcp, foreign_tcp, foreign_tmcl, plug_in
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.script import Exchanged
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.usbtmc import BULK_IN
from goniotwin.twin.doors import TwinModbusClient
from goniotwin.twin.doors.protocol_twin import Serial
from goniotwin.twin.doors.usb import Scripts
from tests.conftest import Writer

TABLES = (
    "SELECT number, attempt, session, started_s, ended_s, positions, flags FROM attempt ORDER BY number, attempt",
    "SELECT * FROM reading ORDER BY number, attempt, gain_v_per_a",
    "SELECT t_s, kind, text FROM event ORDER BY id",
)
Disturb = Callable[[VirtualRig, Engine], None]
MODULE, OTHER = "adc-1", "adc-3"


@dataclass(frozen=True)
class Disturbance:
    """What is wrong during a campaign, and its name in the report."""

    name: str
    disturb: Disturb

    def __str__(self) -> str:
        return self.name


def modbus(faults: tuple[Fault, ...], apart: int) -> Disturb:
    """Faults of one module's connections, so many exchanges apart."""

    def disturb(rig: VirtualRig, engine: Engine) -> None:
        misfortune = ScriptedFaults(spread(faults, apart))
        engine._rig.photodiodes.close()
        rig.modbus_wires[MODULE] = lambda station: FaultyEnd(FaultyLine(station, misfortune, 1.05, foreign_tcp, exception_tcp))
        engine._rig.photodiodes.connect()

    return disturb


def axes(faults: tuple[Fault, ...], apart: int) -> Disturb:
    """Faults of the line of the axes."""

    def disturb(rig: VirtualRig, engine: Engine) -> None:
        line = FaultyLine(rig.serial["axes"], ScriptedFaults(()), 0.1, foreign_tmcl)
        plug_in(line, rig.clock, lambda end: rig.serial.update(axes=end))
        engine._rig.reconnect("axes")
        line.misfortune = ScriptedFaults(spread(faults, apart))

    return disturb


def monitor(faults: tuple[Fault, ...], apart: int) -> Disturb:
    """Faults of the monitor's bus."""

    def disturb(rig: VirtualRig, engine: Engine) -> None:
        bus = rig.usb["monitor"] = FaultyUsb(rig.usb["monitor"], ScriptedFaults(()), rig.clock)
        engine._rig.monitor.connect()
        bus.misfortune = ScriptedFaults(spread(faults, apart))

    return disturb


def spread(faults: tuple[Fault, ...], apart: int) -> list[Fault]:
    return [each for fault in faults for each in (*[Fault.NONE] * apart, fault)]


def at(t: float, action: Callable[[VirtualRig, Engine, float], object]) -> Disturb:
    """An event between, t seconds after the begin."""

    def disturb(rig: VirtualRig, engine: Engine) -> None:
        due = rig.clock.now() + t
        rig.clock.at(due, lambda: action(rig, engine, due))

    return disturb


def refuse(rig: VirtualRig, _engine: Engine, _t: float) -> None:
    rig.modbus[OTHER].refusals += [adam.BUSY, adam.DEVICE_FAILURE]


def fall_silent(rig: VirtualRig, _engine: Engine, _t: float) -> None:
    rig.modbus[OTHER].silent = True
    rig.clock.at(rig.clock.now() + 1.5, lambda: setattr(rig.modbus[OTHER], "silent", False))


def unplug(rig: VirtualRig, _engine: Engine, t: float) -> None:
    rig.usb["monitor"].unplug()
    rig.clock.at(t + 0.3, rig.usb["monitor"].replug)


EVENTS: dict[str, Callable[[VirtualRig, Engine, float], object]] = {
    "a module refuses": refuse,
    "a module falls silent": fall_silent,
    "a module resets": lambda rig, _, t: rig.modbus[OTHER].reset(t),
    "another program changes a range": lambda rig, _, t: rig.modbus[OTHER].write_registers(adam.RANGE_CODE + 2, [0x0142], t),
    "another program changes outputs": lambda rig, _, t: rig.modbus[OTHER].write_coils(adam.DIGITAL_OUTPUT, [False], t),
    "channels are disabled": lambda rig, _, t: rig.modbus[OTHER].write_registers(adam.CHANNEL_ENABLE, [0x0F], t),
    "the light changes": lambda rig, _, t: rig.plant.set_lamp(t, level=0.7),
    "the shutter falls": lambda rig, _, t: rig.plant.shutter_open.set(t, False),
    "the axes' module resets": lambda rig, _, t: rig.serial["axes"].reset(t),
    "an axis is jammed": lambda rig, _, t: rig.plant.shafts["beta"].jam(t),
    "the monitor resets": lambda rig, _, t: rig.usb["monitor"].instrument.power_cycle(t),
    "the monitor's endpoint halts": lambda rig, _, __: rig.usb["monitor"].halt(BULK_IN),
    "the monitor is unplugged": unplug,
    "the run is stopped": lambda _, engine, __: engine.stop(),
}
FAULTS = [
    *(Disturbance(f"Modbus: {each}", modbus((each,), 37)) for each in ON_MODBUS),
    *(Disturbance(f"axes: {each}", axes((each,), 41)) for each in ON_A_SERIAL_LINE),
    *(Disturbance(f"monitor: {each}", monitor((each,), 7)) for each in ON_USB),
]
TIMES = (0.02, 1.3, 2.601, 3.9, 4.37, 5.05, 6.2, 7.77)
DUE = [Disturbance(f"{name} after {t:g} s", at(t, action)) for name, action in EVENTS.items() for t in TIMES]


@pytest.fixture
def small(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule()), read_rig(write_rig()))


def record(plan: Plan, folder: Path, disturb: Disturb) -> tuple[object, ...]:
    """Run a plan; its end, its journal's rows and its transcripts."""
    folder.mkdir()
    with (
        Journal.create(folder / "run.journal", plan, {}, durable=False) as journal,
        open_rig(plan.rig, VirtualClock(), transcript=folder / "wires") as opened,
    ):
        opened.connect()
        assert opened.virtual is not None
        engine = Engine(opened.rig, plan, journal, operator_for(opened, plan.rig.file, None))
        disturb(opened.virtual, engine)
        state = engine.run()
        ended = opened.rig.clock.now()
    with sqlite3.connect(folder / "run.journal") as db:
        tables = [db.execute(each).fetchall() for each in TABLES]
    db.close()
    wires = {path.name: path.read_text(encoding="utf-8") for path in sorted((folder / "wires").iterdir())}
    return state, engine.faults, ended, tables, wires


def both_ways(plan: Plan, folder: Path, disturb: Disturb) -> tuple[list[int], list[int]]:
    """Hold both ways against each other; the numbers of exchanges in the scripts that were made, and of USB transfers."""
    sizes: list[int] = []
    modbus_script, serial_script, usb_script = TwinModbusClient.run_script, Serial.run_script, Scripts.run_script
    messages: list[int] = []

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(TwinModbusClient, "run_script", lambda *each: noted(modbus_script(*each), sizes))
        patch.setattr(Serial, "run_script", lambda *each: noted(serial_script(*each), sizes))
        patch.setattr(Scripts, "run_script", lambda *each: noted(usb_script(*each), messages))
        together = record(plan, folder / "together", disturb)
        patch.setattr(TwinModbusClient, "run_script", lambda *_: [])
        patch.setattr(Serial, "run_script", lambda *_: [])
        patch.setattr(Scripts, "run_script", lambda *_: [])
        singly = record(plan, folder / "singly", disturb)
    assert together == singly
    return sizes, messages


def noted(made: list[Exchanged], sizes: list[int]) -> list[Exchanged]:
    sizes.append(len(made))
    return made


def test_a_campaign_without_faults_is_the_same_both_ways_and_its_readings_are_one_script(small: Plan, tmp_path: Path) -> None:
    sizes, messages = both_ways(small, tmp_path, lambda *_: None)
    modules = -(-small.rig.file.photodiodes.count // adam.CHANNELS)
    assert {2 * modules, 4 * modules} <= set(sizes)  # the readings of a row, those of a dark row
    assert sizes.count(0) == 0
    assert set(messages) == {1, 2}  # READ? and later its value; the canary


@pytest.mark.parametrize("kind", [modbus(ON_MODBUS, 17), axes(ON_A_SERIAL_LINE, 23), monitor(ON_USB, 5)])
def test_a_campaign_on_a_wire_with_every_kind_of_fault_is_the_same_both_ways(
    small: Plan, tmp_path: Path, kind: Disturb
) -> None:
    both_ways(small, tmp_path, kind)


@pytest.mark.parametrize("each", DUE[::11], ids=str)
def test_an_event_between_is_met_at_the_same_exchange_both_ways(small: Plan, tmp_path: Path, each: Disturbance) -> None:
    both_ways(small, tmp_path, each.disturb)


@pytest.mark.long
@pytest.mark.parametrize("each", [*FAULTS, *DUE], ids=str)
def test_every_fault_and_event_is_met_at_the_same_exchange_both_ways(small: Plan, tmp_path: Path, each: Disturbance) -> None:
    both_ways(small, tmp_path, each.disturb)
