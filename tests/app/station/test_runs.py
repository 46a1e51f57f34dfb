"""A run at a station: to the end, paused, ended after a cut, resumed, refused, and what it permits."""

import sqlite3
import threading
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.running.events import State, StateChanged
from goniotwin.app.station.messages import Message, RowSaved, RunBegun, RunEnded, RunRefused, decode, encode
from goniotwin.app.station.permissions import COMMANDS, CommandRefused, allowed
from tests.app.campaign.campaign_bench import QUIET, planned_values
from tests.app.station.station_bench import ROWS, StationBench
from tests.conftest import SMALL, Writer


@pytest.mark.parametrize("name", ["x" * 300, "a\0b", "\ud800"], ids=["long", "NUL", "surrogate"])
def test_a_path_that_the_system_refuses_is_one_line_and_the_rig_stays(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, name: str
) -> None:
    for schedule, folder in ((None, tmp_path / name), (tmp_path / name, tmp_path), (write_schedule(), tmp_path / name)):
        if schedule is None:
            bench.station.resume_journal(folder)
        else:
            bench.station.start(schedule, folder)
        assert bench.work().rig is not None
        assert bench.station.snapshot.activity == ""
    assert len(bench.of(RunRefused)) == 3
    assert all(decode(encode(each)) == each for each in bench.events)


