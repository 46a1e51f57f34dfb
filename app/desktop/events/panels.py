"""The log of events, the safety orders above everything else, and the line of an open question."""

from collections import deque
from dataclasses import dataclass

from PySide6.QtCore import QDateTime, Qt, QTimer, Signal, Slot
from PySide6.QtGui import QColor, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFrame,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
    QWidget,
)

from goniotwin.app.campaign.running.events import SafetyOrder
from goniotwin.app.desktop.theme import Colours

COLUMNS = ("time", "what", "where", "consequence")
MAX_ENTRIES = 2000
"""Entries that the window shows. The journal has all events of a run."""


@dataclass(frozen=True)
class LogEntry:
    """An entry of the log. `serious`: a person should look at it."""

    what: str
    where: str = ""
    consequence: str = ""
    serious: bool = False


class EventTable(QTableWidget):
    """A table whose columns share the width."""

    def __init__(self) -> None:
        super().__init__(0, len(COLUMNS))
        self._fit = QTimer(self, interval=0, singleShot=True)
        self._fit.timeout.connect(self.resizeRowsToContents)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Share the width among the columns; Qt calls it."""
        super().resizeEvent(event)
        time = self.fontMetrics().horizontalAdvance("00:00:00") + 14
        rest = max(self.viewport().width() - time, 0)
        for column, width in enumerate((time, rest * 48 // 100, rest * 26 // 100, rest - rest * 74 // 100)):
            self.setColumnWidth(column, width)
        self._fit.start()


class EventLog(QWidget):
    """The events, the latest first: the time of the calendar, what happened, where, and the consequence."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._entries: deque[LogEntry] = deque()
        self._heading = QLabel()
        self._table = EventTable()
        self._table.setObjectName("events")
        self._table.setAccessibleName("Events")
        self._table.setHorizontalHeaderLabels(COLUMNS)
        self._table.verticalHeader().hide()
        self._table.setWordWrap(True)
        self._table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self._table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self._table.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self._table.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOn)  # else the width follows the heights
        self._table.setTabKeyNavigation(False)
        header = self._table.horizontalHeader()
        header.setHighlightSections(False)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(2)
        layout.addWidget(self._heading)
        layout.addWidget(self._table)
        self._show_heading()

    @property
    def entries(self) -> list[LogEntry]:
        """The entries, the latest first."""
        return list(self._entries)

    def add(self, entry: LogEntry) -> None:
        """Add an entry, now."""
        now = QDateTime.currentDateTime()
        if len(self._entries) == MAX_ENTRIES:
            self._entries.pop()
            self._table.removeRow(MAX_ENTRIES - 1)
        self._entries.appendleft(entry)
        self._table.insertRow(0)
        mark = "✗ " if entry.serious else ""
        texts = (now.toString("HH:mm:ss"), mark + entry.what, entry.where, entry.consequence)
        for column, text in enumerate(texts):
            item = QTableWidgetItem(text)
            item.setToolTip(now.toString(Qt.DateFormat.ISODate) if column == 0 else text)
            item.setTextAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
            item.setForeground(self._colour(entry))
            self._table.setItem(0, column, item)
        self._table.resizeRowToContents(0)
        self._show_heading()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        for row, entry in enumerate(self._entries):
            for column in range(len(COLUMNS)):
                item = self._table.item(row, column)
                assert item is not None
                item.setForeground(self._colour(entry))

    def _colour(self, entry: LogEntry) -> QColor:
        return QColor(self._colours.bad if entry.serious else self._colours.text)

    def _show_heading(self) -> None:
        serious = sum(entry.serious for entry in self._entries)
        look = f" · {serious} to look at (✗)" if serious else ""
        self._heading.setText(f"<b>Events</b>, the latest first{look}")


class OrdersPanel(QWidget):
    """The safety orders that are not acknowledged yet."""

    acknowledged = Signal(object)

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._rows: dict[SafetyOrder, OrderRow] = {}
        self._layout = QVBoxLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setSpacing(1)
        self.hide()

    @property
    def orders(self) -> list[SafetyOrder]:
        """The orders, in the order in which they were given."""
        return list(self._rows)

    def add(self, order: SafetyOrder) -> None:
        """Show an order; one that is shown already is not shown twice."""
        if order in self._rows:
            return
        row = OrderRow(order)
        row.acknowledged.connect(self.acknowledge)
        self._rows[order] = row
        self._layout.addWidget(row)
        row.set_colours(self._colours)
        self.setAccessibleName(f"Safety order: {order.text}")
        self.show()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        for row in self._rows.values():
            row.set_colours(colours)

    @Slot(object)
    def acknowledge(self, order: SafetyOrder) -> None:
        """Remove an order, and report that it is acknowledged."""
        row = self._rows.pop(order, None)
        if row is not None:
            row.hide()
            row.deleteLater()
            self.setVisible(bool(self._rows))
            self.acknowledged.emit(order)


class OrderRow(QFrame):
    """A safety order with its button."""

    acknowledged = Signal(object)

    def __init__(self, order: SafetyOrder) -> None:
        super().__init__()
        self._order = order
        text = QLabel(f"SAFETY: {order.order}")
        font = text.font()
        font.setBold(True)
        font.setPointSizeF(1.3 * font.pointSizeF())
        text.setFont(font)
        reason = QLabel(order.reason)
        for label in (text, reason):
            label.setWordWrap(True)
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        button = QPushButton("Acknowledge")
        button.setAccessibleName(f"Acknowledge: {order.text}")
        button.setToolTip("It is done, or seen to. The journal records it.")
        button.setFocusPolicy(Qt.FocusPolicy.TabFocus)
        button.clicked.connect(self._acknowledge)
        texts = QVBoxLayout()
        texts.setSpacing(2)
        texts.addWidget(text)
        texts.addWidget(reason)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 6, 12, 6)
        layout.setSpacing(16)
        layout.addLayout(texts, 1)
        layout.addWidget(button)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self.setStyleSheet(
            f"QFrame {{ background: {colours.stop}; }} QLabel {{ color: white; }}"
            f"QPushButton {{ background: {colours.base}; color: {colours.text}; border: 1px solid white;"
            " border-radius: 4px; padding: 6px 14px; font-weight: bold }"
            f"QPushButton:focus {{ border: 2px solid {colours.accent} }}"
        )

    @Slot()
    def _acknowledge(self) -> None:
        self.acknowledged.emit(self._order)


class QuestionBar(QFrame):
    """The line of a question that waits for an answer; its button shows the question again."""

    show_question = Signal()

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._text = QLabel()
        self._text.setWordWrap(True)
        self._button = QPushButton("&Answer…")
        self._button.setAccessibleName("Show the question to the operator")
        self._button.clicked.connect(self.show_question)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 4, 12, 4)
        layout.addWidget(self._text, 1)
        layout.addWidget(self._button)
        self.set_colours(colours)
        self.set_question("")

    @property
    def text(self) -> str:
        """The line; empty without a question."""
        return "" if self.isHidden() else self._text.text()

    def set_question(self, title: str) -> None:
        """Show the title of a question; hide the line if empty."""
        self._text.setText(f"The run waits for an answer: {title}")
        self.setVisible(bool(title))

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self.setStyleSheet(
            f"QuestionBar {{ background: {colours.accent}; }} QLabel {{ color: {colours.on_accent}; font-weight: bold }}"
        )
