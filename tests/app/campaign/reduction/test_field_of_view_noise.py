"""Noise, and second orders, in the correction for the field of view: what is stated is what is found."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.reduction.field_of_view import (
    FieldOfView,
    correct_field_of_view,
    pose_variance_deg2,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from tests.app.campaign.reduction.lobe_bench import INSTRUMENT, PLANE, SETTINGS, covariance_of, known, points_of


def test_a_diffuser_with_noise_keeps_its_values_and_their_uncertainty() -> None:
    rng = np.random.default_rng(7)
    polar = np.arange(0.0, 85.1, 0.5)
    for beta in (PLANE, (90.0,), tuple(np.arange(0.0, 181.0, 5.0))):
        flat = 0.01 * (1.0 + 0.003 * rng.standard_normal(polar.size * len(beta)))
        points = points_of(flat, polar, beta, u=3e-5)
        found = correct_field_of_view(points, SETTINGS)
        grown = found.u_bsdf / points.u_bsdf
        assert float(np.median(grown)) < 1.05
        assert float(np.max(grown)) < 2.0
        assert float(np.median(np.abs(found.field_correction))) < 0.1 * 0.003
        assert not found.flag("steep").any()


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_the_noise_of_corrected_values_is_that_of_their_components(step: float) -> None:
    """300 noisy copies of one scan of a lobe of 2 deg, as rotations of the sample: each has slopes of its own."""
    rng, copies = np.random.default_rng(5), 300
    clean = points_of(2.0, np.arange(20.0, 40.01, step), (180.0,))
    clean = clean.where(clean.theta_deg < 6.0)
    noisy = []
    for k in range(copies):
        places = clean.places.copy()
        places[:, 1] = 0.1 * k  # gamma
        bsdf = clean.bsdf * (1.0 + 0.01 * rng.standard_normal(clean.size))
        noisy.append(replace(clean, places=places, bsdf=bsdf, own={"noise": (0.01 * clean.bsdf) ** 2}))
    found = FieldOfView.of(BsdfPoints.join(noisy), INSTRUMENT)
    logs = (np.log(BsdfPoints.join(noisy).bsdf) + found.correction).reshape(copies, -1)
    stated = np.mean(found.noise.reshape(copies, -1) ** 2 + 0.01**2, axis=0)
    ratio = np.var(logs, axis=0) / stated
    assert float(np.mean(ratio)) == pytest.approx(1.0, abs=0.05)
    assert (np.abs(ratio - 1.0) < 5.0 * math.sqrt(2.0 / copies)).all()
    assert float(stated.max()) > 1.1 * 0.01**2


def test_at_a_peak_the_second_order_of_the_unknown_angle_is_a_component() -> None:
    points = points_of(5.0, np.arange(0.0, 85.1, 0.5))
    found = correct_field_of_view(points, SETTINGS)
    peak = int(np.argmin(points.theta_deg))
    drawn = np.random.default_rng(1).normal(size=(200_000, 2)) * np.sqrt(pose_variance_deg2(points, SETTINGS)[peak])
    bent = 1.0 / (0.5 * 25.0 - covariance_of(points)[peak].trace() / 2.0)
    low = np.exp(-0.5 * bent * np.sum(drawn**2, axis=1)) - 1.0
    stated = found.budget["second_order"][peak] / found.bsdf[peak]
    assert stated == pytest.approx(math.sqrt(np.mean(low**2)), rel=0.02)


def test_for_values_lost_in_noise_the_values_themselves_are_fitted() -> None:
    rng = np.random.default_rng(8)
    points = points_of(5.0, u=1e-4)
    noisy = replace(points, bsdf=points.bsdf + 1e-4 * rng.standard_normal(points.bsdf.size))
    dark = points.theta_deg > 25.0
    found = correct_field_of_view(noisy, SETTINGS)
    assert np.isfinite(found.u_field[dark]).all()
    assert float(np.max(found.u_field[dark])) < 0.5 * 1e-4
    lost = noisy.bsdf < 3e-4
    assert not found.field_correction[lost].any()
    assert np.array_equal(found.bsdf[lost], noisy.bsdf[lost])
    assert np.isnan(found.slope_along[lost]).all()


def test_beside_values_lost_in_noise_the_slope_is_that_of_the_other_side() -> None:
    """At steps of 1 deg a lobe of 2 deg falls to a twentieth: of the last value with light a neighbour is lost."""
    points = points_of(2.0, u=1e-4)
    found, (_, slope) = correct_field_of_view(points, SETTINGS), known(2.0, points)
    last = (points.bsdf > 3e-4) & (points.theta_deg > 5.5)
    assert last.sum() == 2
    assert found.slope_along[last] == pytest.approx(slope[last, 0], rel=1e-3)
    assert found.flag("steep")[last].all()
