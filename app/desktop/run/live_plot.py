"""The live plot of a run: values on a logarithmic axis against the angle, redrawn at most every REDRAW_MS.

A logarithmic axis has no place for values that are not positive, and pyqtgraph hides a whole curve for one such value. So
the logarithm is taken here, and values below the detection limit are marks of their own at the lower edge.
"""

import math
from itertools import pairwise

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QObject, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QColor, QResizeEvent
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.components import DETECTED, interval
from goniotwin.app.campaign.reduction.points import BITS, REASON_ORDER
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.desktop.model.live_scan import LiveScan, ScanData, ScanPoints
from goniotwin.app.desktop.theme import Colours
from goniotwin.arrays import Flags, Floats

REDRAW_MS = 100
"""Shortest time between two repaints, at any rate of rows."""
POINT_SIZE = 7
LOW = 190
"""Height in logical pixels below which the text of the plot is hidden; it is the plot's tool tip too."""
PIXELS_OF_VALUE, PIXELS_OF_LINE = 17.0, 5.0
"""Least distance of two texts at the axis of the values, and of two of its ticks."""
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
        self.setWidth(64)

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


class ScanPlot(QWidget):
    """The plot of a scan, and its content as a line of text."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._mark = ""
        self._scan: ScanData | None = None
        self._regions: list[pg.LinearRegionItem] = []
        self._view = pg.PlotWidget(background=None, axisItems={"left": LogAxis(), "bottom": AngleAxis()})
        self._view.setAccessibleName("Plot of the scan in progress")
        self._view.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._plot = self._view.getPlotItem()
        self._plot.setMenuEnabled(False)
        self._plot.showGrid(x=True, y=True, alpha=0.15)
        self._bars = pg.ErrorBarItem(beam=0.0)
        self._plot.addItem(self._bars)
        self._items = {
            "blocked": pg.ScatterPlotItem(symbol="o", size=POINT_SIZE),
            "flagged": pg.ScatterPlotItem(symbol="x", size=POINT_SIZE),
            "below limit": pg.ScatterPlotItem(symbol="t", size=POINT_SIZE - 2),
            "measured": pg.ScatterPlotItem(symbol="o", size=POINT_SIZE),
        }
        for item in self._items.values():
            self._plot.addItem(item)
        self._note = QLabel()
        self._note.setWordWrap(True)
        self._note.setAccessibleName("The scan in progress as text")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._view, 1)
        layout.addWidget(self._note)
        self.set_colours(colours)
        self.clear("")

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the plot where there is little; Qt calls it."""
        super().resizeEvent(event)
        self._note.setVisible(self.height() >= LOW)

    @property
    def summary(self) -> str:
        """The content of the plot as text."""
        return self._note.text()

    @property
    def title(self) -> str:
        """The title of the plot."""
        return f"{self._mark} {self._scan.title if self._scan else ''}".strip()

    @property
    def y_label(self) -> str:
        """The label of the values' axis."""
        return str(self._plot.getAxis("left").labelText)

    def marks(self) -> dict[str, tuple[Floats, Floats]]:
        """The marks that are drawn, by kind: angles and logarithms to the base 10."""
        return {kind: item.getData() for kind, item in self._items.items()}

    def clear(self, mark: str) -> None:
        """Clear the plot; `mark` is the first part of its title (SIMULATED, or empty)."""
        self._mark = mark
        self._scan = None
        for item in self._items.values():
            item.setData([], [])
        self._bars.setData(x=np.empty(0), y=np.empty(0), top=np.empty(0), bottom=np.empty(0))
        self._show_blocked(())
        self._plot.setXRange(-90.0, 90.0, padding=0.02)
        self._plot.setYRange(-4.0, 0.0)
        self._plot.enableAutoRange(axis="y")
        self._label()
        self._write("The scan in progress is plotted here.")

    def show_scan(self, scan: ScanData) -> None:
        """Show the points of a scan so far."""
        is_new = self._scan is None or (self._scan.title, self._scan.y_label) != (scan.title, scan.y_label)
        self._scan = scan
        points = scan.points
        above = np.isfinite(points.values) & (points.values > 0) & ~points.lost
        logs = np.log10(np.where(above, points.values, 1.0))
        below = np.isfinite(points.values) & ~above
        kinds = {
            "measured": above & ~points.blocked & ~points.untrusted,
            "blocked": above & points.blocked,
            "flagged": above & points.untrusted & ~points.blocked,
        }
        floor = float(np.min(logs[above])) - 0.3 if above.any() else -4.0
        for kind, chosen in kinds.items():
            self._items[kind].setData(points.x_deg[chosen], logs[chosen])
        shown = kinds["measured"]
        marks = zip(points.transmitted[shown].tolist(), _steep(points)[shown].tolist(), strict=True)
        symbols = ["d" if steep else "s" if transmitted else "o" for transmitted, steep in marks]
        self._items["measured"].setSymbol(symbols)
        self._items["below limit"].setData(points.x_deg[below], np.full(int(below.sum()), floor))
        low, high = interval(points.values[above], points.u_values[above], points.added[above], coverage=1.0)
        self._bars.setData(
            x=points.x_deg[above], y=logs[above], top=np.log10(high) - logs[above], bottom=logs[above] - np.log10(low)
        )
        if is_new:
            self._show_blocked(scan.blocked_deg)
            self._plot.setXRange(*scan.range_deg, padding=0.02)
            self._plot.enableAutoRange(axis="y")
            self._label()
        self._write(_note_text(scan, kinds, int(below.sum())))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._view.setBackground(colours.base)
        for name in ("left", "bottom", "right", "top"):
            self._plot.getAxis(name).setPen(colours.line)
            self._plot.getAxis(name).setTextPen(colours.text)
        for kind, item in self._items.items():
            filled = kind == "measured"
            item.setPen(pg.mkPen(colours.base, width=0.5) if filled else pg.mkPen(colours.blocked, width=1.0))
            item.setBrush(pg.mkBrush(colours.points if filled else None))
        self._bars.setData(pen=pg.mkPen(colours.points, width=1))
        self._show_blocked(self._scan.blocked_deg if self._scan else ())
        self._label()

    def _write(self, text: str) -> None:
        self._note.setText(text)
        self._view.setToolTip(text)
        self._view.setAccessibleDescription(text)

    def _show_blocked(self, intervals: tuple[tuple[float, float], ...]) -> None:
        for each in self._regions:
            self._plot.removeItem(each)
        shade = QColor(self._colours.blocked)
        shade.setAlpha(50)
        brush, pen = pg.mkBrush(shade), pg.mkPen(None)
        self._regions = [pg.LinearRegionItem(each, movable=False, brush=brush, pen=pen) for each in intervals]
        for each in self._regions:
            each.setZValue(-10)
            self._plot.addItem(each)

    def _label(self) -> None:
        title = self._scan.title if self._scan else "No scan yet"
        marked = f"<b style='color:{self._colours.bad}'>{self._mark}</b>&nbsp;&nbsp; " if self._mark else ""
        self._plot.setTitle(marked + title, color=self._colours.text, size="9pt")
        style = {"color": self._colours.text}
        self._plot.setLabel("bottom", self._scan.x_label if self._scan else "aspecular angle θ (°)", **style)
        self._plot.setLabel("left", self._scan.y_label if self._scan else "BSDF (1/sr)", **style)
        for name in ("bottom", "left"):
            self._plot.getAxis(name).resizeEvent()  # centres the label: pyqtgraph does so for a new size, not for a new text


