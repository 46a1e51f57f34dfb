"""The pictures of the results screen: the hemisphere, and a cut or another picture, each with a cursor on a value."""

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from goniotwin.app.data.results import Shown
from goniotwin.app.desktop.disc import LOW, DiscView
from goniotwin.app.desktop.figures import LINEAR, PanelItems
from goniotwin.app.desktop.run.axes import AXIS_WIDTH, AngleAxis, ResidualAxis, ValueAxis
from goniotwin.app.desktop.run.cut_panel import LEAST_RESIDUAL, MOST_RESIDUAL
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.curves import ANGLE_LIMITS
from goniotwin.app.figures.description import Marks, Panel, Series
from goniotwin.app.figures.hemisphere import HORIZON_DEG, places
from goniotwin.app.figures.style import DISC, MarkKind
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG

STEPS = {Qt.Key.Key_Left: (-1, 0), Qt.Key.Key_Right: (1, 0), Qt.Key.Key_Up: (0, 1), Qt.Key.Key_Down: (0, -1)}
SIGNS: dict[MarkKind, str] = {"lost": "•", "below": "▽", "blocked": "○", "untrusted": "×"}
MARGIN, POLAR_MARGIN = 0.05, 0.1
"""Room beside a spectrum, and about a polar diagram for the texts of its angles, over their width."""
CURSOR = 15
"""Diameter of the cursor's ring on the map."""
RINGS = ((DISC.base, 5), (DISC.text, 2))
"""Colour and width of the cursor's ring and of its edge, which is seen on any colour."""


class CursorKeys(QObject):
    """Moves of a cursor in a plot, which Tab reaches: by the arrow keys to the right and up, and by a click to a place."""

    pressed = Signal(int, int)
    clicked = Signal(float, float)

    def __init__(self, view: pg.PlotWidget) -> None:
        super().__init__(view)
        self.view = view
        view.viewport().setFocusPolicy(Qt.FocusPolicy.NoFocus)  # else Tab stops at it; the view gets it, too
        view.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
        view.installEventFilter(self)
        view.scene().sigMouseClicked.connect(lambda event: self._click(event.scenePos()))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._frame = colours.accent
        self.view.setBackground(colours.base)
        self._show_focus()

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Take the arrow keys, and show the focus by a frame; Qt calls it."""
        if event.type() in (QEvent.Type.FocusIn, QEvent.Type.FocusOut):
            self._show_focus()
        step = STEPS.get(Qt.Key(event.key())) if isinstance(event, QKeyEvent) else None
        if step is None or event.type() != QEvent.Type.KeyPress:
            return super().eventFilter(watched, event)
        self.pressed.emit(*step)
        return True

    def _show_focus(self) -> None:
        self.view.getPlotItem().vb.setBorder(pg.mkPen(self._frame, width=2) if self.view.hasFocus() else None)

    def _click(self, at: QPointF) -> None:
        place = self.view.getPlotItem().vb.mapSceneToView(at)
        self.clicked.emit(place.x(), place.y())


class ResultMap(DiscView):
    """The values of a light over the hemisphere."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours, "Hemisphere of the results")
        self.keys = CursorKeys(self._view)
        self._rings = [
            pg.ScatterPlotItem(symbol="o", size=CURSOR, brush=None, pen=pg.mkPen(each[0], width=each[1])) for each in RINGS
        ]
        for each in self._rings:
            each.setZValue(9)
            self._plot.addItem(each)
        self.set_colours(colours)

    def show_values(self, shown: Shown) -> None:
        """Show the values of a light, or their deviations from a second dataset."""
        found, data = shown.map, shown.data
        filled = np.zeros(found.x.size, dtype=bool) if found.filled is None else found.filled
        coloured = found.trusted | filled
        self._empty()
        self._mirrored = found.mirrored
        self._set_bar(found.bar)
        if shown.image is not None:
            self._fill(shown.image)
        else:
            self._set_density(found.x.size * (2 if found.mirrored else 1))
            self._stamp(found.x[coloured], found.y[coloured], found.values[coloured])
        self._paint()
        panel, line = shown.disc, list[Series]()
        if shown.plane.size:
            ends = places(np.full(2, HORIZON_DEG), np.array([0.0, HALF_TURN_DEG]) + shown.plane_deg)
            line = [Series(*ends, "predicted", line="dashed")]
        marks = [Marks("untrusted", found.x[~coloured], found.y[~coloured])]
        marks += [Marks("lost", found.x[filled], found.y[filled], "base")]
        self._items.show(Panel(projection="disc", series=(*panel.series, *line), marks=(*panel.marks, *marks)))
        top = shown.highest
        highest = f"{data.column('bsdf')[top]:.3g} at polar angle {data.column('polar_deg')[top]:.0f}°"
        text = f"{found.x.size} directions{', the other half is their image' if found.mirrored else ''}; highest {highest}"
        self._write("; ".join([text, *filter(None, panel.title.split("\n")[1:])]).replace(" %", "\u00a0%"))

    def set_cursor(self, shown: Shown, index: int) -> None:
        """Put the cursor on a value."""
        for each in self._rings:
            each.setData(shown.map.x[[index]], shown.map.y[[index]])

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.keys.set_colours(colours)


