"""What a quantity was, and when: a converter asks for the light of a moment ago, after a command has changed it."""

from bisect import bisect_right
from typing import Generic, TypeVar

T = TypeVar("T")


class Timeline(Generic[T]):
    """The last `keep` values of a quantity, each with the time from which it holds."""

    def __init__(self, value: T, keep: int = 64) -> None:
        self._times = [float("-inf")]
        self._values = [value]
        self._keep = keep

    def set(self, t: float, value: T) -> None:
        """From `t` on it is `value`; what was to hold later than `t` is forgotten."""
        index = bisect_right(self._times, t)
        self._times[index:] = [t]
        self._values[index:] = [value]
        if len(self._times) > self._keep:
            del self._times[0], self._values[0]

    def at(self, t: float) -> T:
        """The value at `t`; for a time before the oldest kept, the oldest."""
        if t >= self._times[-1]:
            return self._values[-1]
        return self._values[max(0, bisect_right(self._times, t) - 1)]

    def before(self, t: float) -> tuple[T, float]:
        """The value before the last change up to `t`, and how long ago that change was, s."""
        index = max(0, bisect_right(self._times, t) - 1)
        return self._values[max(0, index - 1)], t - self._times[index]

    @property
    def last_change(self) -> float:
        """From when on the newest value holds, s."""
        return self._times[-1]
