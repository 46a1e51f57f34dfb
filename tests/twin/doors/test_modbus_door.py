"""pymodbus's door: its own client, framing and PDUs against the virtual ADAM-6017."""

import pytest
from pymodbus.exceptions import ModbusIOException

from protocols import adam
from protocols.clock import VirtualClock
from tests.conftest import RigOpener
from twin.doors import NoSuchTwin, TwinModbusClient


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(50.0)


@pytest.fixture
def client(opened: RigOpener, clock: VirtualClock) -> TwinModbusClient:
    opened(("noise = true", "noise = false"), clock=clock)
    clock.sleep_until(60.0)
    return TwinModbusClient("twin://virtual/adc-0")


def test_the_module_says_who_it_is(client: TwinModbusClient) -> None:
    assert client.read_holding_registers(adam.MODULE_NAME, count=2).registers == [0x6017, 0x0000]
    assert client.read_input_registers(adam.MODULE_NAME, count=1).registers == [0x6017]


def test_a_read_takes_the_modules_latency(client: TwinModbusClient, clock: VirtualClock) -> None:
    start = clock.now()
    client.read_holding_registers(adam.AI_VALUE, count=8)
    assert clock.now() - start == pytest.approx(4e-4)


def test_dark_photodiodes_read_their_dark_current(client: TwinModbusClient, clock: VirtualClock) -> None:
    client.write_coils(adam.DIGITAL_OUTPUT, [True, True])  # gain 3: 1e11 V/A
    clock.sleep_until(clock.now() + 1.0)
    volts = [
        adam.RANGES[adam.PLUS_MINUS_10_V].volts(raw) for raw in client.read_holding_registers(adam.AI_VALUE, count=8).registers
    ]
    # 2 pA with a spread of 5 % at 1e11 V/A, and an offset of 1 mV
    assert volts == pytest.approx([0.201] * 8, abs=0.04)
    assert len(set(volts)) > 1


@pytest.mark.parametrize(("address", "count"), [(300, 1), (7, 2), (99, 1)])
def test_an_address_without_a_register_is_exception_2(client: TwinModbusClient, address: int, count: int) -> None:
    answer = client.read_holding_registers(address, count=count)
    assert answer.isError()
    assert answer.exception_code == 2


def test_a_range_code_that_does_not_exist_is_exception_3(client: TwinModbusClient) -> None:
    assert client.write_register(adam.RANGE_CODE, 0x9999).exception_code == 3
    assert not client.write_register(adam.RANGE_CODE, 0x0148).isError()
    assert client.read_holding_registers(adam.RANGE_CODE, count=1).registers == [0x0148]


def test_another_function_is_exception_1(client: TwinModbusClient) -> None:
    assert client.read_discrete_inputs(0, count=1).exception_code == 1


def test_outputs_are_read_back(client: TwinModbusClient) -> None:
    client.write_coil(adam.DIGITAL_OUTPUT + 1, True)
    assert client.read_coils(adam.DIGITAL_OUTPUT, count=2).bits[:2] == [False, True]


def test_a_foreign_unit_is_silent(client: TwinModbusClient, clock: VirtualClock) -> None:
    start = clock.now()
    with pytest.raises(ModbusIOException):
        client.read_holding_registers(adam.AI_VALUE, count=1, device_id=9)
    assert clock.now() - start == pytest.approx(1.0)  # the timeout, once: no retries


def test_there_is_no_client_for_nothing(opened: RigOpener) -> None:
    opened()
    with pytest.raises(NoSuchTwin, match="adc-9"):
        TwinModbusClient("twin://virtual/adc-9")
