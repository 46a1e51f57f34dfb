"""Readings on the bench: the signal of each photodiode over its place on the arc, and the trend of the monitor. No Qt."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np

from goniotwin.app.campaign.geometry.arcs import arc_channels, polar_deg
from goniotwin.app.campaign.geometry.directions import ARCS, Arc
from goniotwin.app.campaign.readout import LIGHT_THRESHOLD_STEPS, WarmUpTrace
from goniotwin.app.rig import RigFile

LEAST_INTERVAL_S = 0.5
"""Readings of the monitor that are closer in time are not kept: ten minutes of live readings would be thousands."""
PREFIXES = (("", 1.0), ("m", 1e-3), ("µ", 1e-6), ("n", 1e-9), ("p", 1e-12), ("f", 1e-15))


class Signal(StrEnum):
    """State of a photodiode in a reading. Dark: within LIGHT_THRESHOLD_STEPS converter steps of the dark reading, or below."""

    LIGHT = "light"
    DARK = "dark"
    SATURATED = "saturated"


@dataclass(frozen=True)
class Bar:
    """The signal of one photodiode: its number, its polar angle on its arc, and its photocurrent, None where saturated."""

    channel: int
    arc: Arc
    polar_deg: float
    current_a: float | None
    state: Signal


@dataclass(frozen=True)
class Bars:
    """A reading of all photodiodes at one gain. The scale runs from the least current that counts as light to full scale.

    `dark_subtracted`: whether there is a dark reading at this gain; without one the amplifiers' offsets are in the currents.
    """

    bars: tuple[Bar, ...]
    gain_v_per_a: float
    least_a: float
    full_scale_a: float
    dark_subtracted: bool
    shutter_open: bool | None

    def level(self, bar: Bar) -> float:
        """Where a bar ends on the logarithmic scale: 0 for none, 1 for full scale."""
        if bar.state is Signal.SATURATED:
            return 1.0
        if bar.state is Signal.DARK or bar.current_a is None:
            return 0.0
        return math.log(bar.current_a / self.least_a) / math.log(self.full_scale_a / self.least_a)

    def count(self, state: Signal) -> int:
        """Number of photodiodes in a state."""
        return sum(bar.state is state for bar in self.bars)

    @property
    def highest(self) -> Bar | None:
        """The photodiode with the highest current; None if all are dark or saturated."""
        lit = [bar for bar in self.bars if bar.state is Signal.LIGHT]
        return max(lit, key=lambda bar: bar.current_a or 0.0, default=None)

    @property
    def text(self) -> str:
        """The reading as a line of text."""
        parts = [f"{len(self.bars)} photodiodes at {self.gain_v_per_a:g} V/A"]
        if (top := self.highest) is not None and top.current_a is not None:
            parts.append(f"highest {current_text(top.current_a)} at {top.polar_deg:g}° of the {top.arc} arc")
        if saturated := self.count(Signal.SATURATED):
            parts.append(f"▲ {saturated} saturated")
        if dark := self.count(Signal.DARK):
            parts.append(f"▽ {dark} without light")
        if not self.dark_subtracted:
            parts.append("no dark reading yet")
        return "; ".join(parts)


@dataclass
class BenchReadings:
    """The readings of one rig: the latest one, the last dark reading at each gain, and the monitor's trend."""

    rig: RigFile
    trend: WarmUpTrace = field(default_factory=WarmUpTrace)
    _dark: dict[float, tuple[float, ...]] = field(default_factory=dict)
    _wavelength_nm: float | None = None

    def add_dark(self, gain_v_per_a: float, counts: Sequence[float]) -> None:
        """Take a dark reading, counts (photodiodes,)."""
        self._dark[gain_v_per_a] = tuple(counts)

    def add_monitor(self, t_s: float, current_a: float, wavelength_nm: float | None) -> None:
        """Take a reading of the monitor with light. At another wavelength the trend begins anew."""
        if wavelength_nm != self._wavelength_nm or (self.trend.times_s and t_s < self.trend.times_s[-1]):
            self.trend, self._wavelength_nm = WarmUpTrace(), wavelength_nm
        if not self.trend.times_s or t_s - self.trend.times_s[-1] >= LEAST_INTERVAL_S:
            self.trend.add(t_s, current_a)

    def bars(
        self,
        counts: Sequence[float],
        saturated: Sequence[bool],
        gain_v_per_a: float,
        shift_deg: float,
        shutter_open: bool | None = None,
    ) -> Bars:
        """The signals of a reading: mean counts and whether saturated (photodiodes,), at a gain and a shift of the arc."""
        converter = self.rig.photodiodes.range
        dark = self._dark.get(gain_v_per_a)
        steps = np.asarray(counts) - (np.full(len(counts), converter.zero) if dark is None else np.asarray(dark))
        per_step_a = converter.lsb_v / gain_v_per_a
        bars = []
        for arc in ARCS:
            for angle, channel in zip(polar_deg(self.rig, arc), arc_channels(self.rig, arc).tolist(), strict=True):
                step = float(steps[channel])
                state = (
                    Signal.SATURATED if saturated[channel] else Signal.LIGHT if step > LIGHT_THRESHOLD_STEPS else Signal.DARK
                )
                current = None if state is Signal.SATURATED else step * per_step_a
                bars.append(Bar(channel, arc, angle + shift_deg, current, state))
        full = (converter.highest - converter.zero) * per_step_a
        return Bars(tuple(bars), gain_v_per_a, LIGHT_THRESHOLD_STEPS * per_step_a, full, dark is not None, shutter_open)


def trend_text(trend: WarmUpTrace) -> str:
    """The monitor's current and its change in ten minutes, as a line of text."""
    if not trend.times_s:
        return "no reading of the monitor with light yet"
    text = current_text(trend.currents_a[-1])
    slope = trend.slope()
    if slope is None:
        return f"{text}; too few readings for its change"
    change, u = (100.0 * each for each in slope)
    return f"{text}, {change:+.2f} % in 10 min (u {u:.2f} %)".replace("-", "−")


def current_text(current_a: float, digits: int = 3) -> str:
    """A current with an SI prefix."""
    size = abs(current_a)
    prefix, factor = next((each for each in PREFIXES if size >= each[1]), PREFIXES[-1])
    return f"{current_a / factor:.{digits}g} {prefix}A".replace("-", "−")
