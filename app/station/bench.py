"""Work on the bench: one move, one setting, one reading at a time, in the engine's thread. No journal."""

from collections.abc import Callable
from functools import partial

import numpy as np

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.running.rig_executor import AxisSettling
from goniotwin.app.campaign.running.stop import StopRequest
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig
from goniotwin.app.station.messages import BenchChanged, BenchReading
from goniotwin.drivers import DeviceError, Pending, Rig, wait
from goniotwin.drivers.monitor.monitor import MonitorMean
from goniotwin.drivers.photodiodes.array import Readings

Tick = Callable[[], None]


class Bench:
    """The settings of a rig that a person works on, and the actions that change them. All but `stop` in one thread.

    `between` is called between polls. Raises DeviceError where a device fails, and Stopped after `stop`.
    """

    def __init__(self, opened: OpenRig, between: Tick) -> None:
        self.opened = opened
        self._rig = opened.rig
        self._clock = opened.rig.clock
        self._between = between
        self._filter: int | None = None
        self.opened_shutter = False
        """Whether the shutter may be open because of this bench."""
        self.settings = BenchChanged()
        self.request = StopRequest(opened.rig)

    def look(self) -> None:
        """Ask for wavelength and shutter; what does not respond is unknown. Nothing moves."""
        self._filter = None
        monochromator = self._rig.monochromator
        try:
            self._set(wavelength_nm=monochromator.wavelength_nm(), shutter_open=monochromator.shutter_is_open(), gain=None)
        except DeviceError:
            self._set(wavelength_nm=None, shutter_open=None, gain=None)

    def take_over(self, gain: int | None, sample: str | None) -> None:
        """Note what a run has left: the gain by its index, and the sample that it has mounted, if any."""
        gains = self._rig.photodiodes.settings.gains_v_per_a
        self._set(gain=None if gain is None else gains[gain])
        if sample is not None:
            self._set(sample=sample)

    def move(self, axis: str, target_deg: float) -> None:
        """Move an axis to an angle; one whose encoder contradicts becomes unreferenced, and Unreferenced is raised."""
        self._wait(self.request.start(partial(self._rig.start, axis, target_deg)))
        moved = self._rig.axes[axis]
        self._wait(AxisSettling(self._clock, [moved], self._clock.now() + moved.settings.settling_s))
        moved.read_back()

    def home(self, axis: str) -> None:
        """Home an axis."""
        self._wait(self.request.start(self._rig.axes[axis].start_homing))

    def set_wavelength(self, wavelength_nm: float) -> None:
        """Set the wavelength, and the order filter that it needs."""
        monochromator = self._rig.monochromator
        order_filter = monochromator.settings.wheel.at(wavelength_nm)
        self._set(wavelength_nm=None)
        if order_filter is not None and order_filter.position != self._filter:
            self._wait(self.request.start(partial(monochromator.start_filter, order_filter.position)))
            self._filter = order_filter.position
        self._wait(self.request.start(partial(monochromator.start_wavelength, wavelength_nm)))
        self._set(wavelength_nm=wavelength_nm)

    def set_shutter(self, *, opened: bool) -> None:
        """Open or close the shutter."""
        self._set(shutter_open=None)
        self.opened_shutter = self.opened_shutter or opened
        self._wait(self.request.start(partial(self._rig.monochromator.start_shutter, opened=opened)))
        self.opened_shutter = opened
        self._set(shutter_open=opened)

    def close_left_open(self) -> None:
        """Close a shutter that an earlier program has left open. Raises DeviceError."""
        self.opened_shutter = True  # the end of the bench tries it again
        self.close_shutter()

    def close_shutter(self) -> None:
        """Close the shutter if this bench has opened it, also after a stop. Raises DeviceError."""
        if self.opened_shutter:
            wait(self._clock, [self._rig.monochromator.start_shutter(opened=False)])
            self.opened_shutter = False
            self._set(shutter_open=False)

    def set_gain(self, gain: int) -> None:
        """Set the gain, by its index in the rig's list."""
        self._set(gain=None)
        self._wait(self._rig.photodiodes.start_gain(gain))
        self._set(gain=self._rig.photodiodes.settings.gains_v_per_a[gain])

    def read(self, readings: int, *, dark: bool) -> BenchReading:
        """A reading of all photodiodes; `dark` with the shutter closed, which is then as it was."""
        was_open = self.settings.shutter_open
        if dark and was_open is not False:
            self.set_shutter(opened=False)
        if self.settings.gain_v_per_a is None:
            self.set_gain(0)
        pending = PendingReading(self._rig, self.settings, readings)
        self._wait(pending)
        if dark and was_open:
            self.set_shutter(opened=True)
        return pending.result

    def start_live(self, *, settled: bool) -> "PendingReading":
        """Start the next live reading, without a wait if the amplifiers have `settled`. Raises DeviceError."""
        if self.settings.gain_v_per_a is None:
            self.set_gain(0)
            settled = False
        return PendingReading(self._rig, self.settings, 1, live=True, settled=settled)

    def set_live(self, on: bool) -> None:
        """Note whether live readings are taken."""
        self._set(live=on)

    def mount(self, sample: str) -> None:
        """Mount a sample in a virtual rig. Raises UserError for one that it does not have."""
        try:
            operator_for(self.opened, self.opened.file, None).mount(sample)
        except KeyError as error:
            raise UserError(f"{sample}: {error.args[0] if error.args else 'there is no such sample'}") from None
        self._set(sample=sample)

    def _wait(self, pending: Pending) -> None:
        def between() -> None:
            self.request.check()
            self._between()

        wait(self._clock, [pending], between)
        self.request.check()

    def _set(self, **changes: object) -> None:
        known = vars(self.settings)
        if "gain" in changes:
            changes["gain_v_per_a"] = changes.pop("gain")
        self.settings = BenchChanged(**{**known, **changes})


