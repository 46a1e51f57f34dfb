"""The plots of a run: a cut with its prediction and residual, and the hemisphere. Redrawn at most every REDRAW_MS.

What they show is computed by workers; a plot that fails never stops a run.
"""

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, QPointF, QRectF, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QFont, QFontMetricsF, QKeyEvent, QResizeEvent
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from goniotwin.app.campaign.geometry.directions import direction_keys
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.components import DETECTED
from goniotwin.app.campaign.reduction.points import BITS, REASON_ORDER
from goniotwin.app.campaign.running.events import RowCommitted, RowStarted
from goniotwin.app.desktop.figures import PanelItems
from goniotwin.app.desktop.model.live_scan import ScanData, ScanKey, Setting
from goniotwin.app.desktop.model.run_points import ALARM_U, Cut, RunPoints, map_points
from goniotwin.app.desktop.model.values import (
    Begin,
    DirectionsPlanned,
    Failed,
    Finish,
    MisalignmentFound,
    PlanTexts,
    PredictionEnded,
    ScanComputed,
    ScanPredicted,
    WatchRun,
    serve_predictions,
    serve_values,
)
from goniotwin.app.desktop.model.worker import Worker, WorkerEnded
from goniotwin.app.desktop.run.axes import AXIS_WIDTH, LOG, AngleAxis, ResidualAxis, ValueAxis
from goniotwin.app.desktop.run.cut_panel import cut_panel, kinds, residual_panel
from goniotwin.app.desktop.run.hemisphere import HemisphereMap
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.curves import ANGLE_LIMITS, PLANE_AXIS, quantity
from goniotwin.app.figures.description import Panel
from goniotwin.app.figures.hemisphere import is_half
from goniotwin.app.figures.scale import ScaleKind
from goniotwin.app.figures.style import MarkKind
from goniotwin.arrays import Flags, Floats

REDRAW_MS = 100
"""Shortest time between two repaints, at any rate of rows."""
LOW, LOW_FOR_TEXT = 190, 270
"""Heights in logical pixels below which the residuals and the cursor's value, and the text of the plot, are omitted. The text
is the plot's tool tip too.
"""
RESIDUAL_HEIGHT, RESIDUAL_SHARE = 110.0, 0.38
"""Height of the residuals, and the most of the plot's height that they take."""
TITLE_POINTS, TITLE_MARGIN = 9, 34.0
"""Size of the title's letters, and the pixels beside it."""
LABEL_SHARE = 0.6
"""Share of the height that the label of the values has; a longer one is cut at its comma."""
ENDED = "has been ended, by another program or for want of memory"
NO_CURSOR = "Point at the plot, or press ←, →, Home and End in it, to read a value."


