"""The log of events, the safety orders above everything else, and the line of an open question."""

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING

from PySide6.QtCore import (
    QAbstractItemModel,
    QAbstractTableModel,
    QDateTime,
    QModelIndex,
    QObject,
    QPersistentModelIndex,
    QSortFilterProxyModel,
    Qt,
    QTimer,
    Signal,
    Slot,
)
from PySide6.QtGui import QColor, QResizeEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QFrame,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QPushButton,
    QTableView,
    QVBoxLayout,
    QWidget,
)

from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.campaign.running.events import SafetyOrder

Index = QModelIndex | QPersistentModelIndex
Role = Qt.ItemDataRole
NOWHERE = QModelIndex()
SERIOUS = Role.UserRole

COLUMNS = ("time", "what", "where", "consequence")
MAX_ENTRIES = 2000
"""Entries that the window shows. The journal has all events of a run."""


@dataclass(frozen=True)
class LogEntry:
    """An entry of the log. `serious`: a person should look at it. `detail`: what a device's wire has shown, as a tool tip."""

    what: str
    where: str = ""
    consequence: str = ""
    serious: bool = False
    detail: str = ""


class EventModel(QAbstractTableModel):
    """The events, the latest first: the time of the calendar, what happened, where, and the consequence."""

    def __init__(self, parent: QObject, colours: Colours) -> None:
        super().__init__(parent)
        self._colours = colours
        self._entries: deque[tuple[QDateTime, LogEntry]] = deque()

    @property
    def entries(self) -> list[LogEntry]:
        """The entries, the latest first."""
        return [entry for _, entry in self._entries]

    @property
    def serious(self) -> int:
        """The number of entries that a person should look at."""
        return sum(entry.serious for _, entry in self._entries)

    def add(self, entry: LogEntry) -> None:
        """Add an entry, now."""
        if len(self._entries) == MAX_ENTRIES:
            self.beginRemoveRows(QModelIndex(), MAX_ENTRIES - 1, MAX_ENTRIES - 1)
            self._entries.pop()
            self.endRemoveRows()
        self.beginInsertRows(QModelIndex(), 0, 0)
        self._entries.appendleft((QDateTime.currentDateTime(), entry))
        self.endInsertRows()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        if self._entries:
            self.dataChanged.emit(self.index(0, 0), self.index(len(self._entries) - 1, len(COLUMNS) - 1))

    def rowCount(self, parent: Index = NOWHERE) -> int:
        """The number of entries; Qt calls it."""
        return 0 if parent.isValid() else len(self._entries)

    def columnCount(self, parent: Index = NOWHERE) -> int:
        """The number of columns; Qt calls it."""
        return 0 if parent.isValid() else len(COLUMNS)

    def headerData(self, section: int, orientation: Qt.Orientation, role: int = Role.DisplayRole) -> object:
        """The names of the columns; Qt calls it."""
        shown = orientation == Qt.Orientation.Horizontal and role == Role.DisplayRole
        return COLUMNS[section] if shown else None

    def data(self, index: Index, role: int = Role.DisplayRole) -> object:
        """A text, tool tip or colour of an entry, and for SERIOUS whether to look at it; Qt calls it."""
        time, entry = self._entries[index.row()]
        column = index.column()
        if role == SERIOUS:
            return entry.serious
        if role == Role.ForegroundRole:
            return QColor(self._colours.bad if entry.serious else self._colours.text)
        if role == Role.TextAlignmentRole:
            return Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop
        if role == Role.ToolTipRole and column == 0:
            return time.toString(Qt.DateFormat.ISODate)
        if role in (Role.ToolTipRole, Role.AccessibleDescriptionRole) and column == 1 and entry.detail:
            return f"{entry.what}\n{entry.detail}"
        if role in (Role.DisplayRole, Role.ToolTipRole):
            mark = "✗ " if entry.serious else ""
            return (time.toString("HH:mm:ss"), mark + entry.what, entry.where, entry.consequence)[column]
        return None


