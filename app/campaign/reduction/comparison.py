"""Measured points against the BSDF that the virtual rig's sample has: the paper's formula 5.

Only this and the figure read the theory; measurement and reduction do not know it.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.reduction.reduction import BsdfPoints
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.samples import GaussianTable
from goniotwin.app.simulation.paper.gaussian_cut import HIGHEST_ZENITH_DEG, WIDTHS, relative_rms_percent
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Scatterer, arc_direction, evaluate, light_direction


@dataclass(frozen=True)
class Comparison:
    """At one sigma: relative RMS in percent over `count` directions, and the hidden ones that would have belonged to it.

    `hidden_deg` are their theta: negative on the grazing side of the specular direction.
    """

    sigma_deg: float
    relative_rms_percent: float
    count: int
    hidden_deg: tuple[float, ...]


def theory(rig: RigDescription, sample: str, points: BsdfPoints) -> Floats:
    """BSDF in 1/sr of the virtual rig's sample at the points' directions. Raises UserError for a rig that is not virtual."""
    scatterer = _scatterer(rig, sample)
    lights = np.array([light_direction(float(sigma)) for sigma in points.sigma_deg]).reshape(-1, 3)
    return evaluate(scatterer, lights, arc_direction(points.zenith_deg, points.azimuth_deg))


def compare(rig: RigDescription, sample: str, points: BsdfPoints) -> list[Comparison]:
    """Each sigma of a Gaussian sample: the plane of incidence, theta <= 2 widths, zenith <= 85 deg, not hidden.

    A direction that two photodiodes saw counts once, with the mean. Raises UserError for a sample that is no Gaussian.
    """
    table = rig.file.twin.samples.get(sample) if rig.file.twin is not None else None
    if not isinstance(table, GaussianTable):
        raise UserError(f"{rig.name}: {sample!r} is not a Gaussian sample of a virtual rig, so formula 5 has no range")
    points = points.front
    chosen = points.in_plane & (points.theta_deg <= WIDTHS * table.width_deg + 1e-6)
    chosen &= points.zenith_deg <= HIGHEST_ZENITH_DEG + 1e-6
    found = []
    for sigma in np.unique(points.sigma_deg):
        here = points.where(chosen & (points.sigma_deg == sigma))
        seen = here.where(here.good)
        measured, expected = _once_each(seen, seen.luminance_factor, math.pi * theory(rig, sample, seen))
        hidden = here.where(here.shadowed).aspecular_deg
        found.append(
            Comparison(
                float(sigma),
                relative_rms_percent(measured, expected),
                measured.size,
                tuple(float(each) for each in np.unique(np.round(hidden, 6))),
            )
        )
    return found


def _once_each(points: BsdfPoints, *values: Floats) -> list[Floats]:
    """Means of `values` over the points that share a direction."""
    directions = np.round(arc_direction(points.zenith_deg, points.azimuth_deg), 6).reshape(-1, 3)
    _, which, counts = np.unique(directions, axis=0, return_inverse=True, return_counts=True)
    return [np.bincount(which.ravel(), weights=each, minlength=counts.size) / counts for each in values]


def _scatterer(rig: RigDescription, sample: str) -> Scatterer:
    model = rig.model()
    if model is None or sample not in model.samples:
        raise UserError(f"{rig.name}: no virtual rig says what {sample!r} is, so there is no theory to compare with")
    return model.samples[sample]
