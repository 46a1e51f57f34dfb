"""Windows beside the main one, which block nothing: the keys of Stop hold in each of them. Esc, once it is up, closes them."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtWidgets import QApplication, QDialog, QFileDialog, QWidget


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
        self.show()
