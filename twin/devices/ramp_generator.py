"""A motor's ramp generator: from commands to trajectories, and from there to the shaft.

Everything that will end a movement (a switch on the way, a stall, a deviation of the encoder) is looked for when the
movement begins, and again when something changes. A motor that a switch has stopped stays so until the next command (*).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from goniotwin.protocols.tmcl import ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter, ErrorFlag, SearchCommand
from goniotwin.twin.devices import reference_search
from goniotwin.twin.devices.axis_table import Parameter
from goniotwin.twin.devices.encoder import MICROSTEPS, Encoder
from goniotwin.twin.devices.switches import Place, Switch, when_switched, when_true
from goniotwin.twin.optics.geometry.coordinates import TURN_DEG
from goniotwin.twin.plant.model import Mechanics
from goniotwin.twin.plant.motion import Trajectory, brake_to_rest, cut_off, ramp_to_target, ramp_to_velocity, rest_at
from goniotwin.twin.plant.shaft import Drive, Heartbeat, Shaft

CHIP_UNITS_PPS = 16_000_000 / 2**24  # of velocities where UNIT_MODE is 0 (*)
CANCELLED_STATE, CANCELLED_S = 15, 0.05
UNCOUPLED = Mechanics(motor=0, gear=1.0, encoder=False)
NO_FLAG = ErrorFlag(0)
STALL_HORIZON_S = 1.0


@dataclass(frozen=True)
class MotionEnd:
    """Cause and time of the end of a movement: `soft` over a ramp, else at once."""

    t: float
    flag: ErrorFlag = NO_FLAG
    soft: bool = False


@dataclass(frozen=True)
class Guards:
    """Limits that a motor obeys: its switches where they are enabled, the speed (pps) above which a stall stops it (0: never),
    by how much the encoder may deviate (0: at all), and the encoder's reading at an angle."""

    right: Switch | None
    left: Switch | None
    soft: bool
    stall_pps: float
    deviation: int
    encoder: Callable[[float], float] | None


class CommandRejected(Exception):
    """A request that the module refuses, with its status."""

    def __init__(self, status: ReplyStatus) -> None:
        super().__init__(status.name)
        self.status = status


