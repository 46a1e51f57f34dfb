"""The golden files: read, written, and compared with what is found now."""

import gzip
import json
from pathlib import Path
from typing import Any

import numpy as np

DATA = Path(__file__).resolve().parent / "data"


def read(name: str) -> Any:
    """A golden file's content."""
    return json.loads(gzip.decompress((DATA / f"{name}.json.gz").read_bytes()))


def write(name: str, content: object) -> None:
    """Writes one, with the same bytes for the same content."""
    text = json.dumps(content, indent=0, sort_keys=True, allow_nan=False) + "\n"
    (DATA / f"{name}.json.gz").write_bytes(gzip.compress(text.encode(), 9, mtime=0))


def as_written(content: object) -> Any:
    """The content as it would be read back."""
    return json.loads(json.dumps(content, allow_nan=False))


def array(values: list[float | None]) -> np.ndarray:
    """A column of a golden file; NaN where there is no number."""
    return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
