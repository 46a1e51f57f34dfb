"""Exchanges handed to a wire together: what is sent and when, and what comes back.

A wire that can look ahead (the virtual rig's, on a virtual clock) carries out a script at once; what it sends and receives, and
when, is the same as one exchange after the other. It carries out as many exchanges as give the expected replies, and leaves
the first other one, and all after it, to be made singly.
"""

from collections.abc import Iterable, Sequence
from struct import Struct
from typing import NamedTuple, Protocol, runtime_checkable

HEADER = Struct(">HHHB")
"""Of a Modbus TCP frame: transaction, protocol, bytes from the unit on, unit. Source: Modbus on TCP/IP 1.0b, 3.1.3."""
TRANSACTION = 2
"""Bytes of a Modbus TCP frame that name its transaction."""
EIGHT_REGISTERS, EIGHT_REGISTERS_BYTES = bytes((3, 16)), 25
"""Begin of the PDU, and length of the frame, that has eight registers."""
_WORDS = Struct(">BHH")


Exchanged = tuple[float, bytes, float, bytes]
"""An exchange that was made: the time at which it begins, s, the request, the time at which all has come back, s, the reply."""


class ModbusExchange(NamedTuple):
    """An exchange of PDUs with a unit, prepared: see `modbus_exchange`.

    `expected` is the reply that it must have; None: eight registers. `sent` is the frame of the request after its transaction,
    `begins` what the frame of the reply has after the same transaction, up to the values, and `length` that of the frame.
    """

    unit: int
    request: bytes
    expected: bytes | None
    sent: bytes
    begins: bytes
    length: int


def modbus_exchange(unit: int, request: bytes, expected: bytes | None) -> ModbusExchange:
    """An exchange with its frames."""
    pdu, length = (EIGHT_REGISTERS, EIGHT_REGISTERS_BYTES) if expected is None else (expected, HEADER.size + len(expected))
    sent = HEADER.pack(0, 0, 1 + len(request), unit) + request
    begins = HEADER.pack(0, 0, length - HEADER.size + 1, unit) + pdu
    return ModbusExchange(unit, request, expected, sent[TRANSACTION:], begins[TRANSACTION:], length)


ModbusScript = Sequence[tuple[float, "ModbusScripts", ModbusExchange]]
"""Exchanges in their order, each with the time before which it does not begin, s, and its client."""


@runtime_checkable
class ModbusScripts(Protocol):
    """A Modbus client that carries out scripts, also for other clients of its kind."""

    def run_script(self, script: ModbusScript, slack_s: float) -> list[Exchanged]:
        """Make the first exchanges of a script, none that would begin more than `slack_s` after it is due.

        The clock is left where it is: the caller moves it to the arrival of the last reply, or to each on the way.
        """


@runtime_checkable
class TmclScripts(Protocol):
    """A serial port that carries out scripts on a TMCL line."""

    def run_script(self, requests: Sequence[tuple[bytes, bytes]]) -> list[Exchanged]:
        """Make the first exchanges, each when the reply to the one before has arrived.

        Each is a request, which is either refused without any effect or has one reply, and the bytes with which that has to
        begin. The clock is left where it is, as in `ModbusScripts`.
        """


@runtime_checkable
class UsbScripts(Protocol):
    """The end of an open USB device that carries out scripts."""

    def run_script(self, transfers: Sequence[bytes], timeout_s: float) -> list[Exchanged]:
        """Make the first transfers, each at once after the one before: what is written to bulk OUT, and what bulk IN then has.

        A transfer that requests an answer is made where that is whole and comes within `timeout_s`. Of others the reply is
        empty, and comes when they go out. The clock is left where it is, as in `ModbusScripts`.
        """


@runtime_checkable
class UsbScriptBackend(Protocol):
    """A backend of pyusb whose devices may carry out scripts."""

    def scripts(self, address: int) -> UsbScripts | None:
        """The end of the device with an address on the bus, which is open now; None where it carries out none."""


def count_matching(exchanges: Iterable[ModbusExchange], made: Sequence[Exchanged]) -> int:
    """How many of the first exchanges have the reply that they must have.

    It has the transaction of its request, protocol, unit, length, and the expected PDU; without that, one of eight registers.
    """
    for k, ((_, _, _, _, begins, length), (_, request, _, reply)) in enumerate(zip(exchanges, made, strict=False)):
        begin = request[:TRANSACTION] + begins
        if reply != begin and (len(begin) == length or len(reply) != length or not reply.startswith(begin)):
            return k
    return len(made)


def read_registers(address: int, count: int) -> bytes:
    """The PDU of function 03. Source: Modbus Application Protocol 1.1b3, 6.3."""
    return _WORDS.pack(3, address, count)


def registers(values: Sequence[int]) -> bytes:
    """The reply to `read_registers`."""
    return bytes((3, 2 * len(values))) + b"".join(value.to_bytes(2, "big") for value in values)


def read_coils(address: int, count: int) -> bytes:
    """The PDU of function 01; 6.1."""
    return _WORDS.pack(1, address, count)


def coils(states: Sequence[bool]) -> bytes:
    """The reply to `read_coils` with up to eight coils, the first in the lowest bit."""
    return bytes((1, 1, _packed(states)))


def write_coils(address: int, states: Sequence[bool]) -> bytes:
    """The PDU of function 15 with up to eight coils; 6.11. Its confirmation are its first five bytes."""
    return _WORDS.pack(15, address, len(states)) + bytes((1, _packed(states)))


def _packed(states: Sequence[bool]) -> int:
    return sum(1 << place for place, on in enumerate(states) if on)
