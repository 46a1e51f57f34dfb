"""The canonical form of many rows at once: that of each alone, whatever a damaged journal has in a column."""

import json
import math
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.campaign.journal.canonical import CanonicalColumns, encode

NUMBERS = st.one_of(
    st.none(),
    st.integers(min_value=-(2**63), max_value=2**63 - 1),
    st.floats(allow_nan=False),
    st.sampled_from([0.0, -0.0, 30.0, 500.05, math.inf]),
    st.text(max_size=8),
    st.binary(max_size=8),
)
CONTENTS = st.one_of(st.none(), st.binary(max_size=12), st.text(max_size=8), st.integers(), st.floats(allow_nan=False))


def columns_of(values: st.SearchStrategy[Any], rows: int) -> st.SearchStrategy[list[list[Any]]]:
    """Columns of equal length, of one type or of several."""
    alike = st.sampled_from([st.just(0.0), st.just(-0.0), st.floats(allow_nan=False), st.integers(-9, 9), values])
    return st.lists(alike.flatmap(lambda of: st.lists(of, min_size=rows, max_size=rows)), min_size=1, max_size=4)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 12).flatmap(lambda rows: st.tuples(columns_of(NUMBERS, rows), columns_of(CONTENTS, rows))))
def test_rows_together_have_the_bytes_of_each_alone(columns: tuple[list[list[Any]], list[list[Any]]]) -> None:
    numbers, contents = columns
    rows = zip(zip(*numbers, strict=True), zip(*contents, strict=True), strict=True)
    assert list(CanonicalColumns(numbers, contents).encoded()) == [encode(*row) for row in rows]


def test_a_zero_keeps_its_sign_among_many_equal_numbers() -> None:
    found = CanonicalColumns([[0.0, -0.0] * 50], [[b""] * 100])
    assert set(found.numbers) == {"0.0", "-0.0"}
    assert found.numbers[1] == "-0.0"


@pytest.mark.parametrize("row", [([1, 0.1, None], [b"a", None, "\u00e9"]), (["], ["], [b"], ["])])
def test_the_canonical_form_is_json_of_numbers_and_lengths_then_the_contents(row: tuple[list[Any], list[Any]]) -> None:
    """As docs/exchange/journal.md has it for other programs."""
    numbers, contents = row
    as_bytes = [each.encode() if isinstance(each, str) else each for each in contents]
    lengths = [None if each is None else len(each) for each in as_bytes]
    assert encode(numbers, contents) == json.dumps([*numbers, *lengths]).encode() + b"".join(filter(None, as_bytes))
