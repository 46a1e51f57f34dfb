"""Many rigs, poses, samples and wavelengths in one call: the same numbers as one at a time, and as in plain numpy."""

import itertools
import math
from dataclasses import replace

import numba
import numpy as np
import pytest

from goniotwin.app.simulation.paper.gaussian_cut import (
    gaussian_theory,
    in_plane_directions,
    in_plane_theta,
    relative_rms_percent,
)
from goniotwin.app.simulation.paper.worst_corner import tilts
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Pose,
    Poses,
    Reflectance,
    Scatterer,
    Scenes,
    apply_spectrum,
    arc_direction,
    deviation_array,
    from_specular,
    gaussian,
    lambertian,
    luminance_factor,
    regular,
    spectral_throughput,
    sum_samples,
    throughput,
)
from goniotwin.twin.optics.fast.scenes import PIECE, score_scenes
from goniotwin.twin.optics.geometry.instrument import COMPONENTS, ELEMENTS, deviation_mapping
from tests.twin.optics.fast.plain_rays import plain_throughput
from tests.twin.optics.models import TABLE

OPEN, SHADED = Instrument(obstruction=False), Instrument()
NARROW = Instrument(mirror_side_mm=9.5)
"""Its mirrors cut the beam's edges, and hide directions."""
TILTED = {name: Deviation(*np.random.default_rng(k).normal(scale=0.15, size=6)) for k, name in enumerate(ELEMENTS)}


def around(sigma_deg: float) -> Floats:
    """Directions about the specular one, about the light, grazing, and below the sample."""
    arcs = [arc_direction(np.arange(0.0, 90.0, 11.0), beta, lower) for beta in (17.0, 200.0) for lower in (False, True)]
    return np.concatenate(
        [from_specular(sigma_deg, np.arange(0.0, 12.0, 0.7), 40.0), *arcs, from_specular(sigma_deg, 62.0, [0.0])]
    )


@pytest.mark.parametrize("instrument", [OPEN, SHADED, NARROW], ids=["open", "shaded", "narrow"])
@pytest.mark.parametrize(("sigma_deg", "gamma_deg"), [(30.0, 0.0), (0.0, 33.0), (150.0, 20.0)])
def test_rays_are_those_of_plain_numpy(instrument: Instrument, sigma_deg: float, gamma_deg: float) -> None:
    directions = around(sigma_deg if sigma_deg < 90.0 else 180.0 - sigma_deg)
    sample = lambertian(0.5, 0.4, side="both")
    for rig in (instrument, replace(instrument, deviations=TILTED, lit_everywhere=True)):
        found = throughput(rig, sigma_deg, directions, sample, 64, gamma_deg)
        expected = plain_throughput(rig, sigma_deg, directions, sample, 64, gamma_deg)
        np.testing.assert_allclose(found, expected, rtol=1e-11, atol=1e-13 * expected.max())
        assert np.count_nonzero(found) > 20


def test_a_gaussian_is_that_of_plain_numpy() -> None:
    rig, sample = replace(NARROW, deviations=TILTED, lit_everywhere=True), gaussian(5.0)
    found = throughput(rig, 30.0, around(30.0), sample, 64)
    np.testing.assert_allclose(found, plain_throughput(rig, 30.0, around(30.0), sample, 64), rtol=1e-9, atol=1e-24)


SAMPLES = [
    gaussian(5.0),
    TABLE,
    apply_spectrum([400.0, 700.0], [0.2, 0.9], gaussian(8.0)),
    sum_samples(lambertian(0.5), regular(0.3), regular(0.1, transmits=True, side="both")),
]
COATED = Reflectance(np.array([400.0, 700.0]), np.array([0.0, 40.0, 50.0]), np.array([[0.9, 0.8, 0.7], [0.95, 0.9, 0.85]]))


