"""Statements of the Cornerstone 260: from state and time to new state, answer and duration.

The state: gratings with their calibration, labels, slits, units, status and error.
"""

import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace

from goniotwin.protocols.cornerstone import (
    MAX_LABEL,
    NO_ERROR,
    ErrorCode,
    Grating,
    Statement,
    StatementError,
    WavelengthUnit,
    decode_number,
    encode_status,
)
from goniotwin.twin.plant import MonochromatorDrive, Plant

SLITS = 3


@dataclass(frozen=True)
class GratingData:
    """A grating's calibration: the wavelength shown is that of its steps times `factor` plus `zero_nm` plus `offset_nm`.

    CALIBRATE changes the offset, as the commands of the Cornerstone 130 do. The unit of the zero is assumed.
    """

    lines_per_mm: int
    label: str
    zero_nm: float = 0.0
    factor: float = 1.0
    offset_nm: float = 0.0

    def shown_nm(self, true_nm: float) -> float:
        """Wavelength shown by the unit, nm."""
        return true_nm * self.factor + self.zero_nm + self.offset_nm

    def true_nm(self, shown_nm: float) -> float:
        """True wavelength for a shown one, nm."""
        return (shown_nm - self.zero_nm - self.offset_nm) / self.factor


@dataclass(frozen=True)
class UnitState:
    """State of the unit. Immutable, so that an ABORT can restore an earlier one."""

    gratings: tuple[GratingData, ...]
    filter_labels: tuple[str, ...]
    grating: int = 1
    outport: int = 1
    slits_um: tuple[float, ...] = (200.0,) * SLITS
    bandpass_nm: float = 5.0
    unit: WavelengthUnit = WavelengthUnit.NM
    handshake: bool = False
    status: int = NO_ERROR
    error: ErrorCode = field(default=ErrorCode.NONE)
    gpib_address: int = 4

    @property
    def current(self) -> GratingData:
        """The grating in the beam."""
        return self.gratings[self.grating - 1]

    def with_grating(self, number: int, **changes: object) -> "UnitState":
        """State with new data of a grating."""
        changed = list(self.gratings)
        changed[number - 1] = replace(changed[number - 1], **changes)  # type: ignore[arg-type]
        return replace(self, gratings=tuple(changed))

    def after_power_on(self) -> "UnitState":
        """State after power-on: calibration, labels and GPIB address are kept."""
        return UnitState(self.gratings, self.filter_labels, gpib_address=self.gpib_address)


IDENTITY = "Cornerstone 260 virtual"
HIGHEST_NM_OF_1200 = 1400.0
LAST_GPIB_ADDRESS = 30
WIDEST_SLIT_UM = 3000.0
NM_A_MICROMETRE_OF_1200 = 0.0032
"""Bandpass of a slit: 3.2 nm a millimetre for 1200 lines/mm (to be confirmed on hardware)."""
OUTPORTS = (1, 2)


def status_text(drive: MonochromatorDrive, status: int) -> str:
    """The status byte as this unit writes it."""
    return encode_status(status, drive.status_digits, decimal=drive.status_decimal)


class StatementRefused(Exception):
    """A statement that the device does not carry out, with the error that it then reports."""

    def __init__(self, error: ErrorCode) -> None:
        super().__init__(error.name)
        self.error = error


@dataclass(frozen=True)
class StatementResult:
    """Result of a statement: the new state, the answer, and the time at which all movements have ended."""

    state: UnitState
    t: float
    answer: str | None = None


