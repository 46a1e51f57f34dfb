"""The tables of a tolerance study: its deviations, with bars, and its sets of combinations. They only show."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from PySide6.QtCore import QModelIndex, QPersistentModelIndex, QRectF, Qt
from PySide6.QtGui import QColor, QPainter, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHeaderView,
    QStyle,
    QStyledItemDelegate,
    QStyleOptionViewItem,
    QTableWidget,
    QTableWidgetItem,
)

from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the optics are loaded
    from goniotwin.app.desktop.model.tolerances import DeviationResult, Distribution, StudyContent, StudyOutcome

BAR = Qt.ItemDataRole.UserRole
"""Role of a cell's bar: its length from 0 to 1; below 0 it goes to the left of the middle."""
BEYOND, SIGNED = BAR + 1, BAR + 2
"""Roles: whether the value is beyond its limit, and whether the bars of the column have both signs."""
BAR_HEIGHT, MARGIN = 4.0, 5.0
ROW_ROOM = 13
"""Pixels of a row beside its text: the bar is below it."""
LONGEST_NAME, LEAST_BAR = 240, 62
"""Widest column, and narrowest of bars, in a table that has no room to spare."""
PADDING = 4


@dataclass(frozen=True)
class Cell:
    """Text of a cell, with a tool tip, and the length of its bar if it has one."""

    text: str
    tip: str = ""
    bar: float | None = None
    beyond: bool = False
    signed: bool = False


class Bars(QStyledItemDelegate):
    """Draws the cells of a table, with a bar below the text where there is one."""

    def __init__(self, table: QTableWidget, colours: Colours) -> None:
        super().__init__(table)
        self.colours = colours

    def paint(self, painter: QPainter, option: QStyleOptionViewItem, index: QModelIndex | QPersistentModelIndex) -> None:
        """Draw a cell; Qt calls it."""
        super().paint(painter, option, index)
        length = index.data(BAR)
        if length is None:
            return
        state, rect = getattr(option, "state"), QRectF(getattr(option, "rect"))  # noqa: B009  # the stub lacks them
        place = QRectF(rect.left() + MARGIN, rect.bottom() - BAR_HEIGHT - 2.0, rect.width() - 2.0 * MARGIN, BAR_HEIGHT)
        chosen = bool(state & QStyle.StateFlag.State_Selected)
        colours = self.colours
        colour = colours.on_accent if chosen else colours.bad if index.data(BEYOND) else colours.points
        painter.fillRect(place, QColor(colours.line))
        zero = place.center().x() if index.data(SIGNED) else place.left()
        reach = 0.5 * place.width() if index.data(SIGNED) else place.width()
        end = zero + reach * max(-1.0, min(1.0, length))
        painter.fillRect(QRectF(min(zero, end), place.top(), abs(end - zero), BAR_HEIGHT), QColor(colour))
        if index.data(SIGNED):
            painter.fillRect(QRectF(zero - 0.5, place.top() - 1.0, 1.0, BAR_HEIGHT + 2.0), QColor(colours.text))


