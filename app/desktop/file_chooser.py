"""The files of the window: rig, schedule and the folder of journals, as a person chooses them."""

from pathlib import Path

from PySide6.QtCore import QObject, QUrl, Signal, SignalInstance, Slot
from PySide6.QtGui import QDesktopServices
from PySide6.QtWidgets import QWidget

from goniotwin import examples
from goniotwin.app.desktop.dialogs import FileDialog
from goniotwin.app.desktop.remembered import Kind, Remembered


class FileChooser(QObject):
    """Lets a person choose files, in dialogs that block nothing. `folder` is that of journals."""

    rig_chosen = Signal(object)
    schedule_chosen = Signal(object)
    folder_chosen = Signal(object)

    def __init__(self, parent: QWidget, folder: Path, remembered: Remembered) -> None:
        super().__init__(parent)
        self.folder = folder
        self._parent = parent
        self._remembered = remembered

    def choose_rig(self, present: Path) -> None:
        """Let a rig file be chosen, beside the latest one, or the `present` one."""
        self._choose("rig", "Open a rig file", present, "Rig files (*.toml)", self.rig_chosen)

    def choose_schedule(self, present: Path) -> None:
        """Let a schedule file be chosen, beside the latest one, or the `present` one."""
        self._choose("schedule", "Open a schedule file", present, "Schedule files (*.toml)", self.schedule_chosen)

    @Slot(str, object)
    def choose_recent(self, kind: Kind, path: Path) -> None:
        """Choose a file that was opened before."""
        (self.rig_chosen if kind == "rig" else self.schedule_chosen).emit(path)

    def remember(self, kind: Kind, path: Path) -> None:
        """Remember a file that is opened, other than those of the first start."""
        if path not in (examples.FIRST_RIG, examples.FIRST_SCHEDULE):
            self._remembered.add_recent(kind, path)

    @Slot()
    def choose_folder(self) -> None:
        """Let the folder of journals be chosen."""
        # The first run creates the folder.
        first = next(each for each in (self.folder, *self.folder.absolute().parents) if each.is_dir())
        FileDialog(self._parent, "Folder for data files (journals)", first, "", self._take_folder)

    def show_folder(self) -> bool:
        """Show the folder of journals in the system's file manager; False if there is none yet."""
        there = self.folder.is_dir()
        if there:
            QDesktopServices.openUrl(QUrl.fromLocalFile(str(self.folder.absolute())))
        return there

    def _choose(self, kind: Kind, title: str, present: Path, kinds: str, chosen: SignalInstance) -> None:
        folder = next((path.parent for path in self._remembered.recent(kind)), present.parent)
        FileDialog(self._parent, title, folder, kinds, chosen.emit)

    def _take_folder(self, folder: Path) -> None:
        self.folder = folder
        self._remembered.set_folder(folder)
        self.folder_chosen.emit(folder)
