"""What a quantity was, and when: a converter asks for the light of a moment ago, after a command has changed it.

A quantity that passes linearly from one value to another: the wavelength while the grating turns.
"""

from bisect import bisect_right
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")


class ChangingQuantity(Protocol):
    """A quantity that changes now and then: what it is now, and from when on it has been at rest there, s."""

    @property
    def newest(self) -> object: ...

    @property
    def last_change(self) -> float: ...


class History(Generic[T]):
    """The last `keep` values of a quantity, each with the time from which it holds; `newest` holds from `last_change` on."""

    def __init__(self, value: T, keep: int = 64) -> None:
        self.newest, self.last_change = value, float("-inf")
        self._times = [self.last_change]
        self._values = [value]
        self._keep = keep

    def set(self, t: float, value: T) -> None:
        """From `t` on it is `value`; what was to hold later than `t` is forgotten."""
        self.newest, self.last_change = value, t
        index = bisect_right(self._times, t)
        self._times[index:] = [t]
        self._values[index:] = [value]
        if len(self._times) > self._keep:
            del self._times[0], self._values[0]

    def at(self, t: float) -> T:
        """The value at `t`; for a time before the oldest kept, the oldest."""
        if t >= self.last_change:
            return self.newest
        return self._values[max(0, bisect_right(self._times, t) - 1)]

    def before(self, t: float) -> tuple[T, float]:
        """The value before the last change up to `t`, and how long ago that change was, s."""
        index = max(0, bisect_right(self._times, t) - 1)
        return self._values[max(0, index - 1)], t - self._times[index]

    def held_since(self, t: float) -> float:
        """From when on the value at `t` holds, s; for a time before the oldest kept, when that was set."""
        return self._times[max(0, bisect_right(self._times, t) - 1)]


@dataclass(frozen=True, slots=True)
class Slew:
    """From `first` at `start` to `last` at `end`, and there from then on."""

    start: float
    end: float
    first: float
    last: float

    def at(self, t: float) -> float:
        """The value at `t`."""
        if t >= self.end:
            return self.last
        if t <= self.start:
            return self.first
        return self.first + (self.last - self.first) * (t - self.start) / (self.end - self.start)


class SlewHistory:
    """What the quantity was at any recent time; jumps and passes."""

    def __init__(self, value: float) -> None:
        self._passes = History(Slew(float("-inf"), float("-inf"), value, value))

    def at(self, t: float) -> float:
        """The value at `t`."""
        return self._passes.at(t).at(t)

    def set(self, t: float, value: float) -> None:
        """It is `value` from `t` on."""
        self._passes.set(t, Slew(t, t, value, value))

    def slew(self, start: float, end: float, value: float) -> None:
        """From where it is at `start` it passes linearly to `value`, which it reaches at `end`."""
        self._passes.set(start, Slew(start, end, self.at(start), value))

    def stop(self, t: float) -> None:
        """It stays where it is at `t`."""
        self.set(t, self.at(t))

    @property
    def newest(self) -> Slew:
        """The last pass."""
        return self._passes.newest

    @property
    def last_change(self) -> float:
        """When the last pass ends, s."""
        return max(self._passes.last_change, self._passes.newest.end)
