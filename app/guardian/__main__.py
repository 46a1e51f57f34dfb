"""The guardian's process: `python -m goniotwin.app.guardian`, with a pipe from its parent as standard input.

Each line has all records that are armed. A farewell, or an empty list at the end of the pipe, ends it without a byte on a
wire. At any other end the parent has died: it takes the rig's locks, sends each will and asks, up to ATTEMPTS times, and
writes what came of it. Where another program holds the locks it waits, and leaves the device to that program after LOCK_S: a
session closes at its start what it finds recorded as open.
"""

import contextlib
import json
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from importlib import import_module
from pathlib import Path

import serial

from goniotwin.app.guardian.held import Held, HeldFile, Taken, take_name
from goniotwin.app.guardian.record import BYTES, EVENTS_SUFFIX, FAREWELL, GUARDIAN, Record, decode_all, record_of
from goniotwin.own_files import replace_text
from goniotwin.protocols.clock import RealClock, calendar_stamp

ATTEMPTS = 3
LOCK_S = 10.0
"""Longest time for which it waits for the locks of a rig that another program has."""
OPEN_S = 2.0
"""Longest time for which a port that is busy is tried again, in each attempt."""
REPLY_S = 2.5
"""Longest wait for the expected answer."""
QUIET_S = 0.1
"""A line without a byte for this time has sent all that belongs to what was before the question."""
LONGEST_NOISE_S = 1.0
RETRY_S = 0.02
LONGEST_S = 60.0
"""It ends after this time, whatever hangs: a program that needs the rig waits for it."""
URL_SCHEMES = ("socket", "rfc2217")
"""Those that a rig file can have (`app.rig.addresses`) and pyserial has a module for."""
CHUNK = 256
FAULTS = (serial.SerialException, OSError, ValueError)
CLOCK = RealClock()


def main() -> None:
    """Wait for the end of the parent; carry out the wills where it died."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    records: list[Record] = []
    for line in sys.stdin.buffer:
        if line == FAREWELL:
            records = []
            break
        if line.endswith(b"\n"):  # else its writer died in the middle, before anything that it states
            records = decode_all(line)
            for record in records:
                _load_handler(record.address)
    if records:
        watchdog = threading.Timer(LONGEST_S, os._exit, (1,))
        watchdog.daemon = True
        watchdog.start()
    for record in records:
        with contextlib.suppress(Taken):
            carry_out(record)
    os._exit(0)  # at once: a parent waits for it after its farewell


def _load_handler(address: str) -> None:
    """Load now what pyserial loads at the first use of a URL: after a death nothing is to be imported."""
    scheme, separator, _ = address.lower().partition("://")
    if separator and scheme in URL_SCHEMES:
        import_module(f"serial.urlhandler.protocol_{scheme}")


def carry_out(record: Record) -> None:
    """Take the locks, make the device safe, and write what came of it. Raises Taken where another program has the rig."""
    outcome = _make_safe(record)
    if record.journal and outcome:  # without the locks: a folder on a network may be slow
        note_event(Path(record.journal), f"{record.device}: {outcome}")


def _make_safe(record: Record) -> str:
    """Send the will and write what came of it; return that, or nothing where a later session has had the rig."""
    died = CLOCK.now()
    with _locked(record):
        found = _recorded(record)
        if found is not None and found.pid != record.pid and found.since >= record.since:
            return ""  # a session has had the rig meanwhile
        wrong = ""
        for _ in range(ATTEMPTS):
            try:
                if not (wrong := _send(record)):
                    break
            except FAULTS as error:
                wrong = str(error)
        ms = 1000.0 * (CLOCK.now() - died)
        if wrong:
            outcome = f"the guardian could not make it safe: {wrong}"
        else:
            outcome = f"process {record.pid} died; {record.relief}, {ms:.0f} ms later, by the guardian ({calendar_stamp()})"
        with contextlib.suppress(OSError):  # a full disk: the record is as before, and the next session asks the device
            replace_text(Path(record.path), replace(record, outcome=outcome, done=not wrong).encode())
    return outcome


@contextlib.contextmanager
def _locked(record: Record) -> Iterator[None]:
    """The locks and names of a rig, tried again for LOCK_S. Raises Taken."""
    deadline = CLOCK.now() + LOCK_S
    while True:
        with contextlib.ExitStack() as held:
            try:
                for path in record.locks:
                    if _take(held, partial(HeldFile, path)):
                        held.enter_context(_noted(path, record.pid))
                for name in record.names:
                    _take(held, partial(take_name, name))
            except Taken:
                if CLOCK.now() > deadline:
                    raise
            else:
                yield
                return
        CLOCK.sleep_until(CLOCK.now() + RETRY_S)


def _take(held: contextlib.ExitStack, take: Callable[[], Held | None]) -> bool:
    """Take a lock or a name; False where that cannot be: a removed folder is no reason to leave a device. Raises Taken."""
    try:
        taken = take()
    except Taken:
        raise
    except OSError:
        return False
    if taken is not None:
        held.enter_context(contextlib.closing(taken))
    return True


def _recorded(record: Record) -> Record | None:
    """The record that its file has now; None where there is none."""
    try:
        return record_of(json.loads(Path(record.path).read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, AttributeError):
        return None


@contextlib.contextmanager
def _noted(lock: str, parent: int) -> Iterator[None]:
    """The note of this holder of a lock, for as long as it has it; the one that is there is of a process that died."""
    note = Path(lock).with_suffix(".holder")
    with contextlib.suppress(OSError):
        replace_text(note, f"process {os.getpid()}, the {GUARDIAN} {parent}, which died\n", 0o644)
    yield
    with contextlib.suppress(OSError):
        note.unlink()


def note_event(journal: Path, text: str) -> None:
    """Add an event to the file beside a journal, unless the journal was moved."""
    if journal.exists():
        with contextlib.suppress(OSError):
            flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0)
            handle = os.open(f"{journal}{EVENTS_SUFFIX}", flags, 0o600)  # never waits, as for the reader of a named pipe
            try:
                os.write(handle, (json.dumps({"at": calendar_stamp(), "text": text}) + "\n").encode())
            finally:
                os.close(handle)


def _send(record: Record) -> str:
    """Send the will once, and ask; return what is wrong, empty if the device is safe. Raises FAULTS."""
    ending, order, question = (each.encode(BYTES) for each in (record.ending, record.order, record.question))
    with contextlib.closing(_opened(record)) as port:
        port.write(ending + order)
        over = CLOCK.now() + LONGEST_NOISE_S
        port.timeout = QUIET_S
        while port.read(1) and CLOCK.now() < over:
            port.read(port.in_waiting)
        port.timeout = RETRY_S
        port.write(question)
        received, over = "", CLOCK.now() + REPLY_S
        while CLOCK.now() < over:
            received += port.read(CHUNK).decode(BYTES)
            if re.search(record.safe, received):
                return ""
    return f"asked {record.question.strip()!r}, it answered {received!r}"


def _opened(record: Record) -> serial.Serial:
    """The port, tried again for OPEN_S where it is busy. Raises FAULTS."""
    deadline = CLOCK.now() + OPEN_S
    while True:
        try:
            return serial.serial_for_url(
                record.address, baudrate=record.baudrate, timeout=QUIET_S, write_timeout=REPLY_S, exclusive=True
            )
        except FAULTS:
            if CLOCK.now() > deadline:
                raise
        CLOCK.sleep_until(CLOCK.now() + RETRY_S)


if __name__ == "__main__":
    main()
