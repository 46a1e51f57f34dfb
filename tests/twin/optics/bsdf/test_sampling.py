"""Values, drawn directions and albedo of each model, compared with each other."""

import math

import numba
import numpy as np
import pytest

from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import (
    Scatterer,
    albedo,
    apply_spectrum,
    draw_directions,
    evaluate,
    from_specular,
    light_direction,
    lobe_shares,
    regular,
    specular_direction,
    sum_samples,
    table_sample,
    to_specular,
)
from goniotwin.twin.optics.bsdf.packed_lobes import pack_lobes
from goniotwin.twin.optics.bsdf.sampling import density_all, scatter_all
from tests.twin.optics.models import (
    ANISOTROPIC,
    BRUSHED,
    MODELS,
    SINGLE,
    canonical_directions,
    gaussian,
    lambertian,
    model_name,
)

# At the edges of the tables' cells, where the density is discontinuous.
THETA_EDGES = np.array([0.0, 2.0, 4.0, 7.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 90.0, 130.0, 180.0])
SECTORS, FINE = 6, 24
Places = Ints
RINGS = THETA_EDGES.size - 1


def integrals(sigma_deg: float, density: Floats) -> Floats:
    """Integral of a density (rings, FINE, sectors, FINE) at `bin_middles` over the solid angle of each bin."""
    theta, width = middles()
    area = np.radians(width / FINE) * np.sin(np.radians(theta)) * 2.0 * math.pi / SECTORS
    result: Floats = np.sum(density.mean(axis=3) * area[:, :, None], axis=1)
    return result


def middles() -> tuple[Floats, Floats]:
    """theta (rings, FINE) of the parts of each ring, and the rings' widths (rings, 1)."""
    width = np.diff(THETA_EDGES)[:, None]
    return THETA_EDGES[:-1, None] + width * (np.arange(FINE) + 0.5) / FINE, width


def bin_middles(sigma_deg: float) -> Floats:
    """Directions (rings, FINE, sectors, FINE, 3) of the parts of all bins, about the specular direction of sigma."""
    phi = 360.0 / SECTORS * (np.arange(SECTORS)[:, None] + (np.arange(FINE) + 0.5) / FINE)
    return from_specular(sigma_deg, middles()[0][:, :, None, None], phi)


def bins(sigma_deg: float, directions: Floats) -> tuple[Places, Places]:
    """Ring and sector of each direction."""
    theta, phi = to_specular(sigma_deg, directions)
    ring = np.clip(np.searchsorted(THETA_EDGES, theta, side="right") - 1, 0, RINGS - 1)
    return ring, np.minimum(phi * SECTORS / 360.0, SECTORS - 1).astype(np.int64)


def normal_of(chi2: float, freedom: int) -> float:
    """The normal number as improbable as a chi-square (approximation of Wilson and Hilferty)."""
    spread = 2.0 / (9.0 * freedom)
    return (math.pow(chi2 / freedom, 1.0 / 3.0) - 1.0 + spread) / math.sqrt(spread)


def too_large(chi2: float, freedom: int) -> bool:
    """Whether chi-square exceeds its quantile of 1 in 30,000."""
    return normal_of(chi2, freedom) > 4.0


def in_part(always: list[float], long: list[float]) -> pytest.MarkDecorator:
    """Incidences of `make test`, and those that only the long run has besides."""
    return pytest.mark.parametrize("sigma_deg", [*always, *(pytest.param(each, marks=pytest.mark.long) for each in long)])


def test_packed_lobes_have_the_types_of_one() -> None:
    """Else numba compiles all kernels of a lobe twice."""
    (lobe,) = gaussian(5.0).lobes
    packed = pack_lobes((lobe,), np.ones(1), 1)
    assert numba.typeof(packed.models.flat) == numba.typeof(packed.models.params[0]) == numba.typeof(lobe.params)


