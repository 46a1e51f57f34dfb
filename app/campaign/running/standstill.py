"""Axes that have arrived, until they have settled: as long as the rig file says, and until their encoders stand."""

from collections.abc import Sequence

from goniotwin.drivers import DeviceError
from goniotwin.drivers.axis import Axis
from goniotwin.protocols.clock import Clock

STILL_DEG = 0.005
"""Between two looks a standing axis' encoder changes by less."""
BETWEEN_S = 0.03
LONGEST_S = 5.0


class Standstill:
    """Done at `settled` where the encoders stand by then, as soon as they do else. One axis is asked a poll."""

    def __init__(self, clock: Clock, axes: Sequence[Axis], settled: float) -> None:
        self._clock = clock
        self._axes = [axis for axis in axes if axis.settings.encoder]
        self._settled = settled
        self._before: list[float] = []
        self._now: list[float] = []
        self._stands = not self._axes
        self.due = settled if self._stands else max(clock.now(), settled - 2.0 * BETWEEN_S)

    def poll(self) -> bool:
        """Asks the next encoder. Raises DeviceError where an axis does not come to rest."""
        if self._stands:
            return self._clock.now() >= self._settled
        self._now.append(self._axes[len(self._now)].encoder_deg() or 0.0)
        if len(self._now) == len(self._axes):
            self._compare()
        return False

    def _compare(self) -> None:
        ways = [abs(now - before) for now, before in zip(self._now, self._before, strict=False)]
        moving = [axis for axis, way in zip(self._axes, ways, strict=False) if way > STILL_DEG]
        self._stands = bool(ways) and not moving
        if moving and self._clock.now() > self._settled + LONGEST_S:
            raise DeviceError(
                moving[0].name, "come to rest", f"its encoder still moves {LONGEST_S:g} s after it has settled",
                "look what moves it; is its settling_s in the rig file too short?",
            )  # fmt: skip
        self._before, self._now = self._now, []
        self.due = max(self._settled, self._clock.now()) if self._stands else self._clock.now() + BETWEEN_S
