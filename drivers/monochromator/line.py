"""The serial line to a Cornerstone 260: one exchange at a time, and back into step after one that failed.

In step means: what the unit has been sent it has answered, line for line. A question is echo (where the line echoes),
answer, status (in handshake mode), no line less and none more. After anything else nothing is believed until the line has
been drained and two marker questions (`INFO?`, `HANDSHAKE?`) have been answered as expected.
"""

import contextlib
import threading
from collections import deque

from serial import Serial, SerialException

from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, NoAnswer
from goniotwin.drivers.motion.tmcl.module import PortOpener
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import (
    MAX_LINE,
    NO_ERROR,
    STATUS_TEXTS,
    Error,
    Statement,
    StatementError,
    decode_known_status,
    decode_number,
    take_lines,
)

NAME = "monochromator"
ANSWER_S = 1.0
QUIET_S = 0.1
LONGEST_TALK_S = 3.0
SAID_KEPT = 100
CHECK_LINE = "check cable and baud rate"


class CornerstoneWire:
    """The line. `echoes` and `handshake` are found out; `said` is what it did of its own accord, newest last."""

    def __init__(self, open_port: PortOpener, baudrate: int, clock: Clock, tap: Tap) -> None:
        self._open_port = open_port
        self._baudrate = baudrate
        self._clock = clock
        self._tap = tap
        self._lock = threading.RLock()
        self._port: Serial | None = None
        self._wanted = False
        self._lines: deque[bytes] = deque()
        self._pending = b""
        self._untapped = b""
        self.in_step = False
        self.echoes = False
        self.handshake = False
        self.identity = ""
        self.said: deque[str] = deque(maxlen=SAID_KEPT)

    def open(self) -> str:
        """Opens the port and finds out who answers and how. Nothing moves. Raises DeviceError."""
        with self._lock:
            self.close()
            self.identity, self.handshake, self._wanted = "", False, True
            self._open()
            self._find_step()
            return self.identity

    def close(self) -> None:
        """Gives the port back. Nothing is sent."""
        with self._lock:
            self._wanted = False
            self._drop()

    def exchange(self, statement: Statement) -> tuple[bytes, int]:
        """One statement that moves nothing: its answer (empty for a command) and its status, 0 without handshake mode.

        Raises DeviceError; from then on the line is out of step.
        """
        with self._lock:
            self.ready()
            self.send(statement)
            try:
                if self.echoes:
                    self.check_echo(statement, self.line(statement))
                answer = self.line(statement) if statement.query else b""
                status = self.status_of(statement, self.line(statement)) if self.handshake else NO_ERROR
                if self._lines or self._pending:
                    raise BadAnswer(NAME, str(statement), f"more than its answer: {list(self._lines)}", CHECK_LINE)
            except DeviceError:
                self.in_step = False
                raise
            return answer, status

    def last_error(self) -> str:
        """What `ERROR?` says, in words. Raises DeviceError."""
        answer, _ = self.exchange(Statement("ERROR", query=True))
        try:
            number = int(decode_number(answer))
        except StatementError as error:
            raise BadAnswer(NAME, "ERROR?", str(error), CHECK_LINE) from None
        return f"error {number}, {Error(number).in_words() if number in set(Error) else 'unknown'}"

    def ready(self) -> None:
        """The line is in step, or brought into step. Raises DeviceError; Forgotten where the unit has reset itself."""
        if not self._wanted:
            raise NoAnswer(NAME, "ask it", "the port is not open", "connect first")
        if self._port is None:
            self._open()
            self.said.append("the port has been opened again")
        if self.in_step:
            self.listen()
            if self._lines or self._pending:
                self.in_step = False
        if not self.in_step:
            self._find_step()

    def send(self, statement: Statement) -> None:
        """Writes a statement. Raises NoAnswer where the port fails."""
        self._lines.clear()
        self._write(statement.encode(), str(statement))

    def send_now(self, statement: Statement) -> None:
        """Writes a statement into whatever goes on, from any thread; the line is out of step then."""
        self.in_step = False
        if self._port is not None:
            self._write(statement.encode(), str(statement))

    def check_echo(self, statement: Statement, line: bytes) -> None:
        """Raises BadAnswer for another echo."""
        if not statement.echoed_by(line):
            raise BadAnswer(NAME, str(statement), f"the echo is {line!r}", CHECK_LINE)

    def status_of(self, statement: Statement, line: bytes) -> int:
        """Raises BadAnswer for what is none."""
        try:
            return decode_known_status(line)
        except StatementError as error:
            raise BadAnswer(NAME, str(statement), str(error), CHECK_LINE) from None

    def line(self, statement: Statement, seconds: float = ANSWER_S) -> bytes:
        """The next line, waited for. Raises NoAnswer."""
        deadline = self._clock.now() + seconds
        while not self._lines:
            left = deadline - self._clock.now()
            if left <= 0.0 or not self._read(left, 1):
                raise NoAnswer(NAME, str(statement), f"no line within {seconds:g} s", CHECK_LINE)
            self.listen()
        return self._lines.popleft()

    def listen(self) -> deque[bytes]:
        """The lines that are there, without waiting."""
        while self._read(0.0, MAX_LINE):
            pass
        return self._lines

    # ---- into step ----

    def _find_step(self) -> None:
        """Drains, asks the markers, restores the settings. Raises DeviceError; Forgotten where they were lost."""
        known, shook = self.identity, self.handshake
        self._drain()
        self.echoes = False
        answer, _ = self._talk(Statement("INFO", query=True))
        if answer is None or len(answer) < 3 or not any(chr(each).isalpha() for each in answer):
            raise BadAnswer(NAME, "INFO?", f"{answer!r} is no identity", CHECK_LINE)
        identity = answer.decode("ascii", "replace")
        if known and identity != known:
            raise BadAnswer(NAME, "INFO?", f"{identity} answers, not {known}", "connect the unit of the rig file")
        shakes, status = self._talk(Statement("HANDSHAKE", query=True))
        if (shakes == b"1" and status is None) or shakes not in (b"0", b"1", None):
            raise BadAnswer(NAME, "HANDSHAKE?", f"{shakes!r} with status {status}", CHECK_LINE)
        lost = shook and shakes != b"1"
        if shakes != b"1":
            _, status = self._talk(Statement("HANDSHAKE", parameter="1"))
        self.handshake = status is not None
        units, _ = self._talk(Statement("UNITS", query=True))
        if units is not None and units.upper() != b"NM":
            self._talk(Statement("UNITS", parameter="NM"))
            lost = lost or bool(known)
        for word in ("STB", "ERROR"):  # what they still say is of statements that are past
            if self._talk(Statement(word, query=True))[0] is None:
                raise NoAnswer(NAME, f"{word}?", "no answer", CHECK_LINE)
        self.identity, self.in_step = identity, True
        if known:
            self.said.append("the line is in step again" + (", and the unit had lost its settings" if lost else ""))
        if lost:
            raise Forgotten(
                NAME, "ask it", "it has reset itself; its settings are restored", "wavelength and shutter have to be set again"
            )

    def _talk(self, statement: Statement) -> tuple[bytes | None, int | None]:
        """Sends a statement and takes every line until it is quiet; the answer and the status, where there are any."""
        self.send(statement)
        lines: list[bytes] = []
        try:
            lines.append(self.line(statement))
        except NoAnswer:
            if statement.word != "HANDSHAKE" or self._port is None:  # only of that mode a unit may know nothing
                raise
        lines += self._until_quiet(statement)
        echoes = [index for index, line in enumerate(lines) if statement.echoed_by(line)]
        if echoes:
            self.echoes = True
            lines = lines[echoes[-1] + 1 :]
        elif self.echoes:
            raise BadAnswer(NAME, str(statement), f"no echo in {lines}", CHECK_LINE)
        status = None
        if lines and lines[-1].strip() in STATUS_TEXTS and len(lines) > statement.query:
            status = STATUS_TEXTS[lines.pop().strip()]
        if not statement.query or not lines:
            return None, status
        return lines[-1].strip(), status

    def _drain(self) -> None:
        """Ends what the unit may have of a line, and waits until nothing comes any more."""
        statement = Statement("INFO", query=True)
        self._write(b"\n", "drain the line")
        self._until_quiet(statement)
        self._lines.clear()
        self._pending = b""

    def _until_quiet(self, statement: Statement) -> list[bytes]:
        """The lines that come until QUIET_S without any byte. Raises BadAnswer where it does not end."""
        deadline = self._clock.now() + LONGEST_TALK_S
        while self._read(QUIET_S, 1):
            self.listen()
            if self._clock.now() > deadline:
                raise BadAnswer(NAME, str(statement), "it does not stop sending", CHECK_LINE)
        lines = list(self._lines)
        self._lines.clear()
        return lines

    # ---- the port ----

    def _open(self) -> None:
        self._lines.clear()
        self._pending = b""
        self.in_step = False
        try:
            self._port = self._open_port(self._baudrate, ANSWER_S)
        except (SerialException, OSError, ValueError) as error:
            raise NoAnswer(NAME, "open the port", str(error), "check the port in the rig file") from None

    def _drop(self) -> None:
        self._tap(FROM_DEVICE, self._untapped)  # a line that was cut off belongs into the transcript too
        self._untapped = b""
        self.in_step = False
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(SerialException, OSError):
                port.close()

    def _write(self, data: bytes, doing: str) -> None:
        if self._port is None:
            raise NoAnswer(NAME, doing, "the port is not open", "connect first")
        self._tap(TO_DEVICE, data)
        try:
            self._port.write(data)
        except (SerialException, OSError) as error:
            self._drop()
            raise NoAnswer(NAME, doing, f"the port failed: {error}", "check cable and power") from None

    def _read(self, timeout_s: float, size: int) -> bytes:
        if self._port is None:
            raise NoAnswer(NAME, "read", "the port is not open", "check cable and power")
        try:
            self._port.timeout = timeout_s
            data = self._port.read(size)
        except (SerialException, OSError) as error:
            self._drop()
            raise NoAnswer(NAME, "read", f"the port failed: {error}", "check cable and power") from None
        lines, self._pending = take_lines(self._pending, data)
        self._lines.extend(lines)
        self._untapped += data
        end = max(self._untapped.rfind(b"\r"), self._untapped.rfind(b"\n")) + 1
        self._tap(FROM_DEVICE, self._untapped[:end])
        self._untapped = self._untapped[end:][-MAX_LINE:]
        return bytes(data)
