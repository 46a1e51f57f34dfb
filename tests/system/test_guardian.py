"""A program dies with the shutter open: its guardian closes it, and where that dies too, the next program states it."""

import contextlib
import json
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.guardian.guard import read_record, record_folder
from goniotwin.app.guardian.record import EVENTS_SUFFIX
from goniotwin.mocks.control import ControlClient
from goniotwin.protocols.clock import RealClock
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import Writer
from tests.system.command_process import FORKED, CommandProcess
from tests.system.conftest import ForkedServe, at, control_client, until
from tests.system.cut_line import CutLine
from tests.system.station_bench import Attached, runs, station_process

pytestmark = [*FORKED, pytest.mark.endpoint, pytest.mark.usefixtures("heard_hangup")]
CLOSED_S = 2.0
"""From the death to the closed shutter, on a computer that is not busy."""
LONGEST_S = 20.0
"""Longer than a guardian tries."""
REST_S = 3.0
"""From the death to axes at rest: the heartbeat of the controllers is 2 s."""
OPEN = b"SHUTTER O\n"
WAVE = b"GOWAVE 600.000\n"
SPEED = 1
MOST_KB = 20_000
TWO_WAVELENGTHS = ("wavelength_nm = [550]", "wavelength_nm = [550, 600]")


class Rig:
    """A served rig whose monochromator is behind a line that can be cut."""

    def __init__(self, folder: Path, rig: Path, lines: list[dict[str, Any]]) -> None:
        self.folder, self.rig = folder, rig
        self.control: ControlClient = control_client(lines)
        self.line = CutLine(at(lines, "mono", "port")["port"])
        text = rig.read_text(encoding="utf-8")
        mono = at(lines, "mono", "path")["path"]
        assert f'"{mono}"' in text
        rig.write_text(text.replace(f'"{mono}"', f'"socket://127.0.0.1:{self.line.port}"'), encoding="utf-8")
        self.clock = RealClock()
        self.died = 0.0

    def is_open(self) -> bool:
        """Whether the shutter is open, in the virtual rig itself."""
        return bool(self.control.do("state")["shutter_open"])

    @property
    def angles(self) -> dict[str, float]:
        return dict(self.control.do("state")["angles_deg"])

    def kill(self, *pids: int) -> None:
        """Kill processes at once."""
        self.died = self.line.clock.now()
        for pid in pids:
            os.kill(pid, signal.SIGKILL)

    def wait_until_closed(self) -> float:
        """Wait until the guardian has seen the shutter closed, and it is; return the seconds since the death."""
        until(lambda: self._is_settled() or self.line.clock.now() > self.died + LONGEST_S, 0.002)
        closed = self.line.clock.now() - self.died
        assert self._is_settled(), self.record
        assert self.record.done, self.record
        assert not self.is_open()
        return closed

    def _is_settled(self) -> bool:
        record = self.record
        return record is not None and bool(record.outcome)

    @property
    def record(self) -> Any:
        """The record of the monochromator; None without one."""
        found = [read_record(path) for path in record_folder().glob("*.json")]
        return next((each for each in found if each is not None and each.address.endswith(f":{self.line.port}")), None)

    @property
    def reaction_s(self) -> float:
        """From the death to the first byte on the wire, s."""
        return next(t for t, _ in self.line.sent if t > self.died) - self.died

    def forget(self) -> None:
        """Remove the record: another program would state it."""
        with contextlib.suppress(OSError, AttributeError):
            Path(self.record.path).unlink()


Start = Callable[..., CommandProcess]


@pytest.fixture
def rig(write_rig: Writer, forked_serve: ForkedServe, tmp_path: Path) -> Iterator[Rig]:
    path = tmp_path / "served.toml"
    made = Rig(tmp_path, path, forked_serve(write_rig(*QUIET), "--speed", SPEED, "--write-rig", path))
    yield made
    made.forget()
    made.line.close()
    made.control.close()


@pytest.fixture
def processes() -> Iterator[list[CommandProcess]]:
    started: list[CommandProcess] = []
    yield started
    for each in started:
        with contextlib.suppress(ValueError):  # it has ended
            each.kill()


@pytest.fixture
def run(rig: Rig, write_schedule: Writer, processes: list[CommandProcess]) -> Start:
    """Starts a run into the journal of a name."""

    def start(name: str) -> CommandProcess:
        schedule = write_schedule(TWO_WAVELENGTHS)
        process = CommandProcess(rig.folder, "run", schedule, "--rig", rig.rig, "--out", rig.folder / name)
        processes.append(process)
        return process

    return start


def guardian_of(pid: int) -> int:
    """The guardian of a process."""
    found = children(pid)
    assert len(found) == 1, found
    return found[0]


