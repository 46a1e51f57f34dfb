"""A move under way: asked when the ramp says that it is over, and often enough for the module's heartbeat meanwhile."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from goniotwin.drivers.errors import DeviceError
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Axis as Parameter
from goniotwin.protocols.tmcl import Command, MoveType
from goniotwin.protocols.tmcl_parameters import DriverFlag, ErrorFlag

if TYPE_CHECKING:
    from goniotwin.drivers.motion.axis import Axis

POLL_S = 0.02
STANDS_S = 0.1
ARRIVED_AFTER_S = 0.002
OVERDUE_S = 5.0


@dataclass(frozen=True)
class Switches:
    """Limit switches at the ends of positive (right) and negative microsteps, and the home switch: True is active."""

    right: bool
    left: bool
    home: bool


class Move:
    """From one angle to another, in one leg or (against backlash) in two. `arrival` is when it should be there, s.

    A question each poll: has it arrived; if so, has the module its settings still, or where does the next leg go; if not
    and it should have, does it still turn. What stands short of its target for 0.1 s has been stopped, and why is asked.
    """

    def __init__(self, axis: "Axis", clock: Clock, doing: str, legs: tuple[float, ...], here: int, stops: int) -> None:
        self._axis = axis
        self._clock = clock
        self._doing = doing
        self._legs = list(legs)
        self._here = here
        self._stops = stops
        self._there = False
        self._stands_since: float | None = None
        self._late_at = self.arrival = self.due = clock.now()

    def begin(self, relative: int | None = None) -> None:
        """Sends the next leg. Raises DeviceError; Interrupted where there has been a stop since the move was asked for."""
        settings, axis = self._axis.settings, self._axis
        target = settings.microsteps(self._legs.pop(0))
        if relative is None:
            axis.command(axis.move_request(MoveType.ABSOLUTE, target), self._stops)
        else:
            axis.command(axis.move_request(MoveType.RELATIVE, relative), self._stops)
        ramp = settings.seconds((target - self._here) / settings.microsteps_per_deg)
        now = self._clock.now()
        self._leg_arrival = now + ramp + ARRIVED_AFTER_S
        self._late_at = self._leg_arrival + ramp + OVERDUE_S
        place, rest = target, 0.0
        for leg in self._legs:
            rest += settings.seconds((settings.microsteps(leg) - place) / settings.microsteps_per_deg) + ARRIVED_AFTER_S
            place = settings.microsteps(leg)
        self._here = target
        self.arrival = self._leg_arrival + rest
        self._stands_since = None
        self._when_next()

    def poll(self) -> bool:
        """Asks, in one exchange; True when it is where it was to go. Raises DeviceError where it never will be."""
        axis = self._axis
        if self._there:
            if self._legs:
                self._there = False
                self.begin()
                return False
            axis.check_canary()
            axis.arrived()
            return True
        if self._stands_since is None or self._clock.now() < self._leg_arrival:
            if axis.ask(Command.GAP, Parameter.POSITION_REACHED):
                self._there, self.due = True, self._clock.now()
            elif self._clock.now() >= self._leg_arrival:
                self._stands_since, self.due = float("inf"), self._clock.now() + POLL_S
            else:
                self._when_next()
            return False
        self._look_whether_it_turns()
        return False

    def _when_next(self) -> None:
        """When the ramp is over, or earlier where the module would stop an axis whose host is silent."""
        self.due = min(self._leg_arrival, self._clock.now() + self._axis.alive_s)

    def _look_whether_it_turns(self) -> None:
        axis = self._axis
        turning = axis.ask(Command.GAP, Parameter.ACTUAL_VELOCITY) != 0
        now = self._clock.now()
        assert self._stands_since is not None
        if turning:
            if now > self._late_at:
                raise DeviceError(axis.name, self._doing, "it still turns long after it should be there", "stop it")
            self._stands_since = None
        elif axis.ask(Command.GAP, Parameter.POSITION_REACHED):
            self._there, self.due = True, now
            return
        else:
            self._stands_since = min(self._stands_since, now)
            if now - self._stands_since > STANDS_S:
                raise stopped_short(axis, self._doing)
        self.due = now + POLL_S


def stopped_short(axis: "Axis", doing: str) -> DeviceError:
    """Asks why an axis stands where it should not, and leaves it unreferenced where that puts its position in doubt."""
    axis.check_canary()
    errors = axis.read_errors()
    switches = axis.switches()
    driver = axis.driver_flags() & ~(DriverFlag.STANDSTILL | DriverFlag.OVERTEMPERATURE_WARNING)
    reasons = []
    if errors & ErrorFlag.STALL:
        reasons.append("the motor has stalled")
    if errors & ErrorFlag.DEVIATION:
        reasons.append("the encoder is somewhere else than the counter")
    if axis.settings.switches and (switches.right or switches.left):
        side = "right" if switches.right else "left"
        reasons.append(f"the {side} limit switch has stopped it")
        axis.put_in_doubt(f"the {side} limit switch has stopped it")
    if driver:
        names = " and ".join((flag.name or "").lower().replace("_", " ") for flag in driver)
        reasons.append(f"the motor's driver reports {names}")
    reason = ", ".join(reasons) or "somebody's stop, or the module's heartbeat after a silence of its host"
    remedy = "remove the cause, then home the axis" if not axis.referenced else "start again"
    return DeviceError(axis.name, doing, f"the axis stands at {axis.position_deg():.3f} deg: {reason}", remedy)
