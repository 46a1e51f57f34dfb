"""CSV of points: a missing number stays missing, and reading returns what was written."""

import csv
import hashlib
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import ArrayLike

from goniotwin.app.formats import FormatError, points, read_points_csv, write_points_csv
from goniotwin.app.formats.points import MOST_TEXT_BYTES, PART_ROWS


def test_a_file_has_comments_then_column_names_then_rows(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    columns: dict[str, ArrayLike] = {
        "theta_deg": np.array([0.0, 1 / 3, 2]),
        "bsdf_per_sr": [0.318309886183791, np.nan, 1e-12],
        "row": [1, 2, 3],
        "flag": ["", "shadowed", 'a "b", c'],
    }
    write_points_csv(path, ["simulated, seed 1", "two\nlines"], columns)
    # Nine significant digits, the missing number an empty field, quotes only where CSV needs them.
    text = path.read_text()
    (stated,) = re.findall(
        r"# 3 rows; sha256 of all other lines: [0-9a-f]{64}; remove this line after a change on purpose *\n", text
    )
    others = text.replace(stated, "")
    assert hashlib.sha256(others.encode()).hexdigest() in stated
    assert others == (
        "# simulated, seed 1\n# two\n# lines\n"
        "theta_deg,bsdf_per_sr,row,flag\n"
        "0,0.318309886,1,\n"
        "0.333333333,,2,shadowed\n"
        '2,1e-12,3,"a ""b"", c"\n'
    )
    points = read_points_csv(path)
    assert points.comments == ("simulated, seed 1", "two", "lines")
    assert list(points.columns) == list(columns)
    np.testing.assert_array_equal(points.columns["bsdf_per_sr"], [0.318309886, np.nan, 1e-12])
    assert points.columns["flag"].tolist() == ["", "shadowed", 'a "b", c']


def test_a_table_without_points_keeps_its_columns(tmp_path: Path) -> None:
    path = tmp_path / "none.csv"
    write_points_csv(path, [], {"a": [], "b": []})
    assert {name: column.tolist() for name, column in read_points_csv(path).columns.items()} == {"a": [], "b": []}


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """A file of five rows: a digest is in line 2, the header in line 3."""
    path = tmp_path / "five.csv"
    columns: dict[str, ArrayLike] = {"x": [1.5, 2.5, 3.5, 4.5, 5.5], "side": ["front"] * 5}
    write_points_csv(path, ["simulated"], columns)
    return path


def swap(lines: list[str], one: int, other: int) -> list[str]:
    lines[one], lines[other] = lines[other], lines[one]
    return lines


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda lines: lines[:5] + lines[6:], "has 4 rows, and 5 were written: 1 are missing"),
        (lambda lines: lines[:-2], "has 3 rows, and 5 were written: 2 are missing"),
        (lambda lines: lines[:5] + lines[4:], "has 6 rows, and 5 were written: 1 too many, and line 6 is the same as line 5"),
        (lambda lines: swap(lines, 4, 5), "is not what was written: a row or a comment was changed, lost or moved"),
        (lambda lines: [each.replace("3.5", "3.6") for each in lines], "a row or a comment was changed"),
        (lambda lines: lines[1:], "a row or a comment was changed, lost or moved"),
        (lambda lines: [*lines[:2], *lines[1:]], "a row or a comment was changed, lost or moved"),
    ],
)
def test_a_line_that_was_lost_doubled_moved_or_changed_is_found(
    written: Path, change: Callable[[list[str]], list[str]], message: str
) -> None:
    written.write_text("".join(change(written.read_text().splitlines(keepends=True))))
    with pytest.raises(FormatError, match=message) as caught:
        read_points_csv(written)
    assert "if it was changed on purpose" in str(caught.value)


@pytest.mark.parametrize("change", [(b"sha256", b"SHA256"), (b"rows; sha256", b"rows;sha256"), (b" on purpose", b"")])
def test_a_damaged_line_of_the_digest_is_no_comment(written: Path, change: tuple[bytes, bytes]) -> None:
    written.write_bytes(written.read_bytes().replace(*change))
    with pytest.raises(FormatError, match="damaged line with the number of rows"):
        read_points_csv(written)


