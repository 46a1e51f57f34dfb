"""Axes of the plots of a run: values on a logarithmic, linear or symmetric logarithmic scale, and angles.

A logarithmic axis has no place for values that are not positive, and pyqtgraph hides a whole curve for one such value. So
the transform is made here, not by pyqtgraph.
"""

import math
from itertools import pairwise
from typing import Literal, get_args

import numpy as np
import pyqtgraph as pg

from goniotwin.arrays import Floats

Scale = Literal["log", "linear", "symlog"]
SCALES: tuple[Scale, ...] = get_args(Scale)
AXIS_WIDTH = 64
"""Pixels of the axis of the values, with its label."""
PIXELS_OF_VALUE, PIXELS_OF_LINE = 17.0, 5.0
"""Least distance of two texts at the axis of the values, and of two of its ticks."""
PIXELS_OF_RESIDUAL, RESIDUAL_STEPS = 13.0, (2.0, 4.0, 8.0, 16.0)
"""Least distance of two texts at the axis of the residuals, and the distances in u."""
DIGITS: tuple[tuple[int, ...], ...] = (tuple(range(1, 10)), (1, 2, 3, 5, 7), (1, 2, 5), (1, 3), (1,))
"""Ticks within a decade, from many to few."""
ANGLE_STEPS_DEG = (90.0, 30.0, 10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01)
"""Each is a multiple of the next."""
PIXELS_OF_ANGLE, PIXELS_OF_TICK = 38.0, 8.0
"""Widths of a step above which it has room for its text, and for a tick."""


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
    step = top * (1.0 - 10.0**-room)  # the distance of logarithms is least at the top
    scale = 10.0 ** math.floor(math.log10(step))
    step = scale * next((each for each in (1, 2, 5) if each * scale >= step), 10)
    numbers = range(math.ceil(bottom / step - 1e-9), math.floor(top / step + 1e-9) + 1)
    return [math.log10(each * step) for each in numbers] if len(numbers) >= 2 else []


class LogAxis(pg.AxisItem):
    """The axis of logarithms, with the values themselves at its ticks: 0.01, 0.05, 100."""

    def __init__(self) -> None:
        super().__init__("left", maxTextLevel=0)
        self.enableAutoSIPrefix(False)
        self.setWidth(AXIS_WIDTH)

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """The ticks with a text, and those between them; each with a distance (pyqtgraph calls it)."""
        low, high = sorted((minVal, maxVal))
        texts = log_ticks(low, high, size, PIXELS_OF_VALUE)
        between = [each for each in log_ticks(low, high, size, PIXELS_OF_LINE) if each not in texts]
        return [(1.0, texts), (0.1, between)]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """The values of logarithms, as short as they differ (pyqtgraph calls it)."""
        del scale, spacing
        return [_value_text(10.0**each) for each in values]


def _value_text(value: float) -> str:
    exponent = math.floor(math.log10(value) + 1e-9)
    return f"{value:.3g}" if -4 <= exponent <= 5 else f"{value / 10.0**exponent:.3g}e{exponent}"


class ResidualAxis(pg.AxisItem):
    """The axis of the residuals: texts at the limits of the alarm or at multiples of them, at 2 u where these have room."""

    def __init__(self) -> None:
        super().__init__("left", maxTextLevel=0)
        self.enableAutoSIPrefix(False)
        self.setWidth(AXIS_WIDTH)

    def tickSpacing(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, float]]:
        """The distance of the texts, with an offset (pyqtgraph calls it)."""
        room = PIXELS_OF_RESIDUAL * max(maxVal - minVal, 1e-9) / max(size, 1.0)
        return [(next((each for each in RESIDUAL_STEPS if each >= room), RESIDUAL_STEPS[-1]), 0.0)]


class AngleAxis(pg.AxisItem):
    """The axis of angles: texts at 30, 10 or 5 deg where pyqtgraph has 50, at finer steps in a part of the scan."""

    def __init__(self) -> None:
        super().__init__("bottom", maxTextLevel=0)

    def tickSpacing(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, float]]:
        """The distance of the texts, and that of the ticks between them; each with an offset (pyqtgraph calls it)."""
        pixels = size / max(maxVal - minVal, 1e-9)
        steps = [each for each in ANGLE_STEPS_DEG if each * pixels >= PIXELS_OF_TICK]
        texts = [each for each in steps if each * pixels >= PIXELS_OF_ANGLE] or list(ANGLE_STEPS_DEG[:1])
        return [(each, 0.0) for each in (texts[-1], *steps[len(texts) : len(texts) + 1])]


def transform(values: Floats, scale: Scale, threshold: float) -> Floats:
    """Values on a scale. Symlog is linear up to about `threshold`; log needs values above zero."""
    if scale == "linear":
        return values
    if scale == "log":
        return np.asarray(np.log10(values))
    return np.asarray(np.sign(values) * np.log10(1.0 + np.abs(values) / threshold))


class ValueAxis(LogAxis):
    """The axis of the values, with the values at its ticks, whatever the scale."""

    def __init__(self) -> None:
        super().__init__()
        self._scale: Scale = "log"
        self._threshold = 1.0

    def set_value_scale(self, scale: Scale, threshold: float) -> None:
        """Show another scale from now on."""
        if (scale, threshold) != (self._scale, self._threshold):
            self._scale, self._threshold = scale, threshold
            self.picture = None
            self.update()

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """The ticks with a text, and those between them; each with a distance (pyqtgraph calls it)."""
        if self._scale == "log":
            return super().tickValues(minVal, maxVal, size)
        low, high = sorted((minVal, maxVal))
        if self._scale == "linear":
            return [(1.0, _linear_ticks(low, high, size))]
        return [(1.0, self._symlog_ticks(low, high, size))]

    def _symlog_ticks(self, low: float, high: float, pixels: float) -> list[float]:
        room = PIXELS_OF_VALUE * max(high - low, 1e-9) / max(pixels, 1.0)
        step = max(1, math.ceil(room))
        first = math.ceil(math.log10(self._threshold) + room)
        top = max(abs(low), abs(high))
        ticks = [0.0]
        for decade in range(first, first + 40, step):
            at = math.log10(1.0 + 10.0**decade / self._threshold)
            if at > top:
                break
            if at >= ticks[-1] + room:
                ticks.append(at)
        return [each for each in (*(-tick for tick in reversed(ticks[1:])), *ticks) if low <= each <= high]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """The values at the ticks, as short as they differ (pyqtgraph calls it)."""
        if self._scale == "log":
            return super().tickStrings(values, scale, spacing)
        if self._scale == "linear":
            return [f"{value:.4g}" for value in values]
        t = self._threshold
        return ["0" if value == 0.0 else f"{math.copysign(t * (10.0 ** abs(value) - 1.0), value):.3g}" for value in values]


def _linear_ticks(low: float, high: float, pixels: float) -> list[float]:
    """Round values at even distances, no two texts closer than they have room."""
    least = 2.0 * PIXELS_OF_VALUE * max(high - low, 1e-300) / max(pixels, 1.0)
    scale = 10.0 ** math.floor(math.log10(least))
    step = scale * next((each for each in (1, 2, 5) if each * scale >= least), 10)
    return [round(number * step, 12) for number in range(math.ceil(low / step), math.floor(high / step) + 1)]
