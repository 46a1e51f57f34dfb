"""The monitor photodiode behind a Thorlabs PM100D or another SCPI picoammeter: mean current or power.

The averaging is the canary: it is read back after each mean and after each resynchronisation of the wire. If it differs,
the instrument has reset, and all settings are written again. Each setting is sent with a query in the same message, so that
a lost setting is detected. An overrange (9.9E37) is an error and never a value, and so is a number beyond the range. For
undetectable faults of the wire see drivers.usb.usbtmc. Each setting is noted before it is written, and `close` restores what
was found. To be confirmed on hardware: 3000 samples per second, duration of a zero.

The SCPI commands of a family of instruments are a `Dialect`. Another picoammeter with USBTMC and SCPI is one more Dialect.
To be confirmed on hardware: everything but the PM100D's commands.
"""

import contextlib
import math
from collections import deque
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from goniotwin.drivers.device import Pending, Poll
from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, NoAnswer, Overrange, Refused
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.monitor.settings import ANSWER_MARGIN_S, MonitorSettings
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.drivers.usb.usbtmc import UsbOpener, UsbTmc
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.scpi import ScpiError, decode_error, decode_number, overloaded

NAME = "monitor"
LONGEST_READING_S = 1.0
OVERRANGE = 1.1
NEXT_ERROR = "SYST:ERR?"
CONFIGURE = "CONF"
"""`CONF:CURR` selects what `CONF?` answers with CURR."""
MOST_ERRORS = 40
LONGEST_ERRORS_S = 1.0
"""Longest time for reading the error queue."""
COMMAND_ERRORS = range(-199, -99)
SETTINGS_KEPT = 64
ZERO_POLL_S = 0.2
LONGEST_ZERO_S = 30.0
Quantity = Literal["current", "power"]


@dataclass(frozen=True)
class Dialect:
    """SCPI commands of a family; None for what the family does not have. `{}` takes a number.

    `averaging` takes a number of samples if `averages_samples`, else seconds. `before` is sent once at connect. With `restores`
    each setting can be asked for, and is restored at the end.
    """

    name: str
    current: str
    current_range: str
    averaging: str
    averages_samples: bool
    read: str = "READ?"
    auto_range: str = "SENS:CURR:RANG:AUTO {:d}"
    power: str | None = None
    power_unit: str | None = None
    wavelength: str | None = None
    low_pass: str | None = None
    zero: str | None = None
    zero_state: str | None = None
    zero_value: str | None = None
    before: tuple[str, ...] = ()
    restores: bool = False


PM100D = Dialect(
    name="pm100d",
    current="CONF:CURR",
    current_range="SENS:CURR:RANG {:.1E}",
    averaging="SENS:AVER:COUN {:d}",
    averages_samples=True,
    power="CONF:POW",
    power_unit="SENS:POW:UNIT W",
    wavelength="SENS:CORR:WAV {:.3f}",
    low_pass="INP:PDI:FILT:LPAS:STAT {:d}",
    zero="SENS:CORR:COLL:ZERO:INIT",
    zero_state="SENS:CORR:COLL:ZERO:STAT?",
    zero_value="SENS:CORR:COLL:ZERO:MAGN?",
    restores=True,
)
B2980 = Dialect(
    name="b2980",
    current="SENS:FUNC 'CURR'",
    current_range="SENS:CURR:RANG {:.1E}",
    averaging="SENS:CURR:APER {:.6E}",
    averages_samples=False,
    before=("FORM ASC", "FORM:ELEM:SENS CURR", "INP ON"),
)
DIALECTS = {each.name: each for each in (PM100D, B2980)}