class Statements:
    """The statements, on one plant."""

    def __init__(self, plant: Plant, drive: MonochromatorDrive, identity: str = IDENTITY) -> None:
        self._plant, self._identity = plant, identity
        self._drive = drive
        self._commands: dict[str, Callable[[UnitState, str, float], StatementResult]] = {
            "GOWAVE": self._go_wave,
            "STEP": self._step,
            "ABORT": lambda state, _, t: StatementResult(state, t),
            "CALIBRATE": self._calibrate,
            "GRAT": self._go_grating,
            "SHUTTER": self._shutter,
            "FILTER": self._go_filter,
            "OUTPORT": self._outport,
            "BANDPASS": self._bandpass,
            "UNITS": self._units,
            "HANDSHAKE": self._handshake,
            "ADDRESS": self._address,
        }

    def perform(self, state: UnitState, statement: Statement, t: float) -> StatementResult:
        """Carry out a statement at `t`. Raises StatementRefused."""
        if statement.query:
            return self._ask(state, statement, t)
        action = self._commands.get(statement.word)
        if action is not None:
            return action(state, statement.parameter, t)
        return self._set_numbered(state, statement, t)

    def highest_nm(self, state: UnitState) -> float:
        """Highest wavelength of the drive with the present grating, nm."""
        return HIGHEST_NM_OF_1200 * 1200 / state.current.lines_per_mm

    def _nm_per_step(self, state: UnitState) -> float:
        return self._drive.nm_per_step * 1200 / state.current.lines_per_mm

    def _ask(self, state: UnitState, statement: Statement, t: float) -> StatementResult:
        true_nm = self._plant.wavelength_nm.at(t)
        grating = state.current
        match statement.word:
            case "WAVE":
                answer = state.unit.encode(grating.shown_nm(true_nm))
            case "STEP":
                answer = str(round(true_nm / self._nm_per_step(state)))
            case "SHUTTER":
                answer = "O" if self._plant.shutter_open.at(t) else "C"
            case "FILTER":
                answer = str(self._plant.filter_position(t) if self._drive.filters else 0)
            case "GRAT":
                answer = Grating(state.grating, grating.lines_per_mm, grating.label).encode()
            case "OUTPORT":
                answer = str(state.outport)
            case "BANDPASS":
                answer = f"{state.bandpass_nm:.3f}"
            case "UNITS":
                answer = state.unit.name
            case "HANDSHAKE" if self._drive.handshake:
                answer = str(int(state.handshake))
            case "ADDRESS":
                answer = str(state.gpib_address)
            case "INFO":
                answer = self._identity
            case "STB":
                answer = status_text(self._drive, state.status)
                state = replace(state, status=NO_ERROR)
            case "ERROR":
                none = state.error is ErrorCode.NONE and not self._drive.zero_is_no_error
                answer = "" if none else str(int(state.error))
                state = replace(state, error=ErrorCode.NONE)
            case word:
                answer = self._ask_numbered(state, word)
        return StatementResult(state, t, answer)

    def _ask_numbered(self, state: UnitState, word: str) -> str:
        kind, number, name = _numbered(word, state, self._drive.filters)
        if kind == "SLIT":
            return f"{state.slits_um[number - 1]:.0f}"
        if kind == "FILTER":
            return state.filter_labels[number - 1]
        grating = state.gratings[number - 1]
        match name:
            case "LABEL":
                return grating.label
            case "LINES":
                return str(grating.lines_per_mm)
            case "ZERO":
                return f"{grating.zero_nm:.4f}"
            case "OFFSET":
                return f"{grating.offset_nm:.6f}"
        return f"{grating.factor:.6f}"

    def _set_numbered(self, state: UnitState, statement: Statement, t: float) -> StatementResult:
        kind, number, name = _numbered(statement.word, state, self._drive.filters)
        text = statement.parameter
        if name == "LABEL":
            if len(text) > MAX_LABEL:
                raise StatementRefused(ErrorCode.LABEL_TOO_LONG)
            if not text:
                raise StatementRefused(ErrorCode.BAD_PARAMETER)
            if kind == "FILTER":
                labels = [*state.filter_labels]
                labels[number - 1] = text
                return StatementResult(replace(state, filter_labels=tuple(labels)), t)
            return StatementResult(state.with_grating(number, label=text), t)
        if kind == "SLIT":
            return self._go_slits(state, {number: _number(text)}, t)
        if name == "LINES":
            if not 1 <= _integer(text) <= 10_000:
                raise StatementRefused(ErrorCode.BAD_PARAMETER)
            return StatementResult(state.with_grating(number, lines_per_mm=_integer(text)), t)
        if name == "ZERO":
            return StatementResult(state.with_grating(number, zero_nm=_number(text)), t)
        if name == "OFFSET":
            return StatementResult(state.with_grating(number, offset_nm=_number(text)), t)
        if not 0.5 <= _number(text) <= 2.0:
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        return StatementResult(state.with_grating(number, factor=_number(text)), t)

    def _go_wave(self, state: UnitState, text: str, t: float) -> StatementResult:
        return self._slew(state, state.current.true_nm(state.unit.to_nm(_number(text))), t)

    def _step(self, state: UnitState, text: str, t: float) -> StatementResult:
        step = self._nm_per_step(state)
        return self._slew(state, (round(self._plant.wavelength_nm.at(t) / step) + _integer(text)) * step, t)

    def _slew(self, state: UnitState, true_nm: float, t: float) -> StatementResult:
        if not 0.0 <= true_nm <= self.highest_nm(state):
            raise StatementRefused(ErrorCode.DESTINATION_NOT_ALLOWED)
        step = self._nm_per_step(state)
        target = round(round(true_nm / step) * step, 6)
        way = abs(target - self._plant.wavelength_nm.at(t))
        if way:
            arrived = t + way / self._drive.slew_nm_per_s
            self._plant.wavelength_nm.slew(t, arrived, target)
            t = arrived + self._drive.settle_s
        return StatementResult(state, t)

    def _calibrate(self, state: UnitState, text: str, t: float) -> StatementResult:
        shown = state.unit.to_nm(_number(text))
        if not 0.0 <= shown <= 10_000.0:
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        offset = state.current.offset_nm + shown - state.current.shown_nm(self._plant.wavelength_nm.at(t))
        return StatementResult(state.with_grating(state.grating, offset_nm=offset), t)

    def _go_grating(self, state: UnitState, text: str, t: float) -> StatementResult:
        number = _integer(text)
        if not 1 <= number <= len(state.gratings):
            raise StatementRefused(ErrorCode.DESTINATION_NOT_ALLOWED)
        if number == state.grating:
            return StatementResult(state, t)
        changed = replace(state, grating=number)
        # The turret turns, and the unit goes back to the wavelength where it was, if that grating reaches it.
        wanted = changed.current.true_nm(state.current.shown_nm(self._plant.wavelength_nm.at(t)))
        target = min(max(wanted, 0.0), self.highest_nm(changed))
        step = self._nm_per_step(changed)
        done = t + self._drive.grating_s
        self._plant.wavelength_nm.slew(t, done, round(round(target / step) * step, 6))
        return StatementResult(changed, done)

    def _shutter(self, state: UnitState, text: str, t: float) -> StatementResult:
        if text.upper() not in ("O", "C"):
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        done = t + self._drive.shutter_s
        self._plant.shutter_open.set(done, text.upper() == "O")
        return StatementResult(state, done)

    def _go_filter(self, state: UnitState, text: str, t: float) -> StatementResult:
        position = _integer(text)
        if not self._drive.filters:
            raise StatementRefused(ErrorCode.ACCESSORY_NOT_PRESENT)
        if not 1 <= position <= self._drive.filters:
            raise StatementRefused(ErrorCode.DESTINATION_NOT_ALLOWED)
        way = abs(position - self._plant.filter_position(t))
        if not way and self._drive.already_there_is_error:
            raise StatementRefused(ErrorCode.ACCESSORY_ALREADY_THERE)
        if way:
            self._plant.wheel.slew(t, t + way * self._drive.filter_s, float(position))
        return StatementResult(state, t + way * self._drive.filter_s)

    def _outport(self, state: UnitState, text: str, t: float) -> StatementResult:
        if _integer(text) not in OUTPORTS:
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        way = self._drive.filter_s if _integer(text) != state.outport else 0.0
        return StatementResult(replace(state, outport=_integer(text)), t + way)

    def _bandpass(self, state: UnitState, text: str, t: float) -> StatementResult:
        bandpass = _number(text)
        width = bandpass / (NM_A_MICROMETRE_OF_1200 * 1200 / state.current.lines_per_mm)
        done = self._go_slits(state, dict.fromkeys(range(1, SLITS + 1), width), t)
        return StatementResult(replace(done.state, bandpass_nm=bandpass), done.t)

    def _go_slits(self, state: UnitState, widths_um: dict[int, float], t: float) -> StatementResult:
        if not all(4.0 <= width <= WIDEST_SLIT_UM for width in widths_um.values()):
            raise StatementRefused(ErrorCode.DESTINATION_NOT_ALLOWED)
        slits = list(state.slits_um)
        way = 0.0
        for number, width in widths_um.items():
            way = max(way, abs(width - slits[number - 1]))
            slits[number - 1] = float(round(width))
        return StatementResult(replace(state, slits_um=tuple(slits)), t + way / self._drive.slit_um_per_s)

    def _units(self, state: UnitState, text: str, t: float) -> StatementResult:
        if text.upper() not in WavelengthUnit.__members__:
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        return StatementResult(replace(state, unit=WavelengthUnit[text.upper()]), t)

    def _handshake(self, state: UnitState, text: str, t: float) -> StatementResult:
        if not self._drive.handshake:
            raise StatementRefused(ErrorCode.NOT_UNDERSTOOD)
        if text not in ("0", "1"):
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        return StatementResult(replace(state, handshake=text == "1"), t)

    def _address(self, state: UnitState, text: str, t: float) -> StatementResult:
        if not 0 <= _integer(text) <= LAST_GPIB_ADDRESS:
            raise StatementRefused(ErrorCode.BAD_PARAMETER)
        return StatementResult(replace(state, gpib_address=_integer(text)), t)


