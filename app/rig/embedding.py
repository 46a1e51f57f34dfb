"""A rig file with the contents of the files that it names: what another computer needs to make the same virtual rig."""

import base64
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import tomlkit

from goniotwin.app.formats.file import read_file, write_file
from goniotwin.app.rig.description import RigDescription, parse_rig

NAME = "the rig file"
"""Its name in the messages of another computer: the path on this one is not the rig's."""


def embed_rig(rig: RigDescription) -> dict[str, Any]:
    """The rig as data: the texts of its file and of its alignment, and the contents of its samples' tables.

    Raises UserError for a table that cannot be read.
    """
    document = tomlkit.parse(rig.text)
    files: dict[str, str] = {}
    for table in _measured(document):
        path = rig.folder / str(table["file"])
        name = f"table-{len(files)}/{path.name}"
        files[name] = base64.b64encode(read_file(path)).decode()
        table["file"] = name
    return {"text": tomlkit.dumps(document) if files else rig.text, "alignment": rig.alignment, "files": files}


def embedded_rig(data: Mapping[str, Any], folder: Path) -> RigDescription:
    """The rig of `embed_rig`; the tables of its samples are written into a folder, which is kept as long as the rig."""
    for name, content in data["files"].items():
        path = folder / name
        path.parent.mkdir()
        write_file(path, base64.b64decode(content))
    return parse_rig(data["text"], folder, NAME, data["alignment"])


def _measured(document: Any) -> Iterator[Any]:
    """The tables of samples that are in files."""
    for sample in document.get("twin", {}).get("samples", {}).values():
        for table in [sample, *sample.get("lobes", ())]:
            if "file" in table:
                yield table
