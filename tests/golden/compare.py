"""What is found now, held against the golden files: exactly, or to 1e-12; a difference is named by its place.

Numba compiles for the processor that it finds, and processors add the terms of a sum in different orders. So a value that is
the small difference of large ones, as an uncertainty is, may differ by rounding: it is held against the largest of its column.
"""

from typing import Any

import numpy as np

from tests.golden import contents, files, product

RELATIVE = 1e-12
ANGLE_DEG = 1e-10
"""Angles may be zero but for the last digit."""
TABLE = 2e-9
"""Files have nine significant digits."""
PROCESSOR = 1e-6
"""Difference of a simulated value between an AVX2 and an AVX-512 processor, relative; found: 2e-7."""
U_PROCESSOR = 1e-9
"""That of an uncertainty, as part of the largest of its column: a small one is what is left of large terms."""
U_FIT = 1e-10
"""That of an uncertainty of a campaign, for its fits are of the processor's own LAPACK; found: 4e-12 by AVX-512 from AVX2."""


def check_rows(found: list[product.Row], golden: contents.Json) -> None:
    """Rows are the golden ones: counts, gains, flags and positions exactly, times and the monitor's currents to 1e-12."""
    assert [row["identity"] for row in found] == [row["identity"] for row in golden["rows"]]
    for row, expected in zip(found, golden["rows"], strict=True):
        where = row["identity"]
        assert contents.exact_part(row) == contents.exact_part(expected), where
        for key in ("started_s", "ended_s"):
            check_numbers([row[key]], [expected[key]], f"{where}: {key}")
        for reading, read in zip(row["readings"], expected["readings"], strict=True):
            for key in ("first_s", "period_s", "monitor_a"):
                check_numbers([reading[key]], [read[key]], f"{where}: {key}")
    assert contents.rows_record(found)["digest"] == golden["digest"]


def check_points(found: contents.Json, golden: contents.Json) -> None:
    """Points, as `contents.points_record` has them, are the golden ones: flags exactly, values and coordinates to 1e-12."""
    assert found.keys() == golden.keys()
    for sample, points in found.items():
        expected = golden[sample]
        assert (points["count"], points["every"]) == (expected["count"], expected["every"]), sample
        assert points["marks"].keys() == expected["marks"].keys(), sample
        for name, mark in points["marks"].items():
            then = expected["marks"][name]
            assert mark == then, f"{sample}: {name}: {mark[0]} points, golden are {then[0]}"
        for kind in ("columns", "sums"):
            assert points[kind].keys() == expected[kind].keys(), sample
            for name, column in points[kind].items():
                part = U_FIT if name.startswith("u_") else RELATIVE
                absolute = ANGLE_DEG if name.endswith("_deg") else part * largest(expected[kind][name])
                check_numbers(column, expected[kind][name], f"{sample}: {kind} of {name}", absolute=absolute)


def check_numbers(
    found: list[Any], golden: list[Any], where: str, *, relative: float = RELATIVE, absolute: float = 0.0
) -> None:
    """Numbers are the golden ones; those that are missing are."""
    now, then = files.array(found), files.array(golden)
    assert now.shape == then.shape, where
    assert np.array_equal(np.isnan(now), np.isnan(then)), f"{where}: other values are missing"
    wrong = np.flatnonzero(np.abs(now - then) > relative * np.abs(then) + absolute)
    if wrong.size:
        k = int(wrong[0])
        raise AssertionError(f"{where}: {wrong.size} of {now.size} differ; the first is [{k}]: {now[k]!r}, golden {then[k]!r}")


def check_table(found: list[str], golden: list[str], where: str, *, simulated: bool = False) -> None:
    """A file's lines, without comments, are the golden ones: words exactly, numbers but for their last digit.

    `simulated` numbers but for the processor.
    """
    assert len(found) == len(golden), where
    expected_lines = [words_of(line) for line in golden]
    relative = PROCESSOR if simulated else TABLE
    allowed = {
        column: U_PROCESSOR * largest([number_of(words[column]) for words in expected_lines[1:] if column < len(words)])
        for column, title in enumerate(expected_lines[0])
        if simulated and title == "standard_error"
    }
    for k, (line, expected_words) in enumerate(zip(found, expected_lines, strict=True)):
        words = words_of(line)
        assert len(words) == len(expected_words), f"{where}: line {k}: {line!r}, golden {golden[k]!r}"
        for column, (word, other) in enumerate(zip(words, expected_words, strict=True)):
            if word != other:
                difference = abs(float(word) - float(other))
                close = difference <= max(relative * abs(float(other)), allowed.get(column, 0.0))
                assert close, f"{where}: line {k}: {word}, golden {other}"


def words_of(line: str) -> list[str]:
    """The fields of a line of a CSV, or the words of another line."""
    return line.split(",") if "," in line else line.split()


def number_of(word: str) -> float:
    """The number that a word is, NaN if it is none."""
    try:
        return float(word)
    except ValueError:
        return float("nan")


def largest(column: list[Any]) -> float:
    """The largest magnitude of the finite values of a column."""
    values = np.abs(files.array(column))
    return float(np.max(values[np.isfinite(values)], initial=0.0))


def check_plan(found: contents.Json, golden: contents.Json, where: str) -> None:
    """A plan is the golden one: its rows exactly, its durations to 1e-12."""
    assert found["count"] == golden["count"], where
    assert found["first"] == golden["first"], where
    assert found["last"] == golden["last"], where
    assert found["digest"] == golden["digest"], f"{where}: some row between the first and the last differs"
    check_numbers([found["seconds"]], [golden["seconds"]], f"{where}: duration")
    check_numbers(found["seconds_of_spans"], golden["seconds_of_spans"], f"{where}: durations of stretches")
    assert found["seconds_of_kinds"].keys() == golden["seconds_of_kinds"].keys(), where
    for kind, seconds in found["seconds_of_kinds"].items():
        check_numbers([seconds], [golden["seconds_of_kinds"][kind]], f"{where}: duration of {kind} rows")