class SeriousOnly(QSortFilterProxyModel):
    """The entries that a person should look at, or all of them."""

    only = False

    def set_only(self, only: bool) -> None:
        """Show only those that a person should look at."""
        self.only = only
        self.invalidate()

    def filterAcceptsRow(self, row: int, parent: Index) -> bool:
        """Whether a row is shown; Qt calls it."""
        return not self.only or bool(self.sourceModel().index(row, 0, parent).data(SERIOUS))


class EventTable(QTableView):
    """A table of events whose columns share the width."""

    def __init__(self, model: QAbstractItemModel, name: str) -> None:
        super().__init__()
        self.setModel(model)
        self.setAccessibleName(name)
        self.verticalHeader().hide()
        self.setWordWrap(True)
        self.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        self.setVerticalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOn)  # else the width follows the heights
        self.setTabKeyNavigation(False)
        header = self.horizontalHeader()
        header.setHighlightSections(False)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        header.setSectionResizeMode(QHeaderView.ResizeMode.Fixed)
        self._fit = QTimer(self, interval=0, singleShot=True)
        self._fit.timeout.connect(self.resizeRowsToContents)
        model.rowsInserted.connect(self._fit_new)

    def resizeEvent(self, event: QResizeEvent) -> None:
        """Share the width among the columns; Qt calls it."""
        super().resizeEvent(event)
        time = self.fontMetrics().horizontalAdvance("00:00:00") + 14
        rest = max(self.viewport().width() - time, 0)
        for column, width in enumerate((time, rest * 48 // 100, rest * 26 // 100, rest - rest * 74 // 100)):
            self.setColumnWidth(column, width)
        self._fit.start()

    @Slot(QModelIndex, int, int)
    def _fit_new(self, _parent: Index, first: int, last: int) -> None:
        """Fit the heights of new rows; all of them, where many come at once."""
        if last > first:
            self._fit.start()
        else:
            self.resizeRowToContents(first)


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
    def orders(self) -> "list[SafetyOrder]":
        """The orders, in the order in which they were given."""
        return list(self._rows)

    def add(self, order: "SafetyOrder") -> None:
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
    def acknowledge(self, order: "SafetyOrder") -> None:
        """Remove an order, and report that it is acknowledged."""
        if self.remove(order):
            self.acknowledged.emit(order)

    def remove(self, order: "SafetyOrder") -> bool:
        """Remove an order; return whether it was shown."""
        row = self._rows.pop(order, None)
        if row is not None:
            row.hide()
            row.deleteLater()
            self.setVisible(bool(self._rows))
        return row is not None


class OrderRow(QFrame):
    """A safety order with its button."""

    acknowledged = Signal(object)

    def __init__(self, order: "SafetyOrder") -> None:
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
        button.setToolTip("Press this when it is done, or somebody is doing it. The journal records it.")
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


NOTICES = {"operate": "Operate fro&m here", "connect": "Connect a&gain", "resume": "Res&ume", "continue": "Resu&me"}
"""What can be done about the station, by the name of the action: the label of its button, with a letter of its own."""


class NoticeBar(QFrame):
    """A line about the station, with a button for what can be done about it: `action` is its name, empty without a notice."""

    pressed = Signal(str)

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self.action = ""
        self._text = QLabel()
        self._text.setWordWrap(True)
        self._text.setAccessibleName("Notice")
        self.button = QPushButton()
        self.button.clicked.connect(self._press)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(12, 4, 12, 4)
        layout.addWidget(self._text, 1)
        layout.addWidget(self.button)
        self.set_colours(colours)
        self.clear()

    @property
    def text(self) -> str:
        """The line; empty without a notice."""
        return "" if self.isHidden() else self._text.text()

    def show_notice(self, text: str, action: str) -> None:
        """Show a notice, with the button of an action of `NOTICES`."""
        label = NOTICES[action]
        self.action = action
        self._text.setText(text)
        self.button.setText(label)
        self.button.setAccessibleName(f"{label.replace('&', '')}. {text}")
        self.show()

    def clear(self) -> None:
        """Show no notice."""
        self.action = ""
        self.hide()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self.setStyleSheet(
            f"NoticeBar {{ background: {colours.accent}; }} QLabel {{ color: {colours.on_accent}; font-weight: bold }}"
        )

    @Slot()
    def _press(self) -> None:
        self.pressed.emit(self.action)


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
