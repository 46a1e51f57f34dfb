"""Files: reading, atomic writing, and the error of this package."""

import contextlib
import errno
import os
import re
import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from io import BufferedRandom, BufferedReader
from pathlib import Path

from goniotwin.app.errors import UserError, one_line, room_on_disk, unusable

StrPath = str | os.PathLike[str]
LONGEST_WORD = 40
MOST_BYTES = 100_000_000
"""Of a file that is read as a whole: parsed, it may take several times as much."""
SQLITE = b"SQLite format 3\0"
BEGINNINGS = {
    SQLITE: "a data file (journal) or another database",
    b"\x89HDF\r\n\x1a\n": "HDF5",
    b"\x89PNG": "a picture (PNG)",
    b"\xff\xd8\xff": "a picture (JPEG)",
    b"%PDF": "a PDF",
    b"PK\x03\x04": "a ZIP archive, or a file of an office program",
    b"\x1f\x8b": "compressed (gzip)",
    b"\xd0\xcf\x11\xe0": "a file of an office program",
    b"OPTIS": "a file of Ansys Speos",
    b"<?xml": "XML",
    b"<!DOCTYPE": "a page of the web (HTML)",
    b"<html": "a page of the web (HTML)",
    b"version https://git-lfs": "a pointer to a file that was not fetched (Git LFS)",
    b"tensor_file": "a file of tensors",
}
"""What a file is, by its first bytes, for the message that refuses it."""
BESIDE_DATABASE = re.compile("-(wal|shm|journal)$")
NO_LINKS = frozenset({errno.EPERM, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS})
"""What a disk without hard links answers, as those of memory sticks."""


class FormatError(UserError, ValueError):
    """A file that cannot be read or written.

    The message is one printable line: the file, the line in it where known, what is wrong and what to do.
    """

    def __init__(self, path: StrPath, wrong: str, remedy: str, line: int | None = None) -> None:
        super().__init__(path, wrong, remedy, line)
        self.path = os.fspath(path)
        self.wrong = wrong
        self.remedy = remedy
        self.line = line

    def __str__(self) -> str:
        where = self.path if self.line is None else f"{self.path}, line {self.line}"
        return one_line(f"{where}: {self.wrong}; {self.remedy}")


def quote_word(word: str) -> str:
    """A word of a file, quoted for a message: at most `LONGEST_WORD` characters, in ASCII, without terminal control codes."""
    return ascii(word if len(word) <= LONGEST_WORD else word[:LONGEST_WORD] + "...")


def begins_as(head: bytes) -> str | None:
    """In words, what a file that begins with `head` is by its first bytes alone."""
    return next((what for first, what in BEGINNINGS.items() if head.startswith(first)), None)


def describe(head: bytes) -> str:
    """In words, what a file that begins with `head` is."""
    found = begins_as(head)
    if found is not None or not head.strip():
        return found or "empty"
    if b"\0" in head:
        return "binary data"
    text = head.decode("utf-8", "replace").strip().splitlines()[0].strip()
    return f"text that begins with {quote_word(text)}"


@contextlib.contextmanager
def name_file(path: StrPath, remedy: str = "correct the file") -> Iterator[None]:
    """Raise a ValueError about the values of a file as FormatError, which names the file."""
    try:
        yield
    except FormatError:
        raise
    except ValueError as error:
        raise FormatError(path, str(error), remedy) from error


def _file_at(path: StrPath) -> Path:
    """The file behind all links, which need not exist. Raises FormatError for an impossible name, a folder or a device."""
    try:
        with contextlib.suppress(OSError):
            Path(path).stat()
        file = Path(os.path.realpath(path))
    except ValueError as error:
        raise FormatError(path, "is not a possible file name", "check the name") from error
    try:
        if file.exists() and not file.is_file():
            raise FormatError(path, "is a folder or a device, not a file", "give the name of a file")
    except OSError as error:  # a name that is too long, a folder that this user cannot enter
        raise FormatError(path, f"cannot be reached ({error.strerror})", "check the name and the permissions") from error
    return file


@contextlib.contextmanager
def open_file(path: StrPath, most: int | None = None) -> Iterator[BufferedReader]:
    """Open a file for reading.

    Raises FormatError if it has more bytes than `most`, is absent, not a regular file, or unreadable.
    """
    try:
        if not Path(path).exists():
            raise FormatError(path, "there is no such file", "check the name and the folder")
        with _file_at(path).open("rb") as content:
            if most is not None and os.fstat(content.fileno()).st_size > most:
                raise FormatError(path, f"has more than {most} bytes", "check the name, or divide it into several files")
            yield content
    except OSError as error:
        raise FormatError(path, f"cannot be read ({error.strerror})", "check the name and the permissions") from error


def read_head(path: StrPath, size: int) -> bytes:
    """The first bytes of a file, at most `size`. Raises FormatError as `open_file` does."""
    with open_file(path) as content:
        return content.read(size)


def read_file(path: StrPath, most: int = MOST_BYTES) -> bytes:
    """The bytes of a file. Raises FormatError as `open_file` does."""
    with open_file(path, most) as content:
        return content.read(os.fstat(content.fileno()).st_size)


