"""An axis on a TMCL module: angles in degrees, microsteps on the line."""

import math

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.drivers.errors import DeviceError, Interrupted, LimitError, Refused, Unreferenced
from goniotwin.drivers.motion.axis import AxisTiming, check_limits
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.stop import stop_all
from goniotwin.drivers.motion.tmcl.homing import HomingSearch
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.move import ARRIVED_AFTER_S, EXCHANGES_AT_END, EXCHANGES_BETWEEN_LEGS, Move
from goniotwin.drivers.motion.tmcl.reference import REMEDY, Reference
from goniotwin.drivers.motion.tmcl.registers import CONFIRMED_EXCHANGES, Registers, Switches
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter as Parameter
from goniotwin.protocols.tmcl_parameters import DriverFlag, ErrorFlag, SearchCommand

KEPT = (Parameter.MICROSTEP_RESOLUTION, Parameter.ENCODER_RESOLUTION, Parameter.STANDBY_CURRENT)
"""Parameters that `close` leaves as they are: the scales of the counters, and what holds the axis where it is."""
EXCHANGES_AT_START = 3
"""Number of exchanges of the start of a move: position, canary, target."""


class TmclAxis:
    """One motor of a motion module, as an angle.

    The axis is *referenced* while its counter is known to give its angle. It becomes unreferenced by a reset of its module,
    a stall, a deviation of the encoder, a limit switch, or a motion command of which the delivery is unknown. An
    unreferenced axis moves to no angle until it is homed or its position is set.
    """

    def __init__(self, name: str, module: TmclModule, settings: AxisSettings, clock: Clock) -> None:
        self._module = module
        self._clock = clock
        self.settings = settings
        self.name = name
        self.last_reference_deg: float | None = None
        self._registers = Registers(name, module, settings)
        self._reference = Reference(module, self._registers)
        self._taken_up = False
        self._searching = False

    # ---- reference ----

    @property
    def unreferenced_reason(self) -> str:
        """Why the axis is unreferenced; empty if it is referenced."""
        return self._reference.unreferenced_reason

    @property
    def referenced(self) -> bool:
        """True if the axis may move to an angle."""
        return not self.unreferenced_reason

    def set_position(self, angle_deg: float | None = None) -> None:
        """Set the current position of an axis at rest (manual referencing); None accepts its counter. Raises DeviceError."""
        if angle_deg is not None:
            self._check_finite(angle_deg, "set its position to")
            self._registers.set_counter(self.settings.counter(angle_deg))
        self._registers.check_canary()
        self._reference.mark_referenced()
        self._taken_up = False

    @property
    def errors(self) -> ErrorFlag:
        """Error flags of the module since connecting or homing, as far as they have been read."""
        return self._reference.errors

    def read_errors(self) -> ErrorFlag:
        """Read and latch the error flags; a stall or a deviation makes the axis unreferenced. Raises DeviceError."""
        return self._reference.read_errors()

    # ---- connection ----

    def connect(self) -> None:
        """Write the settings to the module. The axis does not move. Raises DeviceError."""
        parameters = self.parameters()
        self._registers.note([(each, value) for each, value in parameters if each not in KEPT])
        for parameter, value in parameters:
            self._registers.write(parameter, value)
        try:
            self._reference.errors |= self._registers.error_flags()  # reading clears them: another connection needs them too
        except (Refused, Interrupted):
            raise
        except DeviceError:
            self._reference.errors |= self._registers.error_flags()
        self._reference.restore(self._reference.errors)
        if self.settings.encoder and self.referenced and not self.is_moving():
            self._read_and_compare()
        self._reference.errors = ErrorFlag(0)
        self._taken_up = False

    def parameters(self) -> list[tuple[Parameter, int]]:
        """Axis parameters by the settings, in the order in which they are written."""
        settings, each = self.settings, abs(self.settings.microsteps_per_deg)
        deviation = settings.encoder_value(settings.max_deviation_deg * each)
        parameters = [
            (Parameter.UNIT_MODE, 1),
            (Parameter.MICROSTEP_RESOLUTION, settings.microstep_exponent),
            (Parameter.MAX_VELOCITY, settings.pps(settings.speed_deg_s)),
            (Parameter.MAX_ACCELERATION, settings.pps(settings.acceleration_deg_s2)),
            (Parameter.MAX_DECELERATION, settings.pps(settings.acceleration_deg_s2)),
            (Parameter.RUN_CURRENT, settings.run_current),
            (Parameter.STANDBY_CURRENT, settings.standby_current),
            (Parameter.POWER_DOWN_DELAY, max(1, round(settings.power_down_s * 100.0))),
            (Parameter.SWAP_SWITCHES, int(settings.swap_switches)),
            (Parameter.RIGHT_SWITCH_POLARITY, settings.right_polarity),
            (Parameter.LEFT_SWITCH_POLARITY, settings.left_polarity),
            (Parameter.SOFT_STOP, int(settings.soft_stop)),
            (Parameter.RIGHT_SWITCH_DISABLED, int(not settings.switches)),
            (Parameter.LEFT_SWITCH_DISABLED, int(not settings.switches)),
            (Parameter.STALL_VELOCITY, settings.pps(settings.stall_speed_deg_s)),
            (Parameter.RELATIVE_REFERENCE, 1),
        ]
        if settings.encoder:
            if settings.encoder_counts is not None:
                parameters.append((Parameter.ENCODER_RESOLUTION, settings.encoder_counts))
            parameters.append((Parameter.MAX_ENCODER_DEVIATION, deviation))
        if settings.homing is not None:
            parameters += [
                (Parameter.REFERENCE_SEARCH_MODE, settings.homing.mode),
                (Parameter.REFERENCE_SEARCH_SPEED, settings.pps(settings.homing.speed_deg_s)),
                (Parameter.REFERENCE_SWITCH_SPEED, settings.pps(settings.homing.switch_speed_deg_s)),
            ]
        return parameters

    # ---- motion ----

    def start(self, target_deg: float, stop_count: int | None = None) -> Move:
        """Start a move to an angle, unless a stop was requested after `stop_count` was read (default: now).

        Raises LimitError or Unreferenced before anything is sent, DeviceError after that.
        """
        self.check_limits(target_deg)
        if self.unreferenced_reason:
            raise Unreferenced(self.name, f"move to {target_deg:g} deg", self.unreferenced_reason, REMEDY)
        stop_count = self._registers.stop_count if stop_count is None else stop_count
        here = self._registers.read_confirmed(Parameter.ACTUAL_POSITION)
        legs = self.settings.legs(self.settings.angle_deg(here), target_deg, taken_up=self._taken_up)
        move = self._new_move(f"move to {target_deg:g} deg", legs, here, stop_count)
        move.begin()
        return move

    def start_relative(self, distance_deg: float) -> Move:
        """Start a turn by an angle, referenced or not. The command is never sent twice. Raises as `start` does."""
        self._check_finite(distance_deg, "turn by")
        stop_count = self._registers.stop_count
        here = self._registers.read_confirmed(Parameter.ACTUAL_POSITION)
        target_deg = self.settings.angle_deg(here) + distance_deg
        if self.referenced:
            self.check_limits(target_deg)
        move = self._new_move(f"turn by {distance_deg:g} deg", (target_deg,), here, stop_count)
        move.begin(relative=round(distance_deg * self.settings.microsteps_per_deg))
        return move

    def _new_move(self, doing: str, legs: tuple[float, ...], here: int, stop_count: int) -> Move:
        self._taken_up = False
        return Move(self._registers, self._reference, self._clock, doing, legs, here, stop_count, self._note_arrival)

    def _note_arrival(self) -> None:
        self._taken_up = True

    def start_homing(self) -> HomingSearch:
        """Start the reference search of the settings; at its end the axis is referenced. Raises DeviceError."""
        homing = self.settings.homing
        if homing is None:
            raise DeviceError(
                self.name, "home", "the rig file has no [homing] for it", "add [homing], or set its position (goniotwin here)"
            )
        stop_count = self._registers.stop_count
        self._registers.check_canary()
        self._reference.mark_unreferenced("its reference search has not ended")
        self._searching = True
        self._reference.send_motion_command(self._registers.request(Command.RFS, SearchCommand.START), stop_count)
        return HomingSearch(self._registers, self._reference, homing, self._clock, self._note_homed)

    def _note_homed(self, old_reference_deg: float) -> None:
        self._searching = False
        self._reference.mark_referenced()
        self.last_reference_deg = old_reference_deg
        self._reference.errors = ErrorFlag(0)
        self._taken_up = False

    def stop_requests(self) -> list[tuple[str, CommandFrame]]:
        """Requests that stop the axis over its ramp: MST, and the end of a reference search in progress."""
        searching = [(self.name, self._registers.request(Command.RFS, SearchCommand.STOP))] if self._searching else []
        return [(self.name, self._registers.request(Command.MST, 0)), *searching]

    def stop(self) -> None:
        """Stop the axis over its ramp. Thread-safe. Raises DeviceError if the module does not confirm it."""
        for failure in stop_all({self.name: self._module.begin_stop(self.stop_requests())}):
            raise failure

    def check_limits(self, target_deg: float) -> None:
        """Raise LimitError for a target outside the soft limits, the approach against backlash included."""
        check_limits(self.name, self.settings, target_deg)

    # ---- reading ----

    def position_deg(self) -> float:
        """Position by the motor's counter, confirmed by the canary. Raises DeviceError."""
        return self._registers.position_deg()

    def encoder_deg(self) -> float | None:
        """Position by the encoder, confirmed by the canary; None without one, or lost in a reset. Raises DeviceError."""
        encoder = self._registers.encoder_deg()
        return None if self._reference.encoder_lost else encoder

    def is_moving(self) -> bool:
        """True while the motor turns. Raises DeviceError."""
        return self._registers.read_confirmed(Parameter.ACTUAL_VELOCITY) != 0

    def deviation_deg(self) -> float | None:
        """Encoder minus counter; None where the encoder is. Raises DeviceError."""
        encoder = self.encoder_deg()
        return None if encoder is None else encoder - self.position_deg()

    def read_back(self) -> tuple[float, float | None]:
        """Counter and encoder of a referenced axis at rest. Raises DeviceError, Unreferenced included.

        If they disagree in two readings, the axis becomes unreferenced.
        """
        here, encoder = self._read_and_compare()
        if self.unreferenced_reason:
            raise Unreferenced(self.name, f"read back its position {here:.3f} deg", self.unreferenced_reason, REMEDY)
        return here, encoder

    def _read_and_compare(self) -> tuple[float, float | None]:
        here, encoder = self._registers.places_deg()
        if self._reference.encoder_disagrees(here, encoder):
            here, encoder = self.position_deg(), self.encoder_deg()
            self._reference.compare(here, encoder)
        return here, encoder

    def read_parameter(self, parameter: Parameter) -> int:
        """Value of an axis parameter. Raises DeviceError."""
        return self._registers.read(parameter)

    def switches(self) -> Switches:
        """Limit switches and home switch, as the module reads them. Raises DeviceError."""
        return self._registers.switches()

    def driver_flags(self) -> DriverFlag:
        """Status flags of the motor driver (*). Raises DeviceError."""
        return self._registers.driver_flags()

    def check_canary(self) -> None:
        """Raise Forgotten if the module has reset."""
        self._registers.check_canary()

    def set_currents(self, run: int, standby: int) -> None:
        """Set the motor current while moving and at rest, of 255, until the next connection. Raises DeviceError."""
        self._registers.note([(Parameter.RUN_CURRENT, run)])
        self._registers.write(Parameter.RUN_CURRENT, run)
        self._registers.write(Parameter.STANDBY_CURRENT, standby)

    def _check_finite(self, angle_deg: float, doing: str) -> None:
        if not math.isfinite(angle_deg) or not abs(self.settings.counter(angle_deg)) < 2**31:
            wrong, remedy = (
                "its counter cannot hold this angle",
                "choose another angle, or correct gear and zero in the rig file",
            )
            raise LimitError(self.name, f"{doing} {angle_deg:g} deg", wrong, remedy)


