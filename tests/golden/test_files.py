"""The golden files as text: a change of one value is a change of one line, and is named by its column, its row and its size."""

import difflib
from typing import Any

import pytest

from tests.golden import files
from tests.golden.compare import BOUNDS, check_table, differences
from tests.golden.files import Table, as_csv, parsed, sampled, table
from tests.golden.make import kept

ROWS = 3000
COLUMNS: dict[str, list[Any]] = {
    "sample": ["opal" if k % 2 else "etalon" for k in range(ROWS)],
    "photodiode": [k % 36 for k in range(ROWS)],
    "beta_deg": [0.1 * (k % 1801) for k in range(ROWS)],
    "bsdf": [None if k == 7 else 1.0 / (3.0 + k) for k in range(ROWS)],
}


def with_one(column: str, row: int, value: object) -> Table:
    """The table with one value changed."""
    return table({**COLUMNS, column: [value if k == row else each for k, each in enumerate(COLUMNS[column])]}, BOUNDS)


def changed_lines(one: Table, other: Table) -> int:
    """How many lines of a diff of both files are new."""
    pairs = zip(sampled(one, 16, 48, tuple(BOUNDS)), sampled(other, 16, 48, tuple(BOUNDS)), strict=True)
    diffs = [difflib.unified_diff(as_csv(a).splitlines(), as_csv(b).splitlines(), n=0, lineterm="") for a, b in pairs]
    return sum(line.startswith("+") and not line.startswith("+++") for diff in diffs for line in diff)


@pytest.mark.parametrize("row", [0, 1, 16, 47, 48, ROWS - 1])
@pytest.mark.parametrize(
    ("column", "value"),
    [("sample", "white"), ("photodiode", 40), ("beta_deg", -3.0), ("bsdf", 2.0), ("bsdf", None)],
)
def test_a_change_of_one_value_is_a_change_of_one_line(column: str, value: object, row: int) -> None:
    assert changed_lines(with_one("bsdf", 7, None), with_one(column, row, value)) == 1


def test_a_sign_is_a_change_too() -> None:
    assert changed_lines(with_one("bsdf", 7, None), with_one("bsdf", 17, -COLUMNS["bsdf"][17])) == 1


def test_a_table_is_read_as_it_was_written() -> None:
    written = with_one("sample", 3, 'a "word", with a comma')
    assert parsed(as_csv(written)) == written
    assert [float(each) for each in written.columns["beta_deg"]] == pytest.approx(COLUMNS["beta_deg"], rel=1e-15)


def test_a_difference_states_column_row_and_size() -> None:
    golden = table(COLUMNS, BOUNDS)
    with pytest.raises(AssertionError) as caught:
        check_table(with_one("bsdf", 97, 0.0101), golden, "quick/points.csv")
    assert str(caught.value).splitlines() == [
        "quick/points.csv:",
        "bsdf: 1 of 3000 differ, by 0.0099 in the median, at most 0.0099; the first in row 97: '0.0101', golden '0.01'",
    ]


def test_a_value_that_the_tests_permit_stays_as_it_was(capsys: pytest.CaptureFixture[str]) -> None:
    """What another processor rounds otherwise is no line of a commit."""
    golden = table(COLUMNS, BOUNDS)
    rounded = with_one("bsdf", 97, 0.01 * (1.0 + 1e-14))
    assert rounded != golden
    assert differences(rounded, golden, BOUNDS) == []
    assert kept(rounded, golden, "a.csv", BOUNDS) == golden
    assert capsys.readouterr().out == ""
    other = with_one("bsdf", 97, 0.02)
    assert kept(other, golden, "a.csv", BOUNDS) == other
    assert capsys.readouterr().out.startswith("a.csv: bsdf: 1 of 3000 differ, by 0.5 in the median")


def test_an_exact_number_has_all_its_digits() -> None:
    assert files.text(0.1 + 0.2, exact=True) == "0.30000000000000004"
    assert files.text(0.1 + 0.2) == "0.3"
    assert files.text(1e10, exact=True) == "10000000000"
