"""A simulated disk with power loss: the recorded operations on its files, and the files that remain after a power loss.

Assumptions about the disk and its file system:
- what was written to a file, and its length, are certain once the file was synced; until then any of it may be on the disk or
  not, in blocks of 512 bytes, independently and in any order;
- powersafe overwrite, as SQLite assumes it (and the drives of this century have it): bytes beside those being written keep
  their values, so that a block that is written in part changes in that part only;
- creating, renaming and removing a file is certain once the folder was synced; until then the first of these operations, any
  number of them, are done and the rest are not.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

BLOCK = 512


@dataclass(frozen=True)
class Written:
    """Bytes written to a file."""

    file: int
    offset: int
    data: bytes


@dataclass(frozen=True)
class Resized:
    """A file set to a length."""

    file: int
    size: int


@dataclass(frozen=True)
class Synced:
    """A file synced: all earlier operations on it are certain."""

    file: int


@dataclass(frozen=True)
class Named:
    """A name given to a file in the folder; None removes the name."""

    name: str
    file: int | None


@dataclass(frozen=True)
class FolderSynced:
    """The folder synced: all names are certain."""


@dataclass(frozen=True)
class Acknowledged:
    """Not an operation of the disk: a row was reported as committed."""

    number: int
    digest: str


Change = Written | Resized
Operation = Change | Synced | Named | FolderSynced | Acknowledged


@dataclass
class _File:
    """Certain content of a file, and the changes that are not synced."""

    certain: bytearray = field(default_factory=bytearray)
    pending: list[Change] = field(default_factory=list)


def files_after_power_loss(operations: Iterable[Operation], rng: np.random.Generator | None) -> dict[str, bytes]:
    """The files by name, where the power is lost after these operations.

    Without `rng` only the certain content remains; with it also a random part of the rest, from none to all.
    """
    files: dict[int, _File] = {}
    names: dict[str, int] = {}
    name_changes: list[Named] = []
    for each in operations:
        if isinstance(each, Written | Resized):
            files.setdefault(each.file, _File()).pending.append(each)
        elif isinstance(each, Synced):
            file = files.setdefault(each.file, _File())
            for change in file.pending:
                _apply(file.certain, change)
            file.pending.clear()
        elif isinstance(each, Named):
            name_changes.append(each)
        elif isinstance(each, FolderSynced):
            _apply_names(names, name_changes)
            name_changes.clear()
    share = 0.0 if rng is None else float(rng.choice([0.0, 0.1, 0.5, 0.9, 1.0]))
    if rng is not None:
        _apply_names(names, name_changes[: int(rng.integers(len(name_changes) + 1))])
        for file in files.values():
            for change in _torn(file.pending, share, rng):
                _apply(file.certain, change)
    return {name: bytes(files.get(number, _File()).certain) for name, number in names.items()}


def _torn(changes: Iterable[Change], share: float, rng: np.random.Generator) -> Iterator[Change]:
    """A random share of the changes, block by block."""
    for change in changes:
        if isinstance(change, Resized):
            if rng.random() < share:
                yield change
            continue
        begin, end = change.offset, change.offset + len(change.data)
        cuts = [begin, *range(begin // BLOCK * BLOCK + BLOCK, end, BLOCK), end]
        for first, last in itertools.pairwise(cuts):
            if rng.random() < share:
                yield Written(change.file, first, change.data[first - begin : last - begin])


def _apply(content: bytearray, change: Change) -> None:
    if isinstance(change, Resized):
        del content[change.size :]
        content.extend(bytes(change.size - len(content)))
    else:
        content.extend(bytes(max(0, change.offset - len(content))))
        content[change.offset : change.offset + len(change.data)] = change.data


def _apply_names(names: dict[str, int], name_changes: Iterable[Named]) -> None:
    for each in name_changes:
        if each.file is None:
            names.pop(each.name, None)
        else:
            names[each.name] = each.file