class ScanPlot(QWidget):
    """The plot of a cut: measured points over the prediction with 2 u, the residual below it, and all of it as text.

    The cursor is on a point: under the mouse, or moved with the arrow keys.
    """

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._mark = ""
        self._scan: ScanData | None = None
        self._cut: Cut | None = None
        self._scale: ScaleKind = "log"
        self._cursor: int | None = None
        self._values_axis = ValueAxis()
        self._view = pg.GraphicsLayoutWidget()
        self._view.setAccessibleName("Plot of the scan in progress")
        self._view.viewport().setFocusPolicy(Qt.FocusPolicy.NoFocus)  # else Tab stops at it; the view gets it, too
        self._view.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        self._view.installEventFilter(self)
        self._plot: pg.PlotItem = self._view.addPlot(0, 0, axisItems={"left": self._values_axis, "bottom": AngleAxis()})
        self._residuals: pg.PlotItem = self._view.addPlot(1, 0, axisItems={"left": ResidualAxis(), "bottom": AngleAxis()})
        self._residuals.setXLink(self._plot)
        self._view.ci.setContentsMargins(2, 2, 6, 2)
        self._view.ci.setSpacing(0)
        for plot in (self._plot, self._residuals):
            plot.setMenuEnabled(False)
            plot.hideButtons()
            plot.showGrid(x=True, y=True, alpha=0.15)
        self._items, self._residual_items = PanelItems(self._plot, colours), PanelItems(self._residuals, colours)
        self._limits: tuple[float, float] | None = None
        self._cursor_lines = pg.InfiniteLine(angle=90), pg.InfiniteLine(angle=90)
        for plot, line in zip((self._plot, self._residuals), self._cursor_lines, strict=True):
            line.setVisible(False)
            plot.addItem(line, ignoreBounds=True)
        self._note = QLabel()
        self._note.setWordWrap(True)
        self._note.setAccessibleName("The scan in progress as text")
        self._reading = QLabel(NO_CURSOR)
        self._reading.setAccessibleName("Value at the cursor")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._view, 1)
        layout.addWidget(self._reading)
        layout.addWidget(self._note)
        self._view.scene().sigMouseMoved.connect(self._follow_mouse)
        self.set_colours(colours)
        self.clear("")

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the plot where there is little; Qt calls it."""
        super().resizeEvent(event)
        self._note.setVisible(self.height() >= LOW_FOR_TEXT)
        self._reading.setVisible(self.height() >= LOW)
        self._label()
        self._show_residuals()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Move the cursor with the arrow keys; Qt calls it."""
        if event.type() == QEvent.Type.KeyPress and isinstance(event, QKeyEvent):
            last = 0 if self._scan is None else self._scan.points.x_deg.size
            steps = {Qt.Key.Key_Left: -1, Qt.Key.Key_Right: 1, Qt.Key.Key_Home: -last, Qt.Key.Key_End: last}
            step = steps.get(Qt.Key(event.key()))
            if step is not None:
                self.move_cursor(step)
                return True
        return super().eventFilter(watched, event)

    @property
    def summary(self) -> str:
        """The content of the plot as text."""
        return self._note.text()

    @property
    def reading(self) -> str:
        """The value at the cursor as text."""
        return self._reading.text()

    @property
    def title(self) -> str:
        """The title of the plot."""
        return f"{self._mark} {self._scan.title if self._scan else ''}".strip()

    @property
    def y_label(self) -> str:
        """The label of the values' axis."""
        return str(self._plot.getAxis("left").labelText)

    @property
    def x_label(self) -> str:
        """The label of the axis of angles."""
        return str(self._plot.getAxis("bottom").labelText)

    @property
    def line(self) -> pg.PlotCurveItem:
        """The line of the prediction."""
        return self._items.lines[0]

    def residual_marks(self) -> dict[MarkKind, tuple[Floats, Floats]]:
        """The marks of the residuals, by kind."""
        return self._residual_items.marks()

    def marks(self) -> dict[MarkKind, tuple[Floats, Floats]]:
        """The marks that are drawn, by kind: angles, and values on the scale (logarithms to the base 10)."""
        return self._items.marks()

    @property
    def alarms(self) -> int:
        """The number of points in alarm."""
        return 0 if self._cut is None else int(self._cut.alarms.sum())

    def set_scale(self, scale: ScaleKind) -> None:
        """Show the values on another scale."""
        if scale != self._scale:
            self._scale = scale
            cut, self._scan = self._cut, None
            if cut is not None:
                self.show_cut(cut)

    def clear(self, mark: str) -> None:
        """Clear the plot; `mark` is the first part of its title (SIMULATED, or empty)."""
        self._mark = mark
        self._scan, self._cut = None, None
        for items in (self._items, self._residual_items):
            items.show(Panel())
        self._place_cursor(None)
        self._plot.setXRange(*ANGLE_LIMITS, padding=0.0)
        self._values_axis.set_value_scale(LOG)
        self._plot.setYRange(-4.0, 0.0, padding=0.0)
        self._limits = None
        self._label()
        self._write("The scan in progress is plotted here.")
        self._show_residuals()

    def show_cut(self, cut: Cut) -> None:
        """Show the points of a cut so far, with the prediction."""
        scan = cut.scan
        is_new = self._scan is None or (self._scan.title, self._scan.y_label) != (scan.title, scan.y_label)
        self._scan, self._cut = scan, cut
        of = kinds(scan.points)
        panel = cut_panel(cut, of, self._scale)
        self._items.show(panel)
        scale, limits = panel.scale, panel.y.limits
        assert scale is not None
        self._values_axis.set_value_scale(scale)
        if limits is not None and (is_new or limits != self._limits):
            self._limits = limits
            self._plot.setYRange(*scale.transform(np.array(limits)).tolist(), padding=0.0)
        if is_new:
            self._plot.setXRange(*scan.range_deg, padding=0.0)
            self._label()
            self._place_cursor(None)
        self._show_residuals()
        self._write(_note_text(cut, of))
        if self._cursor is not None:
            self._place_cursor(self._cursor)

    def _show_residuals(self) -> None:
        """Show the residuals, those beyond the range at its edge, where there is room and a prediction."""
        cut = self._cut
        shown = cut is not None and cut.line is not None and cut.scan.is_bsdf and self.height() >= LOW
        self._residuals.setVisible(shown)
        self._residuals.setMaximumHeight(min(RESIDUAL_HEIGHT, RESIDUAL_SHARE * self._view.height()) if shown else 0)
        self._plot.getAxis("bottom").setStyle(showValues=not shown)
        self._plot.getAxis("bottom").showLabel(not shown)
        if not shown or cut is None:
            return
        panel = residual_panel(cut)
        self._residual_items.show(panel)
        assert panel.y.limits is not None
        self._residuals.setYRange(*panel.y.limits, padding=0.0)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._view.setBackground(colours.base)
        for plot in (self._plot, self._residuals):
            for name in ("left", "bottom", "right", "top"):
                plot.getAxis(name).setPen(colours.line)
                plot.getAxis(name).setTextPen(colours.text)
        for items in (self._items, self._residual_items):
            items.set_palette(colours)
        for line in self._cursor_lines:
            line.setPen(pg.mkPen(colours.dim, width=1, style=Qt.PenStyle.DashLine))
        self._label()

    # The cursor.

    def move_cursor(self, step: int) -> None:
        """Move the cursor by so many points."""
        if self._scan is not None and self._scan.points.x_deg.size:
            last = self._scan.points.x_deg.size - 1
            start = (-1 if step > 0 else last + 1) if self._cursor is None else self._cursor
            self._place_cursor(min(max(start + step, 0), last))

    @Slot(object)
    def _follow_mouse(self, at: QPointF) -> None:
        inside = [plot for plot in (self._plot, self._residuals) if plot.isVisible() and plot.sceneBoundingRect().contains(at)]
        if inside and self._scan is not None and self._scan.points.x_deg.size:
            x = inside[0].vb.mapSceneToView(at).x()
            self._place_cursor(int(np.argmin(np.abs(self._scan.points.x_deg - x))))

    def _place_cursor(self, index: int | None) -> None:
        points = None if self._scan is None else self._scan.points
        if index is None or points is None or self._cut is None or index >= points.x_deg.size:
            self._cursor = None
            text = NO_CURSOR
        else:
            self._cursor = index
            text = _reading_text(self._cut, index)
            for line in self._cursor_lines:
                line.setValue(float(points.x_deg[index]))
        for line in self._cursor_lines:
            line.setVisible(self._cursor is not None)
        self._reading.setText(text)

    def _write(self, text: str) -> None:
        self._note.setText(text)
        self._view.setToolTip(text)
        self._view.setAccessibleDescription(text)

    def _label(self) -> None:
        title = self._scan.title if self._scan else "No scan yet"
        bold, plain = (QFont(self.font()) for _ in range(2))
        bold.setBold(True)
        for font in (bold, plain):
            font.setPointSizeF(TITLE_POINTS)
        # pyqtgraph would make the plot as wide as its title, beyond the window.
        room = self._view.width() - AXIS_WIDTH - TITLE_MARGIN
        mark = self._mark
        if room < QFontMetricsF(bold).horizontalAdvance(mark) + QFontMetricsF(plain).horizontalAdvance(title):
            mark = mark.partition(" ")[0]
        room -= QFontMetricsF(bold).horizontalAdvance(mark)
        title = QFontMetricsF(plain).elidedText(title, Qt.TextElideMode.ElideMiddle, max(room, 0.0))
        marked = f"<b style='color:{self._colours.bad}'>{mark}</b>&nbsp;&nbsp; " if mark else ""
        self._plot.setTitle(marked + title, color=self._colours.text, size=f"{TITLE_POINTS}pt")
        style = {"color": self._colours.text}
        below = self._scan.x_label if self._scan else PLANE_AXIS.label
        if self.fontMetrics().horizontalAdvance(below) > self._view.width() - AXIS_WIDTH:
            below = below.partition(";")[0]
        beside = self._scan.y_label if self._scan else quantity(None)
        if self.fontMetrics().horizontalAdvance(beside) > LABEL_SHARE * self._view.height():
            beside = beside.partition(",")[0]
        self._plot.setLabel("left", beside, **style)
        self._residuals.setLabel("left", "residual / u" if self.height() >= LOW_FOR_TEXT else "res. / u", **style)
        for plot in (self._plot, self._residuals):
            plot.setLabel("bottom", below, **style)
            for name in ("bottom", "left"):
                plot.getAxis(name).resizeEvent()  # centres the label: pyqtgraph does so for a new size, not for a new text
        self._plot.getAxis("bottom").showLabel(not self._residuals.isVisible())
        if (place := QRectF(self._view.rect())) != self._view.ci.geometry():  # a longer title may have made it wider
            self._view.ci.setGeometry(place)


