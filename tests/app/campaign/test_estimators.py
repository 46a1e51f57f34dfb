"""A whole campaign on a rig whose light the forward estimator traces, held against the same one with the fast estimator."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.campaign.campaign import run_campaign
from app.campaign.events import State
from app.campaign.journal import Journal
from app.campaign.plan import make_plan
from app.campaign.reduction import BsdfPoints, reduce_journal
from app.campaign.schedule import read_schedule
from app.rig import read_rig
from tests.conftest import Writer
from twin.optics import Estimate, Scatterer, arc_direction, forward
from twin.optics.frames import Floats

STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
# Wide detectors meet more paths: the campaign is about the two estimators, not about the field.
OPTICS = "[twin.optics]\nstray = true\nfield_deg = 2.5\nestimator = '{estimator}'\nforward_error = {error}\n\n[twin.light]"
PAINT_5 = "width_deg = 5.0\nform = \"one_over_e\"\nquantity = \"luminance\"\nreflectance = 0.9\n"
PAINT_30 = "width_deg = 30.0\nreflectance = 0.5\n\n[twin.frames]\nreflectance = 0.3\n"


class Recorder:
    """Stands in for `forward` and keeps what each pose's estimate said of its own error."""

    def __init__(self) -> None:
        self.poses: list[tuple[str, float, Floats, Estimate]] = []

    def __call__(self, instrument: Any, sigma: float, directions: Floats, sample: Scatterer, **how: Any) -> Estimate:
        found = forward(instrument, sigma, directions, sample, **how)
        self.poses.append((sample.name, sigma, directions, found))
        return found

    def relative_errors(self, model: str, points: BsdfPoints) -> Floats:
        """Of the light of a sample of this model at each point (n,)."""
        looks = arc_direction(points.zenith_deg, points.azimuth_deg)
        errors = np.full(points.bsdf.size, np.nan)
        for name, sigma, directions, found in self.poses:
            if not name.startswith(model):
                continue
            here = np.isclose(points.sigma_deg, sigma, atol=0.01)
            near = looks[here] @ directions[points.photodiode[here]].T
            same = np.flatnonzero(here)[near.diagonal() > 1.0 - 1e-8]
            met = found.throughput_m2sr > 0.0
            relative = np.divide(found.standard_error, found.throughput_m2sr, where=met, out=np.full(met.size, np.nan))
            errors[same] = relative[points.photodiode[same]]
        return errors


def measured(rig: Path, schedule: Path, journal: Path) -> BsdfPoints:
    outcome = run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), journal)
    assert outcome.state is State.DONE
    with Journal.open(journal) as opened:
        return reduce_journal(opened).samples["gaussian-5"]


@pytest.mark.parametrize(
    ("error", "angles"),
    [(0.05, "sigma_deg = [30]"), pytest.param(0.01, "sigma_deg = [0, 30, 60]", marks=pytest.mark.long)],
    ids=["5 percent", "1 percent"],
)
def test_a_campaign_with_the_forward_estimator_gives_the_fast_ones_bsdf(
    error: float, angles: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorder = Recorder()
    monkeypatch.setattr("twin.plant.view.forward", recorder)
    schedule = write_schedule(("sigma_deg = [30]", angles), ("[180]", "[0, 180]"))
    found = {}
    for estimator in ("fast", "forward"):
        optics = ("[twin.light]", OPTICS.format(estimator=estimator, error=error))
        rig = write_rig(*STEADY, optics, (PAINT_5, PAINT_30), name=f"{estimator}.toml")
        found[estimator] = measured(rig, schedule, tmp_path / f"{estimator}.journal")
    fast, traced = found["fast"], found["forward"]
    assert np.array_equal(fast.shadowed, traced.shadowed)
    errors = np.hypot(recorder.relative_errors("gaussian", traced), recorder.relative_errors("lambertian", traced))
    good = fast.good & (fast.zenith_deg <= 85.0)
    assert np.isfinite(errors[good]).all()
    standard = (traced.bsdf[good] / fast.bsdf[good] - 1.0) / errors[good]
    count = standard.size
    assert count >= 60
    assert abs(np.sum(standard**2) - count) < 5.0 * np.sqrt(2.0 * count)
    assert np.abs(standard).max() < 5.5
