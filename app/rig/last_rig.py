"""The rig that this computer used last: the journal of another one asks before it is resumed.

A journal has the text of a rig file, with the addresses of devices and the limits of axes, and may come of unknown origin.
"""

import contextlib
import hashlib
import json
from dataclasses import asdict
from pathlib import Path

from goniotwin.app.rig.file import RigFile
from goniotwin.app.rig.kinds import ROLES
from goniotwin.own_files import make_own_folder, replace_text, state_folder

FILE = "last-rig"
OPERATORS = ("name", *ROLES, "geometry", "sample_unit", "etalon")


def remember_rig(file: RigFile) -> None:
    """Remember a rig with devices of this computer as the one that was used last. A full disk is no error."""
    if file.in_process:
        return
    path = _place()
    with contextlib.suppress(OSError):
        make_own_folder(path.parent)
        replace_text(path, _digest(file))


def is_last_rig(file: RigFile) -> bool:
    """Whether a rig is the one that was used last, with the same tables and addresses, or is virtual in this process."""
    if file.in_process:
        return True
    try:
        return _place().read_text(encoding="ascii") == _digest(file)
    except (OSError, UnicodeError):
        return False


def _digest(file: RigFile) -> str:
    """SHA-256 of all tables of the operator's part."""
    tables = {key: value if isinstance(value, str) else asdict(value) for key, value in vars(file).items() if key in OPERATORS}
    return hashlib.sha256(json.dumps(tables, sort_keys=True, default=str).encode()).hexdigest()


def _place() -> Path:
    return state_folder() / FILE