def _numbered(word: str, state: UnitState, filters: int) -> tuple[str, int, str]:
    """Split a word such as `GRAT2LABEL` into its parts: GRAT, 2, LABEL. Raises StatementRefused."""
    match = re.fullmatch(r"(GRAT)(\d)(LABEL|LINES|ZERO|FACTOR|OFFSET)|(FILTER)(\d)(LABEL)|(SLIT)(\d)(MICRONS)", word)
    if match is None:
        raise StatementRefused(ErrorCode.NOT_UNDERSTOOD)
    kind, digit, name = (each for each in match.groups() if each is not None)
    number = int(digit)
    if kind == "FILTER" and not filters:
        raise StatementRefused(ErrorCode.ACCESSORY_NOT_PRESENT)
    if not 1 <= number <= {"GRAT": len(state.gratings), "FILTER": filters, "SLIT": SLITS}[kind]:
        raise StatementRefused(ErrorCode.BAD_PARAMETER)
    return kind, number, name


def _number(text: str) -> float:
    try:
        return decode_number(text.encode("ascii"))
    except StatementError:
        raise StatementRefused(ErrorCode.BAD_PARAMETER) from None


def _integer(text: str) -> int:
    if not re.fullmatch(r"[+-]?\d{1,9}", text):
        raise StatementRefused(ErrorCode.BAD_PARAMETER)
    return int(text)
