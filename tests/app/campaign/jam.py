"""A jammed axis: a schedule that asks about it, and a comparison with a rig on which nothing was jammed."""

from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import read_rig
from tests.app.campaign.campaign_bench import run_plan
from tests.conftest import SMALL, Change

ASK = SMALL.replace("beta_deg = [180]", "beta_deg = [150, 180]") + '\n[faults]\naxis = "ask"\n'
AXIS, JAMMED_DEG, COUNTED_DEG = "beta", 180.0, 150.0
"""Jammed while the sample is mounted, the arc stays where it is, and its counter goes on to that of the third row."""


HOMES: tuple[Change, ...] = (
    (
        "[axes.shift] ",
        "[axes.beta.homing]\nmode = 8\nspeed_deg_s = 20.0\nswitch_speed_deg_s = 2.0\nangle_deg = -4.0\n\n[axes.shift] ",
    ),
    ("beta = { motor = 5, gear = 18.0 }", "beta = { motor = 5, gear = 18.0, home_deg = -5.0 }"),
)
"""The arc has a home switch, 2 deg wide, and a [homing] table with its middle."""


def points_of(journal: Path) -> BsdfPoints:
    """The values of the sample in a journal."""
    with Journal.open(journal) as opened:
        return reduce_journal(opened).samples["gaussian-5"]


def check_undisturbed(journal: Path, rig: Path, schedule: Path) -> None:
    """Each value of a journal is that of an undisturbed rig, within its u."""
    undisturbed = journal.with_name("undisturbed.journal")
    run_plan(make_plan(read_schedule(schedule), read_rig(rig)), undisturbed)
    found, expected = points_of(journal), points_of(undisturbed)
    known = np.isfinite(expected.bsdf)
    assert known.sum() > 50
    assert np.array_equal(np.isfinite(found.bsdf), known)
    assert np.all(np.abs(found.bsdf - expected.bsdf)[known] <= expected.u_bsdf[known])
