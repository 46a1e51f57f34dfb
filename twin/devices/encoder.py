"""An incremental encoder on an axis: its counts are the axis' angle, its eccentricity and its noise, in whole counts."""

import math
from typing import TYPE_CHECKING

import numpy as np

from goniotwin.twin import plant
from goniotwin.twin.plant.process_key import process_key

if TYPE_CHECKING:
    from goniotwin.twin.plant import Plant

PERIOD_S = 1.0e-3
MICROSTEPS = 256
"""Microsteps of a full step in which the module gives the encoder's position (*)."""


class Encoder:
    """The encoder of one axis, with a noise in microsteps.

    `resolution` is what the module believes of its counts a turn of the motor.
    """

    def __init__(self, plant: "Plant", axis: str, noise: float) -> None:
        self._shaft = plant.shafts[axis]
        self._noise = noise if plant.model.noise else 0.0
        self._key = process_key(plant.model.seed, f"encoder {axis}")

    def steady(self, angle_deg: float, resolution: int) -> float:
        """Ideal reading at an angle without noise and rounding, in the module's microsteps."""
        mechanics = self._shaft.mechanics
        error = mechanics.encoder_error_deg * math.sin(math.radians(angle_deg))
        full_steps = (angle_deg + error - mechanics.zero_deg) / mechanics.deg_per_full_step
        return full_steps * MICROSTEPS * self._scale(resolution)

    def read(self, t: float, resolution: int) -> float:
        """Reading at `t`: whole counts, converted into the module's microsteps."""
        mechanics = self._shaft.mechanics
        scale = self._scale(resolution)
        microsteps = self.steady(self._shaft.angle_deg(t), resolution) / scale
        if self._noise:
            microsteps += self._noise * plant.normal(self._key, np.int64(math.floor(t / PERIOD_S)))
        a_count = mechanics.full_steps * MICROSTEPS / mechanics.encoder_counts
        return round(microsteps / a_count) * a_count * scale

    def _scale(self, resolution: int) -> float:
        return self._shaft.mechanics.encoder_counts / resolution
