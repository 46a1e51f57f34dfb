"""What is done in a row: mounting, warming up, or pose and wavelength, shutter, readings, and where the axes are then.

Axes that have arrived, until they have settled: as long as the rig file says, and until their encoders stand.
"""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from goniotwin.app.campaign.journal.record import Reading, RowData
from goniotwin.app.campaign.readout import (
    MIN_AVERAGED_READINGS,
    MONITOR_MEAN_S,
    NOT_WARM,
    UNDER_RANGE,
    WARM_UP_PERIOD_S,
    GainSequence,
    WarmUpTrace,
    readings_needed,
    saturation,
    shows_light,
)
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.campaign.running.stop_request import StopRequest
from goniotwin.app.rig import AXES
from goniotwin.arrays import Counts, Flags, Floats
from goniotwin.drivers import AxisSettings, DeviceError, Pending, Rig, Until, wait
from goniotwin.drivers.motion import Axis
from goniotwin.drivers.motion.settings import ENCODER_TOLERANCE_DEG
from goniotwin.protocols.clock import Clock

STILL_DEG = 0.005
"""Between two looks a standing axis' encoder changes by less."""
BETWEEN_S = 0.03
LONGEST_S = 5.0


class AxisSettling:
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


Note = Callable[[str, str], None]
"""Takes a kind and a text for the journal."""


