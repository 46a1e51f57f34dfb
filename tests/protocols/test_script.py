"""Frames of scripts: the bytes that pymodbus makes of the same requests and replies, and reads as the same values."""

from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerSocket
from pymodbus.pdu import DecodePDU
from pymodbus.pdu.bit_message import ReadCoilsRequest, ReadCoilsResponse, WriteMultipleCoilsRequest, WriteMultipleCoilsResponse
from pymodbus.pdu.register_message import ReadHoldingRegistersRequest, ReadHoldingRegistersResponse

from goniotwin.protocols import script
from goniotwin.protocols.script import HEADER

WORD, BYTE = st.integers(0, 0xFFFF), st.integers(0, 0xFF)
SERVER = FramerSocket(DecodePDU(True))
STATES = st.lists(st.booleans(), min_size=1, max_size=8)


def frame(transaction: int, unit: int, pdu: bytes) -> bytes:
    return HEADER.pack(transaction, 0, 1 + len(pdu), unit) + pdu


@given(WORD, BYTE, WORD, st.integers(1, 125))
def test_a_read_of_registers_is_that_of_pymodbus(transaction: int, unit: int, address: int, count: int) -> None:
    request = ReadHoldingRegistersRequest(address=address, count=count, dev_id=unit, transaction_id=transaction)
    assert frame(transaction, unit, script.read_registers(address, count)) == SERVER.buildFrame(request)


@given(WORD, BYTE, st.lists(WORD, min_size=1, max_size=125))
def test_the_reply_with_registers_is_that_of_pymodbus(transaction: int, unit: int, values: list[int]) -> None:
    reply = ReadHoldingRegistersResponse(registers=values, dev_id=unit, transaction_id=transaction)
    assert frame(transaction, unit, script.registers(values)) == SERVER.buildFrame(reply)


@given(WORD, BYTE, WORD, STATES)
def test_reads_and_writes_of_coils_are_those_of_pymodbus(transaction: int, unit: int, address: int, states: list[bool]) -> None:
    about: dict[str, Any] = {"dev_id": unit, "transaction_id": transaction}
    read = ReadCoilsRequest(address=address, count=len(states), **about)
    written = WriteMultipleCoilsRequest(address=address, bits=states, **about)
    confirmed = WriteMultipleCoilsResponse(address=address, count=len(states), **about)
    assert frame(transaction, unit, script.read_coils(address, len(states))) == SERVER.buildFrame(read)
    assert frame(transaction, unit, script.coils(states)) == SERVER.buildFrame(ReadCoilsResponse(bits=states, **about))
    pdu = script.write_coils(address, states)
    assert frame(transaction, unit, pdu) == SERVER.buildFrame(written)
    assert frame(transaction, unit, pdu[:5]) == SERVER.buildFrame(confirmed)


@given(WORD, BYTE, st.lists(WORD, min_size=8, max_size=8), st.data())
def test_a_reply_matches_its_request_alone(transaction: int, unit: int, values: list[int], data: st.DataObject) -> None:
    pdu = script.registers(values)
    request, reply = frame(transaction, unit, script.read_registers(0, 8)), frame(transaction, unit, pdu)
    exact, any_values = (script.modbus_exchange(unit, script.read_registers(0, 8), each) for each in (pdu, None))
    assert request[2:] == exact.sent
    assert matches(exact, request, reply)
    assert matches(any_values, request, reply)
    place = data.draw(st.integers(0, len(reply) - 1))
    other = reply[:place] + bytes((reply[place] ^ data.draw(st.integers(1, 0xFF)),)) + reply[place + 1 :]
    assert not matches(exact, request, other)
    assert matches(any_values, request, other) is (place >= len(reply) - 16)
    for wrong in (reply[:-1], reply + b"\0", b""):
        assert not matches(any_values, request, wrong)
    made = [(0.0, request, 1.0, each) for each in (reply, reply, other, reply)]
    assert script.count_matching([exact] * 4, made) == 2


def matches(exchange: script.ModbusExchange, request: bytes, reply: bytes) -> bool:
    return script.count_matching([exchange], [(0.0, request, 1.0, reply)]) == 1
