"""The engine: rows, pause, stop, faults, and what it writes to the journal."""

import sqlite3
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import operator_for, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan, describe_check
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.engine import SHUTTER_MAY_BE_OPEN, Engine
from goniotwin.app.campaign.running.events import (
    Event,
    Listener,
    Positions,
    RowCommitted,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
)
from goniotwin.app.campaign.running.question import Answer, UnreferencedAxis
from goniotwin.app.campaign.running.rig_executor import CLOSING_S
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.drivers import DeviceError, Pending, Poll
from goniotwin.protocols.clock import Clock, VirtualClock
from tests.app.campaign.campaign_bench import recorded_events
from tests.conftest import Writer


@dataclass
class Bench:
    """A small plan on an open virtual rig, with an engine ready to run it."""

    plan: Plan
    opened: OpenRig
    journal: Journal
    engine: Engine


MakeBench = Callable[..., Bench]


@pytest.fixture
def bench(plan: Plan, tmp_path: Path, request: pytest.FixtureRequest) -> MakeBench:
    def make(clock: Clock, listeners: list[Listener], positions: float = 0.0, transcript: Path | None = None) -> Bench:
        opened = open_rig(plan.rig, clock, transcript)
        request.addfinalizer(opened.close)
        opened.connect()
        journal = Journal.create(tmp_path / "bench.journal", plan, {})
        request.addfinalizer(journal.close)
        operator = operator_for(opened, plan.rig.file, None)
        return Bench(plan, opened, journal, Engine(opened.rig, plan, journal, operator, listeners, positions))

    return make


def test_a_campaign_commits_every_row_in_order(plan: Plan, tmp_path: Path) -> None:
    events: list[Event] = []
    outcome = run_campaign(plan, tmp_path / "a.journal", listeners=[events.append])
    assert (outcome.state, outcome.rows, outcome.planned) == (State.DONE, len(plan.rows), len(plan.rows))
    committed = [event.row.number for event in events if isinstance(event, RowCommitted)]
    assert committed == [row.number for row in plan.rows]
    assert [event.state for event in events if isinstance(event, StateChanged)] == [State.RUNNING, State.DONE]
    with Journal.open(tmp_path / "a.journal") as journal:
        assert journal.row_counts() == (len(plan.rows), len(plan.rows))
        rows = list(journal.rows())
    measured = [each for each in rows if each.row.kind == "measure"]
    assert all(each.data.readings[0].counts.shape == (2, 36) for each in measured)
    assert measured[0].data.positions is not None
    assert measured[0].data.positions["beta"] == pytest.approx(180.0, abs=1e-3)
    assert measured[0].data.positions["beta_encoder"] == pytest.approx(180.0, abs=0.01)


