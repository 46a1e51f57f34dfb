"""The navigation: one button for each screen, at the left of the window."""

from collections.abc import Sequence

from PySide6.QtCore import QSize, Qt, Signal, Slot
from PySide6.QtWidgets import QButtonGroup, QFrame, QSizePolicy, QToolButton, QVBoxLayout

from goniotwin.app.desktop.icons import SIZE, icon, no_icon
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours

SHORT_MARK = 3
"""Signs of a mark that has room in a narrow window."""
LOW_BUTTON, LOW_ICON = 23, 18
"""Height in logical pixels of a button in a low window, with its share of the margins, and side of its icon."""


class Navigation(QFrame):
    """The titles of the screens, with the key of each. `chosen` has the number of a screen, from 0.

    Tab reaches the present screen's button, the arrow keys the others.
    """

    chosen = Signal(int)

    def __init__(self, screens: Sequence[type[Screen]], colours: Colours) -> None:
        super().__init__()
        self._screens = screens
        self._colours = colours
        self._has_icons = False
        self._low = True  # the window grows from its least size
        self._compact = True  # the window grows from its least size
        self._marks = [""] * len(screens)
        self._group = QButtonGroup(self)
        self.buttons: list[QToolButton] = []
        column = QVBoxLayout(self)
        column.setContentsMargins(0, 4, 0, 4)
        column.setSpacing(0)
        for number, screen in enumerate(screens):
            button = QToolButton()
            button.setCheckable(True)
            button.setToolButtonStyle(Qt.ToolButtonStyle.ToolButtonTextBesideIcon)
            button.setIconSize(QSize(LOW_ICON, LOW_ICON))
            button.setIcon(no_icon())
            button.setSizePolicy(QSizePolicy.Policy.Expanding, QSizePolicy.Policy.Fixed)
            button.setFocusPolicy(Qt.FocusPolicy.StrongFocus)
            button.setToolTip(f"{screen.title} (Ctrl+{number + 1})")
            button.setAutoRaise(True)
            self._group.addButton(button, number)
            self.buttons.append(button)
            column.addWidget(button)
            self.set_mark(number, "")
        column.addStretch(1)
        self._group.idClicked.connect(self.chosen)
        # Its height in a low window, which a high one may become in one step.
        self.setMinimumHeight(LOW_BUTTON * len(screens))
        self.set_colours(colours)

    @Slot(int)
    def show_chosen(self, number: int) -> None:
        """Show which screen is chosen."""
        had_focus = any(button.hasFocus() for button in self.buttons)
        self.buttons[number].setChecked(True)
        if had_focus:
            self.buttons[number].setFocus()

    def set_compact(self, compact: bool) -> None:
        """Show the numbers of the screens without their titles, and of long marks the sign only, in a narrow window."""
        if compact != self._compact:
            self._compact = compact
            for number, mark in enumerate(self._marks):
                self.set_mark(number, mark)

    def set_low(self, low: bool) -> None:
        """Take less height, in a low window."""
        if low != self._low:
            self._low = low
            for button in self.buttons:
                button.setIconSize(QSize(LOW_ICON, LOW_ICON) if low else QSize(SIZE, SIZE))
            self.set_colours(self._colours)

    def set_mark(self, number: int, mark: str) -> None:
        """Show a mark behind the title of a screen that should be looked at (such as ✗ 2); none if empty."""
        self._marks[number] = mark
        title = self._screens[number].title
        shown = mark[:1] if self._compact and len(mark) > SHORT_MARK else mark
        parts = [f" {number + 1}", *([] if self._compact else [title]), *([shown] if shown else [])]
        self.buttons[number].setText("  ".join(parts))
        self.buttons[number].setAccessibleName(f"Screen {title}" + (f", to check: {mark}" if mark else ""))

    def load_icons(self) -> None:
        """Show the icons from now on."""
        self._has_icons = True
        self.set_colours(self._colours)

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self.setStyleSheet(
            f"Navigation {{ background: {colours.base}; border: none; border-right: 1px solid {colours.line} }}"
            f"QToolButton {{ color: {colours.text}; background: transparent; border: 2px solid transparent;"
            f" padding: {0 if self._low else 8}px 10px; text-align: left }}"
            f"QToolButton:hover {{ background: {colours.button} }}"
            f"QToolButton:checked {{ color: {colours.on_accent}; background: {colours.accent} }}"
            f"QToolButton:focus {{ border-color: {colours.text} }}"
        )
        if self._has_icons:
            for button, screen in zip(self.buttons, self._screens, strict=True):
                button.setIcon(icon(screen.icon, colours.text, colours.on_accent))
