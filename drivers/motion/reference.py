"""Whether it is known where an axis is. The module keeps it for the next program, as long as it has power.

A mark of each axis, in a variable that is lost with the power, is one of three: known, in doubt, or neither, where the
module has been powered up or has reset since anybody knew. So what one process has found out outlives it.
"""

import contextlib

from goniotwin.drivers.errors import DeviceError
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.motion.tmcl.rules import DOUBTED, KNOWN, mark
from goniotwin.protocols.tmcl_parameters import ErrorFlag

REMEDY = "home it, or say where it is (goniotwin home, goniotwin here)"


class Reference:
    """What is known of one axis, and its mark in the module."""

    def __init__(self, module: TmclModule, settings: AxisSettings) -> None:
        self._module = module
        self._settings = settings
        self._doubt = "it has not been homed since it was connected" if settings.homing_required else ""
        self._resets = 0
        self._first = True

    @property
    def doubt(self) -> str:
        """Why it is not known where the axis is; empty where it is."""
        if self._module.resets(self._settings.module) != self._resets:
            return self._doubt or "its module has reset, and its counter with it"
        return self._doubt

    def put_in_doubt(self, reason: str) -> None:
        """From now on it is not known. The mark says it too, as far as the line allows."""
        if not self._doubt:
            self._doubt = reason
            with contextlib.suppress(DeviceError):
                self._set(DOUBTED)

    def settle(self) -> None:
        """It is known again. Raises DeviceError."""
        resets = self._module.resets(self._settings.module)
        self._set(KNOWN)
        self._resets = resets
        self._doubt = ""

    def connected(self, before: ErrorFlag) -> None:
        """The module has its settings. At the first time its mark is believed, but not against the error flags of before.

        Raises DeviceError.
        """
        if self._first:
            self._doubt = self._found(self._module.exchange(mark(self._settings.module, self._settings.motor)), before)
            self._first = False
        self._set(DOUBTED if self.doubt else KNOWN)

    def apart(self, counter_deg: float, encoder_deg: float | None) -> bool:
        """Whether counter and encoder disagree."""
        tolerance = self._settings.tolerance_deg
        return encoder_deg is not None and tolerance > 0.0 and abs(encoder_deg - counter_deg) > tolerance

    def compare(self, counter_deg: float, encoder_deg: float | None) -> None:
        """It is in doubt where the axis is, if they disagree."""
        if self.apart(counter_deg, encoder_deg):
            self.put_in_doubt(
                f"its counter says {counter_deg:.3f} deg and its encoder {encoder_deg:.3f} deg, more than "
                f"{self._settings.tolerance_deg:g} deg apart"
            )

    def _found(self, value: int, before: ErrorFlag) -> str:
        """The doubt that a mark and the error flags mean."""
        if value == DOUBTED:
            return "an earlier run has left it in doubt where it is"
        if value == KNOWN:
            stopped = " and ".join((flag.name or "").lower() for flag in before)
            return f"{stopped} has stopped it before it was connected" if stopped else ""
        if self._settings.homing_required:
            return "it has not been homed since its module was powered up"
        if self._settings.power_up_at_reference:
            return ""
        return "its module has been powered up or has reset since it was last known where it is"

    def _set(self, value: int) -> None:
        self._module.exchange(mark(self._settings.module, self._settings.motor, value))
