"""The panels of the set-up: the rig file, the schedule file, and the folder of data files (journals)."""

from pathlib import Path

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QCheckBox, QGroupBox, QHBoxLayout, QLabel, QPushButton, QVBoxLayout

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.messages import RigOpened
from goniotwin.app.desktop.rig.panels import heading


class RigPanel(QGroupBox):
    """The open rig."""

    open = Signal()
    connect_again = Signal()

    def __init__(self) -> None:
        super().__init__("Rig")
        self._name = heading("no rig")
        self._name.setAccessibleName("Rig")
        self.open_button = QPushButton("Open &rig…")
        self.open_button.setAccessibleName("Open a rig file")
        self.again_button = QPushButton("&Connect again")
        self.again_button.setAccessibleName("Connect the rig's devices again")
        self.open_button.clicked.connect(self.open)
        self.again_button.clicked.connect(self.connect_again)
        self.buttons = (self.open_button, self.again_button)
        self.person = QCheckBox("A person is the &operator")
        self.person.setToolTip("Questions about mounting and faults, as on a real rig; from the next run on")
        self.person.setAccessibleName("A person is the operator")
        _fill(self, [self._name], self.buttons).addWidget(self.person)
        self.person.hide()

    def set_rig(self, rig: RigOpened | None, path: Path) -> None:
        """Show the open rig, or that the one of a file is not open. At a real rig a person always is the operator."""
        self.person.setVisible(rig is not None and rig.description.simulated)
        self._name.setText(rig.description.file.name if rig else f"no rig: {path.name}")
        self._name.setToolTip(str(path))


class SchedulePanel(QGroupBox):
    """The schedule, its size, and the folder of data files."""

    open = Signal()
    choose_folder = Signal()

    def __init__(self, folder: Path) -> None:
        super().__init__("Schedule")
        self._name = heading("no schedule")
        self._name.setAccessibleName("Schedule")
        self._size = QLabel()
        self._size.setWordWrap(True)
        self._folder = QLabel()
        self._folder.setWordWrap(True)
        self.open_button = QPushButton("Open &schedule…")
        self.open_button.setAccessibleName("Open a schedule file")
        self.folder_button = QPushButton("Save &in…")
        self.folder_button.setAccessibleName("Choose the folder for data files (journals)")
        self.open_button.clicked.connect(self.open)
        self.folder_button.clicked.connect(self.choose_folder)
        self.buttons = (self.open_button, self.folder_button)
        _fill(self, [self._name, self._size, self._folder], self.buttons)
        self.set_plan(None)
        self.set_folder(folder)

    def set_plan(self, plan: Plan | None) -> None:
        """Show the schedule of a plan and its size."""
        self._name.setText(plan.schedule.file.name if plan else "no schedule")
        self._name.setToolTip(plan.schedule.name if plan else "")
        self._size.setVisible(plan is not None)
        if plan is not None:
            self._size.setText(f"{len(plan.rows)} rows, estimated duration {rounded_duration_text(plan.seconds)}")

    def set_folder(self, folder: Path) -> None:
        """Show the folder of data files."""
        # A path has no spaces to wrap at; an invisible one after each separator allows a line break.
        text = str(folder).replace("/", "/\u200b").replace("\\", "\\\u200b")
        self._folder.setText(f"Data files (journals) in {text}")
        self._folder.setToolTip(str(folder))


def _fill(box: QGroupBox, labels: list[QLabel], buttons: tuple[QPushButton, ...]) -> QVBoxLayout:
    layout = QVBoxLayout(box)
    layout.setSpacing(4)
    for label in labels:
        layout.addWidget(label)
    row = QHBoxLayout()
    for button in buttons:
        row.addWidget(button)
    layout.addLayout(row)
    return layout
