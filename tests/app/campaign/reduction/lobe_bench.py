"""Lobes of closed form as measured points, and their corrections, for tests of the field of view."""

import math

import numpy as np

from goniotwin.app.campaign.measurement_model.field import directions_covariance
from goniotwin.app.campaign.reduction.field_of_view import (
    merge_directions,
)
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Instrument,
    arc_direction,
    to_specular,
)
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG, SMALL

EVERYWHERE = np.arange(0.0, 85.1, 1.0)


PLANE = (0.0, 180.0)


SETTINGS = reduction_settings(read_rig(RIG).file, parse_schedule(SMALL, "small.toml").file, None, "")


INSTRUMENT = nominal_instrument(SETTINGS.rig)


def lobe(width_deg: float, theta_deg: Floats) -> Floats:
    return np.asarray(10.0 * np.exp(-((theta_deg / width_deg) ** 2)))


def points_of(
    values: Floats | float, polar: Floats = EVERYWHERE, beta: tuple[float, ...] = PLANE, sigma: float = 30.0, u: float = 1e-9
) -> BsdfPoints:
    """Points on arcs at some beta; `values` is the width of a Gaussian lobe, or a value for each direction.

    A value below three `u` counts as without light.
    """
    zenith, azimuth = (each.ravel() for each in np.broadcast_arrays(polar[:, None], np.array(beta)))
    theta, _ = to_specular(sigma, arc_direction(zenith, azimuth))
    return made_points(sigma, zenith, azimuth, lobe(values, theta) if isinstance(values, float) else values, u)


def covariance_of(points: BsdfPoints, instrument: Instrument = INSTRUMENT) -> Floats:
    """Covariance (n, 2, 2) of the directions at each point, deg^2."""
    values = merge_directions(points)
    c1, c2, c12 = (
        math.degrees(1.0) ** 2
        * directions_covariance(instrument, values.directions, values.sigma, values.transmitted)[values.which].T
    )
    return np.stack([np.stack([c1, c12], axis=-1), np.stack([c12, c2], axis=-1)], axis=-2)


def axes_of(points: BsdfPoints) -> tuple[Floats, Floats, Floats]:
    """Directions and both axes of the slopes, (n, 3) each, as `BsdfPoints` defines them."""
    zenith, azimuth = np.radians(points.zenith_deg), np.radians(points.azimuth_deg)
    up = np.where(points.zenith_deg > 90.0, -1.0, 1.0)
    seen = arc_direction(points.zenith_deg, points.azimuth_deg)
    along = np.stack([np.cos(zenith) * np.cos(azimuth), np.cos(zenith) * np.sin(azimuth), -np.sin(zenith)], axis=1)
    along *= up[:, None]
    return seen, along, np.cross(seen, along)


def known(width_deg: float, points: BsdfPoints) -> tuple[Floats, Floats]:
    """Correction (n,) and slopes (n, 2), per degree, of y = exp(-(theta / a)^2): matrices, not the reduction's formulas."""
    a, theta = math.radians(width_deg), np.radians(points.theta_deg)
    centre = arc_direction(points.sigma_deg, 180.0)
    _, along, across = axes_of(points)
    away = np.stack([np.sum(-centre * each, axis=1) for each in (along, across)], axis=1)
    size = np.linalg.norm(away, axis=1, keepdims=True)
    away = np.where(size > 1e-9, away / np.maximum(size, 1e-9), [1.0, 0.0])
    aside = np.stack([-away[:, 1], away[:, 0]], axis=1)
    round_it = np.where(theta > 1e-6, theta / np.tan(np.maximum(theta, 1e-6)), 1.0)
    radial, tangential = (np.einsum("ni,nj->nij", each, each) for each in (away, aside))
    second = -2.0 / a**2 * (radial + round_it[:, None, None] * tangential)
    first = -2.0 * (theta / a**2)[:, None] * away
    field = covariance_of(points) * math.radians(1.0) ** 2
    one = np.eye(2) + field @ second
    pulled = np.linalg.solve(one, np.einsum("nij,nj->ni", field, first)[..., None])[..., 0]
    slope = np.linalg.solve(np.swapaxes(one, 1, 2), first[..., None])[..., 0]
    return -0.5 * np.log(np.linalg.det(one)) - 0.5 * np.sum(first * pulled, axis=1), np.radians(slope)
