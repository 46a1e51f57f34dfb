"""Both estimators compute the same quantity, without and with stray light."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.rig.samples import parse_sample
from goniotwin.app.simulation import estimate
from goniotwin.app.simulation.estimate import EstimatorSettings
from goniotwin.app.simulation.files import assumptions, summary
from goniotwin.app.simulation.simulate import Simulation, Task, simulate
from goniotwin.twin.optics import Instrument, SampleFrames
from tests.twin.optics.agreement import agree

WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0)
FRAMES = SampleFrames(reflectance=0.5)
BLACK = "lambertian:reflectance=0.05"
FORWARD = EstimatorSettings("forward", paths=500_000, seed=3)


def simulate_black(stray: bool, sample: str = BLACK, **settings: Any) -> Simulation:
    grid = {"polar_deg": np.arange(10.0, 80.0, 12.0), "azimuth_deg": np.array([40.0, 75.0, 110.0, 145.0])}
    return simulate(
        Task(parse_sample(sample), np.array([30.0]), stray=stray, **{"instrument": WIDE, "frames": FRAMES, **grid, **settings})
    )


@pytest.fixture(autouse=True)
def quick_maps(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(estimate, "STRAY_PATHS", 1 << 16)


@pytest.mark.parametrize(("stray", "back"), [(False, False), (True, False), (True, True)])
def test_both_estimators_agree_within_their_errors(stray: bool, back: bool) -> None:
    fast, forward = (
        simulate_black(stray, f"{BLACK},side=both", back=back, estimator=estimator).at[0].ratio
        for estimator in (EstimatorSettings(), FORWARD)
    )
    seen = (forward.standard_error < 0.15 * forward.factor)[0] & np.isfinite(fast.factor[0])
    assert np.count_nonzero(seen) >= 15
    # A map of 5 by 10 deg blurs stray light by 1 to 2 %.
    blur = 0.02 * np.abs(fast.factor[0, seen] - 0.05)
    error = np.hypot(fast.standard_error[0, seen], blur)
    agree(forward.factor[0, seen], forward.standard_error[0, seen], fast.factor[0, seen], error)


def test_a_lit_frame_adds_its_scattered_light_to_a_black_sample() -> None:
    # The beam lights 1.1 x 1.1 times the hole: a fifth of its area is frame, which scatters a half of it as a diffuser.
    frame = 0.5 * (1.1**2 - 1.0)
    expected = (0.05 + frame) / (1.0 + frame)
    ratio = simulate_black(True).at[0].ratio
    value = ratio.factor[0][np.isfinite(ratio.factor[0])]
    assert np.median(value) == pytest.approx(expected, rel=0.1)  # near the rim of their field detectors lose some of it
    plain = simulate_black(False).at[0].ratio
    np.testing.assert_allclose(plain.factor[0][np.isfinite(plain.factor[0])], 0.05, rtol=1e-9)
    dark = simulate_black(True, frames=SampleFrames(reflectance=0.0)).at[0].ratio
    np.testing.assert_allclose(dark.factor[0][np.isfinite(dark.factor[0])], 0.05, rtol=0.02)


def test_files_and_summary_state_whether_stray_light_is_included() -> None:
    for estimator in (EstimatorSettings(), EstimatorSettings("forward", paths=20_000)):
        for stray in (False, True):
            each = simulate_black(stray, estimator=estimator)
            assert summary(each, [Path("a.ddr")])["stray"] is stray
            (line,) = (line for line in assumptions(each) if line.startswith("stray light: "))
            assert ("stray light: included" in line) == stray
            assert ("not included" in line) != stray
    assert Task(parse_sample(BLACK), np.array([30.0])).stray is False


def test_its_error_is_that_of_its_paths_and_its_seed_gives_the_same_numbers() -> None:
    first, again = (simulate_black(True).at[0].ratio for _ in range(2))
    assert first.factor.tobytes() == again.factor.tobytes()
    other = simulate_black(True, estimator=EstimatorSettings(seed=2)).at[0].ratio
    seen = np.isfinite(first.factor[0])
    assert not np.array_equal(first.factor[0, seen], other.factor[0, seen])
    apart = np.abs(first.factor - other.factor)[0, seen]
    assert np.sqrt(np.mean(apart**2)) == pytest.approx(np.sqrt(np.mean(first.standard_error[0, seen] ** 2)), rel=0.6)
