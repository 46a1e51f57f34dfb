"""Who puts samples into the sample unit: a person at a real rig, the back door of a virtual one."""

from collections.abc import Callable
from typing import Protocol

from app.errors import UserError
from mocks.control import Control, Refused
from twin import VirtualRig


class Operator(Protocol):
    """Whoever mounts."""

    def mount(self, sample: str) -> None:
        """Returns when `sample` is in the sample unit."""


class BackDoor:
    """Mounts on a virtual rig, at once."""

    def __init__(self, rig: VirtualRig) -> None:
        self._rig = rig

    def mount(self, sample: str) -> None:
        """Raises KeyError for a sample that the virtual rig does not have."""
        self._rig.mount(sample)


class ServedBackDoor:
    """Mounts on a virtual rig that another process serves, through its control port."""

    def __init__(self, port: int) -> None:
        self._port = port

    def mount(self, sample: str) -> None:
        """Raises UserError where nobody serves it any more, or where it has no such sample."""
        try:
            control = Control(self._port)
            try:
                control.mount(sample)
            finally:
                control.close()
        except (OSError, Refused) as error:
            raise UserError(f"mounting {sample!r} on the served rig: {error}; is `goniotwin serve` still running?") from None


class Person:
    """Asks a person and waits; `ask` shows a text and returns when it is done."""

    def __init__(self, ask: Callable[[str], None]) -> None:
        self._ask = ask

    def mount(self, sample: str) -> None:
        """The shutter is closed while the person works."""
        self._ask(f"Mount {sample!r} in the sample unit, then confirm.")
