"""The set-up screen: the schedule, what it measures, and the folder of data files (journals)."""

from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import Qt, Signal, Slot
from PySide6.QtGui import QFontDatabase
from PySide6.QtWidgets import (
    QFrame,
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QPushButton,
    QScrollArea,
    QVBoxLayout,
    QWidget,
)

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop import model
from goniotwin.app.desktop.model.axes import GREEK
from goniotwin.app.desktop.rig.panels import fill, heading, path_label, show_path
from goniotwin.app.desktop.screen import Screen
from goniotwin.app.desktop.theme import Colours

if TYPE_CHECKING:  # the window shows itself before the planner is loaded
    from goniotwin.app.campaign.planning.plan import Plan

FEW = 6
"""Values of a grid that are listed one by one."""


class SchedulePanel(QGroupBox):
    """The schedule, its size, and the folder of data files."""

    open = Signal()
    choose_folder = Signal()
    plan_shown = Signal(object)
    folder_shown = Signal(object)
    """The plan and the folder, whenever they are set."""

    def __init__(self) -> None:
        super().__init__("Schedule file")
        self.setAccessibleName("Schedule file")
        self._name = heading("no schedule")
        self._name.setAccessibleName("Schedule")
        self._path = path_label()
        self._size = QLabel()
        self._size.setWordWrap(True)
        self._folder = path_label()
        self.open_button = QPushButton("&Open schedule…")
        self.open_button.setAccessibleName("Open a schedule file")
        self.folder_button = QPushButton("Save &in…")
        self.folder_button.setAccessibleName("Choose the folder for data files (journals)")
        self.open_button.clicked.connect(self.open)
        self.folder_button.clicked.connect(self.choose_folder)
        self.buttons = (self.open_button, self.folder_button)
        fill(self, [self._name, self._path, self._size, self._folder], self.buttons)
        self.set_plan(None)

    def set_plan(self, plan: "Plan | None") -> None:
        """Show the schedule of a plan and its size."""
        self._name.setText(plan.schedule.file.name if plan else "no schedule")
        self._path.setVisible(plan is not None)
        self._size.setVisible(plan is not None)
        if plan is not None:
            show_path(self._path, Path(plan.schedule.name))
            self._size.setText(f"{len(plan.rows)} rows, estimated duration {rounded_duration_text(plan.seconds)}")
        self.plan_shown.emit(plan)

    def set_folder(self, folder: Path) -> None:
        """Show the folder of data files."""
        show_path(self._folder, folder, "Data files (journals) in ")
        self.folder_shown.emit(folder)


class ContentPanel(QGroupBox):
    """What a schedule measures: its samples, grids and readings."""

    def __init__(self) -> None:
        super().__init__("What it measures")
        self.setAccessibleName("What the schedule measures")
        self._grid = QGridLayout(self)
        self._grid.setColumnStretch(1, 1)
        self._grid.setHorizontalSpacing(14)
        self._grid.setVerticalSpacing(3)

    def set_plan(self, plan: "Plan | None") -> None:
        """Show what the schedule of a plan measures."""
        while (item := self._grid.takeAt(0)) is not None:
            if (widget := item.widget()) is not None:
                widget.deleteLater()
        for at, (name, value) in enumerate([] if plan is None else plan_contents(plan)):
            shown = QLabel(value)
            shown.setWordWrap(True)
            shown.setTextFormat(Qt.TextFormat.PlainText)
            shown.setAccessibleName(f"{name}: {value}")
            self._grid.addWidget(QLabel(name), at, 0, Qt.AlignmentFlag.AlignTop)
            self._grid.addWidget(shown, at, 1)
        self.setVisible(plan is not None)


class SetupScreen(Screen):
    """The schedule at the left, its text at the right."""

    title = "Schedule"
    icon = "calendar-clock"

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self.schedule = SchedulePanel()
        self._content = ContentPanel()
        self._text = QPlainTextEdit()
        self._text.setReadOnly(True)
        self._text.setAccessibleName("Text of the schedule file")
        self._text.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self._text.setTabChangesFocus(True)
        self._text.setPlaceholderText("The text of the schedule is shown here.")
        column = QWidget()
        left = QVBoxLayout(column)
        left.setContentsMargins(0, 0, 6, 0)
        left.addWidget(self.schedule)
        left.addWidget(self._content)
        left.addStretch(1)
        layout = QHBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.setSpacing(12)
        scroll = QScrollArea()
        scroll.setWidget(column)
        scroll.setWidgetResizable(True)
        scroll.setFrameShape(QFrame.Shape.NoFrame)
        scroll.setFocusPolicy(Qt.FocusPolicy.NoFocus)
        scroll.setHorizontalScrollBarPolicy(Qt.ScrollBarPolicy.ScrollBarAlwaysOff)
        layout.addWidget(scroll, 1)
        layout.addWidget(self._text, 1)
        self.schedule.plan_shown.connect(self._show_plan)
        self._show_plan(None)

    @property
    def text(self) -> str:
        """The text of the schedule."""
        return self._text.toPlainText()

    @Slot(object)
    def _show_plan(self, plan: "Plan | None") -> None:
        self._content.set_plan(plan)
        self._text.setPlainText("" if plan is None else plan.schedule.text)


def plan_contents(plan: "Plan") -> list[tuple[str, str]]:
    """What a plan measures, as names and texts."""
    file = plan.schedule.file
    gains = file.gains_v_per_a
    grids = (("sigma", file.sigma_deg), ("gamma", file.gamma_deg), ("beta", file.beta_deg), ("shift", file.shift_deg))
    named = (
        ("Samples", ", ".join(file.samples)),
        ("Reference standard", ", ".join(file.standards)),
        ("Light", f"{file.light}, {file.side} side lit"),
        *((GREEK[axis], values_text(model.grid_values(grid), "°")) for axis, grid in grids),
        ("Wavelength", values_text(model.grid_values(file.wavelength_nm), " nm")),
        ("Gains", gains if isinstance(gains, str) else ", ".join(map(gain_text, gains)) + " V/A"),
        ("Dark readings", f"every {rounded_duration_text(file.dark_every_s)}"),
    )
    return list(named)


def values_text(values: tuple[float, ...], unit: str) -> str:
    """Values of a grid with their unit: a few one by one, more as their range and number."""
    if len(values) <= FEW:
        return ", ".join(f"{each:g}" for each in values) + unit
    return f"{min(values):g} to {max(values):g}{unit}, {len(values)} values"


def gain_text(volts_per_ampere: float) -> str:
    """A gain in V/A as it stands in a schedule: 1e8."""
    return f"{volts_per_ampere:g}".replace("e+", "e").replace("e0", "e")
