"""The monitor photodiode behind a Thorlabs PM100D: mean current over a stretch of time."""

import math
from dataclasses import dataclass

from drivers.errors import BadAnswer, DeviceError
from drivers.tap import Tap, no_tap
from drivers.usbtmc import UsbOpener, UsbTmc
from protocols.clock import Clock
from protocols.scpi import ScpiError, decode_error, decode_number, overloaded

NAME = "monitor"
LONGEST_READING_S = 1.0
ANSWER_MARGIN_S = 2.0e-3


@dataclass(frozen=True)
class MonitorSettings:
    """What the operator believes of the monitor: its range in A, its samples, how far one reading can be trusted."""

    range_a: float = 500e-9
    samples_per_s: float = 3000.0
    relative_uncertainty: float = 3.0e-4


class Monitor:
    """The instrument on USB."""

    def __init__(self, opener: UsbOpener, settings: MonitorSettings, clock: Clock, tap: Tap = no_tap) -> None:
        self._wire = UsbTmc(NAME, opener, tap=tap)
        self._clock = clock
        self.settings = settings
        self._averages = 0

    def connect(self) -> str:
        """Opens it, asks who it is, sets its range; returns its identity. Raises DeviceError."""
        self.close()
        self._wire.connect()
        identity = self._wire.ask("*IDN?").decode("ascii", "replace")
        self._wire.write("*CLS")
        self._wire.write("CONF:CURR")
        self._wire.write(f"SENS:CURR:RANG {self.settings.range_a:.1E}")
        self._averages = 0
        self._check_errors("set the range")
        return identity

    def close(self) -> None:
        """Gives it back."""
        self._wire.close()

    def start_mean(self, seconds: float) -> "MonitorMean":
        """Averages the current over about so many seconds from now. Raises DeviceError."""
        pieces = max(1, math.ceil(seconds / LONGEST_READING_S))
        averages = max(1, round(seconds / pieces * self.settings.samples_per_s))
        if averages != self._averages:
            self._wire.write(f"SENS:AVER:COUN {averages}")
            self._check_errors("set the averaging")
            self._averages = averages
        return MonitorMean(self._wire, self._clock, pieces, averages / self.settings.samples_per_s)

    def _check_errors(self, doing: str) -> None:
        answer = self._wire.ask("SYST:ERR?")
        try:
            code, text = decode_error(answer)
        except ScpiError as error:
            raise BadAnswer(NAME, doing, str(error)) from None
        if code != 0:
            raise DeviceError(NAME, doing, f"it answers {code}, {text}", "check range and averaging in the rig file")


class MonitorMean:
    """A mean under way, of one or more readings; `current_a` when it is done."""

    def __init__(self, wire: UsbTmc, clock: Clock, pieces: int, seconds: float) -> None:
        self._wire = wire
        self._clock = clock
        self._left = pieces
        self._seconds = seconds
        self._values: list[float] = []
        self._begin()

    @property
    def current_a(self) -> float:
        """The mean current, A."""
        return math.fsum(self._values) / len(self._values)

    def poll(self) -> bool:
        """Fetches the reading that is due, and starts the next one. Raises DeviceError."""
        answer = self._wire.read("READ?")
        try:
            value = decode_number(answer)
        except ScpiError as error:
            raise BadAnswer(NAME, "READ?", str(error)) from None
        if overloaded(value):
            raise DeviceError(NAME, "READ?", "the current is over the range", "set a wider range in the rig file")
        self._values.append(value)
        self._left -= 1
        if self._left:
            self._begin()
        return not self._left

    def _begin(self) -> None:
        self._wire.write("READ?")
        self.due = self._clock.now() + self._seconds + ANSWER_MARGIN_S
