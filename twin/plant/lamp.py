"""The lamp: one random process over time, the same for all photodiodes and the monitor."""

import math

import numpy as np

from goniotwin.arrays import Floats, Keys
from goniotwin.twin.optics.kernel import kernel
from goniotwin.twin.plant.model import LightSource
from goniotwin.twin.plant.noise import normal, wandering
from goniotwin.twin.plant.process_key import process_key


@kernel()
def lamp_level(t: float, constants: Floats, keys: Keys) -> float:
    """Radiance at the time `t` relative to the nominal radiance. `constants` and `keys` are from `lamp_constants`."""
    level: float = constants[6] + constants[0] * (t - constants[5]) / 3600.0
    if constants[1] > 0.0:
        level += constants[1] * normal(keys[0], np.int64(math.floor(t / constants[2])))
    if constants[3] > 0.0:
        level += constants[3] * wandering(keys[1], t, constants[4])
    return level


@kernel()
def lamp_mean(start: float, end: float, constants: Floats, keys: Keys) -> float:
    """Mean level over [start, end), sampled at least once in each flicker period."""
    count = max(1, math.ceil((end - start) / constants[2]))
    total: float = 0.0
    for k in range(count):
        total += lamp_level(start + (k + 0.5) * (end - start) / count, constants, keys)
    mean: float = total / count
    return mean


def lamp_constants(light: LightSource, seed: int, noise: bool) -> tuple[Floats, Keys]:
    """Arguments of the kernels: constants (7,) and keys (2,).

    Constants: drift per hour, flicker, flicker period, wander, wander period, start time of the drift, level at that time.
    Keys: those of the flicker and of the wander.
    """
    scale = 1.0 if noise else 0.0
    constants = np.array(
        [
            light.drift_per_hour,
            scale * light.flicker,
            light.flicker_period_s,
            scale * light.wander,
            light.wander_period_s,
            0.0,
            1.0,
        ]
    )
    keys = np.array([process_key(seed, "lamp flicker"), process_key(seed, "lamp wander")], dtype=np.uint64)
    return constants, keys
