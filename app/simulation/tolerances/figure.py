"""The figure of a tolerance study: each deviation alone, and the distribution of the criterion over all combinations."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine

from goniotwin.app.figures.style import CURVE_COLOURS, PAPER
from goniotwin.app.simulation.files import write_figure
from goniotwin.app.simulation.tolerances.result import Case, StudyResult
from goniotwin.app.simulation.tolerances.study import LIGHTS

DOTS_PER_INCH = 130
Style = str | tuple[int, tuple[int, ...]]
"""A line's name, or its dashes."""
MOST_DRAWN = 4000
"""Largest number of points of a line."""


def write_figures(result: StudyResult, path: Path, quantity: str) -> None:
    """Write the figure as PNG. Raises UserError."""
    with mpl.rc_context({"font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False}):
        height = max(4.6, 1.2 + 0.19 * len(result.case.parameters))
        layout = ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.06)
        figure = Figure(figsize=(11.5, height), layout=layout, facecolor="white")
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
        _draw_alone(left, result.case, quantity)
        _draw_distribution(right, result, quantity)
        figure.suptitle(f"SIMULATED: {result.study.name}", color=PAPER.bad, weight="bold", fontsize=12)
    write_figure(figure, path, DOTS_PER_INCH)


def _draw_alone(axes: Axes, case: Case, quantity: str) -> None:
    places = np.arange(len(case.parameters))
    for offset, column, colour, sign in ((-0.2, 0, CURVE_COLOURS[0], "-"), (0.2, 1, "#7fb3d5", "+")):
        values = np.nan_to_num(case.alone.percent[:, column], posinf=0.0)
        axes.barh(places + offset, values, height=0.38, color=colour, label=f"at {sign} its limit")
    for limit in case.combinations.within:
        axes.axvline(limit, color=PAPER.bad, lw=1.0, ls="--")
        axes.text(limit, -0.9, f" {limit:g} %", color=PAPER.bad, va="bottom", fontsize=9)
    titles = [f"{each.title}, +-{each.limit:g} {each.unit}" for each in case.parameters]
    axes.set_yticks(places, titles, fontsize=8 if len(places) > 15 else 9)
    axes.set(xlabel=f"{quantity}, %", ylim=(len(places) - 0.4, -1.0))
    axes.set_title("each deviation alone", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=9, loc="lower right")


def _draw_distribution(axes: Axes, result: StudyResult, quantity: str) -> None:
    largest = 0.0
    for case, colour in zip(result.cases, CURVE_COLOURS, strict=False):
        drawn = case.combinations
        kind = "all combinations" if drawn.complete else "random corners"
        largest = max(largest, case.worst.percent if np.isfinite(case.worst.percent) else 0.0)
        label = f"{case.name or f'{len(case.parameters)} deviations'}, {kind}; worst {case.worst.percent:.1f} %"
        _draw_line(axes, drawn.percent, colour, "-", label)
        axes.plot([case.worst.percent], [1.0], "o", color=colour, ms=5, clip_on=False)
    for (name, drawn), style in zip(result.yields.items(), ("--", ":"), strict=False):
        _draw_line(axes, drawn.percent, CURVE_COLOURS[0], style, f"yield, {name}")
    for each, colour in zip(() if result.lights is None else result.lights.lights[2:], reversed(CURVE_COLOURS), strict=False):
        label = f"illumination {LIGHTS[each.light]}; worst {each.worst.percent:.1f} %"
        _draw_line(axes, each.combinations.percent, colour, (0, (5, 1)), label)
        axes.plot([each.worst.percent], [1.0], "o", color=colour, ms=5, clip_on=False)
        largest = max(largest, each.worst.percent if np.isfinite(each.worst.percent) else 0.0)
    if result.recentred is not None:
        worst = result.recentred.worst.percent
        axes.axvline(worst, color="0.45", lw=1.2, ls="-.", label=f"worst about the measured peak, {worst:.2f} %")
    for limit in result.case.combinations.within:
        axes.axvline(limit, color=PAPER.bad, lw=1.0, ls="--")
    axes.set(xlabel=f"{quantity}, %", ylabel="share within", ylim=(0.0, 1.0), xlim=(0.0, 1.05 * largest))
    axes.set_title("all deviations together", loc="left", fontsize=11)
    axes.legend(frameon=False, fontsize=8.5, loc="lower right")
    axes.grid(alpha=0.25)


def _draw_line(axes: Axes, percent: np.ndarray, colour: str, style: Style, label: str) -> None:
    values = np.sort(percent)
    shares = np.arange(1, values.size + 1) / values.size
    chosen = np.unique(np.linspace(0, values.size - 1, min(values.size, MOST_DRAWN)).astype(np.int64))
    axes.plot(values[chosen], shares[chosen], color=colour, ls=style, lw=1.5, label=label)
