"""The paper's figure 8 and the light on the sample, by both estimators of the illumination unit; and its rays."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from goniotwin.app.errors import UserError
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
class Illuminated:
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


def illuminated(
    unit: IlluminationUnit, error_percent: float, seed: int, rays: int | None, progress: Progress = lambda _share, _text: None
) -> Illuminated:
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
    return Illuminated(unit, seed, figure, forward, rayset)


def estimate_in_words(name: str, found: Illumination) -> str:
    """Flux and its standard error in the same power of ten."""
    power = math.floor(math.log10(found.flux))
    scale = 10.0**-power
    digits = max(1, 1 - math.floor(math.log10(found.flux_error * scale))) if found.flux_error > 0.0 else 4
    value, error = found.flux * scale, found.flux_error * scale
    return f"{name} ({value:.{digits}f} +- {error:.{digits}f})e{power:+03d} {found.unit}"


def assumptions(found: Illuminated) -> list[str]:
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


def summary(found: Illuminated) -> dict[str, Any]:
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
