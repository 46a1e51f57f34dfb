"""History of a quantity: a converter needs the light of a moment ago, after a command has changed it.

Also quantities that change linearly from one value to another, such as the wavelength while the grating turns.
"""

from bisect import bisect_right
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

T = TypeVar("T")


class ChangingQuantity(Protocol):
    """Quantity with a newest value, and the time `last_change`, s, since which it is constant."""

    @property
    def newest(self) -> object: ...

    @property
    def last_change(self) -> float: ...


class Changes:
    """Number of changes so far of the quantities that have it in common."""

    number = 0


class History(Generic[T]):
    """The last `keep` values of a quantity, each with its start time; `newest` holds from `last_change` on."""

    def __init__(self, value: T, keep: int = 64, changes: Changes | None = None) -> None:
        self._changes = changes if changes is not None else Changes()
        self.newest, self.last_change = value, float("-inf")
        self._times = [self.last_change]
        self._values = [value]
        self._keep = keep

    def set(self, t: float, value: T) -> None:
        """Set the value from `t` on. Values set for later times are dropped."""
        self._changes.number += 1
        self.newest, self.last_change = value, t
        index = bisect_right(self._times, t)
        self._times[index:] = [t]
        self._values[index:] = [value]
        if len(self._times) > self._keep:
            del self._times[0], self._values[0]

    def at(self, t: float) -> T:
        """Value at `t`; before the oldest stored time, the oldest value."""
        if t >= self.last_change:
            return self.newest
        return self._values[max(0, bisect_right(self._times, t) - 1)]

    def before(self, t: float) -> tuple[T, float]:
        """Value before the last change up to `t`, and the time since that change, s."""
        index = max(0, bisect_right(self._times, t) - 1)
        return self._values[max(0, index - 1)], t - self._times[index]

    def held_since(self, t: float) -> float:
        """Start time of the value at `t`, s; before the oldest stored time, that time."""
        return self._times[max(0, bisect_right(self._times, t) - 1)]


@dataclass(frozen=True, slots=True)
class Slew:
    """Linear change from `first` at `start` to `last` at `end`, constant afterwards."""

    start: float
    end: float
    first: float
    last: float

    def at(self, t: float) -> float:
        """Value at `t`."""
        if t >= self.end:
            return self.last
        if t <= self.start:
            return self.first
        return self.first + (self.last - self.first) * (t - self.start) / (self.end - self.start)


class SlewHistory:
    """History of a quantity that jumps or changes linearly."""

    def __init__(self, value: float, changes: Changes | None = None) -> None:
        self._slews = History(Slew(float("-inf"), float("-inf"), value, value), changes=changes)

    def at(self, t: float) -> float:
        """Value at `t`."""
        return self._slews.at(t).at(t)

    def set(self, t: float, value: float) -> None:
        """Set the value from `t` on."""
        self._slews.set(t, Slew(t, t, value, value))

    def slew(self, start: float, end: float, value: float) -> None:
        """Change linearly from the value at `start` to `value`, reached at `end`."""
        self._slews.set(start, Slew(start, end, self.at(start), value))

    def stop(self, t: float) -> None:
        """Keep the value that the quantity has at `t`."""
        self.set(t, self.at(t))

    @property
    def newest(self) -> Slew:
        """The last linear change."""
        return self._slews.newest

    @property
    def last_change(self) -> float:
        """End of the last linear change, s."""
        return max(self._slews.last_change, self._slews.newest.end)
