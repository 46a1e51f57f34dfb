"""The light on the sample: its incidence, and the place of the lit square; a lobe's measured peak shows neither."""

from collections.abc import Callable

import numpy as np

from goniotwin.app.simulation.tolerances.lobe import GaussianLobe
from goniotwin.arrays import Floats
from goniotwin.twin.optics import IlluminationUnit
from goniotwin.twin.optics.geometry.scene import empty_scene, fill_scene

LIT_SIDE_MM = IlluminationUnit.height_stop_mm * IlluminationUnit.output_condenser_magnification
"""Side of the lit square, across the beam: the slit's image."""


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

    def lit_share(self, values: Floats) -> Floats:
        """Share (n,) of the hole within the lit square, which has sharp edges: of the flux, if nothing else changes it."""
        pupils = self._pupils(values)
        half = 0.5 * LIT_SIDE_MM
        corners = np.empty((len(values), 4, 3))
        for corner, (u, v) in enumerate(((-half, -half), (half, -half), (half, half), (-half, half))):
            point = self._middle(pupils) + u * pupils[:, 1] + v * pupils[:, 2]
            # Along the light onto the sample's plane.
            corners[:, corner] = point - pupils[:, 3] * (point[:, 2] / pupils[:, 3, 2])[:, None]
        side = self._lobe.instrument.spot_side_mm
        return np.array([_area_within(each, 0.5 * side) for each in corners[:, :, :2]]) / side**2

    def _axis(self, values: Floats) -> Floats:
        """Place along both sides of the lit square, mm, and incidence, deg, (n, 3)."""
        pupils = self._pupils(values)
        sides = np.sum(pupils[:, 1:3] * self._middle(pupils)[:, None], axis=2)
        centre = pupils[:, 0]
        incidence = np.degrees(np.arccos(centre[:, 2] / np.linalg.norm(centre, axis=1)))
        return np.concatenate([sides, incidence[:, None]], axis=1)

    def _pupils(self, values: Floats) -> Floats:
        """Image of the exit pupil in the sample's frame (n, 4, 3): its centre, two unit axes and its normal."""
        instrument = self._lobe.instrument
        pupils, scene = np.empty((len(values), 4, 3)), empty_scene()
        for pupil, deviations in zip(pupils, self._lobe.deviations(values), strict=True):
            fill_scene(instrument.lengths, instrument.exit_pupil, deviations, self._sigma_deg, 0.0, scene)
            pupil[:] = scene.pupil
        pupils[:, 1:3] /= instrument.pupil_radius_mm
        return pupils

    @staticmethod
    def _middle(pupils: Floats) -> Floats:
        """Point (n, 3) at which the normal of the pupil meets the sample: the unit images the middle of the slit there."""
        centre, normal = pupils[:, 0], pupils[:, 3]
        return np.asarray(centre - normal * (centre[:, 2] / normal[:, 2])[:, None])


def _area_within(corners: Floats, half: float) -> float:
    """Area of a convex polygon (n, 2) within the square of half side `half` (Sutherland, Hodgman 1974)."""
    points = corners
    for axis, sign in ((0, 1.0), (0, -1.0), (1, 1.0), (1, -1.0)):
        inside = half - sign * points[:, axis]
        after, beyond = np.roll(points, -1, axis=0), np.roll(inside, -1)
        kept = []
        for here, there, point, following in zip(inside, beyond, points, after, strict=True):
            if here >= 0.0:
                kept.append(point)
            if (here >= 0.0) != (there >= 0.0):
                kept.append(point + here / (here - there) * (following - point))
        if len(kept) < 3:
            return 0.0
        points = np.array(kept)
    x, y = points.T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


class Scaled:
    """A response of one residual: a quantity over its limit, so that a criterion of 100 % is the limit."""

    def __init__(self, quantity: Callable[[Floats], Floats], limit: float) -> None:
        self._quantity, self._limit = quantity, limit

    def residuals(self, values: Floats) -> Floats:
        """The quantity over its limit, (n, 1)."""
        return np.asarray(self._quantity(values).reshape(len(values), -1) / self._limit)
