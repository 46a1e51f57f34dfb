"""`goniotwin new`: its questions, what it writes, and what it keeps."""

import io
import json
import shlex
from pathlib import Path

import pytest

from goniotwin.app.campaign.planning.templates import TEMPLATES
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from tests.conftest import RIG

ALL = ("--template", "gloss", "--sample", "gaussian-5", "--target-u", "0.02", "--longest-h", "1")


class Terminal(io.StringIO):
    """Standard input of a person who types these lines."""

    def isatty(self) -> bool:
        return True


def run_new(*arguments: object) -> None:
    app(["new", *map(str, arguments)], standalone_mode=False)


def test_with_all_answers_nothing_is_asked_and_the_next_commands_are_printed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "paint.toml"
    run_new(path, "--rig", RIG, *ALL)
    file = read_schedule(path).file
    assert (file.name, file.samples, file.etalon) == ("gaussian-5, gloss", ["gaussian-5"], "etalon")
    assert file.target is not None
    assert (file.target.relative_u, file.target.longest_h) == (0.02, 1.0)
    printed = capsys.readouterr()
    commands = [line.split("goniotwin ", 1)[1] for line in printed.out.splitlines() if "  next  " in line]
    assert [each.split()[0] for each in commands] == ["check", "rehearse", "run"]
    assert shlex.split(commands[2]) == ["run", str(path), "--rig", str(RIG), "--out", str(tmp_path / "paint.journal")]
    assert printed.err == ""
    app(shlex.split(commands[0]), standalone_mode=False)


def test_in_a_terminal_the_missing_answers_are_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("sys.stdin", Terminal(f"{RIG}\naspecular\ngaussian-5\nmuch\n0.02\n\n\n"))
    run_new()
    file = read_schedule(tmp_path / "gaussian-5.toml").file
    assert file.name == "gaussian-5, aspecular"
    assert file.target is not None
    assert (file.target.relative_u, file.target.longest_h) == (0.02, 4.0)
    asked = capsys.readouterr().err
    assert all(f"  {name:12}{each.title}" in asked for name, each in TEMPLATES.items())
    assert "Name of the sample (the virtual rig has gaussian-5, opal, white-tile):" in asked


def test_for_transmitted_light_the_reference_standard_is_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", Terminal("white-tile\n"))
    answers = ("--template", "transmitted", "--sample", "opal", "--target-u", "0.02", "--longest-h", "1")
    run_new(tmp_path / "opal.toml", "--rig", RIG, *answers)
    assert read_schedule(tmp_path / "opal.toml").file.etalon == "white-tile"


def test_without_a_terminal_missing_answers_are_bad_input(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO())
    with pytest.raises(UserError, match="new: --rig, --sample: missing; add this, or run the command in a terminal"):
        run_new(tmp_path / "x.toml", "--template", "gloss", "--target-u", "0.02", "--longest-h", "1")
    assert not any(tmp_path.iterdir())


def test_an_existing_file_is_kept_without_a_yes_or_force(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "paint.toml"
    path.write_text("mine", encoding="utf-8")
    for stdin in (io.StringIO(), Terminal("n\n"), Terminal("\n")):
        monkeypatch.setattr("sys.stdin", stdin)
        with pytest.raises(UserError, match=r"paint\.toml: exists, and is kept; choose another name"):
            run_new(path, "--rig", RIG, *ALL)
        assert path.read_text(encoding="utf-8") == "mine"
    monkeypatch.setattr("sys.stdin", Terminal("y\n"))
    run_new(path, "--rig", RIG, *ALL)
    assert read_schedule(path).file.samples == ["gaussian-5"]
    path.write_text("mine", encoding="utf-8")
    run_new(path, "--rig", RIG, *ALL, "--force")
    assert read_schedule(path).file.samples == ["gaussian-5"]


@pytest.mark.parametrize(("option", "value"), [("--template", "matt"), ("--sample", "a/b"), ("--sample", "paint")])
def test_what_cannot_be_measured_writes_no_file(option: str, value: str, tmp_path: Path) -> None:
    with pytest.raises(UserError):
        run_new(tmp_path / "x.toml", "--rig", RIG, *ALL, option, value)
    assert not any(tmp_path.iterdir())


def test_the_result_is_one_json_object_and_the_help_names_all_templates(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run_new(tmp_path / "x.toml", "--rig", RIG, *ALL, "--longest-h", "0.01", "--json")
    result = json.loads(capsys.readouterr().out)
    assert result["schedule"] == str(tmp_path / "x.toml")
    assert result["rows"] > 0
    assert "more than 0.01 h" in result["notes"][0]
    app(["new", "--help"], standalone_mode=False)
    words = capsys.readouterr().out.replace(",", " ").replace(".", " ").split()
    assert {*TEMPLATES} <= {*words}


def test_the_warnings_of_the_plan_are_printed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The usual reference standard reflects nothing of light on its back."""
    answers = ("--template", "transmitted", "--sample", "opal", "--target-u", "0.1", "--longest-h", "1", "--etalon", "etalon")
    run_new(tmp_path / "a.toml", "--rig", RIG, *answers)
    assert "etalon reflects nothing when its back is lit" in capsys.readouterr().out
