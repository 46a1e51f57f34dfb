"""What computes a chunk: versions and processor. Results of different ones differ in their last digits, or in their meaning."""

import hashlib
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cache
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

import llvmlite.binding
import numba
import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.linear_algebra import libraries

PARTS = ("app", "drivers", "mocks", "protocols", "twin")
FEATURES = ("avx512f", "avx2", "fma", "sve", "neon")
"""Features of a processor by which compiled sums round otherwise."""


@dataclass(frozen=True)
class Environment:
    """Versions of the project (with a digest of its sources), numpy, its linear algebra, numba and Python; the processor."""

    goniotwin: str
    numpy: str
    linear_algebra: str
    numba: str
    python: str
    processor: str

    def as_dict(self) -> dict[str, str]:
        """The environment for a file."""
        return asdict(self)

    def difference(self, other: "Environment") -> str:
        """What the other one has instead, in words; empty for the same."""
        names = [each.name for each in fields(self) if getattr(self, each.name) != getattr(other, each.name)]
        return ", ".join(f"{name} {getattr(self, name)} against {getattr(other, name)}" for name in names)


@cache
def environment(parts: tuple[str, ...] = PARTS, compiled_for: tuple[str, ...] | None = None) -> Environment:
    """The environment of this process, by the sources of these parts of the project.

    `compiled_for` has the name and the features of another processor than this one that numba compiles for, if it is given;
    else numba's settings have.
    """
    if compiled_for is None:
        compiled_for = tuple(each for each in (numba.config.CPU_NAME, numba.config.CPU_FEATURES) if each)
    return Environment(
        f"{version('goniotwin')} ({_digest_of_sources(parts)})",
        np.__version__,
        _linear_algebra(),
        numba.__version__,
        platform.python_version(),
        _processor(compiled_for),
    )


def _linear_algebra() -> str:
    """Name, version and kind of processor of the library that numpy has loaded."""
    known = [each for each in libraries().info() if each["user_api"] == "blas"]
    own = [each for each in known if "numpy" in each["filepath"]] or known
    return ", ".join(
        sorted({f"{each['internal_api']} {each['version']} {each.get('architecture', '')}".strip() for each in own})
    )


def _processor(compiled_for: tuple[str, ...]) -> str:
    """Name and features of the processor, and another one for which the kernels are compiled by the user's choice."""
    given = llvmlite.binding.get_host_cpu_features().flatten().split(",")
    known = [each for each in FEATURES if f"+{each}" in given]
    chosen = ["compiled for", *compiled_for] if compiled_for else []
    return " ".join([platform.machine(), llvmlite.binding.get_host_cpu_name(), *known, *chosen])


def _digest_of_sources(parts: tuple[str, ...]) -> str:
    """Twelve digits of the SHA-256 of all sources: two working copies can have one version."""
    digest = hashlib.sha256()
    for part in parts:
        spec = find_spec(f"goniotwin.{part}")
        for place in (spec.submodule_search_locations or ()) if spec is not None else ():
            for path in sorted(Path(os.path.realpath(place)).rglob("*.py")):
                digest.update(f"{part}/{path.relative_to(os.path.realpath(place)).as_posix()}\0".encode())
                digest.update(path.read_bytes().replace(b"\r\n", b"\n") + b"\0")
    return digest.hexdigest()[:12]


def check_alike(environments: Mapping[str, Environment], remedy: str) -> None:
    """Refuse different environments, given by the names of their places. Raises UserError, one line."""
    places = iter(environments.items())
    first = next(places, None)
    if first is None:
        return
    for place, each in places:
        if difference := first[1].difference(each):
            raise UserError(f"{first[0]} and {place} differ, and their results are not mixed: {difference}; {remedy}")
