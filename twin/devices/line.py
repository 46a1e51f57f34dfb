"""What a device on a serial line is to its door."""

from collections import deque
from typing import Protocol


class SerialDevice(Protocol):
    """A device that hears bytes and puts answers into its outbox, each with the time at which it begins to send it.

    What has not begun to be sent yet the device may still take back.
    """

    baudrate: int
    outbox: deque[tuple[float, bytes]]

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`."""

    def reset(self, t: float) -> None:
        """Power fails and comes back: what is not kept in its memory it has forgotten."""
