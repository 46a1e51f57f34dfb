"""The share of the hole that is lit: of drawn rigs by the twin's own optics, and as modes against drawn places of the image."""

import math

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.light_place import (
    across_beam,
    change_by_height,
    distinct_poses,
    of_centres,
    seen_logarithm,
    spot_weights,
)
from goniotwin.app.campaign.measurement_model.lit_share import RigLaw, height_effects, lit_effects, lit_modes
from goniotwin.app.campaign.measurement_model.pose import (
    LIGHT,
    VIEW,
    Views,
    disc_moves,
    image_shifts,
    mounting_inputs,
    pose_effects,
    rig_inputs,
    standard_uncertainties,
)
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.app.rig.inputs import PHOTODIODE_ANGLE, element_deviations
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, arc_direction, lambertian, throughput
from tests.conftest import RIG
from tests.sizes import some

FILE = read_rig(RIG).file
INSTRUMENT = nominal_instrument(FILE)
HALF_WIDTHS = math.sqrt(3.0) * standard_uncertainties(rig_inputs(FILE.uncertainty))
OPAL, WHITE = lambertian(0.5, transmittance=0.5, side="both"), lambertian(1.0, side="both")
POLAR_DEG, AZIMUTH_DEG = np.array([5.0, 20.0, 50.0, 75.0, 85.0]), np.array([180.0, 180.0, 60.0, 260.0, 245.0])
"""Of transmitted light, from the lower pole and about it."""


def drawn(rigs: int) -> Floats:
    """Values (rigs, inputs) of the inputs LIGHT and VIEW."""
    return np.random.default_rng(35).uniform(-1.0, 1.0, (rigs, HALF_WIDTHS.size)) * HALF_WIDTHS


def seen_at(sigma_deg: float, gamma_deg: float, *, lower: bool = True, reverse: bool = False) -> Views:
    """The directions, seen on either arc; `reverse`: by photodiodes beyond its pole, the first by a degree."""
    none, flags = np.zeros(POLAR_DEG.size), np.full(POLAR_DEG.size, lower)
    return Views(
        none + sigma_deg,
        none + gamma_deg,
        np.radians(POLAR_DEG * (0.2 if reverse else 1.0)),
        np.radians(AZIMUTH_DEG),
        flags,
        flags,
        np.full(POLAR_DEG.size, reverse),
    )


def effects_at(sigma_deg: float, gamma_deg: float, alignment: Alignment | None = None, *, reverse: bool = False) -> Floats:
    """The effects (directions, modes) on transmitted values."""
    views, rig = seen_at(sigma_deg, gamma_deg, reverse=reverse), RigLaw.of(FILE, alignment)
    return lit_effects(rig, views, views.sigma_deg) - lit_effects(rig, views, 180.0 - views.sigma_deg)


def places_at(sigma_deg: float, values: Floats) -> Floats:
    """The places (rigs, 2) of the image."""
    return np.asarray(values[:, : len(LIGHT)] @ image_shifts(INSTRUMENT, sigma_deg) @ across_beam(sigma_deg).T)


def logarithms(sigma_deg: float, gamma_deg: float, values: Floats, *, reverse: bool = False) -> Floats:
    """ln of a transmitted value (directions, rigs) by the model of the hole alone, on rigs with values of the inputs."""
    views, moves = disc_moves(INSTRUMENT, seen_at(sigma_deg, gamma_deg, reverse=reverse))
    discs = np.einsum("nk,mki->mni", values[:, len(LIGHT) :], moves)
    sample, etalon = (
        seen_logarithm(INSTRUMENT, (at, gamma_deg), views, places_at(at, values), discs)
        for at in (sigma_deg, 180.0 - sigma_deg)
    )
    return sample - etalon


@pytest.mark.parametrize("sigma_deg", [15.0, 45.0, 65.0])
def test_a_transmitted_value_is_off_by_the_lit_shares_of_the_virtual_rig(sigma_deg: float) -> None:
    """With all elements off as far as the rig file states; against the same rig with a hole that is lit everywhere."""
    values = 0.9 * np.sign(drawn(6)) * HALF_WIDTHS
    directions = arc_direction(180.0 - POLAR_DEG, AZIMUTH_DEG)
    values[:, [k for k, name in enumerate((*LIGHT, *VIEW)) if name.endswith("_zero")]] = 0.0  # no elements

    def logarithm(instrument: Instrument) -> Floats:
        return np.log(
            throughput(instrument, sigma_deg, directions, OPAL) / throughput(instrument, 180.0 - sigma_deg, directions, WHITE)
        )

    expected = logarithms(sigma_deg, 0.0, values)
    for k, own in enumerate(values.tolist()):
        deviations = element_deviations(dict(zip((*LIGHT, *VIEW), own, strict=True)), INSTRUMENT.pupil_distance_mm)
        lit, everywhere = (Instrument(deviations=deviations, lit_everywhere=each) for each in (False, True))
        found = logarithm(lit) - logarithm(everywhere)
        assert found[:-1] == pytest.approx(expected[:-1, k], rel=0.1, abs=0.004), (k, own)
        assert found[-1] == pytest.approx(expected[-1, k], rel=0.1, abs=0.005), (k, own)  # at 85 deg, near the horizon
    assert np.abs(expected).max() > 0.03