class RowExecutor:
    """Carries rows out on a rig, and knows what it has told the devices, so that nothing is told twice.

    `between` is called before each question while it waits, `note` with what belongs into the journal beside the row.
    """

    def __init__(self, rig: Rig, operator: Operator, halt: StopRequest, between: Callable[[], None], note: Note) -> None:
        self._rig = rig
        self._clock = rig.clock
        self._operator = operator
        self._halt = halt
        self._between = between
        self._note = note
        self._darks: dict[float, Floats] = {}
        self._apart: set[str] = set()
        self.forget()

    def forget(self) -> None:
        """What the devices were told is not to be relied on: with the next row all of it is told again."""
        self._commanded: dict[str, float] = {}
        self._wavelength_nm: float | None = None
        self._filter: int | None = None
        self._shutter_open: bool | None = None
        self._gain: int | None = None

    def remember(self, dark: RowData) -> None:
        """A dark, for what comes after it."""
        for reading in dark.readings:
            self._darks[reading.gain_v_per_a] = reading.counts.mean(axis=0)

    def perform(self, row: Row) -> RowData:
        """One row. Raises DeviceError where a device fails: there is no row then; Stopped; UserError."""
        started = self._clock.now()
        if row.kind == "mount":
            self.shutter(opened=False)
            self._operator.mount(row.sample)
            self._halt.heed()
            return RowData(started, self._clock.now(), None, ())
        if row.kind == "dark":
            self.shutter(opened=False)
            readings, flags = self._read(row)
            dark = RowData(started, self._clock.now(), None, readings, flags)
            self.remember(dark)
            return dark
        self._move(row)
        if row.kind == "warm-up":
            flags = self._warm_up(row)
            return RowData(started, self._clock.now(), None, (), flags)
        readings, flags = self._read(row)
        positions = self.read_back()
        return RowData(started, self._clock.now(), positions, readings, flags)

    def shutter(self, *, opened: bool) -> None:
        """Opens or closes it, where it is not so already."""
        if self._shutter_open is not opened:
            started = self._halt.start(lambda: self._rig.monochromator.start_shutter(opened=opened))
            self.wait(started)
            self._shutter_open = opened

    @property
    def shutter_may_be_open(self) -> bool:
        """Unless it is known to be closed."""
        return self._shutter_open is not False

    def read_back(self) -> dict[str, float | None]:
        """Counters and encoders of all axes, in degrees, and at which position the filter wheel was found when it was set.

        Raises DeviceError where an axis is lost: there is no row of it then.
        """
        found: dict[str, float | None] = {}
        for name, axis in self._rig.axes.items():
            here, encoder = axis.read_back()
            found[name] = here
            if encoder is not None:
                found[f"{name}_encoder"] = encoder
                self._tell_apart(name, encoder - here, axis.settings)
        if self._filter is not None:
            found["filter"] = float(self._filter)
        return found

    def _tell_apart(self, name: str, ahead_deg: float, settings: AxisSettings) -> None:
        """Once, of an axis whose encoder stands off within what its backlash allows: approached from one side it should not."""
        if abs(ahead_deg) > ENCODER_TOLERANCE_DEG and name not in self._apart:
            self._apart.add(name)
            self._note(
                "encoder",
                f"{name}: the encoder is {ahead_deg:+.3f} deg ahead of the counter, which its backlash allows; but every move "
                f"arrives from {settings.approach_from}, so that its zero is off by as much, and each angle with it: "
                f"home it, or say where it is, coming from {settings.approach_from}",
            )

    def wait(self, *started: Pending) -> None:
        """Until all are done. Raises DeviceError, Stopped."""
        wait(self._clock, started, self._between)
        self._halt.heed()  # a stop may have come with the last answer

    def _move(self, row: Row) -> None:
        """Axes and wavelength to the row's, shutter open, everything at rest and settled."""
        settling = 0.0
        moves: list[Pending] = []
        moved = []
        for name, target in zip(AXES, row.pose or (), strict=row.pose is not None):
            if self._commanded.get(name) != target:
                moves.append(self._halt.start(partial(self._rig.start, name, target)))
                self._commanded[name] = target
                axis = self._rig.axes[name]
                moved.append(axis)
                settling = max(settling, axis.settings.settling_s)
        wavelength = row.wavelength_nm
        if wavelength is not None and wavelength != self._wavelength_nm:
            monochromator = self._rig.monochromator
            sorting = monochromator.settings.wheel.at(wavelength)
            if sorting is not None and sorting.position != self._filter:
                moves.append(self._halt.start(partial(monochromator.start_filter, sorting.position)))
                self._filter = sorting.position
            moves.append(self._halt.start(lambda: monochromator.start_wavelength(wavelength)))
            self._wavelength_nm = wavelength
        self.wait(*moves)
        self.shutter(opened=True)
        if moved:
            self.wait(AxisSettling(self._clock, moved, self._clock.now() + settling))

    def _read(self, row: Row) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
        """All photodiodes at each gain that is needed, and the flags of the row."""
        gains = GainSequence(row, self._rig.photodiodes.settings.count, self._gain)
        taken = {}
        for gain in gains:
            reading = self._averaged(row, gain, gains.saturated)
            taken[gain] = reading
            gains.add(reading.counts)
        readings = tuple(taken[gain] for gain in sorted(taken))
        return readings, (*gains.flags, *self._under_range(row, readings))

    def _under_range(self, row: Row, readings: tuple[Reading, ...]) -> tuple[str, ...]:
        """Its flag, where the row should show light and does not. Without a dark nothing is said."""
        if row.kind == "dark" or row.sample == NO_SAMPLE or not readings:
            return ()
        dark = self._darks.get(readings[-1].gain_v_per_a)
        return () if dark is None or shows_light(readings[-1].counts, dark) else (UNDER_RANGE,)

    def _averaged(self, row: Row, gain: int, wanted: Flags) -> Reading:
        """At one gain: as many readings as the row says, or as its target needs."""
        if row.target is None:
            return self._reading(gain, row.readings)
        reading = self._reading(gain, max(row.readings, MIN_AVERAGED_READINGS))
        settings = self._rig.photodiodes.settings
        nothing = np.full(settings.count, -settings.range.low_v / settings.range.lsb_v)
        dark = self._darks.get(settings.gains_v_per_a[gain], nothing)
        most = max(row.readings, int(row.longest_s / settings.period_s))
        while (needed := readings_needed(reading.counts, dark, wanted & ~saturation(reading.counts), row.target, most)) > len(
            reading.counts
        ):
            reading = _joined(reading, self._reading(gain, needed - len(reading.counts)))
        return reading

    def _reading(self, gain: int, count: int) -> Reading:
        """All photodiodes so many times, and the monitor over the same time."""
        photodiodes, monitor = self._rig.photodiodes, self._rig.monitor
        settings = photodiodes.settings
        if gain != self._gain:
            self.wait(photodiodes.start_gain(gain))
            self._gain = gain
        readings = photodiodes.start_readings(count)
        # A channel's first reading was converted up to a period ago: the monitor begins with it.
        self.wait(Until(self._clock, readings.started - settings.period_s))
        mean = monitor.start_mean(count * settings.period_s)
        self.wait(readings, mean)
        return Reading(settings.gains_v_per_a[gain], readings.started, settings.period_s, mean.current_a, readings.counts)

    def _warm_up(self, row: Row) -> tuple[str, ...]:
        """Until the monitor is steady or the time is up; how steady it is goes to the journal once a minute."""
        assert row.target is not None
        begun = told = self._clock.now()
        trace = WarmUpTrace()
        while True:
            mean = self._rig.monitor.start_mean(MONITOR_MEAN_S)
            self.wait(mean)
            now = self._clock.now()
            trace.add(now, mean.current_a)
            steady, over = trace.is_steady(row.target), now - begun >= row.longest_s
            slope = trace.slope()
            if slope is not None and (steady or over or now - told >= 60.0):
                told = now
                change, spread = (100.0 * share for share in slope)
                self._note("warm-up", f"monitor {mean.current_a:.6g} A, {change:+.3f} % in 10 min (u {spread:.3f} %)")
            if steady or over:
                return () if steady else (NOT_WARM,)
            self.wait(Until(self._clock, now + WARM_UP_PERIOD_S - MONITOR_MEAN_S))


def _joined(first: Reading, second: Reading) -> Reading:
    """Two lots at one gain as one: the monitor's mean weighted, the period so that its middle is that of all readings."""
    counts: Counts = np.concatenate([first.counts, second.counts])
    a, b = len(first.counts), len(second.counts)
    middles = [each.first_s + 0.5 * (len(each.counts) - 1) * each.period_s for each in (first, second)]
    middle = (a * middles[0] + b * middles[1]) / (a + b)
    monitor = (a * first.monitor_a + b * second.monitor_a) / (a + b)
    return Reading(first.gain_v_per_a, first.first_s, 2.0 * (middle - first.first_s) / (a + b - 1), monitor, counts)
