"""The monitor photodiode behind a Thorlabs PM100D, or another SCPI picoammeter: mean current or power over some time.

The averaging is the canary: asked for after each mean and after the wire had to be brought into step. Where it is not what
was set the instrument has reset, and everything is set again. What is set goes out with a question behind it in the same
message, so that none is lost unnoticed. An overrange (9.9E37) is an error and never a value; neither is a number beyond the
range. See drivers.usb.usbtmc for what the wire cannot show. To be confirmed on hardware: 3000 samples a second, how long a zero
takes.

How instruments that measure a photodiode want to be told: a small table of SCPI strings for each family.

Another picoammeter with USBTMC and SCPI is a line here. To be confirmed on hardware: everything but the PM100D's spelling.
"""

import contextlib
import math
from collections import deque
from dataclasses import dataclass
from typing import Literal

from goniotwin.drivers.device import Pending, Poll
from goniotwin.drivers.errors import BadAnswer, DeviceError, Forgotten, NoAnswer, Refused
from goniotwin.drivers.monitor.mean import ANSWER_MARGIN_S as ANSWER_MARGIN_S
from goniotwin.drivers.monitor.mean import NAME, MonitorMean
from goniotwin.drivers.tap import Tap, no_tap
from goniotwin.drivers.usb.usbtmc import UsbOpener, UsbTmc
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.scpi import ScpiError, decode_error, decode_number


