"""The specification of a sweep, with its digest, and the result of one of its chunks."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.errors import UserError
from goniotwin.app.sweeps.environment import Environment, environment
from goniotwin.linear_algebra import one_thread_in_linear_algebra

Arrays = dict[str, npt.NDArray[Any]]
"""The arrays of a chunk by name: numbers, flags or texts of a fixed length."""


@dataclass(frozen=True)
class Specification:
    """What a sweep computes, as data: a worker on another computer needs nothing else.

    `work` names the kind of the sweep and `version` the meaning of its arrays. A chunk has `size` items, which are numbered;
    the random numbers of an item are those of `seed` and its number. `content` is everything else in canonical JSON (see `of`),
    with the contents of files in place of their names. The number of chunks is not in it: a sweep can be extended.
    """

    work: str
    version: int
    size: int
    seed: int
    content: str

    @classmethod
    def of(cls, work: str, version: int, size: int, seed: int, content: Any) -> "Specification":
        """The specification with a content of dictionaries, lists, texts and numbers."""
        return cls(work, version, size, seed, json.dumps(content, sort_keys=True, separators=(",", ":")))

    @cached_property
    def digest(self) -> str:
        """SHA-256 of all fields."""
        return hashlib.sha256(json.dumps(asdict(self), sort_keys=True).encode()).hexdigest()

    @property
    def data(self) -> Any:
        """The content."""
        return json.loads(self.content)

    def items(self, chunk: int) -> range:
        """The numbers of the items of a chunk."""
        return range(self.size * chunk, self.size * (chunk + 1))

    def chunks(self, items: int) -> int:
        """The number of chunks that have the first `items` items."""
        return -(-items // self.size)


def write_specification(path: Path, specification: Specification) -> Path:
    """Write a specification to a file, for a process of this computer; its path."""
    path.write_text(json.dumps(asdict(specification)), encoding="utf-8")
    return path


def read_specification(path: Path) -> Specification:
    """A specification that was written by `write_specification`."""
    return Specification(**json.loads(path.read_text(encoding="utf-8")))


Work = Callable[[Specification, int], Arrays]
"""Gives the arrays of a chunk: a function of a module, which depends on its arguments alone. Raises UserError for none."""


@dataclass(frozen=True, eq=False)
class Computed:
    """A chunk with its arrays, or with the reason why it has none, and what computed it."""

    chunk: int
    arrays: Arrays
    environment: Environment
    failure: str = ""


def compute(work: Work, specification: Specification, chunk: int) -> Computed:
    """Compute a chunk; every runner does it by this function. A failure of the chunk is a part of the result."""
    try:
        with one_thread_in_linear_algebra():
            arrays = {name: np.asarray(each, order="C") for name, each in work(specification, chunk).items()}
    except UserError as error:
        return Computed(chunk, {}, environment(), str(error) or "failed")
    return Computed(chunk, arrays, environment())
