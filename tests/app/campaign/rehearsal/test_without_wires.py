"""Rows without wires are those of the wires: gains, filters, flags and warm-up; an axis arrives where its table states it."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.readout import NOT_WARM, SATURATED, UNDER_RANGE
from goniotwin.app.campaign.rehearsal.without_wires import Motor, rows_without_wires
from goniotwin.app.campaign.row import CommittedRow
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import read_rig
from goniotwin.drivers import AxisSettings
from goniotwin.twin.plant.model import Mechanics
from goniotwin.twin.plant.shaft import Shaft
from tests.app.campaign.campaign_bench import QUIET, run_plan
from tests.app.campaign.filter_rig import FILTERS
from tests.conftest import SMALL, Change, Writer, changed

BLACK = ("[twin.samples.etalon]", '[twin.samples.black]\nmodel = "lambertian"\nreflectance = 1e-10\n\n[twin.samples.etalon]')
SCHEDULE = changed(
    SMALL,
    (
        ('["gaussian-5"]', '["gaussian-5", "black"]'),
        ("[1e8, 1e10]", '"automatic"'),
        ("[550]", "[500, 600, 700]"),
        ("[0, 1]", "[0]"),
    ),
)
WARM_UP = "[warm_up]\npercent_per_10min = {percent}\nlongest_s = {longest}\n"


def without_wires(rig: Path, schedule: str) -> list[CommittedRow]:
    plan = make_plan(parse_schedule(schedule, "x.toml"), read_rig(rig))
    model = plan.rig.model()
    assert model is not None
    return list(rows_without_wires(plan, model))


def test_gains_filters_and_flags_are_those_of_the_wires(write_rig: Writer, tmp_path: Path) -> None:
    """Auto-range, a lobe that is saturated at the lowest gain, a sample that reflects nothing, and three filters."""
    rig = write_rig(
        *QUIET, BLACK, ("[twin.light]", "[twin.light]\nradiance = 2e7"), ("[photodiodes]", f"{FILTERS}[photodiodes]")
    )
    direct = without_wires(rig, SCHEDULE)
    wired = run_plan(make_plan(parse_schedule(SCHEDULE, "x.toml"), read_rig(rig)), tmp_path / "a.journal").rows

    def decided(each: CommittedRow) -> tuple[object, ...]:
        position = None if each.data.positions is None else each.data.positions.get("filter")
        return each.row, [reading.gain_v_per_a for reading in each.data.readings], each.data.flags, position

    assert [decided(each) for each in direct] == [decided(each) for each in wired]
    assert {flag for each in direct for flag in each.data.flags} == {SATURATED, UNDER_RANGE}
    assert {each.data.positions["filter"] for each in direct if each.data.positions} == {1.0, 4.0, 2.0}


@pytest.mark.parametrize(("percent", "drift", "flags"), [(2.0, 0.02, ()), (0.2, 0.18, (NOT_WARM,))])
def test_a_warm_up_ends_when_the_lamp_is_steady(
    percent: float, drift: float, flags: tuple[str, ...], write_rig: Writer, tmp_path: Path
) -> None:
    """A drift of 0.33 % in ten minutes is steady where 2 % is, after the seven readings of a slope; 3 % never is."""
    rig = write_rig(QUIET[0], ("= 0.02", f"= {drift}"))
    schedule = SMALL + WARM_UP.format(percent=percent, longest=300.0)
    (direct,) = (each for each in without_wires(rig, schedule) if each.row.kind == "warm-up")
    (wired,) = run_plan(make_plan(parse_schedule(schedule, "x.toml"), read_rig(rig)), tmp_path / "a.journal").of("warm-up")
    assert direct.data.flags == wired.data.flags == flags
    seconds = direct.data.ended_s - direct.data.started_s
    assert seconds == pytest.approx(300.0 if flags else 61.0, abs=5.0)
    assert seconds == pytest.approx(wired.data.ended_s - wired.data.started_s, abs=5.0)


@pytest.mark.parametrize(
    "changes", [(), (("motor = 4\n", "motor = 4\nsense = -1\n"), ("motor = 4,", "motor = 4, sense = -1,"))]
)
def test_an_axis_whose_microstep_0_is_elsewhere_is_where_its_table_states_it(
    changes: tuple[Change, ...], write_rig: Writer
) -> None:
    """The light is that of the same angles."""
    expected = without_wires(write_rig(), SMALL)
    offset = (("motor = 4\n", "motor = 4\nzero_offset_deg = 12.5\n"), ("motor = 4,", "motor = 4, zero_deg = 12.5,"))
    found = without_wires(write_rig(*offset, *changes), SMALL)
    for each, other in zip(found, expected, strict=True):
        for reading, right in zip(each.data.readings, other.data.readings, strict=True):
            assert np.array_equal(reading.counts, right.counts)


@pytest.mark.parametrize("approach", ["below", "above"])
@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("zero_deg", [0.0, 12.5])
def test_each_move_arrives_at_its_angle_in_spite_of_backlash(approach: str, sense: int, zero_deg: float) -> None:
    """Also the first one, which may be none: driven downwards the axis is higher by the backlash, in the twin and in truth."""
    play = 0.3
    settings = AxisSettings(
        motor=0,
        gear=36.0,
        sense=sense,  # type: ignore[arg-type]
        zero_offset_deg=zero_deg,
        lower_deg=-90.0,
        upper_deg=90.0,
        speed_deg_s=10.0,
        acceleration_deg_s2=10.0,
        backlash_deg=play,
        approach_from=approach,  # type: ignore[arg-type]
    )
    built = zero_deg - (play if approach == "above" else 0.0)
    targets = [zero_deg, zero_deg - 0.1, *np.random.default_rng(1).uniform(-60.0, 60.0, 20).tolist()]
    for first in (0, 1):
        shaft = Shaft(Mechanics(motor=0, gear=36.0, sense=sense, zero_deg=built, backlash_deg=play))  # type: ignore[arg-type]
        motor, t = Motor(settings, shaft), 0.0
        for target in targets[first:]:
            t = motor.move(t, target) + 0.1
            assert shaft.angle_deg(t) == pytest.approx(target, abs=0.51 / settings.microsteps_per_deg * sense)
