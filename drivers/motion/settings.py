"""What the operator believes of an axis, in degrees, and what follows from it in microsteps.

How long a stepper axis takes for a way: the trapezoid that motion controllers drive.
"""

import math
from dataclasses import dataclass
from typing import Literal


def move_seconds(way: float, speed: float, acceleration: float, deceleration: float | None = None) -> float:
    """Seconds from rest to rest over `way` (any sign); the units of way, speed and accelerations belong together."""
    distance = abs(way)
    down = acceleration if deceleration is None else deceleration
    ramps = 0.5 * speed * speed * (1.0 / acceleration + 1.0 / down)
    if distance >= ramps:
        return speed / acceleration + speed / down + (distance - ramps) / speed
    peak = math.sqrt(2.0 * distance * acceleration * down / (acceleration + down))
    return peak / acceleration + peak / down


OVERSHOOT = 2.0
"""By how many times the believed backlash a move goes too far, to come back from the side that it has to arrive from."""

ENCODER_TOLERANCE_DEG = 0.05

ENCODER_MICROSTEPS = 256
"""Microsteps of a full step in which a module gives the encoder's position (*)."""


@dataclass(frozen=True)
class Homing:
    """A reference search: its mode (TMCL axis parameter 193), its speeds in deg/s, and the angle of the reference.

    Without `angle_deg` the reference is where the axis' microsteps are 0.
    """

    mode: int
    speed: float
    switch_speed: float
    angle_deg: float | None = None
    longest_s: float = 180.0


@dataclass(frozen=True)
class AxisSettings:
    """What the operator believes of an axis. `module` and `motor` say where it is wired.

    `sense` is +1 where positive microsteps turn the axis to greater angles, else -1; microsteps 0 are at
    `zero_offset_deg`. Speeds in deg/s, accelerations in deg/s^2. With `backlash_deg` every move arrives from
    `approach_from`, if need be after going too far. `switches` has the limit switches stop the motor, `max_deviation_deg`
    an encoder that says something else than the counter (0: never), `stall_speed` (deg/s) a stall above it (0: never).
    `encoder_counts` a turn of the motor are told to the module where they are given (*).
    After a power-up of its module the axis goes to no angle before it has been homed, or somebody has said where it is;
    but with `power_up_at_reference` it is parked where its microsteps are 0 whenever that is switched on, unless
    `homing_required`. `encoder_tolerance_deg`: how far counter and encoder of an axis at rest may be apart (0: any way).
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
        """Signed."""
        return self.sense * self.full_steps * float(1 << self.microstep_exponent) * self.gear / 360.0

    def microsteps(self, angle_deg: float) -> int:
        """The counter at an angle, to the nearest microstep."""
        return round((angle_deg - self.zero_offset_deg) * self.microsteps_per_deg)

    def angle_deg(self, microsteps: float) -> float:
        """The angle at a counter's value."""
        return self.zero_offset_deg + microsteps / self.microsteps_per_deg

    def encoder_angle_deg(self, value: float) -> float:
        """The angle at an encoder's value."""
        return self.angle_deg(value * (1 << self.microstep_exponent) / ENCODER_MICROSTEPS)

    def encoder_value(self, microsteps: float) -> int:
        """What the encoder has to say where the counter says `microsteps`."""
        return round(microsteps * ENCODER_MICROSTEPS / (1 << self.microstep_exponent))

    def pps(self, speed: float) -> int:
        """Microsteps a second (or a second squared) of deg/s; at least 1 where it is not 0."""
        return 0 if speed == 0.0 else max(1, round(speed * abs(self.microsteps_per_deg)))

    @property
    def tolerance_deg(self) -> float:
        """Between counter and encoder, at rest; where nobody has said it 0.05 deg and the backlash."""
        given = self.encoder_tolerance_deg
        return ENCODER_TOLERANCE_DEG + self.backlash_deg if given is None else given

    @property
    def overshoot_deg(self) -> float:
        """Signed: from a target to where its approach begins; 0 without backlash."""
        far = OVERSHOOT * self.backlash_deg
        return -far if self.approach_from == "below" else far

    def legs(self, here_deg: float, target_deg: float, *, taken_up: bool = True) -> tuple[float, ...]:
        """The angles that a move goes to one after the other; `taken_up`: the axis has arrived from the right side last."""
        if self.backlash_deg == 0.0:
            return (target_deg,)
        way = (target_deg - here_deg) * (1.0 if self.approach_from == "below" else -1.0)
        if way >= (0.0 if taken_up else self.backlash_deg):
            return (target_deg,)
        return (target_deg + self.overshoot_deg, target_deg)

    def seconds(self, way_deg: float) -> float:
        """How long a move over `way_deg` takes, without settling."""
        return move_seconds(way_deg, self.speed, self.acceleration)

    def seconds_between(self, here_deg: float, target_deg: float, *, taken_up: bool = True) -> float:
        """How long all legs of a move take, without settling and without the words on the wire."""
        seconds, place = 0.0, here_deg
        for leg in self.legs(here_deg, target_deg, taken_up=taken_up):
            seconds += self.seconds(leg - place)
            place = leg
        return seconds
