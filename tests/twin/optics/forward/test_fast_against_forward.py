"""Two independent estimators of one integral, without a common ray: light scattered once by the sample."""

import functools
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Scatterer,
    forward_throughput,
    from_specular,
    regular,
    throughput,
)
from tests.sizes import parted
from tests.twin.optics.agreement import agree
from tests.twin.optics.models import (
    ANISOTROPIC,
    TABLE,
    anisotropic_gaussian,
    gaussian,
    lambertian,
    thinned,
    ward,
    wide_tailed,
)

pytestmark = pytest.mark.xdist_group("fast against forward")

MEASURED = Path(__file__).resolve().parents[5] / "shared" / "data" / "real_bsdf" / "aeroglaze.bsdf"
SIGMA = [0.0, 30.0, 60.0, 80.0, 150.0]
# Wide detectors, for many hits from few paths; mirrors and beam are the instrument's own.
WIDE = Instrument(detector_diameter_mm=30.0, field_deg=6.0, obstruction=False)
# The relative error of their sum is about 20 over their number (found between 2^14 and 2^20, for scrambled Sobol points).
RAYS, FEW_RAYS, MANY_RAYS = 1 << 16, 1 << 14, 1 << 19


def rings(sigma_deg: float, step_deg: float, count: int = 4, transmitted: bool = False) -> Floats:
    """The lobe's axis and rings about it, in and out of the plane of incidence: so far apart that no path meets two
    detectors.
    """
    theta = np.concatenate([[0.0], *(np.full(6 * k, step_deg * k) for k in range(1, count + 1))])
    phi = np.concatenate([[0.0], *(np.arange(6 * k) * 60.0 / k for k in range(1, count + 1))])
    directions = from_specular(sigma_deg, theta, phi)
    side = math.copysign(1.0, math.cos(math.radians(sigma_deg)))
    directions = directions[side * directions[:, 2] > math.cos(math.radians(85.0))]
    return directions * [1.0, 1.0, -1.0] if transmitted else directions


def check_agreement(
    instrument: Instrument,
    sigma_deg: float,
    directions: Floats,
    scatterer: Scatterer | None,
    paths: int,
    gamma_deg: float = 0.0,
    least: float = 5e-3,
    sum_error: float = 5e-3,
    rays: int = RAYS,
    seven: bool = False,
    part: int = 1,
) -> None:
    """Check chi-square and largest difference, and the sums within `sum_error`, for detectors with `least` of the brightest's
    light.

    With `seven` also for the seven rays of the fast estimator, as in campaigns. With a `part` of the paths: for detectors with
    as many hits as `least` gives with all paths, and the sums to as many standard errors; `seven` rays alone, if they are
    asked for, which `fast/test_rays.py` compares with bundles.
    """
    bundle = None if seven and part > 1 else rays
    if part > 1:
        paths, least, sum_error = paths // part, least * part, sum_error * math.sqrt(part)
        bundle = bundle and bundle // 4
    estimate = forward_throughput(instrument, sigma_deg, directions, scatterer, paths, seed=2026, gamma_deg=gamma_deg)
    sample = scatterer or regular(transmits=True, side="both")
    expected = throughput(instrument, sigma_deg, directions, sample, rays=bundle, gamma_deg=gamma_deg)
    # Nearly hidden detectors and the lobe's far tail have too few hits for an estimate of the error.
    seen = expected > least * expected.max()
    assert np.count_nonzero(seen) >= 15
    assert not np.any(estimate.single_m2sr[expected == 0.0])
    result, error = estimate.single_m2sr[seen], estimate.single_error[seen]
    agree(result, error, expected[seen], 20.0 / bundle * expected[seen] if bundle else 0.0)
    if seven and bundle:
        own = throughput(instrument, sigma_deg, directions, sample, gamma_deg=gamma_deg)[seen]
        agree(result, error, own, 0.0)
        assert result.sum() == pytest.approx(own.sum(), rel=sum_error)
    assert result.sum() == pytest.approx(expected[seen].sum(), rel=sum_error)
    known = math.sqrt(float(np.sum(error**2))) / result.sum()
    assert known < 0.5 * sum_error


def lobe_detectors(width_deg: float) -> tuple[Instrument, float]:
    """Instrument with detectors for a lobe, and their distance: a third of the lobe's width."""
    field_deg = min(6.0, max(1.0, width_deg / 3.0))
    return replace(WIDE, field_deg=field_deg, detector_diameter_mm=max(10.0, 5.0 * field_deg)), 1.08 * field_deg


@parted(16)
@pytest.mark.parametrize("sigma_deg", SIGMA)
@pytest.mark.parametrize("transmits", [False, True], ids=["reflected", "transmitted"])
def test_both_agree_for_a_lambertian_sample(sigma_deg: float, transmits: bool, part: int) -> None:
    sample = lambertian(0.0 if transmits else 0.9, 0.9 if transmits else 0.0, side="both")
    check_agreement(
        WIDE, sigma_deg, rings(sigma_deg, 6.5, 9, transmits), sample, 40_000_000, sum_error=1e-3, seven=True, part=part
    )


