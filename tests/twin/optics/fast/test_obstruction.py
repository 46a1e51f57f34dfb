"""Directions hidden by the mirrors: a zone about the retro-direction, and one 45 deg from it."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    arc_direction,
    forward_throughput,
    from_specular,
    light_direction,
    throughput,
    visible_fraction,
    visible_fraction_of_few,
)
from goniotwin.twin.optics.bsdf.analytic_samples import lambertian
from goniotwin.twin.optics.fast.few_rays import FEW_RAYS
from goniotwin.twin.optics.forward.bounces import is_on_mount
from goniotwin.twin.optics.forward.setting import set_up
from goniotwin.twin.optics.geometry.instrument import SampleFrames
from tests.twin.optics.agreement import agree

SIGMA = 30.0
ALONG_Y = np.array([0.0, 1.0, 0.0])


def retro_cut(offset_deg: Floats, side_mm: float = 20.0) -> list[float]:
    """Visible fractions along the plane of incidence, at offsets from the retro-direction."""
    directions = from_specular(SIGMA, 2.0 * SIGMA + offset_deg, 0.0)
    return [float(v) for v in visible_fraction(Instrument(mirror_side_mm=side_mm), SIGMA, directions)]


@pytest.mark.parametrize(("side_mm", "edge_deg"), [(20.0, 3.5), (40.0, 6.3)])
def test_mirror_3_hides_the_retro_direction(side_mm: float, edge_deg: float) -> None:
    # The mirror's half side at 200 mm (2.9 or 5.7 deg) and the bundle's half width there.
    dark = 0.55 * edge_deg
    assert retro_cut(np.array([-dark, 0.0, dark]), side_mm) == [0.0, 0.0, 0.0]
    clear = edge_deg + 0.3
    assert retro_cut(np.array([-clear, clear]), side_mm) == [1.0, 1.0]
    edge = retro_cut(np.arange(dark, clear, 0.1), side_mm)
    assert all(after >= before for before, after in pairwise(edge))
    assert 0.8 < retro_cut(np.array([edge_deg - 0.2]), side_mm)[0] < 1.0


def test_at_normal_incidence_the_specular_peak_is_hidden() -> None:
    assert visible_fraction(Instrument(), 0.0, [[0.0, 0.0, 1.0]])[0] == 0.0
    hidden = throughput(Instrument(), 0.0, [[0.0, 0.0, 1.0]], lambertian())[0]
    shown = throughput(Instrument(obstruction=False), 0.0, [[0.0, 0.0, 1.0]], lambertian())[0]
    assert hidden == 0.0
    assert shown > 0.0


def test_mirror_2_hides_a_zone_45_deg_from_the_light() -> None:
    light = light_direction(SIGMA)
    towards = (light - ALONG_Y) / np.sqrt(2.0)
    away = (light + ALONG_Y) / np.sqrt(2.0)
    assert visible_fraction(Instrument(), SIGMA, [towards, away]).tolist() == [0.0, 1.0]


def test_half_a_turn_of_the_arc_is_free() -> None:
    # Only mirror 3 of the mirror unit reaches y > 0: beta 0 to 180 is free except for the zone about the light.
    polar, beta = np.meshgrid(np.arange(0.0, 86.0, 5.0), np.arange(0.0, 181.0, 10.0))
    directions = from_specular(0.0, polar.ravel(), beta.ravel())
    far = directions @ light_direction(SIGMA) < np.cos(np.radians(6.0))
    assert np.all(visible_fraction(Instrument(), SIGMA, directions[far]) == 1.0)


def test_a_detector_in_the_samples_plane_receives_nothing() -> None:
    assert visible_fraction(Instrument(), SIGMA, [[1.0, 0.0, 0.0]])[0] == 0.0


def test_hidden_rays_are_missing_from_the_throughput() -> None:
    offsets = np.array([2.6, 2.9, 3.1, 5.0])
    directions = from_specular(SIGMA, 2.0 * SIGMA + offsets, 0.0)
    share = visible_fraction(Instrument(), SIGMA, directions, rays=1024)
    with_mirrors = throughput(Instrument(), SIGMA, directions, lambertian(), rays=1024)
    without = throughput(Instrument(obstruction=False), SIGMA, directions, lambertian(), rays=1024)
    # The same rays; the two differ by the weights over a beam of 0.7 deg, at most 1 % of a ray.
    assert with_mirrors / without == pytest.approx(share, abs=3e-3)


def test_a_mount_hides_as_a_larger_mirror_and_does_not_change_the_beam() -> None:
    mounted, larger = Instrument(mirror_mount_mm=10.0), Instrument(mirror_side_mm=40.0)
    directions = from_specular(SIGMA, 2.0 * SIGMA + np.arange(-8.0, 8.0, 0.5), 0.0)
    seen = visible_fraction(mounted, SIGMA, directions)
    np.testing.assert_array_equal(seen, visible_fraction(larger, SIGMA, directions))
    assert np.count_nonzero(seen < 1.0) > np.count_nonzero(visible_fraction(Instrument(), SIGMA, directions) < 1.0)
    np.testing.assert_allclose(
        throughput(mounted, SIGMA, directions, lambertian()), throughput(larger, SIGMA, directions, lambertian()), rtol=1e-12
    )
    small = Instrument(mirror_side_mm=7.0, mirror_mount_mm=20.0, obstruction=False)
    bare = Instrument(mirror_side_mm=7.0, obstruction=False)
    far = from_specular(SIGMA, np.arange(10.0, 40.0, 5.0), 90.0)
    np.testing.assert_array_equal(throughput(small, SIGMA, far, lambertian()), throughput(bare, SIGMA, far, lambertian()))


def test_both_estimators_include_mounts() -> None:
    mounted = Instrument(mirror_mount_mm=15.0, detector_diameter_mm=20.0, field_deg=4.0)
    directions = from_specular(SIGMA, 2.0 * SIGMA + np.arange(-16.0, 16.1, 4.0), 0.0)
    traced = forward_throughput(mounted, SIGMA, directions, lambertian(), 8_000_000, seed=5)
    visible = visible_fraction(mounted, SIGMA, directions)
    seen = visible == 1.0
    assert 2 <= np.count_nonzero(seen) < seen.size
    agree(traced.single_m2sr[seen], traced.single_error[seen], throughput(mounted, SIGMA, directions, lambertian())[seen], 0.0)
    assert not np.any(traced.single_m2sr[visible == 0.0])


@pytest.mark.parametrize("mirror", [0, 1, 2])
def test_a_mount_absorbs_light(mirror: int) -> None:
    instrument = Instrument(mirror_mount_mm=5.0)
    surfaces = set_up(instrument, SIGMA, [[0.0, 0.0, 1.0]], lambertian(), 0.0, None, None, 8, SampleFrames()).surfaces
    centre, _, along, across = surfaces.mirrors[mirror]
    for u, v, mount in ((0.0, 0.0, False), (9.9, -9.9, False), (10.1, 0.0, True), (0.0, -10.1, True), (-14.9, 14.9, True)):
        assert is_on_mount(surfaces, mirror, *(centre + u * along + v * across)) is mount


@settings(deadline=None, max_examples=40)
@example(sigma_deg=SIGMA, gamma_deg=0.0, seed=1, rays=256, mount_mm=0.0, field_deg=0.5)
@given(
    sigma_deg=st.floats(0.0, 180.0),
    gamma_deg=st.floats(0.0, 180.0),
    seed=st.integers(0, 2**32 - 1),
    rays=st.sampled_from([16, 256]),
    mount_mm=st.floats(0.0, 10.0),
    field_deg=st.sampled_from([0.5, 20.0]),
)
def test_numpy_and_the_kernel_see_the_same_shadow(
    sigma_deg: float, gamma_deg: float, seed: int, rays: int, mount_mm: float, field_deg: float
) -> None:
    """Near the mirrors' images on the arc, where some rays are blocked, and anywhere."""
    rng = np.random.default_rng(seed)
    mirrors = light_direction(sigma_deg) - [[0.0, 0.0, 0.0], ALONG_Y]
    near = mirrors[rng.integers(2, size=30)] + 0.08 * rng.standard_normal((30, 3))
    directions = np.concatenate([near, rng.standard_normal((10, 3)), arc_direction(90.0, [0.0, 45.0])])
    instrument = Instrument(mirror_mount_mm=mount_mm, field_deg=field_deg)
    by_kernel = visible_fraction(instrument, sigma_deg, directions, rays, gamma_deg)
    by_numpy = visible_fraction_of_few(instrument, sigma_deg, directions, rays, gamma_deg)
    np.testing.assert_allclose(by_numpy, by_kernel, rtol=1e-12, atol=1e-12)
    if sigma_deg == SIGMA and not gamma_deg:
        assert {0.0, 1.0} < set(by_kernel.tolist())  # and some are blocked in part


def test_many_directions_and_instruments_that_are_off_are_left_to_the_kernel() -> None:
    directions = from_specular(0.0, np.linspace(0.0, 80.0, FEW_RAYS // 256 + 1), 0.0)
    many = visible_fraction_of_few(Instrument(), SIGMA, directions, 256, 0.0)
    np.testing.assert_array_equal(many, visible_fraction(Instrument(), SIGMA, directions))
    moved = Instrument(deviations={"mirror_3": Deviation(x_mm=5.0)})
    few = from_specular(SIGMA, 2.0 * SIGMA + np.arange(-4.0, 4.1, 0.5), 0.0)
    by_kernel = visible_fraction(moved, SIGMA, few)
    np.testing.assert_array_equal(visible_fraction_of_few(moved, SIGMA, few, 256, 0.0), by_kernel)
    assert np.any(by_kernel != visible_fraction(Instrument(), SIGMA, few))
