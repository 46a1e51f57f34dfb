"""The light's axis at the sample: its incidence and the place of the lit square, which a lobe's measured peak does not show."""

import math
from collections.abc import Callable

import numpy as np

from goniotwin.app.simulation.tolerances.lobe import GaussianLobe
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.mirrors import mirrors_at, pupil, transform_rows, unfolding_maps
from goniotwin.twin.optics.geometry.scene import scene_at


class BeamOnSample:
    """Incidence and place of the unit's axis on the sample, for combinations of the deviations of a lobe's instrument."""

    def __init__(self, lobe: GaussianLobe, sigma_deg: float) -> None:
        self._lobe, self._sigma_deg = lobe, sigma_deg
        zero = np.zeros((1, len(lobe.parameters)))
        self._nominal = self._axis(zero)[0]

    def incidence_deg(self, values: Floats) -> Floats:
        """Incidence (n,) on the sample minus that without deviations, deg; of the line to the middle of the exit pupil."""
        return np.asarray(self._axis(values)[:, 2] - self._nominal[2])

    def place_mm(self, values: Floats) -> Floats:
        """Shift (n, 2) of the lit square against the hole, mm, along its own sides across the beam."""
        return np.asarray(self._axis(values)[:, :2] - self._nominal[:2])

    def _axis(self, values: Floats) -> Floats:
        """Place along both sides of the lit square, mm, and incidence, deg, (n, 3)."""
        found = np.empty((len(values), 3))
        for row, combination in zip(found, values, strict=True):
            instrument = self._lobe.with_deviations(combination)
            scene = scene_at(instrument, self._sigma_deg)
            before = unfolding_maps(mirrors_at(instrument, self._sigma_deg))[0]
            centre, axis_u, axis_v = transform_rows(np.array(pupil(instrument)), before)
            centre, axis_u, axis_v = (
                (centre - scene.origin) @ scene.to_sample.T,
                scene.to_sample @ axis_u,
                scene.to_sample @ axis_v,
            )
            # Across the beam; reflections change the sense of the third axis, but not the line.
            along = np.cross(axis_u, axis_v)
            place = centre - along * (centre[2] / along[2])
            row[:] = place @ axis_u, place @ axis_v, math.degrees(math.acos(min(1.0, float(scene.towards_light[2]))))
        return found


class Scaled:
    """A response of one residual: a quantity over its limit, so that a criterion of 100 % is the limit."""

    def __init__(self, quantity: Callable[[Floats], Floats], limit: float) -> None:
        self._quantity, self._limit = quantity, limit

    def residuals(self, values: Floats) -> Floats:
        """The quantity over its limit, (n, 1)."""
        return np.asarray(self._quantity(values).reshape(len(values), -1) / self._limit)