@pytest.mark.parametrize("model", SINGLE, ids=model_name)
def test_drawn_directions_follow_their_density(model: Scatterer) -> None:
    sigma_deg, count = 40.0, 40_000
    (lobe,), (x, y, z) = model.lobes, (float(c) for c in light_direction(sigma_deg))
    uniform = np.random.default_rng(7).random((count, 3))
    drawn = scatter_all(*lobe.kernel_arguments, lobe.cells, 1, False, x, y, z, uniform)[:, :3]
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1.0, rtol=1e-6)
    seen = np.zeros((RINGS, SECTORS))
    np.add.at(seen, bins(sigma_deg, drawn), 1.0)
    kind, params, sig, ph, th, psi, _ = lobe.kernel_arguments
    places = bin_middles(sigma_deg)
    values = density_all(kind, params, sig, ph, th, psi, lobe.cells, x, y, z, places.reshape(-1, 3))
    expected = count * integrals(sigma_deg, values.reshape(places.shape[:-1]))
    assert expected.sum() == pytest.approx(count, rel=3e-3)
    full = expected > 20.0
    deviation = (seen - expected)[full] / np.sqrt(expected[full])
    assert full.sum() >= 10
    assert not too_large(float(np.sum(deviation**2)), int(full.sum()) - 1)
    # About 400 numbers in total: 5 is exceeded once in 4000 runs of the suite.
    assert np.max(np.abs(deviation)) < 5.0
    assert seen[~full].sum() == pytest.approx(expected[~full].sum(), abs=4.5 * math.sqrt(expected[~full].sum() + 1.0))


COUNT, GAMMA_DEG = 40_000, 25.0
LEAST_DRAWS = 100.0
"""A bin is compared where its integral is worth so many draws of the largest weight.

Its weights then have at least as many draws' worth by the sum of their squares, whatever they are. A number of hits is no such
bound: ten decades below a peak most of them have next to no weight, and the few that carry the integral are missed.
"""


def polar_side(sigma_deg: float) -> tuple[int, float]:
    """Side of the light, and its angle to that side's normal."""
    return (1, sigma_deg) if sigma_deg < 90.0 else (-1, 180.0 - sigma_deg)


def expected_in_bins(model: Scatterer, sigma_deg: float) -> list[Floats]:
    """Integrals (rings, sectors) of value times cosine, of reflected and of transmitted light."""
    incident, polar = polar_side(sigma_deg)
    places, light = bin_middles(polar), light_direction(sigma_deg)
    found = []
    for transmits in (False, True):
        observers = canonical_directions(places, incident, transmits)
        value = evaluate(model, light, observers, gamma_deg=GAMMA_DEG) * np.abs(observers[..., 2])
        found.append(integrals(polar, value * (places[..., 2] > 0.0)))
    return found


def drawn_in_bins(model: Scatterer, sigma_deg: float, seed: int) -> list[tuple[Floats, Floats, float]]:
    """Mean weight in the bins, its standard error, and the largest weight, of reflected and of transmitted light."""
    incident, polar = polar_side(sigma_deg)
    uniform = np.random.default_rng(seed).random((COUNT, 4))
    directions, weights = draw_directions(model, light_direction(sigma_deg), uniform, gamma_deg=GAMMA_DEG)
    found = []
    for transmits in (False, True):
        above = canonical_directions(directions, incident, transmits)
        mine = (above[:, 2] > 0.0) & (weights > 0.0)
        where, used = bins(polar, above[mine]), weights[mine]
        total, square = np.zeros((RINGS, SECTORS)), np.zeros((RINGS, SECTORS))
        np.add.at(total, where, used)
        np.add.at(square, where, used**2)
        mean = total / COUNT
        found.append((mean, np.sqrt((square / COUNT - mean**2) / COUNT), float(used.max(initial=0.0))))
    return found


