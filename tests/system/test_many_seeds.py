"""Statistics over many seeds."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.components import total_variance
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.campaign.studies.theory import theoretical_bsdf
from goniotwin.app.data.comparison import compare_figure_13
from goniotwin.app.rig import read_rig
from tests.conftest import SCHEDULE, Writer

pytestmark = pytest.mark.long
SEEDS = range(1, 21)
OF_READINGS = {"noise", "dark", "etalon_reading", "lamp", "monitor", "resolution", "field_noise"}


def measured(rig: Path, schedule: Path, journal: Path) -> BsdfDataset:
    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), journal)
    with Journal.open(journal) as opened:
        return reduce_journal(opened)


def test_the_demo_is_within_3_percent_for_every_seed(write_rig: Writer, tmp_path: Path) -> None:
    for seed in SEEDS:
        reduced = measured(write_rig(("seed = 1", f"seed = {seed}")), SCHEDULE, tmp_path / f"{seed}.journal")
        found = compare_figure_13(reduced.rig, "gaussian-5", reduced.samples["gaussian-5"])
        assert max(found.by_sigma.values()) < 3.0


@pytest.mark.parametrize("dark_readings", [4, 16, 64])
def test_the_uncertainty_agrees_with_the_deviations_over_many_seeds(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, dark_readings: int
) -> None:
    """A dark sample, where noise dominates: the mean square of deviation over uncertainty is 1.

    Of the components those that this virtual rig has: it is off by nothing, and its pose, certificate and linearity are exact.
    """
    schedule = write_schedule(
        ("[1e8, 1e10]", "[1e11]"),
        ("dark_readings = 4", f"dark_readings = {dark_readings}"),
        ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2, 3, 4]"),
    )
    squares = []
    for seed in SEEDS:
        black = ("width_deg = 5.0", "width_deg = 40.0"), ("reflectance = 0.9\n", "reflectance = 0.009\n")
        rig = write_rig(("seed = 1", f"seed = {seed}"), *black)
        reduced = measured(rig, schedule, tmp_path / f"{dark_readings}-{seed}.journal")
        points = reduced.samples["gaussian-5"]
        good = points.where(points.good & points.in_plane & (points.zenith_deg < 80.0))
        variance = total_variance({name: each for name, each in good.components.items() if name in OF_READINGS})
        squares.append(float(np.mean((good.bsdf - theoretical_bsdf(reduced.rig, "gaussian-5", good)) ** 2 / variance)))
    assert 0.8 < float(np.mean(squares)) < 1.2