class LivePlot(QObject):
    """Shows the rows of a run in a plot. It never raises; `failed` has the error."""

    failed = Signal(str)

    def __init__(self, plot: ScanPlot, parent: QObject) -> None:
        super().__init__(parent)
        self._plot = plot
        self._scan: LiveScan | None = None
        self._redraw = QTimer(self, interval=REDRAW_MS, singleShot=True)
        self._redraw.timeout.connect(self._draw)

    def start(self, plan: Plan | None, mark: str) -> None:
        """Clear the plot for the run of a plan, or for none."""
        self._plot.clear(mark)
        try:
            self._scan = LiveScan(plan) if plan is not None else None
        except Exception as error:  # noqa: BLE001  (any error of the plot: the measurement goes on)
            self._fail(error)

    def add_row(self, event: RowStarted | RowCommitted) -> None:
        """Add a row; the plot follows within REDRAW_MS."""
        if self._scan is None:
            return
        try:
            self._scan.add_row(event)
        except Exception as error:  # noqa: BLE001  (any error of the plot: the measurement goes on)
            self._fail(error)
        if not self._redraw.isActive():
            self._redraw.start()

    def finish(self) -> None:
        """The run has ended: complete the values."""
        if self._scan is not None:
            self._scan.finish()
            self._redraw.start()

    def stop(self) -> None:
        """Draw no more."""
        self._redraw.stop()

    @Slot()
    def _draw(self) -> None:
        try:
            scan = self._scan.data() if self._scan is not None else None
            if scan is not None:
                self._plot.show_scan(scan)
                if not scan.complete:
                    self._redraw.start()
        except Exception as error:  # noqa: BLE001  (as above)
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Report the error. The plot of this run ends here, because the error would come back at every row."""
        self._scan = None
        self.failed.emit(f"The plot failed ({type(error).__name__}: {error}); the run is not affected.")


def _note_text(scan: ScanData, kinds: dict[str, Flags], below: int) -> str:
    points, measured = scan.points, kinds["measured"]
    blocked, flagged = int(kinds["blocked"].sum()), int(kinds["flagged"].sum())
    text = f"●\u00a0{int(measured.sum())} measured"
    if measured.any():
        top = int(np.argmax(np.where(measured, points.values, -np.inf)))
        text += f", highest {points.values[top]:.3g} at {points.x_deg[top]:.1f}°"
    if transmitted := int((measured & points.transmitted).sum()):
        text += f"    ■\u00a0{transmitted} of these transmitted"
    if steep := int((measured & _steep(points)).sum()):
        text += f"    ◆\u00a0{steep} of these steep (measured too far apart: their u may be too small)"
    if blocked or scan.blocked_deg:
        text += f"    ○\u00a0{blocked} blocked by the mirror unit (shaded)"
    if flagged:
        marks = points.marks[kinds["flagged"]]
        names = ", ".join(name for name in REASON_ORDER if np.any(marks & BITS[name]))
        text += f"    ×\u00a0{flagged} flagged" + (f" ({names})" if names else "")
    if below:
        text += f"    ▽\u00a0{below} below detection limit (signal under {DETECTED:g} u)"
    return "\n".join([text, *(f"✗\u00a0{each}" for each in scan.findings)])


def _steep(points: ScanPoints) -> Flags:
    return np.asarray((points.marks & BITS["steep"]) != 0)
