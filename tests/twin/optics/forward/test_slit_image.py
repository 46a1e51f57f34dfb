"""The slit's image on the sample: the estimators with a weight of pupil and hole, compared with recorded rays and geometry."""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    forward_throughput,
    from_specular,
    record,
    regular,
    replay,
    throughput,
)
from goniotwin.twin.optics.geometry.instrument import ELEMENTS, ILLUMINATION_ELEMENTS
from goniotwin.twin.optics.geometry.mirrors import illumination_place
from goniotwin.twin.optics.geometry.scene import scene_at
from goniotwin.twin.optics.illumination.slit_image import slit_image
from goniotwin.twin.optics.illumination.unit import unit_of
from tests.sizes import parted
from tests.twin.optics.agreement import agree
from tests.twin.optics.models import gaussian, lambertian

WIDE = Instrument(detector_diameter_mm=15.0, field_deg=2.0, obstruction=False)
SIGMA_DEG, LOBE = 30.0, gaussian(5.0, side="both")
RIGS, RAYS, PATHS = 20, 2_000_000, 4_000_000
WORST_DEG, WORST_MM, SMALL = 0.12, 0.15, 3


def random_rig(rig: int) -> Instrument:
    """Elements off by more than the tolerances; every fourth rig has mirrors that are smaller than the beam."""
    random = np.random.default_rng(rig)

    def draw(names: tuple[str, ...], deg: float, mm: float) -> dict[str, Deviation]:
        return {name: Deviation(*random.uniform(-deg, deg, 3), *random.uniform(-mm, mm, 3)) for name in names}

    side = 10.0 if rig % 4 == SMALL else WIDE.mirror_side_mm
    own = {**draw(ILLUMINATION_ELEMENTS[:5], WORST_DEG, 0.05), **draw(ILLUMINATION_ELEMENTS[5:], 0.05, WORST_MM)}
    return replace(WIDE, mirror_side_mm=side, deviations=draw(ELEMENTS, WORST_DEG, WORST_MM), illumination=own)


