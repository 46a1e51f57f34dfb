"""Samples made of samples: sums, other sides, and the same sample in colour."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from goniotwin.twin.optics.bsdf.lobes import Lobe, frozen
from goniotwin.twin.optics.bsdf.scatterer import Scatterer, SpectralWeights, on_side


def summed(*scatterers: Scatterer, name: str | None = None) -> Scatterer:
    """The sum of samples: all their lobes, each with its own spectrum.

    That it gives back no more light than it gets is for the caller to see to: `albedo` tells. Raises ValueError for no
    samples.
    """
    if not scatterers:
        raise ValueError("scatterers is empty: give the samples to add up")
    lobes = tuple(lobe for each in scatterers for lobe in each.lobes)
    title = name or " + ".join(each.name for each in scatterers)
    spectra = [each.spectrum.wavelengths_nm for each in scatterers if each.spectrum is not None]
    if not spectra:
        return Scatterer(title, lobes)
    # Linear pieces over the union of the lists are the linear pieces of each.
    wavelengths = np.unique(np.concatenate(spectra))
    weights = np.concatenate([each.weights(wavelengths) for each in scatterers])
    return Scatterer(title, lobes, SpectralWeights(wavelengths, weights))


def spectral(wavelengths_nm: npt.ArrayLike, factors: npt.ArrayLike, scatterer: Scatterer, name: str | None = None) -> Scatterer:
    """A grey sample in colour: `factors` (w,) times it at wavelengths (w,) in nm, linear between, the ends held.

    Raises ValueError for lists that do not fit or ascend, for a factor that is negative or missing, and for a sample
    that depends on the wavelength already.
    """
    if scatterer.spectrum is not None:
        raise ValueError(f"scatterer: {scatterer.name} depends on the wavelength already; colour its parts, then add them")
    wavelengths, factor = frozen(wavelengths_nm), frozen(factors)
    if factor.shape != wavelengths.shape:
        raise ValueError(f"factors has the shape {factor.shape}: wavelengths_nm makes it {wavelengths.shape}")
    spectrum = SpectralWeights(wavelengths, np.tile(factor, (len(scatterer.lobes), 1)))
    return replace(scatterer, name=name or f"{scatterer.name} in colour", spectrum=spectrum)


def sided(
    front_reflection: Scatterer | None = None,
    front_transmission: Scatterer | None = None,
    back_reflection: Scatterer | None = None,
    back_transmission: Scatterer | None = None,
    name: str | None = None,
) -> Scatterer:
    """A sample with its own model for each way of the light; a missing one scatters nothing.

    "front" and "back" are where the light comes from. Each model may be as its constructor makes it by default (front,
    reflecting: it is then moved to these sides) or be of these sides already, as a refracted lobe has to be. Raises
    ValueError, naming the argument, for a model of other sides, and where none is given.
    """
    ways = {
        "front_reflection": (front_reflection, 1, False),
        "front_transmission": (front_transmission, 1, True),
        "back_reflection": (back_reflection, -1, False),
        "back_transmission": (back_transmission, -1, True),
    }
    given = [
        replace(model, lobes=tuple(map(_mover(argument, incident, transmits), model.lobes)))
        for argument, (model, incident, transmits) in ways.items()
        if model is not None
    ]
    if not given:
        raise ValueError("no model is given: give one for at least one way of the light")
    return summed(*given, name=name)


def _mover(argument: str, incident: int, transmits: bool) -> Callable[[Lobe], Lobe]:
    def moved(lobe: Lobe) -> Lobe:
        right = lobe.transmits == transmits and lobe.incident in (1, incident)
        if not right and (lobe.transmits or lobe.incident != 1):
            side, way = "front" if lobe.incident == 1 else "back", "transmits" if lobe.transmits else "reflects"
            raise ValueError(f"{argument} has a lobe that {way} light from the {side}: give it to the argument of its own")
        return on_side(lobe, incident, transmits)

    return moved
