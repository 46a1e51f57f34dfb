"""A campaign rehearsed: the whole of it, through the real drivers, on the virtual clock."""

import gc
import json
import math
import tracemalloc
from pathlib import Path
from typing import Any

import pytest
import serial

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import Rehearsal, plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import report_text
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.formats import read_points_csv
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.lock import RigLock
from tests.conftest import Change, Writer

REAL = tuple(
    (f"twin://virtual/{name}", address)
    for name, address in (
        ("axes", "/dev/ttyACM0"), ("mono", "/dev/ttyUSB0"), ("monitor", "1313:8078:P0012345"),
        *((f"adc-{k}", f"adam-{k}:502") for k in range(5)),
    )
)  # fmt: skip
"""Where a real rig's devices are."""


def of_a_real_rig(write_rig: Writer, *changes: Change) -> Path:
    """The example's file with real addresses, and nothing in it of a virtual rig."""
    path = write_rig(*changes)
    text = path.read_text(encoding="utf-8").partition("# ---- what the virtual rig is")[0]
    text = text.replace("[simulated]\nseed = 1\n", "")
    for virtual, real in REAL:
        assert virtual in text
        text = text.replace(virtual, real)
    path.write_text(text, encoding="utf-8")
    return path


def rehearsed(schedule: Path, rig: Path, *, sample: str | None = None, out: Path | None = None) -> Rehearsal:
    """As `goniotwin rehearse` does it; `sample` is what gaussian-5 is in place of what the rig says."""
    models = {} if sample is None else {"gaussian-5": sample}
    return rehearse(*plan_rehearsal(read_schedule(schedule), read_rig(rig), models), out=out)


def warned(found: Rehearsal, words: str) -> list[str]:
    """The warnings with these words."""
    return [each for each in found.result["warnings"] if words in each]


@pytest.fixture
def small(write_rig: Writer, write_schedule: Writer) -> Rehearsal:
    return rehearsed(write_schedule(), write_rig())


