"""A Modbus wire: one client and whoever may talk over it, one at a time; and what is done before it is believed again.

A TCP connection has one module, an RTU line several. Over TCP a late answer is known by its transaction identifier; after
a fault the connection is given up, and with it whatever was still under way. Over RTU a late answer is the next
question's answer: after a fault the line is listened to until it is quiet, and the module then has to answer a marker
(see `drivers.photodiodes.adam`). The library's own retries are off: a retry that reuses an identifier takes a late answer
for its own.
"""

import contextlib
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU

from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from goniotwin.protocols import adam

Trace = Callable[[bool, bytes], bytes]
ModbusOpener = Callable[[Trace | None], ModbusBaseSyncClient]
"""Makes the client of a wire; takes what pymodbus calls with each packet."""

WIRE_FAULTS = (ModbusException, OSError, ValueError, LookupError, struct.error)
"""What pymodbus throws when a wire fails, or carries what it cannot read."""
QUIET_S = 0.1
DRAINED_CHUNKS = 8


def in_words(error: Exception) -> str:
    """What has happened to the wire, without the library's advice to programmers."""
    if isinstance(error, ModbusIOException):
        told = error.string.removeprefix("[Input/Output] ").removeprefix("ERROR: ")
        return "no answer" if told.startswith("No response") else told
    if isinstance(error, ConnectionException):
        return "the connection cannot be made, or is gone"
    return str(error) or type(error).__name__


class ModbusBus:
    """One wire. `line` says that it is an RTU line, without transaction identifiers."""

    def __init__(self, opener: ModbusOpener, *, line: bool = False) -> None:
        self.line = line
        self.lock = threading.RLock()
        self.stale = False
        self._opener = opener
        self._client: ModbusBaseSyncClient | None = None
        self._users: set[int] = set()
        self._tap: Tap = no_tap
        self._heard = b""

    def open(self, user: object) -> bool:
        """Connects, unless another user has; whether somebody is there. Raises WIRE_FAULTS for an address that is none."""
        with self.lock:
            if self._client is None:
                self._client = self._opener(self._trace)
            self._users.add(id(user))
            return bool(self._client.connect())

    def close(self, user: object) -> None:
        """Gives the connection back once nobody uses it any more."""
        with self.lock:
            self._users.discard(id(user))
            if not self._users and self._client is not None:
                self._client.close()  # type: ignore[no-untyped-call]
                self._client = None

    def ask(self, call: Callable[[ModbusBaseSyncClient], ModbusPDU], tap: Tap) -> ModbusPDU:
        """One exchange. Raises WIRE_FAULTS; what comes back may still answer something else.

        A connection or port that fails is given up: `renew` makes another one.
        """
        if self._client is None:
            raise ConnectionError("the connection is not open")
        self._tap, self._heard = tap, b""
        try:
            return call(self._client)
        except OSError:
            self._give_up()
            raise
        finally:
            self._tap(FROM_DEVICE, self._heard)

    def renew(self) -> bool:
        """Rids the wire of what is still under way; whether it is connected. Raises WIRE_FAULTS."""
        if self._client is None:
            return False
        if not self.line:
            self._client.close()  # type: ignore[no-untyped-call]
            return bool(self._client.connect())
        if not self._client.connect():
            return False
        timeout = self._client.comm_params.timeout_connect
        self._client.comm_params.timeout_connect = min(QUIET_S, timeout)
        try:
            for _ in range(DRAINED_CHUNKS):
                late = self._client.recv(None)
                self._tap(FROM_DEVICE, late)
                if not late:
                    break
        except OSError:
            self._give_up()
            raise
        finally:
            self._client.comm_params.timeout_connect = timeout
        return True

    def _give_up(self) -> None:
        assert self._client is not None
        with contextlib.suppress(OSError):
            self._client.close()  # type: ignore[no-untyped-call]

    def _trace(self, sending: bool, data: bytes) -> bytes:
        """pymodbus shows an answer again with each piece that has come; the tap gets it once."""
        if sending:
            self._tap(TO_DEVICE, data)
        else:
            if not data.startswith(self._heard):
                self._tap(FROM_DEVICE, self._heard)
            self._heard = data
        return data


@dataclass
class ModbusUnit:
    """Where a module is: on which wire, at which unit address."""

    bus: ModbusBus
    unit: int = adam.UNIT
    tap: Tap = field(default=no_tap)


FUNCTIONS = {
    1: "read coils",
    3: "read registers",
    4: "read input registers",
    5: "write coil",
    6: "write register",
    15: "write coils",
    16: "write registers",
}
MBAP = 7


def explain(direction: str, data: bytes) -> str:
    """A Modbus TCP frame in words, for transcripts."""
    if len(data) < MBAP + 2:
        return "too short for a Modbus TCP frame"
    return _explained(direction, f", transaction {int.from_bytes(data[:2], 'big')}", data[MBAP - 1 :])


def explain_rtu(direction: str, data: bytes) -> str:
    """A Modbus RTU frame in words, for transcripts."""
    if len(data) < 5:
        return "too short for a Modbus RTU frame"
    return _explained(direction, "", data[:-2])


def _explained(direction: str, transaction: str, data: bytes) -> str:
    unit, function, body = data[0], data[1] & 0x7F, data[2:]
    head = f"{FUNCTIONS.get(function, f'function {function}')}{transaction}, unit {unit}"
    if data[1] & 0x80:
        return f"{head}: exception {body[0]}"
    if direction == FROM_DEVICE and function in (3, 4):
        return f"{head}: {' '.join(str(int.from_bytes(body[at : at + 2], 'big')) for at in range(1, len(body) - 1, 2))}"
    return f"{head}: {' '.join(str(int.from_bytes(body[at : at + 2], 'big')) for at in (0, 2) if at + 2 <= len(body))}"