def axis_timing(settings: AxisSettings, exchange_s: float) -> AxisTiming:
    """The durations of the moves of a `TmclAxis` whose line takes `exchange_s` for an exchange."""

    def travel_seconds(start_deg: Floats, stop_deg: Floats) -> Floats:
        # The most probable unknown position is the origin of the counter.
        start_deg = np.where(np.isnan(start_deg), settings.zero_offset_deg, start_deg)
        if settings.approach == 0:
            return settings.ramp_seconds(stop_deg - start_deg) + ARRIVED_AFTER_S
        first_deg = settings.first_target_deg(start_deg, stop_deg)
        last = settings.ramp_seconds(stop_deg - first_deg) + ARRIVED_AFTER_S + EXCHANGES_BETWEEN_LEGS * exchange_s
        first = settings.ramp_seconds(first_deg - start_deg) + ARRIVED_AFTER_S
        return np.asarray(first + np.where(first_deg == stop_deg, 0.0, last))

    return AxisTiming(
        starting_s=EXCHANGES_AT_START * exchange_s,
        ending_s=EXCHANGES_AT_END * exchange_s,
        settling_s=settings.settling_s,
        read_back_s=CONFIRMED_EXCHANGES * (1 + settings.encoder) * exchange_s,
        approach=settings.approach,
        travel_seconds=travel_seconds,
    )
