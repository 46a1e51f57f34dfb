"""Execution of rows on the devices of a rig, over the wires."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from goniotwin.app.campaign.journal.mounting import MOUNTED, mounting_text
from goniotwin.app.campaign.readout import READING_ATTEMPTS
from goniotwin.app.campaign.row import CONTRADICTION, Reading, Row
from goniotwin.app.campaign.running.events import LightChanged
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.rows import LogEvent, RowExecutor
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.arrays import Counts, Flags
from goniotwin.drivers import AxisDescription, DeviceError, Pending, Rig, Until, wait
from goniotwin.drivers.motion import Axis
from goniotwin.drivers.motion.settings import ENCODER_TOLERANCE_DEG
from goniotwin.protocols.clock import Clock

REST_TOLERANCE_DEG = 0.005
"""Largest change of an encoder between two polls of an axis at rest."""
ENCODER_POLL_S = 0.03
"""Time between two polls of the encoders."""
MAX_REST_TIME_S = 5.0
"""Longest time after the settling time in which the encoders must come to rest."""
MAX_LISTED_COUNTS = 16
"""Number of contradicting counts that an event has: a changed count is one, a changed request a module's eight."""
CLOSING_S = 4.0
"""Longest time in which a stop closes the shutter; within that of the whole stop, after which a second signal ends it."""
CLOSING_ATTEMPTS = 3


class RigExecutor(RowExecutor[Pending]):
    """Executes rows on a rig. `on_poll` is called between polls.

    Readings that contradict each other are taken again: a wire may change a count.
    """

    def __init__(
        self,
        rig: Rig,
        operator: Operator,
        stop_request: StopRequest,
        on_poll: Callable[[], None],
        log_event: LogEvent,
        *,
        on_light: Callable[[LightChanged], object] = lambda _: None,
    ) -> None:
        super().__init__(rig.photodiodes.settings, rig.monochromator.settings.wheel, log_event, on_light)
        self._rig = rig
        self._clock = rig.clock
        self._operator = operator
        self._stop_request = stop_request
        self._on_poll = on_poll
        self._encoder_warnings: set[str] = set()

    def now(self) -> float:
        """The time on the rig's clock, s."""
        return self._clock.now()

    def wait(self, *started: Pending) -> None:
        """Wait until all pending actions are done. Raises DeviceError, Stopped."""
        wait(self._clock, started, self._on_poll)
        self._stop_request.check()  # the stop may have come with the last answer

    def _wait_until(self, t: float) -> None:
        self.wait(Until(self._clock, t))

    def _mount(self, sample: str) -> None:
        record = self._operator.mount(sample)
        self._stop_request.check()
        if record is not None:
            self._log_event(MOUNTED, mounting_text(sample, record), sample)

    def _start_shutter(self, *, opened: bool) -> Pending:
        def start() -> Pending:
            self._shutter_is_moving()
            return self._rig.monochromator.start_shutter(opened=opened)

        return self._stop_request.start(start)

    def close_shutter_after_stop(self) -> bool:
        """Close the shutter, although the run was stopped, unless it is known to be closed; return whether it had to be.

        A stop aborts the statement in progress, and leaves the line out of step: so this is repeated, and anew after a further
        stop. Raises DeviceError where it is not done after CLOSING_ATTEMPTS or CLOSING_S.
        """
        if not self.shutter_may_be_open:
            return False
        deadline = self._clock.now() + CLOSING_S

        def check_time() -> None:
            if self._clock.now() > deadline:
                name = self._rig.monochromator.name
                raise DeviceError(name, "close the shutter", f"not done within {CLOSING_S:g} s", "check cable and power")

        attempt, steps = 0, self._stop_request.steps
        while True:
            try:
                wait(self._clock, [self._rig.monochromator.start_shutter(opened=False)], check_time)
                break
            except DeviceError:
                attempt += 1
                if steps != self._stop_request.steps:
                    attempt, steps, deadline = 0, self._stop_request.steps, self._clock.now() + CLOSING_S
                elif attempt == CLOSING_ATTEMPTS or self._clock.now() > deadline:
                    raise
        self._shutter_open = False
        self._show_light(shutter_open=False)
        return True

    def _start_axis(self, name: str, target_deg: float) -> Pending:
        return self._stop_request.start(partial(self._rig.start, name, target_deg))

    def _start_filter(self, position: int) -> Pending:
        return self._stop_request.start(partial(self._rig.monochromator.start_filter, position))

    def _start_wavelength(self, wavelength_nm: float) -> Pending:
        return self._stop_request.start(partial(self._rig.monochromator.start_wavelength, wavelength_nm))

    def _settle(self, axes: Sequence[str]) -> None:
        if axes:
            moved = [self._rig.axes[name] for name in axes]
            settling = max(0.0, *(axis.settings.settling_s for axis in moved))
            self.wait(AxisSettling(self._clock, moved, self._clock.now() + settling))

    def _read_back(self) -> dict[str, float | None]:
        """Counters and encoders of all axes in degrees.

        Raises DeviceError where an axis is unreferenced: the row then has no data.
        """
        positions: dict[str, float | None] = {}
        for name, axis in self._rig.axes.items():
            counter, encoder = axis.read_back()
            positions[name] = counter
            if encoder is not None:
                positions[f"{name}_encoder"] = encoder
                self._warn_about_encoder(name, encoder - counter, axis.settings)
        return positions

    def _warn_about_encoder(self, name: str, difference_deg: float, settings: AxisDescription) -> None:
        """Log an event, once per axis, where encoder and counter differ by more than the tolerance.

        The driver accepts a difference up to the backlash. But every move arrives from the same side, so that backlash cannot
        cause the difference.
        """
        if abs(difference_deg) > ENCODER_TOLERANCE_DEG and name not in self._encoder_warnings:
            self._encoder_warnings.add(name)
            self._log_event(
                "encoder",
                f"{name}: the encoder is {difference_deg:+.3f} deg ahead of the counter. That is within the backlash. But each "
                f"move arrives from {settings.approach_from}: the zero of the axis, and each of its angles, is off by as much. "
                f"Home the axis, or set its current position after a move from {settings.approach_from}",
                name,
            )

    def _start_gain(self, gain: int) -> Pending:
        return self._rig.photodiodes.start_gain(gain)

    def _take(self, row: Row, gain: int, count: int, before: Reading | None) -> tuple[Reading, bool]:
        for attempt in range(1, READING_ATTEMPTS + 1):
            taken = self._take_readings(gain, count)
            reading = taken if before is None else _merge(before, taken)
            contradicting = self._comparison.contradictions(reading, lit=row.kind != "dark")
            contradicting[: len(reading.counts) - count] = False  # accepted before
            if not contradicting.any():
                return reading, False
            self._log_contradiction(row, reading, contradicting, attempt)
        return reading, True

    def _log_contradiction(self, row: Row, reading: Reading, contradicting: Flags, attempt: int) -> None:
        """Log an event with the counts that contradict the others, as they were read."""
        counts, number = reading.counts, len(reading.counts)
        others = (counts.sum(axis=0) - counts.astype(np.float64)) / (number - 1)
        places = np.argwhere(contradicting).tolist()
        found = "; ".join(
            f"photodiode {channel} has the count {counts[k, channel]} in reading {k + 1} of {number}, the others "
            f"{others[k, channel]:.1f}"
            for k, channel in places[:MAX_LISTED_COUNTS]
        )
        found += f"; and {len(places) - MAX_LISTED_COUNTS} more counts" if len(places) > MAX_LISTED_COUNTS else ""
        last = attempt == READING_ATTEMPTS
        end = f"attempt {attempt}: kept, and the row is flagged; check the wire" if last else "the readings are taken again"
        what = f"readings at {reading.gain_v_per_a:g} V/A contradict each other: {found}"
        self._log_event(CONTRADICTION, f"{row.identity}: {what} ({end})", row.identity)

    def _take_readings(self, gain: int, count: int) -> Reading:
        """Read all photodiodes `count` times, and the mean of the monitor over the same time."""
        photodiodes, monitor = self._rig.photodiodes, self._rig.monitor
        settings = photodiodes.settings
        readings = photodiodes.start_readings(count)
        # A channel's first reading was converted up to one period ago: the monitor's mean begins with it.
        self.wait(Until(self._clock, readings.started - settings.period_s))
        mean = monitor.start_mean(count * settings.period_s)
        self.wait(readings, mean)
        return Reading(settings.gains_v_per_a[gain], readings.started, settings.period_s, mean.current_a, readings.counts)

    def _monitor_mean_a(self, seconds: float) -> float:
        mean = self._rig.monitor.start_mean(seconds)
        self.wait(mean)
        return mean.current_a


