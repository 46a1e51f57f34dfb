"""Samples of every kind, for tests of common properties."""

import functools
import math
from dataclasses import replace

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin import optics
from goniotwin.twin.optics import (
    Scatterer,
    combine_sides,
    regular,
    scattered_points,
    sum_samples,
    table_sample,
)
from goniotwin.twin.optics.bsdf.lobes import freeze

gaussian, lambertian = functools.cache(optics.gaussian), functools.cache(optics.lambertian)
anisotropic_gaussian, wide_tailed = functools.cache(optics.anisotropic_gaussian), functools.cache(optics.wide_tailed)
ward = functools.cache(optics.ward)
"""Tests share the samples of the same arguments: the albedos of one are a good part of the time of a small estimate."""

SIGMA_AXIS, PHI_AXIS, THETA_AXIS = [0.0, 30.0, 60.0], [0.0, 90.0, 180.0], [0.0, 10.0, 30.0, 90.0]
TABLE = table_sample(
    SIGMA_AXIS,
    PHI_AXIS,
    THETA_AXIS,
    0.05 + 0.1 * np.arange(3)[:, None, None] + 0.03 * np.arange(3)[:, None] + 0.2 * np.exp(-np.arange(4.0)),
)
PSI_AXIS = [20.0, 100.0, 200.0, 300.0]
TURN_AXIS = [0.0, 60.0, 150.0, 240.0, 360.0]
UNEVEN = np.random.default_rng(1).random((4, 3, 5, 4)) * np.array([8.0, 4.0, 0.3, 0.1])
UNEVEN[..., 0] = UNEVEN[..., :1, 0]
UNEVEN[..., -1, :] = UNEVEN[..., 0, :]
ANISOTROPIC = table_sample(SIGMA_AXIS, TURN_AXIS, THETA_AXIS, UNEVEN, "anisotropic", psi_deg=PSI_AXIS)
BRUSHED = table_sample(
    [10.0, 50.0],
    TURN_AXIS,
    [2.0, 15.0, 40.0],
    UNEVEN[:3, :2, :, :3],
    "brushed",
    psi_deg=[0.0, 40.0, 90.0],
    symmetry="orthotropic",
)


def points(incidences: list[float], step_deg: float = 4.0) -> Floats:
    """sigma, zenith, azimuth, deg (n, 3), of evenly spread directions of the hemisphere (a spiral)."""
    count = round(2.0 * math.pi / math.radians(step_deg) ** 2)
    zenith = np.degrees(np.arccos(1.0 - (np.arange(count) + 0.5) / count))
    azimuth = (np.arange(count) * 137.50776405003785) % 360.0
    return np.concatenate([np.stack([np.full(count, sigma), zenith, azimuth], axis=1) for sigma in incidences])


def thinned(table: Scatterer, step: int) -> Scatterer:
    """A table with every so many angles, the last one too: the albedo of all would be most of the time of a small test."""
    lobes = []
    for lobe in table.lobes:
        assert (lobe.theta_deg.size - 1) % step == 0
        # Contiguous and read-only as before: kernels are compiled for that.
        theta, values = freeze(lobe.theta_deg[::step]), freeze(lobe.values[..., ::step])
        lobes.append(replace(lobe, theta_deg=theta, values=values))
    return replace(table, lobes=tuple(lobes))


SPREAD = points([0.0, 30.0, 60.0])
SPREAD_VALUES = 0.1 + 0.2 * np.cos(np.radians(SPREAD[:, 1])) + 1e-3 * SPREAD[:, 0]
FINE = scattered_points(SPREAD[:, 0], SPREAD[:, 1], SPREAD[:, 2], SPREAD_VALUES, "points", spherical=True)
POINTS = thinned(FINE, 5)

SINGLE = [
    lambertian(0.8),
    gaussian(5.0),
    gaussian(25.0),
    gaussian(60.0),
    gaussian(8.0, "half_width", "intensity", peak=2.0),
    TABLE,
    ANISOTROPIC,
    BRUSHED,
    POINTS,
    anisotropic_gaussian(5.0, 20.0, 30.0),
    wide_tailed(4.0),
    ward(0.15, 0.3, 70.0),
]
COMBINED = [
    lambertian(0.5, 0.4, side="both"),
    gaussian(10.0, transmits=True),
    gaussian(10.0, transmits=True, refraction=1.5, side="back"),
    gaussian(20.0, transmits=True, refraction=0.7),
    sum_samples(gaussian(3.0, reflectance=0.3), gaussian(30.0, reflectance=0.3), lambertian(0.2), name="three"),
    sum_samples(lambertian(0.5), regular(0.3), regular(0.1, transmits=True, side="both"), name="with regular"),
    sum_samples(
        ward(0.4, 0.2, 20.0, 0.5, side="both"),
        anisotropic_gaussian(8.0, 25.0, 110.0, "half_width", reflectance=0.4, transmits=True, side="both"),
        wide_tailed(6.0, reflectance=0.1, transmits=True, side="back"),
        name="two widths",
    ),
    combine_sides(gaussian(5.0), lambertian(0.1), ANISOTROPIC, gaussian(12.0), name="four ways"),
]
MODELS = [*SINGLE, *COMBINED]


def model_name(scatterer: Scatterer) -> str:
    """Name of a model, for pytest."""
    return scatterer.name


def canonical_directions(vectors: Floats, incident: int, transmits: bool) -> Floats:
    """Observers' directions as seen by a reflecting lobe lit from the front (optics.md, section 2)."""
    turned = vectors * [1.0, incident, incident]
    return turned * [1.0, 1.0, -1.0] if transmits else turned