def traced_flux(instrument: Instrument, directions: Floats, part: int) -> tuple[Floats, Floats]:
    """Fluxes (n,) of detectors, W, and their errors, with the recorded rays of the illumination unit."""
    unit, (rotation, origin) = unit_of(instrument), illumination_place(instrument)
    x, y, z = (float(each) for each in origin)
    source = replay(record(unit, RAYS // part, seed=5), unit, (x, y, z), rotation)
    result = forward_throughput(instrument, SIGMA_DEG, directions, LOBE, PATHS // part, seed=6, source=source)
    return result.single_m2sr * result.radiance, result.single_error * result.radiance


def sum_error(flux: Floats, error: Floats, lit: float, part: int) -> float:
    """Relative error of the sum: that of the paths, and that of the number of rays in the hole, a part of the slit's image."""
    share = lit * 25.0 * math.cos(math.radians(SIGMA_DEG)) / 49.0
    return math.hypot(math.sqrt(float(np.sum(error**2))) / flux.sum(), math.sqrt((1.0 / share - 1.0) / (RAYS // part)))


@parted(20)
def test_the_fast_estimator_agrees_with_recorded_rays_for_random_rigs(part: int) -> None:
    directions = from_specular(SIGMA_DEG, np.repeat([0.0, 3.0, 6.0, 9.0], 12), np.tile(np.arange(0.0, 360.0, 30.0), 4))[11:]
    straight, its_error = traced_flux(WIDE, directions, part)
    all_light = throughput(WIDE, SIGMA_DEG, directions, LOBE).sum()
    lit, ratio, error = np.empty((3, RIGS if part == 1 else 4))
    for rig in range(lit.size):
        instrument = random_rig(rig)
        flux, own_error = traced_flux(instrument, directions, part)
        expected = throughput(instrument, SIGMA_DEG, directions, LOBE)
        seen = expected > 0.02 * math.sqrt(part) * expected.max()
        agree(flux[seen] / flux[seen].sum(), own_error[seen] / flux[seen].sum(), (expected / expected[seen].sum())[seen], 0.0)
        lit[rig] = expected.sum() / all_light
        ratio[rig] = flux.sum() / straight.sum() / lit[rig]
        error[rig] = sum_error(flux, own_error, lit[rig], part)
    assert lit.min() < 0.7
    # The light that is lost, relative to that of the rig without deviations, whose error they have in common.
    common = sum_error(straight, its_error, 1.0, part)
    whole = np.arange(lit.size) % 4 != SMALL
    mean = np.average(ratio[whole], weights=error[whole] ** -2)
    assert abs(mean - 1.0) < 4.0 * math.hypot(common, np.sum(error[whole] ** -2) ** -0.5)
    agree(ratio[whole], error[whole], np.full_like(ratio[whole], mean), np.zeros_like(ratio[whole]))
    # Small mirrors cut the rim of the pupil, which is darker by a quarter: rays lose less than a uniform pupil.
    assert np.all(np.abs(ratio[~whole] - 1.005) < 0.005 + 4.0 * error[~whole])


def test_a_tilted_mirror_moves_the_image_by_twice_its_tilt_times_the_path() -> None:
    # optics.md, section 7: 1.05, 0.70, 0.35 mm for 0.05 deg of mirrors 1, 2, 3, and the unit's tilt times 800 mm.
    for element, path_mm in (("mirror_1", 1200.0), ("mirror_2", 800.0), ("mirror_3", 400.0), ("pupil", 800.0)):
        tilted = replace(WIDE, deviations={element: Deviation(rx_deg=0.05)})
        assert shift_mm(tilted) == pytest.approx(path_mm * math.radians(0.05), rel=5e-3)
    assert shift_mm(replace(WIDE, illumination={"unit": Deviation(rx_deg=0.05)})) == pytest.approx(0.698, abs=2e-3)
    # A lens that images 14 times larger moves the image 15 times as far, a slit 14 times.
    assert shift_mm(replace(WIDE, illumination={"output_condenser": Deviation(z_mm=0.05)})) == pytest.approx(0.75, rel=1e-3)
    assert shift_mm(replace(WIDE, illumination={"slit": Deviation(z_mm=0.05)})) == pytest.approx(0.70, rel=1e-3)


def shift_mm(instrument: Instrument) -> float:
    """Distance by which the image of the slit moves, at normal incidence: half the difference of opposite edges."""
    image = slit_image(instrument, scene_at(instrument, 0.0))
    shifts = [0.5 * abs(float(image.edges[k, 0, 0] - image.edges[k + 2, 0, 0])) for k in (0, 1)]
    return math.hypot(*shifts)


def test_the_light_is_the_lit_part_of_the_hole() -> None:
    # Mirror 1 tilted by 0.1 deg about the axis across: 2.09 mm, of which the margin takes 1 mm; a strip of the 5 mm is dark.
    tilted = replace(WIDE, deviations={"mirror_1": Deviation(rx_deg=0.1)})
    dark_mm = 1200.0 * math.tan(math.radians(0.1)) - 1.0
    tilted, straight = (replace(each, detector_diameter_mm=200.0, field_deg=60.0) for each in (tilted, WIDE))
    for rays in (None, 1 << 14):
        light, whole = (throughput(each, 0.0, [[0.0, 0.0, 1.0]], lambertian(), rays)[0] for each in (tilted, straight))
        assert light / whole == pytest.approx(1.0 - dark_mm / 5.0, abs=3e-3)


def test_an_arc_with_less_light_gives_less_everywhere() -> None:
    # Without deviations the reflector adds 0.95 * 0.9^2 * 0.8 of the direct light; turned by 5 deg its image misses the arc.
    turned = replace(WIDE, illumination={"reflector": Deviation(rz_deg=5.0)})
    directions = from_specular(SIGMA_DEG, np.array([0.0, 4.0, 8.0]), 0.0)
    for sample, rays in ((LOBE, None), (LOBE, 1 << 12), (regular(side="both"), None)):
        light, whole = (throughput(each, SIGMA_DEG, directions, sample, rays=rays) for each in (turned, WIDE))
        seen = whole > 0.0
        assert light[seen] / whole[seen] == pytest.approx(1.0 / (1.0 + 0.95 * 0.9**2 * 0.8), rel=5e-3)


@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0, 85.0, 150.0])
def test_the_rig_without_deviations_has_an_even_light(sigma_deg: float) -> None:
    # The image is turned by sigma; at 30 deg the margin is the least, a quarter of a millimetre.
    image = slit_image(WIDE, scene_at(WIDE, sigma_deg))
    assert (image.everywhere, image.slit.even) == (True, True)


def test_a_hole_that_is_lit_everywhere_has_no_edges() -> None:
    # Mirror 1 tilted by 0.2 deg: 4.2 mm, so that most of the hole would be dark.
    rig = replace(WIDE, deviations={"mirror_1": Deviation(rx_deg=0.2)}, lit_everywhere=True)
    image = slit_image(rig, scene_at(rig, 0.0))
    assert (image.everywhere, image.slit.even) == (True, True)
    light, dark, whole = (
        throughput(each, 0.0, [[0.0, 0.0, 1.0]], lambertian())[0] for each in (rig, replace(rig, lit_everywhere=False), WIDE)
    )
    assert light == pytest.approx(whole, rel=1e-3)
    assert dark < 0.5 * whole


def test_results_do_not_depend_on_the_number_of_threads() -> None:
    rig = random_rig(1)
    directions = np.tile(from_specular(SIGMA_DEG, np.arange(0.0, 20.0, 0.5), 90.0), (500, 1))
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        one = throughput(rig, SIGMA_DEG, directions, LOBE)
    finally:
        numba.set_num_threads(threads)
    assert np.array_equal(one, throughput(rig, SIGMA_DEG, directions, LOBE))