class PendingReading:
    """A reading of photodiodes and monitor in progress: a `Pending`, polled by one exchange at a time."""

    def __init__(self, rig: Rig, settings: BenchChanged, readings: int, *, live: bool = False, settled: bool = False) -> None:
        self._rig = rig
        self._settings = settings
        self._live = live
        self._photodiodes: Readings = rig.photodiodes.start_readings(readings, settled=settled)
        self._seconds = readings * rig.photodiodes.settings.period_s
        self._mean: MonitorMean | None = None
        self._left: list[Pending] = []
        self.due = self._photodiodes.started - rig.photodiodes.settings.period_s

    def poll(self) -> bool:
        """Start the monitor's mean, or poll what is due. Raises DeviceError."""
        if self._mean is None:  # a channel's first reading was converted up to one period ago: the mean begins with it
            self._mean = self._rig.monitor.start_mean(self._seconds)
            self._left = [self._photodiodes, self._mean]
        else:
            first = min(self._left, key=lambda each: each.due)
            if first.poll():
                self._left.remove(first)
        self.due = min((each.due for each in self._left), default=self.due)
        return not self._left

    @property
    def result(self) -> BenchReading:
        """The reading, when it is done."""
        counts, settings = self._photodiodes.counts, self._settings
        converter = self._rig.photodiodes.settings.range
        mean, saturated = counts.mean(axis=0), np.any(self._photodiodes.saturated, axis=0).tolist()
        volts = [None if over else float(value) for value, over in zip(converter.volts(mean), saturated, strict=True)]
        assert self._mean is not None
        return BenchReading(
            t_s=self._photodiodes.started,
            readings=len(counts),
            gain_v_per_a=settings.gain_v_per_a or 0.0,
            counts=tuple(mean.tolist()),
            volts=tuple(volts),
            saturated=tuple(saturated),
            monitor_a=self._mean.current_a,
            wavelength_nm=settings.wavelength_nm,
            dark=settings.shutter_open is False,
            live=self._live,
        )
