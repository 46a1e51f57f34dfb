"""What is hostile to a run and is no fault of its devices: each of these must leave a run, its archive and its rig unharmed."""

import contextlib
import io
import json
import multiprocessing
import os
import re
import shutil
import socket
import sqlite3
import struct
import subprocess
import sys
import tempfile
import tracemalloc
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import chain, repeat
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import usb.core

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal import chain as journal_chain
from goniotwin.app.campaign.journal import reading
from goniotwin.app.campaign.journal.reading import DamagedJournal
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import CHECKPOINT_ROWS, Journal, copy_journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction import readings, reduction
from goniotwin.app.campaign.reduction.pipeline import reduce_readings
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies import reduced_journal
from goniotwin.app.cli.main import app
from goniotwin.app.data import export as exporting
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, open_rig, read_rig
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.drivers import Monochromator, MonochromatorSettings
from goniotwin.drivers.motion.stop import stop_all
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.usb.usbip import UsbIpLink
from goniotwin.mocks.faults import Fault, FaultPlan
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.protocols import usbip
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from tests import used
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.conftest import ONE_WAY, REPOSITORY, RIG, SMALL, RigOpener, Writer, changed
from tests.drivers.endless_wires import QUICK, WIRES, EndlessServer, FloodedPort, check_calls, check_flood, check_stops
from tests.system.busy_computer import busy_processes
from tests.system.command import invoke
from tests.system.command_process import FORKED, CommandProcess, row_digest
from tests.system.conftest import Serve
from tests.system.mutations import (
    COMMANDS,
    CPU_S,
    HUGE,
    MEMORY_BYTES,
    attempt,
    attempt_many,
    compute_chain,
    make_files,
    write_huge,
)

# ---- a busy computer ----


class BusyClock(VirtualClock):
    """The clock of a busy computer: every third wait lasts up to `LATE_S` longer than it should, by a seed."""

    LATE_S = 0.3

    def __init__(self, seed: int) -> None:
        super().__init__(1.0)
        self._draws = FaultPlan(seed, ())
        self._waits = 0

    def sleep_until(self, t: float) -> None:
        self._waits += 1
        late = self._draws.draw(self._waits, 1000) / 1000.0 if self._draws.draw(self._waits + (1 << 32), 3) == 0 else 0.0
        super().sleep_until(t + self.LATE_S * late)


@pytest.mark.parametrize("seed", range(5))
def test_a_rig_connects_on_a_busy_computer(seed: int) -> None:
    """Its own waits are late, and so are replies, as those of a rig that the same computer serves."""
    with open_rig(read_rig(RIG), BusyClock(seed)) as opened:
        assert opened.virtual is not None
        serial = opened.virtual.serial
        serial["axes"] = FaultyLine(serial["axes"], FaultPlan(seed, (Fault.LATE,), share=0.2), late_s=0.3)
        assert [str(error) for error in opened.rig.connect().values() if error is not None] == []


def connection_errors(rig: RigDescription, clock: Clock) -> list[str]:
    with open_rig(rig, clock) as opened:
        return [str(error) for error in opened.rig.connect().values() if error is not None]


@pytest.mark.long
@pytest.mark.endpoint
def test_one_process_connects_a_hundred_times_beside_twenty_busy_ones() -> None:
    """Ten times as fast as in the laboratory, so that a tenth of the lateness counts."""
    rig = read_rig(RIG)
    with busy_processes(20):
        assert [error for _ in range(100) for error in connection_errors(rig, RealClock(10.0))] == []


@pytest.mark.long
def test_beside_twenty_busy_processes_a_served_rig_connects_though_its_server_is_late_too(serve: Serve, tmp_path: Path) -> None:
    served = tmp_path / "served.toml"
    serve(RIG, "--write-rig", served)
    rig = read_rig(served)
    with busy_processes(20):
        assert [error for _ in range(20) for error in connection_errors(rig, RealClock())] == []


# ---- a device that never stops sending ----


@pytest.mark.parametrize("name", QUICK)
def test_every_call_of_a_driver_ends_within_five_seconds_though_its_device_never_stops_sending(
    opened: RigOpener, name: str
) -> None:
    check_calls(opened, name, (0, 5))


@pytest.mark.long
@pytest.mark.parametrize("name", WIRES)
def test_every_call_ends_at_whichever_request_the_device_begins_to_send_without_end(opened: RigOpener, name: str) -> None:
    check_calls(opened, name, (*range(20), 34, 55, 89))


@pytest.mark.parametrize(
    "name",
    [each if each in QUICK else pytest.param(each, marks=pytest.mark.long) for each in WIRES if each.startswith("axes")],
)
def test_a_stop_is_on_the_wire_in_time_though_the_module_never_stops_sending(opened: RigOpener, name: str) -> None:
    check_stops(opened, name)


