"""A rig file as it is read: its text, its tables and its alignment file, and the model of the virtual rig that it describes."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from goniotwin.app.errors import UserError
from goniotwin.app.rig.alignment import RigIdentity, alignment_notes, check_alignment, parse_alignment, read_alignment
from goniotwin.app.rig.axes import AXES
from goniotwin.app.rig.file import RigFile, check_kinds, rig_file_table, tables_without_ports
from goniotwin.app.rig.kinds import load_plugins
from goniotwin.app.rig.model_hash import model_hashes
from goniotwin.app.rig.twin_file import check_detectors, twin_model
from goniotwin.app.toml_file import parse_toml, read_toml, validate_table
from goniotwin.twin.plant.model import TwinModel

ARC_KEYS = ("upper_deg", "lower_deg")
"""Keys of [photodiodes] that are angles on the arc."""
AXIS_KEYS = ("gear", "sense", "zero_offset_deg")
"""Keys of an axis that decide where it is, whatever its kind."""
WITHOUT_ANGLES = ("shadow_margin_deg", "reply_timeout_s")
"""Keys of [geometry] and [axes] that change no angle."""


@dataclass(frozen=True)
class RigDescription:
    """A rig file: its text, its tables, the folder that paths in it are relative to, and the text of its alignment file."""

    text: str
    file: RigFile
    folder: Path
    name: str
    alignment: str | None = None

    @property
    def digest(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def simulated(self) -> bool:
        """Whether the rig is simulated."""
        return self.file.simulated is not None

    @property
    def seed(self) -> int | None:
        """The seed of a simulated rig, None for a real one."""
        return self.file.simulated.seed if self.file.simulated is not None else None

    @property
    def identity(self) -> RigIdentity:
        """What an alignment states of its rig, and what it depends on."""
        content = tables_without_ports(self.file)
        content.pop("alignment", None)
        name = content.pop("name")
        photodiodes, axes = content["photodiodes"], content["axes"]
        for table in (axes, *(axes[name] for name in AXES)):
            for key in WITHOUT_ANGLES:
                table.pop(key, None)
        geometry = {
            **{key: value for key, value in content.pop("geometry").items() if key not in WITHOUT_ANGLES},
            **{key: photodiodes.pop(key, None) for key in ARC_KEYS},
            **{f"{axis}.{key}": axes[axis].pop(key, None) for axis in AXES for key in AXIS_KEYS},
        }
        digests = {table: _digest(each) for table, each in content.items()}
        return RigIdentity(name, self.simulated, self.seed, _digest(geometry), digests)

    @property
    def alignment_notes(self) -> list[str]:
        """What is stated wherever the rig's alignment is used: doubtful residuals, and tables that have changed since it."""
        return [] if self.alignment is None else alignment_notes(parse_alignment(self.alignment, self.name), self.identity)

    def model(self) -> TwinModel | None:
        """The model of the virtual rig, None where the file has no [twin].

        Raises UserError for the file of a sample that cannot be read.
        """
        if self.file.twin is None:
            return None
        return twin_model(self.file.twin, self.seed or 0, self.folder, self.name)

    def model_hash(self) -> str | None:
        """The hash of the virtual rig's model, None for a real rig."""
        return self.model_hashes()[0]

    def model_hashes(self) -> tuple[str | None, ...]:
        """All hashes that identify the model of the virtual rig: the present version first, then the older one."""
        model = self.model()
        if model is not None:
            return model_hashes(model)
        table = self.file.simulated
        if table is None:
            return (None,)
        return (table.model,) if table.old_model is None else (table.model, table.old_model)


def read_rig(path: Path) -> RigDescription:
    """Read a rig file, and the alignment file that it names. Raises UserError with the file, the key and the reason."""
    text, content = read_toml(path)
    file = _file(content, str(path))
    alignment = None
    if file.alignment is not None:
        alignment = read_alignment(path.parent, file.alignment)
        check_alignment(alignment, str(path), RigDescription(text, file, path.parent, str(path)).identity)
    return RigDescription(text, file, path.parent, str(path), alignment)


def parse_rig(text: str, folder: Path, name: str, alignment: str | None = None) -> RigDescription:
    """Parse the text of a rig file, such as a journal contains, with that of its alignment file. Raises UserError."""
    return RigDescription(text, _file(parse_toml(text, name), name), folder, name, alignment)


def _digest(table: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(table, sort_keys=True, default=str).encode()).hexdigest()


def _file(content: dict[str, Any], name: str) -> RigFile:
    if "sigma_deg" in content and "axes" not in content:
        raise UserError(f"{name}: looks like a schedule, not like a rig file; open it as a schedule")
    load_plugins(content, name)
    try:
        check_kinds(content)
        check_detectors(content)
    except ValueError as error:
        raise UserError(f"{name}: {error}") from None
    return validate_table(rig_file_table(), content, name)