def test_its_duration_is_the_journals_and_the_one_that_check_foretells(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    schedule, rig = write_schedule(), write_rig()
    found = rehearsed(schedule, rig, out=tmp_path / "kept.journal")
    foretold = check_plan(make_plan(read_schedule(schedule), read_rig(rig)))
    assert found.result["duration_s"] == pytest.approx(foretold["duration_s"], rel=0.05)
    with Journal.open(tmp_path / "kept.journal") as journal:
        assert found.result["duration_s"] == journal.seconds
        assert found.result["rows"] == found.result["planned"] == foretold["rows"] == len(list(journal.rows()))
        assert journal.simulated
    assert found.result["journal_bytes"] == (tmp_path / "kept.journal").stat().st_size


def test_its_blocks_make_up_the_whole(small: Rehearsal) -> None:
    blocks = small.result["blocks"]
    assert [block["name"] for block in blocks] == ["etalon", "gaussian-5"]
    assert sum(block["rows"] for block in blocks) == small.result["rows"]
    assert sum(block["duration_s"] for block in blocks) == pytest.approx(small.result["duration_s"], rel=1e-3)
    assert small.result["lamp_hours"] == pytest.approx(small.result["duration_s"] / 3600.0)


def test_it_says_where_the_axes_have_been_and_how_full_the_converters_were(small: Rehearsal) -> None:
    axes = small.result["axes_deg"]
    assert axes["sigma"] == pytest.approx([30.0, 30.0], abs=0.01)
    assert axes["shift"] == pytest.approx([0.0, 1.0], abs=0.01)
    counts = small.result["counts"]
    assert set(counts["share_of_range"]) == {"1e+08", "1e+10"}
    assert counts["share_of_range"]["1e+10"] == 1.0  # the peak is clipped there, and not at the lower gain
    assert 0.0 < counts["share_of_range"]["1e+08"] < 1.0
    assert counts["largest"] == 65535
    assert small.result["saturated"] == 0


def test_it_foretells_the_uncertainty_of_each_direction(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan, assumed = plan_rehearsal(read_schedule(write_schedule()), read_rig(write_rig()), {})
    spread = rehearse(plan, assumed, points=tmp_path / "points.csv").result["relative_uncertainty"]["gaussian-5"]
    assert 0.0 < spread["p05"] <= spread["p50"] <= spread["p95"]
    found = read_points_csv(tmp_path / "points.csv")
    assert found.comments[0].startswith("SIMULATED")
    columns = found.columns
    assert columns["bsdf_per_sr"].size == spread["directions"]
    peak = (columns["zenith_deg"] == 30.0) & (columns["azimuth_deg"] == 180.0)
    # Noise is small there: what is left is the etalon's certificate, the monitor's and the gains' uncertainty, 0.0025, and what
    # the field takes from the peak of a Gaussian of 5 deg, 2 * 0.0584 / 25.
    assert columns["relative_uncertainty"][peak] == pytest.approx(math.hypot(0.0025, 0.00467), abs=0.0004)


def test_what_it_says_is_json_and_says_that_it_is_simulated(small: Rehearsal) -> None:
    result: dict[str, Any] = json.loads(json.dumps(small.result, allow_nan=False))
    assert result["simulated"] is True
    assert result["state"] == "done"
    assert {"blocks", "counts", "saturated", "lamp_hours", "journal_bytes", "warnings", "assumed"} <= set(result)
    assert report_text(small).startswith("SIMULATED")


def test_nothing_of_a_real_rig_is_opened(write_rig: Writer, write_schedule: Writer, monkeypatch: pytest.MonkeyPatch) -> None:
    rig = of_a_real_rig(write_rig)
    opened: list[str] = []
    known = serial.serial_for_url

    def seen(url: str, **settings: Any) -> serial.Serial:
        opened.append(url)
        return known(url, **settings)

    monkeypatch.setattr(serial, "serial_for_url", seen)
    lock = RigLock(["/dev/ttyACM0"], "somebody measures")
    try:
        found = rehearsed(write_schedule(), rig)
    finally:
        lock.release()
    assert found.done
    assert opened
    assert all(url.startswith("twin://") for url in opened)
    assert any("gaussian-5 scatters as a Gaussian of 5 deg" in each for each in found.result["assumed"])


def test_axes_that_would_have_to_be_homed_are_taken_as_homed_and_told(write_rig: Writer, write_schedule: Writer) -> None:
    parked = "settling_s = 0.2\npower_up_at_reference = true\n\n[axes.beta]"
    found = rehearsed(write_schedule(), of_a_real_rig(write_rig, (parked, "settling_s = 0.2\n\n[axes.beta]")))
    assert found.done
    assert sum("sigma has been referenced" in each for each in found.result["assumed"]) == 1


def test_a_sample_of_another_name_than_the_schedules_is_refused(write_rig: Writer, write_schedule: Writer) -> None:
    with pytest.raises(UserError, match="has no such sample; it has etalon, gaussian-5"):
        plan_rehearsal(read_schedule(write_schedule()), read_rig(write_rig()), {"paper": "lambertian"})


def test_it_warns_of_a_lobe_narrower_than_the_field(write_rig: Writer, write_schedule: Writer) -> None:
    assert not warned(rehearsed(write_schedule(), write_rig()), "narrower")
    narrow = rehearsed(write_schedule(), write_rig(), sample="gaussian:width_deg=0.1,form=half_width")
    assert warned(narrow, "narrower than the photodiodes' field of 0.5 deg (at sigma 30 deg)")
    shiny = rehearsed(write_schedule(), write_rig(), sample="lambertian:reflectance=0.5+regular:reflectance=0.04")
    assert warned(shiny, "regular reflection")


def test_it_says_by_how_much_the_field_changes_the_values(write_rig: Writer, write_schedule: Writer) -> None:
    # In the plane of incidence at theta = 12 deg: half of 0.0584 deg^2 times 4 theta^2 / a^4 - 4 / a^2, which is 2.2 %.
    (told,) = warned(rehearsed(write_schedule(), write_rig()), "changes the values of gaussian-5")
    percent = float(told.partition("by up to ")[2].partition(" %")[0])
    theta = float(told.partition("theta ")[2].partition(" deg")[0])
    assert 10.0 < theta < 13.2  # a thousandth of the peak is at 13.1 deg
    assert percent == pytest.approx(100.0 * 0.5 * 0.0584 * (4.0 * theta**2 / 625.0 - 4.0 / 25.0), rel=0.15)
    wider = rehearsed(write_schedule(), write_rig(), sample="gaussian:width_deg=15,reflectance=0.9")
    assert not warned(wider, "changes the values of")


def test_it_warns_of_a_dark_sample_on_a_coarse_gain(write_rig: Writer, write_schedule: Writer) -> None:
    coarse = ("[1e8, 1e10]", "[1e8]")
    dark = "lambertian:reflectance=0.02"
    assert warned(rehearsed(write_schedule(coarse), write_rig(), sample=dark), "signal of gaussian-5 too low at 1e+08 V/A")
    assert not warned(rehearsed(write_schedule(("[1e8, 1e10]", "[1e11]")), write_rig(), sample=dark), "is dark")


def test_it_warns_of_a_hidden_specular_direction(write_rig: Writer, write_schedule: Writer) -> None:
    assert not warned(rehearsed(write_schedule(), write_rig()), "hides the specular")
    assert warned(rehearsed(write_schedule(("[30]", "[0, 30]")), write_rig()), "hides the specular")


def test_it_warns_of_values_over_the_range(write_rig: Writer, write_schedule: Writer) -> None:
    found = rehearsed(write_schedule(("[1e8, 1e10]", "[1e11]")), write_rig())
    assert found.result["saturated"] > 0
    assert warned(found, "saturated at every gain")


def test_it_does_not_warn_of_the_beam_itself_on_the_arc_that_does_not_matter(write_rig: Writer, write_schedule: Writer) -> None:
    """With nothing mounted the lower arc looks into the beam, at gains for reflected light."""
    signature = ("dark_readings = 4", "dark_readings = 4\nsignature = true")
    reflected = rehearsed(write_schedule(signature), write_rig())
    assert reflected.result["saturated"] == 0
    assert not warned(reflected, "saturated at every gain")
    light = ('name = "small"', 'name = "small"\nlight = "transmitted"')
    transmitted = rehearsed(write_schedule(signature, light), write_rig(), sample="lambertian:reflectance=0.9")
    assert warned(transmitted, "saturated at every gain")


@pytest.mark.long
def test_what_it_holds_does_not_grow_with_the_rows(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beyond the plan itself, which is there before the first row."""
    monkeypatch.setattr("goniotwin.twin.devices.usbtmc_transfers.LOG_KEPT", 50)  # which is full after few rows
    many = ("shift_deg = [0, 1]", "shift_deg = { start = 0.0, stop = 4.5, step = 0.03 }")
    once = (("readings = 2", "readings = 1"), ("[1e8, 1e10]", "[1e8]"))
    plan, assumed = plan_rehearsal(read_schedule(write_schedule(many, *once)), read_rig(write_rig()), {})
    held: dict[int, int] = {}

    def weigh(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done in (150, 290):
            gc.collect()
            held[event.done] = tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        rehearse(plan, assumed, out=tmp_path / "many.journal", listeners=[weigh])
    finally:
        tracemalloc.stop()
    # There are 140 rows in between, and the counts of one alone have 72 bytes.
    assert held[290] - held[150] < 140 * 72
