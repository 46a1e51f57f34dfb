"""Serial line of a Cornerstone 260: one exchange at a time, and resynchronisation after a failed one.

In step means: the unit has replied to each statement, line for line. A query returns an echo (if the line echoes), the
reply and a status (in handshake mode), no line less and none more. After anything else no reply is accepted until the line
has been drained and two marker queries (`INFO?`, `HANDSHAKE?`) have returned the expected replies.
"""

import contextlib
import threading
from collections import deque

from serial import Serial, SerialException

from goniotwin.drivers.device import PortOpener
from goniotwin.drivers.errors import BadAnswer, Forgotten, NoAnswer, Refused, WrongDevice, unless_late
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.cornerstone import (
    ERROR_SINCE_LAST_READ,
    LINE_ENDED,
    MAX_LINE,
    NO_ERROR,
    STATUS_TEXTS,
    ErrorCode,
    Statement,
    StatementError,
    WavelengthUnit,
    decode_number,
    decode_status,
    take_lines,
)

NAME = "monochromator"
REPLY_S = 1.0
QUIET_S = 0.1
LONGEST_NOISE_S = 1.5
"""Longest time in which a unit may send more than its replies while the line is resynchronised, all in all."""
MOST_READS = 64
"""Reads of MAX_LINE bytes in one go. A line of 9600 Bd sends that much in 17 s."""
EVENTS_KEPT = 100
UNITS = tuple(each.name.encode("ascii") for each in WavelengthUnit)
CHECK_LINE = "check cable and baud rate"
LINE_END = b"\r\n"
"""Ends a partial statement in the unit's buffer."""
SWITCH_ON = f"switch it on, also from standby; {CHECK_LINE}"
SWITCH_OFF_AND_ON = "switch the unit off and on, then connect it again"
REMEDIES = {
    ErrorCode.NOT_UNDERSTOOD: "check that the unit is one of the kind in the rig file",
    ErrorCode.BAD_PARAMETER: "choose a wavelength, a grating and a filter that the unit has",
    ErrorCode.DESTINATION_NOT_ALLOWED: "choose a wavelength that the unit's gratings reach, and a filter that its wheel has",
    ErrorCode.ACCESSORY_NOT_PRESENT: "connect the shutter or filter wheel to the unit, or remove its filters from the rig file",
    ErrorCode.CANNOT_HOME: "switch the unit off and on; if it cannot home again, its drive is blocked",
}
"""What to do about what `ERROR?` reports; about anything else SWITCH_OFF_AND_ON."""


def error_text(number: int) -> str:
    """A number that `ERROR?` answers, in words."""
    return f"error {number}, {ErrorCode(number).in_words() if number in set(ErrorCode) else 'unknown'}"


