"""A reference search under way: started, polled, and believed only when everything about it is right."""

from typing import TYPE_CHECKING

from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.motion.settings import Homing
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Axis as Parameter
from goniotwin.protocols.tmcl import Command
from goniotwin.protocols.tmcl_parameters import Search

if TYPE_CHECKING:
    from goniotwin.drivers.motion.axis import Axis

POLL_S = 0.1
NEAR_MICROSTEPS = 1


class HomingSearch:
    """One search. When it is over the counter is 0 at the reference, the encoder is set to agree with it, and the angle
    at which the old counter had the reference is the axis' `last_reference_deg`: how far it had gone astray."""

    def __init__(self, axis: "Axis", clock: Clock, homing: Homing, alive_s: float) -> None:
        self._axis = axis
        self._clock = clock
        self._homing = homing
        self._every = min(POLL_S, alive_s)
        self._deadline = clock.now() + homing.longest_s
        self._steps = iter((self._has_found, self._has_no_errors, self._takes_over))
        self._over = False
        self._reference = 0.0
        self.due = clock.now() + self._every

    def poll(self) -> bool:
        """Asks; True when the axis is referenced. Raises DeviceError where the search has failed."""
        axis = self._axis
        if not self._over:
            self._over = axis.ask(Command.RFS, Search.STATUS) == 0
            if not self._over and self._clock.now() > self._deadline:
                axis.ask(Command.RFS, Search.STOP)
                raise self._failed(f"no reference within {self._homing.longest_s:g} s")
            self.due = self._clock.now() if self._over else self._clock.now() + self._every
            return False
        step = next(self._steps, None)
        if step is not None:
            step()
            self.due = self._clock.now()
            return False
        axis.check_canary()
        axis.homed(self._reference)
        return True

    def _has_found(self) -> None:
        """A search that was ended by something else leaves the counter as it was."""
        counter = self._axis.ask(Command.GAP, Parameter.ACTUAL_POSITION)
        reached = self._axis.ask(Command.GAP, Parameter.POSITION_REACHED)
        if abs(counter) > NEAR_MICROSTEPS or not reached:
            raise self._failed("the search was ended before it found anything")

    def _has_no_errors(self) -> None:
        if errors := self._axis.read_errors():
            raise self._failed(" and ".join((flag.name or "").lower() for flag in errors))
        self._reference = self._axis.settings.angle_deg(self._axis.ask(Command.GAP, Parameter.LAST_REFERENCE_POSITION))

    def _takes_over(self) -> None:
        angle, settings = self._homing.angle_deg, self._axis.settings
        self._axis.count_from(0 if angle is None else settings.microsteps(angle))

    def _failed(self, happened: str) -> DeviceError:
        return DeviceError(self._axis.name, "home", happened, "look at its switches and its way, then home it again")
