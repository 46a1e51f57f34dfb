"""The paper's figure 8 and the light on the sample, by both estimators of the illumination unit; and its rays.

The paper's figure 8 as a file: a CSV of map and profile, or both as a picture.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError, write_points_csv
from goniotwin.app.simulation.files import write_figure
from goniotwin.twin.optics import (
    Illumination,
    IlluminationFigure,
    IlluminationUnit,
    Rayset,
    forward_illumination,
    illumination_figure,
    record,
)

ADJOINT_ERROR = 1e-4
"""Of the flux: cheap, and the profile is smooth."""
FEWEST_RAYS, MOST_RAYS = 2, 5_000_000
Progress = Callable[[float, str], None]


@dataclass(frozen=True, eq=False)
class IlluminationResult:
    """What came out: the figure's data, of which `field` is the adjoint estimate, the forward one, and a rayset if wanted."""

    unit: IlluminationUnit
    seed: int
    figure: IlluminationFigure
    forward: Illumination
    rayset: Rayset | None

    @property
    def adjoint(self) -> Illumination:
        """The flux into the field, backwards."""
        return self.figure.field

    @property
    def difference_over_error(self) -> float:
        """Forward less adjoint flux, over the standard error of that."""
        error = math.hypot(self.forward.flux_error, self.adjoint.flux_error)
        return (self.forward.flux - self.adjoint.flux) / error


def simulate_illumination(
    unit: IlluminationUnit, error_percent: float, seed: int, rays: int | None, progress: Progress = lambda _share, _text: None
) -> IlluminationResult:
    """Of a unit; the forward flux to `error_percent`, and a rayset of `rays` if wanted. Raises UserError."""
    if not (math.isfinite(error_percent) and error_percent > 0.0):
        raise UserError(f"--error: {error_percent:g} will not do; give a percentage above 0")
    if not 0 <= seed < 2**63:
        raise UserError(f"--seed: {seed} will not do; give a whole number from 0")
    if rays is not None and not FEWEST_RAYS <= rays <= MOST_RAYS:
        raise UserError(f"--rays: {rays} will not do; give {FEWEST_RAYS} to {MOST_RAYS}")
    if not unit.band_flux > 0.0:
        first, last = (float(unit.lamp.wavelength_nm[k]) for k in (0, -1))
        raise UserError(
            f"--wavelength: no light of the lamp passes at {unit.wavelength_nm:g} nm; it has {first:g} to {last:g} nm"
        )
    try:
        progress(0.0, "adjoint")
        figure = illumination_figure(unit, relative_error=ADJOINT_ERROR, seed=seed)
        progress(0.2, "forward")
        forward = forward_illumination(unit, relative_error=0.01 * error_percent, seed=seed)
        progress(0.8, "rayset" if rays is not None else "done")
        rayset = record(unit, rays, seed) if rays is not None else None
    except ValueError as error:
        raise UserError(f"illumination: {error}") from None
    progress(1.0, "done")
    return IlluminationResult(unit, seed, figure, forward, rayset)


def format_estimate(name: str, found: Illumination) -> str:
    """Flux and its standard error in the same power of ten."""
    power = math.floor(math.log10(found.flux))
    scale = 10.0**-power
    digits = max(1, 1 - math.floor(math.log10(found.flux_error * scale))) if found.flux_error > 0.0 else 4
    value, error = found.flux * scale, found.flux_error * scale
    return f"{name} ({value:.{digits}f} +- {error:.{digits}f})e{power:+03d} {found.unit}"


def assumptions(found: IlluminationResult) -> list[str]:
    """What a reader has to know, one line each."""
    unit = found.unit
    return [
        f"monochromator: {unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, edges as wide as the bandwidth of "
        f"{unit.bandwidth_nm:g} nm",
        f"field: {unit.field_side_mm:g} x {unit.field_side_mm:g} mm across the axis, {unit.sample_distance_mm:g} mm from the "
        f"exit pupil of {unit.exit_pupil_radius_mm:g} mm radius; the mirrors are unfolded, and lose nothing here",
        f"map: irradiance over twice the field, {len(found.figure.edges_mm) - 1} cells across, adjoint",
        "profile: intensity of the light in the field over the angle to the axis, adjoint",
        "deviations: none; lenses: ideal; lamp: xenon arc",
        f"geometry: {unit.fingerprint}; seed: {found.seed}",
    ]


