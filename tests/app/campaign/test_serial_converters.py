"""A campaign with converters on one serial line, whose questions take longer than the conversions."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import Writer
from tests.drivers.photodiode_bench import SERIAL


def test_its_duration_is_predicted_too(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    schedule = read_schedule(write_schedule(("gains_v_per_a = [1e8, 1e10]", "gains_v_per_a = [1e11]")))
    plan = make_plan(schedule, read_rig(write_rig(*SERIAL)))
    outcome = run_campaign(plan, tmp_path / "serial.journal")
    assert outcome.rows == outcome.planned == len(plan.rows)
    assert outcome.seconds == pytest.approx(plan.seconds, rel=0.01)
