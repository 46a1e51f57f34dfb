"""Who puts samples into the sample unit and mends what has failed: a person at a real rig, the back door of a virtual one."""

from collections.abc import Callable
from typing import Protocol

from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.errors import UserError
from goniotwin.mocks.control import Control, Refused
from goniotwin.twin import VirtualRig


class Operator(Protocol):
    """Whoever is at the rig."""

    def mount(self, sample: str) -> None:
        """Returns when `sample` is in the sample unit, or, for NO_SAMPLE, when it is empty."""

    def mend(self, fault: str, /) -> bool:
        """Asks for a fault to be mended; returns whether somebody has, and the row is to be done again."""


class VirtualOperator:
    """Mounts on a virtual rig, at once."""

    def __init__(self, rig: VirtualRig) -> None:
        self._rig = rig

    def mount(self, sample: str) -> None:
        """Raises KeyError for a sample that the virtual rig does not have."""
        self._rig.mount(None if sample == NO_SAMPLE else sample)

    def mend(self, _fault: str, /) -> bool:
        """There is nobody at a virtual rig."""
        return False


class ServedOperator:
    """Mounts on a virtual rig that another process serves, through its control port."""

    def __init__(self, port: int) -> None:
        self._port = port

    def mount(self, sample: str) -> None:
        """Raises UserError where nobody serves it any more, or where it has no such sample."""
        try:
            control = Control(self._port)
            try:
                control.do("mount", sample=None if sample == NO_SAMPLE else sample)
            finally:
                control.close()
        except (OSError, Refused) as error:
            raise UserError(f"mounting {sample!r} on the served rig: {error}; is `goniotwin serve` still running?") from None

    def mend(self, _fault: str, /) -> bool:
        """There is nobody at a virtual rig."""
        return False


class HumanOperator:
    """Asks a person and waits; `ask` shows a text and returns when it is done."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask

    def mount(self, sample: str) -> None:
        """The shutter is closed while the person works."""
        empty = "Take the sample out, so that the sample unit is empty"
        what = empty if sample == NO_SAMPLE else f"Mount {sample!r} in the sample unit"
        self._ask(f"{what}, then confirm.")

    def mend(self, fault: str, /) -> bool:
        """Whoever does not mend it stops the run instead of confirming."""
        self._ask(f"{fault}. Mend it, then confirm: the row is done again.")
        return True
