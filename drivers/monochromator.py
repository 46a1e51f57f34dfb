"""An Oriel Cornerstone 260: wavelength, shutter, filter wheel.

The unit answers only when it has arrived, so it is told and asked later. Handshake mode says when a statement is done;
whether the line echoes is found out at connect.
"""

from dataclasses import dataclass

from serial import Serial, SerialException

from drivers.errors import BadAnswer, DeviceError, NoAnswer, Refused
from drivers.pending import Pending, Poll
from drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from drivers.tmcl import PortOpener
from protocols.clock import Clock
from protocols.cornerstone import (
    NO_ERROR,
    Error,
    Statement,
    StatementError,
    decode_number,
    decode_status,
    encode_nm,
)

NAME = "monochromator"
POLL_S = 0.02
ANSWER_S = 1.0
LONGEST_S = 60.0
STATUS_MARGIN_S = 3.0e-3


@dataclass(frozen=True)
class MonochromatorSettings:
    """What the operator believes of the monochromator."""

    baudrate: int = 9600
    lowest_nm: float = 380.0
    highest_nm: float = 780.0
    slew_nm_per_s: float = 175.0
    slew_settle_s: float = 0.1
    shutter_s: float = 0.15

    def slew_seconds(self, way_nm: float) -> float:
        """How long a change of wavelength takes."""
        return abs(way_nm) / self.slew_nm_per_s + self.slew_settle_s if way_nm else 0.0

    def statement_seconds(self, text: str) -> float:
        """How long a statement, its echo and the status after it are on the wire."""
        return 10.0 * (2 * len(text) + len("\n\r\n00\r\n")) / self.baudrate


