"""A quantity that passes linearly from one value to another: the wavelength while the grating turns."""

from dataclasses import dataclass

from goniotwin.twin.plant.timeline import Timeline


@dataclass(frozen=True, slots=True)
class Pass:
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


class Slewing:
    """What the quantity was at any recent time; jumps and passes."""

    def __init__(self, value: float) -> None:
        self._passes = Timeline(Pass(float("-inf"), float("-inf"), value, value))

    def at(self, t: float) -> float:
        """The value at `t`."""
        return self._passes.at(t).at(t)

    def set(self, t: float, value: float) -> None:
        """It is `value` from `t` on."""
        self._passes.set(t, Pass(t, t, value, value))

    def slew(self, start: float, end: float, value: float) -> None:
        """From where it is at `start` it passes linearly to `value`, which it reaches at `end`."""
        self._passes.set(start, Pass(start, end, self.at(start), value))

    def stop(self, t: float) -> None:
        """It stays where it is at `t`."""
        self.set(t, self.at(t))

    @property
    def newest(self) -> Pass:
        """The last pass."""
        return self._passes.newest

    @property
    def last_change(self) -> float:
        """When the last pass ends, s."""
        return max(self._passes.last_change, self._passes.newest.end)
