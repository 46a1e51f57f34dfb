"""The archive: HDF5 in the manner of NeXus, after one line of text. docs/exchange/archive.md describes its layout.

It holds every content, with metadata and uncertainties, and what a journal's writer adds (app/data/archive.py).
Each part is a group NXdata with the signal `values` and `values_errors` beside it. The line of text has the SHA-256 of the HDF5
content, which is checked first, as that of a rayset: the HDF5 library can crash on a damaged file. NeXus:
https://manual.nexusformat.org/classes/base_classes/NXdata.html.
"""

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from goniotwin.app.formats.content import COLUMNS, INTERVAL_COLUMNS, BsdfFile, Part, RegularTable, ScatteredBsdf
from goniotwin.app.formats.file import FormatError, StrPath, check_writable, quote_word
from goniotwin.app.formats.hdf5 import open_hdf5, write_hdf5
from goniotwin.app.formats.metadata import metadata_from_dict
from goniotwin.app.formats.table import BsdfTable

FORMAT = "goniotwin archive"
VERSION = 1
HEADING = "goniotwin archive; HDF5 from byte 512 on, of which sha256="
MOST_BYTES = 4_000_000_000
MOST_VALUES = 20_000_000
"""Values of all parts together that are read."""
MOST_PARTS = 10_000
MOST_TEXTS = 500_000
"""Comments and other texts of all parts together."""
MOST_CHARACTERS = 50_000_000
MOST_TEXT_BYTES = 400_000_000
"""Bytes of a column of texts, each of which takes as many as the longest."""
LEAST_TOGETHER, MOST_TOGETHER = 16, 4096
"""Texts that are read at once: all of them may be the longest text that the file has room for."""
COPY_AGAIN = "write the archive again, or copy the file again"
LEAST_PACKED = 512
"""Values from which an array is compressed."""
PACKED = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
WORDS = ("channel", "interval", "flags")
"""Columns of texts: stored as numbers of words, whose list is in NAME_words."""
UNITS = {name: column.unit for name, column in ScatteredBsdf.declared().items() if column.unit}
UNITS |= {"values_errors": "1/sr", "theta_deg": "deg", "phi_deg": "deg", "wavelengths_nm": "nm"}
TEXT = h5py.string_dtype()


def recognise(head: bytes) -> bool:
    """Whether a file that begins with `head` is an archive."""
    return head.startswith(HEADING.encode())


# ---- writing ----


def write(path: Path, content: BsdfFile) -> None:
    """Write a content with all of its parts, completely or not at all. Raises FormatError."""

    def fill(entry: h5py.Group) -> Iterator[None]:
        for k, part in enumerate(content.parts, 1):
            group = put_part(entry, f"part_{k}", part)
            if part.sample in content.of_samples:
                group["metadata"] = json.dumps(content.of_samples[part.sample].as_dict(), ensure_ascii=False)
            yield
        put_about(entry, content)

    write_entry(path, fill)


def write_entry(path: StrPath, fill: Callable[[h5py.Group], Iterator[None]]) -> None:
    """Write an archive whose group `entry` is filled by a function, which yields after each part of it.

    The file is written completely or not at all. Raises FormatError.
    """

    def fill_file(file: h5py.File) -> Iterator[None]:
        file.attrs.update({"NX_class": "NXroot", "default": "entry", "format": FORMAT, "version": VERSION})
        entry = file.create_group("entry")
        entry.attrs["NX_class"] = "NXentry"
        yield from fill(entry)

    check_writable(path)
    write_hdf5(path, HEADING, fill_file)


def put_about(entry: h5py.Group, content: BsdfFile) -> None:
    """Write metadata and comments of a content, and name the part that a viewer shows."""
    entry.attrs["simulated"] = content.simulated
    if content.metadata.title:
        entry["title"] = content.metadata.title
    if content.metadata.date:
        entry["start_time"] = content.metadata.date
    entry["metadata"] = json.dumps(content.metadata.as_dict(), ensure_ascii=False)
    put_texts(entry, "comments", content.comments)
    if content.parts:
        entry.attrs["default"] = "part_1"


def put_texts(group: h5py.Group, name: str, texts: Sequence[str]) -> None:
    """Write a list of texts (n,)."""
    safe = [each.replace("\0", "") for each in texts]
    group.create_dataset(name, data=np.array(safe, dtype=object), dtype=TEXT, shape=(len(safe),))


def put_array(group: h5py.Group, name: str, values: npt.NDArray[Any]) -> None:
    """Write an array, packed where it is large."""
    given = group.create_dataset(name, data=values, **(PACKED if values.size > LEAST_PACKED else {}))
    if name in UNITS:
        given.attrs["units"] = UNITS[name]


