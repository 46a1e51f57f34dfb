"""Windows beside the main one block nothing and pass the release of Esc on: the keys of Stop hold in each of them."""

from collections.abc import Callable
from pathlib import Path

from PySide6.QtCore import Qt
from PySide6.QtGui import QKeyEvent
from PySide6.QtWidgets import QApplication, QDialog, QFileDialog, QWidget


def pass_on_escape(dialog: QDialog, event: QKeyEvent) -> bool:
    """Give the release of Esc, which a window of its own does not pass on, to the main window; return whether it was that."""
    released = event.key() == Qt.Key.Key_Escape and not event.isAutoRepeat()
    parent = dialog.parentWidget()
    if released and parent is not None:
        QApplication.sendEvent(parent.window(), event)
    return released


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

    def keyReleaseEvent(self, event: QKeyEvent) -> None:
        """Close with Esc, and report its release; Qt calls it."""
        if pass_on_escape(self, event):
            self.reject()
        else:
            super().keyReleaseEvent(event)
