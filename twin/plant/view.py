"""Throughput from the exit pupil to the photodiodes at a pose of the instrument."""

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, replace
from hashlib import blake2b
from typing import TypeVar

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Scatterer,
    StrayMap,
    arc_direction,
    forward_throughput,
    regular,
    stray_map,
    stray_throughput,
    throughput,
)
from goniotwin.twin.optics.geometry.deviation import NO_DEVIATION
from goniotwin.twin.plant.disturbances import Drawn, add_deviations
from goniotwin.twin.plant.model import TwinModel

Cached = TypeVar("Cached")
POSES_KEPT = 64
MAPS_KEPT = 16
OPEN_BEAM = regular(transmits=True, side="both")
"""No sample: all light goes straight on."""


@dataclass(frozen=True)
class Aspect:
    """Everything that determines the light on the photodiodes except the lamp.

    The sample's name (None: no sample), the angle by which it is tilted, the wavelength in nm, the axes' true angles in
    degrees, and the number of the sample's mounting (0: without the deviation that each mounting has).
    """

    sample: str | None
    tilt_deg: float
    wavelength_nm: float
    sigma_deg: float
    gamma_deg: float
    beta_deg: float
    shift_deg: float
    mounting: int = 0


class View:
    """Throughputs of a rig's photodiodes. Recent results are stored; the result does not depend on earlier calls."""

    def __init__(self, model: TwinModel, drawn: Drawn | None = None) -> None:
        self._model = model
        self._drawn = drawn or Drawn(model.disturbances, model.seed, model.photodiodes.count)
        self._instrument = self._drawn.instrument(model.instrument)
        self._along_deg, self._across_deg = self._drawn.photodiode_angles_deg()
        self.polar_deg = np.array(model.photodiodes.upper_deg + model.photodiodes.lower_deg)
        self._lower = np.repeat([False, True], [len(model.photodiodes.upper_deg), len(model.photodiodes.lower_deg)])
        self._throughputs: OrderedDict[tuple[object, ...], Floats] = OrderedDict()
        self._maps: OrderedDict[tuple[object, ...], StrayMap] = OrderedDict()
        self._instruments: OrderedDict[tuple[object, ...], Instrument] = OrderedDict()

    def throughputs_m2sr(self, aspect: Aspect) -> Floats:
        """Throughput of each photodiode, m^2 sr: its flux over the radiance of the exit pupil. Shape (photodiodes,)."""
        sample = OPEN_BEAM if aspect.sample is None else self._model.samples[aspect.sample]
        grey = sample.spectrum is None and self._instrument.grey
        wavelength = None if grey else aspect.wavelength_nm
        mounted = self._drawn.mounted(aspect.sample, aspect.mounting)
        light = (aspect.sample, aspect.tilt_deg, wavelength, aspect.sigma_deg, aspect.gamma_deg, mounted)
        return _cached(
            self._throughputs,
            (*light, aspect.beta_deg, aspect.shift_deg),
            POSES_KEPT,
            lambda: self._compute(sample, light, wavelength, mounted, aspect),
        )

    def directions(self, beta_deg: float, shift_deg: float) -> Floats:
        """Directions (photodiodes, 3) of the photodiodes in the rig's frame, each with its own angles."""
        beta = np.full(self.polar_deg.size, beta_deg)
        directions = arc_direction(self.polar_deg + self._along_deg + shift_deg, beta, self._lower)
        if self._across_deg.any():
            aside, across = np.radians(beta_deg), np.radians(self._across_deg)[:, None]
            level = np.array([-math.sin(aside), math.cos(aside), 0.0])
            directions = np.cos(across) * directions + np.sin(across) * level
        return directions

    def _compute(
        self, sample: Scatterer, light: tuple[object, ...], wavelength: float | None, mounted: Deviation, aspect: Aspect
    ) -> Floats:
        model, sigma, instrument = self._model, aspect.sigma_deg, self._instrument
        if mounted != NO_DEVIATION:
            instrument = _cached(self._instruments, (mounted,), MAPS_KEPT, lambda: self._with_sample(mounted))
        directions = self.directions(aspect.beta_deg, aspect.shift_deg)
        if aspect.tilt_deg:
            # A sample tilted about y is equivalent to a rig turned about y by the opposite angle.
            c, s = math.cos(math.radians(aspect.tilt_deg)), math.sin(math.radians(aspect.tilt_deg))
            x, z = directions[:, 0].copy(), directions[:, 2].copy()
            directions[:, 0], directions[:, 2] = c * x - s * z, s * x + c * z
            sigma -= aspect.tilt_deg
        if model.estimator.kind == "forward":
            return self._trace(instrument, sample, sigma, directions, wavelength, mounted, aspect)
        direct = throughput(
            instrument, sigma, directions, sample, rays=model.estimator.rays, gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength,
        )  # fmt: skip
        if not model.estimator.stray:
            return direct

        def compute_map() -> StrayMap:
            return stray_map(
                instrument, sigma, sample, seed=model.seed, gamma_deg=aspect.gamma_deg, wavelength_nm=wavelength,
                sample_frames=model.frames,
            )  # fmt: skip

        stray = _cached(self._maps, light, MAPS_KEPT, compute_map)
        return direct + stray_throughput(stray, directions, instrument)

    def _with_sample(self, mounted: Deviation) -> Instrument:
        """The instrument with the deviation of a mounting, which holds for all its rows."""
        own = add_deviations(self._instrument.deviation("sample"), mounted)
        return replace(self._instrument, deviations={**self._instrument.deviations, "sample": own})

    def _trace(
        self, instrument: Instrument, sample: Scatterer, sigma: float, directions: Floats, wavelength: float | None,
        mounted: Deviation, aspect: Aspect,
    ) -> Floats:  # fmt: skip
        # Each pose has its own random numbers: with the same ones the errors of all rows would be correlated.
        text = _seed_text(self._model.seed, aspect) + (f" {aspect.mounting}" if mounted != NO_DEVIATION else "")
        seed = blake2b(text.encode(), digest_size=8).digest()
        estimate = forward_throughput(
            instrument, sigma, directions, sample, seed=int.from_bytes(seed, "big"), gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength, relative_error=self._model.estimator.relative_error, sample_frames=self._model.frames,
        )  # fmt: skip
        return estimate.throughput_m2sr if self._model.estimator.stray else estimate.single_m2sr


def _seed_text(seed: int, aspect: Aspect) -> str:
    """Text from which the seed of a pose is made. It must not change, whatever the class is called: journals depend on it."""
    return (
        f"({seed!r}, Aspect(sample={aspect.sample!r}, tilt_deg={aspect.tilt_deg!r}, wavelength_nm={aspect.wavelength_nm!r}, "
        f"sigma_deg={aspect.sigma_deg!r}, gamma_deg={aspect.gamma_deg!r}, beta_deg={aspect.beta_deg!r}, "
        f"shift_deg={aspect.shift_deg!r}))"
    )


def _cached(
    cache: OrderedDict[tuple[object, ...], Cached], key: tuple[object, ...], most: int, compute: Callable[[], Cached]
) -> Cached:
    """Cached value of `key`, computed if missing. The value that was used least recently is dropped beyond `most`."""
    if key in cache:
        cache.move_to_end(key)
        return cache[key]
    result = cache[key] = compute()
    if len(cache) > most:
        cache.popitem(last=False)
    return result
