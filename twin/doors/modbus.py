"""pymodbus's door: its synchronous client with the socket's place taken by a twin device.

Framing, PDUs and transactions stay pymodbus's, on both sides of the wire.
"""

from collections.abc import Sequence

from pymodbus.client import ModbusTcpClient
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU, ExceptionResponse, ModbusPDU
from pymodbus.pdu.bit_message import ReadCoilsResponse, WriteMultipleCoilsResponse, WriteSingleCoilResponse
from pymodbus.pdu.register_message import (
    ReadHoldingRegistersResponse,
    ReadInputRegistersResponse,
    WriteMultipleRegistersResponse,
    WriteSingleRegisterResponse,
)

from twin.devices.adam6017 import Adam6017, ModbusFault
from twin.doors.registry import find, missing

ILLEGAL_FUNCTION = 1


class TwinModbusClient(ModbusTcpClient):
    """A Modbus client whose server is a twin device, found by its `twin://` address. Raises NoSuchTwin."""

    def __init__(self, address: str, *, timeout: float = 1.0, trace_packet: object = None) -> None:
        super().__init__(address, timeout=timeout, retries=0, trace_packet=trace_packet)  # type: ignore[arg-type]
        rig, name = find(address)
        if name not in rig.modbus:
            raise missing(address, {**rig.modbus})
        self._clock = rig.clock
        self._device = rig.modbus[name]
        self._server = FramerSocket(DecodePDU(is_server=True))
        self._answers: list[tuple[float, bytes]] = []
        self._open = False

    @property
    def connected(self) -> bool:
        """Whether `connect` has been called and `close` has not."""
        return self._open

    def connect(self) -> bool:
        """There is nothing to dial."""
        self._open = True
        return True

    def close(self) -> None:
        """Answers on their way are lost."""
        self._open = False
        self._answers.clear()

    def send(self, request: bytes, addr: tuple[str, int] | None = None) -> int:
        """Brings a request's bytes to the device, which answers after its latency."""
        del addr
        arrival = self._clock.now() + 0.5 * self._device.latency_s
        used, pdu = self._server.handleFrame(request, 0, 0)
        if used and pdu is not None and pdu.dev_id == self._device.unit:
            answer = answered(self._device, pdu, arrival)
            answer.transaction_id, answer.dev_id = pdu.transaction_id, pdu.dev_id
            self._answers.append((arrival + 0.5 * self._device.latency_s, self._server.buildFrame(answer)))
        return len(request)

    def recv(self, size: int | None) -> bytes:
        """The next answer's bytes; none after the timeout."""
        del size
        deadline = self._clock.now() + self.comm_params.timeout_connect
        if not self._answers or self._answers[0][0] > deadline:
            self._clock.sleep_until(deadline)
            return b""
        ready, data = self._answers.pop(0)
        self._clock.sleep_until(ready)
        return data


def answered(device: Adam6017, request: ModbusPDU, t: float) -> ModbusPDU:
    """The response of a device to a request that arrives at `t`, an exception response where it refuses."""
    try:
        return _response(device, request, t)
    except ModbusFault as fault:
        return ExceptionResponse(request.function_code, fault.code)


def _response(device: Adam6017, request: ModbusPDU, t: float) -> ModbusPDU:
    address, count = request.address, request.count
    match request.function_code:
        case 3:
            return ReadHoldingRegistersResponse(registers=device.registers(address, count, t))
        case 4:
            return ReadInputRegistersResponse(registers=device.registers(address, count, t))
        case 1:
            return ReadCoilsResponse(bits=device.coils(address, count))
        case 6:
            device.write_registers(address, list(request.registers[:1]), t)
            return WriteSingleRegisterResponse(address=address, registers=request.registers[:1])
        case 16:
            device.write_registers(address, list(request.registers), t)
            return WriteMultipleRegistersResponse(address=address, count=len(request.registers))
        case 5:
            device.write_coils(address, _first(request.bits, 1), t)
            return WriteSingleCoilResponse(address=address, bits=request.bits[:1])
        case 15:
            device.write_coils(address, _first(request.bits, count), t)
            return WriteMultipleCoilsResponse(address=address, count=count)
    return ExceptionResponse(request.function_code, ILLEGAL_FUNCTION)


def _first(bits: Sequence[bool], count: int) -> list[bool]:
    """The bits that were sent, without those that fill up the last byte."""
    return [bool(bit) for bit in bits[:count]]
