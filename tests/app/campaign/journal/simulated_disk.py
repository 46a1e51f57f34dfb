"""A disk whose power may go: what was done to its files, in order, and what is on it if it ends there.

Assumed of the disk and its file system, no more:
- what was written to a file, and its length, are there for certain once the file has been synced; until then any of it may be
  there or not, in pieces of 512 bytes, each on its own and in any order;
- powersafe overwrite, as SQLite assumes it (and the drives of this century have it): bytes beside those being written stay
  as they were, so that of a piece that is written in part nothing but that part changes;
- what was created, renamed and removed in a folder is there for certain once the folder has been synced; until then the
  first so many of these are there and the rest is not.
"""

import itertools
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

PIECE = 512


@dataclass(frozen=True)
class Written:
    """Bytes into a file."""

    file: int
    offset: int
    data: bytes


@dataclass(frozen=True)
class Resized:
    """A file to a length."""

    file: int
    size: int


@dataclass(frozen=True)
class Synced:
    """A file: all that was done to it before."""

    file: int


@dataclass(frozen=True)
class Named:
    """A file in the folder; None takes the name away."""

    name: str
    file: int | None


@dataclass(frozen=True)
class Renamed:
    """A file in the folder, at once."""

    name: str
    to: str


@dataclass(frozen=True)
class FolderSynced:
    """All names."""


@dataclass(frozen=True)
class Told:
    """No doing of the disk: a row was said to be on it."""

    number: int
    digest: str


Change = Written | Resized
Naming = Named | Renamed
Doing = Change | Synced | Naming | FolderSynced | Told


@dataclass
class _File:
    """What is on the disk for certain, and what was done since."""

    certain: bytearray = field(default_factory=bytearray)
    since: list[Change] = field(default_factory=list)


def after_the_power_came_back(doings: Iterable[Doing], lots: np.random.Generator | None) -> dict[str, bytes]:
    """The files by their names where the power went after these doings.

    Without lots nothing is there but what is for certain; with them a part of the rest, from none of it to all.
    """
    files: dict[int, _File] = {}
    names: dict[str, int] = {}
    naming: list[Naming] = []
    for each in doings:
        if isinstance(each, Written | Resized):
            files.setdefault(each.file, _File()).since.append(each)
        elif isinstance(each, Synced):
            file = files.setdefault(each.file, _File())
            for change in file.since:
                _carry_out(file.certain, change)
            file.since.clear()
        elif isinstance(each, Named | Renamed):
            naming.append(each)
        elif isinstance(each, FolderSynced):
            _rename(names, naming)
            naming.clear()
    share = 0.0 if lots is None else float(lots.choice([0.0, 0.1, 0.5, 0.9, 1.0]))
    if lots is not None:
        _rename(names, naming[: int(lots.integers(len(naming) + 1))])
        for file in files.values():
            for change in _torn(file.since, share, lots):
                _carry_out(file.certain, change)
    return {name: bytes(files.get(number, _File()).certain) for name, number in names.items()}


def _torn(changes: Iterable[Change], share: float, lots: np.random.Generator) -> Iterator[Change]:
    """A share of them by lot, each piece on its own."""
    for change in changes:
        if isinstance(change, Resized):
            if lots.random() < share:
                yield change
            continue
        begin, end = change.offset, change.offset + len(change.data)
        cuts = [begin, *range(begin // PIECE * PIECE + PIECE, end, PIECE), end]
        for first, last in itertools.pairwise(cuts):
            if lots.random() < share:
                yield Written(change.file, first, change.data[first - begin : last - begin])


def _carry_out(content: bytearray, change: Change) -> None:
    if isinstance(change, Resized):
        del content[change.size :]
        content.extend(bytes(change.size - len(content)))
    else:
        content.extend(bytes(max(0, change.offset - len(content))))
        content[change.offset : change.offset + len(change.data)] = change.data


def _rename(names: dict[str, int], naming: Iterable[Naming]) -> None:
    for each in naming:
        if isinstance(each, Renamed):
            names[each.to] = names.pop(each.name)
        elif each.file is None:
            names.pop(each.name, None)
        else:
            names[each.name] = each.file
