"""A Gaussian lobe in the plane of incidence: by formula 6, and as the simulated instrument measures it (paper, section 4)."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, Pose, from_specular, gaussian, luminance_factors
from goniotwin.twin.optics.bsdf.analytic_samples import Form
from goniotwin.twin.optics.geometry.coordinates import polar_and_azimuth

STEP_DEG = 0.5
WIDTHS = 2.0
HIGHEST_ZENITH_DEG = 85.0


@dataclass(frozen=True, eq=False)
class GaussianCut:
    """Luminance factors (n,) at one sigma: `theory` with a peak of 1, and `simulated` relative to an ideal diffuser.

    `theta_deg` (n,) is the aspecular angle, ascending: positive towards the normal, negative towards grazing.
    """

    sigma_deg: float
    theta_deg: Floats
    theory: Floats
    simulated: Floats

    @property
    def relative_deviation(self) -> Floats:
        """Difference over mean (n,); its root mean square is the paper's formula 5."""
        return relative_deviation(self.simulated, self.theory)

    @property
    def relative_rms_percent(self) -> float:
        """Root mean square of the relative deviation, in percent (paper, formula 5)."""
        return relative_rms_percent(self.simulated, self.theory)


def relative_deviation(measured: Floats, theory: Floats) -> Floats:
    """Difference over mean, of luminance factors or of any other ratio; the shape of the arguments."""
    deviation: Floats = (measured - theory) / (0.5 * (measured + theory))
    return deviation


def relative_rms_percent(measured: Floats, theory: Floats) -> float:
    """Root mean square of the relative deviation, in percent (paper, formula 5). NaN for empty arrays."""
    if not measured.size:
        return math.nan
    return 100.0 * math.sqrt(float(np.mean(relative_deviation(measured, theory) ** 2)))


def in_plane_theta(sigma_deg: float, width_deg: float, widths: float = WIDTHS, step_deg: float = STEP_DEG) -> Floats:
    """Aspecular angles (n,), deg, in steps of `step_deg`: up to `widths` widths on both sides of the specular direction.

    Angles whose zenith angle is 85 deg or more are omitted.
    """
    count = math.floor(widths * width_deg / step_deg + 1e-9)
    theta = step_deg * np.arange(-count, count + 1, dtype=np.float64)
    return theta[np.abs(sigma_deg - theta) < HIGHEST_ZENITH_DEG - 1e-9]


def in_plane_directions(sigma_deg: float, theta_deg: Floats) -> Floats:
    """Unit vectors (n, 3) in the plane of incidence at aspecular angles (n,), deg."""
    return from_specular(sigma_deg, *polar_and_azimuth(theta_deg, 0.0))


def gaussian_theory(theta_deg: Floats, width_deg: float, form: Form) -> Floats:
    """Formula 6 with a peak of 1 (n,): it falls to 1/e at the width, or to a half where `form` is "half_width"."""
    exponent = 1.0 if form == "one_over_e" else math.log(2.0)
    value: Floats = np.exp(-exponent * (theta_deg / width_deg) ** 2)
    return value


def gaussian_cuts(
    instrument: Instrument,
    sigmas_deg: Sequence[float],
    width_deg: float,
    form: Form = "one_over_e",
    widths: float = WIDTHS,
    rays: int | None = None,
    step_deg: float = STEP_DEG,
) -> list[GaussianCut]:
    """Cuts by the fast estimator, one for each sigma; `rays` as in `twin.optics.throughput`."""
    thetas = [in_plane_theta(sigma, width_deg, widths, step_deg) for sigma in sigmas_deg]
    poses = [Pose(sigma, in_plane_directions(sigma, theta)) for sigma, theta in zip(sigmas_deg, thetas, strict=True)]
    simulated = luminance_factors(instrument, poses, gaussian(width_deg, form, peak=1.0 / math.pi), rays)
    return [
        GaussianCut(sigma, theta, gaussian_theory(theta, width_deg, form), values)
        for sigma, theta, values in zip(sigmas_deg, thetas, simulated, strict=True)
    ]