class AxisSettling:
    """Pending settling of axes that have arrived: done at `settled`, or later as soon as their encoders are at rest.

    One poll reads one encoder.
    """

    def __init__(self, clock: Clock, axes: Sequence[Axis], settled: float) -> None:
        self._clock = clock
        self._axes = [axis for axis in axes if axis.settings.encoder]
        self._settled = settled
        self._before: list[float] = []
        self._now: list[float] = []
        self._at_rest = not self._axes
        self.due = settled if self._at_rest else max(clock.now(), settled - 2.0 * ENCODER_POLL_S)

    def poll(self) -> bool:
        """Read the next encoder; return whether the axes have settled. Raises DeviceError if an axis still moves."""
        if self._at_rest:
            return self._clock.now() >= self._settled
        self._now.append(self._axes[len(self._now)].encoder_deg() or 0.0)
        if len(self._now) == len(self._axes):
            self._compare()
        return False

    def _compare(self) -> None:
        changes = [abs(now - before) for now, before in zip(self._now, self._before, strict=False)]
        moving = [axis for axis, change in zip(self._axes, changes, strict=False) if change > REST_TOLERANCE_DEG]
        self._at_rest = bool(changes) and not moving
        if moving and self._clock.now() > self._settled + MAX_REST_TIME_S:
            raise DeviceError(
                moving[0].name,
                "come to rest",
                f"its encoder still moves {MAX_REST_TIME_S:g} s after the settling time",
                "find what moves the axis; is settling_s in the rig file too short?",
            )
        self._before, self._now = self._now, []
        self.due = max(self._settled, self._clock.now()) if self._at_rest else self._clock.now() + ENCODER_POLL_S


def _merge(first: Reading, second: Reading) -> Reading:
    """Merge two readings at one gain: the monitor's mean is weighted by their numbers of readings.

    The period is chosen such that the middle of the merged reading is the mean time of all its readings.
    """
    counts: Counts = np.concatenate([first.counts, second.counts])
    a, b = len(first.counts), len(second.counts)
    middles = [each.first_s + 0.5 * (len(each.counts) - 1) * each.period_s for each in (first, second)]
    middle = (a * middles[0] + b * middles[1]) / (a + b)
    monitor = (a * first.monitor_a + b * second.monitor_a) / (a + b)
    return Reading(first.gain_v_per_a, first.first_s, 2.0 * (middle - first.first_s) / (a + b - 1), monitor, counts)