class RampGenerator:
    """Ramp generator of a motor: counter, trajectory, its early end, and the shaft that follows.

    `shaft` is None where nothing is coupled to it; `heartbeat` is the module's heartbeat.
    """

    def __init__(self, shaft: Shaft | None, encoder: Encoder | None, table: dict[int, Parameter], heartbeat: Heartbeat) -> None:
        self.shaft = shaft if shaft is not None else Shaft(UNCOUPLED)
        self.encoder = encoder
        self._table = table
        self._heartbeat = heartbeat
        self._eeprom: dict[int, int] = {}
        self.shaft.listener = self.refresh
        self._forget(0.0)

    def _forget(self, t: float) -> None:
        self._values = {number: parameter.value for number, parameter in self._table.items()} | self._eeprom
        self._encoder_offset = 0.0
        self._target = 0
        self._errors = ErrorFlag(0)
        self._halt: MotionEnd | None = None
        self._search: reference_search.ReferenceSearch | None = None
        self._cancelled = -1.0
        self._last_reference = self._distance = 0
        self._positioning = False
        self._wanted = self._trajectory = rest_at(0.0, t)

    def is_moving(self, t: float) -> bool:
        """Whether the ramp is still running."""
        return self._trajectory.end > t or self._trajectory.velocity(t) != 0.0

    def _stalls(self, t: float) -> bool:
        return self.shaft.jammed and self._trajectory.velocity(t) != 0.0

    def move_to(self, target: int, t: float) -> int:
        """MVP ABS: starts the ramp; returns the target."""
        self.catch_up(t)
        self._cancel_search(t)
        self._target = signed(target)
        self._positioning = True
        position, velocity = self._trajectory.position(t), self._trajectory.velocity(t)
        self._follow(self._ramp(t, position, velocity), t)
        return self._target

    def turn(self, velocity: int, t: float) -> None:
        """ROR and ROL (signed), and MST with 0: the target position stays what it was."""
        self.catch_up(t)
        self._cancel_search(t)
        self._positioning = False
        self._values[AxisParameter.TARGET_VELOCITY] = velocity
        position, now = self._trajectory.position(t), self._trajectory.velocity(t)
        self._follow(ramp_to_velocity(t, position, now, velocity * self._unit(), *self._slopes()), t)

    def search(self, kind: int, t: float) -> int:
        """RFS. Raises CommandRejected for an unknown type."""
        self.catch_up(t)
        if kind == SearchCommand.STATUS:
            if self._search is not None:
                return self._search.state(t)
            return CANCELLED_STATE if t < self._cancelled + CANCELLED_S else 0
        if kind == SearchCommand.STOP:
            if self._search is not None:
                self.turn(0, t)
            return 0
        if kind != SearchCommand.START:
            raise CommandRejected(ReplyStatus.WRONG_TYPE)
        self._positioning = False
        found = reference_search.search(self._values[AxisParameter.REFERENCE_SEARCH_MODE], self._trajectory, t, self._means(t))
        self._follow(found.trajectory, t, switches=False)
        if self._halt is None or (found.end is not None and found.end <= self._halt.t):
            self._search = found
        else:  # something stops it on the way, so that it finds nothing
            self._search = reference_search.ReferenceSearch(self._trajectory, found.phases)
        return 0

    def catch_up(self, t: float) -> None:
        """Update the state to `t`: ended movements, finished searches."""
        if self._halt is not None and t >= self._halt.t:
            self._errors |= self._halt.flag
            self._halt, self._wanted = None, self._trajectory
        search = self._search
        if search is not None and search.end is not None and t >= search.end:
            assert search.zero is not None
            self._last_reference = round(search.zero)
            if search.distance is not None:
                self._distance = round(search.distance)
            rest = self._trajectory.position(search.end) - search.zero
            self._search, self._target = None, 0
            self._wanted = self._trajectory = self.shaft.recount(search.end, rest, self._per_full())

    def refresh(self, t: float) -> None:
        """Recompute the end of the movement after a change."""
        self.catch_up(t)
        if not self.is_moving(t) and self._wanted is self._trajectory:
            return
        if self._search is not None:
            if self.shaft.jammed:  # it sees no switch any more, and turns for ever
                position, velocity = self._trajectory.position(t), self._trajectory.velocity(t)
                self._search = reference_search.ReferenceSearch(self._trajectory, self._search.phases)
                self._follow(ramp_to_velocity(t, position, velocity, velocity, *self._slopes()), t)
        elif self._positioning:
            self._follow(self._ramp(t, self._trajectory.position(t), self._trajectory.velocity(t)), t)
        else:
            self._follow(self._wanted, t)

    def _cancel_search(self, t: float) -> None:
        if self._search is not None:
            self._search, self._cancelled = None, t

    def _follow(self, wanted: Trajectory, t: float, *, switches: bool = True) -> None:
        """Begins a movement, up to what will end it; a reference search (no `switches`) checks those by itself."""
        down = self._slopes()[1]
        drive = self.shaft.drive_along(t, wanted)
        guards = self._guards() if switches else replace(self._guards(), right=None, left=None)
        self._wanted = self._trajectory = wanted
        self._halt = next_motion_end(drive, t, guards) if self.is_moving(t) else None
        if self._halt is not None:
            end = self._halt.t
            self._trajectory = brake_to_rest(wanted, end, down) if self._halt.soft else cut_off(wanted, end)
        self.shaft.follow(t, self._trajectory, down, self._heartbeat)

    def _guards(self) -> Guards:
        values, encoder = self._values, self.encoder
        offset, resolution = self._encoder_offset, self._resolution()
        return Guards(
            right=None if values[AxisParameter.RIGHT_SWITCH_DISABLED] else self.end_switch(1),
            left=None if values[AxisParameter.LEFT_SWITCH_DISABLED] else self.end_switch(-1),
            soft=bool(values[AxisParameter.SOFT_STOP]),
            stall_pps=values[AxisParameter.STALL_VELOCITY] * self._unit(),
            deviation=values[AxisParameter.MAX_ENCODER_DEVIATION],
            encoder=None if encoder is None else lambda angle: encoder.steady(angle, resolution) + offset,
        )

    def _ramp(self, t: float, position: float, velocity: float) -> Trajectory:
        speed = self._values[AxisParameter.MAX_VELOCITY] * self._unit()
        if speed == 0.0:
            return ramp_to_velocity(t, position, velocity, 0.0, *self._slopes())
        return ramp_to_target(t, position, velocity, float(self._target), speed, *self._slopes())

    def switch(self, place: Place) -> Switch:
        """One of the shaft's switches, as the search mode has the home switch inverted."""
        inverted = place is Place.HOME and bool(self._values[AxisParameter.REFERENCE_SEARCH_MODE] & 128)
        return Switch(self.shaft.mechanics, place, inverted)

    def end_switch(self, side: int) -> Switch:
        """The switch at the right (1) or left (-1) input: wired so that positive microsteps lead to the right one."""
        polarity = AxisParameter.RIGHT_SWITCH_POLARITY if side > 0 else AxisParameter.LEFT_SWITCH_POLARITY
        upwards = side * self.shaft.mechanics.sense * (-1 if self._values[AxisParameter.SWAP_SWITCHES] else 1)
        place = Place.UPPER if upwards > 0 else Place.LOWER
        return Switch(self.shaft.mechanics, place, bool(self._values[polarity]))

    def _means(self, t: float) -> reference_search.Means:
        values, unit = self._values, self._unit()
        return reference_search.Means(
            values[AxisParameter.REFERENCE_SEARCH_SPEED] * unit,
            values[AxisParameter.REFERENCE_SWITCH_SPEED] * unit,
            *self._slopes(),
            self.end_switch(-1),
            self.end_switch(1),
            self.switch(Place.HOME),
            bool(values[AxisParameter.LEFT_SWITCH_DISABLED]),
            bool(values[AxisParameter.RIGHT_SWITCH_DISABLED]),
            lambda trajectory: self.shaft.drive_along(t, trajectory),
        )

    def _slopes(self) -> tuple[float, float]:
        unit = self._unit()
        return self._values[AxisParameter.MAX_ACCELERATION] * unit, self._values[AxisParameter.MAX_DECELERATION] * unit

    def _per_full(self) -> int:
        return int(2 ** self._values[AxisParameter.MICROSTEP_RESOLUTION]) * (
            -1 if self._values[AxisParameter.REVERSE_SHAFT] else 1
        )

    def _resolution(self) -> int:
        parameter = self._table[AxisParameter.ENCODER_RESOLUTION]
        return self._values[AxisParameter.ENCODER_RESOLUTION] if parameter.lowest > 0 else 51_200

    def _unit(self) -> float:
        return 1.0 if self._values[AxisParameter.UNIT_MODE] == 1 else CHIP_UNITS_PPS