class LivePlot(QObject):
    """Shows the rows of a run, and what the twin predicts of them. It never raises; `failed` has the error.

    With `processes` off the workers are threads, and nothing is predicted.
    """

    failed = Signal(str)
    alarmed = Signal(str, str)
    """The first residual of a scan beyond ALARM_U, and the scan."""
    prediction_missing = Signal(str)
    misaligned = Signal(str, str)
    """A misalignment that the residuals of a run show, and of which sample; without a text: why the run is not watched."""
    _answered = Signal(object)

    def __init__(self, plot: ScanPlot, hemisphere: HemisphereMap, parent: QObject, *, processes: bool = True) -> None:
        super().__init__(parent)
        self._plot = plot
        self._map = hemisphere
        self._points = RunPoints()
        self._current: ScanKey | None = None
        self._phi_deg: float | None = None
        self._number, self._prediction = 0, 0
        self._predicted: PlanTexts | None = None
        self._alarmed: set[ScanKey] = set()
        self._unmapped: dict[ScanKey, Cut] = {}
        self._place: object = None
        self._planned: dict[tuple[Setting, bool], int] = {}
        self._running = False
        self._answered.connect(self._take, Qt.ConnectionType.QueuedConnection)
        self._processes = processes
        self._stopped = False
        self._values = self._new_values()
        self._predictions = self._new_predictions() if processes else None
        self._redraw = QTimer(self, interval=REDRAW_MS, singleShot=True)
        self._redraw.timeout.connect(self._draw)

    def predict(self, plan: Plan) -> None:
        """Predict the values of a plan, unless that is done or in progress."""
        texts = PlanTexts.of(plan)
        if self._predictions is not None and (self._predicted is None or self._predicted.same != texts.same):
            self._predicted = texts
            self._prediction += 1
            self._points.begin_prediction()
            self._planned = {}
            self._predictions.put(Begin(self._prediction, texts))
            if not self._running:
                self._values.put(Begin(self._number, None))  # its process starts now, and takes nothing from the first rows

    def start(self, plan: Plan | None, mark: str) -> None:
        """Clear the plot for the run of a plan, or for none."""
        self._plot.clear(mark)
        self._map.clear(mark, mirrored=plan is not None and _is_half_of_isotropic(plan))
        self._points.begin_run()
        self._alarmed.clear()
        self._unmapped.clear()
        self._place = None
        self._current = None
        self._number += 1
        had_run, self._running = self._running, plan is not None
        if plan is not None or had_run:
            self._values.put(Begin(self._number, None if plan is None else PlanTexts.of(plan)))
        if plan is not None:
            self.predict(plan)
        if self._predictions is not None and (plan is not None or had_run):
            self._predictions.put(WatchRun(self._number, None if plan is None else PlanTexts.of(plan)))

    def add_row(self, event: RowStarted | RowCommitted) -> None:
        """Add a row; the plot follows within some REDRAW_MS."""
        if self._running:
            self._values.put(event)
        if self._predictions is not None and isinstance(event, RowCommitted):
            self._predictions.put(event)

    def finish(self) -> None:
        """The run has ended: complete the values."""
        if self._running:
            self._values.put(Finish())

    @Slot(object)
    def show_plane(self, phi_deg: float | None) -> None:
        """Show the plane through the specular direction at an azimuth about it; None is the scan in progress."""
        self._phi_deg = phi_deg
        self._redraw.start()

    def stop(self) -> None:
        """Draw no more, and end the workers."""
        self._redraw.stop()
        self._running = False
        self._stopped = True
        self._values.close()
        if self._predictions is not None:
            self._predictions.close()

    def _new_values(self) -> Worker:
        return Worker("values", serve_values, self._answered.emit, process=self._processes)

    def _new_predictions(self) -> Worker:
        return Worker("predictions", serve_predictions, self._answered.emit)

    @Slot(object)
    def _take(self, answer: object) -> None:
        match answer:
            case ScanComputed(number, scan, current) if number == self._number and self._running:
                self._take_cut(self._points.add(scan))
                if current or self._current is None:
                    self._current = scan.key
            case DirectionsPlanned(number, counts) if number == self._prediction:
                self._planned = counts
            case ScanPredicted(number, scan) if number == self._prediction:
                cut = self._points.predict(scan)
                if cut is None:
                    return
                self._take_cut(cut)
            case PredictionEnded(number, missing) if number == self._prediction and missing:
                self.prediction_missing.emit(missing)
                return
            case MisalignmentFound(number, text, where) if number == self._number:
                self.misaligned.emit(text, where)
                return
            case Failed(number, error) if number == self._number:
                self._fail(error)
                return
            case WorkerEnded() if self._stopped:  # at the end of a session; another worker would keep the window's process
                return
            case WorkerEnded("values"):  # the next run has another one
                self._values.close()
                self._values = self._new_values()
                self._fail(f"its process {ENDED}")
                return
            case WorkerEnded("predictions") if self._predictions is not None:
                self._predictions.close()
                self._predictions, self._predicted = self._new_predictions(), None
                self.prediction_missing.emit(f"the process that computes it {ENDED}")
                return
            case _:
                return
        if not self._redraw.isActive():
            self._redraw.start()

    def _take_cut(self, cut: Cut) -> None:
        key = cut.scan.key
        if key is not None and cut.scan.points.x_deg.size:
            self._unmapped[key] = cut
        if key is not None and key not in self._alarmed and cut.alarms.any():
            self._alarmed.add(key)
            worst = int(np.argmax(np.where(cut.alarms, np.abs(cut.residual), 0.0)))
            more = f", {int(cut.alarms.sum())} points" if cut.alarms.sum() > 1 else ""
            what = f"Residual above {ALARM_U:g} u: {cut.residual[worst]:+.1f} u at {cut.scan.points.x_deg[worst]:.1f}°{more}"
            self.alarmed.emit(what, cut.scan.title)

    @Slot()
    def _draw(self) -> None:
        key = self._current
        if key is None:
            return
        try:
            setting: Setting = key[0]
            cut = self._points.cuts[key] if self._phi_deg is None else self._points.plane(setting, self._phi_deg)
            if cut is not None:
                self._plot.show_cut(cut)
            self._draw_map(setting, self._points.cuts[key])
            self._map.show_plane(key[1], self._phi_deg)
        except Exception as error:  # noqa: BLE001  (any error of the plot: the measurement goes on)
            self._fail(f"{type(error).__name__}: {error}")

    def _draw_map(self, setting: Setting, cut: Cut) -> None:
        """Add to the map what is new of the setting in progress."""
        points = cut.scan.points
        transmitted = bool(points.x_deg.size and points.transmitted.all())
        place = setting, transmitted, cut.scan.y_label, self._points.predicted_scans(setting)
        if place != self._place:
            self._place = place
            self._map.begin(setting, self._points.planned(setting, transmitted))
            self._map.stamp(self._points.hemisphere(setting, transmitted))
        else:
            changed = [each for key, each in self._unmapped.items() if key[0] == setting]
            self._map.stamp(map_points([each for each in changed if each.scan.y_label == cut.scan.y_label], transmitted))
        self._unmapped.clear()
        self._map.show_points(
            self._points.hemisphere(setting, transmitted), self._planned.get((setting, transmitted), 0), cut.scan.y_label
        )

    def _fail(self, error: str) -> None:
        """Report the error. The plot of this run ends here, because the error would come back at every row."""
        self._running = False
        self._current = None
        self.failed.emit(f"The plot failed ({error}); the run is not affected.")


