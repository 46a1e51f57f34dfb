"""Samples given by measured or computed values over a regular grid of specular coordinates: isotropic, anisotropic, spectral.

Specular coordinates are canonical: for light from the back the sample is turned about x (phi and psi change sign), and a
transmitted direction is mirrored in the sample's plane, so theta = 0 is straight through.
"""

from typing import Literal

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.analytic_samples import Side, check_axis, lobes_of_side
from goniotwin.twin.optics.bsdf.kinds import ANISOTROPIC, TABLE
from goniotwin.twin.optics.bsdf.lobes import Lobe, freeze, parameters
from goniotwin.twin.optics.bsdf.scatterer import Scatterer, SpectralWeights

Symmetry = Literal["none", "half_turn", "mirror", "orthotropic"]
# Period of psi, and whether a change of sign of both azimuths is a symmetry.
SYMMETRIES: dict[Symmetry, tuple[float, bool]] = {
    "none": (360.0, False),
    "half_turn": (180.0, False),
    "mirror": (360.0, True),
    "orthotropic": (180.0, True),
}


def table_sample(
    sigma_deg: npt.ArrayLike,
    phi_deg: npt.ArrayLike,
    theta_deg: npt.ArrayLike,
    values: npt.ArrayLike,
    name: str = "table",
    psi_deg: npt.ArrayLike | None = None,
    symmetry: Symmetry = "none",
    side: Side = "front",
    transmits: bool = False,
) -> Scatterer:
    """Sample given by values (sigma, phi, theta) in 1/sr over specular coordinates in degrees.

    phi_deg runs from 0 to 180 (mirrored in the plane of incidence) or from 0 to 360, or is a single angle. Between the angles
    the value is linear in phi and theta and a monotone cubic in sigma, so without a kink at an incidence. Beyond the ends of a
    list its first or last value holds: this avoids extrapolation, but it is no information about the sample.

    With `psi_deg` the sample is anisotropic and values have the shape (psi, sigma, phi, theta): psi is the azimuth of the light
    in the sample's own frame, and the value is linear in it. `symmetry` sets the range of psi_deg: "none" 360 deg; "half_turn"
    180 deg, then it repeats; "mirror" 0 to 180, both ends given, and (-psi, -phi) has the value of (psi, phi); "orthotropic" 0
    to 90, both ends given, with both symmetries, as brushed metal. A periodic list may omit its last angle; if it has it, the
    values must equal those of its first. A single psi makes an isotropic sample. At normal incidence the light's azimuth is
    taken as 0.

    Raises ValueError, naming the argument, for axes that do not ascend or leave their range, for a wrong shape, and for values
    that are negative, infinite or missing.
    """
    phi, psi = _phi(phi_deg), None if psi_deg is None else check_axis("psi_deg", psi_deg, 360.0)
    sigma, theta = check_axis("sigma_deg", sigma_deg, 90.0), check_axis("theta_deg", theta_deg, 180.0)
    table = freeze(values)
    axes = {"sigma": sigma, "phi": phi, "theta": theta}
    _check(table, axes if psi is None else {"psi": psi, **axes})
    blocks = table[None] if psi is None else table
    return Scatterer(name, lobes_of_side(_lobe(sigma, phi, theta, psi, blocks, symmetry), side, transmits))