class NumberTable(QTableWidget):
    """A table of names and numbers. The arrow keys go from row to row."""

    def __init__(self, name: str, colours: Colours) -> None:
        super().__init__(0, 0)
        self.setAccessibleName(name)
        self.verticalHeader().hide()
        self.verticalHeader().setDefaultSectionSize(self.fontMetrics().height() + ROW_ROOM)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setHorizontalScrollMode(QAbstractItemView.ScrollMode.ScrollPerPixel)
        self.setTabKeyNavigation(False)
        self.setMinimumSize(160, 76)
        header = self.horizontalHeader()
        header.setHighlightSections(False)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self._bars = Bars(self, colours)
        self.setItemDelegate(self._bars)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._bars.colours = colours
        self.viewport().update()

    def fill(self, columns: Sequence[tuple[str, str]], rows: Iterable[Sequence[Cell]]) -> None:
        """Show rows under columns with a title and a tool tip each. The first column is text, the others are numbers."""
        lines = list(rows)
        self.setColumnCount(len(columns))
        self.setRowCount(len(lines))
        left = Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter
        right = Qt.AlignmentFlag.AlignRight | Qt.AlignmentFlag.AlignVCenter
        for column, (title, tip) in enumerate(columns):
            item = QTableWidgetItem(title)
            item.setToolTip(tip)
            item.setTextAlignment(right if column else left)
            self.setHorizontalHeaderItem(column, item)
        for row, cells in enumerate(lines):
            for column, cell in enumerate(cells):
                item = QTableWidgetItem(cell.text)
                item.setToolTip(cell.tip or cell.text)
                item.setTextAlignment(right if column else left)
                if cell.bar is not None:
                    item.setData(BAR, cell.bar)
                    item.setData(BEYOND, cell.beyond)
                    item.setData(SIGNED, cell.signed)
                self.setItem(row, column, item)
        self._fit_columns()

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Follow the width; Qt calls it."""
        super().resizeEvent(event)
        self._fit_columns()

    def _fit_columns(self) -> None:
        """Make the columns as wide as their texts, and share what is left among them."""
        header, widths = self.horizontalHeader(), []
        for column in range(self.columnCount()):
            least = LEAST_BAR if any(self._has_bar(row, column) for row in range(self.rowCount())) else 0
            texts = max(self.sizeHintForColumn(column), header.sectionSizeHint(column)) + PADDING
            widths.append(max(least, min(texts, LONGEST_NAME)))
        spare = max(self.viewport().width() - sum(widths), 0)
        for column, width in enumerate(widths):
            header.resizeSection(column, width + spare // len(widths) + (column < spare % len(widths)))

    def _has_bar(self, row: int, column: int) -> bool:
        item = self.item(row, column)
        return item is not None and item.data(BAR) is not None

    @property
    def chosen(self) -> int:
        """The number of the chosen row, or -1."""
        return min((each.row() for each in self.selectedIndexes()), default=-1)


def show_content(table: NumberTable, content: "StudyContent | None") -> None:
    """Show the deviations of a study that is not computed."""
    columns = (("deviation", "Element and deviation"), ("range", "Its limits"), ("step", "Step of the combinations"))
    table.fill(columns, [[Cell(text) for text in row] for row in content.deviations] if content is not None else [])


def show_deviations(table: NumberTable, outcome: "StudyOutcome") -> None:
    """Show the deviations of a study with what was found."""
    limit = outcome.within[0]
    columns = [
        ("deviation", "Element and deviation"),
        ("range", "Its limits"),
        ("alone, %", f"Each deviation alone at its limits: {outcome.quantity}"),
        (f"{limit:g} % at", f"Each deviation alone: where it reaches {limit:g} %"),
        ("one factor", "Limits of all together, reduced by one factor until no combination fails"),
        ("individual", "Limits alone, reduced by one factor until no combination fails"),
    ]
    with_slopes = outcome.deviations[0].peak_deg is not None
    if with_slopes:
        columns += [
            ("peak, °", "Shift of the measured peak by a deviation at its limit"),
            ("incidence, °", "Change of the incidence by a deviation at its limit"),
            ("place, mm", "Shift of the light on the sample by a deviation at its limit"),
        ]
    greatest = max([limit, *(each.percent for each in outcome.deviations if math.isfinite(each.percent))])
    slopes = [
        _sensitivity_column(outcome.deviations, [each.peak_deg or 0.0 for each in outcome.deviations], "°", signed=True),
        _sensitivity_column(outcome.deviations, [each.incidence_deg or 0.0 for each in outcome.deviations], "°", signed=True),
        _sensitivity_column(outcome.deviations, [each.place_mm or 0.0 for each in outcome.deviations], " mm", signed=False),
    ]
    rows = []
    for k, each in enumerate(outcome.deviations):
        row = [
            Cell(each.title),
            Cell(f"±{each.limit:g} {each.unit}"),
            _alone_cell(each, limit, greatest),
            Cell(f"{each.alone:.3f}" if math.isfinite(each.alone) else f"> {each.searched:g}"),
            Cell(f"{each.common:.4f}"),
            Cell(f"{each.individual:.4f}"),
        ]
        rows.append([*row, *(column[k] for column in slopes)] if with_slopes else row)
    table.fill(columns, rows)


def _alone_cell(each: "DeviationResult", limit: float, greatest: float) -> Cell:
    minus, plus = number_text(each.at_minus_percent), number_text(each.at_plus_percent)
    beyond = not each.percent <= limit
    share = each.percent / greatest if math.isfinite(each.percent) else 1.0
    mark = "✗ " if beyond else ""
    tip = f"at −{each.limit:g} {each.unit}: {minus} %, at +{each.limit:g} {each.unit}: {plus} %"
    return Cell(f"{mark}{number_text(each.percent)}", tip, share, beyond)


def _sensitivity_column(
    deviations: Sequence["DeviationResult"], slopes: Sequence[float], unit: str, *, signed: bool
) -> list[Cell]:
    """The change by each deviation at its limit, with the sensitivity in the tool tip."""
    values = [slope * each.limit for slope, each in zip(slopes, deviations, strict=True)]
    greatest = max(abs(value) for value in values) or 1.0
    return [
        Cell(
            (f"{value:+.3f}" if signed and abs(value) >= 5e-4 else f"{abs(value):.3f}").replace("-", "−"),
            f"{slope:+.3f}{unit} per {each.unit}".replace("-", "−"),
            value / greatest,
            signed=signed,
        )
        for value, slope, each in zip(values, slopes, deviations, strict=True)
    ]


def show_distributions(table: NumberTable, outcome: "StudyOutcome | None") -> None:
    """Show the sets of combinations of a study; the first is chosen."""
    limits = outcome.within if outcome is not None else (5.0,)
    columns = [
        ("set", "The study, its variants, and its yields"),
        ("combinations", "Number of combinations that were evaluated; random corners where all would be too many"),
        ("median, %", "Half of the combinations are within it"),
        ("worst, %", "The worst corner, found by search; of a yield the worst that was drawn"),
        *((f"within {each:g} %", "Share of the combinations that pass, with its standard error") for each in limits),
        ("alone, %", "The worst deviation alone at its limit"),
        ("factor", "Factor of all limits with which no combination fails"),
    ]
    table.fill(columns, [] if outcome is None else map(_distribution_row, outcome.distributions))
    if outcome is not None:
        table.selectRow(0)


def _distribution_row(each: "Distribution") -> list[Cell]:
    kind = "" if each.complete else " drawn" if each.factor is None else " corners"
    error = each.surrogate_error_percent
    tip = "" if error is None else f"By a surrogate with an error of {error:.3f} points; the worst ones are exact"
    return [
        Cell(each.name),
        Cell(f"{each.number:,}{kind}{'' if error is None else ' (surrogate)'}", tip),
        Cell(number_text(each.median_percent)),
        Cell(number_text(each.worst_percent)),
        *(Cell(share_text(share, error), bar=share) for _, share, error in each.shares),
        Cell("" if each.alone_percent is None else number_text(each.alone_percent)),
        Cell("" if each.factor is None else f"{each.factor:.4f}"),
    ]


def number_text(value: float) -> str:
    """A criterion in percent without its unit."""
    return f"{value:.2f}" if math.isfinite(value) else "no value"


def share_text(share: float, error: float) -> str:
    """A share in percent, with its standard error in brackets if it was counted."""
    return f"{100.0 * share:.1f} %" if error == 0.0 else f"{100.0 * share:.1f}({100.0 * error:.1f}) %"
