"""A whole campaign with the forward estimator, compared with the same campaign with the fast estimator."""

from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import read_rig
from tests.conftest import Writer

STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
# Wide detectors are hit by more paths. The subject here are the two estimators, not the field of view.
OPTICS = "[twin.optics]\nstray = true\nfield_deg = 2.5\nestimator = '{estimator}'\nforward_error = {error}\n\n[twin.light]"
PAINT_5 = 'width_deg = 5.0\nform = "one_over_e"\nquantity = "luminance"\nreflectance = 0.9\n'
PAINT_30 = "width_deg = 30.0\nreflectance = 0.5\n\n[twin.frames]\nreflectance = 0.3\n"


def measure(rig: Path, schedule: Path, journal: Path) -> BsdfPoints:
    outcome = run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), journal)
    assert outcome.state is State.DONE
    with Journal.open(journal) as opened:
        return reduce_journal(opened).samples["gaussian-5"]


@pytest.mark.parametrize(
    ("error", "angles"),
    [
        pytest.param(0.1, "sigma_deg = [30]", id="10 percent", marks=pytest.mark.long),
        pytest.param(0.015, "sigma_deg = [0, 30, 60]", id="1.5 percent", marks=pytest.mark.long),
    ],
)
def test_forward_and_fast_estimator_give_the_same_bsdf(
    error: float, angles: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Within the stated uncertainty, which includes that of the ray paths."""
    schedule = write_schedule(("sigma_deg = [30]", angles), ("[180]", "[0, 180]"))
    results = {}
    for estimator in ("fast", "forward"):
        optics = ("[twin.light]", OPTICS.format(estimator=estimator, error=error))
        rig = write_rig(*STEADY, optics, (PAINT_5, PAINT_30), name=f"{estimator}.toml")
        results[estimator] = measure(rig, schedule, tmp_path / f"{estimator}.journal")
    fast, traced = results["fast"], results["forward"]
    assert np.array_equal(fast.flag("shadowed"), traced.flag("shadowed"))
    good = fast.good & traced.good & (fast.zenith_deg <= 85.0)
    assert np.count_nonzero(good) >= 60
    standard = (traced.bsdf - fast.bsdf)[good] / np.hypot(traced.u_bsdf, fast.u_bsdf)[good]
    assert np.median((traced.u_bsdf / traced.bsdf)[good]) > 0.8 * error  # of sample and etalon together
    assert 0.4 < np.mean(standard**2) < 1.5
    assert np.abs(standard).max() < 4.5