@dataclass(frozen=True)
class Replaceable:
    """The only files that are overwritten: those of which `is_one` holds, by their content; `words` name such a file."""

    words: str
    is_one: Callable[[bytes], bool]


def check_writable(path: StrPath, replaceable: Replaceable | None = None) -> None:
    """Check that `write_file` can write to `path`, so that a long computation does not end without its result.

    Raises FormatError if the name, the folder or its permissions do not permit it, or if the file is a database such as a
    journal, or any other than a `replaceable` one. The file is not touched.
    """
    try:
        file = _file_at(path)
        _refuse_database(path, file)
        _refuse_other(path, file, replaceable)
        if not file.parent.is_dir():
            raise FormatError(path, f"there is no folder {file.parent}", "make it first")
        with tempfile.TemporaryFile(dir=file.parent):
            pass
    except OSError as error:
        wrong = f"the folder {file.parent} cannot be written to ({error.strerror})"
        raise FormatError(path, wrong, room_on_disk(error) or "check its permissions") from error


def make_folder(folder: Path) -> None:
    """Make a folder in which files can be written. Raises UserError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise unusable(folder, "cannot be written", error, "choose another folder") from None


def write_file(path: StrPath, content: bytes | Iterable[bytes], replaceable: Replaceable | None = None) -> None:
    """Write a file atomically, see `replace_file`. A large content may be an iterable of parts. Raises FormatError."""
    with replace_file(path, replaceable) as out:
        for part in [content] if isinstance(content, bytes) else content:
            out.write(part)


@contextlib.contextmanager
def replace_file(path: StrPath, replaceable: Replaceable | None = None) -> Iterator[BufferedRandom]:
    """A file to write: under another name in the same folder, and at the end synced to the disk and renamed to `path`.

    Raises FormatError if the file cannot be written, is a database such as a journal, or any other than a `replaceable` one.
    After any error no file is left, and an earlier file at `path` is unchanged.
    """
    spare = None
    try:
        file = _file_at(path)  # a link stays a link
        _refuse_database(path, file)
        _refuse_other(path, file, replaceable)
        spare = file.parent / f".{os.getpid()}-{threading.get_ident()}.tmp"
        with spare.open("w+b") as out:
            yield out
            out.flush()
            os.fsync(out.fileno())
        spare.replace(file)
        sync_folder(file.parent)
    except OSError as error:
        raise _unwritable(path, error) from error
    finally:
        if spare is not None:
            with contextlib.suppress(OSError):  # after the renaming there is nothing left to remove
                spare.unlink(missing_ok=True)


@contextlib.contextmanager
def replace_files(*paths: Path) -> Iterator[tuple[Path, ...]]:
    """Names under which files are written that belong together; at the end each is renamed to its path, and a path whose name
    was not written is removed.

    After any error the files at `paths` are unchanged. A FormatError about one of the names is about the first path.
    """
    file = Path(os.path.realpath(paths[0]))
    spares: dict[Path, Path] = {}
    try:
        with tempfile.TemporaryDirectory(dir=file.parent, prefix=".", suffix=".tmp") as folder:
            spares = {Path(folder) / path.name: path for path in paths}
            yield tuple(spares)
            for spare, path in spares.items():
                if spare.exists():
                    spare.replace(os.path.realpath(path))
                else:
                    path.unlink(missing_ok=True)
        sync_folder(file.parent)
    except FormatError as error:
        about = paths[0] if Path(error.path) in spares else error.path
        raise FormatError(about, error.wrong, error.remedy, error.line) from None
    except OSError as error:
        raise _unwritable(paths[0], error) from error


def _unwritable(path: StrPath, error: OSError) -> FormatError:
    wrong = f"cannot be written ({error.strerror or error})"
    return FormatError(path, wrong, room_on_disk(error) or "check the folder and its permissions")


def _refuse_database(path: StrPath, file: Path) -> None:
    owner = file.with_name(BESIDE_DATABASE.sub("", file.name) or file.name)
    if any(each.exists() and read_head(each, len(SQLITE)) == SQLITE for each in (file, owner)):
        wrong = "is a data file (journal) or another database, or belongs to one, and is not overwritten"
        raise FormatError(path, wrong, "choose another name")


def _refuse_other(path: StrPath, file: Path, replaceable: Replaceable | None) -> None:
    if replaceable is not None and file.exists() and not replaceable.is_one(read_file(file)):
        raise FormatError(path, f"exists, is not {replaceable.words}, and is not overwritten", "choose another name")


def name_new_file(spare: Path, path: Path) -> None:
    """Rename a file to a name that no other file has. Raises FileExistsError where one has it, OSError."""
    if os.name == "nt":  # which overwrites nothing
        spare.rename(path)
        return
    try:
        path.hardlink_to(spare)
    except OSError as error:
        if error.errno not in NO_LINKS:
            raise
        if os.path.lexists(path):
            raise FileExistsError(errno.EEXIST, os.strerror(errno.EEXIST), str(path)) from None
        spare.rename(path)
    else:
        spare.unlink()


def sync_folder(folder: Path) -> None:
    # Windows cannot open a folder, and some network disks cannot sync one; the file itself is on the disk by now.
    with contextlib.suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)
