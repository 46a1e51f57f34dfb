"""Auto-range: a row is read at every gain that a photodiode needs, and at no other."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.readout import SATURATED, UNDER_RANGE, GainSequence, gain_order, saturation
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import read_rig
from goniotwin.drivers import PhotodiodeSettings
from goniotwin.protocols import adam
from tests.app.campaign.campaign_bench import QUIET, change_rows, planned_values, run_plan, run_until
from tests.conftest import Writer

ALL_GAINS = ("[1e8, 1e10]", "[1e6, 1e8, 1e10, 1e11]")
BRIGHT = ("[twin.light]", "[twin.light]\nradiance = {radiance}")


def auto_range(row: Row) -> Row:
    return replace(row, automatic=True) if row.kind == "measure" else row


@pytest.fixture
def plan(write_rig: Writer, write_schedule: Writer) -> Plan:
    return change_rows(make_plan(read_schedule(write_schedule(ALL_GAINS)), read_rig(write_rig(*QUIET))), auto_range)


def test_the_etalon_needs_only_the_highest_gain_and_a_lobe_also_lower_ones(plan: Plan, tmp_path: Path) -> None:
    run = run_plan(plan, tmp_path / "a.journal")
    gains = {
        sample: [[reading.gain_v_per_a for reading in each.data.readings] for each in run.of("measure", sample)]
        for sample in ("etalon", "gaussian-5")
    }
    assert gains["etalon"] == [[1e11], [1e11]]
    # The peak is 2.8 nA: 28 V at 1e10 V/A, 0.28 V at 1e8.
    assert gains["gaussian-5"] == [[1e8, 1e10, 1e11]] * 2
    assert all(each.data.flags == () for each in run.rows)


def test_a_photodiode_is_saturated_at_every_gain_but_the_last(plan: Plan, tmp_path: Path) -> None:
    converter = plan.rig.file.photodiodes.range
    for each in run_plan(plan, tmp_path / "a.journal").of("measure"):
        lowest, *higher = each.data.readings
        assert not saturation(lowest.counts, converter).any()
        assert all(saturation(reading.counts, converter).any() for reading in higher)


def test_the_bsdf_is_that_of_readings_at_all_gains(plan: Plan, tmp_path: Path) -> None:
    everything = change_rows(plan, lambda row: replace(row, automatic=False))
    found = []
    for name, each in (("some", plan), ("all", everything)):
        run_campaign(each, tmp_path / f"{name}.journal")
        with Journal.open(tmp_path / f"{name}.journal") as journal:
            found.append(reduce_journal(journal).samples["gaussian-5"])
    # The evidence of both gains, where both were read, may change the last bit of a ratio.
    assert np.allclose(found[0].bsdf, found[1].bsdf, rtol=1e-15, atol=0.0, equal_nan=True)
    assert not found[0].flag("clipped").any()


def test_a_row_saturated_at_the_lowest_gain_is_flagged(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    rig = write_rig(*QUIET, (BRIGHT[0], BRIGHT[1].format(radiance="2e5")))
    schedule = write_schedule(("[1e8, 1e10]", "[1e8, 1e10, 1e11]"))
    run = run_plan(change_rows(make_plan(read_schedule(schedule), read_rig(rig)), auto_range), tmp_path / "a.journal")
    assert [each.data.flags for each in run.of("measure", "gaussian-5")] == [(SATURATED,)] * 2
    assert [each.data.flags for each in run.of("measure", "etalon")] == [()] * 2


@pytest.mark.parametrize("share", [pytest.param(0.3, marks=pytest.mark.long), 0.6, pytest.param(0.8, marks=pytest.mark.long)])
def test_a_resumed_campaign_uses_the_same_gains(plan: Plan, tmp_path: Path, share: float) -> None:
    run_campaign(plan, tmp_path / "whole.journal")
    whole = planned_values(tmp_path / "whole.journal")
    run_until(plan, tmp_path / "a.journal", share * plan.seconds)
    resume_campaign(tmp_path / "a.journal")
    assert planned_values(tmp_path / "a.journal") == whole


def test_with_700_times_the_light_a_lobe_is_read_at_all_gains_without_saturation(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """A peak of 2 uA beside photodiodes without light."""
    rig = write_rig(*QUIET, (BRIGHT[0], BRIGHT[1].format(radiance="1.4e6")))
    run = run_plan(
        change_rows(make_plan(read_schedule(write_schedule(ALL_GAINS)), read_rig(rig)), auto_range), tmp_path / "a.journal"
    )
    lobe = run.of("measure", "gaussian-5")
    assert [[reading.gain_v_per_a for reading in each.data.readings] for each in lobe] == [[1e6, 1e8, 1e10, 1e11]] * 2
    assert all(each.data.flags == () for each in lobe)


@pytest.mark.parametrize(
    ("current", "expected"), [(None, [0, 2, 3]), (0, [0, 2, 3]), (2, [0, 2, 3]), (3, [3, 2, 0]), (1, [0, 2, 3])]
)
def test_without_auto_range_all_gains_are_read_starting_with_the_current_one(current: int | None, expected: list[int]) -> None:
    settings = PhotodiodeSettings((0.0, 5.0, 10.0), (), (1e6, 1e8, 1e10, 1e11), "adam-6017")
    gains = GainSequence(Row(0, "a", "measure", "a", gains=(0, 2, 3), readings=1), settings, current)
    order = []
    for gain in gains:
        order.append(gain)
        gains.add(np.array([[100, 200, adam.FULL_SCALE if gain else 300]], dtype=np.uint16))
    assert order == expected
    assert gains.flags == ()


@pytest.mark.parametrize("current", [None, 0, 2])
def test_auto_range_and_averaging_start_with_the_highest_gain(current: int | None) -> None:
    assert gain_order(Row(0, "a", "measure", "a", gains=(0, 2), readings=1, automatic=True), current) == (2, 0)
    assert gain_order(Row(0, "a", "measure", "a", gains=(0, 2), readings=1, target=0.01), current) == (2, 0)


def test_consecutive_rows_share_a_gain(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    run = run_plan(make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET))), tmp_path / "a.journal")
    firsts = [
        min(each.data.readings, key=lambda reading: reading.first_s).gain_v_per_a for each in run.of("measure", "gaussian-5")
    ]
    assert firsts == [1e8, 1e10] or firsts == [1e10, 1e8]


def test_a_row_without_light_is_flagged(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    """The sample reflects so little that the highest gain shows no light."""
    black = ("[twin.samples.etalon]", '[twin.samples.black]\nmodel = "lambertian"\nreflectance = 1e-5\n\n[twin.samples.etalon]')
    schedule = write_schedule(("[1e8, 1e10]", "[1e6, 1e8]"), ("gaussian-5", "black"))
    run = run_plan(make_plan(read_schedule(schedule), read_rig(write_rig(*QUIET, black))), tmp_path / "a.journal")
    assert [each.data.flags for each in run.of("measure", "black")] == [(UNDER_RANGE,)] * 2
    assert [each.data.flags for each in run.of("measure", "etalon")] == [()] * 2
