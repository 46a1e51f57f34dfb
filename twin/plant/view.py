"""Throughput from the exit pupil to the photodiodes at a pose of the instrument."""

import math
from collections import OrderedDict
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from hashlib import blake2b
from itertools import count, islice
from typing import NamedTuple, TypeVar

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Poses,
    Scatterer,
    Scenes,
    StrayMap,
    arc_axis,
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
POSES_KEPT = 512
POSES_AHEAD = 120
"""Poses whose throughputs are computed in one call; a call for a single one takes about as long as for ten."""
MAPS_KEPT = 16
LIGHTS_KEPT = 1024
"""Numbers of what decides on the light, see `View._light`: some for each wavelength."""
OPEN_BEAM = regular(transmits=True, side="both")
"""No sample: all light goes straight on."""


class Aspect(NamedTuple):
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


SIGMA, MOUNTING = Aspect._fields.index("sigma_deg"), Aspect._fields.index("mounting")
"""Where the angles of the axes begin in an aspect, and where they end."""


class View:
    """Throughputs of a rig's photodiodes. Recent results are stored; the result does not depend on earlier calls."""

    def __init__(self, model: TwinModel, drawn: Drawn | None = None) -> None:
        self._model = model
        self._drawn = drawn or Drawn(model.disturbances, model.seed, model.photodiodes.count)
        self._instrument = self._drawn.instrument(model.instrument)
        self._along_deg, self._across_deg = self._drawn.photodiode_angles_deg()
        self.polar_deg = np.array(model.photodiodes.upper_deg + model.photodiodes.lower_deg)
        self._lower = np.repeat([False, True], [len(model.photodiodes.upper_deg), len(model.photodiodes.lower_deg)])
        self._numbers = count()  # none is given twice
        self._lights: dict[tuple[object, ...], int] = {}
        self._known_lights: dict[tuple[object, ...], int] = {}
        self._throughputs: OrderedDict[tuple[object, ...], Floats] = OrderedDict()
        self._maps: OrderedDict[tuple[object, ...], StrayMap] = OrderedDict()
        self._instruments: OrderedDict[tuple[object, ...], Instrument] = OrderedDict()
        self._expected: Iterator[Aspect] | None = None
        self._next: dict[tuple[object, ...], Aspect] = {}
        self._computed: dict[Aspect, Floats] = {}

    def throughputs_m2sr(self, aspect: Aspect) -> Floats:
        """Throughput of each photodiode, m^2 sr: its flux over the radiance of the exit pupil. Shape (photodiodes,)."""
        known = self._computed.get(aspect)
        if known is not None:
            return known
        key = self._key(aspect)
        if self._expected is not None and key not in self._throughputs:
            self._compute_expected(key)
        return _cached(self._throughputs, key, POSES_KEPT, lambda: self._compute(aspect))

    def expect(self, aspects: Iterable[Aspect]) -> None:
        """Aspects that follow, in their order. At the first that is not known yet, many of them are computed in one call.

        The results do not depend on it, nor does it matter if others come, or not all of these.
        """
        fast = self._model.estimator.kind == "fast" and not self._model.estimator.stray
        self._expected, self._next = (iter(aspects) if fast else None), {}

    def _key(self, aspect: Aspect) -> tuple[object, ...]:
        return (self._light(aspect), *aspect[SIGMA:MOUNTING])

    def _light(self, aspect: Aspect) -> int:
        """Number of what decides on the light besides the axes: sample, tilt, wavelength, deviation of the mounting.

        Equal numbers mean equal ones. They are made once for many poses: the deviation alone has six numbers to compare.
        """
        given = (*aspect[:SIGMA], aspect.mounting)
        known = self._known_lights.get(given)
        if known is None:
            if len(self._known_lights) >= LIGHTS_KEPT:
                self._known_lights.clear()
                self._lights.clear()
            mounted = self._drawn.mounted(aspect.sample, aspect.mounting)
            light = (aspect.sample, aspect.tilt_deg, self._wavelength(aspect), mounted)
            known = self._known_lights[given] = self._lights.setdefault(light, next(self._numbers))
        return known

    def _sample(self, aspect: Aspect) -> Scatterer:
        return OPEN_BEAM if aspect.sample is None else self._model.samples[aspect.sample]

    def _wavelength(self, aspect: Aspect) -> float | None:
        """The wavelength, unless it makes no difference."""
        return None if self._sample(aspect).spectrum is None and self._instrument.grey else aspect.wavelength_nm

    def _compute_expected(self, key: tuple[object, ...]) -> None:
        """Compute an expected aspect and those that follow it."""
        assert self._expected is not None
        for aspect in islice(self._expected, POSES_AHEAD - len(self._next)):
            expected = self._key(aspect)
            if expected not in self._throughputs:
                self._next[expected] = aspect
        if key not in self._next:
            return
        together: dict[object, dict[tuple[object, ...], Aspect]] = {}
        for expected, aspect in self._next.items():
            together.setdefault(expected[0], {})[expected] = aspect
        self._next, self._computed = {}, {}
        for group in together.values():
            first = next(iter(group.values()))
            sigma_deg, gamma_deg, beta_deg, shift_deg = np.array([each[SIGMA:MOUNTING] for each in group.values()]).T
            directions = self._turned(first.tilt_deg, self.detectors(beta_deg, shift_deg))
            poses = Poses(sigma_deg - first.tilt_deg, directions, gamma_deg)
            instrument, rays = self._mounted_instrument(first), self._model.estimator.rays
            scenes = Scenes(instrument, poses, [self._sample(first)], self._wavelength(first), rays)
            found = scenes.throughputs()[0, 0, 0].reshape(len(group), -1)
            self._throughputs.update(zip(group, found, strict=True))
            self._computed.update(zip(group.values(), found, strict=True))
        while len(self._throughputs) > POSES_KEPT:
            self._throughputs.popitem(last=False)

    def directions(self, beta_deg: Floats | float, shift_deg: Floats | float) -> Floats:
        """Directions (..., photodiodes, 3) in the rig's frame, each photodiode with its own angles; of the angles' shape."""
        beta, shift = (np.asarray(each)[..., None] for each in (beta_deg, shift_deg))
        directions = arc_direction(self.polar_deg + self._along_deg + shift, beta, self._lower)
        if self._across_deg.any():
            across = np.radians(self._across_deg)[:, None]
            directions = np.cos(across) * directions + np.sin(across) * arc_axis(beta)
        return directions

    def detectors(self, beta_deg: Floats | float, shift_deg: Floats | float) -> Floats:
        """The same with the axis of the arc after each direction: (..., photodiodes, 6)."""
        directions = self.directions(beta_deg, shift_deg)
        axis = np.broadcast_to(arc_axis(np.asarray(beta_deg)[..., None]), directions.shape)
        return np.concatenate([directions, axis], axis=-1)

    def _mounted_instrument(self, aspect: Aspect) -> Instrument:
        mounted = self._drawn.mounted(aspect.sample, aspect.mounting)
        if mounted == NO_DEVIATION:
            return self._instrument
        return _cached(self._instruments, (mounted,), MAPS_KEPT, lambda: self._with_sample(mounted))

    @staticmethod
    def _turned(tilt_deg: float, detectors: Floats) -> Floats:
        """Detectors (..., 6) as a sample that is tilted sees them; it sees a sigma that is smaller by the tilt.

        A sample tilted about y is equivalent to a rig turned about y by the opposite angle.
        """
        if tilt_deg:
            c, s = math.cos(math.radians(tilt_deg)), math.sin(math.radians(tilt_deg))
            x, z = detectors[..., 0::3].copy(), detectors[..., 2::3].copy()
            detectors[..., 0::3], detectors[..., 2::3] = c * x - s * z, s * x + c * z
        return detectors

    def _compute(self, aspect: Aspect) -> Floats:
        model, sample, wavelength = self._model, self._sample(aspect), self._wavelength(aspect)
        light = (self._light(aspect), aspect.sigma_deg, aspect.gamma_deg)
        mounted, instrument = self._drawn.mounted(aspect.sample, aspect.mounting), self._mounted_instrument(aspect)
        directions = self._turned(aspect.tilt_deg, self.detectors(aspect.beta_deg, aspect.shift_deg))
        sigma = aspect.sigma_deg - aspect.tilt_deg
        if model.estimator.kind == "forward":
            return self._trace(instrument, sample, sigma, directions, wavelength, mounted, aspect)
        direct = throughput(
            instrument,
            sigma,
            directions,
            sample,
            rays=model.estimator.rays,
            gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength,
        )
        if not model.estimator.stray:
            return direct

        def compute_map() -> StrayMap:
            return stray_map(
                instrument,
                sigma,
                sample,
                seed=model.seed,
                gamma_deg=aspect.gamma_deg,
                wavelength_nm=wavelength,
                sample_frames=model.frames,
            )

        stray = _cached(self._maps, light, MAPS_KEPT, compute_map)
        return direct + stray_throughput(stray, directions, instrument)

    def _with_sample(self, mounted: Deviation) -> Instrument:
        """The instrument with the deviation of a mounting, which holds for all its rows."""
        own = add_deviations(self._instrument.deviation("sample"), mounted)
        return replace(self._instrument, deviations={**self._instrument.deviations, "sample": own})

    def _trace(
        self,
        instrument: Instrument,
        sample: Scatterer,
        sigma: float,
        directions: Floats,
        wavelength: float | None,
        mounted: Deviation,
        aspect: Aspect,
    ) -> Floats:
        # Each pose has its own random numbers: with the same ones the errors of all rows would be correlated.
        text = _seed_text(self._model.seed, aspect) + (f" {aspect.mounting}" if mounted != NO_DEVIATION else "")
        seed = blake2b(text.encode(), digest_size=8).digest()
        estimate = forward_throughput(
            instrument,
            sigma,
            directions,
            sample,
            seed=int.from_bytes(seed, "big"),
            gamma_deg=aspect.gamma_deg,
            wavelength_nm=wavelength,
            relative_error=self._model.estimator.relative_error,
            sample_frames=self._model.frames,
        )
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
