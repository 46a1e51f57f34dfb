"""Theory: the known BSDF of a virtual rig's sample in the directions of measured points.

Measurement and reduction do not use it.
"""

from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.geometry.directions import is_lower
from goniotwin.app.campaign.reduction.components import COVERAGE, deviation_in_u, mostly_added
from goniotwin.app.campaign.reduction.field_of_view import FieldOfView
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, RigFile, nominal_instrument
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Scatterer, arc_direction, evaluate, light_direction
from goniotwin.twin.optics.geometry.coordinates import zenith_and_azimuth

SLOPE_STEP_DEG, WAVELENGTH_STEP_NM = 0.01, 0.1


def theoretical_bsdf(rig: RigDescription, sample: str, points: BsdfPoints) -> Floats:
    """BSDF (n,) in 1/sr of a virtual rig's sample at the points' directions. Raises UserError for a real rig."""
    return true_bsdf(_scatterer(rig, sample), points)


def true_bsdf(scatterer: Scatterer, points: BsdfPoints) -> Floats:
    """BSDF (n,) in 1/sr of a model at the nominal wavelengths, incidences and directions of points."""
    result = np.empty(points.size)
    places, which = np.unique(np.stack([points.wavelength_nm, points.gamma_deg], axis=1), axis=0, return_inverse=True)
    sigmas, light = np.unique(points.sigma_deg, return_inverse=True)
    lights = np.array([light_direction(sigma) for sigma in sigmas.tolist()]).reshape(-1, 3)[light.ravel()]
    directions = arc_direction(points.zenith_deg, points.azimuth_deg)
    for k, (wavelength_nm, gamma_deg) in enumerate(places.tolist()):
        at = which.ravel() == k
        result[at] = evaluate(scatterer, lights[at], directions[at], wavelength_nm, gamma_deg)
    return result


def with_true_slopes(scatterer: Scatterer, points: BsdfPoints, rig: RigFile) -> BsdfPoints:
    """The points with the slopes of a model at their nominal directions and, where they were measured, with its slope over the
    wavelength and its correction of the field of view: those of the values follow their noise.
    """
    truth = true_bsdf(scatterer, points)
    slopes = []
    for turn in ((SLOPE_STEP_DEG, 0.0), (0.0, SLOPE_STEP_DEG)):
        ahead, behind = (moved_logarithm(scatterer, points, *(sign * np.array(turn))) for sign in (1.0, -1.0))
        slopes.append((ahead - behind) / (2.0 * SLOPE_STEP_DEG))
    longer, shorter = (
        true_bsdf(scatterer, replace(points, places=points.places + sign * np.eye(len(PLACE))[0] * WAVELENGTH_STEP_NM))
        for sign in (1.0, -1.0)
    )
    over_wavelength = (longer - shorter) / (2.0 * WAVELENGTH_STEP_NM * np.where(truth > 0.0, truth, np.nan))
    known = np.isfinite(points.wavelength_slope)
    correction = FieldOfView.of(replace(points, bsdf=truth), nominal_instrument(rig)).correction
    corrected = (points.field_correction != 0.0) & np.isfinite(correction)
    return replace(
        points,
        slope_along=slopes[0],
        slope_across=slopes[1],
        field_correction=np.where(corrected, correction, points.field_correction),
        wavelength_slope=np.where(known, over_wavelength, points.wavelength_slope),
    )


def moved_logarithm(scatterer: Scatterer, points: BsdfPoints, along: Floats | float, across: Floats | float) -> Floats:
    """Logarithm (n,) of a model's BSDF at the points' directions, turned by so many degrees along the arc and across it."""
    polar = points.zenith_deg * (np.pi / 180.0)
    azimuth = np.radians(points.azimuth_deg)
    level = np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros(azimuth.size)], axis=1)
    ahead = np.stack([np.cos(polar) * level[:, 1], -np.cos(polar) * level[:, 0], -np.sin(polar)], axis=1)
    up = np.where(is_lower(points.zenith_deg), -1.0, 1.0)
    turn = (up * np.radians(along))[:, None] * ahead + (up * np.radians(across))[:, None] * level
    zenith, around = zenith_and_azimuth(arc_direction(points.zenith_deg, points.azimuth_deg) + turn)
    moved = true_bsdf(scatterer, replace(points, zenith_deg=zenith, azimuth_deg=around))
    return np.log(np.maximum(moved, np.finfo(float).tiny))


def deviations_in_u(points: BsdfPoints, truth: Floats) -> Floats:
    """Deviations (n,) of values from the truth in their u: a value is within its interval where they are within COVERAGE.

    Where an interval has other ends, in as many parts of it.
    """
    found = deviation_in_u(points.bsdf, points.u_bsdf, noisy(points), truth)
    down, up = points.coverage.T
    return np.asarray(found * COVERAGE / np.where(found > 0.0, down, up))


def relative_residuals(points: BsdfPoints, truth: Floats) -> Floats:
    """Relative deviations (n,) from the truth, for a fit of inputs: of the logarithm where a value is not mostly noise.

    Also where u is below 15 %, and an interval is linear: the model is one of the logarithm, and its second order (u^2 / 2, far
    less than u) may be more than the independent part of u that the fit leaves.
    """
    value = np.where(points.bsdf == 0.0, 1.0, points.bsdf)  # as in effects_of
    clear = (value > 0.0) & (truth > 0.0) & ~noisy(points)
    ratio = np.where(clear, value, 1.0) / np.where(clear, truth, 1.0)
    return np.where(clear, np.log(ratio), (points.bsdf - truth) / value)


def noisy(points: BsdfPoints) -> Flags:
    """The points (n,) of whose variance more than half is added to a value whatever its size."""
    return mostly_added(points.components)


def _scatterer(rig: RigDescription, sample: str) -> Scatterer:
    model = rig.model()
    if model is None or sample not in model.samples:
        raise UserError(f"{rig.name}: {sample!r} is not a sample of a virtual rig, so there is no theory to compare with")
    return model.samples[sample]
