"""The record of a sample, as the question for its mounting asks for it: as it is known, or that of another campaign."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from PySide6.QtCore import Slot
from PySide6.QtWidgets import QComboBox, QGridLayout, QLabel, QLineEdit, QPushButton, QScrollArea, QWidget

from goniotwin.app.campaign.journal.samples import KnownSample
from goniotwin.app.campaign.schedule.form import SAMPLE_FIELDS
from goniotwin.app.campaign.schedule.metadata import SampleMetadataTable
from goniotwin.app.desktop.bench.number_field import number_of
from goniotwin.app.desktop.bench.position_entry import AnswerField
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.protocols.clock import local_stamp

DECIMALS = 6
PICTURES = "Pictures (*.jpg *.jpeg *.png *.tif *.tiff *.heic *.webp);;All files (*)"
OF_MOUNTING = {"mounted_by": "", "mounted_at": ""}
"""Is asked anew at each mounting."""


class SampleEntry(QScrollArea):
    """The fields of a record. They may stay as they are: `given` has only what a person has changed, or chosen."""

    def __init__(self) -> None:
        super().__init__()
        self._records = [SampleMetadataTable()]
        self._shown = self._records[0]
        self.known = QComboBox()
        self.known.setMinimumContentsLength(12)
        self.fields: dict[str, QLineEdit] = {}
        whole = QWidget()
        grid = QGridLayout(whole)
        grid.setContentsMargins(0, 0, 6, 0)
        grid.setVerticalSpacing(4)
        grid.addWidget(QLabel("Record of"), 0, 0)
        grid.addWidget(self.known, 0, 1, 1, 5)
        self.known.setAccessibleName("Sample whose record is taken")
        for at, each in enumerate(SAMPLE_FIELDS):
            field = self.fields[each.path[-1]] = AnswerField()
            field.setAccessibleName(f"Sample: {each.label.lower()}")
            field.setAccessibleDescription(each.help)
            field.setToolTip(each.help)
            row, column, picture = 1 + at // 2, 3 * (at % 2), each.path[-1] == "picture"
            grid.addWidget(QLabel(each.label), row, column)
            grid.addWidget(field, row, column + 1, 1, 1 if picture else 2)
            grid.setColumnStretch(column + 1, 1 + at % 2)  # a button takes room of the left one
            if picture:
                choose = QPushButton("Choose…")
                choose.setAutoDefault(False)
                choose.setAccessibleName("Choose the picture")
                choose.clicked.connect(self._choose_picture)
                grid.addWidget(choose, row, column + 2)
        self.setWidget(whole)
        self.setWidgetResizable(True)
        self.setFrameShape(QScrollArea.Shape.NoFrame)
        self.known.activated.connect(self._choose_known)
        self.set_known(None, ())

    def set_known(self, own: KnownSample | None, known: Sequence[KnownSample]) -> None:
        """Show the record of the sample in its campaign, and offer those of others. What was typed stays."""
        typed = self._typed()
        others = [each for each in known if own is None or (each.name, each.journal) != (own.name, own.journal)]
        records = [*([] if own is None else [own.record]), *(each.record for each in others)]
        self._records = [each.model_copy(update=OF_MOUNTING) for each in records] or [SampleMetadataTable()]
        self.known.clear()
        self.known.addItem("this campaign")
        for each in others:
            about = f", {each.record.identifier}" if each.record.identifier else ""
            self.known.addItem(f"{each.name}{about}, {each.journal.stem}, {local_stamp(each.begun)}")
        self._choose_known(0)
        for key, text in typed.items():
            self.fields[key].setText(text)

    def given(self) -> dict[str, Any]:
        """What a person has changed or chosen, by key; a text that is no number stays one, and is refused by the station."""
        typed: dict[str, Any] = {key: text.strip() for key, text in self._typed().items()}
        if (text := typed.get("thickness_mm")) is not None:
            number = number_of(text, DECIMALS)
            typed["thickness_mm"] = None if not text else text if number is None else number
        now, before = {**self._shown.model_dump(), **typed}, self._records[0].model_dump()
        if "picture" in typed:
            now.pop("picture_sha256")  # the station finds it
        elif not now["picture_sha256"]:
            now["picture"] = before["picture"]  # a name in a schedule, of a file that may be anywhere, is not copied
        return {key: value for key, value in now.items() if value != before[key]}

    def _typed(self) -> dict[str, str]:
        return {key: field.text() for key, field in self.fields.items() if field.text() != self._text(key)}

    def _text(self, key: str) -> str:
        value = getattr(self._shown, key)
        return "" if value is None else f"{value:g}" if isinstance(value, float) else str(value)

    @Slot(int)
    def _choose_known(self, at: int) -> None:
        self._shown = self._records[at]
        for key, field in self.fields.items():
            if key not in OF_MOUNTING:
                field.setText(self._text(key))
                field.setCursorPosition(0)

    @Slot()
    def _choose_picture(self) -> None:
        FileDialog(self.window(), "Picture of the sample", Path.home(), PICTURES, self._take_picture)

    def _take_picture(self, path: Path) -> None:
        self.fields["picture"].setText(str(path))
