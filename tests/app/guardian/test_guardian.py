"""The guardian's process at a line of the test's own, and the parent's side of it."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import serial
from filelock import FileLock, Timeout

from goniotwin.app.cli.main import app
from goniotwin.app.guardian import __main__ as guardian
from goniotwin.app.guardian import guard
from goniotwin.app.guardian.guard import Guardian, RigGuard, read_events, read_record
from goniotwin.app.guardian.held import HeldFile, Taken, take_name
from goniotwin.app.guardian.record import EVENTS_SUFFIX, FAREWELL, GUARDIAN, Record, decode_all, encode_all
from goniotwin.app.rig.left import acknowledge_left, left_unsafe
from goniotwin.app.rig.lock import LockFile, RigInUse, SystemName
from goniotwin.drivers.guard import LastWill
from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.monochromator.settings import MonochromatorSettings
from goniotwin.protocols.clock import VirtualClock

TIMEOUT_S = 60.0
OPEN, CLOSED = b"O\r\n", b"C\r\n"


class Unit:
    """A monochromator at a TCP port, which answers each `SHUTTER?` with the next of `answers`, the last one again and again."""

    def __init__(self, *answers: bytes) -> None:
        self.received = b""
        self._answers = list(answers)
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._thread = threading.Thread(target=self._serve)
        self._thread.start()

    def close(self) -> None:
        self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()
        self._thread.join()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listener.accept()
            except OSError:
                return
            with connection:
                while data := connection.recv(1024):
                    self.received += data
                    for _ in range(data.count(b"SHUTTER?\n")):
                        connection.sendall(self._answers[0])
                        del self._answers[: len(self._answers) > 1]


@pytest.fixture
def unit_with() -> Iterator[Callable[..., Unit]]:
    units: list[Unit] = []

    def make(*answers: bytes) -> Unit:
        units.append(Unit(*answers))
        return units[-1]

    yield make
    for each in units:
        each.close()


def last_will() -> LastWill:
    """That of the driver."""

    def never(_baudrate: int, _timeout_s: float) -> object:
        raise AssertionError("a last will opens no port")

    return Monochromator(never, MonochromatorSettings(), VirtualClock()).last_will()  # type: ignore[arg-type]


@pytest.fixture
def record(tmp_path: Path) -> Record:
    """A record of the monochromator, with one lock and a journal."""
    (tmp_path / "a.journal").touch()
    (tmp_path / "rig.lock").touch()
    will = last_will()
    ending, order, question = (each.decode() for each in (will.ending, will.order, will.question))
    return Record(
        will.device,
        "socket://127.0.0.1:1",
        will.baudrate,
        ending,
        order,
        question,
        will.safe,
        will.danger,
        will.remedy,
        will.relief,
        "rig",
        4711,
        "2026-01-01T00:00:00+00:00",
        str(tmp_path / "record.json"),
        str(tmp_path / "a.journal"),
        (str(tmp_path / "rig.lock"),),
        (),
    )


def at(unit: Unit, record: Record) -> Record:
    return replace(record, address=f"socket://127.0.0.1:{unit.port}")


def written_by(record: Record) -> Record:
    """The record as the guardian has left it."""
    found = read_record(Path(record.path))
    assert found is not None
    return found


def guard_process(*lines: bytes) -> None:
    """The process, whose parent writes these lines and dies."""
    done = subprocess.run(guard.COMMAND, input=b"".join(lines), capture_output=True, timeout=TIMEOUT_S, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")


def test_the_will_is_sent_when_the_parent_dies_and_the_answer_is_compared(
    unit_with: Callable[..., Unit], record: Record
) -> None:
    """Statements of the manual MCS260, p. 49; the end of a line before them ends one that was half sent."""
    unit = unit_with(CLOSED)
    guard_process(encode_all([at(unit, record)]))
    assert unit.received == b"\r\nABORT\nSHUTTER C\nSHUTTER?\n"
    found = written_by(record)
    assert found.done
    assert found.outcome.startswith("process 4711 died; the shutter is closed, ")
    assert read_events(Path(f"{record.journal}{EVENTS_SUFFIX}")) == [f"monochromator: {found.outcome}"]
    assert not Path(record.locks[0]).with_suffix(".holder").exists()


def test_a_line_with_echo_and_handshake_mode_is_understood(unit_with: Callable[..., Unit], record: Record) -> None:
    unit = unit_with(b"SHUTTER?\nC\r\n00\r\n")
    guard_process(encode_all([at(unit, record)]))
    assert written_by(record).done


def test_it_tries_again_while_the_shutter_is_open(unit_with: Callable[..., Unit], record: Record, quick: None) -> None:
    unit = unit_with(OPEN, OPEN, CLOSED)
    guardian.carry_out(at(unit, record))
    assert unit.received.count(b"SHUTTER C\n") == 3
    assert written_by(record).done


def test_what_it_could_not_do_is_recorded_as_not_done(unit_with: Callable[..., Unit], record: Record, quick: None) -> None:
    unit = unit_with(b"SHUTTER?\nO\r\n00\r\n")
    guardian.carry_out(at(unit, record))
    assert unit.received.count(b"SHUTTER C\n") == guardian.ATTEMPTS
    found = written_by(record)
    assert not found.done
    assert found.text == (
        "Close the shutter by hand: the shutter may be open since 2026-01-01T00:00:00+00:00: process 4711 (rig, a.journal) "
        "ended without making sure; the guardian could not make it safe: asked 'SHUTTER?', it answered "
        "'SHUTTER?\\nO\\r\\n00\\r\\n'"
    )
    assert "could not make it safe" in read_events(Path(f"{record.journal}{EVENTS_SUFFIX}"))[0]


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """The waits of a guardian in this process are short."""
    for name in ("REPLY_S", "QUIET_S", "OPEN_S", "LOCK_S"):
        monkeypatch.setattr(guardian, name, 0.1)


@pytest.mark.parametrize(
    "lines",
    [
        [b"RECORD", FAREWELL],
        [b"RECORD", b"[]\n"],
        [b"[]\n"],
        [],
        [b"RECORD"[:3]],
    ],
    ids=["farewell", "disarmed", "never armed", "no line", "half a line"],
)
def test_nothing_is_sent_where_nothing_is_armed(unit_with: Callable[..., Unit], record: Record, lines: list[bytes]) -> None:
    unit = unit_with(CLOSED)
    armed = encode_all([at(unit, record)])
    guard_process(*(armed if each == b"RECORD" else armed[:-1] if each == b"REC" else each for each in lines))
    assert unit.received == b""
    assert not Path(record.path).exists()


def test_half_a_line_leaves_what_the_line_before_has_armed(unit_with: Callable[..., Unit], record: Record) -> None:
    unit = unit_with(CLOSED)
    guard_process(encode_all([at(unit, record)]), b'[{"device": "monochrom')
    assert written_by(record).done


def test_a_lock_that_cannot_be_taken_at_all_holds_nothing_up(unit_with: Callable[..., Unit], record: Record) -> None:
    """Its folder was removed, or is no folder any more."""
    nowhere = (str(Path(record.path).with_name("gone") / "a.lock"), str(Path(record.locks[0]) / "a.lock"))
    guardian.carry_out(replace(at(unit_with(CLOSED), record), locks=nowhere))
    assert written_by(record).done


def test_a_busy_port_is_tried_again(record: Record, monkeypatch: pytest.MonkeyPatch, unit_with: Callable[..., Unit]) -> None:
    unit, really = unit_with(CLOSED), serial.serial_for_url
    refused: list[tuple[Any, ...]] = []

    def busy_at_first(*arguments: Any, **options: Any) -> serial.Serial:
        if len(refused) < 3:
            refused.append(arguments)
            raise serial.SerialException("busy")
        return really(*arguments, **options)

    monkeypatch.setattr(serial, "serial_for_url", busy_at_first)
    guardian.carry_out(at(unit, record))
    assert unit.received.count(b"SHUTTER C\n") == 1
    assert written_by(record).done


def test_a_rig_that_another_program_has_is_left_to_it(unit_with: Callable[..., Unit], record: Record, quick: None) -> None:
    unit = unit_with(CLOSED)
    with FileLock(record.locks[0]), pytest.raises(Taken):
        guardian.carry_out(at(unit, record))
    name = SystemName("tcp:nowhere:1", "nowhere")
    with pytest.raises(Taken):
        guardian.carry_out(replace(at(unit, record), names=(name.name,)))
    name.release()
    assert unit.received == b""
    HeldFile(record.locks[0]).close()  # it keeps nothing that it has not got


def test_a_rig_that_another_program_had_meanwhile_is_left_alone(unit_with: Callable[..., Unit], record: Record) -> None:
    unit = unit_with(CLOSED)
    Path(record.path).write_text(replace(record, pid=4712).encode(), encoding="utf-8")
    guardian.carry_out(at(unit, record))
    assert unit.received == b""
    assert written_by(record).pid == 4712


def test_the_guardians_lock_and_that_of_the_programs_exclude_each_other(tmp_path: Path) -> None:
    path = tmp_path / "a.lock"
    path.touch()
    held = HeldFile(str(path))
    with pytest.raises(Timeout):
        FileLock(path, 0.0, thread_local=False).acquire()
    held.close()
    with FileLock(path, thread_local=False), pytest.raises(Taken):
        HeldFile(str(path))
    taken = take_name("goniotwin-test")
    if taken is not None:
        with pytest.raises(Taken):
            take_name("goniotwin-test")
        taken.close()


def test_a_program_waits_for_a_guardian_and_for_no_other(tmp_path: Path) -> None:
    path, note = tmp_path / "a.lock", tmp_path / "a.holder"
    path.touch()
    held = HeldFile(str(path))
    note.write_text("process 1 of a person\n", encoding="utf-8")
    with pytest.raises(RigInUse, match="process 1 of a person"):
        LockFile(path, "the rig", "a test", 0o600)
    note.write_text(f"process 2, the {GUARDIAN} 1, which died\n", encoding="utf-8")
    timer = threading.Timer(0.3, held.close)  # longer than the wait for any other holder
    timer.start()
    LockFile(path, "the rig", "a test", 0o600).release()
    timer.join()


def test_the_process_loads_the_standard_library_and_pyserial_alone() -> None:
    code = "import sys, json, goniotwin.app.guardian.__main__; print(json.dumps(sorted(sys.modules)))"
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True)
    loaded = {each for each in json.loads(done.stdout) if each.partition(".")[0] not in sys.stdlib_module_names}
    own = {each for each in loaded if each.partition(".")[0] == "goniotwin"}
    assert own == {
        "goniotwin",
        "goniotwin.app",
        "goniotwin.app.guardian",
        "goniotwin.app.guardian.__main__",
        "goniotwin.app.guardian.held",
        "goniotwin.app.guardian.record",
        "goniotwin.first_use",
        "goniotwin.own_files",
        "goniotwin.protocols",
        "goniotwin.protocols.clock",
    }
    assert {each.partition(".")[0] for each in loaded - own if not each.startswith(("_", "sitecustomize"))} == {"serial"}


@pytest.mark.skipif(sys.platform == "win32", reason="this system has no such signal")
def test_a_guardian_that_is_killed_is_started_again(record: Record) -> None:
    found = Guardian()
    found.hand([record])
    first = found.pid
    assert first is not None
    os.kill(first, signal.SIGKILL)
    os.waitid(os.P_PID, first, os.WEXITED | os.WNOWAIT)
    found.hand([record])
    assert found.pid not in (None, first)
    assert found.failure == ""
    found.end()
    assert found.pid is None


def test_a_guardian_that_cannot_be_started_is_stated(record: Record) -> None:
    found = Guardian([str(Path("no", "such", "program"))])
    found.hand([record])
    assert found.failure.startswith("the guardian cannot be started: ")
    found.end()


def test_what_is_armed_at_the_end_is_an_order_until_it_is_acknowledged_or_seen_safe(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The end of the program that armed it, in good order or not: nothing controls the shutter from then on."""
    lock = tmp_path / "rig.lock"
    journal = tmp_path / "a.journal"

    def leave() -> RigGuard:
        rig = RigGuard("rig")
        device = rig.device("left-in-a-test", "socket://127.0.0.1:1")
        rig.begin([str(lock)], [])
        rig.journal = str(journal)
        with FileLock(lock):
            device.arm(last_will())
            assert left_unsafe() == []  # its program has the rig
        rig.close()
        return rig

    leave()
    (found,) = left_unsafe()
    assert found.pid == os.getpid()
    assert left_unsafe(journal) == [found]
    assert left_unsafe(tmp_path / "b.journal") == []
    capsys.readouterr()
    assert app(["runs", str(tmp_path)], standalone_mode=False) in (None, 0)  # where its journal is not
    assert f"SAFETY: {found.text}" in capsys.readouterr().err
    acknowledge_left("another order")
    assert left_unsafe() == [found]
    acknowledge_left(found.text)
    assert left_unsafe() == []
    leave()
    later = RigGuard("rig")
    device = later.device("left-in-a-test", "socket://127.0.0.1:1")
    later.begin([], [])
    assert [later.left] == left_unsafe() != []
    device.disarm()
    assert later.left is None
    assert left_unsafe() == []


def test_records_survive_their_line(record: Record) -> None:
    binary = replace(record, order=bytes(range(256)).decode("latin-1"))
    assert decode_all(encode_all([binary, record])) == [binary, record]


def test_a_named_pipe_in_the_place_of_the_events_holds_no_program_up(tmp_path: Path) -> None:
    journal = tmp_path / "a.journal"
    journal.touch()
    pipe = Path(f"{journal}{EVENTS_SUFFIX}")
    os.mkfifo(pipe)
    guardian.note_event(journal, "monochromator: the shutter is closed")
    assert read_events(pipe) == []


def test_events_beside_a_journal_that_are_none_are_left_out(tmp_path: Path) -> None:
    beside = tmp_path / "a.journal.guardian"
    beside.write_bytes(b'{"text": "one"}\n' + b"[" * 50_000 + b'\n{"text": 3}\n\xff\n{"text": "two"}\n')
    assert read_events(beside) == ["one", "two"]
