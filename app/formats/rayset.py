"""Rayset files: HDF5 after one line of text, with the columns and units that docs/exchange/rayset.md describes.

The line has the SHA-256 of the HDF5 content, see `hdf5`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import h5py
import numpy as np

from goniotwin.app.formats.file import FormatError, StrPath, quote_word
from goniotwin.app.formats.hdf5 import open_hdf5, write_hdf5
from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.rayset import Rayset

FORMAT = "goniotwin rayset"
VERSION = 1
RECORD_AGAIN = "record the rayset again, or copy the file again"


@dataclass(frozen=True)
class RaysetColumn:
    """A dataset of the file: the field of `Rayset`, the numbers per ray (0: one, in a flat list), unit and meaning."""

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
# Attributes of the file: the field of `Rayset` and its type.
ATTRIBUTES: dict[str, tuple[str, type]] = {
    "flux_unit": ("unit", str),
    "plane_y_mm": ("plane_mm", float),
    "geometry": ("geometry", str),
    "emitted_flux": ("emitted_flux", float),
    "seed": ("seed", int),
}
MOST_BYTES = 330_000_000
"""Bytes of a file: five million rays, the most that are recorded, have 320 MB."""
HEADING = "goniotwin rayset, simulated; HDF5 from byte 512 on, of which sha256="


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is a rayset."""
    return head.startswith(HEADING.encode())


def write_rayset(path: StrPath, rayset: Rayset) -> None:
    """Write a rayset, marked as simulated, completely or not at all. Raises FormatError."""

    def fill(file: h5py.File) -> Iterator[None]:
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
            yield

    write_hdf5(path, HEADING, fill)


def read_rayset(path: StrPath, most_bytes: int = MOST_BYTES) -> Rayset:
    """Read a rayset. Raises FormatError for another kind of file, and for a file that changed after it was written."""
    with open_hdf5(path, HEADING, "a rayset", RECORD_AGAIN, most_bytes) as file:
        return Rayset(**_fields(path, file))


def _fields(path: StrPath, file: h5py.File) -> dict[str, Any]:
    given = _attribute(path, file, "format", str)
    if given != FORMAT:
        wrong = f"is not a rayset: its format is {quote_word(given)}"
        raise FormatError(path, wrong, "give a rayset that was written by goniotwin")
    version = _attribute(path, file, "version", int)
    if version != VERSION:
        raise FormatError(path, f"is a rayset of version {version}, not {VERSION}", "read it with the program that wrote it")
    if not _attribute(path, file, "simulated", bool):
        raise FormatError(path, "is not marked as simulated", "give a rayset that was written by goniotwin")
    fields = {field: _attribute(path, file, name, kind) for name, (field, kind) in ATTRIBUTES.items()}
    for name, column in COLUMNS.items():
        fields[column.field] = _column(path, file, name, column, str(fields["unit"]))
    return fields


def _attribute(path: StrPath, file: h5py.File, name: str, kind: type) -> Any:
    if name not in file.attrs:
        raise FormatError(path, f"the attribute {name} is missing", RECORD_AGAIN)
    value = file.attrs[name]
    accepted = {str: str, bool: np.bool_, int: np.integer, float: np.floating}[kind]
    if not isinstance(value, accepted):
        raise FormatError(path, f"the attribute {name} is {quote_word(str(value))}, not of type {kind.__name__}", RECORD_AGAIN)
    return kind(value)


def _column(path: StrPath, file: h5py.File, name: str, column: RaysetColumn, flux_unit: str) -> Floats:
    data = file.get(name)
    if not isinstance(data, h5py.Dataset):
        raise FormatError(path, f"the column {name} is missing", RECORD_AGAIN)
    expected = 2 if column.width else 1
    if data.dtype != np.float64 or data.ndim != expected or (column.width and data.shape[1] != column.width):
        shape = f"(n, {column.width})" if column.width else "(n,)"
        raise FormatError(path, f"the column {name} has {data.dtype} {data.shape}, not numbers {shape}", RECORD_AGAIN)
    if data.nbytes != data.id.get_storage_size():  # nothing is compressed: numbers that are not stored fill the memory
        raise FormatError(path, f"the column {name} has {data.shape[0]} rays, of which not all are in the file", RECORD_AGAIN)
    unit = data.attrs.get("unit")
    if unit != (column.unit or flux_unit):
        raise FormatError(
            path, f"the column {name} is in {quote_word(str(unit))}, not {column.unit or flux_unit}", RECORD_AGAIN
        )
    return np.asarray(data[()], dtype=np.float64)


read, write = read_rayset, write_rayset
"""The codec of the registry."""
