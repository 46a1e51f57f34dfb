"""The response of the illumination unit by itself (paper, Table 1): flux into the central 5 x 5 mm, and its uniformity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.tolerances.study import FluxTable, Parameter, component_matrix
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, IlluminationUnit, adjoint_illumination, field_fluxes
from goniotwin.twin.optics.geometry.instrument import COMPONENTS
from goniotwin.twin.optics.illumination.unit import ELEMENTS


@dataclass(frozen=True, eq=False)
class LightByRays:
    """Flux relative to that without deviations, its standard error, and the uniformity, by a number of adjoint `rays`."""

    flux: float
    flux_error: float
    uniformity: float
    rays: int


class IlluminationLight:
    """Flux and uniformity of the light of a unit with deviations, by a quadrature without random numbers."""

    def __init__(self, unit: IlluminationUnit, criterion: FluxTable, parameters: Sequence[Parameter]) -> None:
        self.unit, self.criterion, self.parameters = unit, criterion, tuple(parameters)
        self._matrix = component_matrix(parameters, ELEMENTS)
        flux, uniformity = self._light(np.zeros((1, len(self.parameters))))
        self.flux, self.uniformity = float(flux[0]), float(uniformity[0])
        """Flux in the lamp's unit, and lowest irradiance of 5 x 5 cells over the mean, without deviations."""

    def residuals(self, values: Floats) -> Floats:
        """Relative change (n, 1) of the flux, for combinations (n, k) of the deviations."""
        return np.asarray(self._light(values)[0][:, None] / self.flux - 1.0)

    def relative(self, values: Floats) -> tuple[Floats, Floats]:
        """Flux relative to that without deviations, and uniformity, (n,) each."""
        flux, uniformity = self._light(values)
        return flux / self.flux, uniformity

    def deviations(self, values: Floats) -> Floats:
        """Components (n, elements, 6) of the unit's elements, in the order of `ELEMENTS` and of `Deviation`."""
        return np.asarray((values @ self._matrix).reshape(len(values), len(ELEMENTS), len(COMPONENTS)))

    def by_rays(self, values: Floats) -> LightByRays:
        """One combination (k,) by the adjoint estimator, which has nothing in common with the quadrature but the elements."""
        rays, seed = self.criterion.rays, self.criterion.seed
        rows = dict(zip(ELEMENTS, self.deviations(values[None])[0].tolist(), strict=True))
        unit = replace(self.unit, deviations={name: Deviation(*each) for name, each in rows.items() if any(each)})
        aligned = adjoint_illumination(replace(self.unit, deviations={}), rays=rays, seed=seed)
        found = adjoint_illumination(unit, rays=rays, seed=seed)
        flux = found.flux / aligned.flux
        error = math.hypot(found.flux_error, flux * aligned.flux_error) / aligned.flux
        return LightByRays(flux, error, found.uniformity if flux > 0.0 else 0.0, found.rays)

    def _light(self, values: Floats) -> tuple[Floats, Floats]:
        flux, uniformity = field_fluxes(self.unit, self.deviations(values))
        return flux, np.nan_to_num(uniformity)


class Evenness:
    """The response of the uniformity: its relative change."""

    def __init__(self, light: IlluminationLight) -> None:
        self._light = light

    def residuals(self, values: Floats) -> Floats:
        """Relative change (n, 1) of the uniformity."""
        return np.asarray(self._light.relative(values)[1][:, None] / self._light.uniformity - 1.0)
