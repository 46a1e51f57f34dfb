"""The share of the hole that is lit: of drawn rigs by the twin's own optics, and as modes against drawn places of the image."""

import math

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.light_place import across_beam, seen_logarithm
from goniotwin.app.campaign.measurement_model.lit_share import lit_effects, lit_modes
from goniotwin.app.campaign.measurement_model.pose import (
    LIGHT,
    VIEW,
    Views,
    disc_moves,
    image_shifts,
    rig_inputs,
    standard_uncertainties,
)
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.app.rig.inputs import element_deviations
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, arc_direction, lambertian, throughput
from tests.conftest import RIG

FILE = read_rig(RIG).file
INSTRUMENT = nominal_instrument(FILE)
HALF_WIDTHS = math.sqrt(3.0) * standard_uncertainties(rig_inputs(FILE.uncertainty))
OPAL, WHITE = lambertian(0.5, transmittance=0.5, side="both"), lambertian(1.0, side="both")
POLAR_DEG, AZIMUTH_DEG = np.array([5.0, 20.0, 50.0, 75.0, 85.0]), np.array([180.0, 180.0, 60.0, 260.0, 245.0])
"""Of transmitted light, from the lower pole and about it."""


def drawn(rigs: int) -> Floats:
    """Values (rigs, inputs) of the inputs LIGHT and VIEW."""
    return np.random.default_rng(35).uniform(-1.0, 1.0, (rigs, HALF_WIDTHS.size)) * HALF_WIDTHS


def logarithms(sigma_deg: float, gamma_deg: float, values: Floats, reverse: bool = False) -> Floats:
    """ln of a transmitted value (directions, rigs) by the model of the hole alone, on rigs with values of the inputs.

    `reverse`: seen by photodiodes beyond the pole of their arc.
    """
    light, view = values[:, : len(LIGHT)], values[:, len(LIGHT) :]
    none, lower = np.zeros(POLAR_DEG.size), np.ones(POLAR_DEG.size, dtype=bool)
    seen = Views(
        none + sigma_deg, none + gamma_deg, np.radians(POLAR_DEG), np.radians(AZIMUTH_DEG), lower, lower, lower & reverse
    )
    views, moves = disc_moves(INSTRUMENT, seen)
    discs = np.einsum("nk,mki->mni", view, moves)
    sample, etalon = (
        seen_logarithm(INSTRUMENT, (at, gamma_deg), views, light @ image_shifts(INSTRUMENT, at) @ across_beam(at).T, discs)
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


@pytest.mark.parametrize(
    ("sigma_deg", "gamma_deg"),
    [
        (33.0, 20.0),
        (140.0, 30.0),
        *(pytest.param(*each, marks=pytest.mark.long) for each in ((15.0, 0.0), (45.0, 0.0), (40.0, 100.0), (65.0, 0.0))),
    ],
)
def test_the_modes_have_the_second_moments_of_drawn_rigs(sigma_deg: float, gamma_deg: float) -> None:
    """Of each direction, and of two of them together; with the first one once more, seen from beyond the pole."""
    rig, pose, values = (INSTRUMENT, tuple(HALF_WIDTHS.tolist())), (sigma_deg, gamma_deg, True), drawn(20_000)
    seen, beyond = (lit_effects(*rig, (*pose, reverse), POLAR_DEG, AZIMUTH_DEG) for reverse in (False, True))
    effects = np.concatenate([seen, beyond[:1]])
    of_rigs = np.concatenate([logarithms(sigma_deg, gamma_deg, values), logarithms(sigma_deg, gamma_deg, values, True)[:1]])
    moments, expected = effects @ effects.T, of_rigs @ of_rigs.T / of_rigs.shape[1]
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert np.abs((moments - expected) / scale).max() < 0.1


@pytest.mark.parametrize("rest", [0.3, 3.0])
@pytest.mark.parametrize("sigma_deg", [pytest.param(5.0, marks=pytest.mark.long), 15.0, 65.0])
def test_an_interval_has_the_ends_of_drawn_rigs_with_normal_errors(sigma_deg: float, rest: float) -> None:
    """`rest`: of the other, normal errors, in the root of the mean square of the effect."""
    modes = lit_modes(INSTRUMENT, tuple(HALF_WIDTHS.tolist()))
    effects = lit_effects(INSTRUMENT, tuple(HALF_WIDTHS.tolist()), (sigma_deg, 0.0, True, False), POLAR_DEG, AZIMUTH_DEG)
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
