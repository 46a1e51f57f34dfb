"""Seven rays per detector compared with whole bundles: narrow lobes, grazing light, deviations, either side, obstruction."""

import math

import numpy as np
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Scatterer,
    evaluate,
    from_specular,
    gaussian,
    lambertian,
    luminance_factor,
    table_sample,
    throughput,
)
from goniotwin.twin.optics.fast.lobe_sums import gaussian_values
from goniotwin.twin.optics.geometry.instrument import ELEMENTS
from tests.sizes import parted

OPEN = Instrument(obstruction=False)
MANY = 1 << 14


def lobe_grid(sigma_deg: float, width_deg: float, part: int = 4) -> Floats:
    """Rings about the specular direction out to three widths, no lower than 87 deg; every so many of their directions."""
    rows = [
        from_specular(sigma_deg, theta, np.arange(0.0, 360.0, 360.0 / count))
        for theta, count in ((step * width_deg, 1 + 6 * k) for k, step in enumerate(np.arange(0.0, 3.01, 0.25)))
    ]
    directions = np.concatenate(rows)
    return directions[directions[:, 2] > math.cos(math.radians(87.0))][::part]


def percentile_95(few: Floats, many: Floats) -> float:
    """95th percentile of the relative differences, percent."""
    return float(np.percentile(np.abs(few / many - 1.0), 95.0) * 100.0)


@parted(4)
@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0, 80.0, 87.0])
@pytest.mark.parametrize(("width_deg", "worst"), [(2.0, 0.4), (5.0, 0.1), (15.0, 0.02), (30.0, 0.02)])
def test_a_lobe_is_accurate_to_a_few_tenths_of_a_percent(sigma_deg: float, width_deg: float, worst: float, part: int) -> None:
    directions, sample = lobe_grid(sigma_deg, width_deg, part), gaussian(width_deg)
    few = luminance_factor(OPEN, sigma_deg, directions, sample)
    assert percentile_95(few, luminance_factor(OPEN, sigma_deg, directions, sample, rays=MANY)) < worst


@parted(4)
@pytest.mark.parametrize("element", ELEMENTS)
def test_every_deviation_is_included_in_both(element: str, part: int) -> None:
    """Large deviations with a visible effect: both agree with them as without, and the result changes."""
    # Such a tilt of mirror 1 would move the slit's image off the hole.
    less = 0.3 if element == "mirror_1" else 1.0
    own = Deviation(rx_deg=0.2 * less, ry_deg=-0.3 * less, rz_deg=0.25, x_mm=0.3, y_mm=-0.4, z_mm=0.5)
    bent = Instrument(obstruction=False, deviations={element: own})
    directions, sample = lobe_grid(30.0, 5.0, part), gaussian(5.0)
    few, many = (throughput(bent, 30.0, directions, sample, rays) for rays in (None, MANY))
    assert percentile_95(few, many) < 0.4
    straight = throughput(OPEN, 30.0, directions, sample)
    assert np.max(np.abs(few / straight - 1.0)) > 1e-3


def test_a_tilted_sample_turns_the_lobe_by_twice_its_angle() -> None:
    tilted = Instrument(obstruction=False, deviations={"sample": Deviation(ry_deg=0.5)})
    around = from_specular(30.0, np.abs(np.arange(-3.0, 3.01, 0.1)), np.where(np.arange(-3.0, 3.01, 0.1) < 0.0, 180.0, 0.0))
    peak = np.argmax(throughput(tilted, 30.0, around, gaussian(2.0)))
    assert np.arange(-3.0, 3.01, 0.1)[peak] == pytest.approx(1.0, abs=0.051)  # towards the light, as the normal is tilted


@pytest.mark.parametrize(
    ("sigma_deg", "side", "transmits"), [(30.0, "front", True), (150.0, "back", False), (150.0, "back", True)]
)
def test_each_side_is_the_front_turned_over(sigma_deg: float, side: str, transmits: bool) -> None:
    """optics.md, section 2: mirrored in the sample's plane for transmission, turned about x for light from the back."""
    front, other = gaussian(5.0), gaussian(5.0, transmits=transmits, side=side)  # type: ignore[arg-type]
    directions = lobe_grid(30.0, 5.0, 1)
    seen = directions * ([1.0, 1.0, -1.0] if transmits else [1.0, 1.0, 1.0])
    if sigma_deg > 90.0:
        seen = seen * [1.0, -1.0, -1.0]
    expected = throughput(OPEN, 30.0, directions, front)
    np.testing.assert_allclose(throughput(OPEN, sigma_deg, seen, other), expected, rtol=2e-3)
    assert not np.any(throughput(OPEN, sigma_deg, seen, gaussian(5.0, transmits=not transmits, side=side)))  # type: ignore[arg-type]