def test_rows_that_begin_as_comments_do_are_counted(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    write_points_csv(path, ["a comment"], {"sample": np.array(["#5", "a", "#6"]), "x": np.array([1.0, 2.0, 3.0])})
    assert read_points_csv(path).columns["sample"].tolist() == ["#5", "a", "#6"]
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(FormatError, match="has 2 rows, and 3 were written: 1 are missing"):
        read_points_csv(path)


def test_without_its_digest_a_file_is_read_as_it_is_and_other_line_ends_are_the_same_file(written: Path) -> None:
    raw = written.read_bytes()
    for same in (raw.replace(b"\n", b"\r\n"), raw.removesuffix(b"\n"), b"\xef\xbb\xbf" + raw):
        written.write_bytes(same)
        assert read_points_csv(written).columns["x"].tolist() == [1.5, 2.5, 3.5, 4.5, 5.5]
    lines = raw.splitlines(keepends=True)
    written.write_bytes(b"".join([lines[0], *lines[2:5]]))
    assert read_points_csv(written).columns["x"].tolist() == [1.5, 2.5]


FORMULAS = ["=1+1", "+1", "-5", "@a", "\t=1", "\r=1", "'=1", "''-5", "'", "''", "'a", "a=1", "", "-"]


def test_no_text_is_a_formula_in_a_spreadsheet_and_each_is_read_back_exactly(tmp_path: Path) -> None:
    path = tmp_path / "formulas.csv"
    written: dict[str, ArrayLike] = {"x": -np.arange(float(len(FORMULAS))), "=text": FORMULAS}
    write_points_csv(path, [], written)
    with path.open(newline="") as file:
        rows = list(csv.reader(line for line in file if not line.startswith("#")))
    assert not any(text.startswith(("=", "+", "-", "@", "\t", "\r")) for _, text in rows)
    assert [number for number, _ in rows[1:4]] == ["-0", "-1", "-2"]  # a number is one
    columns = read_points_csv(path).columns
    assert columns["=text"].tolist() == FORMULAS
    assert columns["x"].tolist() == [-float(k) for k in range(len(FORMULAS))]


def test_one_line_of_pandas_reads_a_file(written: Path) -> None:
    frame = pytest.importorskip("pandas").read_csv(written, comment="#")
    assert (frame.x.tolist(), frame.side.tolist()) == ([1.5, 2.5, 3.5, 4.5, 5.5], ["front"] * 5)


def test_pandas_keeps_the_rows_whose_texts_have_the_character_of_a_comment(tmp_path: Path) -> None:
    texts = ["#1", "sample #2", "3", "a,#4", "#"]
    columns: dict[str, ArrayLike] = {"sample": texts, "x": np.arange(5.0), "note": texts[::-1]}
    write_points_csv(tmp_path / "points.csv", [], columns)
    frame = pytest.importorskip("pandas").read_csv(tmp_path / "points.csv", comment="#")
    assert (frame["sample"].tolist(), frame.x.tolist(), frame.note.tolist()) == (texts, [0.0, 1.0, 2.0, 3.0, 4.0], texts[::-1])
    assert read_points_csv(tmp_path / "points.csv").columns["sample"].tolist() == texts


TEXT = st.text(st.characters(codec="utf-8", exclude_categories=("Cc", "Cs")) | st.sampled_from("\n\r\t,\"'#=+-@"), max_size=8)
NAMES = st.text(st.characters(min_codepoint=32, max_codepoint=126), min_size=1, max_size=8)


@st.composite
def column_sets(draw: st.DrawFn) -> dict[str, np.ndarray[tuple[int], np.dtype[np.float64 | np.str_]]]:
    names = draw(st.lists(NAMES.filter(lambda name: name.strip() != "" and name[0] != "#"), unique=True, max_size=4))
    length = draw(st.integers(0, 5))
    numbers = st.one_of(st.floats(allow_infinity=False, width=32), st.just(np.nan))
    return {
        "first": np.array(draw(st.lists(numbers, min_size=length, max_size=length)), dtype=np.float64),
        **{
            f"_{name}": np.array(["text", *draw(st.lists(TEXT, min_size=length, max_size=length))], dtype=np.str_)[1:]
            for name in names
        },
    }


@settings(deadline=None)
@given(columns=column_sets(), comments=st.lists(TEXT, max_size=3))
def test_reading_returns_the_written_columns(
    tmp_path_factory: pytest.TempPathFactory,
    columns: dict[str, np.ndarray[tuple[int], np.dtype[np.float64 | np.str_]]],
    comments: list[str],
) -> None:
    path = tmp_path_factory.getbasetemp() / "round.csv"
    write_points_csv(path, comments, columns)
    points = read_points_csv(path)
    assert list(points.columns) == list(columns)
    for name, column in columns.items():
        again = points.columns[name]
        if name == "first":
            np.testing.assert_allclose(again, column.astype(np.float64), rtol=5e-9, atol=0)
        elif again.dtype.kind == "U":
            assert again.tolist() == column.tolist()
        else:  # texts that all look like numbers, or are empty
            assert [text == "" for text in column] == np.isnan(again).tolist()


@settings(deadline=None)
@given(content=st.binary() | st.text(alphabet='ab,"\n\r#1.e-', max_size=60).map(str.encode))
def test_arbitrary_bytes_raise_nothing_but_a_format_error(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(content)
    try:
        points = read_points_csv(path)
    except FormatError:
        return
    assert len({column.size for column in points.columns.values()}) == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# c\na,b\n1,2\n3\n", "line 4: 1 fields, but the header has 2"),
        ("a,a\n1,2\n", "line 1: in the header a column has no name"),
        ("# only a comment\n", "line 2: in the header"),
        ('a,b\n"1,2\n', "line 2: not CSV"),
        (f"a\n{'x' * (csv.field_size_limit() + 1)}\n", "not CSV: field larger than field limit"),
    ],
)
def test_a_broken_file_is_refused_with_its_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "broken.csv"
    path.write_text(text)
    with pytest.raises(FormatError) as caught:
        read_points_csv(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({}, "all of the same length"),
        ({"a": [1.0], "b": [1.0, 2.0]}, "all of the same length"),
        ({"a": [np.inf]}, "infinite"),
        ({"a": [[1.0]]}, "not a plain list"),
        ({"a": np.ma.masked_equal([1.0, 2.0], 2.0)}, "not a plain list"),
        ({"a": np.array([object()])}, "type object"),
        ({"#a": [1.0]}, "column name"),
        ({"a": ["\x07"]}, "has the text"),
        ({"a": ["\ud800"]}, "broken characters"),
    ],
)
def test_columns_that_a_csv_cannot_represent_are_refused(tmp_path: Path, columns: dict[str, list[float]], message: str) -> None:
    with pytest.raises(FormatError, match=message):
        write_points_csv(tmp_path / "out.csv", [], columns)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("more", [0, PART_ROWS - 2, PART_ROWS])