class CornerstoneLine:
    """The line. `echoes` and `handshake` are detected. `events` are its own actions (resynchronised), newest last."""

    def __init__(self, open_port: PortOpener, baudrate: int, clock: Clock, tap: Tap, found: FoundSettings) -> None:
        self._open_port = open_port
        self._baudrate = baudrate
        self._clock = clock
        self._tap = tap
        self._found = found
        self._lock = threading.RLock()
        self._port: Serial | None = None
        self._connected = False
        self._lines: deque[bytes] = deque()
        self._empty_is_reply = False
        self._no_error_text: bytes | None = None
        self._pending = b""
        self._untapped = b""
        self._late_s = 0.0  # by how much this computer was late, s, since the last statement
        self._noise_left_s = LONGEST_NOISE_S
        self.in_step = False
        self.echoes = False
        self.handshake = False
        self.identity = ""
        self.events: deque[str] = deque(maxlen=EVENTS_KEPT)

    def identify(self) -> str:
        """Open the port and return the unit's identity: `INFO?` is all that is sent, twice if the first is not answered.

        Settings that an earlier session has left changed are restored. Raises DeviceError.
        """
        with self._lock:
            self.close()
            self._connected, self.echoes = True, False
            self._open()
            self._noise_left_s = LONGEST_NOISE_S
            try:
                identity, _ = self._query_identity()
            except (NoAnswer, BadAnswer):  # it was sent behind the bytes of another program
                identity, _ = self._query_identity()
            self._found.take_up(identity)
            self.restore()
            return identity

    def restore(self) -> None:
        """Restore units and handshake mode to what was found, unless they were changed elsewhere since. Raises DeviceError."""
        with self._lock:
            if not self._found.changes:
                return
            if self._port is None:
                raise NoAnswer(NAME, "restore its settings", "the port is not open", "connect it again")
            self._noise_left_s = LONGEST_NOISE_S
            self.in_step = False
            self._drain()
            for word in ("UNITS", "HANDSHAKE"):
                found = self._found.value_to_restore(word, self.setting(word))
                if found is not None:
                    self._query_until_quiet(Statement(word, parameter=found))
                    if (now := self.setting(word)) != found:
                        raise BadAnswer(NAME, f"{word} {found}", f"it is {now}", CHECK_LINE)
            self._found.clear()

    def open(self) -> str:
        """Open the port, identify the unit, detect echo and handshake mode. Nothing moves. Raises DeviceError."""
        with self._lock:
            self.close()
            self.identity, self.handshake, self._connected, self._no_error_text = "", False, True, None
            self._open()
            self._resynchronise()
            return self.identity

    def close(self) -> None:
        """Close the port. Nothing is sent."""
        with self._lock:
            self._connected = False
            self._drop()

    def exchange(self, statement: Statement) -> tuple[bytes, int]:
        """Exchange a statement that moves nothing; return its reply (empty for a command) and status (0 without handshake).

        Raises DeviceError; the line is then out of step.
        """
        with self._lock:
            self.ready()
            self.send(statement)
            try:
                if self.echoes:
                    self.check_echo(statement, self.line(statement))
                reply = self.line(statement) if statement.query else b""
                status = self.status_of(statement, self.line(statement)) if self.handshake else NO_ERROR
                if self._has_surplus:
                    raise BadAnswer(NAME, str(statement), f"more lines than its reply: {list(self._lines)}", CHECK_LINE)
            except BaseException:  # also of a signal: replies may be on their way
                self.in_step = False
                raise
            return reply, status

    def last_error(self) -> str:
        """Reply of `ERROR?`, as text. Raises DeviceError."""
        reply, _ = self.exchange(Statement("ERROR", query=True))
        if not reply:
            return "it reports no error"
        try:
            number = int(decode_number(reply))
        except StatementError as error:
            raise BadAnswer(NAME, "ERROR?", str(error), CHECK_LINE) from None
        return error_text(number)

    def refused(self, statement: Statement, error: str) -> Refused:
        """The error of a statement that the unit has refused, by the text of `last_error`, with what to do."""
        remedy = next((what for code, what in REMEDIES.items() if error == error_text(code)), SWITCH_OFF_AND_ON)
        return Refused(NAME, str(statement), error, remedy)

    def ready(self) -> None:
        """Resynchronise the line unless it is in step. Raises DeviceError, Forgotten if the unit has reset."""
        if not self._connected:
            raise NoAnswer(NAME, "use it", "the port is not open", "connect first")
        if self._port is None:
            self._open()
            self.events.append("port reopened")
        self._notice_surplus()
        if not self.in_step:
            self._resynchronise()

    def ask(self) -> None:
        """Ask for the identity. Settings that were lost are not restored: `ready` finds them. Raises DeviceError."""
        with self._lock:
            if not self._connected:
                raise NoAnswer(NAME, "use it", "the port is not open", "connect first")
            if self._port is None:
                self._open()
            self._notice_surplus()
            in_step, self.in_step = self.in_step, False
            self._noise_left_s = LONGEST_NOISE_S
            if not in_step:
                self._drain()
            self._query_identity()
            self.in_step = in_step

    def send(self, statement: Statement) -> None:
        """Write a statement. Raises NoAnswer if the port fails."""
        self._lines.clear()
        self._late_s = 0.0
        self._empty_is_reply = statement.word == "ERROR"  # without an error; any other empty line is skipped
        self._write(statement.encode(), str(statement))

    def send_now(self, statement: Statement) -> None:
        """Write a statement in the middle of an exchange. Thread-safe; the line is then out of step."""
        self.in_step = False
        if self._port is not None:
            self._write(statement.encode(), str(statement))

    def check_echo(self, statement: Statement, line: bytes) -> None:
        """Raise BadAnswer for a wrong echo."""
        if not statement.echoed_by(line):
            raise BadAnswer(NAME, str(statement), f"the echo is {line!r}", CHECK_LINE)

    def status_of(self, statement: Statement, line: bytes) -> int:
        """Status of a line. Raises BadAnswer if it is not a status, or one of fewer digits than this unit sends."""
        try:
            status = decode_status(line)
            if status == NO_ERROR and self._no_error_text not in (line.strip(), None):
                raise StatementError(f"not the status byte of this unit: {line!r}")
        except StatementError as error:
            raise BadAnswer(NAME, str(statement), str(error), CHECK_LINE) from None
        return status

    def line(self, statement: Statement, seconds: float = REPLY_S) -> bytes:
        """Wait for the next line. Raises NoAnswer."""
        deadline = self._clock.now() + seconds
        over = False
        while not self._lines:
            left = deadline - self._clock.now()
            # A computer that is late reads once more: the reply may have been there in time.
            if over or not self._read(max(left, 0.0), 1):
                silent = unless_late(self._late_s, seconds, f"no line within {seconds:g} s", SWITCH_ON)
                raise NoAnswer(NAME, str(statement), *silent)
            over = left <= 0.0
            self.receive()
        return self._lines.popleft()

    def _notice_surplus(self) -> None:
        """Bytes that nothing has asked for put the line out of step."""
        if self.in_step:
            self.receive()
            self.in_step = not self._has_surplus

    @property
    def _has_surplus(self) -> bool:
        """Whether more was received than the replies so far."""
        return bool(self._lines) or self._pending not in (b"", LINE_ENDED)

    def receive(self) -> deque[bytes]:
        """Lines received so far, without waiting: at most what a unit can send between two calls."""
        for _ in range(MOST_READS):
            if not self._read(0.0, MAX_LINE):
                break
        return self._lines

    # ---- resynchronisation ----

    def _resynchronise(self) -> None:
        """Drain the line, query the markers, restore the settings. Raises DeviceError, Forgotten if these were lost."""
        known_identity, had_handshake = self.identity, self.handshake
        self._noise_left_s = LONGEST_NOISE_S
        self._drain()
        self.echoes = False
        identity, acknowledged = self._query_identity()
        if known_identity and identity != known_identity:
            raise WrongDevice(
                NAME, "identify it", f"{identity} is connected, not {known_identity}", "connect the unit of the rig file"
            )
        handshake, status = self._query_until_quiet(Statement("HANDSHAKE", query=True))
        if acknowledged and handshake is not None and STATUS_TEXTS.get(handshake) == ERROR_SINCE_LAST_READ:
            handshake, status = b"1", ERROR_SINCE_LAST_READ  # a unit without this query refuses it in this mode
        if acknowledged and handshake is None:  # in this mode each statement is acknowledged, also one that is refused
            raise NoAnswer(NAME, "HANDSHAKE?", "not responding", SWITCH_ON)
        if (handshake == b"1" and status is None) or handshake not in (b"0", b"1", None):
            raise BadAnswer(NAME, "HANDSHAKE?", f"{handshake!r} with status {status}", CHECK_LINE)
        lost = had_handshake and handshake != b"1"
        self._found.take_up(identity)
        present = str(int(acknowledged)) if handshake is None else handshake.decode("ascii")
        self._found.note({"HANDSHAKE": (present, "1")})
        if handshake != b"1":
            _, status = self._query_until_quiet(Statement("HANDSHAKE", parameter="1"))
        self.handshake = status is not None
        units, _ = self._query_until_quiet(Statement("UNITS", query=True))
        if units is not None and units.upper() in UNITS:
            self._found.note({"UNITS": (units.upper().decode("ascii"), "NM")})
        if units is not None and units.upper() != b"NM":
            self._query_until_quiet(Statement("UNITS", parameter="NM"))
            lost = lost or bool(known_identity)
        for word in ("STB", "ERROR"):  # they may still report an earlier statement
            if self._query_until_quiet(Statement(word, query=True))[0] is None:
                raise NoAnswer(NAME, f"{word}?", "not responding", SWITCH_ON)
        self.identity, self.in_step = identity, True
        if known_identity:
            self.events.append("line resynchronised" + (", settings were lost" if lost else ""))
        if lost:
            raise Forgotten(
                NAME, "check its settings", "it has reset; its settings are restored", "set wavelength and shutter again"
            )

    def _query_identity(self) -> tuple[str, bool]:
        """The unit's identity, and whether it acknowledges statements: it is in handshake mode. Raises DeviceError."""
        reply, status = self._query_until_quiet(Statement("INFO", query=True))
        if reply is None:
            raise NoAnswer(NAME, "INFO?", "no reply", SWITCH_ON)
        if len(reply) < 3 or not any(chr(each).isalpha() for each in reply):
            raise BadAnswer(NAME, "INFO?", f"{reply!r} is not an identity", CHECK_LINE)
        return reply.decode("ascii", "replace"), status is not None

    def setting(self, word: str) -> str:
        """Present value of a setting, in capitals. Raises DeviceError."""
        reply, _ = self._query_until_quiet(Statement(word, query=True))
        if word == "HANDSHAKE" and (reply is None or STATUS_TEXTS.get(reply) == ERROR_SINCE_LAST_READ):
            return str(int(self._query_identity()[1]))  # a unit without this query
        if reply is None:
            raise NoAnswer(NAME, f"{word}?", "not responding", SWITCH_ON)
        return reply.decode("ascii", "replace").upper()

    def _query_until_quiet(self, statement: Statement) -> tuple[bytes | None, int | None]:
        """Send a statement and receive lines until the line is quiet; return reply and status, None for a missing one."""
        self.send(statement)
        lines: list[bytes] = []
        try:
            lines.append(self.line(statement))
        except NoAnswer:
            # A command has no reply without echo and handshake mode, and a unit may not support this mode.
            if (statement.query and statement.word != "HANDSHAKE") or self._port is None:
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
            status = self._learn_status(lines.pop().strip())
        if not statement.query or not lines:
            return None, status
        return lines[-1].strip(), status

    def _learn_status(self, text: bytes) -> int:
        """A status of this unit; without an error units write it with one digit or two."""
        if STATUS_TEXTS[text] == NO_ERROR:
            self._no_error_text = text
        return STATUS_TEXTS[text]

    def _drain(self) -> None:
        """End a partial statement in the unit's buffer, and discard everything until the line is quiet."""
        statement = Statement("INFO", query=True)
        self._write(LINE_END, "drain the line")
        self._until_quiet(statement)
        self._lines.clear()
        self._pending = b""

    def _until_quiet(self, statement: Statement) -> list[bytes]:
        """Lines received until QUIET_S without a byte. Raises BadAnswer if the unit does not stop sending."""
        started, over = self._clock.now(), False
        while self._read(QUIET_S, 1):
            if over:
                raise BadAnswer(NAME, str(statement), "it does not stop sending", CHECK_LINE)
            # Before the rest is read: a computer that is late finds all of the reply in one go, and nothing after it.
            over = self._clock.now() - started > self._noise_left_s
            self.receive()
        self._noise_left_s -= max(0.0, self._clock.now() - started - QUIET_S)
        lines = list(self._lines)
        self._lines.clear()
        return lines

    # ---- the port ----

    def _open(self) -> None:
        self._lines.clear()
        self._pending = b""
        self.in_step = False
        try:
            self._port = self._open_port(self._baudrate, REPLY_S)
        except (SerialException, OSError, ValueError) as error:
            raise NoAnswer(NAME, "open the port", str(error), "check the port in the rig file") from None

    def _drop(self) -> None:
        self._tap(FROM_DEVICE, self._untapped)  # the transcript shows incomplete lines too
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
        started = self._clock.now()
        try:
            self._port.timeout = timeout_s
            data = self._port.read(size)
        except (SerialException, OSError) as error:
            self._drop()
            raise NoAnswer(NAME, "read", f"the port failed: {error}", "check cable and power") from None
        self._late_s = max(self._late_s, self._clock.now() - started - timeout_s)
        lines, self._pending = take_lines(self._pending, data)
        self._lines.extend(line for line in lines if line or self._empty_is_reply)
        self._untapped += data
        end = max(self._untapped.rfind(b"\r"), self._untapped.rfind(b"\n")) + 1
        self._tap(FROM_DEVICE, self._untapped[:end])
        self._untapped = self._untapped[end:][-MAX_LINE:]
        return bytes(data)
