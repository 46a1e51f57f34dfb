"""Devices that a program must not leave as they are when it dies: their last will, which another process carries out.

A driver arms its guard before it sends what makes the device unsafe (an open shutter), and disarms it when the device is seen
safe again. A last will needs no driver: it is the bytes of the device's protocol, and the answer that shows that it is safe.
"""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

CLOSE_SHUTTER = "Close the shutter by hand"
"""What a person does where a shutter may be open and no program closes it."""


@dataclass(frozen=True)
class LastWill:
    """What is sent to a device when the program that controlled it has died, at `baudrate`.

    `ending` ends a command of which only a part was sent, `order` makes the device safe, `question` asks whether it is, and
    `safe` is a regular expression that is found in such an answer, and in no other (a character a byte). For people: `danger`
    is what may be, `remedy` what a person does about it, `relief` what the answer shows.
    """

    device: str
    baudrate: int
    ending: bytes
    order: bytes
    question: bytes
    safe: str
    danger: str
    remedy: str
    relief: str


class Guard(Protocol):
    """The keeper of a last will. A call is quick and raises nothing."""

    def arm(self, will: LastWill) -> None:
        """From now on the device may be unsafe, and the will is carried out if this program dies."""

    def disarm(self) -> None:
        """The device was seen safe."""


class NoGuard:
    """The guard of a device that ends with this process, or of a driver that has none."""

    def arm(self, will: LastWill) -> None:
        """Nothing is kept."""

    def disarm(self) -> None:
        """Nothing was kept."""


@runtime_checkable
class Guarded(Protocol):
    """A device with a last will. Drivers of other packages may not have one."""

    def last_will(self) -> LastWill:
        """What makes the device safe without this program."""

    def is_safe(self) -> bool:
        """Ask the device, which is identified or connected, whether it is safe. Nothing moves. Raises DeviceError."""
