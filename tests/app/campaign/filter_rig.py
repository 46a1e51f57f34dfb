"""The example rig with order filters, in its rig file and in the twin, and a schedule that changes them."""

from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import RigDescription, parse_rig
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import RIG, SMALL, Change, changed

FILTERS = """
[[monochromator.filters]]
position = 1
name = "open"
from_nm = 380
to_nm = 550

[[monochromator.filters]]
position = 4
name = "GG495"
from_nm = 550
to_nm = 650
cut_on_nm = 495

[[monochromator.filters]]
position = 2
name = "RG610"
from_nm = 650
to_nm = 780
cut_on_nm = 610

"""
"""The distances between consecutive filters differ from that between the first and the last: 3, 2 and 1 positions."""
GLASS = """
[[twin.filters]]
position = 4
cut_on_nm = 495

[[twin.filters]]
position = 2
cut_on_nm = 610

"""
RIG_FILTERS: Change = ("[photodiodes]\n", f"{FILTERS}[photodiodes]\n")
TWIN_FILTERS: Change = ("[twin.light]\n", f"{GLASS}[twin.light]\n")
WAVELENGTHS = "[500, 600, 700]"


def second_order(share: float) -> Change:
    """Change of the twin: the second order of the grating has this share of the first."""
    return ("[twin.samples.etalon]", f"[twin.monochromator]\nsecond_order = {share}\n\n[twin.samples.etalon]")


def rig_with(*changes: Change) -> RigDescription:
    """The example rig without noise and drift, with changes."""
    return parse_rig(changed(RIG.read_text(encoding="utf-8"), (*QUIET, *changes)), RIG.parent, "rig with filters")


def plan_with(*changes: Change, wavelengths: str = WAVELENGTHS, tables: str = "", rig: RigDescription | None = None) -> NewPlan:
    """A small schedule at three wavelengths, one per filter, on a rig with filters or on another rig."""
    text = changed(SMALL, (("wavelength_nm = [550]", f"wavelength_nm = {wavelengths}"), *changes)) + tables
    return make_plan(parse_schedule(text, "schedule"), rig or rig_with(RIG_FILTERS, TWIN_FILTERS))
