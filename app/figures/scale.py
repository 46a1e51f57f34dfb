"""Scales of values, and their ticks: logarithmic, linear, symmetric logarithmic.

On a logarithmic scale a value that is zero or negative has no place, and a range without an end hides the others: so it has a
lower edge, by the values and their noise, and at most DECADES.
"""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, get_args

import numpy as np

from goniotwin.arrays import Flags, Floats

ScaleKind = Literal["log", "linear", "symlog"]
SCALES: tuple[ScaleKind, ...] = get_args(ScaleKind)
DECADES = 7
"""A logarithmic scale has no more of them."""
STEEP = 30.0
"""Ratio of the largest value to the tenth percentile from which the scale is logarithmic, if none is asked for."""
DIGITS: tuple[tuple[int, ...], ...] = (tuple(range(1, 10)), (1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,))
"""Ticks within a decade, from many to few."""
ROOM = 1.08
"""The end of a linear scale over the largest value."""


@dataclass(frozen=True)
class Scale:
    """A scale. `floor`: the lower edge of a logarithmic one; `top`: the largest value; symlog is linear to `threshold`."""

    kind: ScaleKind
    floor: float
    top: float
    threshold: float = 1.0

    @property
    def log(self) -> bool:
        """Whether it is logarithmic, and so has a lower edge."""
        return self.kind == "log"

    def placed(self, values: Floats) -> Floats:
        """Values as they are drawn: not below the lower edge."""
        return np.maximum(values, self.floor) if self.log else values

    def below(self, values: Floats) -> Flags:
        """The values that are drawn at the lower edge."""
        return np.asarray(values < self.floor) if self.log else np.zeros(values.shape, dtype=bool)

    def radius(self, values: Floats) -> Floats:
        """The distance from the centre of a polar diagram: decades above the lower edge, or the value."""
        return np.log10(self.placed(values) / self.floor) if self.log else np.maximum(values, 0.0)

    def transform(self, values: Floats) -> Floats:
        """Values on an axis whose own scale is linear: their logarithms to the base 10, for one."""
        if self.kind == "linear":
            return values
        if self.log:
            return np.asarray(np.log10(self.placed(values)))
        return np.asarray(np.sign(values) * np.log10(1.0 + np.abs(values) / self.threshold))

    def share(self, values: Floats, limits: tuple[float, float]) -> Floats:
        """Places (n,) of values between limits, 0 to 1: where their colours are in a map."""
        low, high = self.transform(np.array(limits))
        return np.asarray(np.clip((self.transform(values) - low) / (high - low), 0.0, 1.0))

    def limits(self, *drawn: Floats) -> tuple[float, float]:
        """The ends of an axis that shows these values; a linear one has its zero."""
        if self.log:
            return self.floor, 10.0 ** math.ceil(math.log10(1.05 * self.top))
        known = np.concatenate([np.zeros(1), *(each[np.isfinite(each)] for each in drawn)])
        low, high = float(known.min()), max(float(known.max()), self.top)
        if self.kind == "symlog":
            low, high = (
                math.copysign(self.threshold * ((1.0 + abs(each) / self.threshold) ** ROOM - 1.0), each) for each in (low, high)
            )
            return low, max(high, low + self.threshold)
        return ROOM * low, ROOM * high if high > low else 1.0

    def map_limits(self, values: Floats) -> tuple[float, float]:
        """The ends of the colours of trusted values (n,)."""
        if self.log:
            return self.floor, self.top
        low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
        return low, high if high > low else low + 1.0


def scale_of(values: Floats, u: Floats, log: bool | None) -> Scale:
    """The scale for values (n,) with their u (NaN: unknown); without `log` by the range of the values."""
    known = values[np.isfinite(values)]
    positive = known[known > 0.0]
    top = float(np.max(known, initial=0.0))
    if not positive.size or log is False:
        return Scale("linear", 0.0, top)
    if log is None and np.count_nonzero(positive < top / STEEP) <= 0.1 * positive.size:
        return Scale("linear", 0.0, top)
    noise = u[np.isfinite(u) & (u > 0.0)]
    # Selection and counting: a live map of 100,000 values has no time for quantiles.
    k = int(0.05 * noise.size)
    least = max(float(positive.min()), float(np.partition(noise, k)[k]) if noise.size else 0.0, 10.0**-DECADES * top)
    return Scale("log", 10.0 ** math.floor(math.log10(min(least, 0.5 * top))), top)


