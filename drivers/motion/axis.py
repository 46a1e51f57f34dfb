"""An axis of the goniophotometer: degrees above, microsteps on the wire."""

import math

from goniotwin.drivers.errors import DeviceError, Forgotten, Interrupted, LimitError, NoAnswer, Refused, Unreferenced
from goniotwin.drivers.motion.homing import HomingSearch
from goniotwin.drivers.motion.move import ARRIVED_AFTER_S as ARRIVED_AFTER_S
from goniotwin.drivers.motion.move import Move, Switches
from goniotwin.drivers.motion.reference import REMEDY, Reference
from goniotwin.drivers.motion.settings import AxisSettings as AxisSettings
from goniotwin.drivers.motion.settings import Homing as Homing
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Axis as Parameter
from goniotwin.protocols.tmcl import Command, MoveType, Request
from goniotwin.protocols.tmcl_parameters import DriverFlag, ErrorFlag, Search


class Axis:
    """One motor of a motion module, as an angle.

    It is *referenced* while nothing has put in doubt that the counter knows the angle: a reset of its module, a stall, a
    deviation of the encoder, a limit switch, or a move of which nobody knows whether it was heard. Unreferenced it goes to
    no angle, until it has been homed or somebody says where it is. `errors` are the module's error flags since connecting
    or homing: the module forgets them when they are read.
    """

    def __init__(self, module: TmclModule, settings: AxisSettings, clock: Clock) -> None:
        self._module = module
        self._clock = clock
        self.settings = settings
        self.name = settings.name
        self.errors = ErrorFlag(0)
        self.last_reference_deg: float | None = None
        self._reference = Reference(module, settings)
        self._taken_up = False
        self._searching = False
        self.alive_s = module.alive_s

    # ---- whether it knows where it is ----

    @property
    def doubt(self) -> str:
        """Why it is not known where the axis is; empty where it is."""
        return self._reference.doubt

    @property
    def referenced(self) -> bool:
        """Whether it may be sent to an angle."""
        return not self.doubt

    def put_in_doubt(self, reason: str) -> None:
        """From now on it is not known where the axis is."""
        self._reference.put_in_doubt(reason)

    def assume_referenced(self, angle_deg: float | None = None) -> None:
        """Somebody has looked: the axis rests at this angle, or (None) where its counter says. Raises DeviceError."""
        if angle_deg is not None:
            self._check_finite(angle_deg, "assume that it is at")
            self.count_from(self.settings.microsteps(angle_deg))
        self._module.check_canary(self.settings.module)
        self._reference.settle()
        self._taken_up = False

    def count_from(self, microsteps: int) -> None:
        """Sets counter and encoder; for an axis at rest (a moving one would go astray). Raises DeviceError."""
        if self.ask(Command.GAP, Parameter.ACTUAL_VELOCITY) != 0:
            raise DeviceError(self.name, "set its counter", "the axis is moving", "stop it first")
        self.ask(Command.SAP, Parameter.ACTUAL_POSITION, microsteps)
        if self.settings.encoder:
            self.ask(Command.SAP, Parameter.ENCODER_POSITION, self.settings.encoder_value(microsteps))

    # ---- the beginning ----

    def connect(self) -> None:
        """Writes the settings to the module; the axis stays where it is. Raises DeviceError."""
        settings, each = self.settings, abs(self.settings.microsteps_per_deg)
        deviation = settings.encoder_value(settings.max_deviation_deg * each)
        written = [
            (Parameter.UNIT_MODE, 1),
            (Parameter.MICROSTEP_RESOLUTION, settings.microstep_exponent),
            (Parameter.MAX_VELOCITY, settings.pps(settings.speed)),
            (Parameter.MAX_ACCELERATION, settings.pps(settings.acceleration)),
            (Parameter.MAX_DECELERATION, settings.pps(settings.acceleration)),
            (Parameter.RUN_CURRENT, settings.run_current),
            (Parameter.STANDBY_CURRENT, settings.standby_current),
            (Parameter.POWER_DOWN_DELAY, max(1, round(settings.power_down_s * 100.0))),
            (Parameter.SWAP_SWITCHES, int(settings.swap_switches)),
            (Parameter.RIGHT_SWITCH_POLARITY, settings.right_polarity),
            (Parameter.LEFT_SWITCH_POLARITY, settings.left_polarity),
            (Parameter.SOFT_STOP, int(settings.soft_stop)),
            (Parameter.RIGHT_SWITCH_DISABLED, int(not settings.switches)),
            (Parameter.LEFT_SWITCH_DISABLED, int(not settings.switches)),
            (Parameter.STALL_VELOCITY, settings.pps(settings.stall_speed)),
            (Parameter.RELATIVE_REFERENCE, 1),
        ]
        if settings.encoder:
            if settings.encoder_counts is not None:
                written.append((Parameter.ENCODER_RESOLUTION, settings.encoder_counts))
            written.append((Parameter.MAX_ENCODER_DEVIATION, deviation))
        if settings.homing is not None:
            written += [
                (Parameter.REFERENCE_SEARCH_MODE, settings.homing.mode),
                (Parameter.REFERENCE_SEARCH_SPEED, settings.pps(settings.homing.speed)),
                (Parameter.REFERENCE_SWITCH_SPEED, settings.pps(settings.homing.switch_speed)),
            ]
        for parameter, value in written:
            self.ask(Command.SAP, parameter, value)
        try:
            before = self.ask(Command.GAP, Parameter.ERROR_FLAGS)  # reading clears what was before
        except (Refused, Interrupted):
            raise
        except DeviceError:
            before = self.ask(Command.GAP, Parameter.ERROR_FLAGS)
        self._reference.connected(ErrorFlag(before & 3))
        if self.settings.encoder and not self.doubt and not self.turns():
            self._compared()
        self.errors = ErrorFlag(0)
        self._taken_up = False

    # ---- moving ----

    def start(self, target_deg: float, since: int | None = None) -> Move:
        """Sends the axis to an angle, unless a stop has come since the module's `stops` were `since` (by default: now).

        Raises LimitError or Unreferenced before anything is sent, DeviceError after.
        """
        self.check_limits(self.settings, target_deg)
        if self.doubt:
            raise Unreferenced(self.name, f"move to {target_deg:g} deg", self.doubt, REMEDY)
        stops = self._module.stops if since is None else since
        here = self.ask(Command.GAP, Parameter.ACTUAL_POSITION)
        self._module.check_canary(self.settings.module)
        legs = self.settings.legs(self.settings.angle_deg(here), target_deg, taken_up=self._taken_up)
        self._taken_up = False
        move = Move(self, self._clock, f"move to {target_deg:g} deg", legs, here, stops)
        move.begin()
        return move

    def start_by(self, way_deg: float) -> Move:
        """Turns the axis by an angle, referenced or not; the command is never sent twice. Raises as `start` does."""
        self._check_finite(way_deg, "turn by")
        stops = self._module.stops
        here = self.ask(Command.GAP, Parameter.ACTUAL_POSITION)
        self._module.check_canary(self.settings.module)
        target_deg = self.settings.angle_deg(here) + way_deg
        if self.referenced:
            self.check_limits(self.settings, target_deg)
        self._taken_up = False
        move = Move(self, self._clock, f"turn by {way_deg:g} deg", (target_deg,), here, stops)
        move.begin(relative=round(way_deg * self.settings.microsteps_per_deg))
        return move

    def start_homing(self) -> HomingSearch:
        """Begins the reference search of the settings; when it is done the axis is referenced. Raises DeviceError."""
        homing = self.settings.homing
        if homing is None:
            raise DeviceError(self.name, "home", "the rig file has no [homing] for it", "add it, or say where the axis is")
        stops = self._module.stops
        self._module.check_canary(self.settings.module)
        self.put_in_doubt("it is looking for its reference")
        self._searching = True
        self.command(Request(self.settings.module, Command.RFS, Search.START, self.settings.motor), stops)
        return HomingSearch(self, self._clock, homing, self._module.alive_s)

    def homed(self, reference_deg: float) -> None:
        """A search has ended well; by its old counter the reference was at `reference_deg`."""
        self._searching = False
        self._reference.settle()
        self.last_reference_deg = reference_deg
        self.errors = ErrorFlag(0)
        self._taken_up = False

    def arrived(self) -> None:
        """A move has ended where it was to."""
        self._taken_up = True

    def command(self, request: Request, since: int) -> int:
        """Something that sets it in motion, unless there has been a stop. Not knowing whether it was heard is doubt."""
        try:
            return self._module.exchange(request, since)
        except (Refused, Interrupted, Forgotten):
            raise
        except DeviceError as error:
            if self._module.stops != since:
                raise  # it was stopped after it, if it has heard it at all: the counter knows where
            self.put_in_doubt(f"nobody knows whether it heard a command to move ({error.happened})")
            raise

    def stop_requests(self) -> list[tuple[str, Request]]:
        """What brings it to rest over its ramp: the end of a search where one is going on, and MST."""
        module, motor = self.settings.module, self.settings.motor
        searching = [(self.name, Request(module, Command.RFS, Search.STOP, motor))] if self._searching else []
        return [(self.name, Request(module, Command.MST, 0, motor)), *searching]

    def stop(self) -> None:
        """Has the axis come to rest over its ramp. From any thread. Raises DeviceError where it is not confirmed."""
        for failure in self._module.stop(self.stop_requests()):
            raise failure

    @staticmethod
    def check_limits(settings: AxisSettings, target_deg: float) -> None:
        """Raises LimitError for an angle that an axis of these settings may not be sent to."""
        lower, upper = settings.lower_deg, settings.upper_deg
        remedy = "change the schedule, or the limits in the rig file"
        if not lower <= target_deg <= upper:
            raise LimitError(
                settings.name, f"move to {target_deg:g} deg", f"outside its soft limits {lower:g} to {upper:g} deg", remedy
            )
        begins = target_deg + settings.overshoot_deg
        if not lower <= begins <= upper:
            raise LimitError(
                settings.name, f"move to {target_deg:g} deg",
                f"against backlash it arrives from {settings.approach_from}, begins that at {begins:g} deg, and has soft "
                f"limits of {lower:g} to {upper:g} deg", remedy,
            )  # fmt: skip

    # ---- asking ----

    def position_deg(self) -> float:
        """Where the motor's counter says that the axis is; the module is known to have its settings. Raises DeviceError."""
        return self.settings.angle_deg(self._confirmed(Parameter.ACTUAL_POSITION))

    def turns(self) -> bool:
        """Whether the motor turns. Raises DeviceError."""
        return self._confirmed(Parameter.ACTUAL_VELOCITY) != 0

    def encoder_deg(self) -> float | None:
        """Where the encoder says that the axis is; None where it has none."""
        if not self.settings.encoder:
            return None
        return self.settings.encoder_angle_deg(self._confirmed(Parameter.ENCODER_POSITION))

    def deviation_deg(self) -> float | None:
        """By how much the encoder is ahead of the counter; None where there is no encoder."""
        encoder = self.encoder_deg()
        return None if encoder is None else encoder - self.position_deg()

    def read_back(self) -> tuple[float, float | None]:
        """Counter and encoder of an axis at rest, of which nobody doubts where it is. Raises DeviceError.

        Where they disagree, asked twice, it is unreferenced from then on."""
        here, encoder = self._compared()
        if self.doubt:
            raise Unreferenced(self.name, f"believe that it is at {here:.3f} deg", self.doubt, REMEDY)
        return here, encoder

    def _compared(self) -> tuple[float, float | None]:
        here, encoder = self.position_deg(), self.encoder_deg()
        if self._reference.apart(here, encoder):
            here, encoder = self.position_deg(), self.encoder_deg()
            self._reference.compare(here, encoder)
        return here, encoder

    def switches(self) -> Switches:
        """The limit switches and the home switch, as the module sees them."""
        right, left, home = (
            bool(self.ask(Command.GAP, each)) for each in (Parameter.RIGHT_SWITCH, Parameter.LEFT_SWITCH, Parameter.HOME_SWITCH)
        )
        return Switches(right, left, home)

    def read_errors(self) -> ErrorFlag:
        """Reads the error flags and latches them; a stall or a deviation leaves the axis unreferenced. Raises DeviceError."""
        try:
            self.errors |= ErrorFlag(self.ask(Command.GAP, Parameter.ERROR_FLAGS) & 3)
        except NoAnswer:
            self.put_in_doubt("its error flags were lost on the way")
            raise
        if self.errors:
            self.put_in_doubt(" and ".join(flag.name or "" for flag in self.errors).lower() + " has stopped it")
        return self.errors

    def driver_flags(self) -> DriverFlag:
        """What the motor's driver says of itself (*)."""
        return DriverFlag(self.ask(Command.GAP, Parameter.DRIVER_FLAGS) & 0xFF)

    def check_canary(self) -> None:
        """Raises Forgotten where its module has reset."""
        self._module.check_canary(self.settings.module)

    def set_currents(self, run: int, standby: int) -> None:
        """Of 255: turning, and at rest. Until the next connection."""
        self.ask(Command.SAP, Parameter.RUN_CURRENT, run)
        self.ask(Command.SAP, Parameter.STANDBY_CURRENT, standby)

    def ask(self, command: Command, number: int, value: int = 0) -> int:
        """One exchange about this axis."""
        return self._module.exchange(Request(self.settings.module, command, number, self.settings.motor, value))

    def move_request(self, kind: MoveType, value: int) -> Request:
        """MVP."""
        return Request(self.settings.module, Command.MVP, kind, self.settings.motor, value)

    def _confirmed(self, parameter: Parameter) -> int:
        return self._module.confirmed(Request(self.settings.module, Command.GAP, parameter, self.settings.motor))

    def _check_finite(self, angle_deg: float, doing: str) -> None:
        if not math.isfinite(angle_deg) or not abs(self.settings.microsteps(angle_deg)) < 2**31:
            raise LimitError(self.name, f"{doing} {angle_deg:g} deg", "that is no angle its counter can hold")
