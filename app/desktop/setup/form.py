"""The form of a schedule, and what a new one is made from. Fields, help and choices are those of `campaign.schedule.form`."""

from collections.abc import Callable
from typing import TYPE_CHECKING

from PySide6.QtCore import Signal
from PySide6.QtWidgets import QComboBox, QDialog, QDialogButtonBox, QFormLayout, QLabel, QLineEdit, QVBoxLayout, QWidget

from goniotwin.app.desktop.theme import Colours
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the window shows itself before the tables of the schedule are loaded
    from goniotwin.app.campaign.schedule.form import FormField
    from goniotwin.app.desktop.model.draft import TemplateChoice


class ScheduleForm(QWidget):
    """The fields of a schedule. `edited` has the text of the schedule with what was typed."""

    edited = Signal(str)
    refused = Signal(str)
    """Why what was typed is no value; empty once it is corrected."""

    def __init__(self, colours: Colours) -> None:
        super().__init__()
        self.setAccessibleName("Form of the schedule")
        self._colours = colours
        self._text, self._name = "", ""
        self._refused: dict[str, tuple[str, str]] = {}
        self.fields: dict[str, QLineEdit | QComboBox] = {}
        self._declared: dict[str, FormField] = {}
        self._layout = QFormLayout(self)
        self._layout.setContentsMargins(0, 0, 0, 0)
        self._layout.setVerticalSpacing(3)
        self._layout.setRowWrapPolicy(QFormLayout.RowWrapPolicy.WrapLongRows)

    @property
    def sample(self) -> str:
        """The first sample of the schedule; empty without one."""
        field = self.fields.get("samples")
        return field.text().partition(",")[0] if isinstance(field, QLineEdit) else ""

    @property
    def refusal(self) -> str:
        """Why what stands in a field is no value; empty if every field has that of the text."""
        return next((reason for reason, _ in self._refused.values()), "")

    def discard(self) -> None:
        """Show the text's value in each field again."""
        for key in list(self._refused):
            self._mark(key, "", "")

    def complete(self) -> None:
        """Make the fields, which the schedule's tables declare."""
        # It loads the schedule's tables, which the window's first picture does without.
        from goniotwin.app.campaign.schedule.form import FIELDS

        for each in FIELDS:
            field = QComboBox() if each.choices else QLineEdit()
            if isinstance(field, QComboBox):
                field.addItems(each.choices)
                field.activated.connect(lambda _at, key=each.key: self._edit(key))
            else:
                field.editingFinished.connect(lambda key=each.key: self._edit(key))
            field.setAccessibleName(each.label)
            field.setAccessibleDescription(each.help)
            field.setToolTip(each.help)
            self.fields[each.key], self._declared[each.key] = field, each
            self._layout.addRow(each.label, field)
        self.set_text(self._text, self._name)

    def set_text(self, text: str, name: str) -> None:
        """Show the fields of a text; where it is not TOML they stay as they are."""
        self._text, self._name = text, name
        self.setEnabled(bool(text))
        for key, field in self.fields.items():
            try:
                shown = self._declared[key].shown(text, name)
            except UserError:
                return
            if key in self._refused and self._refused[key][1] != shown:
                self._mark(key, "", "")  # the text has another value by now
            if isinstance(field, QComboBox):
                field.setCurrentText(shown)
            elif field.text() != shown and not field.hasFocus() and key not in self._refused:
                field.setText(shown)

    def _edit(self, key: str) -> None:
        field, declared = self.fields[key], self._declared[key]
        typed = field.currentText() if isinstance(field, QComboBox) else field.text()
        before = self.refusal
        try:
            edited = declared.edited(self._text, typed, self._name)
        except UserError as error:
            self._mark(key, str(error), self._shown(key))
        else:
            self._mark(key, "", "")
            if edited != self._text:
                self.edited.emit(edited)
        if self.refusal != before:
            self.refused.emit(self.refusal)

    def _shown(self, key: str) -> str:
        try:
            return self._declared[key].shown(self._text, self._name)
        except UserError:
            return ""

    def _mark(self, key: str, reason: str, shown: str) -> None:
        """Mark a field whose content is refused for a reason, beside the value that the text has; or unmark it."""
        if reason:
            self._refused[key] = reason, shown
        else:
            self._refused.pop(key, None)
        self.fields[key].setStyleSheet(f"border: 2px solid {self._colours.bad}" if reason else "")
        self.fields[key].setToolTip(reason or self._declared[key].help)


class NewSchedule(QDialog):
    """The questions of a new schedule, as `goniotwin new` asks them. It blocks nothing; `chosen` has a `TemplateChoice`.

    It stays until the schedule is written (`accept`), or `show_error` says why it is not.
    """

    def __init__(
        self, parent: QWidget, samples: tuple[str, ...], sample: str, chosen: "Callable[[TemplateChoice], None]"
    ) -> None:
        # Loads the planner, which the window has by then.
        from goniotwin.app.campaign.planning.templates import TEMPLATES, USUAL_ETALON, USUAL_H, USUAL_U
        from goniotwin.app.desktop.model.draft import TemplateChoice

        super().__init__(parent)
        self.setWindowTitle("New schedule")
        self.setAccessibleName("New schedule")
        self._chosen, self._make = chosen, TemplateChoice
        self.template, self.sample, self.etalon = QComboBox(), QComboBox(), QComboBox()
        for name, each in TEMPLATES.items():
            self.template.addItem(f"{name}: {each.title}", name)
        for choice in (self.sample, self.etalon):
            choice.setEditable(True)
            choice.addItems(samples)
        self.etalon.setCurrentText(USUAL_ETALON)
        others = [each for each in samples if each != USUAL_ETALON] or [sample or "sample"]
        self.sample.setCurrentText(sample if sample in others else others[0])
        self.relative_u, self.longest_h = QLineEdit(f"{USUAL_U:g}"), QLineEdit(f"{USUAL_H:g}")
        self._error = QLabel()
        self._error.setWordWrap(True)
        form = QFormLayout()
        for label, field in (
            ("What is measured", self.template),
            ("Sample", self.sample),
            ("Reference standard", self.etalon),
            ("Target u (k = 1), relative", self.relative_u),
            ("Longest time, h", self.longest_h),
        ):
            field.setAccessibleName(label)
            form.addRow(label, field)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Ok | QDialogButtonBox.StandardButton.Cancel)
        buttons.button(QDialogButtonBox.StandardButton.Ok).setText("Write the schedule")
        buttons.accepted.connect(self._accept)
        buttons.rejected.connect(self.reject)
        layout = QVBoxLayout(self)
        layout.addLayout(form)
        layout.addWidget(self._error)
        layout.addWidget(buttons)

    def _accept(self) -> None:
        numbers = []
        for field in (self.relative_u, self.longest_h):
            try:
                numbers.append(float(field.text()))
            except ValueError:
                self.show_error(f"{field.accessibleName()}: {field.text()!r} is no number; write one such as 0.01 or 4")
                field.setFocus()
                return
        sample, etalon = self.sample.currentText().strip(), self.etalon.currentText().strip()
        self._error.setText("The directions are being chosen …")
        self._chosen(self._make(str(self.template.currentData()), sample, etalon, *numbers))

    def show_error(self, reason: str) -> None:
        """Show why there is no such schedule."""
        self._error.setText(f"✗ {reason}")