@in_part([35.0, 140.0], [0.0, 70.0])
@pytest.mark.parametrize("model", [m for m in MODELS if m.name != "with regular"], ids=model_name)
def test_weights_in_each_part_of_the_sphere_sum_to_the_integral_of_the_value(model: Scatterer, sigma_deg: float) -> None:
    deviations, in_bins = [], expected_in_bins(model, sigma_deg)
    both = zip(in_bins, drawn_in_bins(model, sigma_deg, 11), strict=True)
    for transmits, (expected, (mean, error, largest)) in enumerate(both):
        full = (COUNT * expected > LEAST_DRAWS * largest) & (expected > 1e-12)
        # The bins' own quadrature is accurate to 0.5 %, at the horizon of a coarse table.
        deviations.append((mean - expected)[full] / np.hypot(error, 5e-3 * expected)[full])
        stated = albedo(model, sigma_deg, bool(transmits), gamma_deg=GAMMA_DEG)
        of_sum = math.sqrt(float(np.sum(error**2)) + float(mean.sum()) ** 2 / COUNT)
        assert mean.sum() == pytest.approx(stated, abs=5.0 * of_sum + 1e-9)
        # What the other bins have together: also weight where the value is next to nothing.
        spread = math.sqrt(float(np.sum(error[~full] ** 2)) + (largest / COUNT) ** 2)
        assert mean[~full].sum() == pytest.approx(expected[~full].sum(), rel=0.02, abs=5.0 * spread + 1e-12)
    every = np.concatenate(deviations)
    if sum(float(each.sum()) for each in in_bins) > 0.0:
        assert every.size >= 10
        assert not too_large(float(np.sum(every**2)), every.size)
        # About 3000 numbers in total: 5.5 is exceeded once in 8000 runs of the suite.
        assert np.max(np.abs(every)) < 5.5
    else:
        assert not every.size


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "sigma_deg"),
    [
        ("gaussian 5 x 20 deg one_over_e at 30", 35.0),
        ("wide-tailed 4 deg", 35.0),
        ("ward 0.15 x 0.3 at 70", 70.0),
        ("two widths", 35.0),
        ("two widths", 140.0),
        ("four ways", 70.0),
    ],
)
def test_the_chi_squares_of_many_seeds_follow_their_law(name: str, sigma_deg: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """The seed above is one of many, and none is chosen: of 200 seeds the p-values are uniform (Kolmogorov and Smirnov)."""
    (model,) = [each for each in MODELS if each.name == name]
    monkeypatch.setitem(globals(), "FINE", 72)
    expected = expected_in_bins(model, sigma_deg)
    values = []
    for seed in range(200):
        deviations = []
        for own, (mean, error, largest) in zip(expected, drawn_in_bins(model, sigma_deg, 5000 + seed), strict=True):
            full = COUNT * own > LEAST_DRAWS * largest
            deviations.append((mean - own)[full] / error[full])
        every = np.concatenate(deviations)
        values.append(0.5 * math.erfc(normal_of(float(np.sum(every**2)), every.size) / math.sqrt(2.0)))
    above = np.arange(1, 201) / 200.0 - np.sort(values)
    distance = max(float(above.max()), float((1.0 / 200.0 - above).max()))
    # 1.36 / sqrt(n) is exceeded once in 20 times, 2.23 / sqrt(n) once in 10,000.
    assert distance < 2.23 / math.sqrt(200.0)


@pytest.mark.parametrize("gamma_deg", [pytest.param(0.0, marks=pytest.mark.long), 77.0])
@in_part([75.0, 110.0], [0.0, 30.0, 170.0])
@pytest.mark.parametrize("model", MODELS, ids=model_name)
def test_the_mean_weight_is_the_albedo(model: Scatterer, sigma_deg: float, gamma_deg: float) -> None:
    count = 40_000
    light = light_direction(sigma_deg)
    directions, weights = draw_directions(model, light, np.random.default_rng(3).random((count, 4)), gamma_deg=gamma_deg)
    through = directions[:, 2] * light[2] < 0.0
    for transmitted, mine in ((False, weights * ~through), (True, weights * through)):
        error = mine.std(ddof=1) / math.sqrt(count)
        # 300 numbers: 5 standard errors are exceeded once in 6000 runs of the suite; constant weights have rounding errors.
        assert mine.mean() == pytest.approx(albedo(model, sigma_deg, transmitted, gamma_deg=gamma_deg), abs=5 * error + 2e-6)


@pytest.mark.parametrize("model", [gaussian(2.0), gaussian(5.0), gaussian(15.0), ANISOTROPIC, BRUSHED], ids=model_name)
def test_a_lobe_is_drawn_by_its_own_shape(model: Scatterer) -> None:
    _, weights = draw_directions(model, light_direction(30.0), np.random.default_rng(5).random((20_000, 4)))
    # By the cosine law alone a lobe of 5 deg has 11 times its mean, one of 2 deg 28 times.
    assert weights.std() < 0.8 * weights.mean()


@pytest.mark.parametrize("sigma_deg", [20.0, 130.0])
def test_a_regular_component_has_one_direction_and_its_share_of_the_light(sigma_deg: float) -> None:
    mirror = sum_samples(regular(0.25, side="both"), regular(0.5, transmits=True, side="both"), lambertian(0.1, side="both"))
    light = light_direction(sigma_deg)
    directions, weights = draw_directions(mirror, light, np.random.default_rng(2).random((20_000, 4)))
    reflected = np.isclose(directions @ specular_direction(sigma_deg), 1.0, atol=1e-14)
    through = np.isclose(directions @ -light, 1.0, atol=1e-14)
    assert np.mean(weights * reflected) == pytest.approx(0.25, abs=0.015)
    assert np.mean(weights * through) == pytest.approx(0.5, abs=0.015)
    # Each lobe is drawn in proportion to its share, so that all weights are equal.
    np.testing.assert_allclose(weights, 0.85, rtol=1e-6)


def test_lobes_are_drawn_in_proportion_to_their_albedo() -> None:
    sample = sum_samples(
        lambertian(0.3), gaussian(5.0, reflectance=0.6), gaussian(5.0, transmits=True, side="front"), lambertian(side="back")
    )
    assert lobe_shares(sample, 0.0) == pytest.approx([0.3 / 1.8, 0.6 / 1.8, 0.9 / 1.8, 0.0], rel=1e-6)
    assert lobe_shares(sample, 150.0) == pytest.approx([0.0, 0.0, 0.0, 1.0])
    assert not np.any(lobe_shares(lambertian(), 150.0))
    # A lobe that is zero at this incidence, but not at others, has a probability too.
    bent = gaussian(5.0, transmits=True, refraction=0.5)
    assert lobe_shares(sum_samples(lambertian(0.5), bent), 80.0)[1] > 0.0


def test_without_a_wavelength_lobes_are_drawn_by_their_mean_over_the_spectrum() -> None:
    sample = sum_samples(apply_spectrum([400.0, 600.0], [0.0, 1.0], lambertian(0.5)), lambertian(0.5))
    assert lobe_shares(sample, 0.0) == pytest.approx([1.0 / 3.0, 2.0 / 3.0])
    assert lobe_shares(sample, 0.0, 400.0) == pytest.approx([0.0, 1.0])


def test_a_table_of_zeros_has_no_weight() -> None:
    black = table_sample([0.0, 60.0], [0.0, 180.0], [0.0, 90.0], np.zeros((2, 2, 2)))
    _, weights = draw_directions(black, light_direction(10.0), np.random.default_rng(2).random((1000, 4)))
    assert not np.any(weights)
    assert albedo(black, 10.0) == 0.0
    assert not evaluate(black, light_direction(10.0), from_specular(10.0, 5.0, 0.0))


def test_invalid_uniform_numbers_are_refused() -> None:
    with pytest.raises(ValueError, match="uniform has the shape"):
        draw_directions(lambertian(), light_direction(0.0), np.full((5, 3), 0.5))
    with pytest.raises(ValueError, match="less than 1"):
        draw_directions(lambertian(), light_direction(0.0), np.full((5, 4), 1.0))
    with pytest.raises(ValueError, match="light has the shape"):
        draw_directions(lambertian(), [[0.0, 0.0, 1.0]], np.full((5, 4), 0.5))
