"""Axes of the window's plots: their ticks are those of the figures' scales, as many as have room."""

import pyqtgraph as pg

from goniotwin.app.figures.scale import Scale, tick_text, ticks

AXIS_WIDTH = 64
"""Pixels of the axis of the values, with its label."""
PIXELS_OF_VALUE, PIXELS_OF_LINE = 17.0, 5.0
"""Least distance of two texts at the axis of the values, and of two of its ticks."""
PIXELS_OF_RESIDUAL, RESIDUAL_STEPS = 13.0, (2.0, 4.0, 8.0, 16.0)
"""Least distance of two texts at the axis of the residuals, and the distances in u."""
ANGLE_STEPS_DEG = (90.0, 30.0, 10.0, 5.0, 1.0, 0.5, 0.1, 0.05, 0.01)
"""Each is a multiple of the next."""
PIXELS_OF_ANGLE, PIXELS_OF_TICK = 34.0, 8.0
"""Widths of a step above which it has room for its text, and for a tick."""
LOG = Scale("log", 1e-4, 1.0)


class ValueAxis(pg.AxisItem):
    """The axis of values on a scale, whose transform the plot's items have; with the values themselves at its ticks."""

    def __init__(self, scale: Scale = LOG) -> None:
        super().__init__("left", maxTextLevel=0)
        self._scale = scale
        self.enableAutoSIPrefix(False)
        self.setWidth(AXIS_WIDTH)

    def set_value_scale(self, scale: Scale) -> None:
        """Show another scale from now on."""
        if (scale.kind, scale.threshold) != (self._scale.kind, self._scale.threshold):
            self.picture = None
            self.update()
        self._scale = scale

    def tickValues(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, list[float]]]:
        """The ticks with a text, and those between them; each with a distance (pyqtgraph calls it)."""
        low, high = sorted((minVal, maxVal))
        texts = ticks(self._scale, low, high, size, PIXELS_OF_VALUE)
        between = ticks(self._scale, low, high, size, PIXELS_OF_LINE) if self._scale.log else []
        return [(1.0, texts), (0.1, [each for each in between if each not in texts])]

    def tickStrings(self, values: list[float], scale: float, spacing: float) -> list[str]:
        """The values at the ticks, as short as they differ (pyqtgraph calls it)."""
        del scale, spacing
        return [tick_text(self._scale, each) for each in values]


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
    """The axis of angles: texts at 30, 10 or 5 deg where pyqtgraph has 50, at finer steps in a part of the scan.

    With `of_angles` off it is one of another quantity, as pyqtgraph has it.
    """

    def __init__(self) -> None:
        super().__init__("bottom", maxTextLevel=0)
        self.enableAutoSIPrefix(False)
        self.of_angles = True

    def tickSpacing(self, minVal: float, maxVal: float, size: float) -> list[tuple[float, float]]:
        """The distance of the texts, and that of the ticks between them; each with an offset (pyqtgraph calls it)."""
        if not self.of_angles:
            return super().tickSpacing(minVal, maxVal, size)  # type: ignore[no-any-return]  # pyqtgraph has no types
        pixels = size / max(maxVal - minVal, 1e-9)
        steps = [each for each in ANGLE_STEPS_DEG if each * pixels >= PIXELS_OF_TICK]
        texts = [each for each in steps if each * pixels >= PIXELS_OF_ANGLE] or list(ANGLE_STEPS_DEG[:1])
        return [(each, 0.0) for each in (texts[-1], *steps[len(texts) : len(texts) + 1])]
