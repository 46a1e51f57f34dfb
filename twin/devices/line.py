"""Interface of a device on a serial line."""

from collections import deque
from typing import Protocol

BITS_A_BYTE = 10
"""A byte on the line: a start bit, eight data bits, a stop bit."""


class SerialDevice(Protocol):
    """A device that receives bytes and puts answers into its outbox, each with the start time of its transmission.

    The device may remove answers whose transmission has not started.
    """

    baudrate: int
    outbox: deque[tuple[float, bytes]]

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`."""

    def reset(self, t: float) -> None:
        """Power cycle: everything outside non-volatile memory is lost."""
