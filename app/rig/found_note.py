"""Notes of the settings as found, in the user's state folder: what a killed program leaves changed is restored by the next."""

import contextlib
from pathlib import Path

from goniotwin.app.rig.addresses import device_names
from goniotwin.app.rig.lock import file_stem
from goniotwin.own_files import make_own_folder, replace_text, state_folder

FOLDER = "found"
LONGEST_NOTE = 100_000


class FoundNote:
    """The note about the device at an address: a file, made where it is needed."""

    def __init__(self, address: str) -> None:
        unit = address.partition("?")[2]  # several modules on one line
        self._name = f"{min(device_names(address))} {unit}".rstrip()

    def read(self) -> str:
        """The note; empty if there is none that can be read."""
        try:
            with self._path.open(encoding="utf-8") as file:
                return file.read(LONGEST_NOTE)
        except (OSError, UnicodeError):
            return ""

    def write(self, text: str) -> None:
        """Replace the note; an empty one is removed. Without it settings are restored as well: a full disk is no error."""
        with contextlib.suppress(OSError):
            if text:
                make_own_folder(self._path.parent)
                replace_text(self._path, text)
            else:
                self._path.unlink()

    @property
    def _path(self) -> Path:
        return state_folder() / FOLDER / f"{file_stem(self._name)}.json"
