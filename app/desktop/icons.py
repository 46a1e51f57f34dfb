"""Icons of the Material Design Icons. Their font is loaded at the first use, after the window has been shown."""

from PySide6.QtCore import Qt
from PySide6.QtGui import QIcon, QPixmap

SIZE = 20
"""Side of an icon in logical pixels."""


def icon(name: str, colour: str, on: str = "") -> QIcon:
    """An icon by its name in a colour; `on`: that of the checked state, if it is another."""
    import qtawesome  # with its fonts it takes as long as the rest of the window

    states = {"color_on": on, "color_off": colour} if on else {}
    found = qtawesome.icon(f"mdi6.{name}", color=colour, **states)
    assert isinstance(found, QIcon)
    return found


def no_icon() -> QIcon:
    """The place of an icon, until the font is loaded."""
    pixmap = QPixmap(SIZE, SIZE)
    pixmap.fill(Qt.GlobalColor.transparent)
    return QIcon(pixmap)
