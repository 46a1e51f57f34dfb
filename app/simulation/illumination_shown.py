"""The paper's figure 8 as a file: a CSV of map and profile, or both as a picture."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError, write_points_csv
from goniotwin.app.simulation.illumination import Illuminated, assumptions, estimate_in_words
from goniotwin.app.simulation.picture import save

SUFFIXES = (".csv", ".png")
DOTS_AN_INCH = 130
MARK = "#a93226"


def check_names(out: Path, rayset: Path | None) -> None:
    """Raises UserError for names that will not do, before anything is computed."""
    if out.suffix.lower() not in SUFFIXES:
        raise UserError(f"{out}: what should be written? give a name that ends with .csv or .png")
    for path in (out, *([] if rayset is None else [rayset])):
        if not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}; make it, or choose another name")
    if rayset is not None and rayset.suffix.lower() not in (".h5", ".hdf5"):
        raise UserError(f"--rayset: {rayset}: give a name that ends with .h5")


def write_illumination(found: Illuminated, path: Path) -> None:
    """As the name says. Raises UserError."""
    if path.suffix.lower() == ".png":
        save(_drawn(found), path, DOTS_AN_INCH)
        return
    try:
        write_points_csv(path, _about(found), _columns(found))
    except FormatError as error:
        raise UserError(str(error)) from None


def _about(found: Illuminated) -> list[str]:
    flux = ", ".join(estimate_in_words(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
    return [
        "SIMULATED: the illumination of the sample (paper, figure 8), computed with the virtual prototype; nothing is measured",
        f"flux into the field: {flux}",
        *assumptions(found),
        "table irradiance: a row for each cell, x across and z up in its middle; table intensity: a row for each angle",
    ]


def _columns(found: Illuminated) -> dict[str, np.ndarray]:
    figure = found.figure
    middles = 0.5 * (figure.edges_mm[1:] + figure.edges_mm[:-1])
    x, z = np.meshgrid(middles, middles, indexing="ij")
    cells, angles = x.size, figure.angle_deg.size
    return {
        "table": np.repeat(["irradiance", "intensity"], [cells, angles]),
        "x_mm": np.concatenate([x.ravel(), np.full(angles, np.nan)]),
        "z_mm": np.concatenate([z.ravel(), np.full(angles, np.nan)]),
        "angle_deg": np.concatenate([np.full(cells, np.nan), figure.angle_deg]),
        "value": np.concatenate([figure.irradiance.ravel(), figure.intensity]),
        "standard_error": np.concatenate([figure.irradiance_error.ravel(), figure.intensity_error]),
        "unit": np.repeat([f"{figure.unit}/m^2", f"{figure.unit}/sr"], [cells, angles]),
    }


def _drawn(found: Illuminated) -> Figure:
    with mpl.rc_context({"font.size": 10.0}):
        figure = Figure(figsize=(11.0, 5.4), layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.06), facecolor="white")
        left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
        _map(figure, left, found)
        _profile(right, found)
        unit = found.unit
        at = f"{unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, bandwidth {unit.bandwidth_nm:g} nm"
        figure.suptitle(f"SIMULATED: illumination of the sample, {at}", color=MARK, weight="bold", fontsize=12)
        side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
        flux = ", ".join(estimate_in_words(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
        figure.supxlabel(f"flux into {side}: {flux}", fontsize=10)
    return figure


def _map(figure: Figure, axes: Axes, found: Illuminated) -> None:
    edges, half = found.figure.edges_mm, 0.5 * found.unit.field_side_mm
    mesh = axes.pcolormesh(edges, edges, found.figure.irradiance.T, cmap="inferno", vmin=0.0, rasterized=True)
    axes.add_patch(Rectangle((-half, -half), 2.0 * half, 2.0 * half, fill=False, ec="#1f9bcf", lw=1.5, ls="--"))
    axes.set(aspect="equal", xlabel="x across the axis, mm", ylabel="z, mm")
    axes.set_title(f"irradiance; dashed: the field, least over mean {found.adjoint.uniformity:.3f}", fontsize=10)
    figure.colorbar(mesh, ax=axes, label=f"irradiance, {found.figure.unit}/m$^2$", shrink=0.85)


def _profile(axes: Axes, found: Illuminated) -> None:
    data = found.figure
    width, error = found.adjoint.full_width_deg
    last = float(data.angle_deg[data.intensity > 0.0].max())
    axes.errorbar(
        data.angle_deg, 1e3 * data.intensity, 1e3 * data.intensity_error, fmt="o-", ms=3.5, lw=1.2, color="#1f618d", capsize=2
    )
    label = f"full width at half maximum {width:.3f} +- {error:.3f} deg:\nthe dashed line is half of it"
    height = float(np.interp(0.5 * width, data.angle_deg, 1e3 * data.intensity))
    axes.vlines(0.5 * width, 0.0, height, color="0.5", lw=1.0, ls="--", label=label)
    axes.set(xlabel="angle to the axis, deg", ylabel=f"intensity, m{data.unit}/sr", xlim=(0.0, 1.1 * last))
    axes.set_ylim(0.0, 1.25e3 * float(data.intensity.max()))
    axes.set_title("angular profile of the light in the field", fontsize=10)
    axes.legend(loc="upper right", frameon=False)
    axes.grid(alpha=0.25)