def children(pid: int) -> list[int]:
    """The guardians among the children of a process."""
    listed = [each.read_text(encoding="ascii") for each in Path(f"/proc/{pid}/task").glob("*/children")]
    found = [int(each) for text in listed for each in text.split()]
    return [each for each in found if b"goniotwin.app.guardian" in Path(f"/proc/{each}/cmdline").read_bytes()]


def open_station(rig: Rig, processes: list[CommandProcess], *, opened: bool = True) -> tuple[CommandProcess, Attached]:
    """A station whose client has opened the shutter."""
    process, path = station_process(rig.folder, rig.rig)
    processes.append(process)
    client = Attached(path)
    client.wait_for(lambda: client.snapshot.bench.shutter_open is False)
    if opened:
        open_shutter(rig, client)
    return process, client


def open_shutter(rig: Rig, client: Attached) -> None:
    client.client.do("shutter", opened=True)
    client.wait_for(lambda: client.snapshot.bench.shutter_open is True)
    assert rig.is_open()


def close_to(client: Attached) -> None:
    """Wait for the end of a killed station's client."""
    assert client.ended.wait(10.0)
    client.client.close()


def positions(count: int, statement: bytes) -> list[int]:
    """After how many bytes of a statement it is cut: all in turn, from the last on."""
    return [len(statement) - k % (len(statement) + 1) for k in range(count)]


