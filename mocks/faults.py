"""Wires that fail on purpose: the fault of an exchange is a function of the seed and the number of the exchange.

A fault sits between a device and its clients, in process and on real endpoints alike. The device itself works;
requests or replies do not arrive as they were sent.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from enum import StrEnum

import numpy as np

from goniotwin.twin.plant.noise import mix
from goniotwin.twin.plant.process_key import process_key


class Fault(StrEnum):
    """Fault of one exchange."""

    NONE = "none"
    LATE = "late reply"
    LOST = "reply lost"
    UNHEARD = "request lost"
    TRUNCATED = "truncated reply"
    MERGED = "reply merged with the next"
    CORRUPTED = "corrupted reply"
    GARBLED = "corrupted request"
    REPEATED = "repeated reply"
    FOREIGN = "reply of another address"
    NOISE = "noise before the reply"
    HANG = "hang"
    UNPLUGGED = "unplugged and plugged in again"
    RESET = "device resets itself"
    EXCEPTION = "Modbus exception"
    STALL = "USB stall"
    NAK = "USB NAK"


_ANY_STREAM = (
    Fault.LATE,
    Fault.LOST,
    Fault.UNHEARD,
    Fault.TRUNCATED,
    Fault.MERGED,
    Fault.CORRUPTED,
    Fault.GARBLED,
    Fault.REPEATED,
    Fault.NOISE,
    Fault.HANG,
    Fault.UNPLUGGED,
    Fault.RESET,
)
ON_A_TEXT_LINE = _ANY_STREAM
"""A line of ASCII to one device: there are no addresses."""
ON_A_SERIAL_LINE = (*_ANY_STREAM, Fault.FOREIGN)
"""A line of frames with addresses."""
ON_MODBUS_RTU = (*ON_A_SERIAL_LINE, Fault.EXCEPTION)
ON_MODBUS = tuple(each for each in ON_MODBUS_RTU if each is not Fault.GARBLED)
"""Modbus TCP. A changed request is a right request for something else: see docs/rig/faults.md."""
ON_USB = (
    Fault.LATE,
    Fault.LOST,
    Fault.UNHEARD,
    Fault.TRUNCATED,
    Fault.CORRUPTED,
    Fault.HANG,
    Fault.UNPLUGGED,
    Fault.RESET,
    Fault.STALL,
    Fault.NAK,
)
"""The bus itself handles addresses, order, checksums and repetition, so that nothing is merged, repeated or garbled."""


@dataclass
class FaultPlan:
    """Seeded random faults. A `share` of the exchanges fail, each with one of `kinds`; after `until` exchanges none does.

    A hang lasts `hang` exchanges.
    """

    seed: int
    kinds: tuple[Fault, ...]
    share: float = 0.2
    until: int = 1 << 30
    hang: int = 3

    def __post_init__(self) -> None:
        self._key = process_key(self.seed, "misfortune")
        self._count = 0
        self._hung = 0
        self.met: list[Fault] = []

    def next(self) -> Fault:
        """Fault of the next exchange."""
        number = self._count
        self._count += 1
        if self._hung:
            self._hung -= 1
            return Fault.HANG
        if number >= self.until or self.draw(number, 1 << 20) >= self.share * (1 << 20):
            return Fault.NONE
        fault = self.kinds[self.draw(number + (1 << 32), len(self.kinds))]
        self.met.append(fault)
        if fault is Fault.HANG:
            self._hung = self.hang - 1
        return fault

    def draw(self, number: int, below: int) -> int:
        """A number from 0 to `below` - 1, of the seed and `number`."""
        return int(mix(self._key, np.int64(number)) >> np.uint64(16)) % below

    @property
    def exchanges(self) -> int:
        """Number of exchanges so far."""
        return self._count


class ScriptedFaults(FaultPlan):
    """Given faults, one an exchange, in order; then none. The seed decides which byte is changed and where a reply is cut."""

    def __init__(self, faults: Iterable[Fault], seed: int = 0) -> None:
        super().__init__(seed, ())
        self.script = list(faults)
        """The faults to come."""

    def next(self) -> Fault:
        """Fault of the next exchange."""
        self._count += 1
        fault = self.script.pop(0) if self.script else Fault.NONE
        if fault is not Fault.NONE:
            self.met.append(fault)
        return fault


def corrupt(data: bytes, misfortune: FaultPlan) -> bytes:
    """Change one byte: in one bit, so that a digit often remains a digit, or in any bits."""
    if not data:
        return data
    place = misfortune.draw(misfortune.exchanges + (1 << 33), len(data))
    kind = misfortune.draw(misfortune.exchanges + (1 << 34), 16)
    change = 1 << kind if kind < 8 else 1 + misfortune.draw(misfortune.exchanges + (1 << 40), 255)
    return data[:place] + bytes((data[place] ^ change,)) + data[place + 1 :]


def truncate(data: bytes, misfortune: FaultPlan) -> bytes:
    """Cut the end off."""
    return data[: misfortune.draw(misfortune.exchanges + (1 << 35), max(1, len(data)))]


def noise(misfortune: FaultPlan) -> bytes:
    """One to four random bytes."""
    length = 1 + misfortune.draw(misfortune.exchanges + (1 << 36), 4)
    return bytes(misfortune.draw(misfortune.exchanges + (1 << 37) + k, 256) for k in range(length))
