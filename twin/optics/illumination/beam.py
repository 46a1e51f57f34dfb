"""Beam in the plane across the axis at the sample: the result of both estimators of the illumination unit."""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.illumination.unit import IlluminationUnit

# Share of the flux in the centre of the divergence profile: less would be few rays, more would reach the flank.
CENTRE_SHARE = 0.05


@dataclass(frozen=True, eq=False)
class Illumination:
    """Light in the square of `side_mm` about the axis, in the plane across it at the sample's distance.

    Each value has its standard error. Flux is in `unit` (W or lm). `irradiance` [x, z] in unit/m^2 is the mean over each of (n,
    n) cells, x and z ascending. `angular_flux` (bins,) is the flux over the whole square, by the angle to the unit's axis
    between `angle_edges_deg` (bins + 1,); the last bin includes larger angles. `emitted_flux` is the arc's flux into all
    directions at the passing wavelengths. `rays` is the number of traced rays.
    """

    flux: float
    flux_error: float
    unit: str
    emitted_flux: float
    rays: int
    side_mm: float
    irradiance: Floats
    irradiance_error: Floats
    angle_edges_deg: Floats
    angular_flux: Floats
    angular_flux_error: Floats

    @property
    def efficiency(self) -> float:
        """Share of the emitted flux that arrives in the square."""
        return self.flux / self.emitted_flux

    @property
    def uniformity(self) -> float:
        """Least irradiance of a cell over the mean. It includes the cells' noise: see their errors."""
        return float(self.irradiance.min() / self.irradiance.mean())

    @property
    def solid_angles_sr(self) -> Floats:
        """Solid angles of the rings between the angles, (bins,)."""
        rings: Floats = -2.0 * math.pi * np.diff(np.cos(np.radians(self.angle_edges_deg)))
        return rings

    @property
    def intensity(self) -> Floats:
        """Radiant or luminous intensity of the beam over its angle, (bins,), in unit/sr."""
        result: Floats = self.angular_flux / self.solid_angles_sr
        return result

    @property
    def full_width_deg(self) -> tuple[float, float]:
        """Full width of the divergence at half the central intensity, with its standard error; both NaN without light.

        The central intensity is that of the innermost bins with a twentieth of the flux. Linear interpolation between the
        centres of the bins.
        """
        if self.flux <= 0.0:
            return math.nan, math.nan
        inner = int(np.searchsorted(np.cumsum(self.angular_flux), CENTRE_SHARE * self.angular_flux.sum())) + 1
        solid, intensity = self.solid_angles_sr, self.intensity
        central = self.angular_flux[:inner].sum() / solid[:inner].sum()
        central_error = math.sqrt(np.sum(self.angular_flux_error[:inner] ** 2)) / solid[:inner].sum()
        below = np.flatnonzero(intensity[inner:] < 0.5 * central)
        if below.size == 0:
            return math.nan, math.nan
        k = inner + int(below[0])
        middles = 0.5 * (self.angle_edges_deg[1:] + self.angle_edges_deg[:-1])
        step, fall = middles[k] - middles[k - 1], intensity[k - 1] - intensity[k]
        share = (intensity[k - 1] - 0.5 * central) / fall
        errors = self.angular_flux_error / solid
        level = math.sqrt(((1.0 - share) * errors[k - 1]) ** 2 + (share * errors[k]) ** 2 + (0.5 * central_error) ** 2)
        return 2.0 * float(middles[k - 1] + share * step), 2.0 * float(level * step / fall)


def widest_angle(unit: IlluminationUnit, side_mm: float) -> float:
    """End of the histogram of angles, in rad: 1.5 times the widest angle of a ray without deviations."""
    reach = unit.exit_pupil_radius_mm + 0.5 * math.sqrt(2.0) * side_mm
    return 1.5 * math.atan(reach / unit.sample_distance_mm)


def check_square(unit: IlluminationUnit, side_mm: float | None, cells: int, bins: int) -> float:
    """Side of the square, the unit's own by default. Raises ValueError for values without a map or profile."""
    side = unit.field_side_mm if side_mm is None else side_mm
    if not (math.isfinite(side) and side > 0.0):
        raise ValueError(f"side_mm is {side!r}: give a positive, finite number")
    for name, value in (("cells", cells), ("bins", bins)):
        if not 1 <= value <= 1000:
            raise ValueError(f"{name} is {value}: give 1 to 1000")
    return side


def mean_and_error(sums: Floats, count: int) -> tuple[Floats, Floats]:
    """Means of `count` weights and their standard errors, (n,), from the sums (2, n) of weights and of their squares."""
    mean = sums[0] / count
    return mean, np.sqrt(np.maximum(sums[1] / count - mean**2, 0.0) / (count - 1))
