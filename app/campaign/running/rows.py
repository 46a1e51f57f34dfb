"""Execution of one row: mount, warm up, or move to pose and wavelength, open the shutter, read, and read the positions back."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from goniotwin.app.campaign.readout import (
    MONITOR_MEAN_S,
    NOT_WARM,
    READING_ATTEMPTS,
    UNDER_RANGE,
    WARM_UP_PERIOD_S,
    GainSequence,
    ReadingComparison,
    WarmUpTrace,
    further_readings,
    min_readings,
    shows_light,
)
from goniotwin.app.campaign.row import CONTRADICTION, NO_SAMPLE, Reading, Row, RowData
from goniotwin.app.campaign.running.events import LightChanged
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.rig import AXES
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
WARM_UP_EVENT_PERIOD_S = 60.0
"""Time between two events of a warm-up in the journal."""
LogEvent = Callable[[str, str, str], None]
"""Function that writes an event to the journal: kind, text, and the place, which the text may begin with."""
CLOSING_S = 4.0
"""Longest time in which a stop closes the shutter; within that of the whole stop, after which a second signal ends it."""
CLOSING_ATTEMPTS = 3


class RowExecutor:
    """Executes rows on a rig. `on_poll` is called between polls, and less often where `scripts` are handed to the wires.

    `on_light` gets wavelength and shutter when they change.
    """

    def __init__(
        self,
        rig: Rig,
        operator: Operator,
        stop_request: StopRequest,
        on_poll: Callable[[], None],
        log_event: LogEvent,
        *,
        scripts: bool = False,
        on_light: Callable[[LightChanged], object] = lambda _: None,
    ) -> None:
        self._rig = rig
        self._clock = rig.clock
        self._operator = operator
        self._stop_request = stop_request
        self._on_poll = on_poll
        self._log_event = log_event
        self._scripts = scripts
        self._comparison = ReadingComparison(rig.photodiodes.settings)
        self._on_light = on_light
        self._light = LightChanged(None, None)
        self._encoder_warnings: set[str] = set()
        self.forget_settings()

    def forget_settings(self, *, light: bool = False) -> None:
        """Forget the commanded settings, because the devices may have lost them: the next row sends all of them again.

        With `light` wavelength and shutter are unknown from then on.
        """
        self._commanded: dict[str, float] = {}
        self._filter: int | None = None
        self._gain: int | None = None
        self._wavelength_nm: float | None = None
        self._shutter_open: bool | None = None
        if light:
            self._show_light(wavelength_nm=None, shutter_open=None)

    def _show_light(self, **changes: float | bool | None) -> None:
        self._light = LightChanged(**{**vars(self._light), **changes})
        self._on_light(self._light)

    @property
    def gain(self) -> int | None:
        """The gain of all amplifiers, by its index; None where it is not known."""
        return self._gain

    def remember(self, row: Row, data: RowData) -> None:
        """Use what a row shows for the rows that follow: the level of a dark reading, the scatter of the light."""
        self._comparison.remember(data.readings, lit=row.kind != "dark")

    def execute(self, row: Row) -> RowData:
        """Execute one row. Raises DeviceError where a device fails (the row then has no data), Stopped, UserError."""
        started = self._clock.now()
        if row.kind == "mount":
            self.set_shutter(opened=False)
            self._operator.mount(row.sample)
            self._stop_request.check()
            return RowData(started, self._clock.now(), None, ())
        if row.kind == "dark":
            self.set_shutter(opened=False)
            readings, flags = self._read(row)
            dark = RowData(started, self._clock.now(), None, readings, flags)
            self.remember(row, dark)
            return dark
        self._move(row)
        if row.kind == "warm-up":
            flags = self._warm_up(row)
            return RowData(started, self._clock.now(), None, (), flags)
        readings, flags = self._read(row)
        positions = self.read_back()
        data = RowData(started, self._clock.now(), positions, readings, flags)
        self.remember(row, data)
        return data

    def set_shutter(self, *, opened: bool) -> None:
        """Open or close the shutter, unless it is in this state already."""

        def start() -> Pending:
            self._shutter_open = None  # until it is confirmed: a stop may come in between
            self._show_light(shutter_open=None)
            return self._rig.monochromator.start_shutter(opened=opened)

        if self._shutter_open is not opened:
            self.wait(self._stop_request.start(start))
            self._shutter_open = opened
            self._show_light(shutter_open=opened)

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

    @property
    def shutter_may_be_open(self) -> bool:
        """Whether the shutter is open or its state is unknown."""
        return self._shutter_open is not False

    def read_back(self) -> dict[str, float | None]:
        """Counters and encoders of all axes in degrees, and the position of the filter wheel when it was set.

        Raises DeviceError where an axis is unreferenced: the row then has no data.
        """
        positions: dict[str, float | None] = {}
        for name, axis in self._rig.axes.items():
            counter, encoder = axis.read_back()
            positions[name] = counter
            if encoder is not None:
                positions[f"{name}_encoder"] = encoder
                self._warn_about_encoder(name, encoder - counter, axis.settings)
        if self._filter is not None:
            positions["filter"] = float(self._filter)
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

    def wait(self, *started: Pending) -> None:
        """Wait until all pending actions are done. Raises DeviceError, Stopped."""
        wait(self._clock, started, self._on_poll, scripts=self._scripts)
        self._stop_request.check()  # the stop may have come with the last answer

    def _move(self, row: Row) -> None:
        """Move axes and monochromator to the row's settings, open the shutter, and wait until the axes have settled."""
        settling = 0.0
        moves: list[Pending] = []
        moved = []
        for name, target in zip(AXES, row.pose or (), strict=row.pose is not None):
            if self._commanded.get(name) != target:
                moves.append(self._stop_request.start(partial(self._rig.start, name, target)))
                self._commanded[name] = target
                axis = self._rig.axes[name]
                moved.append(axis)
                settling = max(settling, axis.settings.settling_s)
        wavelength = row.wavelength_nm
        if wavelength is not None and wavelength != self._wavelength_nm:
            monochromator = self._rig.monochromator
            order_filter = monochromator.settings.wheel.at(wavelength)
            if order_filter is not None and order_filter.position != self._filter:
                moves.append(self._stop_request.start(partial(monochromator.start_filter, order_filter.position)))
                self._filter = order_filter.position
            moves.append(self._stop_request.start(lambda: monochromator.start_wavelength(wavelength)))
            self._wavelength_nm = wavelength
            self._show_light(wavelength_nm=None)
        self.wait(*moves)
        if wavelength is not None and wavelength != self._light.wavelength_nm:
            self._show_light(wavelength_nm=wavelength)
        self.set_shutter(opened=True)
        if moved:
            self.wait(AxisSettling(self._clock, moved, self._clock.now() + settling))

    def _read(self, row: Row) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
        """Read all photodiodes at each gain that the row needs; return the readings by ascending gain, and the row's flags."""
        gains = GainSequence(row, self._rig.photodiodes.settings, self._gain)
        taken, contradiction = {}, False
        for gain in gains:
            taken[gain], contradicts = self._read_to_target(row, gain, gains.saturated)
            contradiction |= contradicts
            gains.add(taken[gain].counts)
        readings = tuple(taken[gain] for gain in sorted(taken))
        flags = (*gains.flags, *self._under_range(row, readings))
        return readings, (*flags, CONTRADICTION) if contradiction else flags

    def _under_range(self, row: Row, readings: tuple[Reading, ...]) -> tuple[str, ...]:
        """The flag UNDER_RANGE where the row should show light and does not. Without a dark reading there is no flag."""
        if row.kind == "dark" or row.sample == NO_SAMPLE or not readings:
            return ()
        dark = self._comparison.dark_levels.get(readings[-1].gain_v_per_a)
        return () if dark is None or shows_light(readings[-1].counts, dark.mean) else (UNDER_RANGE,)

    def _read_to_target(self, row: Row, gain: int, selected: Flags) -> tuple[Reading, bool]:
        """Read at one gain: the row's number of readings, or as many as its target uncertainty needs.

        Returns also whether there are readings that contradict each other in every attempt.
        """
        reading, contradiction = self._take_consistent_readings(row, gain, min_readings(row))
        settings = self._rig.photodiodes.settings
        dark = self._comparison.dark_levels.get(settings.gains_v_per_a[gain])
        level = np.full(settings.count, settings.range.zero) if dark is None else dark.mean
        while further := further_readings(row, reading.counts, level, selected, settings):
            reading, contradicts = self._take_consistent_readings(row, gain, further, reading)
            contradiction |= contradicts
        return reading, contradiction

    def _take_consistent_readings(self, row: Row, gain: int, count: int, before: Reading | None = None) -> tuple[Reading, bool]:
        """Take readings after those `before`, and again where they contradict; all of them, and whether they still do."""
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
        if gain != self._gain:
            self.wait(photodiodes.start_gain(gain))
            self._gain = gain
        readings = photodiodes.start_readings(count)
        # A channel's first reading was converted up to one period ago: the monitor's mean begins with it.
        self.wait(Until(self._clock, readings.started - settings.period_s))
        mean = monitor.start_mean(count * settings.period_s)
        self.wait(readings, mean)
        return Reading(settings.gains_v_per_a[gain], readings.started, settings.period_s, mean.current_a, readings.counts)

    def _warm_up(self, row: Row) -> tuple[str, ...]:
        """Wait until the monitor is steady or the time limit is reached; log the monitor's slope once a minute."""
        assert row.target is not None
        started = logged = self._clock.now()
        trace = WarmUpTrace()
        while True:
            mean = self._rig.monitor.start_mean(MONITOR_MEAN_S)
            self.wait(mean)
            now = self._clock.now()
            trace.add(now, mean.current_a)
            steady, timed_out = trace.is_steady(row.target), now - started >= row.longest_s
            slope = trace.slope()
            if slope is not None and (steady or timed_out or now - logged >= WARM_UP_EVENT_PERIOD_S):
                logged = now
                change, u = (100.0 * relative for relative in slope)
                self._log_event("warm-up", f"monitor {mean.current_a:.6g} A, {change:+.3f} % in 10 min (u {u:.3f} %)", "lamp")
            if steady or timed_out:
                return () if steady else (NOT_WARM,)
            self.wait(Until(self._clock, now + WARM_UP_PERIOD_S - MONITOR_MEAN_S))


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
                moving[0].name, "come to rest", f"its encoder still moves {MAX_REST_TIME_S:g} s after the settling time",
                "find what moves the axis; is settling_s in the rig file too short?",
            )  # fmt: skip
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
