"""The command `goniotwin`: demo, run, check, export, help, and refusals of wrong input."""

import re
import sqlite3
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.rig.samples import parse_sample
from goniotwin.examples import FIRST_RIG, FIRST_SCHEDULE
from goniotwin.twin.optics import albedo
from tests.conftest import RIG, Change, Writer
from tests.system.command import (
    CALLS,
    Call,
    goniotwin,
    in_one_thread,
    invoke,
    json_result,
    process_in_one_thread,
    process_in_two_threads,
)


def test_the_demo_reports_uncertainty_and_deviation_from_theory(demo_run: tuple[Path, dict[str, Any]]) -> None:
    folder, result = demo_run
    assert result["simulated"] is True
    sample = parse_sample("gaussian:width_deg=12,reflectance=0.4+lambertian:reflectance=0.3")
    assert [each["sigma_deg"] for each in result["lights"]] == [30.0, 60.0]
    for each in result["lights"]:
        assert 0.0 < each["relative_rms_percent"] < 0.5
        # The values have inputs in common, so chi-square is below its degrees where these happen to be small.
        assert each["chi_square"] < 1.3 * each["directions"]
        assert each["reflectance"]["value"] == pytest.approx(
            albedo(sample, each["sigma_deg"]), abs=2.0 * each["reflectance"]["u"]
        )
        assert each["specular_per_sr"]["u"] < 0.01 * each["specular_per_sr"]["value"]
    for name in ("journal", "csv", "html"):
        assert (folder / f"first.{name}").stat().st_size > 1000
    assert (folder / "first.png").read_bytes().startswith(b"\x89PNG")


def test_check_predicts_the_duration_of_the_journal(demo_run: tuple[Path, dict[str, Any]]) -> None:
    predicted = json_result(invoke("check", FIRST_SCHEDULE, "--rig", FIRST_RIG, "--json"))
    assert predicted["rows"] == demo_run[1]["rows"]
    assert predicted["duration_s"] == pytest.approx(demo_run[1]["duration_s"], rel=0.01)
    database = sqlite3.connect(demo_run[0] / "first.journal")
    (seconds,) = database.execute("SELECT MAX(ended_s) - MIN(started_s) FROM attempt").fetchone()
    database.close()
    assert seconds == pytest.approx(predicted["duration_s"], rel=0.01)


def test_every_wire_of_the_demo_has_a_transcript(demo_run: tuple[Path, dict[str, Any]]) -> None:
    wires = {path.stem: path.read_text(encoding="utf-8") for path in (demo_run[0] / "wires").iterdir()}
    assert set(wires) == {"axes", "monochromator", "monitor", *(f"photodiodes-{k}" for k in range(5))}
    line = re.compile(r" *\d+\.\d{6} [<>] ([0-9a-f]{2} )+ \| .*")
    for text in wires.values():
        lines = text.splitlines()[1:]
        assert lines
        assert all(line.fullmatch(each) for each in lines)
        times = [float(each.split()[0]) for each in lines]
        assert times == sorted(times)
    assert "MVP ABSOLUTE motor 4" in wires["axes"]
    assert "'GOWAVE 550.000\\n'" in wires["monochromator"]
    assert "'READ?\\n'" in wires["monitor"]
    # Each request has a response.
    assert wires["axes"].count(" > ") == wires["axes"].count(" < ")


def dump_journal(path: Path) -> list[str]:
    """A journal as SQL text, without its wall-clock times, and without the checksum of a session, in which they are."""
    database = sqlite3.connect(path)
    lines = [re.sub(r"'\d{4}-\d\d-\d\dT[^']*'", "'stamp'", line) for line in database.iterdump()]
    lines = [re.sub(r"(?s)^(INSERT INTO \"session\".*)'[0-9a-f]{64}'\);$", r"\1'sum');", line) for line in lines]
    database.close()
    return lines


@pytest.mark.parametrize(
    "again",
    [
        pytest.param(in_one_thread, id="in one thread"),
        pytest.param(process_in_one_thread, id="in a process with one thread", marks=pytest.mark.long),
        pytest.param(process_in_two_threads, id="in a process with two threads", marks=pytest.mark.long),
    ],
)
def test_the_same_seed_gives_the_same_journal_on_any_number_of_threads(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, again: Call
) -> None:
    rig, schedule = write_rig(), write_schedule()
    json_result(invoke("run", schedule, "--rig", rig, "--out", tmp_path / "here.journal", "--json"))
    json_result(again("run", schedule, "--rig", rig, "--out", tmp_path / "there.journal", "--json"))
    assert dump_journal(tmp_path / "here.journal") == dump_journal(tmp_path / "there.journal")
    other = write_rig(("seed = 1", "seed = 2"), name="other.toml")
    json_result(invoke("run", schedule, "--rig", other, "--out", tmp_path / "other.journal", "--json"))
    assert dump_journal(tmp_path / "other.journal") != dump_journal(tmp_path / "here.journal")


