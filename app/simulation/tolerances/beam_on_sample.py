"""The light's axis at the sample: its incidence and the place of the lit square, which a lobe's measured peak does not show."""

from collections.abc import Callable

import numpy as np

from goniotwin.app.simulation.tolerances.lobe import GaussianLobe
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.scene import empty_scene, fill_scene


class BeamOnSample:
    """Incidence and place of the unit's axis on the sample, for combinations of the deviations of a lobe's instrument."""

    def __init__(self, lobe: GaussianLobe, sigma_deg: float) -> None:
        self._lobe, self._sigma_deg = lobe, sigma_deg
        self._nominal = self._axis(np.zeros((1, len(lobe.parameters))))[0]

    def incidence_deg(self, values: Floats) -> Floats:
        """Incidence (n,) on the sample minus that without deviations, deg; of the line to the middle of the exit pupil."""
        return np.asarray(self._axis(values)[:, 2] - self._nominal[2])

    def place_mm(self, values: Floats) -> Floats:
        """Shift (n, 2) of the lit square against the hole, mm, along its own sides across the beam."""
        return np.asarray(self._axis(values)[:, :2] - self._nominal[:2])

    def _axis(self, values: Floats) -> Floats:
        """Place along both sides of the lit square, mm, and incidence, deg, (n, 3)."""
        pupils, scene = np.empty((len(values), 4, 3)), empty_scene()
        for pupil, deviations in zip(pupils, self._lobe.deviations(values), strict=True):
            fill_scene(self._lobe.instrument.lengths, deviations, self._sigma_deg, 0.0, scene)
            pupil[:] = scene.pupil
        centre, normal = pupils[:, 0], pupils[:, 3]
        # Where the normal through the middle of the pupil meets the sample: there the unit images the middle of the slit.
        place = centre - normal * (centre[:, 2] / normal[:, 2])[:, None]
        sides = np.sum(pupils[:, 1:3] * place[:, None], axis=2) / self._lobe.instrument.pupil_radius_mm
        incidence = np.degrees(np.arccos(centre[:, 2] / np.linalg.norm(centre, axis=1)))
        return np.concatenate([sides, incidence[:, None]], axis=1)


class Scaled:
    """A response of one residual: a quantity over its limit, so that a criterion of 100 % is the limit."""

    def __init__(self, quantity: Callable[[Floats], Floats], limit: float) -> None:
        self._quantity, self._limit = quantity, limit

    def residuals(self, values: Floats) -> Floats:
        """The quantity over its limit, (n, 1)."""
        return np.asarray(self._quantity(values).reshape(len(values), -1) / self._limit)
