"""Table 3 for people: on the terminal, and figures 12 and 13 as PNG."""

import textwrap
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.lines import Line2D
from rich.console import Console
from rich.table import Table

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.corner import deviating
from goniotwin.app.simulation.cut import STEP_DEG, cuts, theory
from goniotwin.app.simulation.explained import PAPER, SIGMAS_DEG, WIDTHS_DEG
from goniotwin.app.simulation.picture import save
from goniotwin.app.simulation.table3 import Table3
from goniotwin.app.simulation.table3_words import assumptions, explanations

COLOURS = ("#c0392b", "#c08a00", "#1e8449")
"""Of sigma 0, 30, 60: the paper's red, yellow and green, dark enough to read."""
MARK = "#a93226"
COLUMNS = {"paper": "paper", "noise_free": "noise-free", "tilted": "tilted", "worst": "worst corner"}


def show(console: Console, found: Table3) -> None:
    """Prints the table, the assumptions of each column, and what explains the paper's numbers."""
    table = Table(title="SIMULATED: relative RMS against theory (formula 5), %", title_justify="left")
    for column in ("sigma", "width", *COLUMNS.values()):
        table.add_column(column, justify="right")
    values = (PAPER, found.noise_free, found.tilted, found.worst)
    for i, sigma in enumerate(SIGMAS_DEG):
        for j, width in enumerate(WIDTHS_DEG):
            last = j == len(WIDTHS_DEG) - 1
            table.add_row(f"{sigma:g} deg", f"{width:g} deg", *(f"{each[i, j]:.2f}" for each in values), end_section=last)
    console.print(table)
    told = assumptions(found)
    for name, title in COLUMNS.items():
        console.print(f"\n{title}", style="bold")
        for topic, words in told[name].items():
            if name in ("paper", "noise_free") or words != told["noise_free"][topic]:
                _print(console, f"{topic}: {words}")
        if name in ("tilted", "worst"):
            _print(console, "else as noise-free")
    console.print("\nwhat explains the paper's numbers", style="bold")
    for words in explanations(found):
        _print(console, words)


def _print(console: Console, words: str) -> None:
    lines = textwrap.wrap(words, max(40, min(console.width, 120) - 2), initial_indent="- ", subsequent_indent="  ")
    console.print("\n".join(lines), markup=False, soft_wrap=True)


def figures(found: Table3, folder: Path) -> dict[str, Path]:
    """Writes both figures into a folder, which is made; returns their paths. Raises UserError."""
    paths = {"figure12": folder / "figure12.png", "figure13": folder / "figure13.png"}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with mpl.rc_context({"font.size": 10.0, "axes.spines.top": False, "axes.spines.right": False}):
            _gaussians(paths["figure12"])
            _compared(found, paths["figure13"])
    except OSError as error:
        raise UserError(f"{folder}: cannot be written: {error.strerror}; choose another folder with --out") from None
    return paths


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), dpi=150, layout=ConstrainedLayoutEngine(h_pad=0.08, w_pad=0.08), facecolor="white")


def _gaussians(path: Path) -> None:
    figure = _figure(8.0, 5.0)
    axes = figure.subplots()
    theta = np.linspace(-90.0, 90.0, 1441)
    for width, colour in zip(WIDTHS_DEG, ("#1f618d", "#6c3483", "#117a65", "#873600"), strict=True):
        axes.plot(theta, theory(theta, width, "one_over_e"), color=colour, lw=1.6, label=f"width {width:g} deg")
    axes.axhline(np.exp(-1.0), color="0.7", lw=0.8, ls=":")
    axes.text(-89.0, np.exp(-1.0) + 0.015, "1/e", color="0.4", fontsize=9)
    axes.set(
        xlabel="theta, deg from the specular direction", ylabel="luminance factor over its peak", xlim=(-90, 90), ylim=(0, 1.05)
    )
    axes.set_xticks(range(-90, 91, 15))
    axes.legend(frameon=False)
    axes.set_title("The Gaussians of formula 6, 1/e at the width", loc="left", fontsize=12)
    _mark(axes, "SIMULATED: theory, nothing measured")
    save(figure, path)


def _compared(found: Table3, path: Path) -> None:
    figure = _figure(10.5, 7.6)
    panels = figure.subplots(2, 2)
    for axes, width in zip(panels.ravel(), WIDTHS_DEG, strict=True):
        for sigma, colour in zip(SIGMAS_DEG, COLOURS, strict=True):
            _lobe(axes, found, sigma, width, colour)
        margin = max(6.0, 2.4 * width)
        axes.set(xlim=(-min(75.0, margin), min(86.0, 60.0 + margin)), ylim=(0, 1.05))
        axes.set_xlabel("zenith angle in the plane of incidence, deg")
        axes.set_ylabel("luminance factor over its peak")
        axes.set_title(f"width {width:g} deg", loc="left")
    handles = [Line2D([], [], color=colour, lw=2.0) for colour in COLOURS]
    names = [f"sigma {sigma:g} deg" for sigma in SIGMAS_DEG]
    handles += [Line2D([], [], color="0.2", lw=1.2), Line2D([], [], color="0.2", lw=1.8, ls=":")]
    names += ["theory (formula 6, 1/e at the width)", "simulated, worst corner of the deviations"]
    figure.legend(handles, names, loc="outside lower center", ncols=5, frameon=False, fontsize=9)
    title = "Gaussians in the plane of incidence, theory and virtual prototype"
    figure.suptitle(f"{title}\n", x=0.01, ha="left", fontsize=12)
    figure.text(0.99, 0.985, "SIMULATED: no obstruction, no noise", ha="right", va="top", color=MARK, weight="bold", fontsize=9)
    save(figure, path)


def _lobe(axes: Axes, found: Table3, sigma_deg: float, width_deg: float, colour: str) -> None:
    corner = found.corner(sigma_deg, width_deg)
    instrument = deviating(found.instrument, corner.components, corner.signs)
    widths = min(3.0, 75.0 / width_deg)
    (cut,) = cuts(instrument, [sigma_deg], width_deg, widths=widths, step_deg=min(STEP_DEG, width_deg / 20.0))
    zenith = sigma_deg - cut.theta_deg
    axes.plot(zenith, cut.theory, color=colour, lw=1.1)
    axes.plot(zenith, cut.simulated, color=colour, lw=2.0, ls=":")


def _mark(axes: Axes, text: str) -> None:
    axes.text(1.0, 1.02, text, transform=axes.transAxes, ha="right", va="bottom", color=MARK, weight="bold", fontsize=9)
