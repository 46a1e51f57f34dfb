"""An axis of the goniophotometer: degrees above, microsteps on the wire."""

from dataclasses import dataclass

from drivers.errors import DeviceError, LimitError
from drivers.pending import Pending, Poll
from drivers.ramp import move_seconds
from drivers.tmcl import TmclModule
from protocols.clock import Clock
from protocols.tmcl import Axis as Parameter
from protocols.tmcl import Command, MoveType, Request

POLL_S = 0.02
GRACE_S = 1.0
ARRIVED_AFTER_S = 0.002


@dataclass(frozen=True)
class AxisSettings:
    """What the operator believes of an axis. `module` and `motor` say where it is wired.

    `sense` is +1 where positive microsteps turn the axis to greater angles, else -1; microsteps 0 are at
    `zero_offset_deg`. Speeds in deg/s, accelerations in deg/s^2.
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
    settling_s: float = 0.1
    encoder: bool = True

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

    def seconds(self, way_deg: float) -> float:
        """How long a move over `way_deg` takes, without settling."""
        return move_seconds(way_deg, self.speed, self.acceleration)


class Axis:
    """One motor of a motion module, as an angle."""

    def __init__(self, module: TmclModule, settings: AxisSettings, clock: Clock) -> None:
        self._module = module
        self._clock = clock
        self.settings = settings
        self.name = settings.name

    def connect(self) -> None:
        """Writes the settings to the module; the axis stays where it is. Raises DeviceError."""
        each = abs(self.settings.microsteps_per_deg)
        for parameter, value in (
            (Parameter.UNIT_MODE, 1),
            (Parameter.MICROSTEP_RESOLUTION, self.settings.microstep_exponent),
            (Parameter.MAX_VELOCITY, round(self.settings.speed * each)),
            (Parameter.MAX_ACCELERATION, round(self.settings.acceleration * each)),
            (Parameter.MAX_DECELERATION, round(self.settings.acceleration * each)),
            (Parameter.RUN_CURRENT, self.settings.run_current),
            (Parameter.STANDBY_CURRENT, self.settings.standby_current),
        ):
            self._ask(Command.SAP, parameter, value)
        self._ask(Command.GAP, Parameter.ERROR_FLAGS)  # reading clears what was before

    def start(self, target_deg: float) -> Pending:
        """Sends the axis to an angle. Raises LimitError before anything is sent, DeviceError after."""
        self.check_limits(self.settings, target_deg)
        target = self.settings.microsteps(target_deg)
        here = self._ask(Command.GAP, Parameter.ACTUAL_POSITION)
        self._ask(Command.MVP, MoveType.ABSOLUTE, target)
        ramp = self.settings.seconds((target - here) / self.settings.microsteps_per_deg)
        arrival = self._clock.now() + ramp + ARRIVED_AFTER_S
        return Poll(self._clock, arrival, POLL_S, lambda: self._arrived(target_deg, arrival + GRACE_S))

    @staticmethod
    def check_limits(settings: AxisSettings, target_deg: float) -> None:
        """Raises LimitError for an angle that an axis of these settings may not be sent to."""
        lower, upper = settings.lower_deg, settings.upper_deg
        if not lower <= target_deg <= upper:
            raise LimitError(
                settings.name, f"move to {target_deg:g} deg", f"outside its soft limits {lower:g} to {upper:g} deg",
                "change the schedule, or the limits in the rig file",
            )  # fmt: skip

    def position_deg(self) -> float:
        """Where the motor's counter says that the axis is."""
        return self.settings.angle_deg(self._ask(Command.GAP, Parameter.ACTUAL_POSITION))

    def encoder_deg(self) -> float | None:
        """Where the encoder says that the axis is; None where it has none."""
        if not self.settings.encoder:
            return None
        microsteps = self._ask(Command.GAP, Parameter.ENCODER_POSITION)
        return self.settings.angle_deg(microsteps * (1 << self.settings.microstep_exponent) / 256)

    def stop(self) -> None:
        """Has the axis come to rest over its ramp. From any thread."""
        self._ask(Command.MST, 0)

    def _arrived(self, target_deg: float, deadline: float) -> bool:
        if self._ask(Command.GAP, Parameter.POSITION_REACHED):
            return True
        if self._clock.now() > deadline and self._ask(Command.GAP, Parameter.ACTUAL_VELOCITY) == 0:
            raise DeviceError(
                self.name, f"move to {target_deg:g} deg", f"the axis stands at {self.position_deg():.3f} deg",
                "look for a limit switch, a stall or somebody's stop",
            )  # fmt: skip
        return False

    def _ask(self, command: Command, number: int, value: int = 0) -> int:
        return self._module.exchange(Request(self.settings.module, command, number, self.settings.motor, value))
