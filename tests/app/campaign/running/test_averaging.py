"""Averaging to a target uncertainty or a time limit, and the warm-up of the lamp."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.readout import MIN_AVERAGED_READINGS, NOT_WARM, WarmUpTrace, readings_needed, saturation
from goniotwin.app.campaign.reduction.signals import middle_s
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import OpenRig, read_rig
from goniotwin.protocols import adam
from tests.app.campaign.campaign_bench import QUIET, RunResult, change_rows, planned_values, run_plan, run_until
from tests.conftest import Writer

ONE_GAIN = ("[1e8, 1e10]", "[1e11]")


def test_few_readings_request_at_most_four_times_their_number() -> None:
    """Four readings estimate that hundreds are needed; at most four times their number are requested."""
    counts = np.array([[1016], [1024], [1020], [1020]], dtype=np.uint16)
    dark, selected = np.array([1000.0]), np.array([True])
    whole = counts.var(axis=0, ddof=1)[0] / (0.01 * 20.0) ** 2
    assert 200 < whole < 300
    assert readings_needed(counts, dark, selected, 0.01, 1000) == 4 * len(counts)
    assert readings_needed(np.repeat(counts, 20, axis=0), dark, selected, 0.01, 1000) == pytest.approx(whole, rel=0.3)


def averaged(target: float, longest_s: float) -> Callable[[Row], Row]:
    def change(row: Row) -> Row:
        return replace(row, target=target, longest_s=longest_s) if row.kind == "measure" else row

    return change


def dim_plan(write_rig: Writer, write_schedule: Writer, target: float, longest_s: float, radiance: float = 20.0) -> Plan:
    """Plan with one hundredth of the light, so that noise dominates."""
    rig = write_rig(("[twin.light]", f"[twin.light]\nradiance = {radiance}"))
    plan = make_plan(read_schedule(write_schedule(ONE_GAIN)), read_rig(rig))
    return change_rows(plan, averaged(target, longest_s))


def uncertainties(run: RunResult, plan: Plan) -> list[np.ndarray]:
    """Relative uncertainties of the etalon's upper photodiodes in each row, from their scatter."""
    dark = run.of("dark")[0].data.readings[0].counts.mean(axis=0)[:17]
    found = []
    for each in run.of("measure", "etalon"):
        counts = each.data.readings[0].counts[:, :17].astype(float)
        found.append(counts.std(axis=0, ddof=1) / np.sqrt(len(counts)) / np.abs(counts.mean(axis=0) - dark))
    return found


def test_a_row_is_averaged_to_its_target_uncertainty(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = dim_plan(write_rig, write_schedule, 0.01, 20.0)
    run = run_plan(plan, tmp_path / "a.journal")
    settings = plan.rig.file.photodiodes
    for each, found in zip(run.of("measure", "etalon"), uncertainties(run, plan), strict=True):
        taken = len(each.data.readings[0].counts)
        assert MIN_AVERAGED_READINGS < taken < 20.0 / settings.period_s
        assert (found <= 0.0101).sum() >= 16


def test_the_time_limit_ends_the_averaging(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = dim_plan(write_rig, write_schedule, 0.005, 2.0)
    settings = plan.rig.file.photodiodes
    for each in run_plan(plan, tmp_path / "a.journal").of("measure"):
        assert len(each.data.readings[0].counts) <= 2.0 / settings.period_s


def test_bright_photodiodes_take_the_fewest_readings(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = dim_plan(write_rig, write_schedule, 0.01, 20.0, 2000.0)
    run = run_plan(plan, tmp_path / "a.journal")
    assert [len(each.data.readings[0].counts) for each in run.of("measure", "etalon")] == [
        MIN_AVERAGED_READINGS,
        MIN_AVERAGED_READINGS,
    ]


def test_saturated_photodiodes_and_those_without_light_need_no_further_readings() -> None:
    rng = np.random.default_rng(1)
    counts = np.round(rng.normal([40_000.0, 33_000.0, 65_600.0], [10.0, 10.0, 0.0], (8, 3))).clip(0, 65_535).astype(np.uint16)
    dark = np.full(3, 33_000.0)
    selected = ~saturation(counts, adam.RANGES[adam.PLUS_MINUS_10_V])
    assert readings_needed(counts, dark, selected, 0.01, 1000) == 8
    assert 8 < readings_needed(counts, dark, selected, 0.0002, 1000) <= 1000


def test_a_merged_reading_has_the_mean_time_of_both(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    run = run_plan(dim_plan(write_rig, write_schedule, 0.01, 20.0), tmp_path / "a.journal")
    for each in run.of("measure", "etalon"):
        reading = each.data.readings[0]
        assert each.data.started_s < reading.first_s < middle_s(reading) < each.data.ended_s - reading.period_s


def test_a_resumed_campaign_takes_the_same_number_of_readings(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    rig = write_rig(*QUIET)
    plan = change_rows(make_plan(read_schedule(write_schedule(ONE_GAIN)), read_rig(rig)), averaged(1e-3, 3.0))
    run_campaign(plan, tmp_path / "whole.journal")
    run_until(plan, tmp_path / "a.journal", 0.5 * plan.seconds)
    resume_campaign(tmp_path / "a.journal")
    assert planned_values(tmp_path / "a.journal") == planned_values(tmp_path / "whole.journal")


# ---- warm-up of the lamp ----


def add_warm_up(plan: Plan, target: float, longest_s: float) -> Plan:
    def change(row: Row) -> Row | list[Row]:
        if row.number:
            return row
        return [row, Row(0, "warm-up", "warm-up", row.sample, wavelength_nm=550.0, target=target, longest_s=longest_s)]

    return change_rows(plan, change)


def test_the_warm_up_lasts_until_the_lamp_is_steady(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """The lamp drifts by 3 % in ten minutes; after five minutes it is steady."""
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(QUIET[0], ("= 0.02", "= 0.18"))))

    def stop_drift(opened: OpenRig) -> None:
        assert opened.virtual is not None
        plant = opened.virtual.plant
        opened.rig.clock.at(300.0, lambda: plant.set_lamp(300.0, drift_per_hour=0.0))

    run = run_plan(add_warm_up(plan, 0.002, 3600.0), tmp_path / "a.journal", stop_drift)
    (row,) = run.of("warm-up")
    assert row.data.flags == ()
    # Ten minutes after the end of the drift the fitted line over the last ten minutes is level; slightly earlier it nearly is.
    assert 600.0 < row.data.ended_s - row.data.started_s < 920.0
    texts = [text for kind, text in run.events if kind == "warm-up"]
    assert len(texts) >= 10
    assert "+2.995 %" in texts[0]
    assert "% in 10 min" in texts[0]


def test_a_lamp_that_stays_unsteady_is_flagged(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(QUIET[0], ("= 0.02", "= 0.18"))))
    run = run_plan(add_warm_up(plan, 0.002, 200.0), tmp_path / "a.journal")
    (row,) = run.of("warm-up")
    assert row.data.flags == (NOT_WARM,)
    assert row.data.ended_s - row.data.started_s == pytest.approx(200.0, abs=15.0)


def test_noise_is_not_a_slope_and_does_not_hide_one() -> None:
    rng = np.random.default_rng(2)
    for drift, expected in ((0.0, True), (0.02, False)):
        trace = WarmUpTrace()
        for k in range(60):
            t = 10.0 * k
            trace.add(t, 1e-7 * (1.0 + drift * t / 600.0 + 1e-3 * rng.normal()))
        assert trace.is_steady(0.005) is expected
