"""Illumination of the sample (paper, figure 8): flux by both estimators of the illumination unit, map, profile and rayset.

The files are a CSV of map and profile, or a picture of both.
"""

import math
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.layout_engine import ConstrainedLayoutEngine
from matplotlib.patches import Rectangle

from goniotwin.app.errors import UserError
from goniotwin.app.figures.style import PAPER
from goniotwin.app.formats import PointStream
from goniotwin.app.formats.registry import Holds
from goniotwin.app.simulation.files import check_suffix, write_content, write_figure
from goniotwin.app.simulation.simulate import ReportProgress
from goniotwin.twin.optics import (
    Deviation,
    Illumination,
    IlluminationFigure,
    IlluminationUnit,
    Rayset,
    forward_illumination,
    illumination_figure,
    record,
)
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION
from goniotwin.twin.optics.illumination.unit import ELEMENTS
from goniotwin.twin.optics.montecarlo import NoLightError

ADJOINT_ERROR = 1e-4
"""Relative standard error of the adjoint flux: it costs little, and makes the profile smooth."""
FEWEST_RAYS, MOST_RAYS = 2, 5_000_000
DOTS_PER_INCH = 130


@dataclass(frozen=True, eq=False)
class IlluminationResult:
    """The data of the figure, with the adjoint estimate as its `field`, the forward estimate, and a rayset if requested."""

    unit: IlluminationUnit
    seed: int
    figure: IlluminationFigure
    forward: Illumination
    rayset: Rayset | None

    @property
    def adjoint(self) -> Illumination:
        """The adjoint estimate of the flux into the field: rays traced backwards."""
        return self.figure.field

    @property
    def difference_over_error(self) -> float:
        """Forward minus adjoint flux, over the standard error of the difference."""
        error = math.hypot(self.forward.flux_error, self.adjoint.flux_error)
        return (self.forward.flux - self.adjoint.flux) / error


def simulate_illumination(
    unit: IlluminationUnit,
    error_percent: float,
    seed: int,
    rays: int | None,
    report: ReportProgress = lambda _fraction, _step: None,
    adjoint_error: float = ADJOINT_ERROR,
) -> IlluminationResult:
    """Simulate the light of a unit: the forward flux to `error_percent`, and a rayset of `rays` if given.

    `adjoint_error` is the relative error of the adjoint flux. Raises UserError.
    """
    if not (math.isfinite(error_percent) and error_percent > 0.0):
        raise UserError(f"--error: {error_percent:g} is not possible; give a percentage above 0")
    if not 0 <= seed < 2**63:
        raise UserError(f"--seed: {seed} is not possible; give a whole number from 0")
    if rays is not None and not FEWEST_RAYS <= rays <= MOST_RAYS:
        raise UserError(f"--rays: {rays} is not possible; give {FEWEST_RAYS} to {MOST_RAYS}")
    if not unit.band_flux > 0.0:
        first, last = (float(unit.lamp.wavelength_nm[k]) for k in (0, -1))
        raise UserError(
            f"--wavelength: no light of the lamp passes at {unit.wavelength_nm:g} nm; give a wavelength of {first:g} to "
            f"{last:g} nm"
        )
    try:
        report(0.0, "adjoint")
        figure = illumination_figure(unit, relative_error=adjoint_error, seed=seed)
        report(0.2, "forward")
        forward = forward_illumination(unit, relative_error=0.01 * error_percent, seed=seed)
        report(0.8, "rayset" if rays is not None else "done")
        rayset = record(unit, rays, seed) if rays is not None else None
    except NoLightError:
        moved = ", ".join(
            f"{name}.{key}={value:g}" for name, own in describe_deviations(unit).items() for key, value in own.items()
        )
        what = f"with {moved} no light reaches" if moved else "no light reaches"
        raise UserError(f"illumination: {what} the sample; give smaller deviations, or another --wavelength") from None
    except ValueError as error:
        raise UserError(f"illumination: {error}") from None
    report(1.0, "done")
    return IlluminationResult(unit, seed, figure, forward, rayset)


