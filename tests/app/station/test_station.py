"""The station as a plain object, on the virtual clock: its commands, what it refuses, and what its events give."""

import sqlite3
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.running.events import (
    EventLogged,
    Positions,
    RowStarted,
    SafetyOrder,
    State,
    StateChanged,
)
from goniotwin.app.campaign.running.question import Answer
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.app.station.client import Refused, StationClient
from goniotwin.app.station.contacts import ASK_S
from goniotwin.app.station.messages import (
    ActivityChanged,
    BenchReading,
    DeviceChanged,
    DeviceStatus,
    Message,
    OrderAcknowledged,
    QuestionAsked,
    QuestionClosed,
    RowSaved,
    RunBegun,
    RunEnded,
    RunRefused,
    Snapshot,
    advance,
    decode,
    encode,
)
from goniotwin.app.station.permissions import COMMANDS, CommandRefused, allowed
from goniotwin.app.station.runs import Runs
from goniotwin.app.station.server import StationServer
from goniotwin.app.station.station import Station
from goniotwin.drivers import DeviceError, Monochromator, Pending, Rig
from goniotwin.drivers.errors import NoAnswer
from goniotwin.drivers.guard import CLOSE_SHUTTER
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin import VirtualRig
from tests.app.campaign.campaign_bench import QUIET, planned_values
from tests.conftest import SMALL, Writer

ROWS = 10


class StationBench:
    """A station on the virtual clock, with its events."""

    def __init__(self, rig: Path, wall: Clock | None = None) -> None:
        self.clock = VirtualClock()
        self.station = Station(clock=self.clock, wall=wall)
        self.events: list[Message] = []
        self.reactions: list[Callable[[Message], object]] = []
        self.station.board.subscribe(self._note)
        self.station.open(read_rig(rig))
        self.station.connect_all()

    def _note(self, _number: int, message: Message) -> None:
        self.events.append(message)
        for each in self.reactions:
            each(message)

    def of(self, kind: type[Message]) -> list[Message]:
        return [each for each in self.events if isinstance(each, kind)]

    def work(self) -> Snapshot:
        self.station.work()
        return self.station.snapshot

    @property
    def error(self) -> str:
        """The error of the last activity."""
        return [each.error for each in self.events if isinstance(each, ActivityChanged)][-1]

    @property
    def opened(self) -> OpenRig:
        opened = self.station.opened
        assert opened is not None
        return opened

    @property
    def virtual(self) -> VirtualRig:
        assert self.opened.virtual is not None
        return self.opened.virtual


class Idle(StationBench):
    """A station without a command, on the virtual clock, and on another one in place of the real time between its polls."""

    def __init__(self, rig: Path) -> None:
        self.wall = VirtualClock()
        super().__init__(rig, self.wall)

    def wait(self, seconds: float, step_s: float = 0.1) -> None:
        """Let time pass, and what is due be done."""
        for _ in range(round(seconds / step_s)):
            self.wall.sleep_until(self.wall.now() + step_s)
            self.clock.sleep_until(self.clock.now() + step_s)
            self.station.tick()

    def status(self, device: str) -> DeviceStatus:
        rig = self.station.snapshot.rig
        assert rig is not None
        return rig.devices[device]


@pytest.fixture
def bench(write_rig: Writer) -> Iterator[StationBench]:
    bench = StationBench(write_rig(*QUIET))
    yield bench
    bench.station.close_rig()


@pytest.fixture
def idle(write_rig: Writer) -> Iterator[Idle]:
    idle = Idle(write_rig(*QUIET))
    yield idle
    idle.station.close_rig()


def test_a_station_knows_its_rig(bench: StationBench) -> None:
    now = bench.station.snapshot
    assert now.rig is not None
    assert list(now.rig.devices) == ["axes", "monochromator", "photodiodes", "monitor"]
    assert all(each.connected and each.answered for each in now.rig.devices.values())
    assert now.rig.simulated
    assert now.bench.shutter_open is False
    assert now.activity == ""
    assert allowed(now)["start"] == allowed(now)["move"] == ""


def test_a_move_moves_the_axis_and_is_refused_beyond_the_limits(bench: StationBench) -> None:
    bench.station.move("sigma", 30.0)
    assert bench.station.snapshot.activity == "moving sigma to 30 deg"
    assert bench.work().activity == ""
    assert bench.error == ""
    assert bench.virtual.plant.angle_deg("sigma", bench.clock.now()) == pytest.approx(30.0, abs=0.1)
    for axis, target, reason in (("sigma", 4000.0, "outside its soft limits"), ("tau", 1.0, "is no axis")):
        with pytest.raises(CommandRefused, match=reason):
            bench.station.move(axis, target)
    assert bench.station.snapshot.activity == ""