@pytest.mark.long
@pytest.mark.parametrize("times", [1, 100])
def test_the_shutter_of_a_killed_run_is_closed(rig: Rig, run: Start, times: int) -> None:
    """Killed after each byte of the statement that opens the shutter, or of one while it is open; every fifth after Ctrl-C."""
    seconds, reactions = [], []
    for k in range(times):
        statement = OPEN if k % 2 else WAVE
        keep = positions(times, statement)[k // 2]
        process = run(f"{k}.journal")
        killed: list[int] = []

        def kill(process: CommandProcess = process, killed: list[int] = killed, k: int = k) -> None:
            if k % 5 == 4:
                os.kill(process.pid, signal.SIGINT)
            rig.kill(process.pid)
            killed.append(process.pid)

        rig.line.cut(statement, keep, kill)
        until(lambda killed=killed, process=process: bool(killed) or not process.alive)  # type: ignore[misc]
        assert killed, process.errors
        assert process.wait() == -signal.SIGKILL
        seconds.append(rig.wait_until_closed())
        reactions.append(rig.reaction_s)
        rig.forget()
    print(f"{times} runs: bytes after {_spread(reactions)}, closed after {_spread(seconds)}")
    assert max(seconds) < CLOSED_S


@pytest.mark.parametrize("times", [pytest.param(1, id="1"), pytest.param(100, id="100", marks=pytest.mark.long)])
def test_the_shutter_of_a_killed_station_is_closed(rig: Rig, processes: list[CommandProcess], times: int) -> None:
    seconds, reactions = [], []
    for keep in positions(times, WAVE):
        process, client = open_station(rig, processes)
        pid = process.pid
        killed: list[int] = []

        def kill(pid: int = pid, killed: list[int] = killed) -> None:
            rig.kill(pid)
            killed.append(pid)

        rig.line.cut(WAVE, keep, kill)
        client.client.send("wavelength", nm=600.0)
        until(lambda killed=killed: bool(killed))  # type: ignore[misc]
        seconds.append(rig.wait_until_closed())
        reactions.append(rig.reaction_s)
        close_to(client)
        rig.forget()
    print(f"{times} stations: bytes after {_spread(reactions)}, closed after {_spread(seconds)}")
    assert max(seconds) < CLOSED_S


@pytest.mark.long
def test_the_event_of_a_guardian_is_taken_over_by_the_next_session_of_its_journal(rig: Rig, run: Start) -> None:
    journal = rig.folder / "a.journal"
    process = run(journal.name)
    process.wait_for_rows(4)
    until(rig.is_open)
    rig.kill(process.pid)
    rig.wait_until_closed()
    until(Path(f"{journal}{EVENTS_SUFFIX}").exists)  # it is written after the answer
    assert campaign_summary(journal).orders == []
    resumed = CommandProcess(rig.folder, "run", "--resume", journal)
    assert resumed.wait() == 0, resumed.errors
    assert not Path(f"{journal}{EVENTS_SUFFIX}").exists()
    with Journal.open(journal) as opened:
        (text,) = opened.event_texts("guardian")
    assert "the shutter is closed" in text
    assert "the shutter is closed" in resumed.errors


def test_a_session_that_ends_well_leaves_no_guardian_and_no_byte_after_it(rig: Rig, processes: list[CommandProcess]) -> None:
    process, client = open_station(rig, processes, opened=False)
    assert children(process.pid) == []  # as long as the shutter was not opened
    open_shutter(rig, client)
    guardian = guardian_of(process.pid)
    client.client.do("disconnect")
    assert client.ended.wait(30.0)
    client.client.close()
    assert process.wait() == 0
    sent = len(rig.line.sent)
    assert not runs(guardian)
    assert not rig.is_open()
    assert rig.record is None
    assert len(rig.line.sent) == sent


def test_a_guardian_is_small_deaf_to_signals_and_holds_nothing_of_its_parent(rig: Rig, processes: list[CommandProcess]) -> None:
    process, client = open_station(rig, processes)
    guardian = guardian_of(process.pid)

    def status() -> dict[str, str]:
        lines = Path(f"/proc/{guardian}/status").read_text(encoding="utf-8").splitlines()
        return {name: value.strip() for name, _, value in (line.partition(":") for line in lines)}

    until(lambda: bool(int(status()["SigIgn"], 16) & (1 << (signal.SIGINT - 1))))  # it has begun
    print(f"resident: {status()['VmHWM']}")
    assert int(status()["VmHWM"].split()[0]) < MOST_KB
    assert os.getsid(guardian) == guardian
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(guardian, number)
    links = {each.name: str(each.readlink()) for each in Path(f"/proc/{guardian}/fd").iterdir()}
    assert links.pop("0").startswith("pipe:")
    assert links == {"1": os.devnull, "2": os.devnull}
    rig.kill(process.pid)
    rig.wait_until_closed()
    until(lambda: not runs(guardian))
    close_to(client)


@pytest.mark.long
def test_a_shutter_that_is_open_with_no_program_is_stated_by_the_next_command(
    rig: Rig, run: Start, processes: list[CommandProcess]
) -> None:
    """Program and guardian are killed together. `runs`, `devices` change nothing; `move` closes it."""
    journal = rig.folder / "a.journal"
    process = run(journal.name)
    process.wait_for_rows(4)
    until(rig.is_open)
    rig.kill(guardian_of(process.pid), process.pid)
    assert rig.is_open()
    order = "SAFETY: Close the shutter by hand: the shutter may be open since "

    def command(*arguments: object) -> str:
        started = CommandProcess(rig.folder, *arguments)
        assert started.wait() == 0, started.errors
        return started.errors

    listed = CommandProcess(rig.folder, "runs", rig.folder, "--json")
    assert listed.wait() == 0
    (campaign,) = json.loads(listed.output)["campaigns"]
    assert campaign["orders"][0].startswith("Close the shutter by hand: the shutter may be open")
    assert order in command("devices", "--rig", rig.rig)
    assert rig.is_open()
    assert "Shutter closed now: the shutter may be open since " in command("move", "--rig", rig.rig, "sigma", 3)
    assert not rig.is_open()
    assert order not in command("runs", rig.folder)
    assert order not in command("devices", "--rig", rig.rig)


@pytest.mark.long
@pytest.mark.parametrize("times", [20])
def test_a_station_that_is_started_at_once_after_a_kill_finds_or_makes_the_shutter_closed(
    rig: Rig, processes: list[CommandProcess], times: int
) -> None:
    """The start waits for the guardian, or closes the shutter itself: neither is refused."""
    for _ in range(times):
        process, client = open_station(rig, processes)
        rig.kill(process.pid)
        again, other = open_station(rig, processes, opened=False)
        assert not rig.is_open()
        assert other.snapshot.orders == ()
        other.client.do("disconnect")
        assert other.ended.wait(30.0)
        assert again.wait() == 0, again.errors
        for each in (client, other):
            each.client.close()


@pytest.mark.long
def test_the_axes_of_a_killed_program_rest_by_the_controllers_heartbeat(rig: Rig, processes: list[CommandProcess]) -> None:
    process, client = open_station(rig, processes)
    client.client.do("move", axis="gamma", target_deg=170.0)
    start = rig.angles["gamma"]
    until(lambda: abs(rig.angles["gamma"] - start) > 0.5)
    rig.kill(process.pid)
    clock, before = RealClock(), float("nan")
    while (now := rig.angles["gamma"]) != before:
        before = now
        clock.sleep_until(clock.now() + 0.1)
    assert clock.now() < REST_S + 0.2
    assert abs(now - 170.0) > 1.0
    rig.wait_until_closed()
    close_to(client)


def _spread(seconds: list[float]) -> str:
    ordered = sorted(1000.0 * each for each in seconds)
    return f"{ordered[0]:.0f} to {ordered[-1]:.0f} ms, median {ordered[len(ordered) // 2]:.0f} ms"
