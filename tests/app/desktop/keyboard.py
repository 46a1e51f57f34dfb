"""A person at the window with a keyboard only: what is to be read, and keys to the widget that has the focus."""

import html
import re

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeySequence
from PySide6.QtTest import QTest
from PySide6.QtWidgets import (
    QAbstractButton,
    QApplication,
    QComboBox,
    QDialog,
    QLabel,
    QMenuBar,
    QProgressBar,
    QTableView,
    QTextBrowser,
    QWidget,
)

from goniotwin.protocols.clock import calendar_s

MOST_TABS, MOST_ROWS = 100, 30
LOOK_MS, LOOKS = 10, 500


def press(*keys: str) -> None:
    """Press and release keys or combinations (`Tab`, `Alt+S`, `Ctrl+.`) where the focus is."""
    for key in keys:
        pressed = QKeySequence(key)[0]  # type: ignore[index]  # PySide's stubs do not know the operator
        QTest.keyClick(_focus(), pressed.key(), pressed.keyboardModifiers())


def type_text(text: str) -> None:
    """Type a text where the focus is."""
    QTest.keyClicks(_focus(), text)


def press_at(key: str) -> float:
    """Press and release a key; return the calendar time just before, s."""
    pressed_s = calendar_s()
    press(key)
    return pressed_s


def tab_to(name: str) -> None:
    """Press Tab until the focus is on the control whose accessible name begins with `name`. AssertionError if it never is."""
    passed = []
    for _ in range(MOST_TABS):
        press("Tab")
        found = focused()
        if found.startswith(name):
            return
        passed.append(found)
    raise AssertionError(f"Tab does not reach {name}; it reaches {passed}")


def focused() -> str:
    """The accessible name of the control that has the focus."""
    widget = QApplication.focusWidget()
    return "" if widget is None else widget.accessibleName()


def active_title() -> str:
    """The title of the window that the keys go to."""
    return _active().windowTitle()


def seen() -> list[str]:
    """What is to be read in the windows that are shown, each text once."""
    texts: dict[str, None] = {}
    for window in QApplication.topLevelWidgets():
        if window.isVisible():
            texts[window.windowTitle()] = None
            for widget in window.findChildren(QWidget):
                if widget.isVisible():
                    texts.update(dict.fromkeys(_texts(widget)))
    return [text for text in texts if text]


def reads(*texts: str) -> bool:
    """Whether all texts are to be read."""
    lines = seen()
    return all(any(text in line for line in lines) for text in texts)


def _texts(widget: QWidget) -> list[str]:
    """The texts of a widget."""
    match widget:
        case QLabel():
            return [re.sub(r"\s+", " ", html.unescape(re.sub("<[^>]*>", " ", widget.text()))).strip()]
        case QAbstractButton():
            state = "" if widget.isEnabled() else " (disabled)"
            checked = " (checked)" if widget.isCheckable() and widget.isChecked() else ""
            return [f"[{widget.text().replace('&', '')}]{checked}{state}"]
        case QProgressBar():
            return [widget.text()]
        case QComboBox():
            return [f"{widget.accessibleName()}: {widget.currentText()}"]
        case QTableView():
            return [_row(widget, row) for row in range(min(widget.model().rowCount(), MOST_ROWS))]
        case QTextBrowser():
            return [widget.toPlainText()]
        case QMenuBar():
            return []
        case _:  # a plot or a picture: what a screen reader has of it
            return [widget.accessibleDescription()]


def _row(table: QTableView, row: int) -> str:
    """A row of a table."""
    model = table.model()
    cells = [model.index(row, column).data(Qt.ItemDataRole.DisplayRole) for column in range(model.columnCount())]
    return " | ".join(str(cell) for cell in cells)


def _focus() -> QWidget:
    """Where a key goes."""
    active = QApplication.activePopupWidget() or _active()
    focused: QWidget | None = active.focusWidget()
    return active if focused is None else focused


def _active() -> QWidget:
    """The active window. When it, or a list that it shows, is closed, another one is active, as window managers have it."""
    active = QApplication.activeWindow()
    if active is not None and active.isVisible():
        return active
    shown = [each for each in QApplication.topLevelWidgets() if each.isVisible() and each.isWindow()]
    assert shown, "no window is shown"
    shown.sort(key=lambda each: isinstance(each, QDialog))  # a dialog is above the window that it belongs to
    shown[-1].activateWindow()
    # Qt's qWaitForWindowActive takes the hidden child that had the focus before for an active window.
    for _ in range(LOOKS):
        if QApplication.activeWindow() is shown[-1]:
            return shown[-1]
        QTest.qWait(LOOK_MS)
    raise AssertionError("no window of the program is active")
