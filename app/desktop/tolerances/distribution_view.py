"""The distribution of the criterion over all combinations of a study, as cumulative curves. It only shows."""

from typing import TYPE_CHECKING

from PySide6.QtCore import QPointF, QRectF, QSize, Qt
from PySide6.QtGui import QColor, QFontMetricsF, QPainter, QPaintEvent, QPen, QPolygonF
from PySide6.QtWidgets import QSizePolicy, QWidget

from goniotwin.app.desktop import model
from goniotwin.app.desktop.theme import Colours
from goniotwin.app.desktop.tolerances.tables import number_text, share_text

if TYPE_CHECKING:  # the window shows itself before the optics are loaded
    from goniotwin.app.desktop.model.tolerances import Distribution, StudyOutcome

NOTHING = "No study has been computed yet."
QUARTERS = (0.0, 0.25, 0.5, 0.75, 1.0)
ROOM_OF_VALUE = 52.0
"""Least distance in pixels of two values of the horizontal axis."""


class DistributionView(QWidget):
    """Share of the combinations within each value of the criterion: that of the chosen set thick, the others thin."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._outcome: StudyOutcome | None = None
        self._chosen = 0
        self.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Expanding)
        self.setMinimumSize(190, 96)
        self.setAccessibleName("Distribution of the criterion")
        self.set_outcome(None)

    @property
    def summary(self) -> str:
        """The chosen curve as text."""
        return self.accessibleDescription()

    def set_outcome(self, outcome: "StudyOutcome | None", chosen: int = 0) -> None:
        """Show the distributions of a study, one of them chosen; or that there are none."""
        self._outcome, self._chosen = outcome, chosen
        self.setAccessibleDescription(NOTHING if outcome is None else _text(outcome, outcome.distributions[chosen]))
        self.update()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.update()

    def sizeHint(self) -> QSize:
        """A comfortable size; Qt calls it."""
        return QSize(520, 260)

    def paintEvent(self, event: QPaintEvent) -> None:
        """Draw the curves; Qt calls it."""
        del event
        painter = QPainter(self)
        painter.setRenderHint(QPainter.RenderHint.Antialiasing)
        painter.fillRect(self.rect(), QColor(self._colours.base))
        if self._outcome is None:
            painter.setPen(QColor(self._colours.dim))
            painter.drawText(QRectF(self.rect()), Qt.AlignmentFlag.AlignCenter | Qt.TextFlag.TextWordWrap, NOTHING)
        else:
            self._draw(painter, self._outcome)
        painter.end()

    def _draw(self, painter: QPainter, outcome: "StudyOutcome") -> None:
        metrics = QFontMetricsF(painter.font())
        line = metrics.height()
        place = QRectF(self.rect()).adjusted(metrics.horizontalAdvance("100 %") + 12.0, line + 8.0, -14.0, -2.0 * line - 8.0)
        greatest = 1.04 * max((each.largest_percent for each in outcome.distributions), default=0.0)
        greatest = max(greatest, 1.2 * outcome.within[0])
        self._draw_axes(painter, place, greatest, outcome.quantity, line)
        for number, each in enumerate(outcome.distributions):
            if number != self._chosen:
                painter.setPen(QPen(QColor(self._colours.blocked), 1.2, Qt.PenStyle.SolidLine))
                painter.drawPolyline(_curve(each, place, greatest))
        chosen = outcome.distributions[self._chosen]
        painter.setPen(QPen(QColor(self._colours.points), 2.4))
        painter.drawPolyline(_curve(chosen, place, greatest))
        for limit, share, _ in chosen.shares:
            self._draw_limit(painter, place, greatest, limit, share, line)
        painter.setPen(QColor(self._colours.text))
        limit, share, error = chosen.shares[0]
        heading = QRectF(8.0, 2.0, self.width() - 16.0, line)
        text = f"SIMULATED: {chosen.name}: {share_text(share, error)} within {limit:g} %"
        painter.drawText(
            heading, Qt.AlignmentFlag.AlignLeft, metrics.elidedText(text, Qt.TextElideMode.ElideRight, heading.width())
        )

    def _draw_axes(self, painter: QPainter, place: QRectF, greatest: float, quantity: str, line: float) -> None:
        colours = self._colours
        few = place.height() < 5.0 * line
        for share in QUARTERS:
            y = place.bottom() - share * place.height()
            painter.setPen(QPen(QColor(colours.line), 1.0))
            painter.drawLine(QPointF(place.left(), y), QPointF(place.right(), y))
            if not few or share in (0.0, 1.0):
                painter.setPen(QColor(colours.text))
                text = QRectF(0.0, y - 0.5 * line, place.left() - 6.0, line)
                painter.drawText(text, Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter, f"{100.0 * share:.0f} %")
        for value in model.linear_ticks(0.0, greatest, place.width(), ROOM_OF_VALUE):
            x = place.left() + place.width() * value / greatest
            painter.setPen(QPen(QColor(colours.line), 1.0))
            painter.drawLine(QPointF(x, place.top()), QPointF(x, place.bottom() + 3.0))
            painter.setPen(QColor(colours.text))
            text = QRectF(x - 30.0, place.bottom() + 3.0, 60.0, line)
            painter.drawText(text, Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop, f"{value:g}")
        below = QRectF(place.left(), place.bottom() + line + 3.0, place.width(), line)
        title = QFontMetricsF(painter.font()).elidedText(f"{quantity}, %", Qt.TextElideMode.ElideRight, below.width())
        painter.drawText(below, Qt.AlignmentFlag.AlignHCenter | Qt.AlignmentFlag.AlignTop, title)

    def _draw_limit(self, painter: QPainter, place: QRectF, greatest: float, limit: float, share: float, line: float) -> None:
        """A limit of the criterion, with the point of the chosen curve there."""
        x, y = place.left() + place.width() * limit / greatest, place.bottom() - share * place.height()
        if x > place.right():
            return
        colour = QColor(self._colours.bad)
        painter.setPen(QPen(colour, 1.4, Qt.PenStyle.DashLine))
        painter.drawLine(QPointF(x, place.top()), QPointF(x, place.bottom()))
        painter.setPen(colour)
        painter.drawText(QPointF(x + 4.0, place.bottom() - 0.3 * line), f"{limit:g} %")
        painter.setPen(QPen(QColor(self._colours.text), 1.2))
        painter.setBrush(QColor(self._colours.points))
        painter.drawEllipse(QPointF(x, y), 4.0, 4.0)
        painter.setBrush(Qt.BrushStyle.NoBrush)


def _curve(each: "Distribution", place: QRectF, greatest: float) -> QPolygonF:
    width = place.width() * each.largest_percent / greatest / len(each.cumulative)
    points = [QPointF(place.left(), place.bottom())]
    for number, share in enumerate(each.cumulative, 1):
        points.append(QPointF(place.left() + number * width, place.bottom() - share * place.height()))
    return QPolygonF(points)


def _text(outcome: "StudyOutcome", each: "Distribution") -> str:
    """The distribution in words: shares within its limits, quarters, and the worst."""
    parts = [f"{share_text(share, error)} within {limit:g} %" for limit, share, error in each.shares]
    step = each.largest_percent / len(each.cumulative)
    for quarter in QUARTERS[1:4]:
        found = next((number for number, share in enumerate(each.cumulative, 1) if share >= quarter), None)
        if found is not None:
            parts.append(f"{100.0 * quarter:.0f} % within {found * step:.2f} %")
    parts.append(f"the worst {number_text(each.worst_percent)} %")
    return f"SIMULATED, {each.name}, {outcome.quantity}: {', '.join(parts)}"