class Monitor:
    """The instrument on USB."""

    name = NAME
    parts: tuple[str, ...] = ()

    def __init__(
        self,
        opener: UsbOpener,
        settings: MonitorSettings,
        clock: Clock,
        tap: Tap = no_tap,
        found: FoundSettings | None = None,
    ) -> None:
        self._found = found or FoundSettings()
        self._present: dict[str, str] = {}
        self.wire = UsbTmc(NAME, opener, clock, tap=tap)
        """Its wire, for queries that this driver does not have."""
        self._clock = clock
        self.dialect = DIALECTS[settings.dialect]
        """Its commands."""
        self.settings = settings
        self._range_a: float | None = settings.range_a
        self._wavelength_nm = settings.wavelength_nm
        self._low_pass = False
        self._quantity: Quantity = "current"
        self._averages = 0
        self._resynchronisations = 0

    @property
    def model(self) -> str:
        """The model, by its dialect in the rig file."""
        return self.dialect.name.upper()

    @property
    def events(self) -> deque[str]:
        """The driver's own actions (wire resynchronised, device found again), newest last."""
        return self.wire.events

    def identify(self) -> str:
        """Open the instrument and return its identity; no setting is written. Raises DeviceError."""
        identity = self.wire.connect()
        self._found.take_up(identity)
        self._leave_as_found()
        return identity

    def connect(self) -> str:
        """Open and identify the instrument, write its settings; return its identity. Raises DeviceError."""
        self.wire.close()
        identity = self.wire.connect()
        self._found.take_up(identity)
        self._present = self._ask_settings()
        self._resynchronisations = self.wire.resynchronisations
        self._quantity = "current"
        self._write_settings()
        return identity

    def reconnect(self) -> None:
        """Connect again after a fault. Raises DeviceError."""
        self.connect()

    def close(self) -> None:
        """Restore the settings that were found, unless the instrument is not responding, and release the USB interface."""
        with contextlib.suppress(DeviceError):
            self._leave_as_found()
        self.wire.close()

    # ---- settings ----

    def set_range(self, range_a: float | None) -> None:
        """Set the highest current, A; None selects the instrument's auto-range. Raises DeviceError."""
        self._range_a = range_a
        self._send("set the range", *self._range_commands())

    def set_wavelength(self, wavelength_nm: float) -> None:
        """Set the wavelength for power readings. Raises DeviceError."""
        self._wavelength_nm = wavelength_nm
        self._send("set the wavelength", self._require(self.dialect.wavelength, "wavelength").format(wavelength_nm))

    def set_low_pass(self, on: bool) -> None:
        """Switch the low-pass input filter. Raises DeviceError."""
        self._low_pass = on
        self._send("set the filter", self._require(self.dialect.low_pass, "input filter").format(on))

    def check(self) -> None:
        """Read the canary. Raises Forgotten if settings were lost and have been written again, DeviceError if it is silent."""
        self._ready()
        if not self._averages:  # there is no canary before the first mean
            self.wire.status_byte()
        elif self._has_reset():
            self._restore()

    def ask(self) -> None:
        """Ask whether the instrument responds, and restore nothing: the next use finds a reset. Raises DeviceError."""
        self.wire.ready()
        self.wire.status_byte()

    def status_byte(self) -> int:
        """Status byte of IEEE 488.2; does not disturb a measurement. Raises DeviceError."""
        return self.wire.status_byte()

    def abort(self) -> None:
        """Abort a measurement and discard its reply. Raises DeviceError."""
        self.wire.abort()
        self.wire.clear()

    # ---- measuring ----

    def start_mean(self, seconds: float, quantity: Quantity = "current") -> "MonitorMean":
        """Start a mean of current or power over about this many seconds. Raises DeviceError."""
        self._ready()
        if quantity != self._quantity:
            self._quantity = quantity
            self._send(f"measure {quantity}", *self._quantity_commands())
        pieces = max(1, math.ceil(seconds / LONGEST_READING_S))
        # After power-on the averaging is 1, and the averaging is the canary.
        averages = max(2, round(seconds / pieces * self.settings.samples_per_s))
        if averages != self._averages:
            self._averages = averages
            self._send("set the averaging", self._averaging_command())
        each_s = averages / self.settings.samples_per_s
        return MonitorMean(self.wire, self._clock, self.dialect.read, pieces, each_s, self._limit(), self.check)

    def start_zero(self) -> Pending:
        """Start a zero adjustment, with the photodiode in the dark. Raises DeviceError."""
        command = self._require(self.dialect.zero, "zero adjustment")
        state = self._require(self.dialect.zero_state, "zero adjustment")
        self._ready()
        self._send("adjust the zero", command)
        started = self._clock.now()

        def is_over() -> bool:
            if self._query_number(state) == 0.0:
                self._check_errors("adjust the zero")
                return True
            if self._clock.now() > started + LONGEST_ZERO_S:
                raise DeviceError(NAME, "adjust the zero", f"not over after {LONGEST_ZERO_S:g} s", "check the instrument")
            return False

        return Poll(self._clock, started + ZERO_POLL_S, ZERO_POLL_S, is_over)

    def zero_a(self) -> float:
        """Current that the instrument subtracts as zero, A. Raises DeviceError."""
        return self._query_number(self._require(self.dialect.zero_value, "zero adjustment"))

    # ---- settings as found ----

    def _note(self, commands: Iterable[str]) -> list[str]:
        """Note settings before these commands write them; return the names of those that change."""
        settings = {name: value for command in commands for name, value in _settings_of(command)}
        wanted = {name: value for name, value in settings.items() if name in self._present}
        self._found.note({name: (self._present[name], value) for name, value in wanted.items()})
        changed = [name for name, value in wanted.items() if self._present[name] != value]
        self._present |= wanted
        return changed

    def _ask_settings(self) -> dict[str, str]:
        """The settings that the driver may write, as they are now. Raises DeviceError."""
        if not (self._found.asks and self.dialect.restores):
            return {}
        each = self.dialect
        commands = (each.current, each.current_range, each.wavelength, each.low_pass, each.averaging, each.power_unit)
        return {name: self._setting(name) for command in commands if command for name, _ in _settings_of(command)}

    def _note_reported(self, names: Iterable[str]) -> None:
        """Note the values that the instrument made of those that were written, such as the next range. Raises DeviceError."""
        for name in names:
            reported = self._setting(name)
            self._found.note({name: (self._present[name], reported)})
            self._present[name] = reported

    def _leave_as_found(self) -> None:
        if not self._found.changes:
            return
        self.wire.ready()
        with contextlib.suppress(Refused):  # errors of a program that was killed, and are none of what follows
            self._check_errors("read its error queue")
        present = {name: self._setting(name) for name in self._found.changes}
        for name, value in present.items():
            if (found := self._found.value_to_restore(name, value)) is not None and not self._ranges_itself(name):
                separator = ":" if name == CONFIGURE else " "
                self._check_errors("restore its settings", f"{name}{separator}{found};:{NEXT_ERROR}")
        self._found.clear()
        self._present.clear()

    def _ranges_itself(self, name: str) -> bool:
        """Whether it chooses this range by an auto-range that stays on, which a written range would end. Raises DeviceError."""
        auto = f"{name}:AUTO"
        return name.endswith(":RANG") and self._setting(auto) == "1" and self._found.value_to_restore(auto, "1") is None

    def _setting(self, name: str) -> str:
        return _as_noted(self.wire.query(f"{name}?").decode("ascii", "replace"))

    # ---- exchanges ----

    def _limit(self) -> float | None:
        """Largest plausible value; None if there is none."""
        return None if self._quantity == "power" or self._range_a is None else OVERRANGE * self._range_a

    def _ready(self) -> None:
        """Make sure that the wire is in step and the settings are written. Raises DeviceError, Forgotten after a reset."""
        self.wire.ready()
        if self.wire.resynchronisations != self._resynchronisations:
            self._resynchronisations = self.wire.resynchronisations
            self._restore()

    def _restore(self) -> None:
        """Write all settings again. Raises DeviceError, Forgotten if they had been lost."""
        has_reset = self._has_reset()
        self._write_settings()
        if has_reset:
            raise Forgotten(NAME, "check its settings", "it has reset; its settings are restored", "measure again")

    def _has_reset(self) -> bool:
        if not self._averages:
            return False
        query, written = _query_of(self._averaging_command())
        return not math.isclose(self._query_number(query), written, rel_tol=1e-3)

    def _write_settings(self) -> None:
        commands = ["*CLS", *self.dialect.before, *self._quantity_commands(), *self._range_commands()]
        if self.dialect.wavelength is not None:
            commands.append(self.dialect.wavelength.format(self._wavelength_nm))
        if self.dialect.low_pass is not None:
            commands.append(self.dialect.low_pass.format(self._low_pass))
        if self._averages:
            commands.append(self._averaging_command())
        self._send("write its settings", *commands)

    def _quantity_commands(self) -> list[str]:
        if self._quantity == "current":
            return [self.dialect.current]
        unit = [self.dialect.power_unit] if self.dialect.power_unit is not None else []
        return [self._require(self.dialect.power, "power reading"), *unit]

    def _range_commands(self) -> list[str]:
        if self._range_a is None:
            return [self.dialect.auto_range.format(True)]
        return [self.dialect.current_range.format(self._range_a)]

    def _averaging_command(self) -> str:
        value = self._averages if self.dialect.averages_samples else self._averages / self.settings.samples_per_s
        return self.dialect.averaging.format(value)

    def _send(self, doing: str, *commands: str) -> None:
        """Send commands, each with a query in the same message, whose reply confirms it. Raises DeviceError."""
        changed = self._note(commands)
        for command in commands:
            try:
                self._check_errors(doing, f"{command};:{NEXT_ERROR}")
            except NoAnswer:
                with contextlib.suppress(NoAnswer, BadAnswer):  # an unknown command ends the message
                    code, text = self._next_error(doing)
                    if code in COMMAND_ERRORS:
                        raise self._refused(doing, code, text) from None
                raise
        self._note_reported(changed)

    def _query_number(self, query: str) -> float:
        try:
            return decode_number(self.wire.query(query))
        except ScpiError as error:
            self.wire.in_step = False
            raise BadAnswer(NAME, query, str(error), "ask again") from None

    def _check_errors(self, doing: str, query: str = NEXT_ERROR) -> None:
        """Read the error queue until it is empty. Raises Refused with its first error."""
        deadline = self._clock.now() + LONGEST_ERRORS_S
        code, _ = first = self._next_error(doing, query)
        for _ in range(MOST_ERRORS):
            if code == 0 or self._clock.now() > deadline:
                break
            code, _ = self._next_error(doing)
        if first[0] != 0:
            raise self._refused(doing, *first)

    def _next_error(self, doing: str, query: str = NEXT_ERROR) -> tuple[int, str]:
        try:
            return decode_error(self.wire.query(query))
        except ScpiError as error:
            self.wire.in_step = False
            raise BadAnswer(NAME, doing, str(error), "ask again") from None

    def _refused(self, doing: str, code: int, text: str) -> Refused:
        return Refused(NAME, doing, f"error {code}, {text}", "check range and averaging in the rig file")

    def _require(self, command: str | None, what: str) -> str:
        if command is None:
            raise Refused(NAME, "write its settings", f"a {self.dialect.name} has no {what}", "change the rig file")
        return command


