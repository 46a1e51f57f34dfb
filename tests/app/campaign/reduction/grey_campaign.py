"""Campaigns on a grey diffuser: their plan, and their reduction."""

from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import QUIET
from tests.conftest import SMALL, Change, Writer

GREY = '[twin.samples.grey]\nmodel = "lambertian"\nreflectance = 0.03\n\n'
GLASS = '[twin.samples.glass]\nmodel = "lambertian"\nreflectance = 0.4\ntransmittance = 0.3\nside = "both"\n\n'
STRAY = "[twin.optics]\nstray = true\n\n[twin.frames]\nreflectance = 0.045\n\n"
GREY_ONLY = (("gaussian-5", "grey"), ("[1e8, 1e10]", "[1e10, 1e11]"))


def reduced(path: Path) -> BsdfDataset:
    """The reduction of a journal."""
    with Journal.open(path) as journal:
        return reduce_journal(journal)


def grey_plan(write_rig: Writer, write_schedule: Writer, tables: str = "", *changes: Change, twin: str = "") -> Plan:
    """A plan for the grey sample without noise; `tables` are added to the schedule, `twin` to the rig."""
    rig = write_rig(*QUIET, ("[twin.samples.etalon]", f"{GREY}[twin.samples.etalon]"), ("[twin.light]", f"{twin}[twin.light]"))
    return make_plan(read_schedule(write_schedule(*GREY_ONLY, *changes, text=SMALL + tables)), read_rig(rig))