@pytest.mark.parametrize(
    "instrument", [SHADED, NARROW, Instrument(field_deg=2.5, mirror_reflectance=COATED)], ids=["shaded", "narrow", "wide"]
)
def test_many_scenes_in_one_call_equal_one_at_a_time(instrument: Instrument) -> None:
    poses = [Pose(30.0, around(30.0)), Pose(0.0, around(0.0), 25.0), Pose(140.0, -around(20.0))]
    rigs = [{}, TILTED, {"mirror_1": Deviation(ry_deg=0.2)}, {"sample": Deviation(rx_deg=-0.1, z_mm=0.2)}]
    wavelengths = np.array([450.0, 600.0])
    scenes = Scenes(instrument, poses, SAMPLES, wavelengths)
    found, ratios = scenes.throughputs(deviation_array(rigs)), scenes.ratios(deviation_array(rigs))
    assert found.shape == ratios.shape == (4, 4, 2, scenes.detectors)
    for (k, rig), (pose, piece) in itertools.product(enumerate(rigs), zip(poses, scenes.pieces, strict=True)):
        alone = replace(instrument, deviations=rig)
        for j, sample in enumerate(SAMPLES):
            expected = spectral_throughput(
                alone, pose.sigma_deg, pose.directions, sample, wavelengths, gamma_deg=pose.gamma_deg
            )
            np.testing.assert_allclose(found[k, j, :, piece], expected, rtol=1e-12)
        factor = luminance_factor(alone, pose.sigma_deg, pose.directions, SAMPLES[2], None, pose.gamma_deg, 600.0)
        np.testing.assert_allclose(ratios[k, 2, 1, piece], factor, rtol=1e-12)


def test_the_instruments_own_deviations_are_used_where_none_are_given() -> None:
    poses = [Pose(30.0, around(30.0))]
    bent = Scenes(replace(SHADED, deviations=TILTED), poses, [gaussian(5.0)])
    straight = Scenes(SHADED, poses, [gaussian(5.0)])
    np.testing.assert_array_equal(bent.throughputs(), straight.throughputs(deviation_array([TILTED])))
    np.testing.assert_array_equal(straight.throughputs(), bent.throughputs(np.zeros((1, len(ELEMENTS), len(COMPONENTS)))))


@pytest.mark.parametrize("count", [0, 36, PIECE + 5])
def test_poses_as_arrays_are_the_same_as_one_by_one(count: int) -> None:
    sigma, gamma = np.array([30.0, 0.0, 140.0]), np.array([0.0, 25.0, 0.0])
    directions = np.random.default_rng(3).normal(size=(3, count, 3)) * [0.3, 0.3, 1.0]
    arrays = Scenes(SHADED, Poses(sigma, directions, gamma), SAMPLES[:1])
    listed = Scenes(SHADED, [Pose(*each) for each in zip(sigma, directions, gamma, strict=True)], SAMPLES[:1])
    assert arrays.pieces == listed.pieces
    assert arrays.detectors == listed.detectors == 3 * count
    np.testing.assert_array_equal(arrays.throughputs(), listed.throughputs())


def test_poses_that_do_not_fit_are_refused() -> None:
    up = np.tile([0.0, 0.0, 1.0], (2, 4, 1))
    for poses, fault in (
        (Poses([0.0, 30.0], up[0]), r"directions has the shape \(4, 3\)"),
        (Poses([0.0], up), r"sigma_deg has the shape \(1,\): give \(2,\)"),
        (Poses([0.0, 30.0], up, [0.0, math.nan]), "not finite"),
        (Poses([0.0, 30.0], 0.0 * up), "give a finite vector with a length"),
    ):
        with pytest.raises(ValueError, match=fault):
            Scenes(SHADED, poses, SAMPLES[:1])


def test_the_kernel_is_compiled_once_for_all_calls() -> None:
    """Another type of an argument would cost as many seconds again at its first use."""
    fixed = deviation_array([TILTED, {}])
    fixed.flags.writeable = False
    for instrument, wavelengths in ((OPEN, None), (replace(SHADED, mirror_reflectance=COATED), np.array([450.0, 600.0]))):
        for rays in (None, 64):
            scenes = Scenes(
                instrument, [Pose(30.0, around(30.0)), Pose(30.0, np.zeros((0, 3)))], SAMPLES[:2], wavelengths, rays
            )
            assert scenes.throughputs().shape[0] == 1
            assert scenes.ratios(fixed[:, :, :]).shape[0] == scenes.ratios(np.repeat(fixed, 2, axis=0)[::2]).shape[0] == 2
    throughput(OPEN, 30.0, [[0.0, 0.0, 1.0]], gaussian(5.0), wavelength_nm=500.0)
    assert len(score_scenes.signatures) == 1  # type: ignore[attr-defined]


def random_rigs(count: int) -> Floats:
    return np.random.default_rng(3).normal(scale=0.1, size=(count, len(ELEMENTS), len(COMPONENTS)))


