"""Sample: lobes and their spectral weights, the sum of their values, and combinations of samples.

Values are BSDF in 1/sr. A luminance factor (formula 1 of the paper calls it BSDF) is pi times the BSDF. Light and observer are
directions in the rig's frame; a sample turned by gamma sees them turned by -gamma.

Combinations: sums, models for other sides, a grey sample with a spectrum.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from goniotwin.arrays import Floats
from goniotwin.twin.optics.bsdf.kinds import REGULAR
from goniotwin.twin.optics.bsdf.lobes import ALBEDO_SIGMA_DEG, Lobe, freeze
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, is_lit_from_behind


@dataclass(frozen=True, eq=False)
class SpectralWeights:
    """Weights (lobes, w) of lobes at wavelengths (w,) in nm, ascending: linear between, constant beyond the ends."""

    wavelengths_nm: Floats
    weights: Floats

    def __post_init__(self) -> None:
        """Check and copy the arrays. Raises ValueError, naming the argument and the entry."""
        wavelengths, weights = freeze(self.wavelengths_nm), freeze(self.weights)
        if wavelengths.ndim != 1 or wavelengths.size == 0:
            raise ValueError(f"wavelengths_nm has the shape {wavelengths.shape}: give a list of at least one")
        wrong = np.flatnonzero(~(np.isfinite(wavelengths) & (wavelengths > 0.0)))
        if wrong.size:
            raise ValueError(f"wavelengths_nm[{wrong[0]}] is {wavelengths[wrong[0]]}: give a positive, finite number")
        if np.any(np.diff(wavelengths) <= 0.0):
            raise ValueError("wavelengths_nm is not ascending: sort it and give each wavelength once")
        if weights.ndim != 2 or weights.shape[1] != wavelengths.size:
            raise ValueError(f"weights has the shape {weights.shape}: give (lobes, {wavelengths.size})")
        holes = np.argwhere(~(np.isfinite(weights) & (weights >= 0.0)))
        if holes.size:
            i, j = holes[0]
            raise ValueError(f"the weight at {wavelengths[j]:g} nm is {weights[i, j]}: give a finite number, not below 0")
        object.__setattr__(self, "wavelengths_nm", wavelengths)
        object.__setattr__(self, "weights", weights)

    def at(self, wavelength_nm: npt.ArrayLike) -> Floats:
        """Weights (lobes, ...) at wavelengths (...)."""
        wavelengths = np.asarray(wavelength_nm, dtype=np.float64)
        return np.array([np.interp(wavelengths, self.wavelengths_nm, row) for row in self.weights])


@dataclass(frozen=True, eq=False)
class Scatterer:
    """Sample. Its value at a wavelength is the sum over the lobes of weight times value; without a spectrum all weights are 1.

    Made by the functions below and by those of twin.optics.bsdf.analytic_samples, table_samples and point_samples. Raises
    ValueError for no lobes, or a spectrum for another number of lobes.
    """

    name: str
    lobes: tuple[Lobe, ...]
    spectrum: SpectralWeights | None = None

    def __post_init__(self) -> None:
        """Check that there are lobes, and weights for them."""
        if not self.lobes:
            raise ValueError("lobes is empty: a sample has at least one; for a black one give a table of zeros")
        if self.spectrum is not None and self.spectrum.weights.shape[0] != len(self.lobes):
            given = self.spectrum.weights.shape[0]
            raise ValueError(f"spectrum has weights of {given} lobes, but the sample has {len(self.lobes)}")

    def weights(self, wavelength_nm: npt.ArrayLike | None = None) -> Floats:
        """Weights (lobes,) at a wavelength, or (lobes, ...) at wavelengths (...).

        Raises ValueError for a sample with a spectrum without a wavelength, and for a wavelength that is not positive.
        """
        if wavelength_nm is None:
            if self.spectrum is not None:
                raise ValueError(f"wavelength_nm is missing: {self.name} depends on it; give a wavelength")
            return np.ones(len(self.lobes))
        wavelengths = np.asarray(wavelength_nm, dtype=np.float64)
        if not np.all(np.isfinite(wavelengths) & (wavelengths > 0.0)):
            raise ValueError(f"wavelength_nm is {wavelength_nm!r}: give positive, finite numbers of nanometres")
        if self.spectrum is None:
            return np.ones((len(self.lobes), *wavelengths.shape))
        return self.spectrum.at(wavelengths)


def _incidence(sigma_deg: float) -> tuple[int, float]:
    """Side of the light (1 front, -1 back), and its polar angle on that side."""
    if not 0.0 <= sigma_deg <= HALF_TURN_DEG or sigma_deg == 0.5 * HALF_TURN_DEG:
        raise ValueError(f"sigma_deg is {sigma_deg!r}: give an angle of incidence of 0 to 180 deg, but not 90")
    return (-1, HALF_TURN_DEG - sigma_deg) if is_lit_from_behind(sigma_deg) else (1, sigma_deg)


def albedo(
    scatterer: Scatterer,
    sigma_deg: float,
    transmitted: bool = False,
    wavelength_nm: float | None = None,
    gamma_deg: float = 0.0,
) -> float:
    """Share of the light at `sigma_deg` that is reflected, or that is transmitted; regular lobes included.

    sigma is 0 to < 90 for light from the front and > 90 to 180 for light from the back. By quadrature: see `Lobe.albedo`.
    Raises ValueError for another sigma, and for a sample with a spectrum without a wavelength.
    """
    incident, polar = _incidence(sigma_deg)
    # The light's azimuth in the sample's own frame is -gamma; for the sample turned about x its sign is opposite.
    azimuth = -gamma_deg * incident
    weights = scatterer.weights(wavelength_nm)
    shares = [
        float(weight) * lobe.albedo(polar, azimuth)
        for lobe, weight in zip(scatterer.lobes, weights, strict=True)
        if lobe.incident == incident and lobe.transmits == transmitted
    ]
    return sum(shares, start=0.0)


def lobe_shares(scatterer: Scatterer, sigma_deg: float, wavelength_nm: float | None = None) -> Floats:
    """Probabilities (lobes,) for the choice of a lobe, for light at `sigma_deg` as in `albedo`.

    Proportional to weight and albedo; the albedo is interpolated from a few incidences. A lobe that scatters at any of them has
    at least a twentieth of its mean. An estimator divides by these numbers, so they affect its noise and never its mean.
    Without a wavelength the weights are their means over the spectrum's list, for one set of rays that serves all wavelengths.
    All are 0 where no lobe scatters light from that side.
    """
    incident, polar = _incidence(sigma_deg)
    if wavelength_nm is None and scatterer.spectrum is not None:
        weights = scatterer.spectrum.weights.mean(axis=1)
    else:
        weights = scatterer.weights(wavelength_nm)
    result = np.zeros(len(scatterer.lobes))
    for i, lobe in enumerate(scatterer.lobes):
        if lobe.incident == incident and weights[i] > 0.0:
            here = float(np.interp(polar, ALBEDO_SIGMA_DEG, lobe.albedos))
            result[i] = weights[i] * max(here, 0.05 * float(lobe.albedos.mean()))
    total = result.sum()
    return result / total if total > 0.0 else result


def move_to_side(lobe: Lobe, incident: int, transmits: bool) -> Lobe:
    """The same model for another pair of sides."""
    return replace(lobe, incident=incident, transmits=transmits)


def sum_samples(*scatterers: Scatterer, name: str | None = None) -> Scatterer:
    """Sum of samples: all their lobes, each with its own spectrum.

    The total may exceed the light received; check it with `albedo`. Raises ValueError for no samples.
    """
    if not scatterers:
        raise ValueError("scatterers is empty: give the samples to add up")
    lobes = tuple(lobe for each in scatterers for lobe in each.lobes)
    title = name or " + ".join(each.name for each in scatterers)
    spectra = [each.spectrum.wavelengths_nm for each in scatterers if each.spectrum is not None]
    if not spectra:
        return Scatterer(title, lobes)
    # Interpolation over the union of the lists equals the interpolation over each list.
    wavelengths = np.unique(np.concatenate(spectra))
    weights = np.concatenate([each.weights(wavelengths) for each in scatterers])
    return Scatterer(title, lobes, SpectralWeights(wavelengths, weights))


def without_regular(scatterer: Scatterer) -> Scatterer:
    """The sample without its regular component. Raises ValueError where it has nothing else."""
    kept = [k for k, lobe in enumerate(scatterer.lobes) if lobe.kind != REGULAR]
    spectrum = scatterer.spectrum
    if spectrum is not None:
        spectrum = SpectralWeights(spectrum.wavelengths_nm, spectrum.weights[kept])
    return replace(scatterer, lobes=tuple(scatterer.lobes[k] for k in kept), spectrum=spectrum)


def apply_spectrum(
    wavelengths_nm: npt.ArrayLike, factors: npt.ArrayLike, scatterer: Scatterer, name: str | None = None
) -> Scatterer:
    """Grey sample with a spectrum: `factors` (w,) times it at wavelengths (w,) in nm, linear between, constant beyond the ends.

    Raises ValueError for lists that do not fit or ascend, for a factor that is negative or missing, and for a sample that
    already depends on the wavelength.
    """
    if scatterer.spectrum is not None:
        raise ValueError(
            f"scatterer: {scatterer.name} depends on the wavelength already; apply spectra to its parts, then add them"
        )
    wavelengths, factor = freeze(wavelengths_nm), freeze(factors)
    if factor.shape != wavelengths.shape:
        raise ValueError(f"factors has the shape {factor.shape}; with these wavelengths_nm give {wavelengths.shape}")
    spectrum = SpectralWeights(wavelengths, np.tile(factor, (len(scatterer.lobes), 1)))
    return replace(scatterer, name=name or f"{scatterer.name} in colour", spectrum=spectrum)


def combine_sides(
    front_reflection: Scatterer | None = None,
    front_transmission: Scatterer | None = None,
    back_reflection: Scatterer | None = None,
    back_transmission: Scatterer | None = None,
    name: str | None = None,
) -> Scatterer:
    """Sample with its own model for each pair of sides; a missing one scatters nothing.

    "front" and "back" are the sides of the light. A model may be as its constructor makes it by default (front, reflecting: it
    is then moved to these sides) or be of these sides already, as a refracted lobe has to be. Raises ValueError, naming the
    argument, for a model of other sides, and if none is given.
    """
    models = {
        "front_reflection": (front_reflection, 1, False),
        "front_transmission": (front_transmission, 1, True),
        "back_reflection": (back_reflection, -1, False),
        "back_transmission": (back_transmission, -1, True),
    }
    given = [
        replace(model, lobes=tuple(map(_mover(argument, incident, transmits), model.lobes)))
        for argument, (model, incident, transmits) in models.items()
        if model is not None
    ]
    if not given:
        raise ValueError("no model is given: give at least one")
    return sum_samples(*given, name=name)


def _mover(argument: str, incident: int, transmits: bool) -> Callable[[Lobe], Lobe]:
    def move(lobe: Lobe) -> Lobe:
        right = lobe.transmits == transmits and lobe.incident in (1, incident)
        if not right and (lobe.transmits or lobe.incident != 1):
            side, action = "front" if lobe.incident == 1 else "back", "transmits" if lobe.transmits else "reflects"
            raise ValueError(
                f"{argument} has a lobe that {action} light from the {side}: give it as the argument for these sides"
            )
        return move_to_side(lobe, incident, transmits)

    return move
