"""Moments of a detector's accepted rays: two independent integrations, compared with each other and with a closed form."""

import math

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    arc_direction,
    forward_throughput,
    gaussian,
    lambertian,
    luminance_factor,
    throughput,
)
from goniotwin.twin.optics.fast.aperture import (
    common_disc,
    cone_nodes,
    fill_apertures,
    fill_wide_apertures,
    hole_nodes,
    place_detectors,
    side_nodes,
)
from goniotwin.twin.optics.fast.bundle import aperture_sizes
from goniotwin.twin.optics.fast.detector_block import HOLE_U, HOLE_V, ONE, SLOPE_P, SLOPE_Q, empty_block, whole_lanes
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import slit_image
from tests.sizes import parted

ZENITHS_DEG = np.array([0.0, 20.0, 40.0, 60.0, 75.0, 85.0])
SECOND = [HOLE_U, HOLE_V, SLOPE_P, SLOPE_Q]


def moments(instrument: Instrument, *, wide: bool, nodes: int, rings: int = 0) -> Floats:
    """The flux, and the second moments of SECOND (zeniths, 5), by one of the two integrations."""
    sizes, scene = aperture_sizes(instrument), scene_at(instrument, 30.0)
    centres, axes = scene.detectors(instrument, arc_direction(ZENITHS_DEG, 30.0))
    chords = slit_image(instrument, scene).chords
    count, block = ZENITHS_DEG.size, empty_block()
    place_detectors(block, centres, axes)
    if wide:
        fill_wide_apertures(block, whole_lanes(count), hole_nodes(nodes), sizes, chords)
    else:
        fill_apertures(block, whole_lanes(count), cone_nodes(rings), side_nodes(nodes), sizes, chords, False)
    found: Floats = block["moments"][[ONE, *SECOND], [ONE, *SECOND], :count].T
    return found


@pytest.mark.parametrize("field_deg", [0.1, 0.5, 1.0, 2.5])
def test_both_integrations_converge_to_the_same_moments(field_deg: float) -> None:
    instrument = Instrument(field_deg=field_deg)
    by_slopes = moments(instrument, wide=False, nodes=60, rings=60)
    by_hole = moments(instrument, wide=True, nodes=300)
    np.testing.assert_allclose(by_hole[:, 0], by_slopes[:, 0], rtol=5e-5)
    np.testing.assert_allclose(by_hole[:, 1:], by_slopes[:, 1:], rtol=1e-3)


@pytest.mark.parametrize(("field_deg", "wide"), [(0.25, False), (0.5, False), (1.0, True), (2.5, True)])
def test_the_nodes_of_each_integration_are_enough_in_its_range(field_deg: float, wide: bool) -> None:
    instrument = Instrument(field_deg=field_deg)
    many = moments(instrument, wide=True, nodes=300)
    few = moments(instrument, wide=wide, nodes=8 if wide else 6, rings=3)
    np.testing.assert_allclose(few[:, 0], many[:, 0], rtol=4e-3)
    np.testing.assert_allclose(few[:, 1:], many[:, 1:], rtol=2e-2)


@pytest.mark.parametrize(
    ("radius", "x", "y", "other"),
    [(2.5, 3.0, 1.0, 1.5), (2.5, 0.3, -0.4, 1.0), (1.0, 0.3, -0.4, 2.5), (2.0, -1.5, 0.2, 2.1), (2.0, 9.0, 0.0, 1.0)],
)
def test_the_intersection_of_two_discs(radius: float, x: float, y: float, other: float) -> None:
    """Compared with the count of points of a grid."""
    a, b = np.meshgrid(*[np.linspace(-radius, radius, 1001)] * 2)
    both = (a * a + b * b <= radius * radius) & ((a - x) ** 2 + (b - y) ** 2 <= other * other)
    a, b = a[both], b[both]
    counted = np.array([a.size, a.sum(), b.sum(), (a * a).sum(), (a * b).sum(), (b * b).sum()]) * (2.0 * radius / 1000) ** 2
    np.testing.assert_allclose(common_disc(radius, x, y, other), counted, atol=0.01)


@pytest.mark.parametrize(
    ("field_deg", "diameter_mm"), [(0.1, 5.0), (0.8, 5.0), (1.5, 5.0), (2.5, 5.0), (6.0, 5.0), (3.0, 12.0), (1.5, 1.0)]
)
def test_seven_rays_agree_with_a_bundle_for_any_field_and_disc(field_deg: float, diameter_mm: float) -> None:
    instrument = Instrument(field_deg=field_deg, detector_diameter_mm=diameter_mm, obstruction=False)
    directions = arc_direction(np.linspace(15.0, 75.0, 40), 180.0)
    few, many = (luminance_factor(instrument, 45.0, directions, gaussian(5.0), rays) for rays in (None, 1 << 14))
    np.testing.assert_allclose(few[8:32], many[8:32], rtol=5e-3)


@parted(64)
@pytest.mark.parametrize("field_deg", [0.5, 2.5])
def test_the_flux_of_a_wide_field_agrees_with_the_forward_estimator(field_deg: float, part: int) -> None:
    instrument = Instrument(field_deg=field_deg, detector_diameter_mm=10.0)
    directions = arc_direction(np.arange(10.0, 86.0, 15.0), 90.0)
    result = throughput(instrument, 30.0, directions, lambertian(1.0))
    traced = forward_throughput(instrument, 30.0, directions, lambertian(1.0), relative_error=0.01 * math.sqrt(part), seed=3)
    standard = (result - traced.single_m2sr) / traced.single_error
    assert np.abs(standard).max() < 4.5
    assert np.sum(standard**2) < 30.0  # chi-square of 6 degrees of freedom: exceeded once in 25,000


def test_a_field_wider_than_the_angle_between_hole_and_disc_has_no_effect() -> None:
    directions = arc_direction(np.arange(10.0, 86.0, 15.0), 90.0)
    wide, wider = (throughput(Instrument(field_deg=field), 30.0, directions, lambertian(1.0)) for field in (4.0, 40.0))
    np.testing.assert_allclose(wider, wide, rtol=1e-12)
    # All of the disc sees all of the hole: areas, cosines of light and detector, and distances (paper, 3.1).
    beam = math.pi * 5.0**2 / 800.0**2
    seen = 0.95**3 * beam * math.cos(math.radians(30.0)) * 25.0 * np.cos(np.radians(np.arange(10.0, 86.0, 15.0)))
    np.testing.assert_allclose(wide, seen * 1e-6 / math.pi * math.pi * 2.5**2 / 300.0**2, rtol=2e-3)