def parse_deviations(given: list[str]) -> dict[str, Deviation]:
    """Deviations by element from `ELEMENT.FIELD=NUMBER` each, such as `slit.x_mm=0.02`. Raises UserError."""
    names, found, places = [each.name for each in fields(Deviation)], dict[str, Deviation](), set[str]()
    for text in given:
        place, equals, number = text.partition("=")
        element, dot, name = place.partition(".")
        if not (equals and dot):
            raise UserError(f"--deviation: {text!r} is no deviation; write ELEMENT.FIELD=NUMBER, such as slit.x_mm=0.02")
        if element not in ELEMENTS:
            raise UserError(f"--deviation: there is no {element!r} in the illumination unit; it has {', '.join(ELEMENTS)}")
        if name not in names:
            raise UserError(f"--deviation: {element} has no {name!r}; its deviations are {', '.join(names)}")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise UserError(f"--deviation: {text!r} has no number after the equals sign; give degrees or mm")
        if place in places:
            raise UserError(f"--deviation: {place} is given twice; remove one of them")
        places.add(place)
        found[element] = replace(found.get(element, NO_DEVIATION), **{name: value})
    return found


def describe_deviations(unit: IlluminationUnit) -> dict[str, dict[str, float]]:
    """The deviations that are not zero, by element and field."""
    values = {name: {each.name: getattr(own, each.name) for each in fields(own)} for name, own in unit.deviations.items()}
    lit = {name: {key: value for key, value in own.items() if value} for name, own in values.items()}
    return {name: own for name, own in lit.items() if own}


def format_estimate(name: str, result: Illumination) -> str:
    """Name, flux and its standard error in the same power of ten, as text."""
    power = math.floor(math.log10(result.flux))
    scale = 10.0**-power
    digits = max(1, 1 - math.floor(math.log10(result.flux_error * scale))) if result.flux_error > 0.0 else 4
    value, error = result.flux * scale, result.flux_error * scale
    return f"{name} ({value:.{digits}f} +- {error:.{digits}f})e{power:+03d} {result.unit}"


def assumptions(result: IlluminationResult) -> list[str]:
    """The assumptions behind the numbers, one line each."""
    unit = result.unit
    return [
        f"monochromator: {unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, edges as wide as the bandwidth of "
        f"{unit.bandwidth_nm:g} nm",
        f"field: {unit.field_side_mm:g} x {unit.field_side_mm:g} mm across the axis, {unit.sample_distance_mm:g} mm from the "
        f"exit pupil of {unit.exit_pupil_radius_mm:g} mm radius; the beam path is unfolded, and the mirrors lose no light",
        f"map: irradiance over twice the field, {len(result.figure.edges_mm) - 1} cells across, adjoint",
        "profile: intensity of the light in the field over the angle to the axis, adjoint",
        f"deviations: {_deviations_in_words(unit)}; lenses: ideal; lamp: xenon arc",
        f"geometry: {unit.fingerprint}; seed: {result.seed}",
    ]


def _deviations_in_words(unit: IlluminationUnit) -> str:
    every = [f"{name}.{key}={value:g}" for name, own in describe_deviations(unit).items() for key, value in own.items()]
    return ", ".join(every) or "none"


def summary(result: IlluminationResult) -> dict[str, Any]:
    """The result for JSON. Lengths are in mm, errors are standard errors."""
    width, width_error = result.adjoint.full_width_deg
    rayset = result.rayset
    return {
        "simulated": True,
        "unit": result.adjoint.unit,
        "wavelength_nm": result.unit.wavelength_nm,
        "interval_nm": result.unit.interval_nm,
        "bandwidth_nm": result.unit.bandwidth_nm,
        "field_mm": result.unit.field_side_mm,
        "deviations": describe_deviations(result.unit),
        "emitted_flux": result.adjoint.emitted_flux,
        "forward": _as_dict(result.forward),
        "adjoint": _as_dict(result.adjoint),
        "difference_over_error": result.difference_over_error,
        "uniformity": result.adjoint.uniformity,
        "full_width_deg": None if math.isnan(width) else width,
        "full_width_error_deg": None if math.isnan(width) else width_error,
        "geometry": result.unit.fingerprint,
        "seed": result.seed,
        "rayset": None
        if rayset is None
        else {"rays": int(rayset.flux.size), "flux": rayset.total_flux, "standard_error": rayset.total_flux_error},
        "assumptions": assumptions(result),
    }


def _as_dict(result: Illumination) -> dict[str, Any]:
    return {
        "flux": result.flux,
        "standard_error": result.flux_error,
        "rays": result.rays,
        "efficiency": result.efficiency,
    }


