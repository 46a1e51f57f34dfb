"""Settings of an axis in degrees, their values in microsteps, and the durations of its moves."""

import math
from dataclasses import dataclass
from typing import Literal

OVERSHOOT = 2.0
"""Overshoot of a move against backlash, as a multiple of the stated backlash."""
ENCODER_TOLERANCE_DEG = 0.05
ENCODER_MICROSTEPS = 256
"""Microsteps per full step in the encoder position of a module (*)."""


def move_seconds(distance: float, speed: float, acceleration: float, deceleration: float | None = None) -> float:
    """Seconds from rest to rest over `distance` (any sign) with the trapezoidal ramp of motion controllers.

    Distance, speed and accelerations have consistent units.
    """
    distance = abs(distance)
    down = acceleration if deceleration is None else deceleration
    ramps = 0.5 * speed * speed * (1.0 / acceleration + 1.0 / down)
    if distance >= ramps:
        return speed / acceleration + speed / down + (distance - ramps) / speed
    peak = math.sqrt(2.0 * distance * acceleration * down / (acceleration + down))
    return peak / acceleration + peak / down


@dataclass(frozen=True)
class Homing:
    """A reference search: its mode (TMCL axis parameter 193), its speeds in deg/s, and the angle of the reference.

    Without `angle_deg` the reference is at microsteps 0.
    """

    mode: int
    speed: float
    switch_speed: float
    angle_deg: float | None = None
    longest_s: float = 180.0


@dataclass(frozen=True)
class AxisSettings:
    """An axis, as configured by the operator. `module` and `motor` are its address.

    `sense` is +1 if positive microsteps turn the axis to greater angles, else -1; microsteps 0 are at `zero_offset_deg`.
    Speeds in deg/s, accelerations in deg/s^2. With `backlash_deg` every move arrives from `approach_from`, if necessary
    after an overshoot. The motor is stopped by its limit switches (`switches`), by an encoder that deviates from the counter
    by more than `max_deviation_deg` (0: never), and by a stall above `stall_speed` in deg/s (0: never). `encoder_counts`
    per turn of the motor are written to the module if given (*).
    After a power-up of its module the axis is unreferenced until it is homed or its position is set. With
    `power_up_at_reference` it is referenced: it is always parked at microsteps 0 when the module is switched on;
    `homing_required` overrides this. `encoder_tolerance_deg` is the largest difference of counter and encoder at rest
    (0: unlimited; None: 0.05 deg plus the backlash).
    """

    name: str
    motor: int
    gear: float
    lower_deg: float
    upper_deg: float
    speed: float
    acceleration: float
    sense: int = 1
    zero_offset_deg: float = 0.0
    module: int = 1
    full_steps: int = 200
    microstep_exponent: int = 8
    run_current: int = 128
    standby_current: int = 8
    power_down_s: float = 2.0
    settling_s: float = 0.1
    encoder: bool = True
    encoder_counts: int | None = None
    max_deviation_deg: float = 0.0
    stall_speed: float = 0.0
    switches: bool = False
    swap_switches: bool = False
    right_polarity: int = 0
    left_polarity: int = 0
    soft_stop: bool = False
    backlash_deg: float = 0.0
    approach_from: Literal["below", "above"] = "below"
    homing: Homing | None = None
    homing_required: bool = False
    power_up_at_reference: bool = False
    encoder_tolerance_deg: float | None = None

    @property
    def microsteps_per_deg(self) -> float:
        """Microsteps per degree, signed by `sense`."""
        return self.sense * self.full_steps * float(1 << self.microstep_exponent) * self.gear / 360.0

    def microsteps(self, angle_deg: float) -> int:
        """Counter at an angle, to the nearest microstep."""
        return round((angle_deg - self.zero_offset_deg) * self.microsteps_per_deg)

    def angle_deg(self, microsteps: float) -> float:
        """Angle at a counter value."""
        return self.zero_offset_deg + microsteps / self.microsteps_per_deg

    def encoder_angle_deg(self, value: float) -> float:
        """Angle at an encoder value."""
        return self.angle_deg(value * (1 << self.microstep_exponent) / ENCODER_MICROSTEPS)

    def encoder_value(self, microsteps: float) -> int:
        """Encoder value at a counter value."""
        return round(microsteps * ENCODER_MICROSTEPS / (1 << self.microstep_exponent))

    def pps(self, speed: float) -> int:
        """Microsteps per s (or s^2) of deg/s (or deg/s^2); at least 1 unless it is 0."""
        return 0 if speed == 0.0 else max(1, round(speed * abs(self.microsteps_per_deg)))

    @property
    def tolerance_deg(self) -> float:
        """Largest difference of counter and encoder at rest; by default 0.05 deg plus the backlash."""
        given = self.encoder_tolerance_deg
        return ENCODER_TOLERANCE_DEG + self.backlash_deg if given is None else given

    @property
    def overshoot_deg(self) -> float:
        """Signed distance from a target to the start of its approach; 0 without backlash."""
        overshoot = OVERSHOOT * self.backlash_deg
        return -overshoot if self.approach_from == "below" else overshoot

    def legs(self, here_deg: float, target_deg: float, *, taken_up: bool = True) -> tuple[float, ...]:
        """Targets of the legs of a move; `taken_up`: the backlash is taken up, by a last move from the approach side."""
        if self.backlash_deg == 0.0:
            return (target_deg,)
        distance = (target_deg - here_deg) * (1.0 if self.approach_from == "below" else -1.0)
        if distance >= (0.0 if taken_up else self.backlash_deg):
            return (target_deg,)
        return (target_deg + self.overshoot_deg, target_deg)

    def seconds(self, distance_deg: float) -> float:
        """Duration of a move without settling, s."""
        return move_seconds(distance_deg, self.speed, self.acceleration)

    def seconds_between(self, here_deg: float, target_deg: float, *, taken_up: bool = True) -> float:
        """Duration of all legs of a move without settling and communication, s."""
        seconds, place = 0.0, here_deg
        for leg in self.legs(here_deg, target_deg, taken_up=taken_up):
            seconds += self.seconds(leg - place)
            place = leg
        return seconds
