"""A stop at a station: what it ends, what it waits for, and what does not begin before, during or after it."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest

from goniotwin.app.campaign.running.events import RowStarted, State
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.rig import OpenRig
from goniotwin.app.station.client import Refused, StationClient
from goniotwin.app.station.messages import Message, RunBegun, RunRefused
from goniotwin.app.station.permissions import CommandRefused
from goniotwin.app.station.runs import Runs
from goniotwin.app.station.server import StationServer
from goniotwin.drivers import DeviceError, Monochromator, Pending
from tests.app.station.station_bench import ROWS, Idle, StationBench
from tests.conftest import Writer


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
