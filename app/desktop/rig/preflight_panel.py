"""The preflight list in the window. It only shows."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QGridLayout, QGroupBox, QLabel

from goniotwin.app.desktop import model
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before numpy is loaded
    from goniotwin.app.desktop.model.preflight import Check


class PreflightPanel(QGroupBox):
    """One line a check: its mark and name, what is found, and what to do."""

    def __init__(self, colours: Colours) -> None:
        super().__init__("Preflight")
        self._colours = colours
        self._checks: tuple[Check, ...] = ()
        self._lines: list[tuple[QLabel, QLabel, QLabel]] = []
        self._summary = QLabel("No rig is open.")
        self._summary.setWordWrap(True)
        font = self._summary.font()
        font.setBold(True)
        self._summary.setFont(font)
        self._grid = QGridLayout(self)
        self._grid.setContentsMargins(8, 4, 8, 6)
        self._grid.setHorizontalSpacing(8)
        self._grid.setVerticalSpacing(0)
        self._grid.setColumnStretch(2, 1)
        self._summary.setContentsMargins(0, 0, 0, 6)
        self._grid.addWidget(self._summary, 0, 0, 1, 3)
        self.setAccessibleName("Preflight")

    @property
    def text(self) -> str:
        """The list as text, a line each."""
        return "\n".join([self._summary.text(), *(check.text for check in self._checks)])

    def set_checks(self, checks: "Sequence[Check]") -> None:
        """Show the list."""
        if tuple(checks) == self._checks:
            return
        self._checks = tuple(checks)
        while len(self._lines) < len(checks):
            self._add_line()
        self._summary.setText(model.preflight_summary(checks))
        self._summary.setAccessibleName(f"Preflight: {self._summary.text()}")
        self._show()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        self._colours = colours
        self._show()

    def _add_line(self) -> None:
        mark, name, text = QLabel(), QLabel(), QLabel()
        text.setWordWrap(True)
        text.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
        text.setContentsMargins(0, 0, 0, 5)
        row = len(self._lines) + 1
        for column, label in enumerate((mark, name, text)):
            label.setTextFormat(Qt.TextFormat.PlainText)
            label.setAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignTop)
            self._grid.addWidget(label, row, column)
        self._lines.append((mark, name, text))

    def _show(self) -> None:
        if not self._checks:
            return
        c, outcome = self._colours, model.Outcome
        colours = {outcome.GOOD: c.good, outcome.LOOK: c.beam, outcome.BAD: c.bad, outcome.UNKNOWN: c.dim}
        for (mark, name, text), check in zip(self._lines, self._checks, strict=False):
            colour = colours[check.outcome]
            mark.setText(model.MARKS[check.outcome])
            mark.setStyleSheet(f"color: {colour}; font-weight: bold")
            mark.setToolTip(str(check.outcome))
            name.setText(check.name)
            name.setStyleSheet(f"color: {colour if check.outcome is not outcome.UNKNOWN else c.text}; font-weight: bold")
            text.setText(check.found + (f"\n→ {check.remedy}" if check.remedy else ""))
            mark.setAccessibleName(f"{check.name}: {check.outcome}")
            name.setAccessibleName(check.name)
            text.setAccessibleName(check.text)
