"""What the photodiodes see of the exit pupil's radiance: from a pose of the instrument to a throughput each."""

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from hashlib import blake2b
from typing import TypeVar

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Scatterer,
    StrayMap,
    arc_direction,
    forward_throughput,
    regular,
    stray_map,
    stray_throughput,
    throughput,
)
from goniotwin.twin.plant.model import TwinModel

Kept = TypeVar("Kept")
POSES_KEPT = 64
MAPS_KEPT = 16
OPEN_BEAM = regular(transmits=True, side="both")
"""No sample: everything goes straight on."""


@dataclass(frozen=True)
class Aspect:
    """Everything that decides on the light at the photodiodes but the lamp: the sample's name (None: there is none), the angle
    by which it leans, the wavelength in nm, and the axes' true angles in degrees.
    """

    sample: str | None
    tilt_deg: float
    wavelength_nm: float
    sigma_deg: float
    gamma_deg: float
    beta_deg: float
    shift_deg: float


class View:
    """The photodiodes' view of a rig. What was computed lately is kept; asking changes nothing that is seen."""

    def __init__(self, model: TwinModel) -> None:
        self._model = model
        self.polar_deg = np.array(model.photodiodes.upper_deg + model.photodiodes.lower_deg)
        self._lower = np.repeat([False, True], [len(model.photodiodes.upper_deg), len(model.photodiodes.lower_deg)])
        self._seen: OrderedDict[tuple[object, ...], Floats] = OrderedDict()
        self._maps: OrderedDict[tuple[object, ...], StrayMap] = OrderedDict()

    def throughputs_m2sr(self, aspect: Aspect) -> Floats:
        """What each photodiode would get of the exit pupil's radiance: shape (photodiodes,)."""
        sample = OPEN_BEAM if aspect.sample is None else self._model.samples[aspect.sample]
        grey = sample.spectrum is None and self._model.instrument.grey
        wavelength = None if grey else aspect.wavelength_nm
        light = (aspect.sample, aspect.tilt_deg, wavelength, aspect.sigma_deg, aspect.gamma_deg)
        return _kept(
            self._seen,
            (*light, aspect.beta_deg, aspect.shift_deg),
            POSES_KEPT,
            lambda: self._computed(sample, light, wavelength, aspect),
        )

    def _computed(self, sample: Scatterer, light: tuple[object, ...], wavelength: float | None, aspect: Aspect) -> Floats:
        model, sigma = self._model, aspect.sigma_deg
        directions = arc_direction(self.polar_deg + aspect.shift_deg, np.full(self.polar_deg.size, aspect.beta_deg))
        directions[self._lower, 2] *= -1.0
        if aspect.tilt_deg:
            # Everything else turns about y, so a sample that leans is a rig that is turned the other way.
            c, s = math.cos(math.radians(aspect.tilt_deg)), math.sin(math.radians(aspect.tilt_deg))
            x, z = directions[:, 0].copy(), directions[:, 2].copy()
            directions[:, 0], directions[:, 2] = c * x - s * z, s * x + c * z
            sigma -= aspect.tilt_deg
        if model.estimator.kind == "forward":
            return self._traced(sample, sigma, directions, wavelength, aspect)
        seen = throughput(
            model.instrument, sigma, directions, sample, rays=model.estimator.rays, gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength,
        )  # fmt: skip
        if not model.estimator.stray:
            return seen

        def mapped() -> StrayMap:
            return stray_map(
                model.instrument, sigma, sample, seed=model.seed, gamma_deg=aspect.gamma_deg, wavelength_nm=wavelength,
                sample_frames=model.frames,
            )  # fmt: skip

        found = _kept(self._maps, light, MAPS_KEPT, mapped)
        return seen + stray_throughput(found, directions, model.instrument)

    def _traced(
        self, sample: Scatterer, sigma: float, directions: Floats, wavelength: float | None, aspect: Aspect
    ) -> Floats:  # fmt: skip
        # Each pose has its own random numbers: with the same ones all rows would be wrong in the same way.
        seed = blake2b(_seed_text(self._model.seed, aspect).encode(), digest_size=8).digest()
        found = forward_throughput(
            self._model.instrument, sigma, directions, sample, seed=int.from_bytes(seed, "big"), gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength, relative_error=self._model.estimator.relative_error, sample_frames=self._model.frames,
        )  # fmt: skip
        return found.throughput_m2sr if self._model.estimator.stray else found.single_m2sr


def _seed_text(seed: int, aspect: Aspect) -> str:
    """The text that the seed of a pose is made of. It stays as it is, whatever the class is called: journals rely on it."""
    return (
        f"({seed!r}, Aspect(sample={aspect.sample!r}, tilt_deg={aspect.tilt_deg!r}, wavelength_nm={aspect.wavelength_nm!r}, "
        f"sigma_deg={aspect.sigma_deg!r}, gamma_deg={aspect.gamma_deg!r}, beta_deg={aspect.beta_deg!r}, "
        f"shift_deg={aspect.shift_deg!r}))"
    )


def _kept(
    known: OrderedDict[tuple[object, ...], Kept], key: tuple[object, ...], most: int, compute: Callable[[], Kept]
) -> Kept:
    """Of `key`, computed where it is not known; what has not been asked for longest is forgotten."""
    if key in known:
        known.move_to_end(key)
        return known[key]
    found = known[key] = compute()
    if len(known) > most:
        known.popitem(last=False)
    return found