def test_a_column_is_of_texts_where_only_its_last_row_is(tmp_path: Path, more: int) -> None:
    """A file is read in blocks: what the first ones hold is not known to be text before the last."""
    path = tmp_path / "late.csv"
    path.write_text("a,b,c\n" + "1,10,\n" * more + '1,10,\n02,20,\n3,,5\n\n4,"x\ny",\n5.0,30,\n')
    columns = read_points_csv(path).columns
    np.testing.assert_array_equal(columns["a"], [1.0] * more + [1.0, 2.0, 3.0, 4.0, 5.0])
    assert columns["b"].tolist() == ["10"] * more + ["10", "20", "", "x\ny", "30"]
    np.testing.assert_array_equal(columns["c"], [np.nan] * more + [np.nan, np.nan, 5.0, np.nan, np.nan])


def test_a_long_text_among_many_rows_is_refused(tmp_path: Path) -> None:
    """Each row of a column takes the memory of the longest."""
    path, rows = tmp_path / "long.csv", 2 * PART_ROWS + 1  # the long one is in a block of its own, which takes little
    longest = MOST_TEXT_BYTES // (4 * rows) + 1
    path.write_text("a\n" + "x\n" * (rows - 1) + "y" * longest + "\n")
    with pytest.raises(FormatError, match=f"the column 'a' has a text of {longest} characters, among {rows} rows"):
        read_points_csv(path)


def test_a_column_of_repeated_numbers_is_written_as_one_of_different_numbers(tmp_path: Path) -> None:
    """Repeated numbers are spelled once: each field still is that of its own value, with the sign of a zero."""
    few = np.array([0.0, -0.0, np.nan, 1.0 / 3.0, 500.05])
    repeated = np.tile(few, 40)
    number = np.arange(repeated.size)
    write_points_csv(tmp_path / "a.csv", [], {"x": repeated, "n": number % 3, "k": number})
    lines = (tmp_path / "a.csv").read_text(encoding="utf-8").splitlines()[2:]
    texts = ["0", "-0", "", "0.333333333", "500.05"]
    assert lines == [f"{texts[k % 5]},{k % 3},{k}" for k in range(repeated.size)]


HEADER = "sigma_deg,theta_deg,phi_deg,bsdf_per_sr"


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        (HEADER, "60,80,180,1", "the column theta_deg has 80, which at phi 180 and sigma 60 is 140 deg from the normal; give"),
        (HEADER, "100,0,0,1", "the column sigma_deg has 100; give numbers from 0 to 90"),
        (HEADER, "0,,0,1", "the column theta_deg has no number; give numbers from 0 to 180"),
        (HEADER, "0,0,0,one", "the column bsdf_per_sr has 'one', which is not a number; correct it"),
        (f"{HEADER},u_bsdf_per_sr", "0,0,0,1,-1", "the column u_bsdf_per_sr has -1; give numbers from 0 on, or none"),
        (f"{HEADER},light", "0,0,0,1,both", "the column light has 'both'; give reflected or transmitted"),
    ],
)
def test_a_value_that_a_column_cannot_have_is_refused_with_its_line(
    tmp_path: Path, header: str, row: str, message: str
) -> None:
    path = tmp_path / "a.csv"
    good = "0,10,0,1" + header.removeprefix(HEADER).replace(",u_bsdf_per_sr", ",0.1").replace(",light", ",reflected")
    path.write_text(f'# a "comment\n\n{header}\n{good}\n\n{row}\n')
    with pytest.raises(FormatError, match=f"a.csv, line 6: {re.escape(message)}"):
        points.read(path)
    path.write_text(f"{header}\n{good}\n")
    assert points.read(path).scattered[0].polar_deg.tolist() == pytest.approx([10.0])


def test_the_azimuth_of_the_light_is_read_beside_specular_coordinates(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(f"{HEADER},psi_deg\n30,0,0,1,40\n")
    part = points.read(tmp_path / "a.csv").scattered[0]
    assert [part.psi_deg[0], part.polar_deg[0], part.azimuth_deg[0]] == pytest.approx([40.0, 30.0, 220.0])