@dataclass(frozen=True)
class Dialect:
    """The strings; None for what the family does not have. `{}` takes a number.

    `averaging` takes a count of samples where `averages_samples`, else seconds. `before` is sent once at connect.
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


LONGEST_READING_S = 1.0
OVER_RANGE = 1.1
NEXT_ERROR = "SYST:ERR?"
MOST_ERRORS = 40
COMMAND_ERRORS = range(-199, -99)
ZERO_POLL_S = 0.2
LONGEST_ZERO_S = 30.0
Quantity = Literal["current", "power"]


@dataclass(frozen=True)
class MonitorSettings:
    """What the operator believes of the monitor: its range in A, its samples, how far one reading can be trusted.

    `wavelength_nm` is that for which it tells power. `dialect` is one of drivers.monitor.monitor.
    """

    range_a: float = 500e-9
    samples_per_s: float = 3000.0
    relative_uncertainty: float = 3.0e-4
    wavelength_nm: float = 550.0
    dialect: str = "pm100d"


class Monitor:
    """The instrument on USB."""

    def __init__(self, opener: UsbOpener, settings: MonitorSettings, clock: Clock, tap: Tap = no_tap) -> None:
        self._wire = UsbTmc(NAME, opener, tap=tap)
        self._clock = clock
        self._dialect = DIALECTS[settings.dialect]
        self.settings = settings
        self._range_a: float | None = settings.range_a
        self._wavelength_nm = settings.wavelength_nm
        self._low_pass = False
        self._quantity: Quantity = "current"
        self._averages = 0
        self._seen = 0

    @property
    def said(self) -> deque[str]:
        """What the driver did of its own accord (brought the wire into step, found it again), newest last."""
        return self._wire.said

    def connect(self) -> str:
        """Opens it, asks who it is, sets it up; returns its identity. Raises DeviceError."""
        self.close()
        identity = self._wire.connect()
        self._seen = self._wire.renewed
        self._quantity = "current"
        self._set_up()
        return identity

    def close(self) -> None:
        """Gives it back."""
        self._wire.close()

    # ---- settings ----

    def set_range(self, range_a: float | None) -> None:
        """The highest current, A; None lets the instrument choose. Raises DeviceError."""
        self._range_a = range_a
        self._tell("set the range", *self._range_commands())

    def set_wavelength(self, wavelength_nm: float) -> None:
        """For power. Raises DeviceError."""
        self._wavelength_nm = wavelength_nm
        self._tell("set the wavelength", self._have(self._dialect.wavelength, "wavelengths").format(wavelength_nm))

    def set_low_pass(self, on: bool) -> None:
        """The slow input filter. Raises DeviceError."""
        self._low_pass = on
        self._tell("set the filter", self._have(self._dialect.low_pass, "an input filter").format(on))

    def check(self) -> None:
        """Asks whether its settings are still there: the canary. Raises Forgotten where they were not and had to be set."""
        self._ready()
        if self._has_forgotten():
            self._restore()

    def status_byte(self) -> int:
        """IEEE 488.2's, without disturbing a measurement. Raises DeviceError."""
        return self._wire.status_byte()

    def abort(self) -> None:
        """Ends what it measures; the answer that it owed is thrown away. Raises DeviceError."""
        self._wire.abort()
        self._wire.clear()

    # ---- measuring ----

    def start_mean(self, seconds: float, quantity: Quantity = "current") -> MonitorMean:
        """Averages current or power over about so many seconds from now. Raises DeviceError."""
        self._ready()
        if quantity != self._quantity:
            self._quantity = quantity
            self._tell(f"measure {quantity}", *self._quantity_commands())
        pieces = max(1, math.ceil(seconds / LONGEST_READING_S))
        # One is what it has after power-on, and the averaging is the canary.
        averages = max(2, round(seconds / pieces * self.settings.samples_per_s))
        if averages != self._averages:
            self._averages = averages
            self._tell("set the averaging", self._averaging_command())
        each_s = averages / self.settings.samples_per_s
        return MonitorMean(self._wire, self._clock, self._dialect.read, pieces, each_s, self._limit(), self.check)

    def start_zero(self) -> Pending:
        """Takes what it sees now, in the dark, for zero. Raises DeviceError."""
        command = self._have(self._dialect.zero, "a zero")
        state = self._have(self._dialect.zero_state, "a zero")
        self._ready()
        self._tell("take the zero", command)
        begun = self._clock.now()

        def over() -> bool:
            if self._ask_number(state) == 0.0:
                self._check_errors("take the zero")
                return True
            if self._clock.now() > begun + LONGEST_ZERO_S:
                raise DeviceError(NAME, "take the zero", f"not over after {LONGEST_ZERO_S:g} s", "check the instrument")
            return False

        return Poll(self._clock, begun + ZERO_POLL_S, ZERO_POLL_S, over)

    def zero_a(self) -> float:
        """What it takes for zero, A. Raises DeviceError."""
        return self._ask_number(self._have(self._dialect.zero_value, "a zero"))

    # ---- exchanges ----

    def _limit(self) -> float | None:
        """A value beyond it cannot be."""
        return None if self._quantity == "power" or self._range_a is None else OVER_RANGE * self._range_a

    def _ready(self) -> None:
        """In step and set up. Raises DeviceError; Forgotten where settings were lost and had to be set again."""
        self._wire.ready()
        if self._wire.renewed != self._seen:
            self._seen = self._wire.renewed
            self._restore()

    def _restore(self) -> None:
        """Sets everything again; says so where it had been forgotten. Raises DeviceError."""
        forgotten = self._has_forgotten()
        self._set_up()
        if forgotten:
            raise Forgotten(NAME, "ask it", "it has reset itself; its settings are restored", "measure again")

    def _has_forgotten(self) -> bool:
        question = self._dialect.averaging.partition(" ")[0] + "?"
        if not self._averages:
            return False
        told = float(self._averaging_command().partition(" ")[2])
        return not math.isclose(self._ask_number(question), told, rel_tol=1e-3)

    def _set_up(self) -> None:
        commands = ["*CLS", *self._dialect.before, *self._quantity_commands(), *self._range_commands()]
        if self._dialect.wavelength is not None:
            commands.append(self._dialect.wavelength.format(self._wavelength_nm))
        if self._dialect.low_pass is not None:
            commands.append(self._dialect.low_pass.format(self._low_pass))
        if self._averages:
            commands.append(self._averaging_command())
        self._tell("set it up", *commands)

    def _quantity_commands(self) -> list[str]:
        if self._quantity == "current":
            return [self._dialect.current]
        unit = [self._dialect.power_unit] if self._dialect.power_unit is not None else []
        return [self._have(self._dialect.power, "power"), *unit]

    def _range_commands(self) -> list[str]:
        if self._range_a is None:
            return [self._dialect.auto_range.format(True)]
        return [self._dialect.current_range.format(self._range_a)]

    def _averaging_command(self) -> str:
        value = self._averages if self._dialect.averages_samples else self._averages / self.settings.samples_per_s
        return self._dialect.averaging.format(value)

    def _tell(self, doing: str, *commands: str) -> None:
        """Each with a question in the same message, whose answer says that the command has been heard. Raises DeviceError."""
        for command in commands:
            try:
                self._check_errors(doing, f"{command};:{NEXT_ERROR}")
            except NoAnswer:
                with contextlib.suppress(NoAnswer, BadAnswer):  # a command that it does not know ends a message
                    code, text = self._next_error(doing)
                    if code in COMMAND_ERRORS:
                        raise self._refused(doing, code, text) from None
                raise

    def _ask_number(self, question: str) -> float:
        try:
            return decode_number(self._wire.ask(question))
        except ScpiError as error:
            self._wire.in_step = False
            raise BadAnswer(NAME, question, str(error), "ask again") from None

    def _check_errors(self, doing: str, question: str = NEXT_ERROR) -> None:
        """Reads the error queue until it is empty. Raises Refused with the first error in it."""
        code, _ = first = self._next_error(doing, question)
        for _ in range(MOST_ERRORS):
            if code == 0:
                break
            code, _ = self._next_error(doing)
        if first[0] != 0:
            raise self._refused(doing, *first)

    def _next_error(self, doing: str, question: str = NEXT_ERROR) -> tuple[int, str]:
        try:
            return decode_error(self._wire.ask(question))
        except ScpiError as error:
            self._wire.in_step = False
            raise BadAnswer(NAME, doing, str(error), "ask again") from None

    def _refused(self, doing: str, code: int, text: str) -> Refused:
        return Refused(NAME, doing, f"it answers {code}, {text}", "check range and averaging in the rig file")

    def _have(self, command: str | None, what: str) -> str:
        if command is None:
            raise Refused(NAME, "set it up", f"a {self._dialect.name} has not {what}", "change the rig file")
        return command