@pytest.mark.long
@pytest.mark.parametrize(
    ("sigma_deg", "gamma_deg"),
    [(140.0, 30.0), (33.0, 20.0), (15.0, 0.0), (45.0, 0.0), (40.0, 100.0), (65.0, 0.0)],
)
def test_the_modes_have_the_second_moments_of_drawn_rigs(sigma_deg: float, gamma_deg: float) -> None:
    """Of each direction, and of two of them together; the last is the first one, seen from beyond the pole.

    The modes are not made of those there: u of this one is right to 7 %.
    """
    values = drawn(20_000)
    effects = np.concatenate([effects_at(sigma_deg, gamma_deg), effects_at(sigma_deg, gamma_deg, reverse=True)[:1]])
    beyond = logarithms(sigma_deg, gamma_deg, values, reverse=True)[:1]
    of_rigs = np.concatenate([logarithms(sigma_deg, gamma_deg, values), beyond])
    moments, expected = effects @ effects.T, of_rigs @ of_rigs.T / of_rigs.shape[1]
    off = np.abs(moments - expected) / np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert off[:-1, :-1].max() < 0.1
    assert off.max() < 0.15


@pytest.mark.long
@pytest.mark.parametrize("sigma_deg", [15.0, 65.0])
def test_a_value_of_an_aligned_rig_is_corrected_and_the_rest_is_that_of_rigs_about_it(sigma_deg: float) -> None:
    """A rig whose hole is dark in part, all inputs known to a third of what is stated, two tilts together to a tenth."""
    inputs, rng = tuple(rig_inputs(FILE.uncertainty)), np.random.default_rng(8)
    u = standard_uncertainties(list(inputs))
    covariance = np.diag((u / 3.0) ** 2)
    first, second = (LIGHT.index(f"mirror_{k}_tilt_x") for k in (1, 2))
    covariance[first, second] = covariance[second, first] = -0.99 * covariance[first, first]
    found = 0.7 * HALF_WIDTHS * np.sign(drawn(2)[1])
    tilts = [LIGHT.index(f"mirror_{k}_tilt_{axis}") for k in (1, 2, 3) for axis in "xy"]
    found[tilts] = 0.8 * HALF_WIDTHS[tilts] * np.sign(image_shifts(INSTRUMENT, 0.0)[tilts].sum(axis=1))
    known = [k for k in range(u.size) if u[k] > 0.0]
    alignment = Alignment(tuple(inputs[k] for k in known), found[known], covariance[np.ix_(known, known)], "found")
    effects = effects_at(sigma_deg, 0.0, alignment)
    of_rigs = logarithms(sigma_deg, 0.0, rng.multivariate_normal(found, covariance, 4000))
    spread = np.std(of_rigs, axis=1)
    assert np.abs(effects[:, 0] - np.mean(of_rigs, axis=1)).max() < 0.1 * spread.max()
    assert np.abs(effects[:, 0]).max() > 0.004
    moments, expected = effects[:, 1:] @ effects[:, 1:].T, np.cov(of_rigs)
    assert np.abs((moments - expected) / np.outer(spread, spread)).max() < 0.15


@pytest.mark.long
@pytest.mark.parametrize("rest", [3.0, 0.3])
@pytest.mark.parametrize("sigma_deg", [15.0, 5.0, 65.0])
def test_an_interval_has_the_ends_of_drawn_rigs_with_normal_errors(sigma_deg: float, rest: float) -> None:
    """`rest`: of the other, normal errors, in the root of the mean square of the effect."""
    modes, effects = lit_modes(RigLaw.of(FILE)), effects_at(sigma_deg, 0.0)
    of_rigs = logarithms(sigma_deg, 0.0, drawn(20_000))
    u = rest * np.sqrt(np.mean(of_rigs**2, axis=1))
    errors = of_rigs + u[:, None] * np.random.default_rng(54).standard_normal(of_rigs.shape)
    ends = modes.quantiles(effects, u, (0.025, 0.975))
    inside = np.mean((errors >= ends[:, :1]) & (errors <= ends[:, 1:]), axis=1)
    assert inside == pytest.approx(0.95, abs=0.012)
    assert np.mean(errors < ends[:, :1], axis=1) == pytest.approx(0.025, abs=0.01)
    # Of a normal law alone they are those of tables.
    normal = modes.quantiles(0.0 * effects, u, (0.025, 0.975))
    assert normal == pytest.approx(1.959964 * np.stack([-u, u], axis=1), rel=1e-6)
    # An error as the normal deviate of its probability.
    deviates = [modes.deviate(effects[0], u[0], error) for error in errors[0, :2000].tolist()]
    assert np.sqrt(np.mean(np.square(deviates))) == pytest.approx(1.0, abs=0.06)
    assert np.mean(np.abs(deviates) > 1.96) == pytest.approx(0.05, abs=0.02)
    assert modes.deviate(0.0 * effects[0], u[0], -1.5 * u[0]) == pytest.approx(-1.5)


