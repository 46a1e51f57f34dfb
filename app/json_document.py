"""The JSON of results: the one place where a result of a command becomes a document.

A dataclass is an object of its fields, in their order. A field with the metadata OPTIONAL_KEY is absent where it is None. A
class whose document has other keys gives them by `as_dict`. Arrays, tuples and lists are lists; paths are their text, dates and
times ISO 8601, members of an enumeration their value; NaN and infinity are null, because JSON has no such numbers.
"""

import json
import math
import os
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from datetime import date
from enum import Enum
from typing import Any

OPTIONAL_KEY = {"json": "absent where it is None"}


def json_value(value: object) -> Any:
    """A result as dictionaries, lists, texts, numbers, True, False and None. Raises TypeError for what has no JSON."""
    if value is None or (isinstance(value, bool | int | str) and not isinstance(value, Enum)):
        return value
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Enum):
        return json_value(value.value)
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, date):
        return value.isoformat()
    if isinstance(value, Mapping):
        return {_key(key): json_value(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [json_value(each) for each in value]
    if hasattr(value, "as_dict"):
        return json_value(value.as_dict())
    if is_dataclass(value):
        shown = [each for each in fields(value) if "json" not in each.metadata or getattr(value, each.name) is not None]
        return {each.name: json_value(getattr(value, each.name)) for each in shown}
    if hasattr(value, "tolist"):  # an array or a number of numpy
        return json_value(value.tolist())
    raise TypeError(f"{type(value).__name__} {value!r:.60} has no JSON")


def json_text(value: object, indent: int | None = 2) -> str:
    """A result as the text of a JSON document."""
    return json.dumps(json_value(value), indent=indent, allow_nan=False)


def _key(key: object) -> str:
    if not isinstance(key, str | int):
        raise TypeError(f"{key!r:.60} is no key of a JSON object")
    return str(key)
