"""The pictures of the results screen: the hemisphere and the cut, each with a cursor on a value."""

import numpy as np
import pyqtgraph as pg
from PySide6.QtCore import QEvent, QObject, QPointF, Qt, Signal
from PySide6.QtGui import QKeyEvent, QResizeEvent
from PySide6.QtWidgets import QLabel, QVBoxLayout, QWidget

from goniotwin.app.desktop.disc import LOW, DiscView
from goniotwin.app.desktop.figures import PanelItems
from goniotwin.app.desktop.model.results import Shown
from goniotwin.app.desktop.run.axes import AXIS_WIDTH, AngleAxis, ValueAxis
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.figures.curves import ANGLE_LIMITS
from goniotwin.app.figures.description import Marks, Panel, Series
from goniotwin.app.figures.hemisphere import HORIZON_DEG
from goniotwin.app.figures.style import DISC, MarkKind

STEPS = {Qt.Key.Key_Left: (-1, 0), Qt.Key.Key_Right: (1, 0), Qt.Key.Key_Up: (0, 1), Qt.Key.Key_Down: (0, -1)}
SIGNS: dict[MarkKind, str] = {"lost": "•", "below": "▽", "blocked": "○", "untrusted": "×"}
CURSOR = 15
"""Diameter of the cursor's ring on the map."""
RINGS = ((DISC.base, 5), (DISC.text, 2))
"""Colour and width of the cursor's ring and of its edge, which is seen on any colour."""
PLANE = Series(np.array([-HORIZON_DEG, HORIZON_DEG]), np.zeros(2), "predicted", line="dashed")


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
        """Show the values of a light."""
        found, data = shown.map, shown.data
        filled = np.zeros(found.x.size, dtype=bool) if found.filled is None else found.filled
        coloured = found.trusted | filled
        self._empty()
        self._mirrored = found.mirrored
        self._set_density(found.x.size * (2 if found.mirrored else 1))
        self._set_bar(found.bar)
        self._stamp(found.x[coloured], found.y[coloured], found.values[coloured])
        self._paint()
        panel = shown.disc
        marks = [Marks("untrusted", found.x[~coloured], found.y[~coloured])]
        marks += [Marks("lost", found.x[filled], found.y[filled], "base")]
        self._items.show(Panel(projection="disc", series=(*panel.series, PLANE), marks=(*panel.marks, *marks)))
        top = shown.highest
        text = f"{found.x.size} directions, highest {found.values[top]:.3g} at polar angle {data.column('polar_deg')[top]:.0f}°"
        self._write("; ".join([text, *panel.title.split("\n")[1:]]).replace(" %", "\u00a0%"))

    def set_cursor(self, shown: Shown, index: int) -> None:
        """Put the cursor on a value."""
        for each in self._rings:
            each.setData(shown.map.x[[index]], shown.map.y[[index]])

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self.keys.set_colours(colours)


class ResultCut(QWidget):
    """The values of a light in the plane of incidence, with their bands; its marks in words below."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._shown: Shown | None = None
        self._axis = ValueAxis()
        self._view = pg.PlotWidget(axisItems={"left": self._axis, "bottom": AngleAxis()})
        self._view.setAccessibleName("Cut in the plane of incidence")
        self.keys = CursorKeys(self._view)
        self._plot: pg.PlotItem = self._view.getPlotItem()
        self._plot.setMenuEnabled(False)
        self._plot.hideButtons()
        self._plot.showGrid(x=True, y=True, alpha=0.15)
        self._plot.setXRange(*ANGLE_LIMITS, padding=0.0)
        self._items = PanelItems(self._plot, colours)
        self._line, self._ring = pg.InfiniteLine(angle=90), pg.ScatterPlotItem(symbol="o", size=CURSOR, brush=None)
        for item in (self._line, self._ring):
            self._plot.addItem(item, ignoreBounds=True)
        self._note = QLabel()
        self._note.setWordWrap(True)
        self._note.setAccessibleName("The cut as text")
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._view, 1)
        layout.addWidget(self._note)
        self.set_colours(colours)

    @property
    def summary(self) -> str:
        """The content of the cut as text."""
        return self._note.text()

    def show_values(self, shown: Shown) -> None:
        """Show the values of a light."""
        self._shown, panel = shown, shown.cut
        self._items.show(panel)
        if panel.scale is not None and panel.y.limits is not None:
            self._axis.set_value_scale(panel.scale)
            self._plot.setYRange(*panel.scale.transform(np.array(panel.y.limits)).tolist(), padding=0.0)
        key = [f"{SIGNS[kind]}\u00a0{meaning}" for kind, meaning in panel.key]
        self._note.setText("; ".join([shown.missing or panel.legend, *key]).replace(" %", "\u00a0%"))
        self._view.setToolTip(self.summary)
        self._view.setAccessibleDescription(self.summary)
        self._label()

    def set_cursor(self, shown: Shown, index: int) -> None:
        """Put the cursor on a value, where it is in the plane of incidence."""
        there = np.flatnonzero(shown.plane == index)
        for item in (self._line, self._ring):
            item.setVisible(there.size > 0)
        if there.size and shown.cut.scale is not None:
            x, value = shown.abscissa[there[:1]], shown.data.column("bsdf")[[index]]
            self._line.setValue(float(x[0]))
            self._ring.setData(x, shown.cut.scale.transform(np.nan_to_num(value)))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.keys.set_colours(colours)
        for name in ("left", "bottom"):
            self._plot.getAxis(name).setPen(colours.line)
            self._plot.getAxis(name).setTextPen(colours.text)
        self._items.set_palette(colours)
        self._line.setPen(pg.mkPen(colours.dim, width=1, style=Qt.PenStyle.DashLine))
        self._ring.setPen(pg.mkPen(colours.text, width=2))
        self._label()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Leave the room to the plot where there is little; Qt calls it."""
        super().resizeEvent(event)
        self._note.setVisible(self.height() >= LOW)
        self._label()

    def _label(self) -> None:
        panel = Panel() if self._shown is None else self._shown.cut
        wide = self.fontMetrics().horizontalAdvance(panel.x.label) > self._view.width() - AXIS_WIDTH
        self._plot.setLabel("bottom", panel.x.label.partition(";")[0] if wide else panel.x.label, color=self._colours.text)
        self._plot.setLabel("left", panel.y.label, color=self._colours.text)