@pytest.mark.parametrize("call", CALLS)
def test_a_run_leaves_one_file_which_can_be_exported(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, call: Call
) -> None:
    journal = tmp_path / "a.journal"
    result = json_result(call("run", write_schedule(), "--rig", write_rig(), "--out", journal, "--json"))
    assert result["state"] == "done"
    assert result["rows"] == result["planned"]
    assert sorted(path.name for path in tmp_path.glob("a.journal*")) == ["a.journal"]  # one file and no auxiliary files
    before = journal.read_bytes()
    for name in ("ddr", "csv"):
        exported = json_result(call("export", journal, "--format", name, "--out", tmp_path / f"a.{name}", "--json"))
        assert exported["values"] > 0
        assert exported["simulated"] is True
        assert "SIMULATED" in (tmp_path / f"a.{name}").read_text(encoding="utf-8")
    assert journal.read_bytes() == before


BAD: list[tuple[Change | None, Change | None, str]] = [
    (("gear = 36.0\nlower", "gaer = 36.0\nlower"), None, "gaer"),
    (None, ("sigma_deg", "sigma_dge"), "sigma_dge"),
    (None, ("shift_deg = [0, 1]", "shift_deg = [0, 9]"), "shift_deg: 9 deg"),
    (('port = "twin://virtual/axes"', 'port = "/dev/tty-that-is-not-there"'), None, "/dev/tty-that-is-not-there"),
    (('"twin://virtual/adc-3"', '"twin://virtual/adc-33"'), None, "adc-33"),
    (('usb = "twin://virtual/monitor"', 'usb = "nonsense"'), None, "monitor.usb: 'nonsense'"),
    (
        (
            'model = "gaussian"\nwidth_deg = 5.0\nform = "one_over_e"\nquantity = "luminance"\nreflectance = 0.9',
            'model = "zemax"\nfile = "broken.bsdf"',
        ),
        None,
        "broken.bsdf",
    ),
]


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(("rig_change", "schedule_change", "named"), BAD)
def test_bad_input_is_one_line_and_leaves_no_journal(
    write_rig: Writer,
    write_schedule: Writer,
    tmp_path: Path,
    call: Call,
    rig_change: Change | None,
    schedule_change: Change | None,
    named: str,
) -> None:
    (tmp_path / "broken.bsdf").write_text("Source Measured\nSymmetry PlaneSymmetrical\n", encoding="utf-8")
    rig = write_rig(*([rig_change] if rig_change else []))
    schedule = write_schedule(*([schedule_change] if schedule_change else []))
    done = call("run", schedule, "--rig", rig, "--out", tmp_path / "a.journal", "--json")
    assert done.returncode == 2
    assert named in done.stderr
    assert done.stdout == ""
    assert len(done.stderr.strip().splitlines()) == 1
    assert "Traceback" not in done.stderr
    assert list(tmp_path.glob("a.journal*")) == []


def test_a_data_file_without_its_suffix_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    done = invoke("run", "missing.toml", "--rig", "missing.toml", "--out", tmp_path / "first")
    assert done.returncode == 2
    assert f"write --out {tmp_path / 'first'}.journal" in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize("command", [[], ["run"], ["check"], ["export"], ["demo"], ["desktop"], ["home"], ["here"]])
def test_each_command_has_help(command: list[str], call: Call) -> None:
    done = call(*command, "--help")
    assert done.returncode == 0
    assert "Usage" in done.stdout
    assert len(done.stdout.splitlines()) > 8


@pytest.mark.parametrize("call", CALLS)
def test_a_wrong_option_is_status_2(call: Call) -> None:
    assert call("run", "--nonsense").returncode == 2
    assert call("export", "nothing.journal", "--format", "ddr", "--out", "x").returncode == 2


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["run", "--nonsense"],
        pytest.param(["check", "nothing.toml", "--rig", RIG], id="check", marks=pytest.mark.long),
    ],
)
def test_a_process_ends_as_a_call_in_this_process_does(arguments: list[object]) -> None:
    called, own = invoke(*arguments), goniotwin(*arguments)
    assert (own.returncode, own.stderr) == (called.returncode, called.stderr)
    # Before that is the program's name, which in this process is pytest's.
    assert own.stdout.partition("[OPTIONS]")[2] == called.stdout.partition("[OPTIONS]")[2]
