"""A real rig with devices of another make of which no twin can be described: its plan, and the message at its rehearsal."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest

from goniotwin.app.campaign.planning.check import check_plan, explain_order
from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig.kinds import DeviceKind, device_kind, register, unregister
from goniotwin.arrays import Floats
from goniotwin.drivers import FilterWheel, OrderFilter
from tests.app.rig.test_described_twin import real_rig
from tests.conftest import SMALL, Change
from tests.system.another_make.conftest import SHIFT

ESP_SHIFT = (SHIFT[0], SHIFT[1].replace("twin://virtual/esp", "COM5"))
OTHER: Change = ('kind = "cornerstone"', 'kind = "other"')
TURN_S = 7.0


@dataclass(frozen=True, kw_only=True)
class OtherTable:
    """The table of a monochromator of another make: what docs/extend/adding-a-device.md lists, and nothing else."""

    kind: Literal["other"]
    port: str
    baudrate: int = 9600
    lowest_nm: float = 380.0
    highest_nm: float = 780.0

    @property
    def wheel(self) -> FilterWheel:
        return FilterWheel((OrderFilter(1, "none", 380.0, 600.0), OrderFilter(2, "RG", 600.0, 780.0)), step_s=TURN_S)

    def wavelength_seconds(self, start_nm: Floats, stop_nm: Floats) -> Floats:
        return np.ones(len(stop_nm)) + self.wheel.seconds(start_nm, stop_nm)

    def shutter_seconds(self, *, opened: bool) -> float:
        return 0.2 if opened else 0.1


@pytest.fixture(autouse=True)
def _other_monochromator(_registered: None) -> Iterator[None]:
    kind = DeviceKind("monochromator", "other", OtherTable, device_kind("monochromator", "cornerstone").open)
    register(kind)
    yield
    unregister(kind)


def plan(schedule: str, *changes: Change) -> NewPlan:
    return make_plan(parse_schedule(schedule, "small.toml"), real_rig(*changes))


AUTOMATIC = SMALL.replace("[1e8, 1e10]", '"automatic"')
AVERAGING = f"{SMALL}[averaging]\nrelative_uncertainty = 0.01\n"


@pytest.mark.parametrize("schedule", [SMALL, AUTOMATIC, AVERAGING])
@pytest.mark.parametrize("change", [ESP_SHIFT, OTHER])
def test_it_is_planned_whatever_needs_the_expected_light(schedule: str, change: Change) -> None:
    planned = plan(schedule, change)
    assert check_plan(planned).rows > 0
    assert planned.expected_reading_s == {}


def test_the_duration_of_filter_changes_is_that_of_the_table() -> None:
    """The two filters are neighbours: each change is one step."""
    planned = plan(SMALL.replace("[550]", "[550, 650]"), OTHER)
    changes = check_plan(planned).filter_changes
    assert changes > 0
    assert f"filter changes: {changes}, 0 min {round(changes * TURN_S):02d} s" in explain_order(planned)


@pytest.mark.parametrize(("change", "place"), [(ESP_SHIFT, r"axes\.shift: .* 'esp'"), (OTHER, "monochromator: .* 'other'")])
def test_its_rehearsal_asks_for_a_twin_table(change: Change, place: str) -> None:
    with pytest.raises(UserError, match=f"^{place}; describe the virtual rig in a .twin. table"):
        plan_rehearsal(parse_schedule(SMALL, "small.toml"), real_rig(change), {})
