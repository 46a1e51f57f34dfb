"""Execution of one row: mount, warm up, or move to pose and wavelength, open the shutter, read, and read the positions back.

The rules are here, once for rows over the wires (`rig_executor`) and without them (`rehearsal.without_wires`).
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Generic, TypeVar

import numpy as np

from goniotwin.app.campaign.readout import (
    MONITOR_MEAN_S,
    NOT_WARM,
    UNDER_RANGE,
    WARM_UP_PERIOD_S,
    ReadingComparison,
    WarmUpTrace,
    read_row,
    shows_light,
)
from goniotwin.app.campaign.row import CONTRADICTION, NO_SAMPLE, Reading, Row, RowData
from goniotwin.app.campaign.running.events import LightChanged
from goniotwin.app.rig import AXES
from goniotwin.arrays import Counts, Floats
from goniotwin.drivers.monochromator import FilterWheel
from goniotwin.drivers.photodiodes.description import ConverterDescription

WARM_UP_EVENT_PERIOD_S = 60.0
"""Time between two events of a warm-up in the journal."""
LogEvent = Callable[[str, str, str], None]
"""Function that writes an event to the journal: kind, text, and the place, which the text may begin with."""
Action = TypeVar("Action")
"""An action that was started and may not be done."""


class RowExecutor(ABC, Generic[Action]):
    """Executes rows. What a row needs of a rig are the abstract methods: each starts an action, or does it.

    `on_light` gets wavelength and shutter when they change.
    """

    def __init__(
        self,
        settings: ConverterDescription,
        wheel: FilterWheel,
        log_event: LogEvent = lambda _kind, _text, _place: None,
        on_light: Callable[[LightChanged], object] = lambda _: None,
    ) -> None:
        self._settings = settings
        self._wheel = wheel
        self._log_event = log_event
        self._comparison = ReadingComparison(settings)
        self._on_light = on_light
        self._light = LightChanged(None, None)
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

    @property
    def shutter_may_be_open(self) -> bool:
        """Whether the shutter is open or its state is unknown."""
        return self._shutter_open is not False

    def remember(self, row: Row, data: RowData) -> None:
        """Use what a row shows for the rows that follow: the level of a dark reading, the scatter of the light."""
        self._comparison.remember(data.readings, lit=row.kind != "dark")

    def execute(self, row: Row) -> RowData:
        """Execute one row. Raises DeviceError where a device fails (the row then has no data), Stopped, UserError."""
        started = self.now()
        if row.kind == "mount":
            self.set_shutter(opened=False)
            self._mount(row.sample)
            return RowData(started, self.now(), None, ())
        if row.kind == "dark":
            self.set_shutter(opened=False)
            self._settle(())
        else:
            self._settle(self._move(row))
        if row.kind == "warm-up":
            flags = self._warm_up(row)
            return RowData(started, self.now(), None, (), flags)
        readings, flags = self._read(row)
        positions = None if row.kind == "dark" else self._positions()
        data = RowData(started, self.now(), positions, readings, flags)
        self.remember(row, data)
        return data

    def set_shutter(self, *, opened: bool) -> None:
        """Open or close the shutter, unless it is in this state already."""
        if self._shutter_open is not opened:
            self.wait(self._start_shutter(opened=opened))
            self._shutter_open = opened
            self._show_light(shutter_open=opened)

    def _shutter_is_moving(self) -> None:
        """Until it is confirmed its state is unknown: a stop may come in between."""
        self._shutter_open = None
        self._show_light(shutter_open=None)

    def _move(self, row: Row) -> list[str]:
        """Move axes and monochromator to the row's settings, and open the shutter; return the axes that were moved."""
        started: list[Action] = []
        moved: list[str] = []
        for name, target in zip(AXES, row.pose or (), strict=row.pose is not None):
            if self._commanded.get(name) != target:
                started.append(self._start_axis(name, target))
                self._commanded[name] = target
                moved.append(name)
        wavelength = row.wavelength_nm
        if wavelength is not None and wavelength != self._wavelength_nm:
            order_filter = self._wheel.at(wavelength)
            if order_filter is not None and order_filter.position != self._filter:
                started.append(self._start_filter(order_filter.position))
                self._filter = order_filter.position
            started.append(self._start_wavelength(wavelength))
            self._wavelength_nm = wavelength
            self._show_light(wavelength_nm=None)
        self.wait(*started)
        if wavelength is not None and wavelength != self._light.wavelength_nm:
            self._show_light(wavelength_nm=wavelength)
        self.set_shutter(opened=True)
        return moved

    def _positions(self) -> dict[str, float | None]:
        """Positions of all axes in degrees, and that of the filter wheel when it was set."""
        positions = self._read_back()
        if self._filter is not None:
            positions["filter"] = float(self._filter)
        return positions

    def _read(self, row: Row) -> tuple[tuple[Reading, ...], tuple[str, ...]]:
        """Read all photodiodes at each gain that the row needs; return the readings by ascending gain, and the row's flags."""
        taken: dict[int, Reading] = {}
        contradiction = False

        def take(gain: int, count: int) -> Counts:
            nonlocal contradiction
            if gain != self._gain:
                self.wait(self._start_gain(gain))
                self._gain = gain
            taken[gain], contradicts = self._take(row, gain, count, taken.get(gain))
            contradiction |= contradicts
            return taken[gain].counts

        flags = read_row(row, self._settings, self._gain, self._dark_counts, take)
        readings = tuple(taken[gain] for gain in sorted(taken))
        flags = (*flags, *self._under_range(row, readings))
        return readings, (*flags, CONTRADICTION) if contradiction else flags

    def _dark_counts(self, gain: int) -> Floats:
        """The dark reading (photodiodes,) at a gain; without one the count of 0 V."""
        dark = self._comparison.dark_levels.get(self._settings.gains_v_per_a[gain])
        return np.full(self._settings.count, self._settings.range.zero) if dark is None else dark.mean

    def _under_range(self, row: Row, readings: tuple[Reading, ...]) -> tuple[str, ...]:
        """The flag UNDER_RANGE where the row should show light and does not. Without a dark reading there is no flag."""
        if row.kind == "dark" or row.sample == NO_SAMPLE or not readings:
            return ()
        dark = self._comparison.dark_levels.get(readings[-1].gain_v_per_a)
        return () if dark is None or shows_light(readings[-1].counts, dark.mean) else (UNDER_RANGE,)

    def _warm_up(self, row: Row) -> tuple[str, ...]:
        """Wait until the monitor is steady or the time limit is reached; log the monitor's slope once a minute."""
        assert row.target is not None
        started = logged = self.now()
        trace = WarmUpTrace()
        while True:
            current_a = self._monitor_mean_a(MONITOR_MEAN_S)
            now = self.now()
            trace.add(now, current_a)
            steady, timed_out = trace.is_steady(row.target), now - started >= row.longest_s
            slope = trace.slope()
            if slope is not None and (steady or timed_out or now - logged >= WARM_UP_EVENT_PERIOD_S):
                logged = now
                change, u = (100.0 * relative for relative in slope)
                self._log_event("warm-up", f"monitor {current_a:.6g} A, {change:+.3f} % in 10 min (u {u:.3f} %)", "lamp")
            if steady or timed_out:
                return () if steady else (NOT_WARM,)
            self._wait_until(now + WARM_UP_PERIOD_S - MONITOR_MEAN_S)

    # ---- what a row needs of a rig ----

    @abstractmethod
    def now(self) -> float:
        """The time on the rig's clock, s."""

    @abstractmethod
    def wait(self, *started: Action) -> None:
        """Wait until all actions are done. Raises DeviceError, Stopped."""

    @abstractmethod
    def _wait_until(self, t: float) -> None:
        """Wait until a time on the rig's clock, s."""

    @abstractmethod
    def _mount(self, sample: str) -> None:
        """Have a sample mounted."""

    @abstractmethod
    def _start_shutter(self, *, opened: bool) -> Action:
        """Open or close the shutter; `_shutter_is_moving` before anything is sent."""

    @abstractmethod
    def _start_axis(self, name: str, target_deg: float) -> Action:
        """Move an axis to an angle."""

    @abstractmethod
    def _start_filter(self, position: int) -> Action:
        """Turn the filter wheel to a position."""

    @abstractmethod
    def _start_wavelength(self, wavelength_nm: float) -> Action:
        """Change the wavelength."""

    @abstractmethod
    def _settle(self, axes: Sequence[str]) -> None:
        """Wait until the axes that have arrived are at rest."""

    @abstractmethod
    def _start_gain(self, gain: int) -> Action:
        """Set the gain of all amplifiers."""

    @abstractmethod
    def _take(self, row: Row, gain: int, count: int, before: Reading | None) -> tuple[Reading, bool]:
        """Take readings at the gain that is set, after those `before`: all of them, and whether they contradict each other."""

    @abstractmethod
    def _monitor_mean_a(self, seconds: float) -> float:
        """The mean current of the monitor over some time from now on, A."""

    @abstractmethod
    def _read_back(self) -> dict[str, float | None]:
        """The positions of all axes, and their encoders, in degrees."""
