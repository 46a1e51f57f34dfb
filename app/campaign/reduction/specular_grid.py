"""Interpolation of measured points to a grid of specular coordinates, with the nodes that were not measured.

Between measured directions of one sigma that are at most 3 deg apart the value is bilinear in zenith and azimuth, mirrored in
the plane of incidence. A table needs a number at every node: other nodes get a continued value, and are marked as not measured.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.reduction.reduction import BsdfPoints
from goniotwin.app.campaign.schedule.grids import fold_azimuth
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import from_specular

FINEST_DEG = 0.1
WIDEST_GAP_DEG = 3.0
"""There is no interpolation between measured directions that are further apart."""
PHI_STEP_DEG = 5.0


@dataclass(frozen=True)
class SpecularTable:
    """BSDF (sigma, phi, theta) in 1/sr; `measured` is true where it is interpolated, false where it is continued."""

    sigma_deg: Floats
    phi_deg: Floats
    theta_deg: Floats
    bsdf: Floats
    measured: Flags


def regrid(points: BsdfPoints) -> SpecularTable:
    """Interpolate points of one wavelength and one gamma to a grid of specular coordinates.

    theta goes from 0 to 180 in the finest step of the zenith angles; phi is 0 and 180 where only the plane of incidence
    was measured. Raises ValueError where no point has a value.
    """
    good = points.where(points.good)
    if not good.bsdf.size:
        raise ValueError("no direction has a value")
    sigmas = np.unique(points.sigma_deg)
    azimuths = np.unique(fold_azimuth(good.azimuth_deg[good.zenith_deg > 1e-6]))
    in_plane = bool(np.all((azimuths < 1e-6) | (azimuths > 180.0 - 1e-6)))
    phi = np.array([0.0, 180.0]) if in_plane else np.arange(0.0, 180.0 + 1e-9, PHI_STEP_DEG)
    theta = np.linspace(0.0, 180.0, 1 + math.ceil(180.0 / _step(good.zenith_deg) - 1e-6))
    shape = (sigmas.size, phi.size, theta.size)
    bsdf, measured = np.empty(shape), np.empty(shape, dtype=bool)
    for k, sigma in enumerate(sigmas):
        bsdf[k], measured[k] = _interpolate_sigma(good.where(good.sigma_deg == sigma), float(sigma), phi, theta)
    return SpecularTable(sigmas, phi, theta, bsdf, measured)


def _interpolate_sigma(points: BsdfPoints, sigma: float, phi: Floats, theta: Floats) -> tuple[Floats, Flags]:
    directions = from_specular(sigma, theta[None, :], phi[:, None])
    zenith = np.degrees(np.arccos(np.clip(directions[..., 2], -1.0, 1.0)))
    azimuth = fold_azimuth(np.degrees(np.arctan2(directions[..., 1], directions[..., 0])))
    values = _interpolate(points, zenith, azimuth)
    measured = np.isfinite(values)
    for row, known in zip(values, measured, strict=True):
        if known.any():
            row[~known] = np.interp(theta[~known], theta[known], row[known])
    rows = measured.any(axis=1)
    if not rows.any():
        raise ValueError(f"at sigma {sigma:g} no direction has a value")
    values[~rows] = values[rows].mean(axis=0)
    return values, measured


def _interpolate(points: BsdfPoints, zenith: Floats, azimuth: Floats) -> Floats:
    """Bilinear in the measured zeniths and azimuths; NaN where a needed corner is missing."""
    rows, columns, table = _table(points)
    i, u = _place(rows, zenith)
    j, v = _place(columns, azimuth)
    result = np.zeros(zenith.shape)
    for di, weight_i in ((0, 1.0 - u), (1, u)):
        for dj, weight_j in ((0, 1.0 - v), (1, v)):
            weight = weight_i * weight_j
            corner = table[np.minimum(i + di, rows.size - 1), np.minimum(j + dj, columns.size - 1)]
            result += np.where(weight > 1e-9, weight * corner, 0.0)
    pole = zenith < 1e-6  # any azimuth is the same direction there
    apart = np.sin(np.radians(zenith)) * _gap(columns, j, v)
    wide = (_gap(rows, i, u) > WIDEST_GAP_DEG + 1e-6) | (~pole & (apart > WIDEST_GAP_DEG + 1e-6))
    outside = wide | (zenith > rows[-1] + 1e-6) | (zenith < rows[0] - 1e-6)
    outside |= ~pole & ((azimuth > columns[-1] + 1e-6) | (azimuth < columns[0] - 1e-6))
    return np.where(outside, np.nan, result)


def _table(points: BsdfPoints) -> tuple[Floats, Floats, Floats]:
    """Zeniths, azimuths (0 to 180), and the means of the values there, NaN where none was measured."""
    folded = fold_azimuth(points.azimuth_deg)
    rows, i = np.unique(np.round(points.zenith_deg, 6), return_inverse=True)
    columns, j = np.unique(np.round(folded, 6), return_inverse=True)
    total, count = np.zeros((rows.size, columns.size)), np.zeros((rows.size, columns.size))
    np.add.at(total, (i, j), points.bsdf)
    np.add.at(count, (i, j), 1.0)
    if rows[0] < 1e-6:  # the pole is one direction, whatever the azimuth
        total[0], count[0] = total[0].sum(), count[0].sum()
    with np.errstate(invalid="ignore"):
        return rows, columns, total / count


def _place(grid: Floats, values: Floats) -> tuple[Ints, Floats]:
    """Index of the grid value below, and the position between it and the next one, 0 to 1."""
    if grid.size == 1:
        return np.zeros(values.shape, dtype=np.int64), np.zeros(values.shape)
    index = np.clip(np.searchsorted(grid, values, side="right") - 1, 0, grid.size - 2)
    share = np.clip((values - grid[index]) / (grid[index + 1] - grid[index]), 0.0, 1.0)
    share = np.where(share < 1e-6, 0.0, np.where(share > 1.0 - 1e-6, 1.0, share))
    return index, share


def _gap(grid: Floats, index: Ints, share: Floats) -> Floats:
    """Distance of the two grid values around a place; 0 where it lies on one of them."""
    if grid.size == 1:
        return np.zeros(index.shape)
    between = (share > 0.0) & (share < 1.0)
    gap: Floats = np.where(between, grid[index + 1] - grid[index], 0.0)
    return gap


def _step(zenith_deg: Floats) -> float:
    """The finest step of the zenith angles, deg."""
    apart = np.diff(np.unique(np.round(zenith_deg, 6)))
    return max(FINEST_DEG, float(apart.min())) if apart.size else 5.0
