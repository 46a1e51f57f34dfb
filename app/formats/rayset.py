"""Rayset files: HDF5 behind a line of text, with the columns and units that docs/rayset.md describes.

The text has the SHA-256 of all that follows, for HDF5's library, given a damaged file, may end the process.
"""

import hashlib
import io
import re
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from goniotwin.app.formats.file import FormatError, StrPath, quote_word, read_file, write_file
from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.rayset import Rayset

FORMAT = "goniotwin rayset"
VERSION = 1
AGAIN = "record the rayset again, or copy the file again"


@dataclass(frozen=True)
class RaysetColumn:
    """A dataset of the file: the `Rayset`'s field, numbers a ray (0: one, not in a row of its own), unit, meaning."""

    field: str
    width: int
    unit: str
    meaning: str


COLUMNS = {
    "position": RaysetColumn(
        "positions_mm", 3, "mm", "where the ray crosses the reference plane: x across, y along the light, z up"
    ),
    "direction": RaysetColumn("directions", 3, "1", "along the light, same axes; length without meaning"),
    "wavelength": RaysetColumn("wavelength_nm", 0, "nm", "wavelength of the ray"),
    "flux": RaysetColumn("flux", 0, "", "what the ray carries, in the unit of the attribute flux_unit"),
}
# Attributes of the file, the fields that they are, and their types.
ATTRIBUTES: dict[str, tuple[str, type]] = {
    "flux_unit": ("unit", str),
    "plane_y_mm": ("plane_mm", float),
    "geometry": ("geometry", str),
    "emitted_flux": ("emitted_flux", float),
    "seed": ("seed", int),
}
# HDF5's user block: the library leaves it alone, and looks for its own signature behind it.
BLOCK = 512
HEADING = "goniotwin rayset, simulated; HDF5 from byte 512 on, of which sha256="
STATED = re.compile(re.escape(HEADING).encode() + rb"([0-9a-f]{64})\n *\n")


def write_rayset(path: StrPath, rayset: Rayset) -> None:
    """Write a rayset, whole or not at all; it says that it is simulated. Raises FormatError if that is impossible."""
    content = io.BytesIO()
    with h5py.File(content, "w", userblock_size=BLOCK) as file:
        file.attrs["format"] = FORMAT
        file.attrs["version"] = VERSION
        file.attrs["simulated"] = True
        for name, (field, kind) in ATTRIBUTES.items():
            value = getattr(rayset, field)
            file.attrs[name] = np.uint64(value) if kind is int else kind(value)
        for name, column in COLUMNS.items():
            data = file.create_dataset(name, data=np.asarray(getattr(rayset, column.field), dtype="<f8"))
            data.attrs["unit"] = column.unit or rayset.unit
            data.attrs["meaning"] = column.meaning
    body = content.getvalue()[BLOCK:]
    heading = f"{HEADING}{hashlib.sha256(body).hexdigest()}\n".encode()
    write_file(path, heading.ljust(BLOCK - 1) + b"\n" + body)


def read_rayset(path: StrPath) -> Rayset:
    """Read a rayset. Raises FormatError for anything that is not one, or is not as it was written."""
    content = read_file(path)
    stated = STATED.fullmatch(content[:BLOCK])
    if stated is None:
        raise FormatError(path, "is no rayset", "name a rayset that was written by goniotwin")
    if hashlib.sha256(content[BLOCK:]).hexdigest().encode() != stated[1]:
        raise FormatError(path, "is damaged: its content does not give the sha256 that it states", AGAIN)
    try:
        with h5py.File(io.BytesIO(content), "r") as file:
            return Rayset(**_fields(path, file))
    except FormatError:
        raise
    except ValueError as error:
        raise FormatError(path, str(error), AGAIN) from error
    except (OSError, KeyError, RuntimeError, TypeError) as error:
        raise FormatError(path, "cannot be read as HDF5", AGAIN) from error


def _fields(path: StrPath, file: h5py.File) -> dict[str, Any]:
    stated = _attribute(path, file, "format", str)
    if stated != FORMAT:
        raise FormatError(
            path, f"is no rayset: its format is {quote_word(stated)}", "name a rayset that was written by goniotwin"
        )
    version = _attribute(path, file, "version", int)
    if version != VERSION:
        raise FormatError(path, f"is a rayset of version {version}, not {VERSION}", "read it with the program that wrote it")
    if not _attribute(path, file, "simulated", bool):
        raise FormatError(path, "does not say that it is simulated", "only simulated raysets are read")
    fields = {field: _attribute(path, file, name, kind) for name, (field, kind) in ATTRIBUTES.items()}
    for name, column in COLUMNS.items():
        fields[column.field] = _column(path, file, name, column, str(fields["unit"]))
    return fields


def _attribute(path: StrPath, file: h5py.File, name: str, kind: type) -> Any:
    if name not in file.attrs:
        raise FormatError(path, f"the attribute {name} is missing", "name a rayset, or copy the file again")
    value = file.attrs[name]
    accepted = {str: str, bool: np.bool_, int: np.integer, float: np.floating}[kind]
    if not isinstance(value, accepted):
        raise FormatError(path, f"the attribute {name} is {quote_word(str(value))}, no {kind.__name__}", AGAIN)
    return kind(value)


def _column(path: StrPath, file: h5py.File, name: str, column: RaysetColumn, flux_unit: str) -> Floats:
    data = file.get(name)
    if not isinstance(data, h5py.Dataset):
        raise FormatError(path, f"the column {name} is missing", AGAIN)
    expected = 2 if column.width else 1
    if data.dtype.kind != "f" or data.ndim != expected or (column.width and data.shape[1] != column.width):
        wanted = f"(n, {column.width})" if column.width else "(n,)"
        raise FormatError(path, f"the column {name} has {data.dtype} {data.shape}, not numbers {wanted}", AGAIN)
    unit = data.attrs.get("unit")
    if unit != (column.unit or flux_unit):
        raise FormatError(path, f"the column {name} is in {quote_word(str(unit))}, not {column.unit or flux_unit}", AGAIN)
    return np.asarray(data[()], dtype=np.float64)
