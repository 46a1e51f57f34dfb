"""Journals of an older version of the program: they open, reduce, are listed and are resumed as they were then."""

from pathlib import Path

import pytest

from tests.golden import contents, files, product
from tests.golden.compare import check_points, check_rows, check_table


@pytest.fixture
def journals(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the finished one and of the interrupted one."""
    return contents.copied(tmp_path)


def test_they_are_listed_as_they_were(journals: tuple[Path, Path]) -> None:
    golden = files.read("listed")
    assert [each["state"] for each in golden] == ["done", "killed"]
    assert contents.listed(journals[0].parent) == golden


def test_the_finished_one_has_its_points_and_tables(journals: tuple[Path, Path], tmp_path: Path) -> None:
    golden = files.read("finished")
    found = contents.finished_record(journals[0], tmp_path)
    check_points(files.as_written(found["points"]), golden["points"])
    for form, lines in found["exports"].items():
        check_table(lines, golden["exports"][form], form)


def test_the_interrupted_one_has_its_points(journals: tuple[Path, Path]) -> None:
    check_points(files.as_written(contents.points_record(journals[1])), files.read("interrupted"))


def test_the_interrupted_one_is_resumed_and_ends_as_a_run_that_nothing_disturbs(journals: tuple[Path, Path]) -> None:
    golden, undisturbed = files.read("resumed"), files.read("undisturbed")
    found = files.as_written(contents.resumed_record(journals[1]))
    check_rows(found["rows"], golden)
    check_points(found["points"], golden["points"])
    planned = [contents.exact_part(row) for row in found["rows"] if row["planned"]]
    assert planned == [contents.exact_part(row) for row in undisturbed["rows"]]
    assert len(planned) < len(found["rows"])  # what was mounted is mounted again


def test_they_know_no_folder_of_the_computer_that_made_them(journals: tuple[Path, Path]) -> None:
    for journal in journals:
        assert product.campaign_entry(journal, "rig_folder") == "."
