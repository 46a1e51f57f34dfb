"""A Modbus wire: one client, shared by the modules on it, and its renewal after a fault.

A TCP connection has one module, an RTU line several. Over TCP the transaction identifier shows a late reply; after a fault
the connection is closed, with everything still in transmission. Over RTU a late reply would be taken for the next one:
after a fault the line is read until it is quiet, and the module must then return a marker (see `photodiodes.registers`).
The library's own retries are off: a retry that reuses an identifier would accept a late reply.

An exchange ends after one timeout, however its reply is divided, and whatever else the wire brings.
"""

import contextlib
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from pymodbus.client import ModbusSerialClient
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.exceptions import ConnectionException, ModbusException, ModbusIOException
from pymodbus.pdu import ModbusPDU

from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from goniotwin.protocols import adam
from goniotwin.protocols.clock import Clock

Trace = Callable[[bool, bytes], bytes]
ModbusOpener = Callable[[Trace | None], ModbusBaseSyncClient]
"""Makes the client of a wire; takes the function that pymodbus calls with each packet."""

WIRE_FAULTS = (ModbusException, OSError, ValueError, LookupError, struct.error)
"""Exceptions of pymodbus for a wire that fails, or for bytes that it cannot decode."""
QUIET_S = 0.1
DRAINED_CHUNKS = 8
CHUNK = 256
LONGEST_RECEIVED = 4096
"""More bytes than any reply, with what a wire may bring before it."""
SHORTEST_WAIT_S = 1e-3
NOT_QUIET = "it does not stop sending"


def describe_fault(error: Exception) -> str:
    """A fault of the wire as text, without the library's advice to programmers."""
    if isinstance(error, ModbusIOException):
        text = error.string.removeprefix("[Input/Output] ").removeprefix("ERROR: ")
        return "not responding" if text.startswith("No response") else text
    if isinstance(error, ConnectionException):
        return "no connection"
    return str(error) or type(error).__name__


class RtuClient(ModbusSerialClient):
    """pymodbus's client for a serial port, but its waits are the port's own.

    The library's go by the calendar, which may be set, and a computer that is late gives up before it has looked.
    """

    def recv(self, size: int | None) -> bytes:
        """What comes until a short silence; nothing after the timeout. Raises ConnectionException."""
        del size
        port = self.socket
        if port is None:
            raise ConnectionException(str(self))
        try:
            port.timeout = self.comm_params.timeout_connect
            data = bytes(port.read(1))
            port.timeout = self._recv_interval
            while data and len(data) < LONGEST_RECEIVED and (chunk := port.read(CHUNK)):
                data += chunk
        except OSError:
            self.close()  # type: ignore[no-untyped-call]  # pymodbus gives it no types
            raise ConnectionException(str(self)) from None
        return data