@parted(16)
@pytest.mark.parametrize(
    ("width_deg", "sigma_deg"),
    [
        pytest.param(width, sigma, marks=pytest.mark.long if (i + j) % 2 else [])
        for i, width in enumerate((2.0, 5.0, 15.0, 30.0))
        for j, sigma in enumerate(SIGMA)
    ],
)
def test_both_agree_for_a_gaussian_lobe(sigma_deg: float, width_deg: float, part: int) -> None:
    instrument, step_deg = lobe_detectors(width_deg)
    sample = gaussian(width_deg, side="both")
    check_agreement(
        instrument, sigma_deg, rings(sigma_deg, step_deg, 6), sample, 20_000_000, sum_error=1e-3, seven=True, part=part
    )


@parted(16)
@pytest.mark.parametrize("sigma_deg", [30.0, *(pytest.param(each, marks=pytest.mark.long) for each in (0.0, 60.0, 150.0))])
@pytest.mark.parametrize(
    ("sample", "width_deg"),
    [
        (anisotropic_gaussian(5.0, 15.0, 40.0, side="both"), 5.0),
        (wide_tailed(3.0, side="both"), 3.0),
        (ward(0.08, 0.2, 40.0, side="both"), 9.0),
    ],
    ids=["two widths", "wide tails", "ward"],
)
def test_both_agree_for_lobes_of_two_widths_and_with_wide_tails(
    sample: Scatterer, width_deg: float, sigma_deg: float, part: int
) -> None:
    instrument, step_deg = lobe_detectors(width_deg)
    directions = rings(sigma_deg, step_deg, 6)
    check_agreement(instrument, sigma_deg, directions, sample, 4_000_000, gamma_deg=25.0, sum_error=4e-3, seven=True, part=part)


@parted(16)
@pytest.mark.parametrize("sigma_deg", [0.0, 60.0, 150.0])
@pytest.mark.parametrize("refraction", [1.0, 1.5])
def test_both_agree_for_a_transmitted_lobe(sigma_deg: float, refraction: float, part: int) -> None:
    sample = gaussian(10.0, "half_width", "intensity", reflectance=0.7, transmits=True, refraction=refraction, side="both")
    instrument, step_deg = lobe_detectors(10.0)
    check_agreement(
        instrument, sigma_deg, rings(sigma_deg, step_deg, 8, True), sample, 20_000_000, sum_error=1e-3, seven=True, part=part
    )


@parted(16)
@pytest.mark.parametrize("sigma_deg", [0.0, 60.0, 80.0])
def test_both_agree_for_a_table(sigma_deg: float, part: int) -> None:
    check_agreement(WIDE, sigma_deg, rings(sigma_deg, 6.5, 8), TABLE, 2_000_000, rays=FEW_RAYS, part=part)


@parted(16)
@pytest.mark.parametrize("gamma_deg", [0.0, 110.0])
def test_both_agree_for_an_anisotropic_sample_and_a_turned_hole(gamma_deg: float, part: int) -> None:
    check_agreement(WIDE, 50.0, rings(50.0, 6.5, 6), ANISOTROPIC, 1_000_000, gamma_deg, rays=FEW_RAYS, part=part)


@parted(16)
def test_both_agree_for_the_default_detectors_and_obstruction(part: int) -> None:
    narrow = Instrument()
    theta = np.arange(-10.0, 10.1, 0.6)
    in_plane = from_specular(30.0, np.abs(theta), np.where(theta < 0.0, 180.0, 0.0))
    check_agreement(narrow, 30.0, in_plane, gaussian(5.0), 40_000_000, sum_error=1e-2, part=part)
    # At normal incidence mirror 3 hides the peak, and some detectors partly.
    check_agreement(narrow, 0.0, rings(0.0, 0.7, 8), gaussian(5.0), 40_000_000, sum_error=1e-2, part=part)


AWRY = {
    "pupil": Deviation(0.1, 0.2, -0.1, 0.3, 0.2, -0.2),
    "mirror_1": Deviation(0.1, -0.05, 0.2, 0.1, -0.1, 0.1),
    "mirror_2": Deviation(-0.1, 0.15, 0.0, 0.0, 0.1, 0.2),
    "mirror_3": Deviation(0.05, 0.1, -0.1, -0.2, 0.0, 0.1),
    "mirror_unit": Deviation(0.1, 0.1, 0.1, 0.1, 0.1, 0.1),
    "sample": Deviation(0.3, -0.4, 0.5, 0.2, -0.1, 0.15),
    "arc": Deviation(0.2, 0.1, -0.3, 0.2, 0.3, -0.1),
    "sensor": Deviation(0.3, -0.2, 0.0, 0.4, 0.3, 0.2),
}


