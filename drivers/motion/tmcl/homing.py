"""A reference search in progress: start, poll, and accept the result only if every check passes."""

from collections.abc import Callable

from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.motion.settings import Homing
from goniotwin.drivers.motion.tmcl.reference import Reference, flag_names
from goniotwin.drivers.motion.tmcl.registers import Registers
from goniotwin.protocols.clock import Clock
from goniotwin.protocols.tmcl import Command
from goniotwin.protocols.tmcl_parameters import AxisParameter as Parameter
from goniotwin.protocols.tmcl_parameters import SearchCommand

POLL_S = 0.1
NEAR_MICROSTEPS = 1


class HomingSearch:
    """One reference search. At its end the counter is 0 at the reference and the encoder is set to agree with it.

    `on_success` is called with the angle of the reference by the old counter, degrees: the error of the old reference.
    """

    def __init__(
        self, registers: Registers, reference: Reference, homing: Homing, clock: Clock, on_success: Callable[[float], None]
    ) -> None:
        self._registers = registers
        self._reference = reference
        self._clock = clock
        self._homing = homing
        self._on_success = on_success
        self._interval_s = min(POLL_S, registers.keep_alive_s)
        self._deadline = clock.now() + homing.longest_s
        self._steps = iter((self._check_position, self._check_errors, self._set_counter))
        self._over = False
        self._old_reference_deg = 0.0
        self.due = clock.now() + self._interval_s

    def poll(self) -> bool:
        """Ask the module; True when the axis is referenced. Raises DeviceError for a failed search."""
        if not self._over:
            self._over = self._registers.exchange(Command.RFS, SearchCommand.STATUS) == 0
            if not self._over and self._clock.now() > self._deadline:
                self._registers.exchange(Command.RFS, SearchCommand.STOP)
                raise self._failed(f"no reference within {self._homing.longest_s:g} s")
            self.due = self._clock.now() if self._over else self._clock.now() + self._interval_s
            return False
        step = next(self._steps, None)
        if step is not None:
            step()
            self.due = self._clock.now()
            return False
        self._registers.check_canary()
        self._on_success(self._old_reference_deg)
        return True

    def _check_position(self) -> None:
        """A search that was ended by something else leaves the counter as it was."""
        counter = self._registers.read(Parameter.ACTUAL_POSITION)
        reached = self._registers.read(Parameter.POSITION_REACHED)
        if abs(counter) > NEAR_MICROSTEPS or not reached:
            raise self._failed("the search was ended before it found a reference")

    def _check_errors(self) -> None:
        if errors := self._reference.read_errors():
            raise self._failed(flag_names(errors))
        self._old_reference_deg = self._registers.settings.angle_deg(self._registers.read(Parameter.LAST_REFERENCE_POSITION))

    def _set_counter(self) -> None:
        angle_deg, settings = self._homing.angle_deg, self._registers.settings
        self._registers.set_counter(0 if angle_deg is None else settings.counter(angle_deg))

    def _failed(self, happened: str) -> DeviceError:
        return DeviceError(self._registers.name, "home", happened, "check its switches and its path, then home it again")
