"""A Thorlabs PM100D with a photodiode: SCPI messages in, answers out, each answer with the time at which it is ready."""

import math
from collections import deque
from collections.abc import Callable

from protocols.scpi import MAX_MESSAGE, OVERRANGE, ScpiError, Unit, encode_error, encode_number, parse, spellings
from twin.plant import Plant

FIRMWARE = "2.8.0"
THINKING_S = 5.0e-4
RANGES_A = (50e-9, 500e-9, 5e-6, 50e-6, 500e-6, 5e-3)
WAVELENGTHS_NM = (400.0, 1100.0)
ERRORS_KEPT = 10
MAX_AVERAGES = 10_000


class Pm100d:
    """The instrument behind its USB interface: one input, one output queue, an error queue, a status byte."""

    def __init__(self, plant: Plant) -> None:
        self._plant = plant
        self._monitor = plant.model.monitor
        self.serial_number = self._monitor.serial_number
        self._errors: deque[tuple[int, str]] = deque()
        self._events = 0
        self._now = 0.0
        self._commands = self._make_commands()
        self._reset()

    def _reset(self) -> None:
        self._range_a = RANGES_A[-1]
        self._auto = True
        self._averages = 1
        self._wavelength_nm = 635.0
        self._measured: tuple[float, float] | None = None  # value, when it is ready

    def execute(self, message: bytes, t: float) -> list[tuple[float, bytes]]:
        """Carries out a whole program message that arrived at `t`; the answers of its queries, when each is ready.

        The answers of one message are one response, joined by `;`.
        """
        self._now = t + THINKING_S
        answers: list[bytes] = []
        try:
            if len(message) > MAX_MESSAGE:
                raise ScpiError(-223, "Too much data")
            for unit in parse(message):
                answer = self._perform(unit)
                if answer is not None:
                    answers.append(answer)
        except ScpiError as error:
            self.report(error.code, error.text)
        return [(self._now, b";".join(answers) + b"\n")] if answers else []

    def report(self, code: int, text: str) -> None:
        """Puts an error into the queue; the last place of a full queue says that it overflowed."""
        if len(self._errors) >= ERRORS_KEPT:
            self._errors[-1] = (-350, "Queue overflow")
        else:
            self._errors.append((code, text))
        self._events |= 0x20 if -200 < code <= -100 else 0x04 if code <= -400 else 0x10

    def _perform(self, unit: Unit) -> bytes | None:
        for pattern, query, action in self._commands:
            if query == unit.query and unit.header in spellings(pattern):
                return action(unit)
        raise ScpiError(-113, "Undefined header")

    def _make_commands(self) -> list[tuple[str, bool, Callable[[Unit], bytes | None]]]:
        return [
            ("*IDN", True, lambda _: f"Thorlabs,PM100D,{self.serial_number},{FIRMWARE}".encode()),
            ("*RST", False, lambda _: self._reset()),
            ("*CLS", False, lambda _: self._clear_status()),
            ("*OPC", True, lambda _: b"1"),
            ("*TST", True, lambda _: b"0"),
            ("*ESR", True, lambda _: self._read_events()),
            ("*STB", True, lambda _: str(self.status_byte()).encode()),
            ("SYSTem:ERRor[:NEXT]", True, lambda _: self._next_error()),
            ("SYSTem:SENSor:IDN", True, lambda _: b"S120VC,TWIN,virtual photodiode,1,1,33"),
            ("SYSTem:VERSion", True, lambda _: b"1999.0"),
            ("CONFigure[:SCALar]:CURRent[:DC]", False, lambda _: None),
            ("CONFigure", True, lambda _: b"CURR"),
            ("MEASure[:SCALar]:CURRent[:DC]", True, lambda _: self._read()),
            ("READ", True, lambda _: self._read()),
            ("INITiate[:IMMediate]", False, lambda _: self._initiate()),
            ("FETCh", True, lambda _: self._fetch()),
            ("ABORt", False, lambda _: self._abort()),
            ("[SENSe]:AVERage[:COUNt]", False, self._set_averages),
            ("[SENSe]:AVERage[:COUNt]", True, lambda _: str(self._averages).encode()),
            ("[SENSe]:CURRent[:DC]:RANGe[:UPPer]", False, self._set_range),
            ("[SENSe]:CURRent[:DC]:RANGe[:UPPer]", True, self._ask_range),
            ("[SENSe]:CURRent[:DC]:RANGe:AUTO", False, self._set_auto),
            ("[SENSe]:CURRent[:DC]:RANGe:AUTO", True, lambda _: b"1" if self._auto else b"0"),
            ("[SENSe]:CORRection:WAVelength", False, self._set_wavelength),
            ("[SENSe]:CORRection:WAVelength", True, self._ask_wavelength),
        ]

    def _initiate(self) -> None:
        """Averages from now on; the value is there when the averaging is over."""
        end = self._now + self._averages / self._monitor.samples_per_s
        current = self._plant.monitor_a(self._now, end)
        if self._auto:
            self._range_a = next((upper for upper in RANGES_A if current <= upper), RANGES_A[-1])
        self._measured = (current if current <= 1.05 * self._range_a else OVERRANGE, end)

    def _fetch(self) -> bytes:
        if self._measured is None:
            raise ScpiError(-230, "Data corrupt or stale")
        value, ready = self._measured
        self._now = max(self._now, ready)
        return encode_number(value)

    def _read(self) -> bytes:
        self._initiate()
        return self._fetch()

    def _abort(self) -> None:
        self._measured = None

    def _clear_status(self) -> None:
        self._errors.clear()
        self._events = 0

    def _read_events(self) -> bytes:
        events, self._events = self._events, 0
        return str(events).encode()

    def status_byte(self) -> int:
        """IEEE 488.2: bit 2 the error queue, bit 5 the event register (MAV is the interface's)."""
        return (0x04 if self._errors else 0) | (0x20 if self._events else 0)

    def _next_error(self) -> bytes:
        return encode_error(*(self._errors.popleft() if self._errors else (0, "No error")))

    def _set_averages(self, unit: Unit) -> None:
        self._averages = round(_argument(unit, 1, MAX_AVERAGES))

    def _set_range(self, unit: Unit) -> None:
        wanted = _argument(unit, RANGES_A[0], RANGES_A[-1])
        self._range_a = next(upper for upper in RANGES_A if wanted <= upper)
        self._auto = False

    def _ask_range(self, unit: Unit) -> bytes:
        return encode_number(_limit(unit, RANGES_A[0], RANGES_A[-1], self._range_a))

    def _set_auto(self, unit: Unit) -> None:
        words = {"0": False, "OFF": False, "1": True, "ON": True}
        if len(unit.parameters) != 1 or unit.parameters[0].upper() not in words:
            raise ScpiError(-224, "Illegal parameter value")
        self._auto = words[unit.parameters[0].upper()]

    def _set_wavelength(self, unit: Unit) -> None:
        self._wavelength_nm = _argument(unit, *WAVELENGTHS_NM)

    def _ask_wavelength(self, unit: Unit) -> bytes:
        return encode_number(_limit(unit, *WAVELENGTHS_NM, self._wavelength_nm))


def _argument(unit: Unit, lowest: float, highest: float) -> float:
    """The one number of a command, or MIN or MAX. Raises ScpiError."""
    if not unit.parameters:
        raise ScpiError(-109, "Missing parameter")
    if len(unit.parameters) > 1:
        raise ScpiError(-108, "Parameter not allowed")
    named = {"MIN": lowest, "MINIMUM": lowest, "MAX": highest, "MAXIMUM": highest}
    text = unit.parameters[0].upper()
    if text in named:
        return named[text]
    try:
        value = float(text)
    except ValueError:
        raise ScpiError(-104, "Data type error") from None
    if math.isnan(value) or not lowest <= value <= highest:
        raise ScpiError(-222, "Data out of range")
    return value


def _limit(unit: Unit, lowest: float, highest: float, now: float) -> float:
    """What a query asks for: the present value, or with MIN or MAX a limit."""
    return _argument(unit, lowest, highest) if unit.parameters else now
