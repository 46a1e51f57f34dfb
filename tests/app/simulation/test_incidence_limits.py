"""The largest incidences of campaign and simulation, each with the reason that its message states."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.schedule.file import HIGHEST_SIGMA_DEG
from goniotwin.app.cli.work.virtual_instrument import SIGMA_END_DEG
from goniotwin.twin.optics import Deviation, Instrument, lambertian, throughput
from tests.system.command import invoke

OPEN = Instrument(obstruction=False)


def flux(instrument: Instrument, sigma_deg: float) -> float:
    """Light of an ideal diffuser in a detector at the normal."""
    return float(throughput(instrument, sigma_deg, np.array([[0.0, 0.0, 1.0]]), lambertian())[0])


@pytest.mark.parametrize(("sigma", "percent"), [(HIGHEST_SIGMA_DEG, 1.7), (SIGMA_END_DEG, 5.0)])
def test_a_tilt_of_the_tolerance_changes_the_light_by_its_tangent(sigma: float, percent: float) -> None:
    changed = [
        flux(replace(OPEN, deviations={"sample": Deviation(ry_deg=tilt)}), sigma) / flux(OPEN, sigma) - 1.0
        for tilt in (-0.05, 0.05)
    ]
    expected = math.radians(0.05) * math.tan(math.radians(sigma))
    assert sorted(changed) == pytest.approx([-expected, expected], rel=0.03)
    assert 100.0 * expected == pytest.approx(percent, abs=0.05)


@pytest.mark.parametrize("divergence_deg", [0.5, 0.716, 1.0])
def test_all_of_the_beam_meets_the_lit_side_up_to_the_limit_of_a_simulation(divergence_deg: float) -> None:
    beam = replace(OPEN, pupil_radius_mm=OPEN.pupil_distance_mm * math.tan(math.radians(0.5 * divergence_deg)))
    per_area = [flux(beam, sigma) / math.cos(math.radians(sigma)) for sigma in (60.0, SIGMA_END_DEG, 89.9)]
    assert per_area[1] == pytest.approx(per_area[0], rel=1e-3)
    assert per_area[2] > 1.01 * per_area[0]  # a part of the beam comes from behind


def test_the_message_has_the_limit_and_its_reason() -> None:
    done = invoke("simulate", "sample", "--sample", "lambertian", "--sigma", "90", "--out", "a.ddr")
    assert done.returncode == 2
    assert "--sigma: 90 is out of range; give 0 to 89 (nearer to 90 a part of the beam" in " ".join(done.stderr.split())
