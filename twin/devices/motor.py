"""One motor of a motion module: its axis parameters and commands."""

from goniotwin.protocols.tmcl import ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter, DriverFlag, ErrorFlag
from goniotwin.twin.devices import reference_search
from goniotwin.twin.devices.axis_table import COMPUTED, Parameter
from goniotwin.twin.devices.encoder import Encoder
from goniotwin.twin.devices.ramp_generator import CommandRejected, RampGenerator, signed
from goniotwin.twin.devices.switches import Place
from goniotwin.twin.plant.motion import ramp_to_velocity
from goniotwin.twin.plant.shaft import Heartbeat, Shaft

ACTUAL_POSITION, ENCODER_POSITION = int(AxisParameter.ACTUAL_POSITION), int(AxisParameter.ENCODER_POSITION)
UNLOADED = 512
POWER_DOWN_UNIT_S = 0.01
REPLANNED = frozenset(
    {
        AxisParameter.MAX_VELOCITY,
        AxisParameter.MAX_ACCELERATION,
        AxisParameter.MAX_DECELERATION,
        AxisParameter.RIGHT_SWITCH_DISABLED,
        AxisParameter.SWAP_SWITCHES,
        AxisParameter.LEFT_SWITCH_DISABLED,
        AxisParameter.RIGHT_SWITCH_POLARITY,
        AxisParameter.LEFT_SWITCH_POLARITY,
        AxisParameter.SOFT_STOP,
        AxisParameter.STALL_VELOCITY,
        AxisParameter.MAX_ENCODER_DEVIATION,
        AxisParameter.ENCODER_RESOLUTION,
        AxisParameter.UNIT_MODE,
    }
)