@parted(16)
@pytest.mark.parametrize("sigma_deg", [30.0, 140.0])
@pytest.mark.parametrize("element", [*AWRY, "all"])
def test_both_agree_with_deviations(element: str, sigma_deg: float, part: int) -> None:
    instrument, step_deg = lobe_detectors(5.0)
    awry = replace(instrument, deviations=AWRY if element == "all" else {element: AWRY[element]})
    directions, sample = rings(sigma_deg, step_deg, 6), gaussian(5.0, side="both")
    rays = RAYS if part == 1 else FEW_RAYS
    # All together move the slit's image, and part of the hole is dark: fewer paths arrive.
    paths = 24_000_000 if element == "all" else 8_000_000
    check_agreement(awry, sigma_deg, directions, sample, paths, gamma_deg=20.0, sum_error=2e-3, rays=rays, part=part)
    straight, shifted = (throughput(each, sigma_deg, directions, sample, gamma_deg=20.0) for each in (instrument, awry))
    assert np.max(np.abs(shifted / straight - 1.0)) > 5e-3


@parted(16)
def test_both_agree_with_mirrors_smaller_than_the_beam(part: int) -> None:
    small = replace(WIDE, mirror_side_mm=7.0)
    check_agreement(small, 30.0, rings(30.0, 6.5, 6), lambertian(), 20_000_000, sum_error=2e-3, part=part)


@parted(16)
@pytest.mark.parametrize(
    ("sigma_deg", "scatterer"), [(30.0, regular(0.4, side="both")), (150.0, regular(0.4, side="both")), (30.0, None)]
)
def test_both_agree_for_a_mirror_and_the_open_beam(sigma_deg: float, scatterer: Scatterer | None, part: int) -> None:
    narrow = Instrument(obstruction=False)
    directions = rings(sigma_deg, 0.12, 6, transmitted=scatterer is None)
    # These detectors overlap, so the error of their sum does not follow from their errors.
    estimate = forward_throughput(narrow, sigma_deg, directions, scatterer, 4_000_000 // part, seed=3)
    expected = throughput(narrow, sigma_deg, directions, scatterer or regular(transmits=True, side="both"))
    seen = expected > 0.05 * expected.max()
    assert np.max(np.abs(estimate.single_m2sr - expected)[seen] / estimate.single_error[seen]) < 5.5
    assert estimate.single_m2sr == pytest.approx(expected, abs=3e-3 * math.sqrt(part) * expected.max())


@functools.cache
def measured_paint(step: int = 1) -> Scatterer:
    """Table of the black paint, of every so many angles, for light from either side; the data are not in this repository."""
    if not MEASURED.is_file():
        pytest.skip(f"no table of the measured paint: {MEASURED}")
    from goniotwin.app.rig.samples import MeasuredTable, sample_scatterer

    paint = sample_scatterer(MeasuredTable(model="zemax", file=str(MEASURED), side="both"), MEASURED.parent, "the test")
    return thinned(paint, step)


@pytest.mark.parametrize(("sigma_deg", "paths", "sum_error"), [(30.0, 6_000_000, 4e-3), (150.0, 32_000_000, 1e-3)])
def test_both_agree_for_a_measured_paint(sigma_deg: float, paths: int, sum_error: float) -> None:
    """A small part of `test_the_sums_agree_for_a_measured_paint`, which checks the same with all angles and many more paths."""
    directions, paint = rings(sigma_deg, 6.5, 8), measured_paint(4)
    check_agreement(WIDE, sigma_deg, directions, paint, paths, sum_error=sum_error, rays=FEW_RAYS, part=32)


@pytest.mark.long
@pytest.mark.parametrize("sigma_deg", SIGMA)
@pytest.mark.parametrize("width_deg", [0.0, 2.0, 5.0, 15.0, 30.0])
def test_the_sums_agree_to_three_parts_in_ten_thousand(sigma_deg: float, width_deg: float) -> None:
    if width_deg == 0.0:
        directions, sample = rings(sigma_deg, 6.5, 6), lambertian(side="both")
        check_agreement(
            WIDE,
            sigma_deg,
            directions,
            sample,
            800_000_000 if sigma_deg == 80.0 else 500_000_000,
            sum_error=3e-4,
            rays=MANY_RAYS,
        )
        return
    instrument, step_deg = lobe_detectors(width_deg)
    sample = gaussian(width_deg, side="both")
    check_agreement(instrument, sigma_deg, rings(sigma_deg, step_deg, 6), sample, 300_000_000, sum_error=3e-4, rays=MANY_RAYS)


@pytest.mark.long
@pytest.mark.parametrize("sigma_deg", SIGMA)
def test_the_sums_agree_for_a_measured_paint(sigma_deg: float) -> None:
    paths = {60.0: 600_000_000, 80.0: 900_000_000}.get(sigma_deg, 420_000_000)
    check_agreement(WIDE, sigma_deg, rings(sigma_deg, 6.5, 8), measured_paint(), paths, sum_error=3e-4, rays=MANY_RAYS)
