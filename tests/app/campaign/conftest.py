"""A small plan on the virtual rig."""

import pytest

from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from tests.conftest import Writer


@pytest.fixture
def plan(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule()), read_rig(write_rig()))
