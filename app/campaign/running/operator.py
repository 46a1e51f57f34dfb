"""Operator of a rig: mounts samples and fixes faults. A person at a real rig; at a virtual rig the program itself."""

from collections.abc import Callable
from typing import Protocol

from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.errors import UserError
from goniotwin.mocks.control import ControlClient, OrderRefused
from goniotwin.twin import VirtualRig


class Operator(Protocol):
    """Operator of the rig."""

    def mount(self, sample: str) -> None:
        """Return when `sample` is in the sample unit; for NO_SAMPLE, when the sample unit is empty."""

    def confirm_fix(self, fault: str, /) -> bool:
        """Ask for a fault to be fixed; return whether it is fixed and the row is to be retried."""


class VirtualOperator:
    """Operator of a virtual rig in this process: mounts at once, fixes nothing."""

    def __init__(self, rig: VirtualRig) -> None:
        self._rig = rig

    def mount(self, sample: str) -> None:
        """Mount a sample. Raises KeyError for a sample that the virtual rig does not have."""
        self._rig.mount(None if sample == NO_SAMPLE else sample)

    def confirm_fix(self, _fault: str, /) -> bool:
        """Return False: a virtual rig has no person to fix a fault."""
        return False


class ServedOperator:
    """Operator of a virtual rig that another process serves: mounts through the simulation control port, fixes nothing."""

    def __init__(self, port: int) -> None:
        self._port = port

    def mount(self, sample: str) -> None:
        """Mount a sample. Raises UserError where the rig is not served any more, or has no such sample."""
        try:
            control = ControlClient(self._port)
            try:
                control.do("mount", sample=None if sample == NO_SAMPLE else sample)
            finally:
                control.close()
        except (OSError, OrderRefused) as error:
            raise UserError(f"mounting {sample!r} on the served rig: {error}; is `goniotwin serve` still running?") from None

    def confirm_fix(self, _fault: str, /) -> bool:
        """Return False: a virtual rig has no person to fix a fault."""
        return False


class HumanOperator:
    """Person at the rig. `ask` shows a text and returns when the person confirms."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask

    def mount(self, sample: str) -> None:
        """Ask for a sample to be mounted, or for the sample unit to be emptied. The shutter is closed meanwhile."""
        empty = "Take the sample out, so that the sample unit is empty"
        what = empty if sample == NO_SAMPLE else f"Mount {sample!r} in the sample unit"
        self._ask(f"{what}, then confirm.")

    def confirm_fix(self, fault: str, /) -> bool:
        """Ask for a fault to be fixed. To end the run instead, stop it without confirming."""
        self._ask(f"{fault}. Fix the fault, then confirm: the row is retried.")
        return True
