"""The paper's figure 13: points in the plane of incidence over the theory of their sample."""

import math
from collections.abc import Mapping
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset
from goniotwin.app.campaign.studies.theory import theoretical_bsdf
from goniotwin.app.figures.curves import ANGLE_LIMITS, ANGLE_TICKS, PLANE_AXIS, plane_angle
from goniotwin.app.figures.style import CURVE_COLOURS, PAPER
from goniotwin.app.simulation.paper.gaussian_cut import HIGHEST_ZENITH_DEG, WIDTHS
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction, evaluate, light_direction
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, TOLERANCE_DEG, polar_and_azimuth, round_deg


def cut_figure(reduced: BsdfDataset, sample: str, relative_rms_percent: Mapping[float, float], path: Path) -> None:
    """Write the paper's figure 13 as a PNG: points over theoretical curves in the plane of incidence; below, the deviation.

    `sample` is one with a known theory, and `relative_rms_percent` formula 5 by sigma. Blocked directions are shaded.
    """
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
    upper: Axes,
    lower: Axes,
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


def _draw_axes(upper: Axes, lower: Axes, reduced: BsdfDataset, sample: str) -> None:
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
