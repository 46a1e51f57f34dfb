"""What the photodiodes see: with a sample, without one, with stray light and without it."""

from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.twin import TwinModel
from goniotwin.twin.optics import SampleFrames
from goniotwin.twin.plant import Estimator
from goniotwin.twin.plant.view import Aspect, View
from tests.conftest import RIG

UPPER = 18
ACROSS = Aspect("etalon", 0.0, 550.0, 30.0, 0.0, 90.0, 0.0)


@pytest.fixture
def model() -> TwinModel:
    found = read_rig(RIG).model()
    assert found is not None
    return found


def stray_of(model: TwinModel, **changes: object) -> TwinModel:
    return replace(model, estimator=Estimator(stray=True), **changes)  # type: ignore[arg-type]


def test_without_a_sample_the_open_beam_meets_the_photodiode_behind(model: TwinModel) -> None:
    seen = View(model).throughputs_m2sr(replace(ACROSS, sample=None, sigma_deg=0.0))
    assert np.flatnonzero(seen).tolist() == [UPPER]  # of the lower arc, the one below the sample's normal
    white = View(model).throughputs_m2sr(replace(ACROSS, sigma_deg=0.0))
    assert seen[UPPER] > 1e3 * white[UPPER - 1]


def test_stray_light_of_the_frames_is_what_is_left_without_a_sample(model: TwinModel) -> None:
    """The signature of the instrument: as bright as the frames are, and no light where they are black."""
    bare = replace(ACROSS, sample=None)
    dim, bright, black = (
        View(stray_of(model, frames=SampleFrames(reflectance=each))).throughputs_m2sr(bare)[:UPPER] for each in (0.1, 0.4, 0.0)
    )
    assert np.all(dim[2:] > 0.0)
    np.testing.assert_allclose(bright.sum() / dim.sum(), 4.0, rtol=0.05)
    assert not black.any()
    assert not View(model).throughputs_m2sr(bare)[:UPPER].any()


def test_stray_light_adds_to_a_sample_what_the_forward_estimator_finds(model: TwinModel) -> None:
    wide = replace(model.instrument, detector_diameter_mm=10.0, field_deg=2.0)  # meets more paths
    model = replace(model, instrument=wide, frames=SampleFrames(reflectance=0.9))

    def stray_share(estimator: Estimator) -> float:
        with_it, without = (
            View(replace(model, estimator=replace(estimator, stray=each))).throughputs_m2sr(ACROSS)[:UPPER].sum()
            for each in (True, False)
        )
        return float(with_it / without - 1.0)

    added = stray_share(Estimator())
    assert added > 0.05
    assert added == pytest.approx(stray_share(Estimator("forward", relative_error=0.02)), rel=0.05)


def test_each_pose_has_random_numbers_of_its_own_and_always_the_same(model: TwinModel) -> None:
    traced = replace(model, estimator=Estimator("forward", relative_error=0.3))
    again = replace(ACROSS, gamma_deg=90.0)  # for a sample that is the same all round, the same light
    first, other = (View(traced).throughputs_m2sr(each) for each in (ACROSS, again))
    assert np.any(first[:UPPER] != other[:UPPER])
    np.testing.assert_array_equal(View(traced).throughputs_m2sr(ACROSS), first)
