"""A serial line that fails: it stands in for the device at the door or at the endpoint."""

from collections import deque
from collections.abc import Callable

from mocks.faults import Fault, Misfortune, corrupted, noise, truncated
from twin.devices.line import SerialDevice

Foreign = Callable[[bytes], bytes]


class FaultyLine:
    """`device` behind a bad wire. `late_s` is how much too late a late reply is.

    `foreign` makes of a reply one of another address, with a checksum that is right; a wire without addresses has none.
    """

    def __init__(
        self, device: SerialDevice, misfortune: Misfortune, late_s: float = 0.1, foreign: Foreign | None = None
    ) -> None:
        self.device = device
        self.misfortune = misfortune
        self.baudrate = device.baudrate
        self.outbox: deque[tuple[float, bytes]] = device.outbox
        self._late_s = late_s
        self._foreign = foreign
        self._held: list[bytes] = []

    def receive(self, data: bytes, t: float) -> None:
        """Brings the bytes to the device, or not, and does to its replies what is to happen to them."""
        fault = self.misfortune.next()
        if fault in (Fault.UNHEARD, Fault.HANG):
            return
        if fault is Fault.RESET:
            self.device.reset(t)
        there = len(self.outbox)
        self.device.receive(corrupted(data, self.misfortune) if fault is Fault.GARBLED else data, t)
        replies = [self.outbox.pop() for _ in range(len(self.outbox) - there)][::-1]
        for ready, reply in replies:
            self.outbox.extend(self._failed(fault, ready, reply))

    def reset(self, t: float) -> None:
        """Of the device behind it."""
        self.device.reset(t)

    def _failed(self, fault: Fault, ready: float, reply: bytes) -> list[tuple[float, bytes]]:
        held, self._held = b"".join(self._held), []
        match fault:
            case Fault.LATE:
                return [(ready + self._late_s, held + reply)]
            case Fault.LOST:
                return []
            case Fault.TRUNCATED:
                return [(ready, held + truncated(reply, self.misfortune))]
            case Fault.MERGED:
                self._held = [held + reply]
                return []
            case Fault.CORRUPTED:
                return [(ready, held + corrupted(reply, self.misfortune))]
            case Fault.REPEATED:
                return [(ready, held + reply + reply)]
            case Fault.FOREIGN if self._foreign is not None:
                return [(ready, held + self._foreign(reply))]
            case Fault.NOISE:
                return [(ready, noise(self.misfortune) + held + reply)]
        return [(ready, held + reply)]
