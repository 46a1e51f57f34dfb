"""Theory: the known BSDF of a virtual rig's sample in the directions of measured points; with the paper's figure 13.

Measurement and reduction do not use it.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from goniotwin.app.campaign.geometry.directions import is_lower
from goniotwin.app.campaign.reduction.components import COVERAGE, deviation_in_u, mostly_added
from goniotwin.app.campaign.reduction.field_of_view import FieldOfView
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import ANGLE_LIMITS, ANGLE_TICKS, PLANE_AXIS, plane_angle
from goniotwin.app.figures.style import CURVE_COLOURS, PAPER
from goniotwin.app.rig import RigDescription, RigFile, nominal_instrument
from goniotwin.app.simulation.paper.gaussian_cut import HIGHEST_ZENITH_DEG, WIDTHS
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Scatterer, arc_direction, evaluate, light_direction
from goniotwin.twin.optics.geometry.coordinates import (
    SPECULAR_AZIMUTH_DEG,
    TOLERANCE_DEG,
    polar_and_azimuth,
    round_deg,
    zenith_and_azimuth,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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


def cut_figure(reduced: BsdfDataset, sample: str, relative_rms_percent: Mapping[float, float], path: Path) -> None:
    """Write the paper's figure 13 as a PNG: points over theoretical curves in the plane of incidence; below, the deviation.

    `sample` is one with a known theory, and `relative_rms_percent` formula 5 by sigma. Blocked directions are shaded.
    """
    import matplotlib as mpl  # a rehearsal needs the truth of a sample, and not the 30 MB of what draws
    from matplotlib.figure import Figure

    points = reduced.samples[sample].front
    chosen = points.where(points.in_plane)
    with mpl.rc_context({"font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.0, 6.4), dpi=150, layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        every = relative_rms_percent.items()
        for (sigma, percent), colour in zip(every, CURVE_COLOURS * len(every), strict=False):
            _draw_cut(upper, lower, reduced, sample, chosen, sigma, percent, colour)
        _draw_axes(upper, lower, reduced, sample)
        figure.savefig(path)


def _draw_cut(
    upper: "Axes",
    lower: "Axes",
    reduced: BsdfDataset,
    sample: str,
    points: BsdfPoints,
    sigma: float,
    percent: float,
    colour: str,
) -> None:
    here = points.where(points.sigma_deg == sigma)
    good = here.where(here.good)
    x = _signed_zenith(good)
    order = np.argsort(x)
    angles = np.linspace(-89.0, 89.0, 1781)
    label = f"sigma {sigma:g} deg, relative RMS {percent:.2f} %"
    upper.plot(angles, _theoretical_curve(reduced, sample, sigma, angles), color=colour, lw=1.2)
    upper.plot(x[order], good.luminance_factor[order], "o", ms=3.2, mfc="white", mec=colour, mew=0.9, label=label)
    for start, stop in _blocked_ranges(here):
        upper.axvspan(start, stop, ymax=0.97, color=colour, alpha=0.10, lw=0)
        upper.annotate(
            "blocked",
            (0.5 * (start + stop), 0.5),
            xycoords=("data", "axes fraction"),
            rotation=90,
            color=colour,
            fontsize=8,
            ha="center",
            va="center",
        )
    near = good.theta_deg <= WIDTHS * _width(reduced, sample) + TOLERANCE_DEG
    close = good.where(near & (good.zenith_deg <= HIGHEST_ZENITH_DEG))
    deviation = 100.0 * (close.bsdf / theoretical_bsdf(reduced.rig, sample, close) - 1.0)
    lower.plot(_signed_zenith(close), deviation, ".", ms=4, color=colour)


def _draw_axes(upper: "Axes", lower: "Axes", reduced: BsdfDataset, sample: str) -> None:
    upper.set_ylabel("luminance factor (pi times BRDF)")
    upper.set_ylim(bottom=0.0)
    upper.legend(loc="upper left", framealpha=1.0, edgecolor="white", title="points: measured, lines: theory")
    lower.axhline(0.0, color="0.6", lw=0.8)
    lower.set_ylabel("deviation, %\n(theta <= 2 widths)")
    lower.set_xlabel(PLANE_AXIS.label)
    lower.set_xlim(*ANGLE_LIMITS)
    lower.set_xticks(ANGLE_TICKS)
    upper.set_title(f"{sample}: measurement and theory", loc="left", fontsize=12)
    if reduced.simulated:
        text = f"SIMULATED (seed {reduced.rig.seed})"
        upper.text(1.0, 1.02, text, transform=upper.transAxes, ha="right", va="bottom", color=PAPER.bad, weight="bold")


def _theoretical_curve(reduced: BsdfDataset, sample: str, sigma: float, angles: Floats) -> Floats:
    """Luminance factors at signed zenith angles (n,) in the plane of incidence."""
    model = reduced.rig.model()
    assert model is not None
    directions = arc_direction(*polar_and_azimuth(angles, SPECULAR_AZIMUTH_DEG))
    return math.pi * evaluate(model.samples[sample], light_direction(sigma), directions)


def _width(reduced: BsdfDataset, sample: str) -> float:
    twin = reduced.rig.file.twin
    assert twin is not None
    return float(getattr(twin.samples[sample], "width_deg", 45.0))


def _signed_zenith(points: BsdfPoints) -> Floats:
    return plane_angle(points.zenith_deg, points.azimuth_deg)


def _blocked_ranges(points: BsdfPoints) -> list[tuple[float, float]]:
    """Ranges of signed zenith in which every direction is blocked, widened by half a step so that they meet the points."""
    x = round_deg(_signed_zenith(points))
    angles = np.unique(x)
    shadowed = points.flag("shadowed")
    blocked = np.array([bool(shadowed[x == angle].all()) for angle in angles])
    step = float(np.min(np.diff(angles))) if angles.size > 1 else 1.0
    ranges: list[tuple[float, float]] = []
    for angle in angles[blocked]:
        if ranges and angle - ranges[-1][1] <= 1.01 * step + 0.5 * step:
            ranges[-1] = (ranges[-1][0], float(angle) + 0.5 * step)
        else:
            ranges.append((float(angle) - 0.5 * step, float(angle) + 0.5 * step))
    return ranges