def test_unreferenced_axes_are_reported_until_their_position_is_set(write_rig: Writer) -> None:
    bench = StationBench(write_rig(*QUIET, ("settling_s = 0.2\npower_up_at_reference = true", "settling_s = 0.2")))
    unreferenced = bench.work().unreferenced
    assert set(unreferenced) == {"sigma", "beta"}
    assert all(unreferenced.values())
    bench.station.set_position("sigma", 0.0)
    assert set(bench.work().unreferenced) == {"beta"}
    bench.station.close_rig()
    assert bench.station.snapshot.unreferenced == {}


def test_positions_are_reported_while_an_axis_moves(bench: StationBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("goniotwin.app.station.poller.POLL_S", 0.0)
    bench.station.move("sigma", 30.0)
    bench.work()
    seen = [each.degrees["sigma"] for each in bench.events if isinstance(each, Positions)]
    assert len(seen) > 3
    assert seen == sorted(seen)


def test_one_thing_at_a_time(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    bench.station.move("sigma", 30.0)
    commands: tuple[Callable[[], None], ...] = (
        lambda: bench.station.move("beta", 10.0),
        lambda: bench.station.read(),
        lambda: bench.station.shutter(True),
        lambda: bench.station.start(write_schedule(), tmp_path),
    )
    for command in commands:
        with pytest.raises(CommandRefused, match="moving sigma to 30 deg"):
            command()
    bench.work()
    bench.station.read()


def test_live_readings_switched_on_before_a_move_do_not_end_it(bench: StationBench) -> None:
    bench.station.live(True)
    bench.station.move("sigma", 30.0)
    bench.work()
    busy = [each.activity for each in bench.events if isinstance(each, ActivityChanged)]
    assert busy == ["moving sigma to 30 deg", ""]
    assert bench.station.snapshot.positions["sigma"] == pytest.approx(30.0, abs=0.1)


def test_a_move_that_is_asked_for_at_the_end_of_a_start_is_in_progress_until_it_has_arrived(
    bench: StationBench, tmp_path: Path
) -> None:
    """The end of one activity is not that of the next: a second motion would begin, and SIGTERM would stop neither."""
    at_end: list[float] = []

    def react(message: Message) -> None:
        if isinstance(message, RunRefused):
            bench.station.move("sigma", 30.0)
        if isinstance(message, ActivityChanged) and not message.activity:
            at_end.append(bench.station.snapshot.positions.get("sigma", 0.0))

    bench.reactions.append(react)
    bench.station.start(tmp_path / "none.toml", tmp_path)
    bench.work()
    assert at_end == [pytest.approx(30.0, abs=0.1)]


def test_the_rig_is_closed_after_the_stops_in_progress(bench: StationBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that finds a closed port would order to cut the motors' power."""
    done: list[str] = []
    begun, go_on, close = threading.Event(), threading.Event(), OpenRig.close

    def stop(_request: StopRequest) -> list[DeviceError]:
        begun.set()
        go_on.wait(5.0)
        done.append("stopped")
        return []

    monkeypatch.setattr(StopRequest, "stop", stop)

    def note_and_close(opened: OpenRig) -> None:
        done.append("closed")
        close(opened)

    monkeypatch.setattr(OpenRig, "close", note_and_close)
    thread = threading.Thread(target=bench.station.stop)
    thread.start()
    assert begun.wait(5.0)
    threading.Timer(0.02, go_on.set).start()
    bench.station.close_rig()
    thread.join()
    assert done == ["stopped", "closed"]


@pytest.mark.long
def test_the_shutter_is_closed_after_the_last_of_many_stops(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each of them aborts what the monochromator does."""
    start, closings = Monochromator.start_shutter, 0

    def start_and_stop(monochromator: Monochromator, *, opened: bool) -> Pending:
        nonlocal closings
        if bench.station.snapshot.state is State.STOPPING and (closings := closings + 1) < 6:
            bench.clock.at(bench.clock.now() + 0.05, bench.station.stop)
        return start(monochromator, opened=opened)

    def react(message: Message) -> None:
        if isinstance(message, RowStarted) and bench.virtual.plant.shutter_open.at(bench.clock.now()):
            bench.station.stop()

    monkeypatch.setattr(Monochromator, "start_shutter", start_and_stop)
    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path)
    now = bench.work()
    assert (now.state, closings) == (State.IDLE, 6)
    assert now.orders == ()
    assert not bench.virtual.plant.shutter_open.at(bench.clock.now())


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


def test_no_command_begins_when_the_rig_is_being_given_back(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    """A start after the last stop would hold up the end of the process until the campaign is done."""
    bench.station.end()
    with pytest.raises(CommandRefused, match="being given back"):
        bench.station.start(write_schedule(), tmp_path)
    with pytest.raises(CommandRefused, match="being given back"):
        bench.station.move("sigma", 30.0)
    assert bench.station.snapshot.activity == ""


def test_a_stop_is_counted_before_it_looks_for_the_run(bench: StationBench, monkeypatch: pytest.MonkeyPatch) -> None:
    """Otherwise a run that ends in this moment would not wait for it, and its safety order would miss the journal."""
    seen: list[int] = []

    def look(_runs: Runs) -> None:
        seen.append(bench.station.stops.in_progress)

    monkeypatch.setattr(Runs, "engine", property(look, lambda *_: None), raising=False)
    bench.station.stop()
    assert seen == [1]


def test_wavelength_shutter_gain_and_reading(bench: StationBench) -> None:
    station = bench.station
    commands: tuple[Callable[[], None], ...] = (
        lambda: station.mount("etalon"),
        lambda: station.move("beta", 180.0),
        lambda: station.wavelength(600.0),
        lambda: station.gain(1e10),
        lambda: station.read(4, dark=True),
        lambda: station.shutter(True),
        lambda: station.read(4),
    )
    for command in commands:
        command()
        bench.work()
        assert bench.error == ""
    now = station.snapshot.bench
    assert (now.wavelength_nm, now.shutter_open, now.gain_v_per_a, now.sample) == (600.0, True, 1e10, "etalon")
    dark, light = [each for each in bench.events if isinstance(each, BenchReading)]
    assert (dark.dark, light.dark) == (True, False)
    assert len(dark.counts) == len(light.volts) == 36
    assert light.monitor_a is not None
    assert dark.monitor_a is not None
    assert light.monitor_a > 10.0 * abs(dark.monitor_a)
    assert max(light.counts) > max(dark.counts) + 10.0
    with pytest.raises(CommandRefused, match="is no gain"):
        station.gain(3.0)


def test_a_sample_that_the_rig_does_not_have(bench: StationBench) -> None:
    bench.station.mount("cheese")
    bench.work()
    assert "cheese" in bench.error
    assert bench.station.snapshot.bench.sample is None


def test_a_dark_reading_leaves_the_shutter_as_it_was(bench: StationBench) -> None:
    bench.station.shutter(True)
    bench.work()
    bench.station.read(dark=True)
    assert bench.work().bench.shutter_open is True
    bench.station.close_rig()
    assert bench.station.snapshot.rig is None


def test_homing_and_setting_the_position(bench: StationBench) -> None:
    with pytest.raises(CommandRefused, match="homing"):
        bench.station.home("sigma")
    with pytest.raises(CommandRefused, match="soft limits"):
        bench.station.set_position("sigma", 4000.0)
    bench.station.set_position("sigma", 5.0)
    bench.work()
    assert bench.error == ""
    assert bench.opened.rig.axes["sigma"].position_deg() == pytest.approx(5.0, abs=0.01)


def test_a_stop_in_the_middle_of_a_move_on_the_bench(bench: StationBench) -> None:
    bench.station.move("sigma", 30.0)
    bench.clock.at(bench.clock.now() + 1.5, bench.station.stop)
    assert bench.work().activity == ""
    assert bench.error == "stopped"
    bench.clock.sleep_until(bench.clock.now() + 5.0)
    angle = bench.virtual.plant.angle_deg("sigma", bench.clock.now())
    assert 5.0 < angle < 29.0
    bench.station.move("sigma", 0.0)  # a stop ends what was in progress, and nothing else
    bench.work()
    assert bench.error == ""


def test_a_stop_before_a_move_has_begun(bench: StationBench) -> None:
    bench.station.move("sigma", 30.0)
    bench.station.stop()
    bench.work()
    assert bench.error == "stopped"
    assert bench.virtual.plant.angle_deg("sigma", bench.clock.now()) == 0.0


def test_no_command_is_accepted_while_a_stop_is_carried_out(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It would clear the request of that stop, and begin."""
    refused = []

    def stop(_request: StopRequest) -> list[DeviceError]:
        commands: tuple[Callable[[], None], ...] = (
            lambda: bench.station.start(write_schedule(), tmp_path),
            lambda: bench.station.live(on=True),
        )
        for command in commands:
            with pytest.raises(CommandRefused, match="being stopped") as error:
                command()
            refused.append(error)
        return []

    monkeypatch.setattr(StopRequest, "stop", stop)
    bench.station.stop()
    assert len(refused) == 2
    bench.station.start(write_schedule(), tmp_path)


def test_what_was_asked_for_before_a_stop_does_not_begin_after_it(bench: StationBench) -> None:
    """The line of a client waits somewhere while another one stops."""
    server = StationServer(bench.station)
    server.start()
    client = StationClient(server.port, server.token, "a")
    client.start()
    try:
        before = bench.station.snapshot.stops
        bench.station.stop()
        with pytest.raises(Refused, match="stopped before the start"):
            client.do("move", axis="sigma", target_deg=30.0, stops=before)
        client.do("move", axis="sigma", target_deg=30.0, stops=bench.station.snapshot.stops)
    finally:
        client.close()
        server.stop()


def test_a_stop_before_a_run_or_its_resume_has_begun(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.station.stop()
    bench.work()
    assert [each.reason for each in bench.of(RunRefused) if isinstance(each, RunRefused)] == ["stopped before the start"]
    bench.station.start(write_schedule(), tmp_path)
    bench.reactions.append(lambda message: bench.station.stop() if isinstance(message, RowStarted) else None)
    bench.work()
    bench.reactions.clear()
    (journal,) = tmp_path.glob("*.journal")
    bench.events.clear()
    bench.station.resume_journal(journal)
    bench.station.stop()
    bench.work()
    assert [each.reason for each in bench.of(RunRefused) if isinstance(each, RunRefused)] == ["stopped before the start"]
    assert not bench.of(RunBegun)


def test_live_readings_after_a_stop(idle: Idle) -> None:
    """The station died of its own stop request."""
    idle.station.live(on=True)
    idle.work()
    idle.station.stop()  # before the first reading, which sets the gain
    idle.wait(0.1)
    assert not idle.work().bench.live
    idle.station.stop()
    idle.station.live(on=True)
    idle.work()
    idle.wait(0.1)
    assert idle.work().bench.live
    idle.station.live(on=True)
    idle.station.stop()
    idle.work()
    assert not idle.work().bench.live


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


def test_a_person_mounts_and_the_first_answer_counts(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    refused: list[str] = []

    def react(message: Message) -> None:
        if isinstance(message, QuestionAsked):
            bench.station.answer(message.number, Answer.WAIT)
            bench.station.answer(message.number, Answer.MOUNTED)
            for number, choice in ((message.number, Answer.MOUNTED), (message.number + 1, Answer.MOUNTED)):
                try:
                    bench.station.answer(number, choice)
                except CommandRefused as error:
                    refused.append(str(error))

    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path, person=True)
    assert bench.work().state is State.DONE
    asked = bench.of(QuestionAsked)
    assert [each.question.title for each in asked] == ["Mount etalon", "Mount gaussian-5"]  # type: ignore[union-attr]
    assert len(refused) == 2 * len(asked)
    assert all("is answered already" in each for each in refused)
    assert [each.answer for each in bench.of(QuestionClosed)] == [Answer.MOUNTED] * 2  # type: ignore[union-attr]


def test_a_resumed_run_has_the_operator_that_it_began_with(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer
) -> None:
    """The choice is in the journal: the station that began it, and its window, may be gone."""
    answer = Answer.STOP

    def react(message: Message) -> None:
        if isinstance(message, QuestionAsked):
            (bench if len(asked) == 0 else other).station.answer(message.number, answer)
            asked.append(message)

    asked: list[QuestionAsked] = []
    bench.reactions.append(react)
    bench.station.start(write_schedule(), tmp_path, person=True)
    now = bench.work()
    assert (now.state, now.person, len(asked)) == (State.IDLE, True, 1)
    bench.station.close_rig()
    other = StationBench(write_rig(*QUIET))
    other.reactions.append(react)
    answer = Answer.MOUNTED
    assert now.journal is not None
    other.station.resume_journal(now.journal)
    now = other.work()
    assert (now.state, now.person, len(asked)) == (State.DONE, True, 3)
    other.station.close_rig()


def test_the_photodiodes_are_asked_when_nothing_else_reads_them(idle: Idle, monkeypatch: pytest.MonkeyPatch) -> None:
    """So that it is known when they last answered; live readings show it themselves."""
    asked: list[PhotodiodeArray] = []
    check = PhotodiodeArray.check

    def note(photodiodes: PhotodiodeArray) -> None:
        check(photodiodes)
        asked.append(photodiodes)

    monkeypatch.setattr(PhotodiodeArray, "check", note)
    idle.wait(1.5 * ASK_S)
    assert len(asked) == 2
    idle.station.live(True)
    idle.work()
    idle.wait(1.5 * ASK_S)
    assert len(asked) == 2


def test_live_readings_do_not_wait_for_amplifiers_that_have_settled(idle: Idle) -> None:
    """Of the rig's time a reading takes one conversion and the exchanges: ten a second."""
    idle.station.live(True)
    idle.work()
    while len(taken := idle.of(BenchReading)) < 5:
        idle.wait(0.005, 0.005)
    _, *times = [each.t_s for each in taken if isinstance(each, BenchReading)]  # the first one has waited
    assert [after - before for before, after in pairwise(times)] == pytest.approx([0.1] * 3, abs=0.02)


def test_stop_answers_a_question(bench: StationBench, write_schedule: Writer, tmp_path: Path) -> None:
    bench.reactions.append(
        lambda message: bench.station.answer(message.number, Answer.STOP) if isinstance(message, QuestionAsked) else None
    )
    bench.station.start(write_schedule(), tmp_path, person=True)
    now = bench.work()
    assert now.state is State.IDLE
    assert now.question is None


def test_an_order_stands_until_it_is_acknowledged(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    with monkeypatch.context() as patch:
        patch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
        now = bench.work()
    (order,) = now.orders
    assert now.journal is not None
    assert campaign_summary(now.journal).orders == [order.text]
    with pytest.raises(CommandRefused, match="no such safety order"):
        bench.station.acknowledge("something else")
    bench.station.acknowledge(order.text)
    assert bench.station.snapshot.orders == ()
    assert campaign_summary(now.journal).orders == []
    with pytest.raises(CommandRefused, match="no safety order is open"):
        bench.station.acknowledge(order.text)


def test_an_order_about_the_shutter_ends_when_the_run_has_seen_it_closed(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    order = SafetyOrder(CLOSE_SHUTTER, "it may be open")
    open_orders: list[tuple[SafetyOrder, ...]] = []

    def give(message: Message) -> None:
        if isinstance(message, RowSaved) and message.row.kind == "measure" and order not in bench.events:
            bench.station.runs.listen(order)
            open_orders.append(bench.station.snapshot.orders)

    bench.reactions.append(give)
    bench.station.start(write_schedule(), tmp_path)
    now = bench.work()
    assert open_orders == [(order,)]
    kinds = [type(each) for each in bench.events]
    assert kinds.index(OrderAcknowledged) < max(k for k, kind in enumerate(kinds) if kind is RowSaved)
    assert now.orders == ()


def test_an_order_of_the_last_session_stands_after_a_resume(
    bench: StationBench, write_schedule: Writer, tmp_path: Path, write_rig: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench.station.start(write_schedule(), tmp_path)
    bench.clock.at(bench.clock.now() + 8.0, bench.station.stop)
    with monkeypatch.context() as patch:
        patch.setattr(Rig, "stop", lambda _rig: [NoAnswer("sigma", "MST", "nothing")])
        journal = bench.work().journal
    assert journal is not None
    other = StationBench(write_rig(*QUIET))
    other.station.resume_journal(journal)
    (order,) = other.work().orders
    assert order.order == "Cut the motors' power"
    other.station.acknowledge(order.text)
    assert campaign_summary(journal).orders == []
    other.station.close_rig()


def test_an_order_without_a_run(bench: StationBench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Rig, "stop", lambda _rig: [NoAnswer("beta", "MST", "nothing")])
    (failure,) = bench.station.stop()
    assert failure.startswith("beta: MST: nothing")
    (order,) = bench.station.snapshot.orders
    bench.station.acknowledge(order.text)
    assert bench.station.snapshot.orders == ()


def test_a_stop_from_another_thread_on_the_virtual_clock_is_a_flag(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    def stop_elsewhere() -> None:
        thread = threading.Thread(target=bench.station.stop)
        thread.start()
        thread.join()

    bench.clock.at(bench.clock.now() + 8.0, stop_elsewhere)
    bench.station.start(write_schedule(), tmp_path)
    now = bench.work()
    assert now.state is State.IDLE
    assert 0 < now.done < ROWS


def test_a_device_that_is_lost_and_connected_again(
    bench: StationBench, monkeypatch: pytest.MonkeyPatch, write_schedule: Writer, tmp_path: Path
) -> None:
    modules = bench.virtual.modbus["adc-2"]
    modules.units = (9,)
    bench.station.read()
    now = bench.work()
    assert "Photodiodes module 2 (ADAM-6017) is not responding" in bench.error
    assert now.rig is not None
    assert now.rig.not_responding == ["photodiodes"]
    assert allowed(now)["read"] == allowed(now)["start"] == "not responding: photodiodes"
    assert allowed(now)["move"] == ""
    with pytest.raises(CommandRefused, match="not responding: photodiodes"):
        bench.station.start(write_schedule(), tmp_path)
    modules.units = (1,)
    bench.station.connect()
    now = bench.work()
    assert now.rig is not None
    assert now.rig.not_responding == []
    changed = [each for each in bench.events if isinstance(each, DeviceChanged)]
    assert [each.status.connected for each in changed] == [False, True]


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


def test_every_event_survives_the_channel_and_leads_to_the_same_state(
    bench: StationBench, write_schedule: Writer, tmp_path: Path
) -> None:
    """A client that attached at the beginning, and one that attaches at the end, have the snapshot of the station."""
    early = decode(encode(bench.station.snapshot))
    assert isinstance(early, Snapshot)
    bench.events.clear()
    bench.reactions.append(
        lambda message: bench.station.answer(message.number, Answer.MOUNTED) if isinstance(message, QuestionAsked) else None
    )
    bench.station.start(write_schedule(), tmp_path, person=True)
    bench.work()
    bench.station.read()
    bench.work()
    for message in bench.events:
        received = decode(encode(message))
        assert received == message
        assert not isinstance(received, Snapshot)
        assert received is not None
        early = advance(early, received)
    assert early == bench.station.snapshot == decode(encode(bench.station.snapshot))


def test_an_event_of_a_later_version_is_none_and_a_wrong_one_is_an_error() -> None:
    assert decode({"type": "Coffee"}) is None
    with pytest.raises(ValueError, match="Positions"):
        decode({"type": "Positions", "degrees": "all"})
    long = EventLogged("fault", "x" * 100_000)
    assert len(str(encode(long))) < 3000
    assert decode(encode(EventLogged("fault", "what"))) == EventLogged("fault", "what")
    assert decode(encode(SafetyOrder("a", "b"))) == SafetyOrder("a", "b")


def test_a_shutter_that_is_found_open_is_an_order_until_it_is_closed(bench: StationBench) -> None:
    """Opened by hand, or by another program: it is left as it is, because a person may work with it."""
    bench.virtual.plant.shutter_open.set(bench.clock.now(), True)
    bench.station.connect("monochromator")
    (order,) = bench.work().orders
    assert order.order == "Close the shutter by hand"
    assert bench.virtual.plant.shutter_open.at(bench.clock.now())
    bench.station.shutter(opened=False)
    assert bench.work().orders == ()
    assert bench.station.orders.open == []


def test_a_shutter_that_the_bench_has_opened_is_no_order(bench: StationBench) -> None:
    bench.station.shutter(opened=True)
    bench.work()
    bench.station.connect("monochromator")
    assert bench.work().orders == ()
    bench.station.shutter(opened=False)
    bench.work()


def test_a_run_closes_a_shutter_that_is_found_open(write_rig: Writer) -> None:
    bench = StationBench(write_rig(*QUIET))
    bench.virtual.plant.shutter_open.set(bench.clock.now(), True)
    bench.station.report_connected()  # as of `goniotwin run`
    assert bench.station.orders.open == []
    assert not bench.virtual.plant.shutter_open.at(bench.clock.now())
    assert [each.what for each in bench.events if isinstance(each, EventLogged)][-1].startswith(
        "Shutter closed now: it is open"
    )
    bench.station.close_rig()
