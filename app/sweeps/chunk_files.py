"""The files of a sweep: a folder with its specification, and a file for each finished chunk, which is complete or not there.

A file is a NumPy archive, which `numpy.load` reads: `about` is a text in JSON with the digest of the specification, the number
of the chunk and what computed it; the other arrays are those of the chunk. The comment of the archive is the SHA-256 of all
bytes before it.
"""

import contextlib
import hashlib
import io
import json
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.errors import UserError, unusable
from goniotwin.app.formats.file import write_file
from goniotwin.app.rig.lock import LockFile
from goniotwin.app.sweeps.environment import Environment
from goniotwin.app.sweeps.specification import Computed, Specification

ABOUT, LOCK = "sweep.json", "sweep.lock"
LAYOUT = 1
"""Version of the files."""
OWN = (".lock", ".holder", ".tmp")
"""Suffixes of the lock, of the note of its holder, and of a file that is being written."""
DIGITS = 64
"""Length of a SHA-256 in hexadecimal digits."""
Note = Callable[[str], None]
"""Receives a line for the user."""


@dataclass(frozen=True)
class ChunkFiles:
    """The folder of a sweep; `option` of the command names it, and `of` is what makes another sweep, both for messages."""

    folder: Path
    specification: Specification
    option: str
    of: str
    note: Note = field(default=lambda _: None, compare=False)

    @contextlib.contextmanager
    def opened(self) -> Iterator[None]:
        """Make the folder if it is not there, and lock it. Raises UserError for that of another sweep, and for one in use."""
        self._check()
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not (self.folder / ABOUT).exists() and self._has_files():
                self._refuse_other()
            lock = LockFile(self.folder / LOCK, str(self.folder), self.specification.work, 0o644)
        except OSError as error:
            raise self._unusable(error) from None
        try:
            self._prepare()
            yield
        finally:
            lock.release(remove=True)

    def path(self, chunk: int) -> Path:
        """The file of a chunk."""
        return self.folder / f"chunk-{chunk:06d}.npz"

    def write(self, computed: Computed) -> None:
        """Write a finished chunk: completely, or not at all. Raises UserError."""
        write_file(self.path(computed.chunk), pack(computed, self.specification.digest))

    def read(self, chunk: int) -> Computed | None:
        """A finished chunk; None where there is none, and, with a note, for a file that is damaged or of another sweep."""
        path = self.path(chunk)
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise unusable(path, "cannot be read", error, "check its permissions") from None
        if content[-DIGITS:] != _digest(content[:-DIGITS]):
            self.note(f"{path}: is damaged; chunk {chunk} is computed again")
            return None
        digest, computed = unpack(content)
        if (digest, computed.chunk) != (self.specification.digest, chunk):
            self.note(f"{path}: is of another sweep, or another chunk; chunk {chunk} is computed again")
            return None
        return computed

    def _prepare(self) -> None:
        """Write the specification into a new folder, and remove what a killed program has left. The folder is locked."""
        self._check()
        try:
            if not (self.folder / ABOUT).exists():
                if self._has_files():
                    self._refuse_other()
                write_file(self.folder / ABOUT, json.dumps(self._about(), indent=1).encode())
            for each in self.folder.glob(".*.tmp"):
                each.unlink(missing_ok=True)
        except OSError as error:
            raise self._unusable(error) from None

    def _check(self) -> None:
        """Raise UserError for a folder of another sweep, and for what is no folder."""
        path = self.folder / ABOUT
        try:
            if self.folder.exists() and not self.folder.is_dir():
                raise UserError(f"{self.folder}: is a file; choose another folder with {self.option}")
            about = json.loads(path.read_bytes()) if path.exists() else self._about()
            known = about["layout"], about["digest"]
        except OSError as error:
            raise self._unusable(error) from None
        except (ValueError, KeyError, TypeError):
            raise UserError(f"{path}: is damaged; delete the folder, or choose another one with {self.option}") from None
        if known != (LAYOUT, self.specification.digest):
            wrong = f"{self.folder}: has results of another {self.of}"
            raise UserError(f"{wrong}; choose another folder with {self.option}, or delete this one")

    def _about(self) -> dict[str, Any]:
        return {"layout": LAYOUT, "digest": self.specification.digest, **asdict(self.specification)}

    def _has_files(self) -> bool:
        return any(each.suffix not in OWN for each in self.folder.iterdir())

    def _refuse_other(self) -> None:
        wrong = f"{self.folder}: is not empty, and no folder of a {self.specification.work}"
        raise UserError(f"{wrong}; choose another one with {self.option}")

    def _unusable(self, error: OSError) -> UserError:
        return unusable(self.folder, "cannot be used", error, f"choose another folder with {self.option}")


def pack(computed: Computed, digest: str) -> bytes:
    """The bytes of a chunk's file: the same for the same arrays and environment."""
    made = {"specification": digest, "chunk": computed.chunk, "computed with": computed.environment.as_dict()}
    about = json.dumps(made, sort_keys=True)
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        archive.comment = b"0" * DIGITS
        for name, array in {"about": np.array(about), **computed.arrays}.items():
            with archive.open(zipfile.ZipInfo(f"{name}.npy"), "w", force_zip64=True) as member:
                np.lib.format.write_array(member, array, allow_pickle=False)
    bare = content.getvalue()[:-DIGITS]
    return bare + _digest(bare)


def unpack(content: bytes) -> tuple[str, Computed]:
    """The digest of the specification and the chunk of a file."""
    with np.load(io.BytesIO(content), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    about = json.loads(str(arrays.pop("about")))
    return str(about["specification"]), Computed(int(about["chunk"]), arrays, Environment(**about["computed with"]))


def _digest(content: bytes) -> bytes:
    return hashlib.sha256(content).hexdigest().encode()
