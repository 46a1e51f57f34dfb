"""The paper's figure 13: measured points over the theoretical curves in the plane of incidence, as a PNG."""

import math
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from goniotwin.app.campaign.reduction.comparison import Comparison, theory
from goniotwin.app.campaign.reduction.export import heading
from goniotwin.app.campaign.reduction.reduction import BsdfPoints, Reduced
from goniotwin.twin.optics import arc_direction, evaluate, light_direction

COLOURS = ("#c0392b", "#b7950b", "#1e8449", "#1f618d", "#6c3483", "#616a6b")


def cut_figure(reduced: Reduced, sample: str, comparisons: list[Comparison], path: Path) -> None:
    """Writes the figure of a sample whose theory is known: above the cuts, below the deviation from theory."""
    points = reduced.samples[sample].front
    chosen = points.where(points.in_plane)
    with mpl.rc_context({"font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False}):
        figure = Figure(figsize=(9.0, 6.4), dpi=150, layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 1))
        for comparison, colour in zip(comparisons, COLOURS * len(comparisons), strict=False):
            _cut(upper, lower, reduced, sample, chosen, comparison, colour)
        _dress(upper, lower, reduced, sample)
        figure.savefig(path)


def _cut(
    upper: Axes,
    lower: Axes,
    reduced: Reduced,
    sample: str,
    points: BsdfPoints,
    comparison: Comparison,
    colour: str,
) -> None:
    sigma = comparison.sigma_deg
    here = points.where(points.sigma_deg == sigma)
    good = here.where(here.good)
    x = _signed_zenith(good)
    order = np.argsort(x)
    angles = np.linspace(-89.0, 89.0, 1781)
    label = f"sigma {sigma:g} deg, relative RMS {comparison.relative_rms_percent:.2f} %"
    upper.plot(angles, _curve(reduced, sample, sigma, angles), color=colour, lw=1.2)
    upper.plot(x[order], good.luminance_factor[order], "o", ms=3.2, mfc="white", mec=colour, mew=0.9, label=label)
    for start, stop in _hidden(here):
        upper.axvspan(start, stop, ymax=0.97, color=colour, alpha=0.10, lw=0)
        upper.annotate(
            "hidden", (0.5 * (start + stop), 0.5), xycoords=("data", "axes fraction"), rotation=90, color=colour,
            fontsize=8, ha="center", va="center",
        )  # fmt: skip
    near = good.theta_deg <= 2.0 * _width(reduced, sample) + 1e-6
    close = good.where(near & (good.zenith_deg <= 85.0))
    deviation = 100.0 * (close.bsdf / theory(reduced.rig, sample, close) - 1.0)
    lower.plot(_signed_zenith(close), deviation, ".", ms=4, color=colour)


def _dress(upper: Axes, lower: Axes, reduced: Reduced, sample: str) -> None:
    upper.set_ylabel("luminance factor (pi times BRDF)")
    upper.set_ylim(bottom=0.0)
    upper.legend(loc="upper left", framealpha=1.0, edgecolor="white", title="points: measured, lines: theory")
    lower.axhline(0.0, color="0.6", lw=0.8)
    lower.set_ylabel("deviation, %\n(theta <= 2 widths)")
    lower.set_xlabel("zenith angle in the plane of incidence, deg (positive on the specular side)")
    lower.set_xlim(-90.0, 90.0)
    lower.set_xticks(range(-90, 91, 15))
    upper.set_title(f"{sample}: measured through the wires, and its theory", loc="left", fontsize=12)
    if reduced.simulated:
        text = heading(reduced)[-1].split(";")[0]
        upper.text(1.0, 1.02, text.split(":")[0] + f" (seed {reduced.rig.seed})", transform=upper.transAxes, ha="right",
                   va="bottom", color="#a93226", weight="bold")  # fmt: skip


def _curve(reduced: Reduced, sample: str, sigma: float, angles: np.ndarray) -> np.ndarray:
    model = reduced.rig.model()
    assert model is not None
    directions = arc_direction(np.abs(angles), np.where(angles > 0.0, 180.0, 0.0))
    return math.pi * evaluate(model.samples[sample], light_direction(sigma), directions)


def _width(reduced: Reduced, sample: str) -> float:
    twin = reduced.rig.file.twin
    assert twin is not None
    return float(getattr(twin.samples[sample], "width_deg", 45.0))


def _signed_zenith(points: BsdfPoints) -> np.ndarray:
    specular_side = np.cos(np.radians(points.azimuth_deg)) < 0.0
    return np.where(specular_side, points.zenith_deg, -points.zenith_deg)


def _hidden(points: BsdfPoints) -> list[tuple[float, float]]:
    """Ranges of signed zenith in which every direction is hidden, widened by half a step so that they meet the points."""
    x = np.round(_signed_zenith(points), 6)
    angles = np.unique(x)
    hidden = np.array([bool(points.shadowed[x == angle].all()) for angle in angles])
    step = float(np.min(np.diff(angles))) if angles.size > 1 else 1.0
    runs: list[tuple[float, float]] = []
    for angle in angles[hidden]:
        if runs and angle - runs[-1][1] <= 1.01 * step + 0.5 * step:
            runs[-1] = (runs[-1][0], float(angle) + 0.5 * step)
        else:
            runs.append((float(angle) - 0.5 * step, float(angle) + 0.5 * step))
    return runs