@pytest.mark.parametrize("sample", [lambertian(), gaussian(5.0)], ids=["lambertian", "gaussian"])
def test_a_detector_that_a_mirror_partly_hides_has_a_bundle(sample: Scatterer) -> None:
    directions = from_specular(0.0, np.arange(2.0, 6.0, 0.1), 20.0)
    few, many = (throughput(Instrument(), 0.0, directions, sample, rays) for rays in (None, MANY))
    np.testing.assert_allclose(few, many, atol=0.01 * many.max())
    assert few[0] == 0.0
    assert few[-1] == pytest.approx(throughput(OPEN, 0.0, directions[-1:], sample)[0])


@parted(4)
@pytest.mark.parametrize(("side_mm", "flux"), [(9.5, 0.01), (7.0, 0.01), (4.0, 0.03)])
def test_a_beam_that_partly_misses_the_mirrors_has_seven_rays_in_what_is_left_of_it(
    side_mm: float, flux: float, part: int
) -> None:
    narrow, sample = Instrument(mirror_side_mm=side_mm, obstruction=False), gaussian(5.0)
    directions = lobe_grid(60.0, 5.0, part)
    few, many = (throughput(narrow, 60.0, directions, sample, rays) for rays in (None, MANY))
    np.testing.assert_allclose(few, many, rtol=flux)
    assert np.all(few < 0.99 * throughput(OPEN, 60.0, directions, sample))
    ratios = (luminance_factor(narrow, 60.0, directions, sample, rays) for rays in (None, MANY))
    assert percentile_95(*ratios) < 0.4


@parted(4)
def test_a_table_with_kinks_has_bundles_and_agrees_with_the_etalon(part: int) -> None:
    """Linear between few angles, as in a measured table: seven rays would miss the effect of a kink on a beam of 0.7 deg."""
    theta = np.array([0.0, 1.0, 2.0, 4.0, 8.0, 20.0, 180.0])
    table = table_sample([0.0, 80.0], [0.0], theta, np.tile(np.exp(-theta / 4.0), (2, 1, 1)))
    directions = lobe_grid(30.0, 4.0, part)
    few, many = (luminance_factor(OPEN, 30.0, directions, table, rays) for rays in (None, MANY))
    assert percentile_95(few, many) < 0.3
    white = table_sample([0.0, 80.0], [0.0], theta, np.full((2, 1, theta.size), 1.0 / math.pi))
    np.testing.assert_allclose(luminance_factor(OPEN, 30.0, directions, white), 1.0, rtol=1e-12)


@pytest.mark.parametrize(
    "sample",
    [
        gaussian(2.0),
        gaussian(30.0),
        gaussian(90.0),
        gaussian(8.0, "half_width", "intensity"),
        gaussian(20.0, transmits=True, refraction=1.5),
        gaussian(20.0, transmits=True, refraction=0.7),
    ],
    ids=lambda each: each.name,
)
def test_the_vectorised_gaussian_equals_the_model(sample: Scatterer) -> None:
    """Compared with `evaluate`, which calls the library's arccosine and exponential."""
    random = np.random.default_rng(1)
    light, observer = (each / np.linalg.norm(each, axis=1)[:, None] for each in random.normal(size=(2, 4096, 3)))
    light[:, 2] = np.abs(light[:, 2])
    weights = random.random(4096)
    rays, values = np.concatenate([weights[None], light.T, observer.T]), np.empty(4096)
    lobe = sample.lobes[0]
    gaussian_values(
        lobe.params[0], lobe.params[1], lobe.params[2] == 1.0, lobe.params[4], lobe.transmits, rays, values.size, values
    )
    np.testing.assert_allclose(values, weights * evaluate(sample, light, observer), rtol=1e-9, atol=1e-290)
