"""The hash of a virtual rig's model: of everything that decides what the virtual rig does, under names of fields alone.

No name of a class or a module is in it, so that these may change. A hash begins with the version of its text. Version 1 had no
such mark; see `app.rig.old_model_hash`.
"""

import hashlib
import json
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from enum import Enum
from numbers import Integral, Real

import numpy as np

from goniotwin.app.rig.old_model_hash import old_model_hash
from goniotwin.twin import TwinModel

VERSION = 2


def model_hash(model: TwinModel) -> str:
    """Of a model without its seed, samples' tables included, and without the samples' names, which are for people."""
    parts = {entry.name: getattr(model, entry.name) for entry in fields(model) if entry.name != "seed"}
    parts["samples"] = {
        key: {entry.name: getattr(sample, entry.name) for entry in fields(sample) if entry.name != "name"}
        for key, sample in model.samples.items()
    }
    return f"{VERSION}:{hashlib.sha256(canonical_text(parts).encode()).hexdigest()[:16]}"


def model_hashes(model: TwinModel) -> tuple[str, ...]:
    """All hashes by which journals and rig files may know a model, the one that is written now first."""
    old = old_model_hash(model)
    return (model_hash(model),) if old is None else (model_hash(model), old)


def canonical_text(value: object) -> str:
    """A value as text that is the same for equal values: dataclasses and mappings by the names of their fields, in alphabetical
    order, lists and tuples alike, 1 as 1.0, an enum as its value, an array as its shape, type and the SHA-256 of its bytes.

    Raises TypeError for anything else, such as a function: two of them cannot be compared.
    """
    if value is None:
        return "null"
    if isinstance(value, Enum):
        return canonical_text(value.value)
    if isinstance(value, bool | np.bool_):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(str(value))
    if isinstance(value, Real):
        return _number(value)
    if isinstance(value, np.ndarray):
        return _array(value)
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(canonical_text, value))}]"
    if is_dataclass(value) and not isinstance(value, type):
        value = {entry.name: getattr(value, entry.name) for entry in fields(value)}
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{json.dumps(str(key))}: {canonical_text(value[key])}' for key in sorted(value))}}}"
    raise TypeError(f"a {type(value).__name__} has no canonical text: give numbers, texts, arrays of numbers or dataclasses")


def _number(value: Real) -> str:
    number = float(value)
    if isinstance(value, Integral) and int(value) != number:
        return repr(int(value))
    return repr(number + 0.0)  # -0.0 is 0.0


def _array(values: np.ndarray) -> str:
    if values.dtype.kind not in "biuf":
        raise TypeError(f"an array of the type {values.dtype} has no canonical text: give an array of numbers")
    plain = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
    return f"array {values.shape} {plain.dtype.str} {hashlib.sha256(plain.tobytes()).hexdigest()}"
