"""Rehearsal of a whole campaign, through the real drivers, on the virtual clock."""

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
from goniotwin.app.campaign.rehearsal.warnings import noise_remedy
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.formats import read_points_csv
from goniotwin.app.json_document import json_text
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.lock import RigLock
from tests.conftest import SMALL, Change, Writer

REAL = tuple(
    (f"twin://virtual/{name}", address)
    for name, address in (
        ("axes", "/dev/ttyACM0"),
        ("mono", "/dev/ttyUSB0"),
        ("monitor", "1313:8078:P0012345"),
        *((f"adc-{k}", f"adam-{k}:502") for k in range(5)),
    )
)
"""Addresses of a real rig's devices."""


def real_rig_file(write_rig: Writer, *changes: Change) -> Path:
    """The example's rig file with real addresses, without the tables of the virtual rig."""
    path = write_rig(*changes)
    text = path.read_text(encoding="utf-8").partition("# ---- what the virtual rig is")[0]
    text = text.replace("[simulated]\nseed = 1\n", "")
    for virtual, real in REAL:
        assert virtual in text
        text = text.replace(virtual, real)
    path.write_text(text, encoding="utf-8")
    return path


def run_rehearsal(schedule: Path, rig: Path, *, sample: str | None = None, out: Path | None = None) -> Rehearsal:
    """Rehearse as `goniotwin rehearse` does; `sample` is a model that replaces the rig's gaussian-5."""
    models = {} if sample is None else {"gaussian-5": sample}
    return rehearse(*plan_rehearsal(read_schedule(schedule), read_rig(rig), models), out=out)


def warnings_with(rehearsal: Rehearsal, words: str) -> list[str]:
    """The warnings that contain `words`."""
    return [each for each in rehearsal.result.warnings if words in each]


@pytest.fixture
def small(write_rig: Writer, write_schedule: Writer) -> Rehearsal:
    return run_rehearsal(write_schedule(), write_rig())


