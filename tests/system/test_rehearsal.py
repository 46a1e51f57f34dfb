"""`goniotwin rehearse`: its options and output, and a campaign in real time against its rehearsal."""

from pathlib import Path

import pytest

from tests.conftest import RIG, Change, Writer
from tests.system.command import CALLS, Call, goniotwin, json_result
from tests.system.conftest import Serve


@pytest.mark.parametrize("call", CALLS)
def test_a_rehearsal_is_one_json_object_and_its_points_are_a_csv(write_schedule: Writer, tmp_path: Path, call: Call) -> None:
    schedule, kept, points = write_schedule(), tmp_path / "kept.journal", tmp_path / "points.csv"
    result = json_result(call("rehearse", schedule, "--rig", RIG, "--out", kept, "--points", points, "--json"))
    assert result["simulated"] is True
    assert result["rows"] == result["planned"]
    assert kept.stat().st_size == result["journal_bytes"]
    assert points.read_text(encoding="utf-8").startswith("# SIMULATED")


@pytest.mark.parametrize("call", CALLS)
def test_the_text_output_has_every_section_and_the_mark_simulated(write_schedule: Writer, call: Call) -> None:
    done = call("rehearse", write_schedule(), "--rig", RIG)
    assert done.returncode == 0
    assert done.stdout.startswith("SIMULATED: small rehearsed on virtual goniophotometer")
    for word in ("duration", "axes", "counts", "uncertainty", "lamp", "journal"):
        assert f"\n  {word}" in done.stdout


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--sample", "paper=lambertian"], "has no such sample"),
        (["--sample", "gaussian-5"], "write NAME=MODEL"),
        (["--sample", "gaussian-5=plaster"], "there is no model 'plaster'"),
        (["--sample", "etalon=lambertian", "--sample", "etalon=lambertian"], "is given twice"),
    ],
)
def test_wrong_samples_are_refused(write_schedule: Writer, options: list[str], message: str, call: Call) -> None:
    done = call("rehearse", write_schedule(), "--rig", RIG, *options)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
    assert done.stdout == ""


@pytest.mark.parametrize("call", CALLS)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--points", "absent/x.csv"], "--points absent/x.csv: there is no folder"),
        (["--points", "."], "--points .: is a folder"),
        (["--points", "x.ddr"], "--points x.ddr: the format ddr is not written here; give a name that ends with .csv"),
        (["--out", "absent/x.journal"], "--out absent/x.journal: there is no folder"),
        (["--out", "rig.toml"], "--out rig.toml: exists"),
        (["--points", "same", "--out", "./same"], "--points same: is the journal of --out"),
    ],
)
def test_files_that_cannot_be_written_are_refused_before_the_first_row(
    write_rig: Writer,
    write_schedule: Writer,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    options: list[str],
    message: str,
    call: Call,
) -> None:
    rig, schedule = write_rig(), write_schedule()
    before = sorted(tmp_path.iterdir())
    monkeypatch.chdir(tmp_path)
    done = call("rehearse", schedule, "--rig", rig, *options)
    assert done.returncode == 2
    assert message in " ".join(done.stderr.split())
    assert "rows" not in done.stderr
    assert sorted(tmp_path.iterdir()) == before


SIGMAS: tuple[Change, ...] = (
    ("sigma_deg = [30]", "sigma_deg = [0, 30, 60]"),
    ("[0, 1]", "[0]"),
    ("[1e8, 1e10]", "[1e8]"),
    ("readings = 2", "readings = 12"),
)
SHIFTS: tuple[Change, ...] = (("[0, 1]", "{ start = 0.0, stop = 4.5, step = 0.5 }"), ("readings = 2", "readings = 4"))


@pytest.mark.long
@pytest.mark.early
@pytest.mark.parametrize("rows", [SIGMAS, SHIFTS], ids=["rows of some seconds", "rows of a second"])
def test_a_campaign_in_real_time_takes_as_long_as_its_rehearsal(
    serve: Serve, write_schedule: Writer, tmp_path: Path, rows: tuple[Change, ...]
) -> None:
    """Over pseudo-terminals, TCP and USB/IP, at the speed of a real rig.

    What is longer in real time is an exchange with a busy process, a millisecond or two in place of 0.4 ms.
    """
    schedule = write_schedule(*rows, ("dark_readings = 4", "dark_readings = 16"))
    rig = tmp_path / "served.toml"
    rehearsed = json_result(goniotwin("rehearse", schedule, "--rig", RIG, "--json"))
    serve(RIG, "--speed", 1, "--write-rig", rig)
    done = json_result(goniotwin("run", schedule, "--rig", rig, "--out", tmp_path / "real.journal", "--json"))
    assert done["state"] == "done"
    assert done["duration_s"] == pytest.approx(rehearsed["duration_s"], rel=0.02)
    # With the twin that is built from the file of the served rig.
    again = json_result(goniotwin("rehearse", schedule, "--rig", rig, "--json"))
    assert again["duration_s"] == pytest.approx(done["duration_s"], rel=0.02)