# ---- ticks ----


def ticks(scale: Scale, low: float, high: float, pixels: float, least: float) -> list[float]:
    """Round places on `Scale.transform` between two of them, no two closer than `least` of the `pixels` between these."""
    if scale.log:
        return log_ticks(low, high, pixels, least)
    if scale.kind == "linear":
        return linear_ticks(low, high, pixels, 2.0 * least)
    return _symlog_ticks(scale.threshold, low, high, pixels, least)


def tick_text(scale: Scale, place: float) -> str:
    """The value at a place on `Scale.transform`, as short as it differs from its neighbours."""
    if scale.kind == "linear":
        return f"{place:.4g}"
    if scale.log:
        return _value_text(10.0**place)
    t = scale.threshold
    return "0" if place == 0.0 else f"{math.copysign(t * (10.0 ** abs(place) - 1.0), place):.3g}"


def bar_ticks(scale: Scale, limits: tuple[float, float], pixels: float = 100.0, least: float = 17.0) -> tuple[float, ...]:
    """The values at the ticks of a colour bar."""
    low, high = scale.transform(np.array(limits)).tolist()
    found = ticks(scale, low, high, pixels, least)
    return tuple(float(f"{10.0**each:.6g}") if scale.log else each for each in found)


def _value_text(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value:.3g}" if -4 <= exponent <= 5 else f"{value / 10.0**exponent:.3g}e{exponent}"


def log_ticks(low: float, high: float, pixels: float, least: float) -> list[float]:
    """The logarithms of round values between two logarithms, no two closer than `least` of the `pixels` between these.

    A decade has the values 1 to 9, or some of them; where a decade has no room, every second, third and so on has one. Less
    than a decade has values at even distances where the digits would leave fewer than three.
    """
    span = max(high - low, 1e-9)
    room = least * span / max(pixels, 1.0)
    for digits in DIGITS:
        logs = [math.log10(each) for each in (*digits, 10)]
        if min(after - before for before, after in pairwise(logs)) >= room:
            decades = range(math.floor(low), math.ceil(high) + 1)
            found = [decade + each for decade in decades for each in logs[:-1] if low <= decade + each <= high]
            return found if len(found) >= 3 or span >= 1.0 else _even_ticks(low, high, room) or found
    step = math.ceil(room)
    return [float(each) for each in range(math.floor(low), math.ceil(high) + 1) if each % step == 0 and low <= each <= high]


def _even_ticks(low: float, high: float, room: float) -> list[float]:
    """The logarithms of values at even distances, within a decade; empty where fewer than two have room."""
    bottom, top = 10.0**low, 10.0**high
    step = _round_step(top * (1.0 - 10.0**-room))  # the distance of logarithms is least at the top
    numbers = range(math.ceil(bottom / step - 1e-9), math.floor(top / step + 1e-9) + 1)
    return [math.log10(each * step) for each in numbers] if len(numbers) >= 2 else []


def linear_ticks(low: float, high: float, pixels: float, least: float) -> list[float]:
    """Round values at even distances, no two closer than `least` of the `pixels` between `low` and `high`."""
    step = _round_step(least * max(high - low, 1e-300) / max(pixels, 1.0))
    return [
        float(f"{number * step:.12g}") for number in range(math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9) + 1)
    ]


def _round_step(least: float) -> float:
    """1, 2 or 5 times a power of ten that is not less."""
    scale = 10.0 ** math.floor(math.log10(least))
    return scale * next((each for each in (1, 2, 5) if each * scale >= least * (1.0 - 1e-9)), 10)


def _symlog_ticks(threshold: float, low: float, high: float, pixels: float, least: float) -> list[float]:
    room = least * max(high - low, 1e-9) / max(pixels, 1.0)
    step = max(1, math.ceil(room))
    first = math.ceil(math.log10(threshold) + room)
    top = max(abs(low), abs(high))
    found = [0.0]
    for decade in range(first, first + 40, step):
        at = math.log10(1.0 + 10.0**decade / threshold)
        if at > top:
            break
        if at >= found[-1] + room:
            found.append(at)
    return [each for each in (*(-tick for tick in reversed(found[1:])), *found) if low <= each <= high]
