"""An Oriel Cornerstone 260: grating drive, shutter and filter wheel behind lines of ASCII.

While it moves it hears but does not answer, as the classic unit does; echo and handshake mode as on RS232.
"""

from collections import deque

from protocols.cornerstone import (
    ERROR_SINCE_LAST_READ,
    FROM_DEVICE,
    MAX_LINE,
    NO_ERROR,
    Error,
    Statement,
    StatementError,
    encode_nm,
    encode_status,
)
from twin.plant import Plant

IDENTITY = "Cornerstone 260 virtual"
LATENCY_S = 2.0e-3
LINES_PER_MM = {1: 1200, 2: 600}
HIGHEST_NM_OF_1200 = 1400.0
FILTERS = 6


class Refused(Exception):
    """A statement that the device does not carry out, with the error that it then reports."""

    def __init__(self, error: Error) -> None:
        super().__init__(error.name)
        self.error = error


class Cornerstone260:
    """The device's firmware on one serial line."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._drive = plant.model.monochromator
        self.baudrate = self._drive.baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._line = bytearray()
        self._busy_until = 0.0
        self._handshake = False
        self._status = NO_ERROR
        self._error = Error.NONE
        self._grating = 1
        self._filter = 1

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`."""
        if self._drive.echo:
            self.outbox.append((max(t, self._busy_until), data.replace(b"\n", FROM_DEVICE)))
        for byte in data:
            if byte in b"\r\n":
                line, self._line = bytes(self._line), bytearray()
                if line.strip():
                    self._perform(line, max(t, self._busy_until) + LATENCY_S)
            elif len(self._line) < MAX_LINE:
                self._line.append(byte)

    def _perform(self, line: bytes, t: float) -> None:
        answer: str | None = None
        done = t
        try:
            statement = Statement.decode(line)
            if statement.query:
                answer = self._ask(statement, t)
            else:
                done = self._command(statement, t)
        except StatementError:
            self._fail(Error.NOT_UNDERSTOOD)
        except Refused as refused:
            self._fail(refused.error)
        if answer is not None:
            self.outbox.append((t, answer.encode("ascii") + FROM_DEVICE))
        self._busy_until = done
        if self._handshake:
            self.outbox.append((done, encode_status(self._status)))
            self._status = NO_ERROR  # sent is read

    def _fail(self, error: Error) -> None:
        self._error = error
        self._status = ERROR_SINCE_LAST_READ

    def _ask(self, statement: Statement, t: float) -> str:
        match statement.word:
            case "WAVE":
                return encode_nm(self._plant.wavelength_nm.at(t))
            case "SHUTTER":
                return "O" if self._plant.shutter_open.at(t) else "C"
            case "FILTER":
                return str(self._filter)
            case "GRAT":
                return f"{self._grating},{LINES_PER_MM[self._grating]},VIS"
            case "UNITS":
                return "NM"
            case "HANDSHAKE":
                return str(int(self._handshake))
            case "INFO":
                return IDENTITY
            case "STB":
                status, self._status = self._status, NO_ERROR
                return f"{status:02X}" if self._handshake else f"{status:02d}"
            case "ERROR":
                error, self._error = self._error, Error.NONE
                return str(int(error))
        raise Refused(Error.NOT_UNDERSTOOD)

    def _command(self, statement: Statement, t: float) -> float:
        """Does it; returns when it will be done."""
        match statement.word:
            case "GOWAVE":
                return self._go_wave(_number(statement.parameter), t)
            case "SHUTTER":
                if statement.parameter.upper() not in ("O", "C"):
                    raise Refused(Error.BAD_PARAMETER)
                done = t + self._drive.shutter_s
                self._plant.shutter_open.set(done, statement.parameter.upper() == "O")
                return done
            case "FILTER":
                return self._go_filter(_integer(statement.parameter), t)
            case "GRAT":
                if _integer(statement.parameter) not in LINES_PER_MM:
                    raise Refused(Error.DESTINATION_NOT_ALLOWED)
                self._grating = _integer(statement.parameter)
                return t
            case "HANDSHAKE":
                if statement.parameter not in ("0", "1"):
                    raise Refused(Error.BAD_PARAMETER)
                self._handshake = statement.parameter == "1"
                return t
            case "ABORT":
                return t
        raise Refused(Error.NOT_UNDERSTOOD)

    def _go_wave(self, wavelength_nm: float, t: float) -> float:
        highest = HIGHEST_NM_OF_1200 * 1200 / LINES_PER_MM[self._grating]
        if not 0.0 <= wavelength_nm <= highest:
            raise Refused(Error.DESTINATION_NOT_ALLOWED)
        way = abs(wavelength_nm - self._plant.wavelength_nm.at(t))
        done = t + (way / self._drive.slew_nm_per_s + self._drive.settle_s if way else 0.0)
        self._plant.wavelength_nm.set(done, wavelength_nm)
        return done

    def _go_filter(self, position: int, t: float) -> float:
        if not 1 <= position <= FILTERS:
            raise Refused(Error.DESTINATION_NOT_ALLOWED)
        turns = abs(position - self._filter)
        self._filter = position
        return t + turns * self._drive.filter_s


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise Refused(Error.BAD_PARAMETER) from None


def _integer(text: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise Refused(Error.BAD_PARAMETER) from None