class ResultPlot(QWidget):
    """The picture beside the map, a cut or another one, above the residuals of a cut; its marks in words below."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self._axis, self._angles = ValueAxis(), AngleAxis()
        self._view = pg.PlotWidget(axisItems={"left": self._axis, "bottom": self._angles})
        self._view.setAccessibleName("Picture beside the hemisphere")
        self._residual = pg.PlotWidget(axisItems={"left": ResidualAxis(), "bottom": AngleAxis()})
        self._residual.setAccessibleName("Residuals of the cut")
        self._residual.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self._residual.viewport().setFocusPolicy(Qt.FocusPolicy.NoFocus)
        self.keys = CursorKeys(self._view)
        self._plots: tuple[pg.PlotItem, ...] = self._view.getPlotItem(), self._residual.getPlotItem()
        for each in self._plots:
            each.setMenuEnabled(False)
            each.hideButtons()
            each.showGrid(x=True, y=True, alpha=0.15)
        self._items = [PanelItems(each, colours) for each in self._plots]
        self._line, self._ring = pg.InfiniteLine(angle=90), pg.ScatterPlotItem(symbol="o", size=CURSOR, brush=None)
        for item in (self._line, self._ring):
            self._plots[0].addItem(item, ignoreBounds=True)
        self._note = QLabel()
        self._note.setWordWrap(True)
        self._note.setAccessibleName("The picture as text")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        for part, share in ((self._view, 3), (self._residual, 1), (self._note, 0)):
            layout.addWidget(part, share)
        self.set_colours(colours)

    @property
    def summary(self) -> str:
        """The content of the picture as text."""
        return self._note.text()

    def show_values(self, shown: Shown) -> None:
        """Show the picture of a view."""
        self._shown, panel, (plot, below) = shown, shown.beside or Panel(), self._plots
        flat = panel.projection == "polar"
        self._items[0].show(panel)
        for name in ("left", "bottom"):
            plot.showAxis(name, not flat)
        plot.showGrid(x=not flat, y=not flat, alpha=0.15)
        plot.setAspectLocked(flat)
        scale = LINEAR if flat or panel.scale is None else panel.scale
        self._axis.set_value_scale(scale)
        if flat and panel.y.limits is not None:
            outer = panel.y.limits[1]
            plot.setRange(xRange=(-outer, outer), yRange=(-outer if panel.angles else 0.0, outer), padding=POLAR_MARGIN)
        else:
            self._angles.of_angles = panel.x.limits is not None
            known = np.concatenate([each.x for each in panel.series] or [np.zeros(1)])
            ends = panel.x.limits or (float(known.min()), float(known.max()))
            plot.setXRange(*ends, padding=0.0 if panel.x.limits else MARGIN)
            if panel.y.limits is not None:
                plot.setYRange(*scale.transform(np.array(panel.y.limits)).tolist(), padding=0.0)
        if shown.residual is not None:
            self._items[1].show(shown.residual)
            below.setXRange(*ANGLE_LIMITS, padding=0.0)
            largest = max((float(np.nanmax(np.abs(each.y), initial=0.0)) for each in shown.residual.series), default=0.0)
            half = min(max(1.1 * largest, LEAST_RESIDUAL), MOST_RESIDUAL)
            below.setYRange(-half, half, padding=0.0)
        key = [f"{SIGNS[kind]}\u00a0{meaning}" for kind, meaning in panel.key]
        self._note.setText("; ".join(filter(None, [shown.about, shown.missing or panel.legend, *key])).replace(" %", "\u00a0%"))
        self._view.setToolTip(self.summary)
        self._view.setAccessibleDescription(self.summary)
        self._fit()

    def set_cursor(self, shown: Shown, index: int) -> None:
        """Put the cursor on a value, where it is in the cut."""
        there = np.flatnonzero(shown.plane == index)
        for item in (self._line, self._ring):
            item.setVisible(there.size > 0)
        if there.size and shown.beside is not None and shown.beside.scale is not None:
            x, value = shown.abscissa[there[:1]], shown.data.column("bsdf")[[index]]
            self._line.setValue(float(x[0]))
            self._ring.setData(x, shown.beside.scale.transform(np.nan_to_num(value)))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.keys.set_colours(colours)
        self._residual.setBackground(colours.base)
        for plot, items in zip(self._plots, self._items, strict=True):
            for name in ("left", "bottom"):
                plot.getAxis(name).setPen(colours.line)
                plot.getAxis(name).setTextPen(colours.text)
            items.set_palette(colours)
        self._line.setPen(pg.mkPen(colours.dim, width=1, style=Qt.PenStyle.DashLine))
        self._ring.setPen(pg.mkPen(colours.text, width=2))
        self._fit()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the plot where there is little; Qt calls it."""
        super().resizeEvent(event)
        self._fit()

    def _fit(self) -> None:
        """Show the parts that have room, with labels that have it."""
        shown = self._shown
        self._note.setVisible(self.height() >= LOW)
        self._residual.setVisible(shown is not None and shown.residual is not None and self.height() >= LOW)
        panel = Panel() if shown is None or shown.beside is None else shown.beside
        wide = self.fontMetrics().horizontalAdvance(panel.x.label) > self._view.width() - AXIS_WIDTH
        labels = (
            ("", "")
            if panel.projection == "polar"
            else (panel.x.label.partition(";")[0] if wide else panel.x.label, panel.y.label)
        )
        for name, label in zip(("bottom", "left"), labels, strict=True):
            self._plots[0].getAxis(name).setLabel(label, color=self._colours.text)  # that of the plot would show the axis
        if shown is not None and shown.residual is not None:
            self._plots[1].setLabel("left", shown.residual.title.partition(":")[0], color=self._colours.text)
