"""pymodbus's door: its own client, framing and PDUs against the virtual ADAM-6017."""

import pytest
from pymodbus.exceptions import ModbusIOException

from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.doors import NoSuchTwin, TwinModbusClient, TwinRtuClient
from tests.conftest import RigOpener

SERIAL_MODULES = (
    ('kind = "adam-6017"', 'kind = "adam-4117"'),
    ("gains_v_per_a = [1e6, 1e8, 1e10, 1e11]", "gains_v_per_a = [1e10]"),
    ("[twin.light]", '[twin.electronics]\nmodule = "adam-4117"\ngains_v_per_a = [1e10]\n\n[twin.light]'),
)


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(50.0)


@pytest.fixture
def client(opened: RigOpener, clock: VirtualClock) -> TwinModbusClient:
    rig = opened(("noise = true", "noise = false"), clock=clock)
    clock.sleep_until(60.0)
    return TwinModbusClient(f"twin://{rig._name}/adc-0")  # another test's rig of that name may still be open


def test_the_module_identifies_itself(client: TwinModbusClient) -> None:
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


@pytest.mark.parametrize(("address", "count"), [(300, 1), (8, 2), (99, 1), (9, 1), (48, 1)])
def test_an_address_without_a_register_is_exception_2(client: TwinModbusClient, address: int, count: int) -> None:
    answer = client.read_holding_registers(address, count=count)
    assert answer.isError()
    assert answer.exception_code == 2


def test_a_range_code_that_does_not_exist_is_exception_3(client: TwinModbusClient) -> None:
    assert client.write_register(adam.RANGE_CODE, 0x9999).exception_code == 3
    assert not client.write_register(adam.RANGE_CODE, 0x0148).isError()
    assert client.read_holding_registers(adam.RANGE_CODE, count=1).registers == [0x0148]


def test_another_function_is_exception_1(client: TwinModbusClient) -> None:
    assert client.report_device_id().exception_code == 1
    assert client.readwrite_registers(read_address=0, read_count=1, address=200, values=[0x0143]).exception_code == 1


def test_outputs_are_read_as_coils_and_as_discrete_inputs(client: TwinModbusClient) -> None:
    client.write_coils(adam.DIGITAL_OUTPUT, [True, False])
    assert client.read_coils(adam.DIGITAL_OUTPUT, count=2).bits[:2] == [True, False]
    assert client.read_discrete_inputs(adam.DIGITAL_OUTPUT, count=2).bits[:2] == [True, False]
    assert client.diag_query_data(b"\x12\x34").message == b"\x12\x34"  # type: ignore[attr-defined]


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


@pytest.fixture
def line(opened: RigOpener, clock: VirtualClock) -> TwinRtuClient:
    """The converters of the example rig, were they ADAM-4117 on one line."""
    rig = opened(*SERIAL_MODULES, clock=clock)
    clock.sleep_until(60.0)
    return TwinRtuClient(f"twin://{rig._name}/adc-0")


def test_the_units_of_a_line_answer_each_for_itself(line: TwinRtuClient) -> None:
    for unit in range(1, 6):
        assert line.read_holding_registers(adam.MODULE_NAME, count=2, device_id=unit).registers == [0x4117, 0x0000]


def test_an_rtu_read_takes_its_bytes_and_its_gaps(line: TwinRtuClient, clock: VirtualClock) -> None:
    line.read_holding_registers(adam.AI_VALUE, count=8)
    start = clock.now()
    line.read_holding_registers(adam.AI_VALUE, count=8)
    # 8 and 21 characters, the gap that ends the request, the one that ends the answer, and the module's latency
    assert clock.now() - start == pytest.approx((8 + 21 + 2 * 3.5) * 10 / 9600 + 4e-4, abs=2e-3)


def test_a_foreign_rtu_unit_is_silent_for_one_timeout(line: TwinRtuClient, clock: VirtualClock) -> None:
    start = clock.now()
    with pytest.raises(ModbusIOException):
        line.read_holding_registers(adam.AI_VALUE, count=1, device_id=9)
    assert clock.now() - start == pytest.approx(1.0, abs=0.02)
    assert not line.read_holding_registers(adam.AI_VALUE, count=1).isError()


def test_each_wire_has_its_own_client(line: TwinRtuClient) -> None:
    with pytest.raises(NoSuchTwin, match="TwinRtuClient"):
        TwinModbusClient("twin://virtual/adc-0")
    with pytest.raises(NoSuchTwin, match="adc-9"):
        TwinRtuClient("twin://virtual/adc-9")
