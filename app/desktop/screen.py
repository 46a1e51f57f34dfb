"""A screen of the window: a page of its own, with a title and an icon in the navigation."""

from collections.abc import Callable
from typing import ClassVar

from PySide6.QtCore import QEvent, QObject, QSize, Signal, Slot
from PySide6.QtGui import QShowEvent
from PySide6.QtWidgets import QPushButton, QWidget

from goniotwin.app.desktop.theme import Colours


class WithoutPreferredHeight(QWidget):
    """A widget that a scroll area makes as high as its room: with a text that wraps it would have its preferred height."""

    def hasHeightForWidth(self) -> bool:
        """Whether the height depends on the width; Qt calls it."""
        return False


class Screen(QWidget):
    """A screen. A new one is a folder with a subclass, and a line in `SCREENS` of the view.

    `title` is its name, `icon` that of an icon of the Material Design Icons (qtawesome). The mnemonics of its controls differ
    from those of the menus and of the controls of a run, which are always there.

    The window shows itself before a rig is there: a module of a screen imports neither the engine nor the plots; what needs
    them is imported and made by `complete`.
    """

    title: ClassVar[str]
    icon: ClassVar[str]
    command = Signal(str, object)
    """A command of the station (`station.permissions.COMMANDS`), and its arguments by name."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self._colours = colours
        self._room: QWidget | None = None
        self.setAccessibleName(f"Screen {self.title}")

    def complete(self) -> None:
        """Make what takes long to load. Called once, after the window has been shown and before the first message."""

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours

    @Slot(object)
    def show_message(self, message: object) -> None:
        """Show a message to the window (`model.messages`). Called for each one, in the window's thread."""

    def set_refusals(self, refusals: dict[str, str]) -> None:
        """Take, by command, the reason why the station refuses it now; empty where it is allowed."""

    def shut_down(self) -> None:
        """End what the screen has started."""

    def fit(self, room: QSize) -> None:
        """Arrange the parts for a room, which the screen has without scrolling."""

    def showEvent(self, event: QShowEvent) -> None:
        """Find the room; Qt calls it."""
        super().showEvent(event)
        parent = self.parentWidget()
        if parent is not None and parent is not self._room:
            self._room = parent
            parent.installEventFilter(self)
        if parent is not None:
            self.fit(parent.size())

    def eventFilter(self, watched: QObject, event: QEvent) -> bool:
        """Follow the room; Qt calls it."""
        if watched is self._room and event.type() == QEvent.Type.Resize and self.isVisible():
            self.fit(self._room.size())
        return super().eventFilter(watched, event)

    def _button(self, text: str, name: str, act: Callable[[], object]) -> QPushButton:
        """A button that does `act`; no dialog takes it as its default."""
        button = QPushButton(text)
        button.setAccessibleName(name)
        button.setAutoDefault(False)
        button.clicked.connect(lambda _checked=False: act())
        return button