def test_the_duration_is_that_of_the_journal_and_close_to_the_one_estimated_by_check(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    schedule, rig = write_schedule(), write_rig()
    rehearsal = run_rehearsal(schedule, rig, out=tmp_path / "kept.journal")
    estimate = check_plan(make_plan(read_schedule(schedule), read_rig(rig)))
    assert rehearsal.result.duration_s == pytest.approx(estimate.duration_s, rel=0.05)
    with Journal.open(tmp_path / "kept.journal") as journal:
        assert rehearsal.result.duration_s == journal.seconds
        assert rehearsal.result.rows == rehearsal.result.planned == estimate.rows == len(list(journal.rows()))
        assert journal.simulated
    assert rehearsal.result.journal_bytes == (tmp_path / "kept.journal").stat().st_size


def test_the_blocks_add_up_to_the_whole_campaign(small: Rehearsal) -> None:
    blocks = small.result.blocks
    assert [block.name for block in blocks] == ["etalon", "gaussian-5"]
    assert sum(block.rows for block in blocks) == small.result.rows
    assert sum(block.duration_s for block in blocks) == pytest.approx(small.result.duration_s, rel=1e-3)
    assert small.result.lamp_hours == pytest.approx(small.result.duration_s / 3600.0)


def test_the_values_are_compared_with_the_truth_of_the_samples(small: Rehearsal) -> None:
    spread = small.result.relative_uncertainty["gaussian-5"]
    assert 0.85 <= spread.coverage <= 1.0
    assert 0.0 < spread.worst_u < 5.0
    assert "within their 95 % interval of the truth, the worst" in report_text(small)


def test_the_ranges_of_axes_and_counts_are_reported(small: Rehearsal) -> None:
    axes = small.result.axes_deg
    assert axes["sigma"] == pytest.approx([30.0, 30.0], abs=0.01)
    assert axes["shift"] == pytest.approx([0.0, 1.0], abs=0.01)
    counts = small.result.counts
    assert set(counts.share_of_range) == {"1e+08", "1e+10"}
    assert counts.share_of_range["1e+10"] == 1.0  # the peak is saturated at this gain, not at the lower one
    assert 0.0 < counts.share_of_range["1e+08"] < 1.0
    assert counts.largest == 65535
    assert small.result.saturated == 0


def test_the_uncertainty_of_each_direction_is_predicted(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan, assumed = plan_rehearsal(read_schedule(write_schedule()), read_rig(write_rig()), {})
    spread = rehearse(plan, assumed, points=tmp_path / "points.csv").result.relative_uncertainty["gaussian-5"]
    assert 0.0 < spread.p05 <= spread.p50 <= spread.p95
    table = read_points_csv(tmp_path / "points.csv")
    assert table.comments[0].startswith("SIMULATED")
    columns = table.columns
    assert columns["bsdf_per_sr"].size == spread.directions
    peak = (columns["zenith_deg"] == 30.0) & (columns["azimuth_deg"] == 180.0)
    # Noise is small at the peak. The components are the etalon's certificate, the monitor and the gains, together 0.0025; the
    # etalon's age and its edges, 0.001 and 0.002; 0.001 for each decade from the etalon's light to the peak's; 12 % of the
    # field's effect on the peak of a Gaussian of 5 deg, 2 * 0.0584 / 25; the second order of an angle unknown to 0.094 deg
    # on each of two axes; and two lifts of 0.1 mm, seen at 30 deg, of a spot whose light falls by 0.14 / mm^2 of the way that
    # the sensor's tilt of 0.05 deg at 300 mm, and shifts of 0.1 mm along the arc of sensor and arc, move the discs.
    second_order = math.sqrt(2.0) * 0.094**2 * 2.0 / 25.0
    linearity = 0.001 * math.log10(math.pi * columns["bsdf_per_sr"][peak][0])
    discs_mm = math.hypot(300.0 * math.radians(0.05), 0.1, 0.1) / math.sqrt(3.0)
    lifts = 2.0 * 0.14 * discs_mm * math.sin(math.radians(30.0)) * math.sqrt(2.0) * 0.1 / math.sqrt(3.0)
    expected = math.hypot(0.0025, 0.001, 0.002, linearity, 0.12 * 0.00467, second_order, lifts)
    assert columns["relative_uncertainty"][peak] == pytest.approx(expected, abs=0.0004)


def test_the_result_is_json_and_marked_as_simulated(small: Rehearsal) -> None:
    result: dict[str, Any] = json.loads(json_text(small.result))
    assert result["simulated"] is True
    assert result["state"] == "done"
    assert {"blocks", "counts", "saturated", "lamp_hours", "journal_bytes", "warnings", "assumed"} <= set(result)
    assert report_text(small).startswith("SIMULATED")


def test_a_target_is_compared_with_the_predicted_u_of_each_decade(write_rig: Writer, tmp_path: Path) -> None:
    """The peak of the lobe of 5 deg is known to 0.4 %; on its flank an angle that is off by 0.1 deg makes 3 %."""
    schedule, rig = tmp_path / "target.toml", write_rig()
    found = {}
    for relative_u, share in ((0.01, 0.97), (0.001, 0.001)):
        target = f"[target]\nrelative_u = {relative_u}\nabove_peak_share = {share}\n"
        schedule.write_text(f"{SMALL}\n{target}", encoding="utf-8")
        found[relative_u] = run_rehearsal(schedule, rig)
    met, missed = found[0.01], found[0.001]
    assert [each.met for each in met.result.target["gaussian-5"]] == [True]
    assert "  target      gaussian-5: u (k = 1) of at most 1 %: to 1e-1 of the peak: " in report_text(met)
    assert not warnings_with(met, "[target]")
    decades = missed.result.target["gaussian-5"]
    assert sum(each.within for each in decades) < sum(each.values for each in decades)
    assert warnings_with(missed, "gaussian-5 misses [target] relative_u = 0.001: ")
    assert json.loads(json_text(missed.result))["target"]["gaussian-5"][0]["met"] is False
    assert missed.done


def test_without_a_target_nothing_is_said_about_it(small: Rehearsal) -> None:
    assert small.result.target == {}
    assert "  target  " not in report_text(small)


def test_no_port_and_no_lock_of_a_real_rig_is_used(
    write_rig: Writer, write_schedule: Writer, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = real_rig_file(write_rig)
    opened: list[str] = []
    original = serial.serial_for_url

    def record(url: str, **settings: Any) -> serial.Serial:
        opened.append(url)
        return original(url, **settings)

    monkeypatch.setattr(serial, "serial_for_url", record)
    lock = RigLock(["/dev/ttyACM0"], "another measurement")
    try:
        rehearsal = run_rehearsal(write_schedule(), rig)
    finally:
        lock.release()
    assert rehearsal.done
    assert opened
    assert all(url.startswith("twin://") for url in opened)
    assert any("gaussian-5 scatters as a Gaussian of 5 deg" in each for each in rehearsal.result.assumed)


def test_unreferenced_axes_are_assumed_as_referenced_and_listed(write_rig: Writer, write_schedule: Writer) -> None:
    parked = "settling_s = 0.2\npower_up_at_reference = true\n\n[axes.beta]"
    rehearsal = run_rehearsal(write_schedule(), real_rig_file(write_rig, (parked, "settling_s = 0.2\n\n[axes.beta]")))
    assert rehearsal.done
    assert sum("sigma has been referenced" in each for each in rehearsal.result.assumed) == 1


def test_a_sample_that_is_not_in_the_schedule_is_refused(write_rig: Writer, write_schedule: Writer) -> None:
    with pytest.raises(UserError, match="has no such sample; it has etalon, gaussian-5"):
        plan_rehearsal(read_schedule(write_schedule()), read_rig(write_rig()), {"paper": "lambertian"})


def test_a_lobe_narrower_than_the_field_gives_a_warning(write_rig: Writer, write_schedule: Writer) -> None:
    assert not warnings_with(run_rehearsal(write_schedule(), write_rig()), "narrower")
    narrow = run_rehearsal(write_schedule(), write_rig(), sample="gaussian:width_deg=0.1,form=half_width")
    assert warnings_with(narrow, "narrower than the photodiodes' field of 0.5 deg (at sigma 30 deg)")
    shiny = run_rehearsal(write_schedule(), write_rig(), sample="lambertian:reflectance=0.5+regular:reflectance=0.04")
    assert warnings_with(shiny, "regular reflection")


def test_a_warning_gives_the_change_of_the_values_by_the_field(write_rig: Writer, write_schedule: Writer) -> None:
    # In the plane of incidence at theta = 12 deg: half of 0.0584 deg^2 times 4 theta^2 / a^4 - 4 / a^2, which is 2.2 %.
    (warning,) = warnings_with(run_rehearsal(write_schedule(), write_rig()), "changes the values of gaussian-5")
    percent = float(warning.partition("by up to ")[2].partition(" %")[0])
    theta = float(warning.partition("theta ")[2].partition(" deg")[0])
    assert 10.0 < theta < 13.2  # a thousandth of the peak is at 13.1 deg
    assert percent == pytest.approx(100.0 * 0.5 * 0.0584 * (4.0 * theta**2 / 625.0 - 4.0 / 25.0), rel=0.15)
    wider = run_rehearsal(write_schedule(), write_rig(), sample="gaussian:width_deg=15,reflectance=0.9")
    assert not warnings_with(wider, "changes the values of")


def test_a_dark_sample_at_a_low_gain_gives_a_warning(write_rig: Writer, write_schedule: Writer) -> None:
    coarse = ("[1e8, 1e10]", "[1e8]")
    dark = "lambertian:reflectance=0.02"
    assert warnings_with(
        run_rehearsal(write_schedule(coarse), write_rig(), sample=dark), "signal of gaussian-5 too low at 1e+08 V/A"
    )
    assert not warnings_with(run_rehearsal(write_schedule(("[1e8, 1e10]", "[1e11]")), write_rig(), sample=dark), "too low at")


def test_a_blocked_specular_direction_gives_a_warning(write_rig: Writer, write_schedule: Writer) -> None:
    assert not warnings_with(run_rehearsal(write_schedule(), write_rig()), "blocks the specular")
    assert warnings_with(run_rehearsal(write_schedule(("[30]", "[0, 30]")), write_rig()), "blocks the specular")


def test_saturated_values_give_a_warning(write_rig: Writer, write_schedule: Writer) -> None:
    rehearsal = run_rehearsal(write_schedule(("[1e8, 1e10]", "[1e11]")), write_rig())
    assert rehearsal.result.saturated > 0
    assert warnings_with(rehearsal, "saturated at every gain")


def test_the_direct_beam_on_an_arc_that_is_not_measured_gives_no_warning(write_rig: Writer, write_schedule: Writer) -> None:
    """Without a sample the lower arc looks into the beam, at gains for reflected light."""
    signature = ("dark_readings = 4", "dark_readings = 4\nsignature = true")
    reflected = run_rehearsal(write_schedule(signature), write_rig())
    assert reflected.result.saturated == 0
    assert not warnings_with(reflected, "saturated at every gain")
    light = ('name = "small"', 'name = "small"\nlight = "transmitted"')
    transmitted = run_rehearsal(write_schedule(signature, light), write_rig(), sample="lambertian:reflectance=0.9")
    assert warnings_with(transmitted, "saturated at every gain")


@pytest.mark.long
def test_the_memory_of_a_rehearsal_does_not_grow_with_the_rows(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Apart from the plan, which exists before the first row."""
    many = ("shift_deg = [0, 1]", "shift_deg = { start = 0.0, stop = 4.5, step = 0.004 }")
    once = (("readings = 2", "readings = 1"), ("[1e8, 1e10]", "[1e8]"))
    plan, assumed = plan_rehearsal(read_schedule(write_schedule(many, *once)), read_rig(write_rig()), {})
    memory: dict[int, int] = {}

    def record_memory(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done in (1500, 2060):
            gc.collect()
            memory[event.done] = tracemalloc.get_traced_memory()[0]

    tracemalloc.start()
    try:
        rehearse(plan, assumed, out=tmp_path / "many.journal", listeners=[record_memory])
    finally:
        tracemalloc.stop()
    # The counts of one row alone take 72 bytes; there are 560 rows in between. The light of 512 poses is kept, the fields of
    # 1024 frames and 2000 transfers of the monitor, which are full by then; caches vary by some 10 kB.
    assert memory[2060] - memory[1500] < 560 * 72


def test_a_setting_that_is_mostly_below_detection_is_named_with_what_to_change(
    write_rig: Writer, write_schedule: Writer
) -> None:
    """It runs to its end without a fault, and tells little of the sample."""
    rehearsal = run_rehearsal(write_schedule(("[1e8, 1e10]", "[1e8]")), write_rig())
    assert rehearsal.done
    spread = rehearsal.result.relative_uncertainty["gaussian-5"]
    (below,) = spread.mostly_below
    assert below.setting == "550 nm, sigma 30 deg"
    assert 0.5 * below.values < below.below == spread.below_detection
    text = f"gaussian-5: {below.below} of {below.values} directions are below the detection limit at 550 nm, sigma 30 deg. Add"
    assert [each.partition(" 1e11 V/A to gains_v_per_a")[0] for each in rehearsal.result.missed] == [text]
    assert rehearsal.result.missed[0] in rehearsal.result.warnings
    assert f", {below.below} below the detection limit, " in report_text(rehearsal)
    wide = run_rehearsal(
        write_schedule(), write_rig(), sample="gaussian:width_deg=15,reflectance=0.9+lambertian:reflectance=0.1"
    )
    assert not wide.result.missed


def test_a_duration_beyond_the_target_and_a_sample_without_values_are_missed(write_rig: Writer, tmp_path: Path) -> None:
    schedule = tmp_path / "long.toml"
    text = SMALL.replace("[1e8, 1e10]", "[1e6]").replace("readings = 2", "readings = 3", 1)
    schedule.write_text(f"{text}\n[target]\nrelative_u = 0.1\nlongest_h = 0.001\n", encoding="utf-8")
    rehearsal = run_rehearsal(schedule, write_rig())
    no_value, duration = rehearsal.result.missed
    assert no_value.startswith("gaussian-5 has no values: of 36 directions 36 are without a signal of the etalon")
    assert "more than [target] longest_h = 0.001. Take coarser grids" in duration
    assert len(warnings_with(rehearsal, "longest_h")) == 1


@pytest.mark.parametrize(
    ("change", "remedy"),
    [
        (("[1e8, 1e10]", "[1e8]"), "Add 1e11 V/A to gains_v_per_a"),
        (("[1e8, 1e10]", "[1e11]"), "Set readings above 2, or add [averaging] for faint light"),
        (
            ("[1e8, 1e10]", '"automatic"\naveraging = { relative_uncertainty = 0.01 }'),
            "In [averaging] set longest_s above 10, or relative_uncertainty below 0.01",
        ),
    ],
)
def test_the_remedy_against_noise_is_a_higher_gain_and_else_more_readings(
    write_rig: Writer, write_schedule: Writer, change: tuple[str, str], remedy: str
) -> None:
    assert noise_remedy(read_schedule(write_schedule(change)).file, read_rig(write_rig()).file) == remedy
