"""A check of a device on the day it arrives: what is verified, whether something moves, and what must come."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from statistics import median
from typing import Any

from goniotwin.arrays import Floats
from goniotwin.drivers.device import Pending, wait
from goniotwin.drivers.errors import DeviceError, LimitError
from goniotwin.drivers.rig import Rig

REPLIES = 20
"""Number of exchanges of which the reply times are measured."""


class CheckVerdict(StrEnum):
    """The result of a check."""

    OK = "ok"
    DIFFERS = "differs"
    NOT_CHECKED = "cannot be checked here"


@dataclass(frozen=True)
class CheckOutcome:
    """A verdict, what was expected and what came."""

    verdict: CheckVerdict
    expected: str
    came: str


def judged(good: bool, expected: str, came: str) -> CheckOutcome:
    """The outcome of a comparison."""
    return CheckOutcome(CheckVerdict.OK if good else CheckVerdict.DIFFERS, expected, came)


def not_checked(reason: str, expected: str = "") -> CheckOutcome:
    """The outcome where a check is not possible."""
    return CheckOutcome(CheckVerdict.NOT_CHECKED, expected, reason)


@dataclass
class CheckSession:
    """A rig whose devices are connected, and the person beside it.

    `ask` puts a question and returns the answer, None where nobody can answer. `mount` has a sample mounted, and returns
    False where nobody can.
    """

    rig: Rig
    ask: Callable[[str], str | None]
    mount: Callable[[str], bool]
    opened_shutter: bool = field(default=False, init=False)

    def wait(self, *started: Pending) -> float:
        """Wait for actions; return how long, s. Raises DeviceError."""
        begun = self.rig.clock.now()
        wait(self.rig.clock, started)
        return self.rig.clock.now() - begun

    def move(self, axis: str, target_deg: float) -> None:
        """Move an axis and let it settle. Raises DeviceError, LimitError before anything is sent."""
        self.wait(self.rig.start(axis, target_deg))
        self.rig.clock.sleep_until(self.rig.clock.now() + self.rig.axes[axis].settings.settling_s)

    def connected(self, name: str) -> bool:
        """Whether a device is connected."""
        return name in self.rig.identities

    @contextmanager
    def open_shutter(self) -> Iterator[None]:
        """The shutter open for a while. Raises DeviceError."""
        monochromator = self.rig.monochromator
        self.opened_shutter = True
        try:
            self.wait(monochromator.start_shutter(opened=True))
            yield
        except DeviceError:
            self.close_shutter()
            raise
        self.close_shutter()  # after Ctrl-C the axes are stopped first

    def close_shutter(self) -> None:
        """Close the shutter if it may be open because of these checks. Raises DeviceError."""
        if self.opened_shutter:
            self.wait(self.rig.monochromator.start_shutter(opened=False))
            self.opened_shutter = False

    def volts(self, gain: int, readings: int = 10) -> Floats:
        """Mean of readings of all channels with a gain, by its index, V; NaN is saturated. Raises DeviceError."""
        photodiodes = self.rig.photodiodes
        self.wait(photodiodes.start_gain(gain))
        pending = photodiodes.start_readings(readings)
        self.wait(pending)
        return pending.mean_volts()

    def monitor_a(self, seconds: float = 0.5) -> float:
        """Mean current of the monitor, A. Raises DeviceError."""
        mean = self.rig.monitor.start_mean(seconds)
        self.wait(mean)
        return mean.current_a

    def reply_times(self, exchange: Callable[[], object], longest_s: float) -> CheckOutcome:
        """The outcome of some exchanges, by their duration."""
        times = []
        for _ in range(REPLIES):
            begun = self.rig.clock.now()
            exchange()
            times.append(self.rig.clock.now() - begun)
        came = f"median {1e3 * median(times):.1f} ms, longest {1e3 * max(times):.1f} ms of {REPLIES}"
        return judged(max(times) <= longest_s, f"at most {1e3 * longest_s:.0f} ms each", came)


@dataclass(frozen=True)
class DeviceCheck:
    """A check of a device of some make.

    `what` is verified, and `expected` must come. `facts` are the assumed rows of docs/rig/interoperability.md that it tests, by
    their first words. `run` takes the session, the device and one of its `subjects` (the device itself, or each axis).
    """

    what: str
    expected: str
    run: Callable[[CheckSession, Any, str], CheckOutcome]
    moves: bool = False
    facts: tuple[str, ...] = ()
    of_each_part: bool = False

    def subjects(self, device: Any) -> tuple[str, ...]:
        """What is checked one after the other."""
        return tuple(device.parts) if self.of_each_part else (device.name,)

    def outcome(self, session: CheckSession, device: Any, subject: str) -> CheckOutcome:
        """Carry the check out. A fault of the device is an outcome; nothing moves after it."""
        try:
            return self.run(session, device, subject)
        except LimitError as error:  # nothing was sent
            return not_checked(str(error), self.expected)
        except DeviceError as error:
            return CheckOutcome(CheckVerdict.DIFFERS, self.expected, str(session.rig.in_words(error)))


def identity_check(expected: str, facts: tuple[str, ...] = ()) -> DeviceCheck:
    """The first check of each device: it has been connected, and has identified itself."""

    def run(session: CheckSession, device: Any, _subject: str) -> CheckOutcome:
        return judged(True, expected, session.rig.identities[device.name])

    return DeviceCheck("identity", expected, run, facts=facts)
