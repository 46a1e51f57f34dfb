"""The colour schemes, light and dark: the palette of Qt's Fusion style, and the colours of the plot and of the marks."""

from dataclasses import dataclass
from typing import Literal

from PySide6.QtCore import QObject, Qt, Signal, Slot
from PySide6.QtGui import QColor, QPalette
from PySide6.QtWidgets import QApplication

from goniotwin.app.figures.style import Palette

Scheme = Literal["light", "dark"]
FUSION_DARKER = 140
"""Percentage by which Fusion darkens the window's colour for a frame; 120 for a grid."""


@dataclass(frozen=True, kw_only=True)
class Colours(Palette):
    """The colours of a scheme: those of figures, and of the window.

    The contrast of text to its background is at least 4.5 to 1. Marks differ in shape too, not only in hue.
    """

    window: str
    button: str
    accent: str
    on_accent: str
    good: str
    simulated: str
    on_simulated: str
    stop: str
    stop_pressed: str
    beam: str


LIGHT = Colours(
    window="#f3f4f6",
    base="#ffffff",
    button="#e6e8ec",
    text="#1b1f24",
    dim="#59616b",
    line="#c3c8d0",
    accent="#0b62c4",
    on_accent="#ffffff",
    good="#17692c",
    bad="#b3161b",
    simulated="#ffd24d",
    on_simulated="#1b1f24",
    stop="#c1121f",
    stop_pressed="#8d0c16",
    points="#0b62c4",
    blocked="#6b7280",
    beam="#b85c00",
    predicted="#b45f06",
)
DARK = Colours(
    window="#1e2126",
    base="#15171b",
    button="#2d3138",
    text="#e8eaed",
    dim="#a4abb5",
    line="#454b55",
    accent="#5aa5ff",
    on_accent="#10131a",
    good="#66cf80",
    bad="#ff8080",
    simulated="#e0b02f",
    on_simulated="#15171b",
    stop="#d11a28",
    stop_pressed="#8d0c16",
    points="#5aa5ff",
    blocked="#9aa2ad",
    beam="#ffb454",
    predicted="#f0a63a",
)


class Theme(QObject):
    """The scheme of the desktop environment, or a forced one (for tests and pictures)."""

    changed = Signal()

    def __init__(self, application: QApplication, forced: Scheme | None = None) -> None:
        super().__init__()
        self._application = application
        self._forced = forced
        self._hints = application.styleHints()
        application.setStyle("Fusion")
        self._hints.colorSchemeChanged.connect(self._follow)
        self._follow()

    @property
    def colours(self) -> Colours:
        """The colours of the present scheme."""
        dark = self._forced == "dark" if self._forced else self._hints.colorScheme() == Qt.ColorScheme.Dark
        return DARK if dark else LIGHT

    def force(self, scheme: Scheme | None) -> None:
        """Force a scheme from now on; None follows the desktop environment again."""
        self._forced = scheme
        self._follow()

    @Slot()
    def _follow(self) -> None:
        colours = self.colours
        palette = _palette(colours)
        self._application.setPalette(palette)
        # Fusion draws frames and grids in a darker shade of the window's colour: on a dark window they are not seen.
        for widget, frame in (("QCheckBox", colours.dim), ("QProgressBar", colours.dim), ("QTableView", colours.line)):
            palette.setColor(QPalette.ColorRole.Window, QColor(frame).lighter(FUSION_DARKER))
            self._application.setPalette(palette, widget)  # type: ignore[arg-type]  # the stub has bytes, Qt takes text
        self.changed.emit()


def _palette(colours: Colours) -> QPalette:
    palette = QPalette()
    role = QPalette.ColorRole
    for which, colour in (
        (role.Window, colours.window),
        (role.WindowText, colours.text),
        (role.Base, colours.base),
        (role.AlternateBase, colours.window),
        (role.ToolTipBase, colours.base),
        (role.ToolTipText, colours.text),
        (role.Text, colours.text),
        (role.Button, colours.button),
        (role.ButtonText, colours.text),
        (role.BrightText, colours.bad),
        (role.Highlight, colours.accent),
        (role.Accent, colours.accent),
        (role.HighlightedText, colours.on_accent),
        (role.Link, colours.accent),
        (role.PlaceholderText, colours.dim),
        (role.Mid, colours.line),
    ):
        palette.setColor(which, QColor(colour))
    for which in (role.WindowText, role.Text, role.ButtonText):
        palette.setColor(QPalette.ColorGroup.Disabled, which, QColor(colours.dim))
    return palette
