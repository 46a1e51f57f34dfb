"""The campaigns screen: the journals of the folder with their state, and what can be done with one of them."""

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from PySide6.QtCore import QProcess, Qt, Signal, Slot
from PySide6.QtGui import QColor, QShowEvent
from PySide6.QtWidgets import (
    QAbstractItemView,
    QHBoxLayout,
    QHeaderView,
    QLabel,
    QTableWidget,
    QTableWidgetItem,
    QVBoxLayout,
)

from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop import model
from goniotwin.app.desktop.events.question import ask_file
from goniotwin.app.desktop.screen import Screen, WithoutPreferredHeight
from goniotwin.app.desktop.theme import Colours
from goniotwin.protocols.clock import local_stamp

if TYPE_CHECKING:  # the window shows itself before the engine is loaded
    from goniotwin.app.desktop.model.campaigns import Campaign, CampaignsListed

COLUMNS = ("campaign", "state", "rows", "left", "begun", "kind", "file")
MARKS = {"done": "✓", "running": "▶", "failed": "✗", "killed": "✗", "stopped": "■", "empty": "○"}
"""A mark of each state beside its word, for eyes that do not see the colours."""
LONGEST_NAME = 240
"""Widest column in logical pixels; the whole text is below the table, and in the tool tip."""
EXPORTS = "Measured points (*.csv);;Table (*.ddr);;Archive (*.h5)"
REPORTS = "Report (*.html);;Report to print (*.pdf)"