def _is_half_of_isotropic(plan: Plan) -> bool:
    """Whether a plan measures one side of the plane of incidence of a sample whose other side is its image."""
    beta = np.array([row.pose[2] for row in plan.rows if row.kind == "measure" and row.pose is not None])
    return plan.schedule.file.symmetry == "isotropic" and is_half(beta)


def _reading_text(cut: Cut, index: int) -> str:
    """A point as a line of text."""
    points = cut.scan.points
    value, u = points.values[index], points.u_values[index]
    unit = " 1/sr" if cut.scan.is_bsdf else ""
    text = f"{points.x_deg[index]:.2f}°: "
    text += f"{value:.4g} ± {u:.2g}{unit} (u)" if np.isfinite(value) else "no value"
    if np.isfinite(cut.expected[index]):
        text += f", predicted {cut.expected[index]:.4g}"
    if np.isfinite(cut.residual[index]):
        alarm = "  ✗ ALARM" if cut.alarms[index] else ""
        text += f", residual {cut.residual[index]:+.1f} u{alarm}"
    return text + (", blocked by the mirror unit" if points.blocked[index] else "")


def _note_text(cut: Cut, of: dict[MarkKind, Flags]) -> str:
    scan, points = cut.scan, cut.scan.points
    measured, counts = of["measured"], {kind: int(which.sum()) for kind, which in of.items()}
    text = f"●\u00a0{counts['measured']} measured"
    if measured.any():
        top = int(np.argmax(np.where(measured, points.values, -np.inf)))
        text += f", highest {points.values[top]:.3g} at {points.x_deg[top]:.1f}°"
    if transmitted := int((measured & points.transmitted).sum()):
        text += f"    ■\u00a0{transmitted} of these transmitted"
    if steep := int((measured & points.steep).sum()):
        text += f"    ◆\u00a0{steep} of these steep (measured too far apart: their u may be too small)"
    if points.blocked.any() or scan.blocked_deg:  # most have no value, so no mark; two photodiodes may measure one direction
        keys = direction_keys(*points.directions[points.blocked, :2].T)
        text += f"    ○\u00a0{len(np.unique(keys, axis=0))} blocked by the mirror unit (shaded)"
    if counts["untrusted"]:
        marks = points.marks[of["untrusted"]]
        names = ", ".join(name for name in REASON_ORDER if np.any(marks & BITS[name]))
        text += f"    ×\u00a0{counts['untrusted']} flagged" + (f" ({names})" if names else "")
    if counts["lost"]:
        text += f"    •▽\u00a0{counts['lost']} below detection limit (signal under {DETECTED:g} u)"
    if cut.line is not None:
        text += "    ━\u00a0predicted ± 2 u"
    if alarms := int(cut.alarms.sum()):
        text += f"    □\u00a0{alarms} residual above {ALARM_U:g} u ✗"
    return "\n".join([text, *(f"✗\u00a0{each}" for each in scan.findings)])