@pytest.mark.parametrize("piece", [b"x", b"00\r\n"])
def test_a_flooded_monochromator_holds_no_call_for_longer_than_five_seconds(piece: bytes) -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, piece)
    driver = Monochromator(lambda *_: port, MonochromatorSettings(), clock)
    check_flood(clock, driver.connect, driver.wavelength_nm, lambda: driver.start_wavelength(600.0), driver.shutter_is_open)


def test_stop_frames_are_on_a_flooded_line_within_200_ms() -> None:
    clock = VirtualClock(1.0)
    port: Any = FloodedPort(clock, b"\2\1")
    module = TmclModule(lambda *_: port, clock)
    check_flood(clock, module.connect, module.identify)
    started = clock.now()
    stops = {"axes": module.begin_stop([(name, CommandFrame(1, Command.MST, 0, k)) for k, name in enumerate(AXES)])}
    assert [each.device for each in stop_all(stops)] == list(AXES)
    frames = [t - started for t, data in port.written if t >= started and data[1] == Command.MST]
    assert frames[len(AXES) - 1] < 0.2
    assert clock.now() - started < 5.0


@pytest.mark.parametrize(
    "stream",
    [repeat(usbip.Submitted(999, 0, 0).encode()), chain([usbip.Submitted(1, 0, 1 << 20).encode()], repeat(b"x"))],
    ids=["results of other transfers", "a byte at a time"],
)
def test_a_transfer_over_usbip_ends_though_the_server_never_stops_sending(
    stream: Iterator[bytes], monkeypatch: pytest.MonkeyPatch
) -> None:
    server: Any = EndlessServer(stream)
    monkeypatch.setattr("goniotwin.drivers.usb.usbip._connect", lambda *_: server)
    monkeypatch.setattr("goniotwin.drivers.usb.usbip._clock", server)
    link = UsbIpLink("host", 3240, "1-1")
    with pytest.raises(usb.core.USBError):
        link.read(1, 1 << 20, 1000)
    assert 1.0 < server.now() < 5.0


# ---- a journal with a flipped bit ----


def export_csv(journal: Path, out: Path) -> bytes | None:
    """What `goniotwin export` writes with status 0; None where it refuses the journal in one line and writes nothing."""
    out.unlink(missing_ok=True)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            status = app(["export", str(journal), "--format", "csv", "--out", str(out)], standalone_mode=False)
    except UserError as error:
        return None if error.status and "\n" not in str(error) and not out.exists() else b"other"
    return None if status else out.read_bytes()