def summary(found: IlluminationResult) -> dict[str, Any]:
    """The result for programs. Lengths in mm, errors are standard errors."""
    width, width_error = found.adjoint.full_width_deg
    rayset = found.rayset
    return {
        "simulated": True,
        "unit": found.adjoint.unit,
        "wavelength_nm": found.unit.wavelength_nm,
        "interval_nm": found.unit.interval_nm,
        "bandwidth_nm": found.unit.bandwidth_nm,
        "field_mm": found.unit.field_side_mm,
        "emitted_flux": found.adjoint.emitted_flux,
        "forward": _as_dict(found.forward),
        "adjoint": _as_dict(found.adjoint),
        "difference_over_error": found.difference_over_error,
        "uniformity": found.adjoint.uniformity,
        "full_width_deg": None if math.isnan(width) else width,
        "full_width_error_deg": None if math.isnan(width) else width_error,
        "geometry": found.unit.fingerprint,
        "seed": found.seed,
        "rayset": None
        if rayset is None
        else {"rays": int(rayset.flux.size), "flux": rayset.total_flux, "standard_error": rayset.total_flux_error},
        "assumptions": assumptions(found),
    }


def _as_dict(found: Illumination) -> dict[str, Any]:
    return {
        "flux": found.flux,
        "standard_error": found.flux_error,
        "rays": found.rays,
        "efficiency": found.efficiency,
    }


SUFFIXES = (".csv", ".png")
DOTS_AN_INCH = 130
MARK = "#a93226"


def check_file_names(out: Path, rayset: Path | None) -> None:
    """Raises UserError for names that will not do, before anything is computed."""
    if out.suffix.lower() not in SUFFIXES:
        raise UserError(f"{out}: what should be written? give a name that ends with .csv or .png")
    for path in (out, *([] if rayset is None else [rayset])):
        if not path.parent.is_dir():
            raise UserError(f"{path}: there is no folder {path.parent}; make it, or choose another name")
    if rayset is not None and rayset.suffix.lower() not in (".h5", ".hdf5"):
        raise UserError(f"--rayset: {rayset}: give a name that ends with .h5")


def write_illumination(found: IlluminationResult, path: Path) -> None:
    """As the name says. Raises UserError."""
    if path.suffix.lower() == ".png":
        write_figure(_drawn(found), path, DOTS_AN_INCH)
        return
    try:
        write_points_csv(path, _about(found), _columns(found))
    except FormatError as error:
        raise UserError(str(error)) from None


def _about(found: IlluminationResult) -> list[str]:
    flux = ", ".join(format_estimate(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
    return [
        "SIMULATED: the illumination of the sample (paper, figure 8), computed with the virtual prototype; nothing is measured",
        f"flux into the field: {flux}",
        *assumptions(found),
        "table irradiance: a row for each cell, x across and z up in its middle; table intensity: a row for each angle",
    ]


def _columns(found: IlluminationResult) -> dict[str, np.ndarray]:
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


def _drawn(found: IlluminationResult) -> Figure:
    with mpl.rc_context({"font.size": 10.0}):
        figure = Figure(figsize=(11.0, 5.4), layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.06), facecolor="white")
        left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
        _map(figure, left, found)
        _profile(right, found)
        unit = found.unit
        at = f"{unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, bandwidth {unit.bandwidth_nm:g} nm"
        figure.suptitle(f"SIMULATED: illumination of the sample, {at}", color=MARK, weight="bold", fontsize=12)
        side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
        flux = ", ".join(format_estimate(*each) for each in (("forward", found.forward), ("adjoint", found.adjoint)))
        figure.supxlabel(f"flux into {side}: {flux}", fontsize=10)
    return figure


def _map(figure: Figure, axes: Axes, found: IlluminationResult) -> None:
    edges, half = found.figure.edges_mm, 0.5 * found.unit.field_side_mm
    mesh = axes.pcolormesh(edges, edges, found.figure.irradiance.T, cmap="inferno", vmin=0.0, rasterized=True)
    axes.add_patch(Rectangle((-half, -half), 2.0 * half, 2.0 * half, fill=False, ec="#1f9bcf", lw=1.5, ls="--"))
    axes.set(aspect="equal", xlabel="x across the axis, mm", ylabel="z, mm")
    axes.set_title(f"irradiance; dashed: the field, least over mean {found.adjoint.uniformity:.3f}", fontsize=10)
    figure.colorbar(mesh, ax=axes, label=f"irradiance, {found.figure.unit}/m$^2$", shrink=0.85)


def _profile(axes: Axes, found: IlluminationResult) -> None:
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