class ModbusBus:
    """One wire. `rtu`: an RTU line, without transaction identifiers. `stale`: a late reply may still arrive.

    `noisy`: at the last renewal it did not fall silent. `late_s` is by how much this computer was late in the last exchange
    that failed, s; a reply had `timeout_s`.
    """

    def __init__(self, opener: ModbusOpener, *, rtu: bool = False) -> None:
        self.rtu = rtu
        self.lock = threading.RLock()
        self.stale = self.noisy = False
        self.late_s, self.timeout_s = 0.0, 0.0
        self._clock: Clock | None = None
        self._deadline = self._waiting_since = 0.0
        self._over = False
        self._opener = opener
        self._client: ModbusBaseSyncClient | None = None
        self._users: set[int] = set()
        self._tap: Tap = no_tap
        self._received = b""

    def open(self, user: object) -> bool:
        """Connect, unless another user has; True if connected. Raises WIRE_FAULTS for a wrong address."""
        with self.lock:
            if self._client is None:
                self._client = self._opener(self._trace)
            self._users.add(id(user))
            return bool(self._client.connect())

    def close(self, user: object) -> None:
        """Close the connection after its last user."""
        with self.lock:
            self._users.discard(id(user))
            if not self._users and self._client is not None:
                self._client.close()
                self._client = None

    def exchange(self, call: Callable[[ModbusBaseSyncClient], ModbusPDU], tap: Tap, clock: Clock) -> ModbusPDU:
        """One exchange, timed by `clock`; the caller checks that the reply belongs to its request. Raises WIRE_FAULTS.

        A connection or port that fails is closed: `renew` opens another one.
        """
        client = self._client
        if client is None:
            raise ConnectionError("the connection is not open")
        settings = client.comm_params
        timeout_s = self.timeout_s = settings.timeout_connect
        now = clock.now()
        self._tap, self._received, self._clock, self._over = tap, b"", clock, False
        self._waiting_since, self._deadline = now, now + timeout_s
        try:
            return call(client)
        except WIRE_FAULTS as error:
            self.late_s = clock.now() - self._waiting_since - settings.timeout_connect
            if isinstance(error, OSError):
                self._close_client()
            raise
        finally:
            settings.timeout_connect = timeout_s
            self._clock = None
            tap(FROM_DEVICE, self._received)

    def renew(self) -> bool:
        """Discard everything still in transmission; True if connected. Raises WIRE_FAULTS."""
        if self._client is None:
            return False
        if not self.rtu:
            self._client.close()
            return bool(self._client.connect())
        if not self._client.connect():
            return False
        timeout = self._client.comm_params.timeout_connect
        self._client.comm_params.timeout_connect = min(QUIET_S, timeout)
        try:
            for _ in range(DRAINED_CHUNKS):
                late = self._client.recv(None)
                self._tap(FROM_DEVICE, late)
                self.noisy = bool(late)
                if not late:
                    break
        except OSError:
            self._close_client()
            raise
        finally:
            self._client.comm_params.timeout_connect = timeout
        if self.noisy:
            raise ModbusIOException(NOT_QUIET)
        return True

    def _close_client(self) -> None:
        assert self._client is not None
        with contextlib.suppress(OSError):
            self._client.close()

    def _trace(self, sending: bool, data: bytes) -> bytes:
        """Pass packets to the tap. pymodbus repeats a reply with each piece that is received; the tap gets it once.

        Each piece shortens the wait for the next one. Raises ModbusException after the deadline: a piece that comes first then
        is accepted, because a computer that was late finds a reply that came in time.
        """
        if sending:
            self._tap(TO_DEVICE, data)
        else:
            if not data.startswith(self._received):
                self._tap(FROM_DEVICE, self._received)
            self._received = data
            if self._clock is not None and self._client is not None:
                now = self._clock.now()
                if self._over or len(data) > LONGEST_RECEIVED:
                    raise ModbusIOException(NOT_QUIET)
                self._over, self._waiting_since = now > self._deadline, now
                self._client.comm_params.timeout_connect = max(self._deadline - now, SHORTEST_WAIT_S)
        return data


@dataclass
class ModbusUnit:
    """Address of a module: its wire and its unit; the settings that are found there."""

    bus: ModbusBus
    unit: int = adam.UNIT
    tap: Tap = field(default=no_tap)
    found: FoundSettings = field(default_factory=FoundSettings)


FUNCTIONS = {
    1: "read coils",
    3: "read registers",
    4: "read input registers",
    5: "write coil",
    6: "write register",
    15: "write coils",
    16: "write registers",
}


def explain(direction: str, data: bytes) -> str:
    """A Modbus TCP frame as text, for transcripts."""
    if len(data) < adam.MBAP + 2:
        return "too short for a Modbus TCP frame"
    return _explain_pdu(direction, f", transaction {int.from_bytes(data[:2], 'big')}", data[adam.MBAP - 1 :])


def explain_rtu(direction: str, data: bytes) -> str:
    """A Modbus RTU frame as text, for transcripts."""
    if len(data) < 5:
        return "too short for a Modbus RTU frame"
    return _explain_pdu(direction, "", data[:-2])


def _explain_pdu(direction: str, transaction: str, data: bytes) -> str:
    unit, function, body = data[0], data[1] & 0x7F, data[2:]
    head = f"{FUNCTIONS.get(function, f'function {function}')}{transaction}, unit {unit}"
    if data[1] & 0x80:
        return f"{head}: exception {body[0]}"
    if direction == FROM_DEVICE and function in (3, 4):
        return f"{head}: {' '.join(str(int.from_bytes(body[at : at + 2], 'big')) for at in range(1, len(body) - 1, 2))}"
    return f"{head}: {' '.join(str(int.from_bytes(body[at : at + 2], 'big')) for at in (0, 2) if at + 2 <= len(body))}"