class Monochromator:
    """The device on its serial line."""

    def __init__(self, open_port: PortOpener, settings: MonochromatorSettings, clock: Clock, tap: Tap = no_tap) -> None:
        self._open_port = open_port
        self._clock = clock
        self._tap = tap
        self.settings = settings
        self._port: Serial | None = None
        self._received = b""
        self._untapped = b""
        self._echoes = False
        self._wavelength_nm: float | None = None

    def connect(self) -> str:
        """Opens the port, finds out about the echo, switches handshake mode on; returns who answers. Nothing moves.

        Raises DeviceError.
        """
        self.close()
        try:
            self._port = self._open_port(self.settings.baudrate, ANSWER_S)
        except (SerialException, OSError, ValueError) as error:
            raise DeviceError(NAME, "open the port", str(error), "check the port in the rig file") from None
        statement = Statement("HANDSHAKE", parameter="1")
        self._send(statement)
        first = self._line(statement)
        self._echoes = first.strip().upper() == str(statement).encode().upper()
        self._expect_success(statement, self._line(statement) if self._echoes else first)
        identity = self._ask("INFO").decode("ascii", "replace")
        self._wavelength_nm = self.wavelength_nm()
        return identity

    def close(self) -> None:
        """Gives the port back. Nothing is sent."""
        self._tap_rest()
        if self._port is not None:
            self._port.close()
            self._port = None
        self._received = b""

    def wavelength_nm(self) -> float:
        """Asks where the grating is. Raises DeviceError."""
        return self._ask_number("WAVE")

    def shutter_is_open(self) -> bool:
        """Asks the shutter. Raises DeviceError."""
        answer = self._ask("SHUTTER").strip().upper()
        if answer not in (b"O", b"C"):
            raise BadAnswer(NAME, "SHUTTER?", f"{answer!r} is neither O nor C")
        return answer == b"O"

    def start_wavelength(self, wavelength_nm: float) -> Pending:
        """Sends the grating to a wavelength. Raises DeviceError, before anything is sent where it is out of range."""
        lowest, highest = self.settings.lowest_nm, self.settings.highest_nm
        if not lowest <= wavelength_nm <= highest:
            raise DeviceError(
                NAME, f"go to {wavelength_nm:g} nm", f"outside {lowest:g} to {highest:g} nm", "change the schedule"
            )
        known = self._wavelength_nm
        way = highest - lowest if known is None else wavelength_nm - known
        pending = self._start(Statement("GOWAVE", parameter=encode_nm(wavelength_nm)), self.settings.slew_seconds(way))
        self._wavelength_nm = wavelength_nm
        return pending

    def start_shutter(self, *, opened: bool) -> Pending:
        """Opens or closes the shutter. Raises DeviceError."""
        return self._start(Statement("SHUTTER", parameter="O" if opened else "C"), self.settings.shutter_s)

    def start_filter(self, position: int) -> Pending:
        """Turns the filter wheel. Raises DeviceError."""
        return self._start(Statement("FILTER", parameter=str(position)), 0.0)

    def _start(self, statement: Statement, seconds: float) -> Pending:
        self._send(statement)
        begun = self._clock.now()
        waiting = [self._echoes]

        def done() -> bool:
            line = self._poll_line()
            if line is not None and waiting[0]:
                waiting[0] = False
                if line.strip().upper() != str(statement).encode().upper():
                    raise BadAnswer(NAME, str(statement), f"the echo is {line!r}", "check cable and baud rate")
                line = self._poll_line()
            if line is not None:
                self._expect_success(statement, line)
                return True
            if self._clock.now() > begun + seconds + LONGEST_S:
                raise NoAnswer(NAME, str(statement), f"not done after {LONGEST_S + seconds:g} s", "check the unit")
            return False

        due = begun + seconds + self.settings.statement_seconds(str(statement)) + STATUS_MARGIN_S
        return Poll(self._clock, due, POLL_S, done)

    def _ask(self, word: str) -> bytes:
        """One query and its answer; the status after it must say that all is well."""
        statement = Statement(word, query=True)
        self._send(statement)
        line = self._line(statement)
        if self._echoes:
            line = self._line(statement)
        self._expect_success(statement, self._line(statement))
        return line

    def _ask_number(self, word: str) -> float:
        answer = self._ask(word)
        try:
            return decode_number(answer)
        except StatementError as error:
            raise BadAnswer(NAME, f"{word}?", str(error), "check cable and baud rate") from None

    def _send(self, statement: Statement) -> None:
        if self._port is None:
            raise NoAnswer(NAME, str(statement), "the port is not open", "connect first")
        self._read(0.0, 256)
        self._tap_rest()
        self._received = b""
        self._tap(TO_DEVICE, statement.encode())
        try:
            self._port.write(statement.encode())
        except (SerialException, OSError) as error:
            raise NoAnswer(NAME, str(statement), f"the port failed: {error}", "check cable and power") from None

    def _expect_success(self, statement: Statement, line: bytes) -> None:
        try:
            status = decode_status(line)
        except StatementError as error:
            raise BadAnswer(NAME, str(statement), str(error), "check cable and baud rate") from None
        if status != NO_ERROR and str(statement) != "ERROR?":
            number = int(self._ask_number("ERROR"))
            words = Error(number).in_words() if number in set(Error) else "unknown"
            raise Refused(NAME, str(statement), f"error {number}, {words}")

    def _line(self, statement: Statement) -> bytes:
        """The next line, within the time in which the unit answers when it does not move."""
        deadline = self._clock.now() + ANSWER_S
        while b"\n" not in self._received:
            left = deadline - self._clock.now()
            chunk = self._read(left, 1) if left > 0 else b""
            if not chunk:
                raise NoAnswer(NAME, str(statement), f"no line within {ANSWER_S:g} s", "check cable and baud rate")
            self._received += chunk + self._read(0.0, 256)
        line, _, self._received = self._received.partition(b"\n")
        return line.rstrip(b"\r")

    def _poll_line(self) -> bytes | None:
        """A line if a whole one is there."""
        self._received += self._read(0.0, 256)
        if b"\n" not in self._received:
            return None
        line, _, self._received = self._received.partition(b"\n")
        return line.rstrip(b"\r")

    def _read(self, timeout_s: float, size: int) -> bytes:
        assert self._port is not None
        try:
            self._port.timeout = timeout_s
            data = self._port.read(size)
        except (SerialException, OSError) as error:
            raise NoAnswer(NAME, "read", f"the port failed: {error}", "check cable and power") from None
        self._untapped += data
        while b"\n" in self._untapped:
            line, end, self._untapped = self._untapped.partition(b"\n")
            self._tap(FROM_DEVICE, line + end)
        return data

    def _tap_rest(self) -> None:
        """A line that was cut off belongs into the transcript too."""
        self._tap(FROM_DEVICE, self._untapped)
        self._untapped = b""
