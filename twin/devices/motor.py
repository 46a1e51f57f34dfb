"""One motor of a motion module: its axis parameters, its ramp, and the shaft that it turns."""

from collections.abc import Callable

from protocols.tmcl import Axis, Status
from twin.plant.motion import Trajectory, moving, resting, turning
from twin.plant.shaft import Shaft

MAX_VELOCITY_PPS = 7_999_774
MAX_MICROSTEP_EXPONENT = 8

# What a module has after power-on; the ranges are those of the manual's table of axis parameters.
DEFAULTS: dict[Axis, tuple[int, int, int]] = {
    # parameter: (value, lowest, highest)
    Axis.TARGET_VELOCITY: (0, -MAX_VELOCITY_PPS, MAX_VELOCITY_PPS),
    Axis.MAX_VELOCITY: (51_200, 1, MAX_VELOCITY_PPS),
    Axis.MAX_ACCELERATION: (51_200, 1, 2_147_418_111),
    Axis.MAX_DECELERATION: (51_200, 1, 2_147_418_111),
    Axis.RUN_CURRENT: (128, 0, 255),
    Axis.STANDBY_CURRENT: (8, 0, 255),
    Axis.RIGHT_SWITCH_DISABLED: (1, 0, 1),
    Axis.LEFT_SWITCH_DISABLED: (1, 0, 1),
    Axis.RELATIVE_REFERENCE: (0, 0, 2),
    Axis.MICROSTEP_RESOLUTION: (8, 0, MAX_MICROSTEP_EXPONENT),
    Axis.MAX_ENCODER_DEVIATION: (0, 0, 2**31 - 1),
    Axis.POWER_DOWN_DELAY: (200, 1, 65_535),
    Axis.UNIT_MODE: (0, 0, 1),
}
CHIP_UNITS_PPS = 16_000_000 / 2**24  # of velocities where UNIT_MODE is 0


class Rejected(Exception):
    """A request that the module refuses, with the status that says so."""

    def __init__(self, status: Status) -> None:
        super().__init__(status.name)
        self.status = status


class Motor:
    """A motor, its counter and its ramp generator. `shaft` is None where nothing is coupled to it.

    `encoder(t)` gives the encoder's reading in microsteps, None where the motor has no encoder.
    """

    def __init__(self, shaft: Shaft | None, encoder: Callable[[float], float] | None) -> None:
        self.shaft = shaft
        self._encoder = encoder
        self._encoder_offset = 0.0
        self._values = {axis: value for axis, (value, _, _) in DEFAULTS.items()}
        self._trajectory = resting(0.0)
        self._target = 0

    def position(self, t: float) -> float:
        """The counter, microsteps."""
        return self._trajectory.position(t)

    def get(self, number: int, t: float) -> int:
        """GAP. Raises Rejected for a parameter that is not there."""
        match number:
            case Axis.TARGET_POSITION:
                return self._target
            case Axis.ACTUAL_POSITION:
                return round(self._trajectory.position(t))
            case Axis.ACTUAL_VELOCITY:
                return round(self._trajectory.velocity(t) / self._unit())
            case Axis.POSITION_REACHED:
                return int(self._trajectory.end <= t and round(self._trajectory.position(t)) == self._target)
            case Axis.HOME_SWITCH | Axis.RIGHT_SWITCH | Axis.LEFT_SWITCH | Axis.ERROR_FLAGS:
                return 0
            case Axis.ENCODER_POSITION if self._encoder is not None:
                return round(self._encoder(t) + self._encoder_offset)
        return self._values[self._known(number)]

    def set(self, number: int, value: int, t: float) -> None:
        """SAP. Raises Rejected for a parameter that is not there or a value out of its range."""
        match number:
            case Axis.TARGET_POSITION:
                self.move_to(value, t)
                return
            case Axis.ACTUAL_POSITION:
                self._recount(value, t)
                self._target = value
                return
            case Axis.ENCODER_POSITION if self._encoder is not None:
                self._encoder_offset = value - self._encoder(t)
                return
        parameter = self._known(number)
        _, lowest, highest = DEFAULTS[parameter]
        if not lowest <= value <= highest:
            raise Rejected(Status.INVALID_VALUE)
        self._values[parameter] = value
        if parameter == Axis.MICROSTEP_RESOLUTION:
            self._recount(round(self._trajectory.position(t)), t)
        elif parameter == Axis.TARGET_VELOCITY:
            self.turn(value, t)

    def move_to(self, target: int, t: float) -> int:
        """MVP ABS: starts the ramp; returns the target."""
        self._target = target
        unit = self._unit()
        self._follow(
            moving(
                t,
                self._trajectory.position(t),
                self._trajectory.velocity(t),
                float(target),
                self._values[Axis.MAX_VELOCITY] * unit,
                self._values[Axis.MAX_ACCELERATION] * unit,
                self._values[Axis.MAX_DECELERATION] * unit,
            ),
            t,
        )
        return target

    def move_by(self, offset: int, t: float) -> int:
        """MVP REL: from the last target or from where it is, as RELATIVE_REFERENCE says; returns the target."""
        from_actual = self._values[Axis.RELATIVE_REFERENCE] == 1
        start = round(self._trajectory.position(t)) if from_actual else self._target
        return self.move_to(start + offset, t)

    def turn(self, velocity: int, t: float) -> None:
        """ROR and ROL (signed), and MST with 0: the target position stays what it was."""
        unit = self._unit()
        self._follow(
            turning(
                t,
                self._trajectory.position(t),
                self._trajectory.velocity(t),
                velocity * unit,
                self._values[Axis.MAX_ACCELERATION] * unit,
                self._values[Axis.MAX_DECELERATION] * unit,
            ),
            t,
        )

    def _follow(self, trajectory: Trajectory, t: float) -> None:
        self._trajectory = trajectory
        if self.shaft is not None:
            self.shaft.follow(t, trajectory)

    def _recount(self, position: int, t: float) -> None:
        per_full = 2 ** self._values[Axis.MICROSTEP_RESOLUTION]
        self._trajectory = (
            resting(float(position), t) if self.shaft is None else self.shaft.recount(t, float(position), per_full)
        )

    def _unit(self) -> float:
        return 1.0 if self._values[Axis.UNIT_MODE] == 1 else CHIP_UNITS_PPS

    def _known(self, number: int) -> Axis:
        try:
            parameter = Axis(number)
        except ValueError:
            raise Rejected(Status.WRONG_TYPE) from None
        if parameter not in self._values:
            raise Rejected(Status.WRONG_TYPE)
        return parameter
