"""Throughputs of the photodiodes: with and without a sample, with and without stray light."""

from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.twin import TwinModel
from goniotwin.twin.optics import SampleFrames
from goniotwin.twin.plant import Estimator
from goniotwin.twin.plant.view import Aspect, View
from tests.conftest import RIG
from tests.rig_tables import disturbances

UPPER = 18
ACROSS = Aspect("etalon", 0.0, 550.0, 30.0, 0.0, 90.0, 0.0)


@pytest.fixture
def model() -> TwinModel:
    result = read_rig(RIG).model()
    assert result is not None
    return result


def with_stray_light(model: TwinModel, **changes: object) -> TwinModel:
    return replace(model, estimator=Estimator(stray=True), **changes)  # type: ignore[arg-type]


def test_the_open_beam_reaches_the_photodiode_on_the_axis_alone(model: TwinModel) -> None:
    seen = View(model).throughputs_m2sr(ACROSS._replace(sample=None, sigma_deg=0.0))
    assert np.flatnonzero(seen).tolist() == [UPPER]  # on the lower arc, below the sample's normal
    white = View(model).throughputs_m2sr(ACROSS._replace(sigma_deg=0.0))
    assert seen[UPPER] > 1e3 * white[UPPER - 1]


def test_the_signature_without_a_sample_is_stray_light_of_the_frames(model: TwinModel) -> None:
    """Proportional to the frames' reflectance, and zero with black frames."""
    bare = ACROSS._replace(sample=None)
    dim, bright, black = (
        View(with_stray_light(model, frames=SampleFrames(reflectance=each))).throughputs_m2sr(bare)[:UPPER]
        for each in (0.1, 0.4, 0.0)
    )
    assert np.all(dim[2:] > 0.0)
    np.testing.assert_allclose(bright.sum() / dim.sum(), 4.0, rtol=0.05)
    assert not black.any()
    assert not View(model).throughputs_m2sr(bare)[:UPPER].any()


@pytest.mark.long
def test_added_stray_light_of_a_sample_agrees_with_the_forward_estimator(model: TwinModel) -> None:
    wide = replace(model.instrument, detector_diameter_mm=10.0, field_deg=2.0)  # more paths per detector
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


def test_each_pose_has_its_own_reproducible_random_numbers(model: TwinModel) -> None:
    traced = replace(model, estimator=Estimator("forward", relative_error=0.3))
    again = ACROSS._replace(gamma_deg=90.0)  # the same light for an isotropic sample
    first, other = (View(traced).throughputs_m2sr(each) for each in (ACROSS, again))
    assert np.any(first[:UPPER] != other[:UPPER])
    np.testing.assert_array_equal(View(traced).throughputs_m2sr(ACROSS), first)


def poses(samples: tuple[str | None, ...] = ("etalon", "gaussian-5")) -> list[Aspect]:
    return [
        Aspect(sample, tilt_deg, 550.0, sigma_deg, 0.0, beta_deg, shift_deg, mounting=1)
        for sample in samples
        for tilt_deg in (0.0, 0.1)
        for sigma_deg in (0.0, 42.0)
        for beta_deg in (0.0, 117.3)
        for shift_deg in (0.0, 1.25, 2.5)
    ]


def test_expected_poses_have_the_throughputs_of_poses_one_by_one_to_the_bit(model: TwinModel) -> None:
    off = disturbances(sample_tilt_deg=0.2, photodiode_angle_deg=0.02, photodiode_across_deg=0.03, sigma_zero_deg=0.1)
    model = replace(model, disturbances=off)
    ahead, singly = View(model), View(model)
    ahead.expect(poses())
    for each in poses():
        np.testing.assert_array_equal(ahead.throughputs_m2sr(each), singly.throughputs_m2sr(each))


def test_poses_that_were_not_expected_and_expected_ones_that_do_not_come_change_nothing(model: TwinModel) -> None:
    view = View(model)
    view.expect(poses(("gaussian-5",)))
    for each in (*poses(("etalon", None))[::2], *poses(("gaussian-5",))[::-3]):
        np.testing.assert_array_equal(view.throughputs_m2sr(each), View(model).throughputs_m2sr(each))


def test_expected_poses_are_computed_in_one_call(model: TwinModel, monkeypatch: pytest.MonkeyPatch) -> None:
    view = View(model)
    view.expect(poses())
    view.throughputs_m2sr(poses()[0])
    monkeypatch.setattr("goniotwin.twin.plant.view.throughput", None)
    assert all(view.throughputs_m2sr(each).shape == (2 * UPPER,) for each in poses())
