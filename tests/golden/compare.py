"""What is found now, held against the golden files: exactly, or to 1e-12; a difference is named by its place."""

from typing import Any

import numpy as np

from tests.golden import contents, files, product

RELATIVE = 1e-12
ANGLE_DEG = 1e-10
"""Angles may be zero but for the last digit."""
TABLE = 2e-9
"""Files have nine significant digits."""


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
                absolute = ANGLE_DEG if name.endswith("_deg") else 0.0
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


def check_table(found: list[str], golden: list[str], where: str) -> None:
    """A file's lines, without comments, are the golden ones: words exactly, numbers but for their last digit."""
    assert len(found) == len(golden), where
    for k, (line, expected) in enumerate(zip(found, golden, strict=True)):
        if line == expected:
            continue
        words, expected_words = (each.replace(",", " , ").split() for each in (line, expected))
        assert len(words) == len(expected_words), f"{where}: line {k}: {line!r}, golden {expected!r}"
        for word, other in zip(words, expected_words, strict=True):
            if word != other:
                close = abs(float(word) - float(other)) <= TABLE * abs(float(other))
                assert close, f"{where}: line {k}: {word}, golden {other}"


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