def check_file_names(out: Path, rayset: Path | None) -> None:
    """Check the names of the files before anything is computed. Raises UserError for a name that cannot be written."""
    check_suffix(out, Holds.COLUMNS, ".png")
    if rayset is not None:
        check_suffix(rayset, Holds.RAYS)


def write_illumination(result: IlluminationResult, path: Path) -> None:
    """Write one file, in the format of its suffix. Raises UserError."""
    if path.suffix.lower() == ".png":
        write_figure(_draw(result), path, DOTS_PER_INCH)
        return
    write_content(path, Holds.COLUMNS, PointStream(_heading(result), [_columns(result)]))


def _heading(result: IlluminationResult) -> list[str]:
    flux = ", ".join(format_estimate(*each) for each in (("forward", result.forward), ("adjoint", result.adjoint)))
    return [
        "SIMULATED: the illumination of the sample (paper, figure 8), computed with the virtual prototype; nothing is measured",
        f"flux into the field: {flux}",
        *assumptions(result),
        "table irradiance: one row per cell, with x (across) and z (up) of its middle; table intensity: one row per angle",
    ]


def _columns(result: IlluminationResult) -> dict[str, np.ndarray]:
    figure = result.figure
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


def _draw(result: IlluminationResult) -> Figure:
    with mpl.rc_context({"font.size": 10.0}):
        figure = Figure(figsize=(11.0, 5.4), layout=ConstrainedLayoutEngine(w_pad=0.12, h_pad=0.06), facecolor="white")
        left, right = figure.subplots(1, 2, width_ratios=(1.1, 1.0))
        _draw_map(figure, left, result)
        _draw_profile(right, result)
        unit = result.unit
        at = f"{unit.wavelength_nm:g} nm, interval {unit.interval_nm:g} nm, bandwidth {unit.bandwidth_nm:g} nm"
        figure.suptitle(f"SIMULATED: illumination of the sample, {at}", color=PAPER.bad, weight="bold", fontsize=12)
        side = f"{unit.field_side_mm:g} x {unit.field_side_mm:g} mm"
        flux = ", ".join(format_estimate(*each) for each in (("forward", result.forward), ("adjoint", result.adjoint)))
        figure.supxlabel(f"flux into {side}: {flux}", fontsize=10)
    return figure


def _draw_map(figure: Figure, axes: Axes, result: IlluminationResult) -> None:
    edges, half = result.figure.edges_mm, 0.5 * result.unit.field_side_mm
    mesh = axes.pcolormesh(edges, edges, result.figure.irradiance.T, cmap="inferno", vmin=0.0, rasterized=True)
    axes.add_patch(Rectangle((-half, -half), 2.0 * half, 2.0 * half, fill=False, ec="#1f9bcf", lw=1.5, ls="--"))
    axes.set(aspect="equal", xlabel="x across the axis, mm", ylabel="z, mm")
    axes.set_title(f"irradiance; dashed: the field, lowest over mean {result.adjoint.uniformity:.3f}", fontsize=10)
    figure.colorbar(mesh, ax=axes, label=f"irradiance, {result.figure.unit}/m$^2$", shrink=0.85)


def _draw_profile(axes: Axes, result: IlluminationResult) -> None:
    data = result.figure
    width, error = result.adjoint.full_width_deg
    last = float(data.angle_deg[data.intensity > 0.0].max())
    axes.errorbar(
        data.angle_deg, 1e3 * data.intensity, 1e3 * data.intensity_error, fmt="o-", ms=3.5, lw=1.2, color="#1f618d", capsize=2
    )
    label = f"full width at half maximum {width:.3f} +- {error:.3f} deg;\nthe dashed line is at half of it"
    height = float(np.interp(0.5 * width, data.angle_deg, 1e3 * data.intensity))
    axes.vlines(0.5 * width, 0.0, height, color="0.5", lw=1.0, ls="--", label=label)
    axes.set(xlabel="angle to the axis, deg", ylabel=f"intensity, m{data.unit}/sr", xlim=(0.0, 1.1 * last))
    axes.set_ylim(0.0, 1.25e3 * float(data.intensity.max()))
    axes.set_title("angular profile of the light in the field", fontsize=10)
    axes.legend(loc="upper right", frameon=False)
    axes.grid(alpha=0.25)
