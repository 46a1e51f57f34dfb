"""The response of the illumination unit by itself (paper, Table 1): flux into the central 5 x 5 mm, and its uniformity."""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np

from goniotwin.app.simulation.tolerances.study import FluxTable, Parameter, component_matrix
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, IlluminationUnit, adjoint_illumination
from goniotwin.twin.optics.geometry.instrument import COMPONENTS
from goniotwin.twin.optics.illumination.unit import ELEMENTS
from goniotwin.twin.optics.kernel import thread_count


class IlluminationLight:
    """Flux and uniformity of the light of a unit with deviations, by adjoint rays that are the same for all combinations."""

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

    def _light(self, values: Floats) -> tuple[Floats, Floats]:
        components = (values @ self._matrix).reshape(len(values), len(ELEMENTS), len(COMPONENTS))

        def trace(combination: Floats) -> tuple[float, float]:
            named = zip(ELEMENTS, combination.tolist(), strict=True)
            unit = replace(self.unit, deviations={name: Deviation(*each) for name, each in named if any(each)})
            light = adjoint_illumination(unit, rays=self.criterion.rays, seed=self.criterion.seed)
            return light.flux, light.uniformity if light.flux > 0.0 else 0.0

        with ThreadPoolExecutor(thread_count()) as pool:  # the kernel holds no lock
            found = np.array(list(pool.map(trace, components)))
        return found[:, 0], found[:, 1]


class Evenness:
    """The response of the uniformity: its relative change."""

    def __init__(self, light: IlluminationLight) -> None:
        self._light = light

    def residuals(self, values: Floats) -> Floats:
        """Relative change (n, 1) of the uniformity."""
        return np.asarray(self._light.relative(values)[1][:, None] / self._light.uniformity - 1.0)
