"""A move in progress: polled when its ramp ends, and often enough for the module's heartbeat until then."""

from collections.abc import Callable
from itertools import pairwise

from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.motion.tmcl.reference import Reference
from goniotwin.drivers.motion.tmcl.registers import Registers
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Command, MoveType
from goniotwin.protocols.tmcl_parameters import AxisParameter as Parameter
from goniotwin.protocols.tmcl_parameters import DriverFlag, ErrorFlag

POLL_S = 0.02
STANDSTILL_S = 0.1
ARRIVED_AFTER_S = 0.002
"""Time from the end of a ramp until the module is asked whether the target is reached."""
OVERDUE_S = 5.0
EXCHANGES_BETWEEN_LEGS, EXCHANGES_AT_END = 2, 2
"""Number of exchanges at the end of a leg: target reached and next target; at the end of a move: target reached and canary."""


class Move:
    """A move to an angle, in one leg or (against backlash) in two. `arrival` is the estimated end of the move, s.

    Each poll makes one exchange. It asks whether the target is reached. If it is, the next leg starts, or the canary is
    read. If it is not and the ramp is over, it asks whether the motor still turns. A motor at rest short of its target for
    0.1 s has been stopped: the cause is read from the module. `on_arrival` is called at the end.
    """

    def __init__(
        self,
        registers: Registers,
        reference: Reference,
        clock: Clock,
        doing: str,
        legs: tuple[float, ...],
        here: int,
        stop_count: int,
        on_arrival: Callable[[], None],
    ) -> None:
        self._registers = registers
        self._reference = reference
        self._clock = clock
        self._doing = doing
        self._legs = list(legs)
        self._here = here
        self._stop_count = stop_count
        self._on_arrival = on_arrival
        self._reached = False
        self._standstill_since: float | None = None
        self._overdue_at = self.arrival = self.due = clock.now()

    def begin(self, relative: int | None = None) -> None:
        """Send the next leg. Raises DeviceError; Interrupted if a stop was requested since the move was."""
        settings = self._registers.settings
        target = settings.counter(self._legs.pop(0))
        kind, value = (MoveType.ABSOLUTE, target) if relative is None else (MoveType.RELATIVE, relative)
        self._reference.send_motion_command(self._registers.request(Command.MVP, kind, value), self._stop_count)
        places = [self._here, target, *(settings.counter(leg) for leg in self._legs)]
        ramp, *later = [settings.ramp_s(there - here) for here, there in pairwise(places)]
        self._leg_arrival = self._clock.now() + ramp + ARRIVED_AFTER_S
        self._overdue_at = self._leg_arrival + ramp + OVERDUE_S
        self._here = target
        self.arrival = self._leg_arrival + sum(each + ARRIVED_AFTER_S for each in later)
        self._standstill_since = None
        self._schedule_poll()

    def poll(self) -> bool:
        """Ask the module, in one exchange; True when the last target is reached. Raises DeviceError for a failed move."""
        registers = self._registers
        if self._reached:
            if self._legs:
                self._reached = False
                self.begin()
                return False
            registers.check_canary()
            self._on_arrival()
            return True
        if self._standstill_since is None or self._clock.now() < self._leg_arrival:
            if registers.read(Parameter.POSITION_REACHED):
                self._reached, self.due = True, self._clock.now()
            elif self._clock.now() >= self._leg_arrival:
                self._standstill_since, self.due = float("inf"), self._clock.now() + POLL_S
            else:
                self._schedule_poll()
            return False
        self._check_standstill()
        return False

    def _schedule_poll(self) -> None:
        """Next poll at the end of the ramp, or earlier, before the module stops an axis because its host is silent."""
        self.due = min(self._leg_arrival, self._clock.now() + self._registers.keep_alive_s)

    def _check_standstill(self) -> None:
        """Ask an overdue axis whether it moves, and raise DeviceError if it has been stopped or never arrives."""
        registers = self._registers
        moving = registers.read(Parameter.ACTUAL_VELOCITY) != 0
        now = self._clock.now()
        assert self._standstill_since is not None
        if moving:
            if now > self._overdue_at:
                raise DeviceError(registers.name, self._doing, "it still turns long after its estimated arrival", "stop it")
            self._standstill_since = None
        elif registers.read(Parameter.POSITION_REACHED):
            self._reached, self.due = True, now
            return
        else:
            self._standstill_since = min(self._standstill_since, now)
            if now - self._standstill_since > STANDSTILL_S:
                raise self._stopped_short()
        self.due = now + POLL_S

    def _stopped_short(self) -> DeviceError:
        """The error of an axis at rest short of its target, with the cause by the module's flags and switches.

        The axis becomes unreferenced if the cause affects its position.
        """
        registers, reference = self._registers, self._reference
        registers.check_canary()
        errors = reference.read_errors()
        switches = registers.switches()
        driver = registers.driver_flags() & ~(DriverFlag.STANDSTILL | DriverFlag.OVERTEMPERATURE_WARNING)
        reasons = []
        if errors & ErrorFlag.STALL:
            reasons.append("the motor has stalled")
        if errors & ErrorFlag.DEVIATION:
            reasons.append("the encoder deviates from the counter")
        if registers.settings.switches and (switches.right or switches.left):
            side = "right" if switches.right else "left"
            reasons.append(f"the {side} limit switch has stopped it")
            reference.mark_unreferenced(f"the {side} limit switch has stopped it")
        if driver:
            names = " and ".join((flag.name or "").lower().replace("_", " ") for flag in driver)
            reasons.append(f"the motor driver reports {names}")
        reason = ", ".join(reasons) or "a stop from elsewhere, or the module's heartbeat because its host was silent"
        remedy = "remove the cause, then home the axis" if reference.unreferenced_reason else "start again"
        return DeviceError(registers.name, self._doing, f"stopped at {registers.position_deg():.3f} deg: {reason}", remedy)