def test_results_are_bit_identical_for_any_number_of_threads_and_any_blocks() -> None:
    polar = np.linspace(0.0, 80.0, PIECE // 2 + 100)
    poses = [Pose(30.0, arc_direction(polar, 180.0)), Pose(50.0, around(50.0)), Pose(50.0, arc_direction(polar, 10.0))]
    scenes, rigs = Scenes(NARROW, [Pose(30.0, around(30.0))], [gaussian(5.0)]), random_rigs(200)
    many = Scenes(SHADED, poses, [gaussian(5.0)])
    assert many.detectors > PIECE
    first, wide = scenes.throughputs(rigs), many.throughputs()
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        np.testing.assert_array_equal(scenes.throughputs(rigs), first)
        np.testing.assert_array_equal(many.throughputs(), wide)
    finally:
        numba.set_num_threads(threads)
    blocks = np.split(rigs, [1, 8, 60, 61, 199])
    np.testing.assert_array_equal(np.concatenate(list(scenes.map(lambda found: found, blocks))), first)
    halves = [np.split(rigs, [size]) for size in (13, 100)]
    one, other = (np.concatenate(list(scenes.map(lambda found: found[..., 3], each, ratios=True))) for each in halves)
    np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize(
    ("deviations", "message"),
    [(np.zeros((3, 8)), "shape"), (np.zeros((1, 7, 6)), "shape"), (np.full((1, 8, 6), np.nan), "finite")],
)
def test_wrong_deviations_are_refused(deviations: Floats, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Scenes(OPEN, [Pose(30.0, [[0.0, 0.0, 1.0]])], [gaussian(5.0)]).throughputs(deviations)


@pytest.mark.parametrize("pose", [Pose(math.nan, [[0.0, 0.0, 1.0]]), Pose(0.0, [[0.0, 0.0, 1.0]], math.inf)])
def test_angles_that_are_not_finite_are_refused(pose: Pose) -> None:
    with pytest.raises(ValueError, match="sigma_deg"):
        Scenes(OPEN, [pose], [gaussian(5.0)])


def test_a_mapping_of_deviations_is_one_row_for_each_element() -> None:
    (rows,) = deviation_array([{"mirror_2": Deviation(ry_deg=0.1), "pupil": Deviation(x_mm=0.3)}])
    assert rows[ELEMENTS.index("mirror_2"), COMPONENTS.index("ry_deg")] == 0.1
    assert np.count_nonzero(rows) == 2
    assert deviation_mapping(rows) == {"pupil": Deviation(x_mm=0.3), "mirror_2": Deviation(ry_deg=0.1)}
    with pytest.raises(ValueError, match="no such element"):
        deviation_array([{"lamp": Deviation()}])


def in_plane(instrument: Instrument, width_deg: float = 5.0) -> tuple[Scenes, Floats]:
    theta = in_plane_theta(30.0, width_deg)
    poses = [Pose(30.0, in_plane_directions(30.0, theta))]
    sample: list[Scatterer] = [gaussian(width_deg, peak=1.0 / math.pi)]
    return Scenes(instrument, poses, sample), gaussian_theory(theta, width_deg, "one_over_e")


def test_each_tilt_alone_has_the_error_of_an_independent_prototype() -> None:
    """optics.md, section 7: alone at 0.05 deg, in plane, sigma 30, alpha 5, exit pupil at 800 mm, all of the hole lit."""
    scenes, theory = in_plane(replace(OPEN, lit_everywhere=True))
    rigs = deviation_array({tilt.element: Deviation(**{tilt.name: tilt.amount})} for tilt in tilts(OPEN))
    percents = [relative_rms_percent(each, theory) for each in scenes.ratios(rigs)[:, 0, 0]]
    found = dict(zip((tilt.title for tilt in tilts(OPEN)), percents, strict=True))
    prototype = {
        "mirror 1 ry": 1.01,
        "mirror 2 ry": 1.75,
        "mirror 3 ry": 2.54,
        "sample ry": 4.78,
        "arc ry": 2.41,
        "beam x": 2.10,
        "beam z": 1.35,
        **{f"{each} rx": 0.61 for each in ("mirror 1", "mirror 2", "mirror 3", "sample", "arc")},
    }
    assert found == pytest.approx(prototype, abs=0.006)