def test_a_run_that_would_collide_on_its_way_to_the_first_row_has_no_journal(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    """It was created, and the run failed after three tries at a fault of the device."""
    for axis, angle in (("beta", 300.0), ("shift", 5.0)):
        bench.station.move(axis, angle)
        bench.work()
    bench.station.start(write_schedule(), tmp_path / "journals")
    bench.work()
    (refused,) = bench.of(RunRefused)
    assert isinstance(refused, RunRefused)
    assert refused.reason.startswith("on the way from beta 300.0 deg, shift 5.0 deg to the first row the arc would collide")
    assert refused.reason.endswith("lower the shift first, or turn in the other direction")
    assert not (tmp_path / "journals").exists()
    bench.station.move("shift", 0.0)
    bench.work()
    bench.station.start(write_schedule(), tmp_path / "journals")
    assert bench.work().state is State.DONE


def test_a_run_from_start_to_end(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    folder, busy = tmp_path / "journals", set[bool]()  # a station that is not busy, and has no client, ends
    bench.reactions.append(lambda message: busy.add(bench.station.busy) if isinstance(message, RunBegun | RowSaved) else None)
    bench.station.start(write_schedule(), folder)
    now = bench.work()
    assert now.state is State.DONE
    assert now.journal == folder / "small-001.journal"
    assert (now.done, now.total) == (ROWS, ROWS)
    saved = [each for each in bench.events if isinstance(each, RowSaved)]
    assert [each.row.number for each in saved] == list(range(ROWS))
    assert isinstance(bench.events[-1], RunEnded)
    assert busy == {True}
    assert campaign_summary(folder / "small-001.journal").state == "done"


@pytest.mark.parametrize("command", COMMANDS)
def test_what_a_run_permits(bench: StationBench, write_schedule: Writer, tmp_path: Path, command: str) -> None:
    found: dict[str, dict[str, str]] = {}

    def note(message: Message) -> None:
        if isinstance(message, RowSaved) and message.done == 3:
            found["now"] = allowed(bench.station.snapshot)

    bench.reactions.append(note)
    bench.station.start(write_schedule(), tmp_path)
    bench.work()
    permitted = command in ("stop", "operate", "pause", "finish_cut", "speed")
    assert (found["now"][command] == "") == permitted


def test_a_stop_in_a_run_and_its_resume(bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer) -> None:
    """The resumed rows have the values of an undisturbed run: the same rig, with its time."""
    bench.station.start(write_schedule(), tmp_path / "a")
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    now = bench.work()
    assert now.state is State.IDLE
    assert 0 < now.done < ROWS
    assert now.journal is not None
    before = now.done
    bench.station.resume_journal(now.journal)
    now = bench.work()
    assert now.state is State.DONE
    assert [each.done for each in bench.events if isinstance(each, RunBegun)] == [0, before]
    assert now.journal is not None
    summary = campaign_summary(now.journal)
    assert (now.done, now.total) == (summary.rows, summary.planned) == (ROWS, ROWS)  # without the mounting of the resume
    resumed = [each for each in bench.events if isinstance(each, RowSaved)][before:]
    assert len(resumed) > ROWS - before
    assert [each.done for each in resumed if each.row.unplanned] == [before] * (len(resumed) - (ROWS - before))
    other = StationBench(write_rig(*QUIET))
    other.station.start(write_schedule(), tmp_path / "b")
    undisturbed = other.work().journal
    other.station.close_rig()
    assert now.journal is not None
    assert undisturbed is not None
    assert planned_values(now.journal) == planned_values(undisturbed)


def test_a_journal_of_another_rig_is_refused(
    bench: StationBench, write_schedule: Writer, write_rig: Writer, tmp_path: Path
) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    journal = bench.work().journal
    assert journal is not None
    other = StationBench(write_rig(*QUIET, ("settling_s = 0.2", "settling_s = 0.3"), name="other.toml"))
    other.station.resume_journal(journal)
    other.work()
    (refused,) = other.of(RunRefused)
    assert isinstance(refused, RunRefused)
    assert "is not the rig" in refused.reason
    other.station.close_rig()


def test_pause_and_resume(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    """The run waits in its thread, so that resume comes from another one: on the virtual clock it is only a flag too."""
    states: list[State] = []

    def react(message: Message) -> None:
        if isinstance(message, RowSaved) and message.done == 3:
            bench.station.pause()
        if isinstance(message, StateChanged):
            states.append(message.state)
            if message.state is State.PAUSED:
                threading.Timer(0.0, bench.station.resume).start()

    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path)
    assert bench.work().state is State.DONE
    assert State.PAUSED in states


@pytest.mark.parametrize("command", ["pause", "finish_cut", "stop"])
def test_what_is_asked_for_before_the_first_row_is_not_lost(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, command: str
) -> None:
    """The run has been started and its thread has not begun it."""
    begun: list[State] = []

    def react(message: Message) -> None:
        if isinstance(message, RowSaved) and not begun:
            begun.append(bench.station.snapshot.state)
        if isinstance(message, StateChanged) and message.state is State.PAUSED:
            begun.append(message.state)
            threading.Timer(0.0, bench.station.stop).start()

    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path)
    assert bench.station.snapshot.starting
    with pytest.raises(CommandRefused, match="starting"):
        bench.station.disconnect()
    getattr(bench.station, command)()
    now = bench.work()
    assert not now.starting
    assert now.state is State.IDLE
    assert begun == ([State.PAUSED] if command == "pause" else [])
    assert bench.of(RowSaved) == []


@pytest.mark.parametrize("interrupted", [False, True])
def test_finish_cut_ends_after_the_cut(bench: StationBench, write_schedule: Writer, tmp_path: Path, interrupted: bool) -> None:
    """Also the cut that an interruption has left: it is in progress before the first row of its rest."""
    schedule = write_schedule(("beta_deg = [180]", "beta_deg = [0, 45, 90, 180]"))

    def react(message: Message) -> None:
        if isinstance(message, RowSaved) and message.row.kind == "measure" and not finishing:
            finishing.append(message.row)
            (bench.station.stop if interrupted else bench.station.finish_cut)()

    def finish(message: Message) -> None:
        if isinstance(message, RowSaved):
            bench.station.finish_cut()

    finishing: list[object] = []
    bench.reactions.append(react)
    bench.station.start(schedule, tmp_path)
    if interrupted:
        journal = bench.work().journal
        assert journal is not None
        bench.reactions[:] = [finish]
        bench.station.resume_journal(journal)
    now = bench.work()
    assert now.state is State.IDLE
    assert now.reason == "ended after the cut, as requested"
    rows = [each.row for each in bench.events if isinstance(each, RowSaved) and each.row.kind == "measure"]
    planes = {(each.sample, each.pose[1], each.pose[2] % 180.0) for each in rows if each.pose is not None}
    assert len(planes) == 1
    assert len(rows) >= 2
    assert now.journal is not None
    summary = campaign_summary(now.journal)
    assert summary.state == "stopped"
    assert not summary.orders
    assert not bench.virtual.plant.shutter_open.at(bench.clock.now())


def test_finish_cut_in_the_last_cut_ends_the_campaign(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    def react(message: Message) -> None:
        if isinstance(message, RowSaved) and message.done == ROWS - 1:
            bench.station.finish_cut()

    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path)
    assert bench.work().state is State.DONE


def test_a_schedule_that_cannot_be_measured_is_refused(bench: StationBench, tmp_path: Path) -> None:
    bench.station.start(tmp_path / "none.toml", tmp_path)
    now = bench.work()
    (refused,) = bench.of(RunRefused)
    assert isinstance(refused, RunRefused)
    assert "none.toml" in refused.reason
    assert now.activity == ""
    assert now.journal is None


def test_an_exception_of_a_run_ends_it_and_the_station_goes_on(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from goniotwin.app.campaign.journal.writing import Journal

    def full(*_: object) -> None:
        raise sqlite3.OperationalError("database or disk is full")

    with monkeypatch.context() as patch:
        patch.setattr(Journal, "commit", full)
        bench.station.start(write_schedule(), tmp_path)
        now = bench.work()
    assert now.state is State.FAILED
    assert "disk is full" in now.reason
    bench.station.start(write_schedule(text=SMALL), tmp_path)
    assert bench.work().state is State.DONE
