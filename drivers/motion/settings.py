"""Settings of an axis in degrees, their values in microsteps, and the durations of its moves."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Annotated, Literal

import numpy as np
from annotated_types import Ge, Le

from goniotwin.arrays import Floats
from goniotwin.keys import Address, Count, MotorNumber, NonNegative, Positive

WHOLE_TURN_DEG = 360.0
OVERSHOOT = 2.0
"""Overshoot of a move against backlash, as a multiple of the stated backlash."""
ENCODER_TOLERANCE_DEG = 0.05
SEARCH_MODES = (*range(1, 9), *range(65, 69), *range(133, 137))
MOVES_KEPT = 1024
ENCODER_MICROSTEPS = 256
"""Microsteps per full step in the encoder position of a module (*)."""


def move_seconds(distance: Floats | float, speed: float, acceleration: float, deceleration: float | None = None) -> Floats:
    """Seconds (n,) from rest to rest over distances (n,) of any sign with the trapezoidal ramp of motion controllers.

    Distance, speed and accelerations have consistent units.
    """
    distance = np.abs(distance)
    down = acceleration if deceleration is None else deceleration
    ramps = 0.5 * speed * speed * (1.0 / acceleration + 1.0 / down)
    peak = np.where(distance >= ramps, speed, np.sqrt(2.0 * distance * acceleration * down / (acceleration + down)))
    rising = peak / acceleration
    falling = rising if deceleration is None else peak / down
    return np.asarray(rising + falling + np.maximum(distance - ramps, 0.0) / speed)


@dataclass(frozen=True)
class Homing:
    """The reference search of an axis.

    `mode`: number of the search in Trinamic's manuals: 1 to 8, or one of 1 to 4 plus 64, or one of 5 to 8 plus 128.
    `speed_deg_s`: speed of the search. `switch_speed_deg_s`: speed at which the switch is then found. `angle_deg`: angle of the
    axis at the reference; without it the angle at microstep 0. `longest_s`: longest duration of the search; after it the search
    has failed.

    Raises ValueError for an unknown mode.
    """

    mode: int
    speed_deg_s: Positive
    switch_speed_deg_s: Positive
    angle_deg: float | None = None
    longest_s: Positive = 180.0

    def __post_init__(self) -> None:
        if self.mode not in SEARCH_MODES:
            raise ValueError(
                f"mode: {self.mode} is not a reference search; give 1 to 8, 65 to 68 (64 added) or 133 to 136 (128 added)"
            )


@dataclass(frozen=True)
class AxisSettings:
    """The nominal properties of an axis.

    `motor`: number of the motor on its module. `gear`: motor turns per turn of the axis. `lower_deg`: lower soft limit.
    `upper_deg`: upper soft limit. `speed_deg_s`: greatest speed of a move. `acceleration_deg_s2`: acceleration and deceleration
    of a move. `sense`: +1 if positive microsteps turn the axis to greater angles, else -1. `zero_offset_deg`: angle of the axis
    at microstep 0. `module`: address of the motor's module.

    `full_steps`: full steps in a turn of the motor. `microsteps`: microsteps in a full step. `run_current`: current of the
    moving motor; 255 is the largest that the module gives. `standby_current`: current of the motor at rest; 255 is the largest
    as well. `power_down_s`: time at rest after which the motor has the standby current. `settling_s`: time after a move until
    the axis rests.

    `encoder`: whether the position is read back from an encoder. `encoder_counts`: encoder counts in a turn of the motor, which
    are written to the module. Without it the module keeps its own number. `max_deviation_deg`: deviation of encoder and counter
    at which the module stops the motor; 0 is off. `stall_speed_deg_s`: speed above which the module stops the motor if it
    stalls; 0 is off.

    `switches`: whether the limit switches stop the motor. `swap_switches`: whether left and right limit switch are exchanged.
    `right_polarity`: polarity of the right limit switch; 1 inverts it. `left_polarity`: polarity of the left limit switch; 1
    inverts it. `soft_stop`: whether a limit switch stops the motor with a ramp.

    `backlash_deg`: play of the gear. With it every move arrives from one side, if necessary after an overshoot.
    `approach_from`: side from which every move arrives if there is backlash. The zero offset holds for it. `homing_required`:
    whether the axis is unreferenced from each connection until it is homed. `power_up_at_reference`: whether the axis is at
    microstep 0 after power-up or a reset of the controller, kept there by a parking position or a brake. Otherwise it is then
    unreferenced, and does not move until it is homed or its position is set. `encoder_tolerance_deg`: largest difference of
    counter and encoder at rest; 0 is off. By default it is 0.05 deg plus the backlash.

    Raises ValueError for limits that are not in order, and for two contradicting references.
    """

    motor: MotorNumber
    gear: Positive
    lower_deg: float
    upper_deg: float
    speed_deg_s: Positive
    acceleration_deg_s2: Positive
    sense: Literal[1, -1] = 1
    zero_offset_deg: float = 0.0
    module: Address = 1
    full_steps: Count = 200
    microsteps: Literal[1, 2, 4, 8, 16, 32, 64, 128, 256] = 256
    run_current: Annotated[int, Ge(0), Le(255)] = 128
    standby_current: Annotated[int, Ge(0), Le(255)] = 8
    power_down_s: Annotated[float, Ge(0.01), Le(655.0)] = 2.0
    settling_s: Annotated[float, Ge(0.0), Le(600.0)] = 0.1
    encoder: bool = True
    encoder_counts: Count | None = None
    max_deviation_deg: NonNegative = 0.0
    stall_speed_deg_s: NonNegative = 0.0
    switches: bool = False
    swap_switches: bool = False
    right_polarity: Literal[0, 1] = 0
    left_polarity: Literal[0, 1] = 0
    soft_stop: bool = False
    backlash_deg: NonNegative = 0.0
    approach_from: Literal["below", "above"] = "below"
    homing: Homing | None = None
    homing_required: bool = False
    power_up_at_reference: bool = False
    encoder_tolerance_deg: NonNegative | None = None

    def __post_init__(self) -> None:
        if not self.lower_deg < self.upper_deg:
            raise ValueError(f"lower_deg {self.lower_deg:g} is not below upper_deg {self.upper_deg:g}; exchange them")
        if self.homing_required and self.power_up_at_reference:
            raise ValueError("homing_required and power_up_at_reference contradict each other; remove one")

    @property
    def microstep_exponent(self) -> int:
        """Binary logarithm of `microsteps`, as a module wants it."""
        return self.microsteps.bit_length() - 1

    @cached_property
    def microsteps_per_deg(self) -> float:
        """Microsteps per degree, signed by `sense`."""
        return self.sense * self.full_steps * float(self.microsteps) * self.gear / WHOLE_TURN_DEG

    def counter(self, angle_deg: float) -> int:
        """Counter at an angle, to the nearest microstep."""
        return round((angle_deg - self.zero_offset_deg) * self.microsteps_per_deg)

    def angle_deg(self, microsteps: float) -> float:
        """Angle at a counter value."""
        return self.zero_offset_deg + microsteps / self.microsteps_per_deg

    def encoder_angle_deg(self, value: float) -> float:
        """Angle at an encoder value."""
        return self.angle_deg(value * self.microsteps / ENCODER_MICROSTEPS)

    def encoder_value(self, microsteps: float) -> int:
        """Encoder value at a counter value."""
        return round(microsteps * ENCODER_MICROSTEPS / self.microsteps)

    def pps(self, speed: float) -> int:
        """Microsteps per s (or s^2) of deg/s (or deg/s^2); at least 1 unless it is 0."""
        return 0 if speed == 0.0 else max(1, round(speed * abs(self.microsteps_per_deg)))

    @property
    def tolerance_deg(self) -> float:
        """Largest difference of counter and encoder at rest; by default 0.05 deg plus the backlash."""
        given = self.encoder_tolerance_deg
        return ENCODER_TOLERANCE_DEG + self.backlash_deg if given is None else given

    @property
    def approach(self) -> int:
        """Direction of the last leg of each move, +1 or -1, against backlash; 0 without backlash."""
        return 0 if self.backlash_deg == 0.0 else 1 if self.approach_from == "below" else -1

    @property
    def overshoot_deg(self) -> float:
        """Signed distance from a target to the start of its approach; 0 without backlash."""
        return -self.approach * OVERSHOOT * self.backlash_deg

    def first_target_deg(self, here_deg: Floats | float, target_deg: Floats | float, *, taken_up: bool = True) -> Floats:
        """Target (n,) of the first leg of moves (n,): beyond the target where the last leg has to come from its other side.

        `taken_up`: the backlash is taken up, by a last move in the direction of approach.
        """
        direct = (target_deg - here_deg) * self.approach >= (0.0 if taken_up else self.backlash_deg)
        return np.where(direct, target_deg, target_deg + self.overshoot_deg)

    def legs(self, here_deg: float, target_deg: float, *, taken_up: bool = True) -> tuple[float, ...]:
        """Targets of the legs of a move."""
        if self.approach == 0:
            return (target_deg,)
        first_deg = float(self.first_target_deg(here_deg, target_deg, taken_up=taken_up))
        return (target_deg,) if first_deg == target_deg else (first_deg, target_deg)

    def ramp_seconds(self, distance_deg: Floats | float) -> Floats:
        """Seconds (n,) of moves over distances (n,), without communication and settling."""
        return move_seconds(distance_deg, self.speed_deg_s, self.acceleration_deg_s2)

    def ramp_s(self, microsteps: int) -> float:
        """`ramp_seconds` of one move, by its microsteps."""
        return _one_move_s(microsteps / self.microsteps_per_deg, self.speed_deg_s, self.acceleration_deg_s2)


@lru_cache(maxsize=MOVES_KEPT)
def _one_move_s(distance: float, speed: float, acceleration: float) -> float:
    """`move_seconds` of one move: a scan has the same again and again."""
    return float(move_seconds(distance, speed, acceleration))
