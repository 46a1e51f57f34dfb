"""Spectra of lamps: flux over wavelength, with its unit, and the passband of a monochromator."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats

FluxUnit = Literal["W", "lm"]
LUMEN_PER_WATT = 683.0

# The photopic luminous efficiency V(lambda) of CIE 1924, every 10 nm from 380 to 780 nm.
V_NM = np.arange(380.0, 781.0, 10.0)
V = np.array(
    [
        0.000039, 0.00012, 0.000396, 0.00121, 0.0040, 0.0116, 0.023, 0.038, 0.060, 0.09098, 0.13902,
        0.20802, 0.323, 0.503, 0.710, 0.862, 0.954, 0.99495, 0.995, 0.952, 0.870,
        0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017,
        0.00821, 0.004102, 0.002091, 0.001047, 0.00052, 0.000249, 0.00012, 0.00006, 0.00003, 0.000015,
    ]
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Flux that a lamp emits over all directions: `flux_per_nm` (n,) in W/nm or lm/nm at `wavelength_nm` (n,).

    Linear between the points, zero outside them. The arrays are copied and read-only. Raises ValueError for fewer than 2
    points, wavelengths that do not ascend, negative flux, NaN, or no flux at all.
    """

    wavelength_nm: Floats
    flux_per_nm: Floats
    unit: FluxUnit = "W"

    def __post_init__(self) -> None:
        wavelength = np.array(self.wavelength_nm, dtype=np.float64)
        flux = np.array(self.flux_per_nm, dtype=np.float64)
        if self.unit not in ("W", "lm"):
            raise ValueError(f"unit is {self.unit!r}: give W or lm")
        if wavelength.ndim != 1 or wavelength.size < 2:
            raise ValueError(f"wavelength_nm has the shape {wavelength.shape}: give a list of at least 2 wavelengths")
        if flux.shape != wavelength.shape:
            raise ValueError(f"flux_per_nm has the shape {flux.shape}, wavelength_nm {wavelength.shape}: give one each")
        if not (np.all(np.isfinite(wavelength)) and wavelength[0] > 0.0 and np.all(np.diff(wavelength) > 0.0)):
            raise ValueError("wavelength_nm does not ascend: give positive, finite wavelengths, each once")
        if not (np.all(np.isfinite(flux)) and np.all(flux >= 0.0) and np.any(flux > 0.0)):
            raise ValueError("flux_per_nm has holes: give finite numbers, none negative, not all zero")
        for name, array in (("wavelength_nm", wavelength), ("flux_per_nm", flux)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def at(self, wavelength_nm: npt.ArrayLike) -> Floats:
        """Flux per nm at these wavelengths."""
        wavelength = np.asarray(wavelength_nm, dtype=np.float64)
        return np.interp(wavelength, self.wavelength_nm, self.flux_per_nm, left=0.0, right=0.0)

    @property
    def total(self) -> float:
        """Flux over all wavelengths, in `unit`."""
        return float(np.trapezoid(self.flux_per_nm, self.wavelength_nm))


@dataclass(frozen=True)
class Passband:
    """Transmittance of a monochromator: 1 over an interval about the centre, falling to 0 over a bandwidth on either side.

    Without an interval it is a triangle whose full width at half maximum is the bandwidth. All in nm.
    """

    centre_nm: float
    interval_nm: float
    bandwidth_nm: float

    @property
    def knots(self) -> Floats:
        """Corners of its straight lines, (5,), ascending."""
        inner, outer = 0.5 * self.interval_nm, 0.5 * self.interval_nm + self.bandwidth_nm
        return self.centre_nm + np.array([-outer, -inner, 0.0, inner, outer])

    def transmittance(self, wavelength_nm: npt.ArrayLike) -> Floats:
        """Transmittance at these wavelengths."""
        distance = np.abs(np.asarray(wavelength_nm, dtype=np.float64) - self.centre_nm)
        return np.clip((0.5 * self.interval_nm + self.bandwidth_nm - distance) / self.bandwidth_nm, 0.0, 1.0)

    def flux(self, spectrum: Spectrum) -> float:
        """Flux of a lamp that passes, in the spectrum's unit."""
        knots = np.sort(np.concatenate([spectrum.wavelength_nm, self.knots]))
        middle = 0.5 * (knots[1:] + knots[:-1])
        ends = spectrum.at(knots) * self.transmittance(knots)
        # Both are linear between the knots, so that Simpson's rule is exact; outside the table the flux is zero.
        inside = (middle > spectrum.wavelength_nm[0]) & (middle < spectrum.wavelength_nm[-1])
        simpson = (ends[1:] + ends[:-1] + 4.0 * spectrum.at(middle) * self.transmittance(middle)) / 6.0
        return float(np.sum(np.where(inside, simpson, 0.0) * np.diff(knots)))

    def sample(self, spectrum: Spectrum, numbers: Floats) -> Floats:
        """Wavelengths in nm, distributed as the flux that passes, from `numbers` (n,) in 0..1.

        Raises ValueError if no flux passes.
        """
        low = max(float(self.knots[0]), float(spectrum.wavelength_nm[0]))
        high = min(float(self.knots[-1]), float(spectrum.wavelength_nm[-1]))
        if low >= high:
            raise ValueError(
                f"the lamp emits nothing in {self.knots[0]:g} to {self.knots[-1]:g} nm, and no other wavelength passes"
            )
        edges = np.linspace(low, high, 4097)
        middle = 0.5 * (edges[1:] + edges[:-1])
        share = np.cumsum(spectrum.at(middle) * self.transmittance(middle))
        return np.interp(numbers, np.append(0.0, share / share[-1]), edges)


def luminous_spectrum(spectrum: Spectrum) -> Spectrum:
    """Spectrum in W converted to lm, at the wavelengths of both tables between 380 and 780 nm."""
    if spectrum.unit == "lm":
        return spectrum
    wavelength = np.union1d(spectrum.wavelength_nm, V_NM)
    wavelength = wavelength[(wavelength >= V_NM[0]) & (wavelength <= V_NM[-1])]
    return Spectrum(wavelength, LUMEN_PER_WATT * np.interp(wavelength, V_NM, V) * spectrum.at(wavelength), "lm")


def xenon_spectrum(luminous_flux_lm: float = 3000.0) -> Spectrum:
    """Xenon short-arc lamp of about 150 W, in W/nm from 380 to 780 nm; such lamps are rated at 3000 lm.

    Coarse, from general publications on these lamps, not from one lamp's data sheet: a continuum like that of a black body at
    6000 K, flat within a fifth over the visible, with groups of weak lines near 467 and 490 nm. The strong lines from 820 nm on
    are outside. Replace it by the table of the lamp in use. Raises ValueError unless the flux is positive and finite.
    """
    if not (np.isfinite(luminous_flux_lm) and luminous_flux_lm > 0.0):
        raise ValueError(f"luminous_flux_lm is {luminous_flux_lm!r}: give a positive, finite number")
    shape = np.array(
        [
            [380, 0.80], [400, 0.88], [420, 0.92], [440, 0.96], [455, 1.00], [467, 1.18], [475, 1.06], [482, 1.03],
            [490, 1.08], [500, 0.99], [520, 0.98], [540, 0.98], [560, 0.98], [580, 0.98], [600, 0.97], [620, 0.97],
            [640, 0.95], [660, 0.94], [680, 0.95], [700, 0.92], [720, 0.91], [740, 0.91], [760, 0.92], [780, 0.89],
        ]
    )  # fmt: skip
    relative = Spectrum(shape[:, 0], shape[:, 1])
    return Spectrum(relative.wavelength_nm, relative.flux_per_nm * luminous_flux_lm / luminous_spectrum(relative).total)
