"""Explanation of the paper's Table 3: the numbers of each contribution.

Blur falls as 1/width^2 and a shift of the specular direction as 1/width; counting noise does not fall. Their squares add.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.paper.gaussian_cut import (
    HIGHEST_ZENITH_DEG,
    gaussian_cuts,
    gaussian_theory,
    in_plane_directions,
    in_plane_theta,
    relative_rms_percent,
)
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, gaussian, lambertian, throughput
from goniotwin.twin.optics.bsdf.analytic_samples import Form

SIGMAS_DEG = (0.0, 30.0, 60.0)
WIDTHS_DEG = (2.0, 5.0, 15.0, 30.0)
PAPER = np.array([[4.79, 2.74, 0.37, 0.20], [4.21, 1.90, 0.56, 0.47], [3.85, 1.83, 0.74, 0.63]])
"""Table 3 of the paper, percent: sigma 0, 30, 60 by widths of 2, 5, 15, 30 deg."""
FORMS: tuple[Form, ...] = ("one_over_e", "half_width")
RANGES = (1.0, 1.5, 2.0, 3.0)
DIVERGENCES_DEG = (0.5, 0.716, 1.0)
TILTS_DEG = tuple(0.005 * k for k in range(11))
NOISES_PERCENT = (0.0, *np.geomspace(0.05, 0.6, 40))


@dataclass(frozen=True, eq=False)
class ClosestSettings:
    """The settings whose `table` (3, 4), in percent, is closest to the paper's; `off_by` is its typical factor from it."""

    form: Form
    widths: float
    divergence_deg: float
    tilt_deg: float
    noise_percent: float
    table: Floats
    off_by: float


def rms_table(instrument: Instrument, form: Form = "one_over_e", widths: float = 2.0, rays: int | None = None) -> Floats:
    """Relative RMS (3, 4) in percent, by sigma and width."""
    columns = [
        [cut.relative_rms_percent for cut in gaussian_cuts(instrument, SIGMAS_DEG, width, form, widths, rays)]
        for width in WIDTHS_DEG
    ]
    return np.array(columns).T


def with_tilt(instrument: Instrument, meridional_deg: float, sagittal_deg: float = 0.0) -> Instrument:
    """The instrument with a tilted sample."""
    return replace(instrument, deviations={"sample": Deviation(rx_deg=sagittal_deg, ry_deg=meridional_deg)})


def with_divergence(instrument: Instrument, divergence_deg: float) -> Instrument:
    """The instrument with another beam divergence: another exit pupil at the same distance."""
    radius = instrument.pupil_distance_mm * math.tan(math.radians(0.5 * divergence_deg))
    return replace(instrument, pupil_radius_mm=radius)


def counting_variance(
    instrument: Instrument, form: Form = "one_over_e", widths: float = 2.0, etalon_alone: bool = False
) -> Floats:
    """Relative variance of the ratio by counting noise (3, 4), relative to its value at sigma 0, width 30.

    A tracer that starts a fixed number of equal rays counts rays in proportion to the throughput of each detector. The
    relative variance of the ratio is the sum of both inverse counts, 1/sample + 1/etalon, here averaged over the directions.
    The reflectance of the sample is 0.9. With `etalon_alone` the sample has no noise.
    """
    result = np.empty((len(SIGMAS_DEG), len(WIDTHS_DEG)))
    for (i, sigma), (j, width) in itertools.product(enumerate(SIGMAS_DEG), enumerate(WIDTHS_DEG)):
        directions = in_plane_directions(sigma, in_plane_theta(sigma, width, widths))
        counted = [lambertian()] if etalon_alone else [lambertian(), gaussian(width, form)]
        result[i, j] = sum(np.mean(1.0 / throughput(instrument, sigma, directions, each)) for each in counted)
    scaled: Floats = result / result[0, -1]
    return scaled


def exponents(table: Floats) -> Floats:
    """Exponents (3, 3) of the width with which the rows of a table (3, 4) fall from column to column."""
    falls: Floats = -np.diff(np.log(table), axis=1) / np.diff(np.log(WIDTHS_DEG))
    return falls


def noise_floor(blur: Floats, variance: Floats) -> tuple[float, Floats]:
    """Noise in percent that gives the paper's value at sigma 0, width 30, and the table (3, 4) of blur with this noise."""
    square = PAPER[0, -1] ** 2 - blur[0, -1] ** 2
    table: Floats = np.sqrt(blur**2 + square * variance)
    return math.sqrt(square), table


def interpolation_error(step_deg: float) -> Floats:
    """Relative RMS (3, 4) in percent of a linear interpolation of the theory half way between nodes of that step."""
    result = np.empty((len(SIGMAS_DEG), len(WIDTHS_DEG)))
    for (i, sigma), (j, width) in itertools.product(enumerate(SIGMAS_DEG), enumerate(WIDTHS_DEG)):
        theta = in_plane_theta(sigma, width)
        below, above = (gaussian_theory(theta + side * step_deg, width, "one_over_e") for side in (-0.5, 0.5))
        read = 0.5 * (below + above)
        result[i, j] = relative_rms_percent(read, gaussian_theory(theta, width, "one_over_e"))
    return result


def required_tilt_deg(blur: Floats, tilted: Floats, tilt_deg: float) -> Floats:
    """Tilt of the sample (3, 4), deg, that raises the blur to the paper's value; `tilted` is the table at `tilt_deg`.

    The square of the contribution is in proportion to that of the tilt. 0 where the blur alone is above the paper's value.
    """
    per_degree = np.sqrt(tilted**2 - blur**2) / tilt_deg
    needed: Floats = np.sqrt(np.maximum(PAPER**2 - blur**2, 0.0)) / per_degree
    return needed


def closest_settings(
    instrument: Instrument, step: Callable[[], None] = lambda: None, tilts_deg: Sequence[float] = TILTS_DEG
) -> ClosestSettings:
    """The closest settings to the paper among forms, ranges of theta, divergences, tilts of the sample and counting noises.

    The distance is the root mean square of the logarithms of the ratios. `step` is called for each form and range.
    """
    best: ClosestSettings | None = None
    for form, widths in itertools.product(FORMS, RANGES):
        variance = counting_variance(instrument, form, widths)
        for divergence, tilt in itertools.product(DIVERGENCES_DEG, tilts_deg):
            table = rms_table(with_tilt(with_divergence(instrument, divergence), tilt), form, widths)
            for noise in NOISES_PERCENT:
                total = np.sqrt(table**2 + noise**2 * variance)
                off = math.exp(math.sqrt(float(np.mean(np.log(total / PAPER) ** 2))))
                if best is None or off < best.off_by:
                    best = ClosestSettings(form, widths, divergence, tilt, float(noise), total, off)
        step()
    assert best is not None
    return best


def describe_range(widths: float = 2.0) -> str:
    """The range of i in formula 5, as text."""
    within = "1 width" if widths == 1.0 else f"{widths:g} widths"
    return (
        f"the plane of incidence, both sides of the specular direction, steps of 0.5 deg, theta up to {within}, "
        f"zenith angle below {HIGHEST_ZENITH_DEG:g} deg"
    )
