"""HDF5 after one line of text, which has the SHA-256 of the HDF5 content: archives and raysets.

The HDF5 library ends in a segmentation fault on a damaged file, and on one that it cannot write (docs/decisions/0050). So the
checksum is compared before it reads, and it writes to a file whose writes do not fail.
"""

import hashlib
import io
import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any, cast

import h5py

from goniotwin.app.formats.file import FormatError, StrPath, name_file, open_file, replace_file

BLOCK = 512
"""Bytes of the user block: the HDF5 library looks for its signature after it."""
PAGE = 1 << 16


def write_hdf5(path: StrPath, heading: str, fill: Callable[[h5py.File], Iterable[None]]) -> None:
    """Write a file completely or not at all; its first line is `heading` and the checksum.

    `fill` writes the content, and yields after each part of it: on a full disk that part, at most, is in memory. Raises
    FormatError.
    """
    with replace_file(path) as out:
        unfailing = _UnfailingFile(cast(io.FileIO, out.raw))
        with h5py.File(unfailing, "w", userblock_size=BLOCK) as file:
            for _ in fill(file):
                unfailing.check()
        unfailing.check()
        out.seek(BLOCK)
        line = f"{heading}{hashlib.file_digest(out, 'sha256').hexdigest()}\n".encode()
        out.seek(0)
        out.write(line.ljust(BLOCK - 1) + b"\n")


@contextmanager
def open_hdf5(path: StrPath, heading: str, what: str, remedy: str, most_bytes: int) -> Iterator[h5py.File]:
    """Open a file that `write_hdf5` wrote; `what` it is, such as "a rayset", and the remedy for a damaged one, for messages.

    Raises FormatError for another kind of file, for one that changed after it was written, and where it cannot be read.
    """
    with open_file(path, most_bytes) as content:
        line = re.fullmatch(re.escape(heading).encode() + rb"([0-9a-f]{64})\n *\n", content.read(BLOCK))
        if line is None:
            raise FormatError(path, f"is not {what}", "give one that was written by goniotwin")
        if hashlib.file_digest(content, "sha256").hexdigest().encode() != line[1]:
            raise FormatError(path, "is damaged: its content does not match the sha256 in its first line", remedy)
        try:
            with name_file(path, remedy), h5py.File(content, "r") as file:
                yield file
        except (OSError, KeyError, RuntimeError, TypeError, AttributeError) as error:
            raise FormatError(path, f"cannot be read as {what}", remedy) from error


class _UnfailingFile(io.RawIOBase):
    """A file of which the HDF5 library sees no write fail: from the first that does, what is written stays in memory."""

    def __init__(self, file: io.FileIO) -> None:
        self._file = file
        self._error: OSError | None = None
        self._at = 0
        self._size = 0
        self._kept: dict[int, bytearray] = {}
        """Pages of `PAGE` bytes by their number, as they would be in the file."""

    def check(self) -> None:
        """Raise the OSError of the first write that failed."""
        if self._error is not None:
            raise self._error

    def readable(self) -> bool:
        return True

    def writable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        self._at = offset + {io.SEEK_SET: 0, io.SEEK_CUR: self._at, io.SEEK_END: self._size}[whence]
        return self._at

    def truncate(self, size: int | None = None, /) -> int:
        self._size = self._at if size is None else size
        try:
            self.check()
            self._file.truncate(self._size)
        except OSError as error:
            self._error = self._error or error
        return self._size

    def write(self, data: Any, /) -> int:
        view = memoryview(data).cast("B")
        done = 0
        try:
            self.check()
            self._file.seek(self._at)
            while done < len(view):
                done += self._file.write(view[done:]) or 0
        except OSError as error:
            self._error = self._error or error
            for page, within, piece in self._pieces(done, len(view)):
                page[within] = view[piece]
        self._at += len(view)
        self._size = max(self._size, self._at)
        return len(view)

    def readinto(self, buffer: Any, /) -> int:
        view = memoryview(buffer).cast("B")
        size = max(0, min(len(view), self._size - self._at))
        if self._error is None:
            self._file.seek(self._at)
            size = self._file.readinto(view[:size]) or 0
        else:
            for page, within, piece in self._pieces(0, size):
                view[piece] = page[within]
        self._at += size
        return size

    def _pieces(self, begin: int, end: int) -> Iterator[tuple[bytearray, slice, slice]]:
        """The pages from `begin` to `end` after this place, the part of each, and where that part is from this place on."""
        while begin < end:
            number, first = divmod(self._at + begin, PAGE)
            size = min(PAGE - first, end - begin)
            if number not in self._kept:
                self._file.seek(number * PAGE)
                self._kept[number] = bytearray((self._file.read(PAGE) or b"").ljust(PAGE, b"\0"))
            yield self._kept[number], slice(first, first + size), slice(begin, begin + size)
            begin += size
