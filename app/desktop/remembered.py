"""What the window remembers between its starts: its layout, the folder of journals, the files that were opened last."""

from pathlib import Path
from typing import Literal, get_args

from PySide6.QtCore import QByteArray, QSettings

from goniotwin.app.desktop.theme import Scheme
from goniotwin.own_files import make_own_folder, state_folder

Kind = Literal["rig", "schedule"]
FILE = "window.ini"
MOST_RECENT = 8


class Remembered:
    """The settings of a user's windows in a file; without one nothing is remembered. A file that cannot be used is no error."""

    def __init__(self, path: Path | None = None) -> None:
        self._settings = None if path is None else QSettings(str(path), QSettings.Format.IniFormat)

    @classmethod
    def of_user(cls) -> "Remembered":
        """That of this user, in the state folder; nothing is remembered if that cannot be used."""
        try:
            make_own_folder(state_folder())
        except OSError:
            return cls()
        return cls(state_folder() / FILE)

    def layout(self, name: str) -> QByteArray | None:
        """A layout (the window's geometry, the state of a splitter) as Qt stores it; None without one."""
        value = None if self._settings is None else self._settings.value(f"layout/{name}")
        return value if isinstance(value, QByteArray) else None

    def set_layout(self, name: str, state: QByteArray) -> None:
        """Remember a layout."""
        self._set(f"layout/{name}", state)

    def text(self, name: str) -> str:
        """A text; empty without one."""
        value = None if self._settings is None else self._settings.value(name)
        return value if isinstance(value, str) else ""

    def set_text(self, name: str, text: str) -> None:
        """Remember a text."""
        self._set(name, text)

    @property
    def scheme(self) -> Scheme | None:
        """The scheme that the user has chosen; None follows the system."""
        return next((each for each in get_args(Scheme) if each == self.text("scheme")), None)

    @property
    def folder(self) -> Path | None:
        """The folder of journals; None if it is not there any more."""
        path = Path(self.text("folder"))
        return path if self.text("folder") and path.is_dir() else None

    def set_folder(self, folder: Path) -> None:
        """Remember the folder of journals."""
        self._set("folder", str(folder.absolute()))

    def recent(self, kind: Kind) -> list[Path]:
        """The files of a kind that were opened last, the latest first."""
        paths = [Path(line) for line in self.text(f"recent/{kind}").split("\n") if line]
        return [path for path in paths[:MOST_RECENT] if path.is_file()]

    def add_recent(self, kind: Kind, path: Path) -> None:
        """Remember a file that has been opened."""
        latest = path.absolute()
        paths = [latest, *(each for each in self.recent(kind) if each != latest)]
        self._set(f"recent/{kind}", "\n".join(map(str, paths[:MOST_RECENT])))

    def _set(self, name: str, value: object) -> None:
        if self._settings is not None:
            self._settings.setValue(name, value)