def spectral_table(
    wavelengths_nm: npt.ArrayLike,
    sigma_deg: npt.ArrayLike,
    phi_deg: npt.ArrayLike,
    theta_deg: npt.ArrayLike,
    values: npt.ArrayLike,
    name: str = "spectral table",
    psi_deg: npt.ArrayLike | None = None,
    symmetry: Symmetry = "none",
    side: Side = "front",
    transmits: bool = False,
) -> Scatterer:
    """`table_sample` at each wavelength in nm, ascending; values have the wavelength as an additional first axis.

    Linear between the wavelengths; the first and last hold beyond the ends. Raises ValueError as `table_sample` does, and for
    wavelengths that do not ascend or are not positive.
    """
    wavelengths, table = freeze(wavelengths_nm), np.asarray(values, dtype=np.float64)
    if table.ndim == 0 or wavelengths.ndim != 1 or table.shape[0] != wavelengths.size:
        shapes = f"values has the shape {table.shape} and wavelengths_nm {wavelengths.shape}"
        raise ValueError(f"{shapes}: give a table for each wavelength, along the first axis")
    lobes: tuple[Lobe, ...] = ()
    for wavelength, block in zip(wavelengths, table, strict=True):
        try:
            sample = table_sample(sigma_deg, phi_deg, theta_deg, block, name, psi_deg, symmetry, side, transmits)
        except ValueError as error:
            raise ValueError(f"at {wavelength:g} nm: {error}") from None
        lobes += sample.lobes
    hats = np.repeat(np.eye(wavelengths.size), len(lobes) // max(wavelengths.size, 1), axis=0)
    return Scatterer(name, lobes, SpectralWeights(wavelengths, hats))


def _phi(phi_deg: npt.ArrayLike) -> Floats:
    phi = check_axis("phi_deg", phi_deg, 360.0)
    if phi.size > 1 and (phi[0] != 0.0 or phi[-1] not in (180.0, 360.0)):
        runs = f"{phi[0]:g} to {phi[-1]:g}"
        raise ValueError(f"phi_deg runs from {runs}: give 0 to 180 (symmetric) or 0 to 360, or one angle")
    return phi


def _check(table: Floats, axes: dict[str, Floats]) -> None:
    shape = tuple(each.size for each in axes.values())
    if table.shape != shape:
        raise ValueError(f"values has the shape {table.shape}: with its axes ({', '.join(axes)}) give {shape}")
    wrong = np.argwhere(~np.isfinite(table) | (table < 0.0))
    if wrong.size:
        index = tuple(int(i) for i in wrong[0])
        where = ", ".join(f"{name} {each[i]:g}" for (name, each), i in zip(axes.items(), index, strict=True))
        raise ValueError(f"values has {table[index]} at {where}: fill the hole or cut the table: values are 1/sr, >= 0")


def _lobe(sigma: Floats, phi: Floats, theta: Floats, psi: Floats | None, blocks: Floats, symmetry: Symmetry) -> Lobe:
    if symmetry not in SYMMETRIES:
        raise ValueError(f"symmetry is {symmetry!r}: give one of {', '.join(SYMMETRIES)}")
    if psi is None and symmetry != "none":
        raise ValueError(f"symmetry is {symmetry!r}, but psi_deg is missing; give psi_deg, or no symmetry")
    if psi is None or psi.size == 1:
        return Lobe(TABLE, parameters(), sigma, phi, theta, values=freeze(blocks))
    period, mirrored = SYMMETRIES[symmetry]
    if mirrored:
        if psi[0] != 0.0 or psi[-1] != 0.5 * period:
            runs = f"psi_deg runs from {psi[0]:g} to {psi[-1]:g}"
            raise ValueError(f"{runs}: for the symmetry {symmetry!r} give 0 to {0.5 * period:g} deg")
    elif psi[-1] - psi[0] > period:
        runs = f"psi_deg runs from {psi[0]:g} to {psi[-1]:g}"
        raise ValueError(f"{runs}: with the symmetry {symmetry!r} it repeats after {period:g} deg; cut it there")
    elif psi[-1] - psi[0] == period:
        worst = float(np.max(np.abs(blocks[-1] - blocks[0])))
        if worst > 1e-6 * float(blocks.max()):
            ends = f"values at psi {psi[0]:g} and {psi[-1]:g} differ by up to {worst:g} 1/sr"
            raise ValueError(f"{ends}: these are the same orientation; leave one of them out")
    else:
        psi, blocks = freeze([*psi, psi[0] + period]), np.concatenate([blocks, blocks[:1]])
    return Lobe(ANISOTROPIC, parameters(period, float(mirrored)), sigma, phi, theta, freeze(psi), freeze(blocks))