class Motor(RampGenerator):
    """A motor by its parameters. `faults` are bits of AP 208 that a test may set."""

    def __init__(self, shaft: Shaft | None, encoder: Encoder | None, table: dict[int, Parameter], heartbeat: Heartbeat) -> None:
        super().__init__(shaft, encoder, table, heartbeat)
        self.faults = DriverFlag(0)

    def reset(self, t: float) -> None:
        """Power-on: the rotor stands, EEPROM's settings hold, the counter and the encoder's are 0, and the shaft stays."""
        self._forget(t)
        self._wanted = self._trajectory = self.shaft.recount(t, 0.0, self._per_full())
        if self.encoder is not None:
            self._encoder_offset = -self.encoder.read(t, self._resolution())

    def factory_reset(self, t: float) -> None:
        """The same with an empty EEPROM."""
        self._eeprom.clear()
        self.reset(t)

    def position(self, t: float) -> float:
        """The counter, microsteps."""
        self.catch_up(t)
        return self._trajectory.position(t)

    def arrival(self) -> float | None:
        """Time of arrival at the target; None if the motor does not arrive."""
        end = self._trajectory.end
        reaches = self._search is None and round(self._trajectory.position(end)) == self._target
        return end if reaches and self._trajectory.velocity(end) == 0.0 else None

    def current(self, t: float) -> int:
        """Of 255: the run current, and a power-down delay after the end of a movement the standby current."""
        rests = self._trajectory.end + self._values[AxisParameter.POWER_DOWN_DELAY] * POWER_DOWN_UNIT_S
        return self._values[
            AxisParameter.STANDBY_CURRENT if t >= rests and not self.is_moving(t) else AxisParameter.RUN_CURRENT
        ]

    def get(self, number: int, t: float) -> int:
        """GAP. Raises CommandRejected for a parameter that is not there."""
        self.catch_up(t)
        if number == ACTUAL_POSITION:
            return signed(round(self._trajectory.position(t)))
        if number == ENCODER_POSITION:
            return signed(self._encoder_position(t))
        if number in COMPUTED:
            return signed(self._computed(number, t))
        if number not in self._values:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        return self._values[number]

    def _computed(self, number: int, t: float) -> int:
        match number:
            case AxisParameter.TARGET_POSITION:
                return self._target
            case AxisParameter.ACTUAL_POSITION | 198:
                return round(self._trajectory.position(t))
            case AxisParameter.ACTUAL_VELOCITY | 29:
                return round(self._trajectory.velocity(t) / self._unit())
            case AxisParameter.POSITION_REACHED:
                at_target = round(self._trajectory.position(t)) == self._target
                return int(not self.is_moving(t) and at_target and self._search is None)
            case AxisParameter.HOME_SWITCH:
                return int(self.switch(Place.HOME).active(self.shaft.angle_deg(t)))
            case AxisParameter.RIGHT_SWITCH:
                return int(self.end_switch(1).active(self.shaft.angle_deg(t)))
            case AxisParameter.LEFT_SWITCH:
                return int(self.end_switch(-1).active(self.shaft.angle_deg(t)))
            case AxisParameter.SWITCH_DISTANCE:
                return self._distance
            case AxisParameter.LAST_REFERENCE_POSITION:
                return self._last_reference
            case AxisParameter.LOAD_VALUE:
                return 0 if self._stalls(t) else UNLOADED
            case AxisParameter.ERROR_FLAGS:
                errors, self._errors = self._errors, ErrorFlag(0)  # reading clears them
                return int(errors)
            case AxisParameter.DRIVER_FLAGS:
                return int(self.faults | self._driver_flags(t))
            case 180:
                return self.current(t) >> 3
        return self._encoder_position(t)

    def _encoder_position(self, t: float) -> int:
        if self.encoder is None:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        return round(self.encoder.read(t, self._resolution()) + self._encoder_offset)

    def _driver_flags(self, t: float) -> DriverFlag:
        if self._stalls(t):
            return DriverFlag.STALL
        return DriverFlag(0) if self.is_moving(t) else DriverFlag.STANDSTILL

    def set(self, number: int, value: int, t: float) -> None:
        """SAP. Raises CommandRejected for a parameter that is not there or a value out of its range."""
        self.catch_up(t)
        match number:
            case AxisParameter.TARGET_POSITION:
                self.move_to(value, t)
                return
            case AxisParameter.ACTUAL_POSITION:
                self._recount(float(value), t)
                return
            case AxisParameter.ENCODER_POSITION if self.encoder is not None:
                self._encoder_offset = value - self.encoder.read(t, self._resolution())
                self.refresh(t)
                return
        parameter = self._table.get(number)
        if parameter is None:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        if not parameter.lowest <= value <= parameter.highest:
            raise CommandRejected(ReplyStatus.INVALID_VALUE)
        if number == AxisParameter.REFERENCE_SEARCH_MODE and not reference_search.known(value):
            raise CommandRejected(ReplyStatus.INVALID_VALUE)
        changes, self._values[number] = self._values[number] != value, value  # the same resolution again: no effect (*)
        if changes and number in (AxisParameter.MICROSTEP_RESOLUTION, AxisParameter.REVERSE_SHAFT):
            self._trajectory = self._wanted = self.shaft.recount(t, round(self._trajectory.position(t)), self._per_full())
        elif number == AxisParameter.TARGET_VELOCITY:
            self.turn(value, t)
        elif number in REPLANNED:
            self.refresh(t)

    def store(self, number: int, *, restore: bool, t: float) -> None:
        """STAP and RSAP. Raises CommandRejected for a parameter that EEPROM does not keep."""
        parameter = self._table.get(number)
        if parameter is None or not parameter.stored:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        if restore:
            self.set(number, self._eeprom.get(number, parameter.value), t)
        else:
            self._eeprom[number] = self._values[number]

    def move_by(self, offset: int, t: float) -> int:
        """MVP REL: from the last target, from where it is or from the encoder, as AP 127 selects; returns the target."""
        reference = self._values[AxisParameter.RELATIVE_REFERENCE]
        start = (AxisParameter.TARGET_POSITION, AxisParameter.ACTUAL_POSITION, AxisParameter.ENCODER_POSITION)[reference]
        return self.move_to(self.get(start, t) + offset, t)

    def _recount(self, position: float, t: float) -> None:
        """Set the counter. A moving motor goes from the new count to the old target: the axis ends elsewhere (TMCM-3214)."""
        goes_on, velocity = self._positioning and self.is_moving(t), self._trajectory.velocity(t)
        self._cancel_search(t)
        self._halt = None
        self._wanted = self._trajectory = self.shaft.recount(t, position, self._per_full())
        if goes_on:
            self._follow(self._ramp(t, position, velocity), t)
        elif velocity == 0.0:
            self._target = int(position)
        else:
            self._follow(ramp_to_velocity(t, position, velocity, velocity, *self._slopes()), t)
