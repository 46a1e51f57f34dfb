"""The values at standard geometries, as far as measured values cover these: for reports."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.schedule.standard_geometries import STANDARD_GEOMETRIES, StandardGeometry
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.kinds.choice import at_sigma, one_azimuth, side_words, sides
from goniotwin.app.errors import UserError
from goniotwin.app.figures.curves import COVERAGE, distinct
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import round_deg, wrap_azimuth, zenith_and_azimuth

MOST_WAVELENGTHS = 9
MEASURED, INTERPOLATED = "measured", "interpolated"


@dataclass(frozen=True)
class StandardValue:
    """The BSDF at a geometry, `bsdf` in 1/sr, with its expanded uncertainty `expanded_u` (k = 2).

    `polar_deg` and `azimuth_deg` are the direction in the sample's frame. `source` is "measured" in a measured direction; else
    it states what the value is interpolated between.
    """

    geometry: str
    light: str
    wavelength_nm: float
    sigma_deg: float
    polar_deg: float
    azimuth_deg: float
    bsdf: float
    expanded_u: float
    source: str

    @property
    def radiance_factor(self) -> tuple[float, float]:
        """The radiance factor, pi times the BSDF, and its expanded uncertainty."""
        return math.pi * self.bsdf, math.pi * self.expanded_u


@dataclass(frozen=True)
class StandardValues:
    """Values of one sample at standard geometries; `missing` names those that the sample's trusted values do not cover.

    They are at `wavelengths` of so many that there are, and at the first azimuth of the light.
    """

    values: tuple[StandardValue, ...]
    missing: tuple[str, ...]
    wavelengths: tuple[int, int]


def standard_values(dataset: Dataset) -> StandardValues:
    """The values of the only sample at all standard geometries, and in the specular direction of each measured sigma.

    A value is that of `Dataset.at` at a measured sigma, where it accepts the direction: nothing is extrapolated, or taken from
    beside a direction that is blocked. Of transmitted light, it is in the direction straight through.
    """
    values: list[StandardValue] = []
    missing: list[str] = []
    nm = list(distinct(dataset.wavelength_nm[dataset.good], MOST_WAVELENGTHS))
    for back, transmitted, one_side in sides(dataset):
        here = one_azimuth(one_side)
        light = side_words(transmitted, back)
        name = "straight through" if transmitted else "specular"
        specular = [StandardGeometry(name, sigma) for sigma in np.unique(here.sigma_deg[here.good]).tolist()]
        alike: dict[tuple[float, float], list[StandardGeometry]] = {}
        for each in (*(() if transmitted else STANDARD_GEOMETRIES), *specular):
            alike.setdefault((each.sigma_deg, each.aspecular_deg), []).append(each)
        for same in alike.values():
            names = ", ".join(each.name for each in same)
            found = [value for each in nm if (value := _value(here, same[0], names, light, each)) is not None]
            values += found
            missing += [] if found else [f"{names} ({light})" if back else names]
    return StandardValues(tuple(values), tuple(missing), (len(nm), np.unique(dataset.wavelength_nm[dataset.good]).size))


def _value(here: Dataset, geometry: StandardGeometry, names: str, light: str, nm: float) -> StandardValue | None:
    """The value at a geometry and a wavelength; None where there is none to be trusted around."""
    sigma, (theta, phi) = geometry.sigma_deg, geometry.theta_phi_deg
    at_it = at_sigma(here, sigma)
    if not at_it.size:  # between incidences nothing is certified
        return None
    psi = float(at_it.psi_deg.max())
    place: dict[str, Any] = {"sigma_deg": sigma, "psi_deg": psi, "theta_deg": theta, "phi_deg": phi, "wavelength_nm": nm}
    try:
        bsdf, u = at_it.at(**place)
    except UserError:
        return None
    source = MEASURED if _is_measured(at_it, place) else INTERPOLATED
    polar, azimuth = map(round_deg, zenith_and_azimuth(from_specular(sigma, theta, phi)))
    around = float(wrap_azimuth(azimuth + psi)) if polar else 0.0
    return StandardValue(names, light, nm, sigma, float(polar), around, bsdf, COVERAGE * u, source)


def _is_measured(at_it: Dataset, place: dict[str, Any]) -> bool:
    try:
        return bool(at_it.select(**place).good.any())
    except UserError:
        return False
