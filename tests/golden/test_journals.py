"""Journals of an older version of the program: they open, reduce, are listed and are resumed as they were then."""

import json
import re
from pathlib import Path

import pytest

from tests.conftest import ONE_WAY, changed
from tests.golden import contents, files, product
from tests.golden.compare import check_lines, check_tables

LIGHT, FRAMES = "[twin.light]\n", "[twin.frames]\nreflectance = 0.06\n\n"


@pytest.fixture
def journals(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the finished one and of the interrupted one."""
    return contents.copied(tmp_path)


def test_they_are_listed_as_they_were(journals: tuple[Path, Path]) -> None:
    golden = json.loads((files.DATA / "listed.json").read_text(encoding="utf-8"))
    assert [each["state"] for each in golden] == ["done", "killed"]
    assert contents.listed(journals[0].parent) == golden


def test_the_finished_one_has_its_points_and_tables(journals: tuple[Path, Path], tmp_path: Path) -> None:
    check_tables(contents.points_record(journals[0]), files.read("finished"), "finished")
    for form in contents.EXPORTS:
        lines = contents.exported_lines(journals[0], form, tmp_path)
        check_lines(lines, files.read_lines(f"exported/finished.{form}"), form)


def test_the_interrupted_one_has_its_points(journals: tuple[Path, Path]) -> None:
    check_tables(contents.points_record(journals[1]), files.read("interrupted"), "interrupted")


def test_the_interrupted_one_is_resumed_and_ends_as_a_run_that_nothing_disturbs(journals: tuple[Path, Path]) -> None:
    found = contents.resumed_record(journals[1])
    check_tables(found, files.read("resumed"), "resumed")
    planned = contents.planned({name: found[name] for name in ("rows", "readings", "counts")})
    check_tables(planned, contents.planned(files.read("undisturbed")), "undisturbed")
    assert len(planned["rows"]) < len(found["rows"])  # what was mounted is mounted again


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("reflectance = 0.9\n", "reflectance = 0.8\n"),
        ("gear = 36.0 }", "gear = 36.0, zero_deg = 0.01 }"),
        (LIGHT, FRAMES + LIGHT),
    ],
    ids=["sample", "mechanics", "frames"],
)
def test_the_interrupted_one_is_not_resumed_on_another_twin(
    old: str, new: str, journals: tuple[Path, Path], tmp_path: Path
) -> None:
    _, journal = journals
    before = journal.read_bytes()
    rig = tmp_path / "rig.toml"
    rig.write_text(changed(product.campaign_entry(journal, "rig"), (ONE_WAY, (old, new))), encoding="utf-8")
    assert "the model's hash differs" in product.refusal("run", "--resume", journal, "--rig", rig)
    assert journal.read_bytes() == before
    rig.write_text(changed(product.campaign_entry(journal, "rig"), (ONE_WAY,)), encoding="utf-8")
    assert product.answer("run", "--resume", journal, "--rig", rig)["state"] == "done"


def test_the_interrupted_one_with_the_hash_of_another_twin_is_not_resumed(journals: tuple[Path, Path], tmp_path: Path) -> None:
    rig = tmp_path / "rig.toml"
    rig.write_text(changed(product.campaign_entry(journals[1], "rig"), (ONE_WAY,)), encoding="utf-8")
    assert re.fullmatch(r'"[0-9a-f]{16}"', product.campaign_entry(journals[1], "model"))  # without the mark of a version
    product.change_campaign(journals[1], "model", product.campaign_entry(journals[0], "model"))
    assert "the model's hash differs" in product.refusal("run", "--resume", journals[1], "--rig", rig)


def test_they_know_no_folder_of_the_computer_that_made_them(journals: tuple[Path, Path]) -> None:
    for journal in journals:
        assert product.campaign_entry(journal, "rig_folder") == "."