def next_motion_end(drive: Drive, t: float, guards: Guards) -> MotionEnd | None:
    """The first early end of a movement; None without any."""
    halts: list[MotionEnd] = []
    for switch, side in ((guards.right, 1), (guards.left, -1)):
        met = when_switched(drive, t, switch, True, side) if switch is not None else None
        if met is not None:
            halts.append(MotionEnd(met, soft=guards.soft))
    if guards.stall_pps > 0.0 and drive.jammed:
        met = when_true(drive, t, lambda t: abs(drive.trajectory.velocity(t)) >= guards.stall_pps, STALL_HORIZON_S)
        if met is not None:
            halts.append(MotionEnd(met, ErrorFlag.STALL))
    if guards.deviation and guards.encoder is not None:
        met = _deviation(drive, t, guards.encoder, guards.deviation)
        if met is not None:
            halts.append(MotionEnd(met, ErrorFlag.DEVIATION))
    return min(halts, key=lambda halt: halt.t, default=None)


def _deviation(drive: Drive, t: float, encoder: Callable[[float], float], most: int) -> float | None:
    scale = MICROSTEPS / abs(drive.per_full)

    def deviates(t: float) -> bool:
        return abs(encoder(drive.angle_deg(t)) - drive.counter(t) * scale) > most

    # A steady movement that has not deviated after a turn and twice the allowed way never will.
    speed = abs(drive.trajectory.pieces[-1].velocity)
    way = abs(TURN_DEG / drive.mechanics.deg_per_full_step * drive.per_full) + 2.0 * most / scale
    return when_true(drive, t, deviates, way / speed if speed else 0.0)


def signed(value: int) -> int:
    """Value of a 32-bit counter with wrap-around."""
    return (value + 2**31) % 2**32 - 2**31
