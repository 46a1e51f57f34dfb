"""Readings that the twin has computed ahead are those computed one by one: the same bytes at the same times, the same journal.

Both ways run the same campaign, with the same event at the same time.
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
from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.usb_standard import BULK_IN
from goniotwin.twin.plant import Plant
from tests.conftest import Writer

TABLES = (
    "SELECT number, attempt, session, started_s, ended_s, positions, flags FROM attempt ORDER BY number, attempt",
    "SELECT * FROM reading ORDER BY number, attempt, gain_v_per_a",
    "SELECT t_s, kind, text FROM event ORDER BY id",
)
Disturb = Callable[[VirtualRig, Engine], None]
OTHER = "adc-3"


@dataclass(frozen=True)
class Disturbance:
    """What is wrong during a campaign, and its name in the report."""

    name: str
    disturb: Disturb

    def __str__(self) -> str:
        return self.name


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


def assert_same_singly(plan: Plan, folder: Path, disturb: Disturb) -> None:
    """Hold a campaign against one whose converters compute each reading alone, when it is asked for."""
    kept = record(plan, folder / "kept", disturb)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Plant, "coming_readings", lambda *_: None)
        assert record(plan, folder / "singly", disturb) == kept


@pytest.mark.parametrize("each", DUE[::11], ids=str)
def test_an_event_changes_the_readings_from_its_time_on(small: Plan, tmp_path: Path, each: Disturbance) -> None:
    assert_same_singly(small, tmp_path, each.disturb)


@pytest.mark.long
@pytest.mark.parametrize("each", DUE, ids=str)
def test_every_event_changes_the_readings_from_its_time_on(small: Plan, tmp_path: Path, each: Disturbance) -> None:
    assert_same_singly(small, tmp_path, each.disturb)