def put_part(entry: h5py.Group, name: str, part: Part) -> h5py.Group:
    """Write a part as a group of this name."""
    group = entry.create_group(name)
    group.attrs.update({"NX_class": "NXdata", "signal": "values", "sample": part.sample, "generated": part.generated})
    if isinstance(part, ScatteredBsdf):
        group.attrs.update({"kind": "scattered", "isotropic": part.isotropic, "axes": ["."]})
        for column in COLUMNS:
            stored = "values_errors" if column == "u" else column
            if column in WORDS:
                put_words(group, column, getattr(part, column))
            else:
                put_array(group, stored, getattr(part, column))
    else:
        regular = isinstance(part, RegularTable)
        angles = ("psi", "sigma") if regular else ("psi", "sigma", "phi", "theta")
        channel = "wavelengths_nm" if part.wavelengths_nm is not None else "colours" if part.colours else "."
        group.attrs.update({"kind": "regular" if regular else "table", "transmitted": part.transmitted, "back": part.back})
        group.attrs["axes"] = [channel, *(f"{each}_deg" for each in angles)]
        if part.wavelengths_nm is not None:
            put_array(group, "wavelengths_nm", np.array(part.wavelengths_nm))
        if part.colours:
            put_texts(group, "colours", part.colours)
        for each in angles:
            put_array(group, f"{each}_deg", np.asarray(getattr(part, f"{each}_deg"), dtype=np.float64))
        put_array(group, "values", part.values)
        if part.u is not None:
            put_array(group, "values_errors", part.u)
        if isinstance(part, BsdfTable) and part.known is not None:
            put_array(group, "known", part.known)
        if regular:
            for each in ("values", "values_errors"):
                if each in group:
                    group[each].attrs["units"] = "1"
    put_texts(group, "comments", part.comments)
    return group


def put_words(group: h5py.Group, name: str, texts: npt.NDArray[np.str_]) -> None:
    """Write texts (n,) as numbers (n,) of the words in NAME_words."""
    words, number = (texts[:1], np.zeros(texts.size)) if texts.size and (texts == texts[0]).all() else distinct(texts)
    put_texts(group, f"{name}_words", words.tolist())
    put_array(group, name, number.astype(np.int32))


def distinct(texts: npt.NDArray[np.str_]) -> tuple[npt.NDArray[np.str_], npt.NDArray[Any]]:
    """The different texts, and the number of each."""
    words, number = np.unique(texts, return_inverse=True)
    return words, number.ravel()


class Rows:
    """A dataset (n, columns) that grows in both: a part of the rows at a time, and columns with names as they are found."""

    def __init__(self, group: h5py.Group, name: str, kind: str, empty: float = 0.0) -> None:
        self._data = group.create_dataset(
            name, (0, 0), kind, maxshape=(None, None), chunks=(4096, 4), fillvalue=empty, **PACKED
        )
        self._columns: dict[Any, int] = {}

    def column(self, key: Any) -> int:
        """The place of a column, a new one for a new key."""
        return self._columns.setdefault(key, len(self._columns))

    @property
    def keys(self) -> list[Any]:
        """The keys of the columns, in their order."""
        return list(self._columns)

    def add(self, count: int, found: Mapping[Any, npt.NDArray[Any]]) -> None:
        """Add rows: a column (count,) by its key; the others are empty there."""
        places = {self.column(key): each for key, each in found.items()}
        begin = self._data.shape[0]
        self._data.resize((begin + count, len(self._columns)))
        if places:
            block = np.full((count, len(self._columns)), self._data.fillvalue, dtype=self._data.dtype)
            for place, each in places.items():
                block[:, place] = each
            self._data[begin:] = block


class Column:
    """A dataset (n,) that grows."""

    def __init__(self, group: h5py.Group, name: str, kind: Any) -> None:
        self._data = group.create_dataset(name, (0,), kind, maxshape=(None,), chunks=(16384,), **PACKED)
        if name in UNITS:
            self._data.attrs["units"] = UNITS[name]

    def add(self, values: npt.NDArray[Any]) -> None:
        """Add values (k,)."""
        begin = self._data.shape[0]
        self._data.resize((begin + len(values),))
        self._data[begin:] = values


# ---- reading ----


def read(path: StrPath) -> BsdfFile:
    """Read the parts of an archive, with metadata and comments.

    Raises FormatError for another kind of file, and for a file that changed after it was written.
    """
    with open_hdf5(path, HEADING, "an archive of goniotwin", COPY_AGAIN, MOST_BYTES) as file:
        return _ArchiveReader(path, file).content()


