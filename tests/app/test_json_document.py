"""The JSON of results: what each kind of value becomes."""

import json
import math
from dataclasses import dataclass, field
from datetime import date
from enum import Enum, StrEnum
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.json_document import OPTIONAL_KEY, json_text, json_value


class Colour(StrEnum):
    RED = "red"


class Number(Enum):
    ONE = 1


@dataclass(frozen=True)
class Inner:
    second: float
    first: tuple[int, ...]
    absent: str | None = field(default=None, metadata=OPTIONAL_KEY)
    empty: str | None = None


class OtherKeys:
    def as_dict(self) -> dict[str, object]:
        return {"inner": Inner(math.inf, (1, 2)), "paths": [Path("a/b")]}


def test_each_kind_of_value_has_one_json() -> None:
    result = {
        "array": np.array([[1.0, np.nan], [np.inf, 0.1]]),
        "number": np.float64(0.1),
        "whole": np.int64(3),
        "flag": np.bool_(True),
        "enum": (Colour.RED, Number.ONE),
        "date": date(2026, 11, 28),
        "other": OtherKeys(),
        7: None,
    }
    assert json_text(result, indent=None) == (
        '{"array": [[1.0, null], [null, 0.1]], "number": 0.1, "whole": 3, "flag": true, "enum": ["red", 1], '
        '"date": "2026-11-28", "other": {"inner": {"second": null, "first": [1, 2], "empty": null}, "paths": ["a/b"]}, '
        '"7": null}'
    )


def test_an_optional_key_is_there_with_its_value() -> None:
    assert list(json_value(Inner(1.0, (), absent=""))) == ["second", "first", "absent", "empty"]


def test_numbers_keep_all_their_digits() -> None:
    numbers = np.random.default_rng(1).random(100) * 10.0 ** np.arange(-50, 50)
    assert json.loads(json_text(numbers)) == numbers.tolist()


@pytest.mark.parametrize("wrong", [object(), {1.5: "a"}, {"a": b"bytes"}, {1, 2}])
def test_what_has_no_json_is_an_error_of_the_program(wrong: object) -> None:
    with pytest.raises(TypeError, match="JSON"):
        json_value(wrong)
