"""Files on a disk that is too small for them: what becomes of each format, and of every other file that a command writes.

The disk is a small tmpfs, where mounting is permitted, or a limit of the size of a file, which acts as a full disk.
"""

import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from goniotwin.app.formats import BsdfTable, archive, registry
from goniotwin.app.formats.content import BsdfFile, RegularTable
from goniotwin.app.formats.registry import Holds
from tests.conftest import REPOSITORY
from tests.system.command_process import CommandProcess, Limits

JOURNAL = REPOSITORY / "tests" / "golden" / "data" / "finished.journal"
PAGE = 4096
"""Bytes: what a tmpfs has is a whole number of these."""


@dataclass(frozen=True)
class Writing:
    """A command that writes a file; `out` is its name."""

    name: str
    arguments: tuple[object, ...]
    out: str

    def run(self, folder: Path, logs: Path, limits: Limits | None = None) -> tuple[int, list[str]]:
        """Run the command, with its file in a folder. Its exit status, and the errors that it prints."""
        arguments = [folder / self.out if each == self.out else each for each in self.arguments]
        process = CommandProcess(logs, *arguments, limits=limits)
        status = process.wait()
        return status, [line for line in process.errors.splitlines() if line.startswith(("goniotwin: ", "Traceback"))]


@dataclass(frozen=True)
class Outcome:
    """What became of a file on a disk of so many bytes."""

    writing: str
    size: int
    status: int
    lines: tuple[str, ...]
    left: tuple[str, ...]

    @property
    def fault(self) -> str:
        """What is wrong with it; empty for a file that is there, and for one that is not, with status 2 and one line why."""
        if self.status == 0:
            return "" if self.left else "no file, and status 0"
        if self.status != 2:
            return f"status {self.status}: {' '.join(self.lines)}"
        if self.left:
            return f"left over: {', '.join(self.left)}"
        proper = len(self.lines) == 1 and "; " in self.lines[0] and "unexpected error" not in self.lines[0]
        return "" if proper else f"not one line with a remedy: {' '.join(self.lines)}"


def writings(folder: Path) -> list[Writing]:
    """Commands that write a file in each format that can be written, and the other files of data that a person asks for.

    Their sources are made in the folder.
    """
    coarse, sources = folder / "coarse.h5", {name: folder / f"{name}.h5" for name in (Holds.REFLECTED, Holds.TRANSMITTED)}
    archive.write(coarse, BsdfFile((_table(7, transmitted=False),)))
    for light, source in sources.items():
        table = _table(91, transmitted=light == Holds.TRANSMITTED)
        of_angle = table.values.ravel()[:900].reshape(1, 1, 900)
        regular = RegularTable(np.linspace(0.0, 90.0, 900), of_angle, (550.0,), transmitted=table.transmitted)
        archive.write(source, BsdfFile((table, regular)))
    found = []
    for each in registry.writers():
        out = f"out{each.suffixes[0]}"
        if Holds.RAYS in each.holds:
            maps = "simulate", "illumination", "--out", folder / "maps.csv", "--error", 0.5, "--rays", 1000
            found.append(Writing(each.name, (*maps, "--rayset", out), out))
        else:
            light = Holds.REFLECTED if Holds.REFLECTED in each.holds else Holds.TRANSMITTED
            source = coarse if each.resamples else sources[light]
            found.append(Writing(each.name, ("convert", source, out, "--format", each.name), out))
    found += [
        Writing("csv of a journal", ("export", JOURNAL, "--out", "out.csv"), "out.csv"),
        Writing("archive of a journal", ("export", JOURNAL, "--out", "out.h5"), "out.h5"),
        Writing("copy of a journal", ("copy", JOURNAL, "out.journal"), "out.journal"),
        Writing("picture (png)", ("plot", JOURNAL, "--out", "out.png"), "out.png"),
        Writing("picture (svg)", ("plot", JOURNAL, "--out", "out.svg"), "out.svg"),
        Writing("comparison", ("compare", JOURNAL, "theory", "--out", "out.png"), "out.png"),
        Writing("report", ("report", JOURNAL, "--out", "out.html"), "out.html"),
        Writing(
            "points of a simulation",
            ("simulate", "sample", "--sample", "lambertian:reflectance=0.9", "--out", "out.csv", "--rays", 64),
            "out.csv",
        ),
        Writing("schema", ("schema", "rig", "--out", "out.json"), "out.json"),
    ]
    return found


def _table(thetas: int, *, transmitted: bool) -> BsdfTable:
    grid = np.linspace(0.0, 90.0, 10), np.linspace(0.0, 180.0, 13), np.linspace(0.0, 180.0, thetas)
    values = np.random.default_rng(1).uniform(0.1, 1.0, (1, 1, 10, 13, thetas))
    return BsdfTable(*grid, values, (550.0,), u=0.01 * values, transmitted=transmitted)


def bytes_needed(writing: Writing, folder: Path, logs: Path) -> int:
    """The bytes of the files that a command leaves in an empty folder, which is emptied again."""
    status, lines = writing.run(folder, logs)
    assert status == 0, lines
    return sum(len(content) for content in _emptied(folder).values())


def with_a_limit(writing: Writing, size: int, folder: Path, logs: Path) -> Outcome:
    """The outcome where no file may have more bytes."""
    status, lines = writing.run(folder, logs, Limits(file_bytes=size))
    return Outcome(writing.name, size, status, tuple(lines), tuple(_emptied(folder)))


def on_a_disk(writing: Writing, size: int, disk: Callable[[int], Path], logs: Path) -> Outcome:
    """The outcome on a disk of so many bytes, which `disk` mounts."""
    place = disk(size)
    status, lines = writing.run(place, logs)
    return Outcome(writing.name, size, status, tuple(lines), tuple(_emptied(place)))


@contextmanager
def small_disks(place: Path) -> Iterator[Callable[[int], Path] | None]:
    """A function that mounts an empty disk of a number of bytes at a place; None where mounting is not permitted."""

    def mount(size: int) -> Path:
        unmount()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size}", "none", str(place)], capture_output=True, check=True)
        return place

    def unmount() -> None:
        if place.is_mount():
            subprocess.run(["umount", str(place)], check=True)

    try:
        mount(PAGE)
    except (subprocess.CalledProcessError, OSError):
        yield None
        return
    try:
        yield mount
    finally:
        unmount()


def sizes_of_disks(needed: int, count: int) -> list[int]:
    """Up to so many sizes, in bytes, from one page to a little more than twice what the files need."""
    most = 2 + round(2.2 * needed / PAGE)
    return [int(pages) * PAGE for pages in np.unique(np.linspace(1, most, count).astype(int))]


HEADING = "| file | sizes, bytes | status 2, one line, no file | status 0 | anything else |\n|---|---|---|---|---|"
"""Of the table of files, sizes and status."""


def as_row(outcomes: list[Outcome]) -> str:
    """The outcomes of one file as a row of the table."""
    refused, written = ([each.size for each in outcomes if not each.fault and each.status == status] for status in (2, 0))
    faults = [f"{each.size}: {each.fault}" for each in outcomes if each.fault]
    spans = [f"{len(some)} ({min(some)} to {max(some)})" if some else "0" for some in (refused, written)]
    about = f"{len(outcomes)}, {min(each.size for each in outcomes)} to {max(each.size for each in outcomes)}"
    return f"| {outcomes[0].writing} | {about} | {' | '.join(spans)} | {'; '.join(faults) or 'none'} |"


def _emptied(folder: Path) -> dict[str, bytes]:
    """The files of a folder, which are removed."""
    found = {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}
    for name in found:
        (folder / name).unlink()
    return found
