"""Made contents of files, whose BSDF is a known function."""

import math
from collections.abc import Callable

import numpy as np

from goniotwin.app.formats.content import ABSENT, ScatteredBsdf
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction, to_specular

Bsdf = Callable[[Floats, Floats], Floats]
"""Of theta and phi, deg."""


def gaussian(width_deg: float, peak: float = 1.0) -> Bsdf:
    """A lobe about the specular direction."""
    return lambda theta, _phi: peak * np.exp(-((theta / width_deg) ** 2))


def lambertian(reflectance: float) -> Bsdf:
    """The ideal diffuser."""
    return lambda theta, _phi: np.full(theta.shape, reflectance / math.pi)


def table(bsdf: Bsdf, sigma_deg: Floats, step_deg: float = 1.0, u: float | None = None, last_deg: float = 180.0) -> BsdfTable:
    """A table of relative uncertainty u over phi from 0 to 180."""
    theta = np.arange(0.0, last_deg + 1e-9, step_deg)
    phi = np.arange(0.0, 181.0, 15.0)
    grid = np.meshgrid(phi, theta, indexing="ij")
    values = np.tile(bsdf(grid[1], grid[0]), (1, 1, sigma_deg.size, 1, 1))
    return BsdfTable(sigma_deg, phi, theta, values, u=None if u is None else u * values)


def rings(
    bsdf: Bsdf, sigma_deg: float, polar_deg: Floats, azimuth_deg: Floats, u: float | None = None, *, isotropic: bool = True
) -> ScatteredBsdf:
    """Values on rings of one polar angle, of relative uncertainty u."""
    polar, azimuth = (each.ravel() for each in np.meshgrid(polar_deg, azimuth_deg, indexing="ij"))
    theta, phi = to_specular(sigma_deg, arc_direction(polar, azimuth))
    values = bsdf(theta, phi)
    n = values.size
    return ScatteredBsdf(
        np.full(n, sigma_deg), np.zeros(n), polar, azimuth, values, u=ABSENT if u is None else u * values, isotropic=isotropic
    )