@lru_cache(maxsize=SETTINGS_KEPT)
def _query_of(command: str) -> tuple[str, float]:
    """The query of a setting that a command writes, and the number that it writes."""
    name, _, value = command.partition(" ")
    return f"{name}?", float(value)


def _settings_of(command: str) -> list[tuple[str, str]]:
    """Names and values of the settings that a command writes; none for `*CLS`."""
    name, blank, value = command.partition(" ")
    if not blank:
        name, _, value = command.rpartition(":")
        return [(name, value)] if name == CONFIGURE else []
    settings = [(name, _as_noted(value))]
    return [*settings, (f"{name}:AUTO", "0")] if name.endswith(":RANG") else settings  # a range ends the auto-range


def _as_noted(text: str) -> str:
    """The value of a setting, of a command or a reply, in one form."""
    text = text.strip()
    try:
        return f"{float(text):.6g}"
    except ValueError:
        return {"ON": "1", "OFF": "0"}.get(text.upper(), text)


class MonitorMean:
    """A mean in progress, of one or more readings; `current_a` (or `power_w`) is the result.

    At the end it reads the instrument's canary (`check`): readings after a reset have wrong settings.
    """

    def __init__(
        self,
        wire: UsbTmc,
        clock: Clock,
        query: str,
        pieces: int,
        seconds: float,
        limit: float | None,
        check: Callable[[], None],
    ) -> None:
        self._wire = wire
        self._clock = clock
        self._query = query
        self._left = pieces
        self._seconds = seconds
        self._limit = limit
        self._check = check
        self._values: list[float] = []
        self._start_reading()

    @property
    def current_a(self) -> float:
        """Mean current, A."""
        return math.fsum(self._values) / len(self._values)

    power_w = current_a
    """Mean power, W, of a mean of power."""

    def poll(self) -> bool:
        """Fetch the reading that is due and start the next one; at the end read the canary. Raises DeviceError."""
        if not self._left:
            self._check()
            return True
        reply = self._wire.read(self._query)
        try:
            value = decode_number(reply)
        except ScpiError as error:
            self._wire.in_step = False
            raise BadAnswer(NAME, self._query, str(error), "measure again") from None
        if overloaded(value):
            raise Overrange(NAME, self._query, "overrange: the current exceeds the range", "set a wider range in the rig file")
        if self._limit is not None and abs(value) > self._limit:
            self._wire.in_step = False
            raise BadAnswer(NAME, self._query, f"{value:g} is beyond the range", "measure again")
        self._values.append(value)
        self._left -= 1
        if self._left:
            self._start_reading()
        else:
            self.due = self._clock.now()
        return False

    def _start_reading(self) -> None:
        self._wire.write(self._query, expects_reply=True)
        self.due = self._clock.now() + self._seconds + ANSWER_MARGIN_S
