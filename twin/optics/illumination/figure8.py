"""Figure 8 of the paper as data: how uniform the illumination of the sample is, and how far it diverges."""

from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.adjoint import adjoint_illumination
from goniotwin.twin.optics.illumination.beam import Illumination
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

# The map shows the slit's image with its edges: so much wider than the field.
MARGIN = 2.0
# Rays of a cell of the map, at least: its error is then below 1 %.
CELL_RAYS = 256


@dataclass(frozen=True, eq=False)
class IlluminationFigure:
    """The main output of the illumination unit (paper, figure 8), ready to be drawn.

    Map: `irradiance` [x, z] (n, n) and its standard errors in `unit`/m^2, over the cells between `edges_mm` (n + 1,) in
    both directions. Profile: `intensity` (bins,) and its standard errors in `unit`/sr against the `angle_deg` (bins,) to
    the axis, of the light in the central `field` alone, whose flux, uniformity and full width are there too.
    """

    unit: str
    edges_mm: Floats
    irradiance: Floats
    irradiance_error: Floats
    angle_deg: Floats
    intensity: Floats
    intensity_error: Floats
    field: Illumination


def illumination_figure(
    unit: IlluminationUnit, cells: int = 40, bins: int = 40, relative_error: float = 0.001, seed: int = 0
) -> IlluminationFigure:
    """Data of the paper's figure 8. `cells` is across the map of twice the field; `relative_error` that of the flux.

    The lit square is the slit's image, 14 times larger: 7 mm for a field of 5 mm. What is uniform is the irradiance: without
    deviations to 0.1 % over the field and to 1 % over the square (the arc's chords), with edges that are sharp because the
    lenses are ideal. What is not is the exit pupil: its rim is a quarter darker than its centre (the cosines in front of
    the f/1 condenser), so that the beam is narrower than one from a uniform pupil. Raises ValueError as
    `adjoint_illumination`.
    """
    field = adjoint_illumination(unit, relative_error=relative_error, bins=bins, seed=seed)
    side = MARGIN * unit.field_side_mm
    wide = adjoint_illumination(
        unit, rays=max(field.rays, CELL_RAYS * cells * cells), cells=cells, bins=bins, side_mm=side, seed=seed
    )
    return IlluminationFigure(
        unit=field.unit,
        edges_mm=np.linspace(-0.5 * side, 0.5 * side, cells + 1),
        irradiance=wide.irradiance,
        irradiance_error=wide.irradiance_error,
        angle_deg=0.5 * (field.angle_edges_deg[1:] + field.angle_edges_deg[:-1]),
        intensity=field.intensity,
        intensity_error=field.angular_flux_error / field.solid_angles_sr,
        field=field,
    )
