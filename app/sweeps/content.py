"""Dataclasses of numbers, texts and arrays as data for a specification, and back: bit by bit the same.

The reader of the data lists the classes: no others are made.
"""

import base64
from collections.abc import Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np


def as_data(value: object) -> Any:
    """A value as dictionaries, lists, texts and numbers. Raises TypeError for anything but numbers, arrays and dataclasses."""
    if value is None or isinstance(value, bool | str):
        return value
    if isinstance(value, np.bool_):
        return bool(value)
    if isinstance(value, int | np.integer):
        return int(value)
    if isinstance(value, float | np.floating):
        return float(value)
    if isinstance(value, np.ndarray):
        plain = np.ascontiguousarray(value, dtype=value.dtype.newbyteorder("<"))
        if plain.dtype.kind not in "biuf":
            raise TypeError(f"an array of the type {value.dtype} is no data: give an array of numbers")
        kept = {"writeable": bool(value.flags.writeable)}  # kernels are compiled for arrays that are not
        text = base64.b64encode(plain.tobytes()).decode()
        return {"array": text, "type": plain.dtype.str, "shape": list(value.shape), **kept}
    if isinstance(value, tuple | list):
        return [as_data(each) for each in value]
    if isinstance(value, Mapping):
        return {"mapping": {str(key): as_data(each) for key, each in value.items()}}
    if is_dataclass(value) and not isinstance(value, type):
        own = {each.name: as_data(getattr(value, each.name)) for each in fields(value) if each.init}
        return {"class": type(value).__name__, "fields": own}
    raise TypeError(f"a {type(value).__name__} is no data: give numbers, texts, arrays of numbers or dataclasses")


def from_data(data: Any, classes: Iterable[type]) -> Any:
    """The value of `as_data`, with the classes that it may have; a list is a tuple. Raises KeyError for another class."""
    known = {each.__name__: each for each in classes}

    def made(each: Any) -> Any:
        if isinstance(each, list):
            return tuple(made(one) for one in each)
        if not isinstance(each, dict):
            return each
        if "array" in each:
            array = np.frombuffer(base64.b64decode(each["array"]), each["type"]).reshape(each["shape"]).copy()
            array = array.astype(array.dtype.newbyteorder("="), copy=False)
            array.flags.writeable = each["writeable"]
            return array
        if "mapping" in each:
            return {key: made(one) for key, one in each["mapping"].items()}
        return known[each["class"]](**{key: made(one) for key, one in each["fields"].items()})

    return made(data)
