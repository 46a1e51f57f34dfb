"""What of a window is not on its screen. Benchmarks take it from here."""

from PySide6.QtCore import QRect
from PySide6.QtWidgets import (
    QAbstractButton,
    QAbstractItemView,
    QAbstractSlider,
    QComboBox,
    QHeaderView,
    QLabel,
    QLineEdit,
    QMenuBar,
    QPlainTextEdit,
    QProgressBar,
    QScrollArea,
    QScrollBar,
    QWidget,
)

from goniotwin.app.desktop.setup.screen import SCROLLED

SCREEN = 1280, 800
"""Pixels of the smallest screen."""
CONTROLS = (
    QAbstractButton,
    QComboBox,
    QProgressBar,
    QAbstractItemView,
    QPlainTextEdit,
    QLineEdit,
    QAbstractSlider,
    QMenuBar,
)
PARTS = (QScrollBar, QHeaderView)
OWNERS = (QComboBox, QAbstractItemView)
"""Controls that belong to others, and these others."""


def controls(window: QWidget) -> list[QWidget]:
    """The controls of a window that are shown, without those that are parts of others."""
    found = [each for kind in CONTROLS for each in window.findChildren(kind) if each.isVisible() and each.window() is window]
    return [each for each in found if not isinstance(each, PARTS) and not isinstance(each.parent(), OWNERS)]


def faults(window: QWidget, percent: int, screen: tuple[int, int] = SCREEN) -> list[str]:
    """The controls of a window that are not whole on its screen, and the texts that are cut off; one line each."""
    lines = []
    if window.width() > screen[0] * 100 // percent or window.height() > screen[1] * 100 // percent:
        lines.append(f"the window needs {window.width()} x {window.height()} logical pixels")
    for each in controls(window):
        if _hidden_part(window, each):
            lines.append(f"{type(each).__name__} {each.accessibleName()!r} is not whole in the window")
    for label in window.findChildren(QLabel):
        if label.isVisible() and label.window() is window and label.text() and _cut_off(label):
            lines.append(f"text cut off: {label.text()[:60]!r}")
    return lines


def _hidden_part(window: QWidget, control: QWidget) -> bool:
    for area in window.findChildren(QScrollArea):
        if area.accessibleName() == SCROLLED and area.isAncestorOf(control):  # Tab scrolls to it, up and down
            return control.mapTo(area.viewport(), control.rect().topRight()).x() >= area.viewport().width()
    place = QRect(control.mapTo(window, control.rect().topLeft()), control.size())
    return not window.rect().contains(place) or control.visibleRegion().boundingRect() != control.rect()


def _cut_off(label: QLabel) -> bool:
    if label.wordWrap():
        return label.heightForWidth(label.width()) > label.height()
    return label.sizeHint().width() > label.width()