@pytest.mark.parametrize(("sigma_deg", "lower"), [(15.0, False), (45.0, False), (65.0, False), (125.0, True)])
def test_a_hole_that_is_dark_in_part_and_lifted_gives_the_light_of_the_virtual_rig(sigma_deg: float, lower: bool) -> None:
    """That of 20 rigs with all elements off whose effect is largest, lifted by the half width both ways.

    Against the same with a hole that is lit everywhere.
    """
    values, height = 0.9 * np.sign(drawn(20)) * HALF_WIDTHS, 0.1
    values[:, [k for k, name in enumerate((*LIGHT, *VIEW)) if name.endswith("_zero")]] = 0.0  # no elements
    directions = arc_direction(180.0 - POLAR_DEG if lower else POLAR_DEG, AZIMUTH_DEG)
    views, _ = disc_moves(INSTRUMENT, seen_at(sigma_deg, 0.0, lower=lower))
    expected = height * change_by_height(INSTRUMENT, (sigma_deg, 0.0), views, places_at(sigma_deg, values))
    k = int(np.argmax(np.abs(expected).max(axis=0)))
    named = dict(zip((*LIGHT, *VIEW), values[k].tolist(), strict=True))
    deviations = element_deviations(named, INSTRUMENT.pupil_distance_mm)

    def logarithm(up: float, *, lit: bool) -> Floats:
        rig = Instrument(deviations={**deviations, "sample": Deviation(z_mm=up)}, lit_everywhere=lit)
        return np.log(throughput(rig, sigma_deg, directions, WHITE))

    dark, lit = (0.5 * (logarithm(height, lit=each) - logarithm(-height, lit=each)) for each in (False, True))
    assert (dark - lit)[:-1] == pytest.approx(expected[:-1, k], rel=0.3, abs=0.0025)
    assert np.abs(expected[:-1, k]).max() > 0.005


@pytest.mark.parametrize(("sigma_deg", "gamma_deg"), [(15.0, 0.0), (50.0, 20.0), (75.0, 0.0)])
def test_the_modes_of_a_height_have_the_second_moments_of_drawn_rigs(sigma_deg: float, gamma_deg: float) -> None:
    """Of two heights, and of each direction and two of them together: to 3 % of the square of 0.4 %, a value's u."""
    views = seen_at(sigma_deg, gamma_deg, lower=False)
    u = 2.0 * mounting_inputs(FILE.uncertainty, "sample", "")[2].u ** 2
    effects = height_effects(RigLaw.of(FILE), views)["sample"]
    of_rigs = change_by_height(
        INSTRUMENT, (sigma_deg, gamma_deg), disc_moves(INSTRUMENT, views)[0], places_at(sigma_deg, drawn(3000))
    )
    error = u * (effects @ effects.T - of_rigs @ of_rigs.T / of_rigs.shape[1])
    assert np.abs(error).max() < 0.03 * 0.004**2
    assert u * np.max(np.mean(of_rigs**2, axis=1)) > 0.03 * 0.004**2


@pytest.mark.parametrize("transmitted", [False, True])
@pytest.mark.parametrize("sigma_deg", some([30.0, 5.0, 75.0]))
def test_the_middle_of_the_light_adds_less_than_a_tenth_to_the_variance_of_an_angle(
    sigma_deg: float, transmitted: bool
) -> None:
    """So it is not in u. On drawn rigs, with what tilts of the mirrors do to the angle and to the middle alike."""
    values, rng = drawn(20_000), np.random.default_rng(1)
    polar = np.array([sigma_deg + 2.0, sigma_deg + 10.0, sigma_deg - 2.0, sigma_deg + 3.0])
    none, flags = np.zeros(polar.size), np.full(polar.size, transmitted)
    azimuth = np.radians([180.0, 180.0, 180.0, 190.0])
    views = Views(none + sigma_deg, none, np.radians(polar), azimuth, flags, flags, np.zeros_like(flags))
    effects = pose_effects(INSTRUMENT, views)
    _, middle = spot_weights(INSTRUMENT, sigma_deg, 0.0).lit(places_at(sigma_deg, values))
    u = standard_uncertainties(mounting_inputs(FILE.uncertainty, "sample", ""))
    mounted = rng.uniform(-1.0, 1.0, (len(values), u.size)) * math.sqrt(3.0) * u
    own = FILE.uncertainty.u(PHOTODIODE_ANGLE) * rng.standard_normal((polar.size, len(values)))
    for name, centres in zip(("along", "across"), of_centres(INSTRUMENT, *distinct_poses(views), effects.common), strict=True):
        angle = getattr(effects.common, name) @ values.T + getattr(effects.sample, name) @ mounted.T + own
        with_middle = angle + centres[:, :2] @ middle.T
        ratio = np.mean(with_middle**2, axis=1) / np.mean(angle**2, axis=1)
        assert ratio.max() < 1.065
        assert ratio.min() > 0.99
