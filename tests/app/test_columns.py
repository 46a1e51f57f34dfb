"""A table of columns: selection, joining and names are those of plain arrays, whatever kinds of fields declare the columns."""

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.columns import ColumnTable, Degrees, MemberColumn, NumberColumn, NumberedColumn, PerSteradian, TextColumn
from goniotwin.arrays import Floats


@dataclass(frozen=True)
class Effects(ColumnTable):
    member: MemberColumn
    effect: NumberColumn


@dataclass(frozen=True)
class Inner(ColumnTable):
    value: PerSteradian
    own: Mapping[str, NumberColumn]


@dataclass(frozen=True)
class Outer(ColumnTable):
    """A table with a field of each kind."""

    sigma_deg: Degrees
    flags: TextColumn
    inner: Inner
    effects: Mapping[str, Effects]
    photodiode: NumberedColumn | None = None
    other: Inner | None = None
    whole: str = ""
    places: Floats | None = None


def table(n: int, *, names: tuple[str, ...] = ("noise",), width: int = 2, photodiode: bool = True, begin: int = 0) -> Outer:
    at = np.arange(begin, begin + n, dtype=np.float64)
    inner = Inner(at + 0.5, dict.fromkeys(names, at**2))
    pairs = np.stack([at] * width, axis=1) if width else np.zeros((n, 0))
    effects = {"lamp": Effects(pairs.astype(np.int32), -pairs)}
    numbers = at.astype(np.int64) if photodiode else None
    return Outer(at, at.astype(str), inner, effects, numbers, inner, "whole", np.ones((3, 3)))


def same(one: Outer, other: Outer) -> bool:
    """Whether two tables have the same columns, in their names, types, shapes and values."""
    mine, theirs = one.columns(), other.columns()
    alike = all(
        each.dtype.kind == theirs[name].dtype.kind and np.array_equal(each, theirs[name]) for name, each in mine.items()
    )
    return list(mine) == list(theirs) and alike and (one.whole, one.places is None) == (other.whole, other.places is None)


@given(st.integers(2, 12), st.data())
def test_the_parts_of_a_table_joined_are_the_table(n: int, data: st.DataObject) -> None:
    whole = table(n)
    cuts = sorted(data.draw(st.sets(st.integers(0, n))))
    edges = [0, *cuts, n]
    parts = [whole.where(slice(a, b)) for a, b in itertools.pairwise(edges)]
    assert sum(part.size for part in parts) == whole.size == n
    assert same(Outer.join(parts), whole)


@given(st.lists(st.integers(0, 5), max_size=9))
def test_a_choice_of_rows_is_that_of_each_array(chosen: list[int]) -> None:
    whole, index = table(6), np.array(chosen, dtype=np.int64)
    found = whole.where(index)
    expected = {name: array[index] for name, array in whole.columns().items()}
    assert found.columns().keys() == expected.keys()
    assert all(np.array_equal(array, expected[name]) for name, array in found.columns().items())
    assert found.places is whole.places  # it belongs to the whole table


def test_columns_have_the_names_of_their_fields_and_make_the_table_again() -> None:
    whole = table(3)
    assert list(whole.columns()) == [
        "sigma_deg",
        "flags",
        "inner value",
        "inner own noise",
        "effects member lamp",
        "effects effect lamp",
        "photodiode",
        "other value",
        "other own noise",
    ]
    assert same(table(1, begin=7).of_columns(whole.columns()), whole)
    with pytest.raises(KeyError, match="sigma_deg"):
        whole.of_columns({})
    with pytest.raises(ValueError, match="no place for the columns sigma"):
        whole.of_columns({**whole.columns(), "sigma": whole.sigma_deg})


def test_what_one_of_joined_tables_does_not_have_is_absent_there() -> None:
    one, other = table(2, names=("noise",), width=1, photodiode=False), table(1, names=("dark",), width=2, begin=5)
    one = replace(one, effects={**one.effects, "etalon": one.effects["lamp"]})
    joined = Outer.join([one, other])
    columns: dict[str, Any] = {name: array.tolist() for name, array in joined.columns().items()}
    assert columns["inner own noise"] == [0.0, 1.0, 0.0]
    assert columns["inner own dark"] == [0.0, 0.0, 25.0]
    assert columns["effects member lamp"] == [[0, -1], [1, -1], [5, 5]]
    assert columns["effects effect lamp"] == [[0.0, 0.0], [-1.0, 0.0], [-5.0, -5.0]]
    assert columns["effects member etalon"] == [[0], [1], [-1]]
    assert columns["photodiode"] == [-1, -1, 5]
    assert joined.columns()["effects member lamp"].dtype == np.int32
    assert Outer.join([replace(one, other=None), replace(other, other=None)]).other is None
    with pytest.raises(ValueError, match="no place for the columns other own dark, other value"):
        Outer.join([replace(one, other=None), other])


def test_where_a_mask_is_false_everything_is_absent() -> None:
    found = table(2).known_at(np.array([True, False]))
    assert found.sigma_deg.tolist() == [0.0, 0.0]
    assert found.flags.tolist() == ["0.0", ""]
    assert found.inner.value.tolist() == [0.5, 0.0]
    assert found.effects["lamp"].member.tolist() == [[0, 0], [-1, -1]]
    two = Inner(np.ones((2, 2)), {}).known_at(np.array([[True, False], [False, True]]))
    assert two.value.tolist() == [[1.0, 0.0], [0.0, 1.0]]


def test_each_column_states_its_unit() -> None:
    declared = {name: column.unit for name, column in Outer.declared().items()}
    assert declared == {"sigma_deg": "deg", "flags": "", "photodiode": ""}
    assert Inner.declared()["value"].unit == "1/sr"