class CampaignsScreen(Screen):
    """The campaigns of the folder, the latest first. The window lists them, resumes them, and opens the folder."""

    title = "Campaigns"
    icon = "folder-clock-outline"

    refresh_wanted = Signal()
    resume_wanted = Signal(object)
    """The journal to resume."""
    results_wanted = Signal(object)
    """The journal to show on the screen Results."""
    folder_wanted = Signal()
    reported = Signal(str, bool)
    """A line for the status, and whether it is an error."""

    def __init__(self, colours: Colours) -> None:
        super().__init__(colours)
        self._campaigns: tuple[Campaign, ...] = ()
        self._no_resume = "no rig is open"
        self._process: QProcess | None = None
        self._heading = QLabel()
        self._heading.setAccessibleName("Folder of the campaigns")
        self._heading.setWordWrap(True)
        self.table = QTableWidget(0, len(COLUMNS))
        self.table.setAccessibleName("Campaigns")
        self.table.setHorizontalHeaderLabels(COLUMNS)
        self.table.verticalHeader().hide()
        self.table.setSelectionBehavior(QAbstractItemView.SelectionBehavior.SelectRows)
        self.table.setSelectionMode(QAbstractItemView.SelectionMode.SingleSelection)
        self.table.setEditTriggers(QAbstractItemView.EditTrigger.NoEditTriggers)
        self.table.setTabKeyNavigation(False)
        self.table.setMinimumHeight(80)
        header = self.table.horizontalHeader()
        header.setHighlightSections(False)
        header.setMaximumSectionSize(LONGEST_NAME)
        header.setDefaultAlignment(Qt.AlignmentFlag.AlignLeft | Qt.AlignmentFlag.AlignVCenter)
        header.setSectionResizeMode(QHeaderView.ResizeMode.ResizeToContents)
        header.setSectionResizeMode(len(COLUMNS) - 1, QHeaderView.ResizeMode.Stretch)
        self._about = QLabel()
        self._about.setWordWrap(True)
        self._about.setAccessibleName("The chosen campaign")
        self._errors = QLabel()
        self._errors.setWordWrap(True)
        self._errors.setAccessibleName("Files that cannot be read")
        self.results_button = self._button("R&esults", "Show the results of the chosen campaign", self._show_results)
        self.resume_button = self._button("Resume &it", "Resume the chosen campaign", self._resume)
        self.export_button = self._button("E&xport…", "Export the chosen campaign to a file", self._export)
        self.report_button = self._button("Rep&ort…", "Write the report of the chosen campaign", self._report)
        self.folder_button = self._button("Fol&der", "Open the folder of the campaigns", self.folder_wanted.emit)
        self.refresh_button = self._button("List agai&n", "List the campaigns again", self.refresh_wanted.emit)
        self.buttons = (
            self.results_button,
            self.resume_button,
            self.export_button,
            self.report_button,
            self.folder_button,
            self.refresh_button,
        )
        row = QHBoxLayout()
        for each in self.buttons:
            row.addWidget(each)
        row.addStretch(1)
        whole = WithoutPreferredHeight()
        outer = QVBoxLayout(self)
        outer.setContentsMargins(0, 0, 0, 0)
        outer.addWidget(whole)
        layout = QVBoxLayout(whole)
        layout.setContentsMargins(0, 0, 0, 0)
        for part in (self._heading, self.table, self._about, self._errors):
            layout.addWidget(part, 1 if part is self.table else 0)
        layout.addLayout(row)
        self.table.itemSelectionChanged.connect(self._show_chosen)
        self.table.itemActivated.connect(self._show_results)
        self.set_colours(colours)
        self._show_chosen()

    def show_campaigns(self, listed: "CampaignsListed") -> None:
        """Show the campaigns of a folder; the chosen one stays chosen."""
        chosen = self.chosen
        self._campaigns = listed.campaigns
        found = len(listed.campaigns)
        some = "no campaign yet: Start creates one" if not found else f"{found} campaign{'s' if found > 1 else ''}"
        self._heading.setText(f"{listed.folder}: {some}")
        self._errors.setText("\n".join(f"✗ {each}" for each in listed.errors))
        self._errors.setVisible(bool(listed.errors))
        self.table.setRowCount(found)
        for number, each in enumerate(listed.campaigns):
            for column, text in enumerate(_texts(each)):
                item = QTableWidgetItem(text)
                item.setToolTip(text)
                self.table.setItem(number, column, item)
        self._colour_states()
        paths = [each.path for each in listed.campaigns]
        if paths:
            self.table.selectRow(paths.index(chosen.path) if chosen is not None and chosen.path in paths else 0)
        self._show_chosen()

    @property
    def chosen(self) -> "Campaign | None":
        """The chosen campaign."""
        rows = {each.row() for each in self.table.selectedIndexes()}
        return self._campaigns[min(rows)] if rows and min(rows) < len(self._campaigns) else None

    @property
    def about(self) -> str:
        """What is known of the chosen campaign."""
        return self._about.text()

    @Slot(object)
    def show_message(self, message: object) -> None:
        """List the campaigns again when a run begins; the window does so at its end."""
        if isinstance(message, model.RunBegun):
            self.refresh_wanted.emit()

    def showEvent(self, event: QShowEvent) -> None:
        """List the campaigns again: their rows grow; Qt calls it."""
        super().showEvent(event)
        self.refresh_wanted.emit()

    def set_resume(self, refusal: str) -> None:
        """Allow resuming, or give the reason why it is not possible now."""
        if refusal != self._no_resume:
            self._no_resume = refusal
            self._show_chosen()

    def set_colours(self, colours: Colours) -> None:
        """Take the colours of a scheme."""
        super().set_colours(colours)
        self._errors.setStyleSheet(f"color: {colours.bad}")
        self._colour_states()

    def _colour_states(self) -> None:
        colours = self._colours
        shown = {"done": colours.good, "running": colours.accent, "failed": colours.bad, "killed": colours.bad}
        for number, each in enumerate(self._campaigns):
            item = self.table.item(number, 1)
            if item is not None:
                item.setForeground(QColor(shown.get(each.summary.state, colours.text)))

    @Slot()
    def _show_chosen(self) -> None:
        campaign = self.chosen
        for button in (self.results_button, self.export_button, self.report_button):
            button.setEnabled(campaign is not None and campaign.summary.rows > 0)
        resumable = campaign is not None and campaign.unfinished
        self.resume_button.setEnabled(resumable and not self._no_resume)
        if campaign is None:
            self.resume_button.setToolTip("Choose a campaign first")
        elif not resumable:
            self.resume_button.setToolTip(f"It is {campaign.summary.state}: there is nothing to resume")
        else:
            self.resume_button.setToolTip(
                f"Disabled: {self._no_resume}" if self._no_resume else "Measure the rows that are left"
            )
        self._about.setText("" if campaign is None else _about(campaign))
        self._about.setVisible(campaign is not None)

    @Slot()
    def _resume(self) -> None:
        if (campaign := self.chosen) is not None:
            self.resume_wanted.emit(campaign.path)

    @Slot()
    def _show_results(self) -> None:
        if (campaign := self.chosen) is not None and campaign.summary.rows > 0:
            self.results_wanted.emit(campaign.path)

    @Slot()
    def _export(self) -> None:
        if (campaign := self.chosen) is not None:
            self.export(campaign.path)

    @Slot()
    def _report(self) -> None:
        if (campaign := self.chosen) is not None:
            self.report(campaign.path)

    @Slot(object)
    def export(self, journal: Path) -> None:
        """Ask for a file, and export a campaign to it."""
        first, run = journal.with_suffix(".csv"), partial(self.run_command, "export", journal)
        ask_file(self.window(), "Export the campaign", first, EXPORTS, run)

    @Slot(object)
    def report(self, journal: Path) -> None:
        """Ask for a file, a number and a name, and write the report of a campaign."""

        def write(out: Path, number: str, person: str) -> None:
            self.run_command("report", journal, out, f"--number={number}", f"--approved-by={person}")

        first = journal.with_suffix(".html")
        ask_file(self.window(), "Report of the campaign", first, REPORTS, write, "Report number", "Approved by")

    def run_command(self, command: str, journal: Path, out: Path, *options: str) -> None:
        """Run `goniotwin COMMAND JOURNAL --out FILE` in a process of its own: its status is what it wrote, and warnings."""
        if self._process is not None:
            self.reported.emit("An export or a report is in progress.", True)
            return
        process = QProcess(self)
        process.finished.connect(self._end_command)
        process.errorOccurred.connect(self._fail_command)
        self._process = process
        self.reported.emit(f"Writing {out} …", False)
        process.start(sys.executable, ["-m", "goniotwin", command, str(journal), "--out", str(out), *options])

    @Slot(int)
    def _end_command(self, status: int) -> None:
        process, self._process = self._process, None
        if process is not None:
            channels = process.readAllStandardOutput(), process.readAllStandardError()
            written, warnings = (bytes(each.data()).decode(errors="replace").split("\n") for each in channels)
            done = f"Written: {written[0].strip()}" if status == 0 and written[0].strip() else ""
            texts = (done, *(each.strip().removeprefix("goniotwin: ") for each in warnings))
            self.reported.emit("; ".join(each for each in texts if each) or f"Ended with status {status}.", status != 0)
            process.deleteLater()

    @Slot(object)
    def _fail_command(self, error: QProcess.ProcessError) -> None:
        if error is QProcess.ProcessError.FailedToStart:
            self._process = None
            self.reported.emit("The program could not be started for this.", True)


def _texts(campaign: "Campaign") -> tuple[str, ...]:
    each = campaign.summary
    left = "" if each.state == "done" else rounded_duration_text(each.seconds_left)
    rows = f"{each.rows} of {each.planned}" + (f", {each.skipped} skipped" if each.skipped else "")
    kind = "SIMULATED" if each.simulated else "measured"
    return (
        each.name,
        f"{MARKS[each.state]} {each.state}",
        rows,
        left,
        local_stamp(each.begun or ""),
        kind,
        campaign.path.name,
    )


def _about(campaign: "Campaign") -> str:
    """The chosen campaign in words, with its last fault and its open safety orders."""
    each = campaign.summary
    sessions = "1 session" if each.sessions == 1 else f"{each.sessions} sessions"
    parts = [f"{campaign.path.name}: {each.state}, {each.rows} of {each.planned} rows in {sessions}"]
    if each.faults:
        parts.append(f"last fault: {each.faults[-1]}")
    if each.orders:
        parts.append(f"✗ safety order not acknowledged: {each.orders[-1]}")
    if each.damage:
        parts.append(f"✗ differs from what was measured: {each.damage}")
    return "; ".join(parts)