@pytest.mark.parametrize("flips", [pytest.param(60, id="60"), pytest.param(10_000, id="10000", marks=pytest.mark.long)])
def test_no_flipped_bit_of_a_journal_gives_other_values(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, flips: int
) -> None:
    """Of all bytes, and where there are few flips of those that are not zero: most others are unused, and change nothing."""
    plan = make_plan(read_schedule(write_schedule(("shift_deg = [0, 1]", "shift_deg = [0]"))), read_rig(write_rig()))
    path, out = tmp_path / "a.journal", tmp_path / "a.csv"
    run_campaign(plan, path)
    whole, sound = path.read_bytes(), export_csv(path, out)
    assert sound is not None
    places = np.arange(len(whole)) if flips > 1000 else np.flatnonzero(np.frombuffer(whole, dtype=np.uint8))
    outcomes: Counter[str] = Counter()
    for k in np.random.default_rng(flips).choice(8 * len(places), flips, replace=False).tolist():
        bit = 8 * int(places[k // 8]) + k % 8
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        found = export_csv(path, out)
        outcomes["refused" if found is None else "same" if found == sound else "other"] += 1
        assert found in (None, sound), f"bit {bit}"
    print(f"\n{dict(outcomes)}")
    assert outcomes["refused"] > flips // 5


# ---- copies of a journal during a run ----


@pytest.mark.long
@pytest.mark.parametrize("runs", [10])
@FORKED[0]
def test_copies_of_a_journal_during_a_run_are_whole(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, runs: int
) -> None:
    """By `goniotwin copy` with every row that was reported before; plain ones without at most ten rows, or refused as torn."""
    rig = write_rig()
    schedule = write_schedule(("wavelength_nm = [550]", "wavelength_nm = [500, 550, 600, 650, 700]"))
    plain, exact = tmp_path / "plain.journal", tmp_path / "exact.journal"
    copies: Counter[str] = Counter()
    for k in range(runs):
        copied: set[tuple[int, str]] = set()  # with the latest row, which need not be reported yet
        path = tmp_path / f"{k}.journal"
        process = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", path)
        process.wait_for_rows(1)
        while process.alive:
            before = process.committed
            if k % 2:
                exact.unlink(missing_ok=True)
                copy_journal(path, exact)
                assert before.items() <= committed_rows(exact).items()
                copies["exact"] += 1
                continue
            shutil.copyfile(path, plain)
            try:
                found = committed_rows(plain)
                copied |= found.items()
                assert len(found) > len(before) - CHECKPOINT_ROWS
                copies["plain"] += 1
            except DamagedJournal:
                copies["torn"] += 1
        assert process.wait() == 0, process.errors
        assert copied <= process.committed.items()
        shutil.copyfile(path, plain)
        assert committed_rows(plain) == process.committed
    print(f"\n{dict(copies)}")
    assert min(copies["exact"], copies["plain"]) > runs


def committed_rows(path: Path) -> dict[int, str]:
    """The rows of a journal, by number, with the digests of their data. Raises DamagedJournal."""
    with Journal.open(path) as journal:
        if journal.chain.damage:
            raise DamagedJournal(journal.chain.damage)
        return {each.row.number: row_digest(each.data) for each in journal.rows()}


# ---- the rig belongs to one program ----

posix = pytest.mark.skipif(sys.platform == "win32", reason="Windows closes a user's folders to others")
ANOTHER_USER = 65_534
TCP = ["socket://127.0.0.1:{}", "socket://localhost:{}", "rfc2217://[::1]:{}", "SOCKET://LOCALHOST:{}/", "socket://0.0.0.0:{}"]
USERS = [(None, None), (None, ANOTHER_USER), (ANOTHER_USER, None)]
"""User of the first and of the second program; None is the one of the tests."""


@dataclass(frozen=True)
class Ports:
    """A TCP port and a serial port that both programs want, and the TCP port of all other devices of the second one."""

    tcp: int
    serial: str
    link: str
    own: socket.socket

    def untouched(self) -> bool:
        """Whether no program has connected to the devices that only the second one has."""
        try:
            self.own.accept()
        except BlockingIOError:
            return True
        return False


@pytest.fixture
def open_folder() -> Iterator[Path]:
    """A folder that every user can read: those of pytest are closed."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


@pytest.fixture
def ports(open_folder: Path) -> Iterator[Ports]:
    """The ports, for every user."""
    with socket.create_server(("127.0.0.1", 0)) as shared, socket.create_server(("127.0.0.1", 0)) as own:
        own.setblocking(False)
        server, port = os.openpty()
        os.fchmod(port, 0o666)
        link = open_folder / "by-id"
        link.symlink_to(os.ttyname(port))
        yield Ports(shared.getsockname()[1], os.ttyname(port), str(link), own)
        os.close(server)
        os.close(port)


def rig_on(folder: Path, port: str, others: int) -> Path:
    """The rig file of a rig that has its axes at a port, and everything else at a TCP port."""
    text = RIG.read_text(encoding="utf-8")
    text = text[: text.index("\n[simulated]")] + text[text.index("\n[axes]") : text.index("\n[twin]")]
    text = text.replace('"twin://virtual/axes"', f'"{port}"').replace(
        '"twin://virtual/monitor"', f'"usbip:localhost:{others}/1"'
    )
    text = text.replace('"twin://virtual/mono"', f'"socket://localhost:{others}"')
    for number in range(10):
        text = text.replace(f'"twin://virtual/adc-{number}"', f'"rtu:socket://localhost:{others}?unit={number + 1}"')
    assert "twin://" not in text
    path = folder / f"rig-{len(list(folder.iterdir()))}.toml"
    path.write_text(text, encoding="utf-8")
    return path


def become(user: int | None, folder: Path) -> None:
    """Go on as another user, which may not be able to load anything any more, with temporary files of this process' own."""
    if user is not None:
        from goniotwin.app.rig.addresses import device_names
        from goniotwin.app.rig.lock import RigLock

        assert device_names("localhost:1")
        RigLock(["/dev/null"], "loading", folder / "loading").release()
        assert invoke("devices", "--rig", RIG).returncode == 0
        assert invoke("devices", "--rig", folder / "no such file").returncode == 2
    own = folder / str(os.getpid())
    own.mkdir()
    state = folder / f"state-{user}"
    state.mkdir(exist_ok=True)
    os.environ.update(TMPDIR=str(own), XDG_STATE_HOME=str(state))
    tempfile.tempdir = None
    if user is not None:
        for each in (own, state):
            os.chown(each, user, user)
        os.setgroups([])
        os.setgid(user)
        os.setuid(user)


def hold(pipe: Connection, rig: Path, port: str, user: int | None) -> None:
    """The first program: it has opened its rig, and its serial port, until the test has ended."""
    from goniotwin.app.rig import open_rig, read_rig
    from goniotwin.app.rig.wires import open_serial
    from goniotwin.protocols.clock import RealClock

    become(user, rig.parent)
    with open_rig(read_rig(rig), RealClock()):
        line = open_serial(port, 115200, 1.0) if port.startswith("/") else None
        pipe.send("held")
        pipe.recv()
        if line is not None:
            line.close()


def connect(pipe: Connection, rig: Path, user: int | None) -> None:
    """The second program."""
    become(user, rig.parent)
    done = invoke("devices", "--rig", rig)
    pipe.send((done.returncode, done.stderr))


@contextlib.contextmanager
def process(work: Callable[..., None], *arguments: Any) -> Iterator[Connection]:
    """A process that does some work, and the pipe to it."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["goniotwin.app.cli.main", "goniotwin.app.cli.device_search", __name__])
    ours, theirs = context.Pipe()
    started = context.Process(target=work, args=(theirs, *arguments))
    started.start()
    theirs.close()
    try:
        yield ours
    finally:
        started.kill()
        started.join()
        started.close()
        ours.close()


def check_refused(status: int, errors: str, ports: Ports) -> None:
    """Check that a program was refused in one line, before it opened anything."""
    assert status == 2, errors
    assert "is in use by process" in errors
    assert "Traceback" not in errors
    assert ports.untouched()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a TCP address has no guard among folders of state")
def test_no_spelling_of_a_port_gets_a_second_program_onto_a_rig(
    open_folder: Path, ports: Ports, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Neither in its own temporary folder, nor with its own folder of locks."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    own = ports.own.getsockname()[1]
    with process(hold, rig_on(open_folder, ports.serial, ports.tcp), ports.serial, None) as holder:
        assert holder.recv() == "held"
        for port in (ports.serial, ports.link, *(each.format(ports.tcp) for each in TCP)):
            for state in (open_folder / "state-None", tmp_path):
                monkeypatch.setenv("XDG_STATE_HOME", str(state))
                done = invoke("devices", "--rig", rig_on(open_folder, port, own))
                check_refused(done.returncode, done.stderr, ports)


@pytest.mark.long
@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only the system's administrator can be two users")
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="elsewhere a TCP address has no guard among users")
@pytest.mark.parametrize("users", USERS, ids=["one user", "another second", "another first"])
def test_two_processes_of_any_users_do_not_get_onto_one_rig(open_folder: Path, ports: Ports, users: tuple[Any, Any]) -> None:
    first_user, second_user = users
    own = ports.own.getsockname()[1]
    tcp = [each.format(ports.tcp) for each in TCP]
    pairs = [*zip(tcp, tcp[1:] + tcp[:1], strict=True), (ports.serial, ports.link), (ports.link, ports.serial)]
    for first, second in pairs:
        with process(hold, rig_on(open_folder, first, ports.tcp), first, first_user) as holder:
            assert holder.recv() == "held"
            with process(connect, rig_on(open_folder, second, own), second_user) as pipe:
                status, errors = pipe.recv()
                check_refused(status, errors, ports)


# ---- folders and files that another user has prepared ----


def owned_by_another(folder: Path, foreign: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only the system's administrator can prepare the folder of another user")
    folder.mkdir(parents=True)
    os.chown(folder, ANOTHER_USER, ANOTHER_USER)


def linked(folder: Path, foreign: Path) -> None:
    folder.parent.mkdir(parents=True, exist_ok=True)
    folder.symlink_to(foreign, target_is_directory=True)


def writable_by_all(folder: Path, foreign: Path) -> None:
    folder.mkdir(parents=True)
    folder.chmod(0o777)


@contextlib.contextmanager
def unchanged(foreign: Path) -> Iterator[None]:
    """Check that no byte of a foreign folder changes, and no file comes."""
    before = {each: each.read_bytes() for each in foreign.iterdir()}
    yield
    assert {each: each.read_bytes() for each in foreign.iterdir()} == before


@pytest.fixture
def foreign(tmp_path: Path) -> Path:
    """A folder with a file that is not to change."""
    folder = tmp_path / "foreign"
    folder.mkdir()
    (folder / "precious").write_text("precious", encoding="utf-8")
    return folder


@posix
@pytest.mark.parametrize("prepare", [owned_by_another, linked, writable_by_all])
def test_a_prepared_folder_of_locks_is_refused(
    prepare: Callable[[Path, Path], None], open_folder: Path, foreign: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    prepare(tmp_path / "state" / "goniotwin" / "locks", foreign)
    with unchanged(foreign):
        done = invoke("devices", "--rig", rig_on(open_folder, "/dev/ttyACM7", 9))
    assert done.returncode == 2
    assert "the lock of /dev/ttyACM7 cannot be made" in done.stderr


@posix
@pytest.mark.parametrize("prepare", [owned_by_another, linked, writable_by_all])
def test_a_prepared_folder_of_pseudo_terminals_is_refused(
    prepare: Callable[[Path, Path], None], foreign: Path, tmp_path: Path
) -> None:
    prepare(tmp_path / "ports", foreign)
    with unchanged(foreign):
        done = invoke("serve", "--rig", RIG, "--ptys", tmp_path / "ports")
    assert (done.returncode, done.stdout) == (2, "")
    assert "cannot be served" in done.stderr


@posix
@pytest.mark.parametrize("name", ["a.journal.lock", "a.journal.holder", ".a.journal.goniotwin-new", "a.journal"])
def test_no_byte_changes_of_a_file_to_which_a_prepared_link_leads(name: str, foreign: Path, tmp_path: Path) -> None:
    schedule = tmp_path / "schedule.toml"
    schedule.write_text(changed(SMALL, (("readings = 2", "readings = 1"),)), encoding="utf-8")
    (tmp_path / name).symlink_to(foreign / "precious")
    with unchanged(foreign):
        done = invoke("run", schedule, "--rig", RIG, "--out", tmp_path / "a.journal")
    assert "Traceback" not in done.stderr
    assert done.returncode == (0 if name in ("a.journal.holder", ".a.journal.goniotwin-new") else 2), done.stderr


# ---- files from strangers ----

MUTATIONS = 10_000
PER_PROCESS = 500
"""Mutations of one child process: a new one for each would take longer than they do."""


def test_a_few_wild_mutations_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(changed := make_files(tmp_path))
    assert [wrong for number in range(24) if (wrong := attempt(number, tmp_path / "originals", changed))] == []


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system has no such limits of a process")
@pytest.mark.parametrize("first", range(0, MUTATIONS, PER_PROCESS))
def test_wild_mutations_are_refused_in_one_line(first: int, tmp_path: Path) -> None:
    """Under 1 GB and within 10 s of the processor; in a child process, which these limits may end."""
    changed = make_files(tmp_path)
    numbers, report = range(first, first + PER_PROCESS), tmp_path / "report"
    arguments = (numbers, tmp_path / "originals", changed, report)
    child = multiprocessing.get_context("spawn").Process(target=attempt_many, args=arguments)
    child.start()
    child.join(3600.0)
    child.kill()
    child.join()
    found = dict(json.loads(line) for line in report.read_text(encoding="utf-8").splitlines())
    assert [wrong for wrong in found.values() if wrong] == []
    assert list(found) == list(numbers)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system does not report the memory of a process")
@pytest.mark.parametrize("what", HUGE)
@pytest.mark.parametrize(
    ("name", "place"),
    [("chained.journal", "attempt.flags"), ("chained.journal", "plan.detail"), ("left.journal", "session.versions")],
)
def test_a_wild_text_of_tens_of_megabytes_is_refused_within_a_gigabyte(
    name: str, place: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(make_files(tmp_path))
    shutil.copy(tmp_path / "originals" / name, name)
    with contextlib.closing(sqlite3.connect(name)) as database, database:
        table, column = place.split(".")
        write_huge(database, table, column, 1, what)
        compute_chain(database)
    done = used.run(sys.executable, "-m", "goniotwin", *COMMANDS[name])
    assert done.peak_bytes < MEMORY_BYTES
    assert done.cpu_s < CPU_S
    assert done.status == (1 if name == "chained.journal" else 0)
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert f"{name}: is damaged: " in lines[0]


OLD_JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"

# ---- a journal of unknown origin is data, not a program; ports of known kinds ----

ANOTHER_TEXT = (
    "PRAGMA writable_schema = ON; UPDATE sqlite_schema SET sql = replace(sql, 'gamma_deg REAL', 'gamma_deg REAL CHECK (1)');"
)
STRANGE_SCHEMAS = {
    "trigger": "CREATE TRIGGER strange AFTER UPDATE ON session BEGIN DELETE FROM reading; END;",
    "view": "CREATE VIEW strange AS SELECT * FROM plan;",
    "view in place of a table": "DROP TABLE event; CREATE VIEW event AS SELECT 1 AS id, 'x' AS text, 'fault' AS kind;",
    "table": "CREATE TABLE strange (x);",
    "index": "CREATE INDEX strange ON plan (abs(seconds));",
    "virtual table": "CREATE VIRTUAL TABLE strange USING fts5(x);",
    "column": "ALTER TABLE plan ADD COLUMN strange TEXT;",
    "generated column": "ALTER TABLE plan ADD COLUMN strange TEXT AS (identity || kind) VIRTUAL;",
    "other text": ANOTHER_TEXT,
    "no table": "DROP TABLE reading;",
    "statistics": "ANALYZE;",
}


def changed_journal(path: Path, statements: str) -> Path:
    """A copy of an old journal, changed as a stranger can."""
    shutil.copyfile(OLD_JOURNAL, path)
    database = sqlite3.connect(path)
    database.executescript(statements)
    database.close()
    return path


@pytest.mark.parametrize("strange", STRANGE_SCHEMAS)
def test_a_journal_with_another_schema_is_refused(tmp_path: Path, strange: str) -> None:
    path = changed_journal(tmp_path / "a.journal", STRANGE_SCHEMAS[strange])
    before = path.read_bytes()
    out = tmp_path / "a.csv"
    for arguments in (("export", path, "--format", "csv", "--out", out), ("run", "--resume", path)):
        done = invoke(*arguments)
        assert (done.returncode, done.stdout) == (2, "")
        (line,) = done.stderr.splitlines()
        assert "a.journal: has " in line
        assert "as no version of goniotwin makes" in line
    assert path.read_bytes() == before
    assert not out.exists()


@pytest.mark.parametrize("place", ["attempt.flags", "attempt.positions", "plan.detail", "session.versions", "event.text"])
def test_a_journal_with_a_text_of_a_length_that_nothing_has_is_refused_before_it_is_parsed(tmp_path: Path, place: str) -> None:
    """16 million lists of 48 MB are 1.4 GB as objects. A stranger can compute checksums, and an old journal has none."""
    table, column = place.split(".")
    lists = "'[' || substr(replace(hex(zeroblob(100000)), '00', '[],'), 1, 299999) || ']'"
    path = changed_journal(tmp_path / "a.journal", f"UPDATE {table} SET {column} = {lists};")
    if table == "event":
        with contextlib.closing(sqlite3.connect(path)) as database, database:
            database.execute(f"INSERT INTO event (t_s, kind, text) VALUES (0, 'fault', {lists})")
    for arguments in (("export", path, "--format", "csv", "--out", tmp_path / "a.csv"), ("runs", tmp_path)):
        done = invoke(*arguments)
        assert done.returncode == (1 if arguments[0] == "export" else 0)
        assert f"has more than 100000 bytes in {column} of the table {table}" in done.stderr
    assert not (tmp_path / "a.csv").exists()


@pytest.mark.parametrize("where", ["kind = 'dark'", "kind = 'measure'", "1"])
@pytest.mark.parametrize("shape", ["readings = readings * 2, channels = channels / 2", "readings = 0, counts = x''"])
def test_counts_of_other_photodiodes_than_the_rigs_are_refused(tmp_path: Path, shape: str, where: str) -> None:
    changed = f"UPDATE reading SET {shape} WHERE number IN (SELECT number FROM plan WHERE {where});"
    path = changed_journal(tmp_path / "a.journal", changed)
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert "a.journal: a row has counts of " in done.stderr
    assert "the rig has 36 of these: use a copy of the journal" in done.stderr


@pytest.mark.parametrize("time", ["9e999", "1e308"])
def test_a_reading_at_no_possible_time_is_refused(tmp_path: Path, time: str) -> None:
    path = changed_journal(tmp_path / "a.journal", f"UPDATE reading SET first_s = {time} WHERE number = 1;")
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert "a.journal: a row has readings at the time " in done.stderr


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ("UPDATE reading SET monitor_a = 9e999 WHERE number = 3;", "a row has a monitor current of inf A"),
        ("UPDATE attempt SET started_s = 1e308 WHERE number = 3;", "row 3 began at the time 1e+308 s"),
    ],
)
def test_a_row_of_no_possible_light_or_time_is_refused(tmp_path: Path, change: str, wrong: str) -> None:
    path = changed_journal(tmp_path / "a.journal", change)
    done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert done.returncode == 2
    assert (len(done.stderr.splitlines()), wrong in done.stderr) == (1, True), done.stderr


@pytest.mark.skipif(os.name == "nt", reason="pipes and links as files")
def test_what_is_no_file_is_no_journal(tmp_path: Path) -> None:
    pipe, loop = tmp_path / "pipe.journal", tmp_path / "loop.journal"
    os.mkfifo(pipe)
    loop.symlink_to(loop)
    for path, what in (
        (pipe, "is a folder or a device, not a journal"),
        (Path("/dev/zero"), "is a folder or a device, not a journal"),
        (loop, "there is no such journal"),
    ):
        done = invoke("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
        assert (done.returncode, done.stderr) == (2, f"goniotwin: {path}: {what}; check the name\n")


def rollback_journal(naming: Path) -> bytes:
    """A rollback journal without pages that names a super-journal (https://sqlite.org/fileformat.html, section 3, and the
    comment of `readSuperJournal` in SQLite's pager.c): once it is rolled back, SQLite deletes the file of that name.
    """
    magic, name = bytes.fromhex("d9d505f920a163d7"), str(naming).encode()
    head = magic + struct.pack(">5I", 0, 1, OLD_JOURNAL.stat().st_size // 4096, 512, 4096)
    locked_page = (1 << 30) // 4096 + 1
    return head.ljust(512, b"\0") + struct.pack(">I", locked_page) + name + struct.pack(">2I", len(name), sum(name)) + magic


@pytest.mark.skipif(os.name == "nt", reason="pipes and links as files")
@pytest.mark.parametrize("strange", ["super-journal", "long", "link", "pipe"])
def test_a_strange_file_beside_a_journal_is_named_and_nothing_else_is_touched(tmp_path: Path, strange: str) -> None:
    path, precious = changed_journal(tmp_path / "a.journal", ""), tmp_path / "precious"
    precious.write_text("x", encoding="utf-8")
    beside = Path(f"{path}-wal" if strange == "link" else f"{path}-journal")
    if strange == "super-journal":
        beside.write_bytes(rollback_journal(precious))
    elif strange == "long":
        beside.write_bytes(rollback_journal(precious))
        os.truncate(beside, 10**11)  # takes no room
    elif strange == "link":
        beside.symlink_to(precious)
    else:
        os.mkfifo(beside)
    export = ("export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    for arguments in (("runs", tmp_path), export, ("copy", path, tmp_path / "b.journal"), ("run", "--resume", path)):
        done = invoke(*arguments)
        assert done.returncode == (0 if arguments[0] == "runs" else 2)
        assert f"{beside}: " in done.stderr
        assert "remove it, and beware of its origin" in done.stderr
    assert precious.read_text(encoding="utf-8") == "x"
    assert {each.name for each in tmp_path.iterdir()} == {path.name, beside.name, "precious"}


def test_a_journal_of_any_own_version_is_opened(tmp_path: Path) -> None:
    """The schema text of one that was migrated is another than that of one that was made so."""
    path = changed_journal(tmp_path / "old.journal", "")
    with Journal.open(path) as journal:
        planned = journal.row_counts()
    with Journal.reopen(path):  # migrates it
        pass
    with Journal.open(path) as journal:
        assert journal.row_counts() == planned


@pytest.mark.parametrize("port", ["spy:///dev/null?file={file}", "spy://socket://127.0.0.1:9?file={file}&all", "alt://{file}"])
def test_a_port_of_another_kind_is_refused_before_anything_is_opened(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, port: str
) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    address = port.format(file=precious)
    for change in (
        ('port = "twin://virtual/axes"', f'port = "{address}"'),
        ('port = "twin://virtual/mono"', f'port = "{address}"'),
        ('"twin://virtual/adc-1"', f'"rtu:{address}"'),
    ):
        rig = write_rig(change)
        for arguments in (("devices", "--rig", rig), ("run", write_schedule(), "--rig", rig, "--out", tmp_path / "a.journal")):
            done = invoke(*arguments)
            assert (done.returncode, done.stdout) == (2, "")
            (line,) = done.stderr.splitlines()
            assert "is not an address of a known kind" in line
    assert precious.read_text() == "precious"


def test_a_resume_on_another_rig_than_the_last_asks_first(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    monkeypatch.setenv("WIN_PD_OVERRIDE_LOCAL_APPDATA", str(tmp_path / "state"))
    rig = write_rig(("twin://virtual/mono", str(tmp_path / "no-device")))
    path = tmp_path / "a.journal"
    Journal.create(path, make_plan(read_schedule(write_schedule()), read_rig(rig)), {}).close()
    before = path.read_bytes()
    (line,) = invoke("run", "--resume", path).stderr.splitlines()  # standard input is no terminal
    assert invoke("run", "--resume", path).returncode == 2
    assert "is not the one that this computer used last" in line
    assert "--accept-rig" in line
    assert str(tmp_path / "no-device") in line
    assert path.read_bytes() == before
    for accepted in (("--accept-rig",), ("--rig", rig)):
        done = invoke("run", "--resume", path, *accepted)
        assert done.returncode == 2
        assert "no-device" in done.stderr
        assert "--accept-rig" not in done.stderr
    remember_rig(read_rig(rig).file)
    assert "--accept-rig" not in invoke("run", "--resume", path).stderr
    remember_rig(read_rig(write_rig(("twin://virtual/mono", "/dev/another"))).file)
    assert "--accept-rig" in invoke("run", "--resume", path).stderr


# ---- journals of any kind in one folder; the end of a campaign; a full disk ----


def test_runs_lists_the_sound_journals_and_names_the_odd_ones(tmp_path: Path) -> None:
    folder = tmp_path / "journals"
    folder.mkdir()
    changed_journal(folder / "[red]sound.journal", "UPDATE campaign SET value = '[/]\x1b[2J' WHERE key = 'name'")
    odd: dict[str, Callable[[Path], object]] = {
        "folder": lambda path: path.mkdir(),
        "text": lambda path: path.write_text("x"),
        "empty": lambda path: path.touch(),
        "loop": lambda path: path.symlink_to(path),
        "nowhere": lambda path: path.symlink_to(tmp_path / "nothing"),
        "endless": lambda path: path.symlink_to("/dev/zero"),
        "torn": lambda path: path.write_bytes(OLD_JOURNAL.read_bytes()[:20_000]),
        "outcome": lambda path: changed_journal(path, "UPDATE session SET outcome = 'strange'"),
        "versions": lambda path: changed_journal(path, f"UPDATE session SET versions = '{'[' * 100_000}'"),
        "duration": lambda path: changed_journal(path, "UPDATE session SET started_s = -9e999"),
        "plan": lambda path: changed_journal(path, "DELETE FROM reading; DELETE FROM attempt; UPDATE plan SET seconds = 9e999"),
        "flags": lambda path: changed_journal(path, "UPDATE attempt SET flags = 'skipped'"),
        "view": lambda path: changed_journal(path, STRANGE_SCHEMAS["view"]),
    }
    if hasattr(os, "mkfifo"):
        odd["fifo"] = os.mkfifo
    for name, make in odd.items():
        make(folder / f"{name}.journal")
    assert invoke("runs", folder, "--json").returncode == 0
    done = invoke("runs", folder)
    assert done.returncode == 0
    assert "[red]sound.journal" in done.stdout
    assert "[/]?[2J" in done.stdout
    named = done.stderr.splitlines()
    assert len(named) == len(odd), done.stderr
    assert all(any(f"{name}.journal" in line for line in named) for name in odd)


@pytest.mark.parametrize("outcome", ["NULL", "'failed'"])
def test_a_campaign_that_ended_after_its_last_row_becomes_done(tmp_path: Path, outcome: str) -> None:
    path = changed_journal(tmp_path / "a.journal", f"UPDATE session SET outcome = {outcome}, ended_s = NULL, wall_ended = NULL")
    assert campaign_summary(path).state == ("done" if outcome == "NULL" else "failed")
    assert campaign_summary(path).seconds_left == 0.0
    with Journal.open(path) as journal:
        (rig := tmp_path / "rig.toml").write_text(changed(journal.value("rig"), (ONE_WAY,)), encoding="utf-8")
    done = invoke("run", "--resume", path, "--rig", rig)  # closes the shutter
    assert done.returncode == 0, done.stderr
    assert campaign_summary(path).state == "done"
    assert "nothing to resume" in invoke("run", "--resume", path, "--rig", rig).stderr


# ---- a million rows ----


@pytest.mark.long
def test_the_memory_of_an_export_grows_by_less_than_a_kilobyte_per_row_and_each_row_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With small blocks a short journal shows what a long one takes."""
    for module in (reduction, reduced_journal):
        monkeypatch.setattr(module, "BLOCK_ROWS", 16)
    monkeypatch.setattr(readings, "EVIDENCE_ROWS", 16)
    monkeypatch.setattr(readings, "ROWS_AT_ONCE", 16)
    monkeypatch.setattr(journal_chain, "CHECKED_TOGETHER", 16)
    monkeypatch.setattr(reading, "RECORDED_TOGETHER", 16)
    monkeypatch.setattr(reading, "INDEXED_TOGETHER", 16)
    monkeypatch.setattr(exporting, "PART_POINTS", 64)
    reduced = 0

    def counted(table: Any, *arguments: Any) -> Any:
        nonlocal reduced
        reduced += table.rows
        return reduce_readings(table, *arguments)

    monkeypatch.setattr(readings, "reduce_readings", counted)
    memory: list[int] = []
    rows: list[int] = []
    reads: list[int] = []
    for wavelengths in (1, 1, 6):  # the first time imports what it needs
        path = tmp_path / f"{len(rows)}.journal"
        rows.append(write_long_journal(path, wavelengths, 1, "repeats = 2\n"))
        reduced = 0
        tracemalloc.start()
        form = format_to_write(tmp_path / "a.csv")
        with Journal.open(path) as journal, reduced_journal.reduce_to_files(journal, tmp_path) as found:
            convert_reduced(found, tmp_path / "a.csv", form, Choice())
        memory.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        reads.append(reduced)
    assert (memory[2] - memory[1]) / (
        rows[2] - rows[1]
    ) < 1000.0  # all points in memory take 4 kB per row, with 36 photodiodes 40
    assert all(read < row for read, row in zip(reads, rows, strict=True))  # also where poses are repeated


WRITE_LONG = """
import os, sys
os.nice(19)  # a quarter of an hour of one core, beside tests in real time
from pathlib import Path
from tests.app.campaign.reduction.long_journal import write_long_journal
print(write_long_journal(Path(sys.argv[1]), 4992, 10))  # with dark readings as many as a campaign may have
"""
EXPORT_LONG = """
import os, sys
os.nice(19)
from goniotwin.app.cli.main import app
status = app(["export", sys.argv[1], "--format", "csv", "--out", sys.argv[2]], standalone_mode=False)
print(open("/proc/self/status").read())  # a child's rusage begins with the memory of its parent
sys.exit(status)
"""


@pytest.mark.long
@pytest.mark.early
@pytest.mark.skipif(sys.platform != "linux", reason="this system has no /proc")
def test_a_million_rows_are_exported_within_a_gigabyte(tmp_path: Path) -> None:
    path, out = tmp_path / "long.journal", tmp_path / "long.csv"

    def run(script: str) -> str:
        words = [sys.executable, "-c", script, str(path), str(out)]
        return subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout

    assert int(run(WRITE_LONG)) > 999_000
    found = re.search(r"VmHWM:\s+(\d+) kB", run(EXPORT_LONG))
    assert found is not None
    with out.open(encoding="utf-8") as file:
        assert sum(not line.startswith("#") for line in file) == 1 + 998_400
    print(f"\n{int(found[1]) / 1024:.0f} MiB")
    assert int(found[1]) * 1024 < 1e9
