"""Reference of an axis: whether its position is known. The module keeps it for the next process while it has power.

Each axis has a mark in a user variable that is lost with the power. It is referenced, unreferenced, unreferenced by a reset,
or has no value, which means that the module was powered up or reset since the mark was set. So a process inherits the
reference of the process before it. A reset takes the encoder's counter too; other events leave it right.
"""

import contextlib

from goniotwin.drivers.errors import DeviceError, Forgotten, Interrupted, NoAnswer, Refused
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.registers import Registers
from goniotwin.drivers.motion.tmcl.rules import REFERENCED, RESET, UNREFERENCED, mark
from goniotwin.protocols.tmcl import CommandFrame
from goniotwin.protocols.tmcl_parameters import ErrorFlag

REMEDY = "home it or set its position (goniotwin home, goniotwin here)"


class Reference:
    """Reference of one axis, its mark in the module, and the events that end it.

    `errors` are the module's error flags since connecting or homing: the module clears them when they are read.
    """

    def __init__(self, module: TmclModule, registers: Registers) -> None:
        self._module = module
        self._registers = registers
        self._settings = registers.settings
        self._reason = "it has not been homed since it was connected" if self._settings.homing_required else ""
        self._resets = 0
        self._first = True
        self._encoder_lost = False
        self.errors = ErrorFlag(0)

    @property
    def unreferenced_reason(self) -> str:
        """Why the axis is unreferenced; empty if it is referenced."""
        if self._has_reset:
            return self._reason or "its module has reset, and its counter with it"
        return self._reason

    @property
    def encoder_lost(self) -> bool:
        """True if a reset has zeroed the encoder's counter somewhere, and the axis has not been referenced since."""
        return self._encoder_lost or self._has_reset

    @property
    def _has_reset(self) -> bool:
        return self._module.resets(self._settings.module) != self._resets

    def mark_unreferenced(self, reason: str) -> None:
        """Make the axis unreferenced, here and, if the line works, in the module."""
        if not self._reason:
            self._reason = reason
            with contextlib.suppress(DeviceError):
                self._write_mark(RESET if self.encoder_lost else UNREFERENCED)

    def mark_referenced(self) -> None:
        """Make the axis referenced. Raises DeviceError."""
        resets = self._module.resets(self._settings.module)
        self._write_mark(REFERENCED)
        self._resets = resets
        self._reason, self._encoder_lost = "", False

    def restore(self, earlier_errors: ErrorFlag) -> None:
        """Take over the mark in the module on the first connection, unless an error flag contradicts it. Raises DeviceError.

        Call it when the module has its settings; `earlier_errors` are the flags from before the connection.
        """
        if self._first:
            value = self._module.exchange(mark(self._settings.module, self._settings.motor))
            self._reason = self._reason_of_mark(value, earlier_errors)
            self._encoder_lost = bool(self._reason) and value not in (REFERENCED, UNREFERENCED)
            self._first = False
        unreferenced = RESET if self.encoder_lost else UNREFERENCED
        self._write_mark(unreferenced if self.unreferenced_reason else REFERENCED)

    def encoder_disagrees(self, counter_deg: float, encoder_deg: float | None) -> bool:
        """True if counter and encoder differ by more than the tolerance."""
        tolerance = self._settings.tolerance_deg
        return encoder_deg is not None and tolerance > 0.0 and abs(encoder_deg - counter_deg) > tolerance

    def compare(self, counter_deg: float, encoder_deg: float | None) -> None:
        """Make the axis unreferenced if counter and encoder disagree."""
        if self.encoder_disagrees(counter_deg, encoder_deg):
            self.mark_unreferenced(
                f"its counter is at {counter_deg:.3f} deg and its encoder at {encoder_deg:.3f} deg, more than "
                f"{self._settings.tolerance_deg:g} deg apart"
            )

    def read_errors(self) -> ErrorFlag:
        """Read and latch the error flags; a stall or a deviation makes the axis unreferenced. Raises DeviceError."""
        try:
            self.errors |= self._registers.error_flags()
        except NoAnswer:
            self.mark_unreferenced("its error flags were lost in transmission")
            raise
        if self.errors:
            self.mark_unreferenced(f"{flag_names(self.errors)} has stopped it")
        return self.errors

    def send_motion_command(self, request: CommandFrame, stop_count: int) -> int:
        """Send a request that starts a motion, unless a stop was requested after `stop_count`. Raises DeviceError.

        If its delivery is unknown the axis becomes unreferenced.
        """
        try:
            return self._module.exchange(request, stop_count)
        except (Refused, Interrupted, Forgotten):
            raise
        except DeviceError as error:
            if self._module.stop_count != stop_count:
                raise  # stopped afterwards, if it was received at all: the counter has the position
            self.mark_unreferenced(f"it is unknown whether it received a motion command ({error.happened})")
            raise

    def _reason_of_mark(self, value: int, earlier_errors: ErrorFlag) -> str:
        """Why the axis is unreferenced according to its mark and the error flags; empty if it is referenced."""
        if value == UNREFERENCED:
            return "an earlier run has left it unreferenced"
        if value == REFERENCED:
            return f"{flag_names(earlier_errors)} has stopped it before it was connected" if earlier_errors else ""
        if self._settings.homing_required:
            return "it has not been homed since its module was powered up"
        if self._settings.power_up_at_reference and value != RESET:
            return ""
        return "its module was powered up or has reset since it was last referenced"

    def _write_mark(self, value: int) -> None:
        self._module.exchange(mark(self._settings.module, self._settings.motor, value))


def flag_names(flags: ErrorFlag) -> str:
    """Names of error flags for a message."""
    return " and ".join((flag.name or "").lower() for flag in flags)
