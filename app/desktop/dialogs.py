"""Windows beside the main one, which block nothing: the keys of Stop hold in each of them. Esc, once it is up, closes them."""

import os
from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import (
    QApplication,
    QDialog,
    QDialogButtonBox,
    QFileDialog,
    QGridLayout,
    QLabel,
    QLineEdit,
    QTextBrowser,
    QVBoxLayout,
    QWidget,
)

TEXT_WIDTH, TITLE_BAR = 520, 36


def close_dialog() -> None:
    """Close the dialog that is in front, if there is one: Esc was pressed and released.

    Not by its press, from which on Esc may be held, nor by any release that a dialog gets: that of auto-repeat comes while the
    key is down.
    """
    window = QApplication.activeWindow()
    if isinstance(window, QDialog):
        window.reject()


class FileDialog(QFileDialog):
    """A choice of a file or a folder, which blocks nothing; Esc, not held, closes it.

    It is Qt's own: that of a desktop environment keeps the keys of Stop to itself.
    """

    def __init__(
        self, parent: QWidget, title: str, first: Path, kinds: str, chosen: Callable[[Path], object], *, save: bool = False
    ) -> None:
        """Show it: `first` is the folder, or the file to `save` to; without `kinds` a folder is chosen."""
        super().__init__(parent, title)
        self._title = title
        self.setOption(QFileDialog.Option.DontUseNativeDialog)
        self.setOption(QFileDialog.Option.DontConfirmOverwrite)  # that question would block
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        self.setModal(False)
        self.setNameFilter(kinds)
        self.setDirectory(str(first.parent if save else first))
        if save:
            self.setAcceptMode(QFileDialog.AcceptMode.AcceptSave)
            self.selectFile(first.name)
        elif kinds:
            self.setFileMode(QFileDialog.FileMode.ExistingFile)
        else:
            self.setFileMode(QFileDialog.FileMode.Directory)
            self.setOption(QFileDialog.Option.ShowDirsOnly)
        self.fileSelected.connect(lambda name: chosen(Path(name)))
        for field in self.findChildren(QLineEdit, "fileNameEdit"):
            field.setAccessibleName("File name")
        self.show()
        self.resize(self.width(), min(self.height(), self.screen().availableGeometry().height() - TITLE_BAR))

    def accept(self) -> None:
        """Choose what was typed or picked; Qt calls it. Its own answer to a name that is not there would block."""
        name = next(iter(self.selectedFiles()), "")
        if self.acceptMode() is QFileDialog.AcceptMode.AcceptOpen and not os.path.exists(name):  # noqa: PTH110  (of too long a name Path raises)
            self.setWindowTitle(f"{self._title}: there is no {Path(name).name}")
        else:
            self.setWindowTitle(self._title)
            super().accept()

    def add_field(self, label: str, field: QLineEdit) -> None:
        """Show a field, which may stay empty, below the name of the file."""
        grid = self.layout()
        assert isinstance(grid, QGridLayout)
        row = grid.rowCount()
        field.setAccessibleName(label)
        grid.addWidget(QLabel(f"{label}:"), row, 0)
        grid.addWidget(field, row, 1)


class TextBox(QDialog):
    """A text in a window of its own, which blocks nothing."""

    def __init__(self, parent: QWidget, title: str, text: str) -> None:
        super().__init__(parent)
        self.setWindowTitle(title)
        self.setAccessibleName(title)
        self.setAttribute(Qt.WidgetAttribute.WA_DeleteOnClose)
        shown = QTextBrowser()
        shown.setHtml(text)
        shown.setAccessibleName(title)
        shown.setTabChangesFocus(True)
        shown.document().setDocumentMargin(10)
        buttons = QDialogButtonBox(QDialogButtonBox.StandardButton.Close)
        buttons.rejected.connect(self.close)
        for button in buttons.buttons():
            button.setAccessibleName(f"Close {title}")
        layout = QVBoxLayout(self)
        layout.addWidget(shown)
        layout.addWidget(buttons)
        document = shown.document()
        document.setTextWidth(TEXT_WIDTH)
        self.resize(TEXT_WIDTH + 50, min(round(document.size().height()) + 80, parent.height() - 20))