@dataclass
class _ArchiveReader:
    """Reads the parts of a file within bounds, checked before memory is taken: a few bytes of HDF5 can state any amount.

    All methods raise FormatError, and ValueError and what h5py raises for a file that has something else.
    """

    path: StrPath
    file: h5py.File
    texts_left: int = MOST_TEXTS
    characters_left: int = MOST_CHARACTERS

    def content(self) -> BsdfFile:
        """What the file holds."""
        path, attributes = self.path, self.file.attrs
        if attributes.get("format") != FORMAT:
            raise FormatError(path, "is not an archive of goniotwin", "give an archive that was written by goniotwin")
        if (version := int(attributes["version"])) != VERSION:
            wrong = f"is an archive of version {version}, not {VERSION}"
            raise FormatError(path, wrong, "read it with the program that wrote it")
        entry = self.file["entry"]
        names = [name for name in entry if re.fullmatch(r"part_[0-9]{1,6}", name)]
        if len(names) > MOST_PARTS:
            raise FormatError(path, f"has {len(names)} parts", "divide it into several files")
        names.sort(key=lambda name: int(name[5:]))
        size = sum(int(entry[name]["values"].size) for name in names)
        if size > MOST_VALUES:
            raise FormatError(path, f"has {size} values, more than {MOST_VALUES}", "divide it into several files")
        comments = self._texts(entry, "comments")
        metadata = metadata_from_dict(json.loads(self._texts(entry, "metadata")[0]))
        of_samples = {
            str(entry[name].attrs["sample"]): metadata_from_dict(json.loads(self._texts(entry[name], "metadata")[0]))
            for name in names
            if "metadata" in entry[name]
        }
        return BsdfFile(tuple(self._part(entry[name]) for name in names), metadata, comments, of_samples)

    def _part(self, group: h5py.Group) -> Part:
        kind, sample, generated = (group.attrs[name] for name in ("kind", "sample", "generated"))
        comments = self._texts(group, "comments")
        about: dict[str, Any] = {"sample": str(sample), "generated": bool(generated), "comments": comments}
        if kind == "scattered":
            absent = {column for column in INTERVAL_COLUMNS if column not in group}  # of an older archive
            columns: dict[str, Any] = {column: self._column(group, column) for column in COLUMNS if column not in absent}
            return ScatteredBsdf(**columns, isotropic=bool(group.attrs["isotropic"]), **about)
        if kind not in ("table", "regular"):
            wrong = f"has a part of the kind {quote_word(str(kind))}"
            raise FormatError(self.path, wrong, "read it with the program that wrote it")
        about |= {"transmitted": bool(group.attrs["transmitted"]), "back": bool(group.attrs["back"])}
        if "wavelengths_nm" in group:
            about["wavelengths_nm"] = tuple(_numbers(group, "wavelengths_nm").tolist())
        about |= {"colours": self._texts(group, "colours") if "colours" in group else ()}
        if "values_errors" in group:
            about["u"] = _numbers(group, "values_errors")
        if kind == "regular":
            psi = _numbers(group, "psi_deg")
            return RegularTable(_numbers(group, "sigma_deg"), _numbers(group, "values"), psi_deg=psi, **about)
        if "known" in group:
            about["known"] = _numbers(group, "known", "b").astype(bool)
        about |= {f"{each}_deg": _numbers(group, f"{each}_deg") for each in ("psi", "sigma", "phi", "theta")}
        return BsdfTable(values=_numbers(group, "values"), **about)

    def _column(self, group: h5py.Group, column: str) -> npt.NDArray[Any]:
        if column in WORDS:
            words = self._texts(group, f"{column}_words")
            number = _numbers(group, column, "i")
            if number.size and (number.min() < 0 or number.max() >= len(words)):
                raise ValueError(f"{column} has a number without a word")
            if 4 * max(map(len, words), default=0) * max(number.size, len(words)) > MOST_TEXT_BYTES:
                raise ValueError(f"{column} has a text that is too long among {number.size} values")
            return np.array(words, dtype=np.str_)[number] if words else np.full(number.size, "", dtype=np.str_)
        kind = "b" if column in ("transmitted", "back") else "i" if column == "photodiode" else "f"
        return _numbers(group, "values_errors" if column == "u" else column, kind)

    def _texts(self, group: h5py.Group, name: str) -> tuple[str, ...]:
        """A text, or a list of texts. Raises KeyError, TypeError, and FormatError where the file has too many."""
        data = group[name]
        self.texts_left -= data.size
        if self.texts_left < 0 or data.nbytes > MOST_CHARACTERS:
            raise FormatError(
                self.path, f"{group.name}/{name}: has too many texts ({data.size})", "divide it into several files"
            )
        if not data.shape:
            return (self._counted(str(data.asstr()[()])),)
        together = min(MOST_TOGETHER, max(LEAST_TOGETHER, MOST_CHARACTERS // self.file.id.get_filesize()))  # none is longer
        texts = data.asstr()
        found: list[str] = []
        for begin in range(0, data.shape[0], together):
            found += [self._counted(str(each)) for each in texts[begin : begin + together].ravel().tolist()]
        return tuple(found)

    def _counted(self, text: str) -> str:
        self.characters_left -= len(text)
        if self.characters_left < 0:
            raise FormatError(self.path, f"has texts of more than {MOST_CHARACTERS} characters", "divide it into several files")
        return text


def _numbers(group: h5py.Group, name: str, kind: str = "f") -> npt.NDArray[Any]:
    """An array of floats (f), whole numbers (i) or flags (b), which has no more of them than the part has values.

    Raises KeyError, and ValueError for another type or size.
    """
    data = group[name]
    if data.dtype.kind not in {"f": "f", "i": "iu", "b": "b"}[kind] or data.size > group["values"].size:
        raise ValueError(f"{group.name}/{name} has {data.dtype} {data.shape}")
    if data.size and not data.id.get_storage_size():
        raise ValueError(f"{group.name}/{name} has no values in the file")
    return np.asarray(data[()])