def test_after_a_long_pause_a_dark_reading_is_taken_before_the_next_row(plan: Plan, bench: MakeBench) -> None:
    before = next(row.number for row in plan.rows if row.kind == "measure")

    def pause(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.number == before:
            made.engine.pause()
        elif isinstance(event, StateChanged) and event.state is State.PAUSED:
            clock.sleep_until(clock.now() + 300.0)  # 60 s are allowed
            made.engine.resume()

    clock = VirtualClock()
    made = bench(clock, [pause])
    assert made.engine.run() is State.DONE
    numbers = [each.row.number for each in made.journal.rows()]
    assert numbers == [*range(before + 1), len(plan.rows), *range(before + 1, len(plan.rows))]


def test_the_estimated_duration_is_that_of_the_journal(plan: Plan, tmp_path: Path) -> None:
    outcome = run_campaign(plan, tmp_path / "a.journal")
    assert outcome.seconds == pytest.approx(plan.seconds, rel=0.01)


def test_the_shutter_is_closed_for_dark_readings_and_at_the_end(bench: MakeBench) -> None:
    states: list[tuple[str, bool]] = []
    holder: list[Bench] = []

    def look(event: Event) -> None:
        if isinstance(event, RowCommitted):
            rig = holder[0].opened.virtual
            assert rig is not None
            states.append((event.row.kind, rig.plant.shutter_open.at(rig.clock.now())))

    holder.append(bench(VirtualClock(), [look]))
    assert holder[0].engine.run() is State.DONE
    assert all(is_open == (kind == "measure") for kind, is_open in states)
    assert states[-1][0] == "dark"


def test_a_listener_that_fails_is_named_and_does_not_stop_the_run(bench: MakeBench) -> None:
    def broken(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 2:
            raise RuntimeError("the plot is broken")

    made: Bench = bench(VirtualClock(), [broken])
    assert made.engine.run() is State.DONE
    made.journal.close()
    database = sqlite3.connect(made.journal.path)
    assert database.execute("SELECT kind, text FROM event").fetchall() == [("listener", "RuntimeError: the plot is broken")]
    database.close()


def test_a_stop_during_a_move_keeps_the_committed_rows(bench: MakeBench) -> None:
    clock = VirtualClock()
    made: Bench = bench(clock, [])
    clock.at(clock.now() + 10.0, lambda: made.engine.stop())
    assert made.engine.run() is State.IDLE
    done, planned = made.journal.row_counts()
    assert 0 < done < planned
    rig = made.opened.virtual
    assert rig is not None
    clock.sleep_until(clock.now() + 5.0)
    before = [rig.plant.angle_deg(axis, clock.now()) for axis in ("gamma", "sigma", "beta", "shift")]
    assert [rig.plant.angle_deg(axis, clock.now() + 1000.0) for axis in ("gamma", "sigma", "beta", "shift")] == before


def test_a_device_that_does_not_respond_ends_the_run_and_gives_no_row(bench: MakeBench) -> None:
    holder: list[Bench] = []

    def disconnect(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.row.number == 3:
            rig = holder[0].opened.virtual
            assert rig is not None
            rig.modbus["adc-2"].units = (9,)  # the module does not respond from now on

    holder.append(bench(VirtualClock(), [disconnect]))
    made = holder[0]
    assert made.engine.run() is State.FAILED
    assert made.journal.row_counts()[0] == 4
    assert made.journal.faults()[0].startswith(
        "Photodiodes module 2 (ADAM-6017) is not responding: check address, cable and power ("
    )


def test_an_axis_that_slips_ends_the_run_and_gives_no_row(bench: MakeBench) -> None:
    holder: list[Bench] = []

    def jam(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 0:
            rig = holder[0].opened.virtual
            assert rig is not None
            rig.plant.shafts["sigma"].jam(holder[0].opened.rig.clock.now())

    holder.append(bench(VirtualClock(), [jam]))
    made = holder[0]
    assert made.engine.run() is State.FAILED
    first = next(row.number for row in made.plan.rows if row.pose is not None and row.pose[1] != 0.0)
    assert made.journal.row_counts()[0] == first
    fault = made.journal.faults()[0]
    assert fault.startswith("sigma: ")
    assert all(part in fault for part in ("counter is at 30.000 deg", "encoder", "goniotwin home", "goniotwin here"))


def test_a_rig_with_an_unreferenced_axis_is_refused_and_leaves_no_journal(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    rig = write_rig(("settling_s = 0.2\npower_up_at_reference = true", "settling_s = 0.2"))
    unreferenced = make_plan(read_schedule(write_schedule()), read_rig(rig))
    with pytest.raises(UserError, match=rf"sigma: .*beta: .*goniotwin here --rig {rig} sigma DEG"):
        run_campaign(unreferenced, tmp_path / "unreferenced.journal")
    assert not (tmp_path / "unreferenced.journal").exists()
    result = check_plan(unreferenced)
    assert result.unreferenced == ["sigma", "beta"]
    assert "sigma, beta: home it, or set its position, after each power-up" in describe_check(unreferenced, result)


def test_a_pause_takes_effect_at_the_next_row_and_repeats_no_row(bench: MakeBench) -> None:
    """Pause and resume come from other threads than the one that runs the engine."""
    committed: list[int] = []
    found: list[tuple[list[int], bool]] = []
    others: list[threading.Thread] = []

    def call(action: Callable[[], object]) -> None:
        others.append(threading.Thread(target=action))
        others[-1].start()

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted):
            committed.append(event.row.number)
            if event.row.number == 2:
                call(made.engine.pause)
                others[-1].join()
        elif event == StateChanged(State.PAUSED):
            rig = made.opened.virtual
            assert rig is not None
            found.append((list(committed), rig.plant.shutter_open.at(rig.clock.now())))
            call(made.engine.resume)  # waits for the engine, which still holds its lock here

    made = bench(VirtualClock(), [listen], 0.1)
    assert made.engine.run() is State.DONE
    for other in others:
        other.join()
    assert found == [([0, 1, 2], False)]
    assert committed == [row.number for row in made.plan.rows]
    assert made.engine.state is State.DONE


def test_positions_are_reported_while_the_axes_move(bench: MakeBench) -> None:
    seen: list[float] = []

    def listen(event: Event) -> None:
        if isinstance(event, Positions):
            seen.append(event.degrees["beta"])

    made: Bench = bench(VirtualClock(), [listen], 0.1)
    made.engine.run()
    assert len([beta for beta in seen if 5.0 < beta < 175.0]) > 5


def test_ctrl_c_is_a_stop(bench: MakeBench) -> None:
    def interrupt(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 4:
            raise KeyboardInterrupt

    made = bench(VirtualClock(), [interrupt])
    assert made.engine.run() is State.IDLE
    assert made.journal.row_counts()[0] == 4
    assert made.engine.faults == []


@pytest.mark.parametrize("how", ["Ctrl-C", "stop", "opening", "twice", "a late stop"])
def test_a_stop_closes_the_shutter_after_the_stop_frames(bench: MakeBench, tmp_path: Path, how: str) -> None:
    """Also where the shutter was just being opened, and where a second stop aborts its closing."""
    clock = VirtualClock()
    interrupted: list[str] = []

    def interrupt(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 4:
            assert plant.shutter_open.at(clock.now())
            if how == "stop":
                made.engine.stop()
            elif how in ("Ctrl-C", "twice", "a late stop"):
                raise KeyboardInterrupt

    made = bench(clock, [interrupt], transcript=tmp_path / "wires")
    assert made.opened.virtual is not None
    plant, rig = made.opened.virtual.plant, made.opened.rig
    start, stop = rig.monochromator.start_shutter, rig.stop

    def start_shutter(*, opened: bool) -> Pending:
        pending = start(opened=opened)
        if how == "opening" and opened and not interrupted:
            interrupted.append("while it opens")
            raise KeyboardInterrupt
        if how == "a late stop" and not opened and not interrupted and plant.shutter_open.at(clock.now() - 1.0):
            interrupted.append("while it closes")
            made.engine.stop()
        return pending

    def stop_rig() -> list[DeviceError]:
        if how == "twice" and not interrupted:
            interrupted.append("in the stop")
            raise KeyboardInterrupt
        return stop()

    made.opened.rig.monochromator.start_shutter = start_shutter  # type: ignore[method-assign]
    made.opened.rig.stop = stop_rig  # type: ignore[method-assign]
    assert made.engine.run() is State.IDLE
    assert not plant.shutter_open.at(clock.now())
    assert len(interrupted) == (how in ("opening", "twice", "a late stop"))
    assert made.engine.faults == []
    assert not made.engine.shutter_may_be_open
    assert recorded_events(made.journal.path) == [("shutter", "closed after the stop")]
    made.opened.close()
    sent = {
        wire: (tmp_path / "wires" / f"{wire}.txt").read_text(encoding="utf-8").splitlines()
        for wire in ("axes", "monochromator")
    }
    last_stop = max(line for line in sent["axes"] if " > " in line and "MST" in line)
    closing = max(line for line in sent["monochromator"] if " > " in line and "SHUTTER C" in line)
    assert float(last_stop.split()[0]) <= float(closing.split()[0])


def test_a_shutter_that_cannot_be_closed_is_a_fault_and_stays_so(bench: MakeBench) -> None:
    def unplug(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 4:
            made.opened.rig.monochromator.close()
            raise KeyboardInterrupt

    made = bench(VirtualClock(), [unplug])
    assert made.engine.run() is State.IDLE
    assert len(made.engine.faults) == 1
    assert "; close the shutter by hand (" in made.engine.faults[0]
    assert made.engine.shutter_may_be_open
    assert made.journal.faults() == made.engine.faults


def test_a_stop_that_is_not_confirmed_is_one_order(bench: MakeBench) -> None:
    """The rig is stopped by request, and again at the end of the run."""
    heard: list[str] = []

    def stop(event: Event) -> None:
        if isinstance(event, SafetyOrder):
            heard.append(event.text)
        if isinstance(event, RowStarted) and event.row.number == 4:
            made.opened.rig.stop = lambda: [DeviceError("sigma", "MST", "no reply")]  # type: ignore[method-assign]
            made.engine.stop()

    made = bench(VirtualClock(), [stop])
    assert made.engine.run() is State.IDLE
    assert len(heard) == 1
    assert [text for kind, text in recorded_events(made.journal.path) if kind == "order"] == heard
    assert made.journal.open_orders() == heard
    made.journal.event(made.opened.rig.clock.now(), "acknowledged", heard[0])
    assert made.journal.open_orders() == []


def test_a_shutter_that_does_not_arrive_has_a_deadline(bench: MakeBench) -> None:
    clock = VirtualClock()

    def interrupt(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 4:
            stopped.append(clock.now())
            rig.monochromator.start_shutter = start_shutter  # type: ignore[method-assign]
            raise KeyboardInterrupt

    def start_shutter(*, opened: bool) -> Pending:
        return Poll(clock, clock.now(), 0.1, lambda: False)

    stopped: list[float] = []
    made = bench(clock, [interrupt])
    rig = made.opened.rig
    assert made.engine.run() is State.IDLE
    assert 0.0 < clock.now() - stopped[0] < 1.5 * CLOSING_S
    assert "not done within 4 s" in made.engine.faults[0]


def test_a_full_disk_ends_the_run_and_keeps_the_committed_rows(bench: MakeBench) -> None:
    committed: list[int] = []
    holder: list[Bench] = []

    def fill_the_disk(event: Event) -> None:
        if isinstance(event, RowCommitted):
            committed.append(event.row.number)
            if event.row.number == 3:
                database = holder[0].journal._db
                (pages,) = database.execute("PRAGMA page_count").fetchone()
                database.execute(f"PRAGMA max_page_count = {pages}")

    holder.append(bench(VirtualClock(), [fill_the_disk]))
    assert holder[0].engine.run() is State.FAILED
    assert "full" in holder[0].engine.faults[0]
    holder[0].journal.close()
    with Journal.open(holder[0].journal.path) as journal:
        assert journal.row_counts()[0] == len(committed) >= 4


def test_an_error_of_the_program_stops_the_axes_and_is_in_the_journal(bench: MakeBench) -> None:
    made = bench(VirtualClock(), [])
    engine = Engine(made.opened.rig, made.plan, made.journal, FaultyOperator())
    with pytest.raises(ZeroDivisionError):
        engine.run()
    assert engine.state is State.FAILED
    assert made.journal.faults() == ["ZeroDivisionError: an error of the program"]


def test_an_error_of_the_program_with_an_open_shutter_has_a_note_of_it(bench: MakeBench) -> None:
    def unplug(event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == 4:
            made.opened.rig.monochromator.close()
            raise SystemExit("an error of the program")

    made = bench(VirtualClock(), [unplug])
    with pytest.raises(SystemExit) as ended:
        made.engine.run()
    assert ended.value.__notes__ == [SHUTTER_MAY_BE_OPEN]


class FaultyOperator:
    """Operator whose code has an error."""

    def mount(self, sample: str) -> None:
        raise ZeroDivisionError("an error of the program")

    def resolve_fault(
        self, fault: str, /, *, skippable: bool, device: str = "", axis: UnreferencedAxis | None = None
    ) -> Answer:
        raise ZeroDivisionError(fault)


def test_dark_readings_are_as_recent_as_the_schedule_requires(write_rig: Writer, write_schedule: Writer) -> None:
    long = ("shift_deg = [0, 1]", "shift_deg = { start = 0, stop = 5, step = 0.1 }")
    plan = make_plan(read_schedule(write_schedule(long)), read_rig(write_rig()))
    age = 0.0
    for row in plan.rows:
        age = age + row.seconds if row.kind == "measure" else 0.0
        assert age <= 60.0
