"""pyserial's door: bytes take their time, both ways."""

import pytest
import serial

import goniotwin.twin.doors  # noqa: F401  (registers the handler)
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from tests.conftest import RigOpener

FRAME = CommandFrame(1, Command.FIRMWARE_VERSION, 1, 0).encode()


@pytest.fixture
def clock() -> VirtualClock:
    return VirtualClock(50.0)


@pytest.fixture
def port(opened: RigOpener, clock: VirtualClock) -> serial.Serial:
    rig = opened(clock=clock)
    clock.sleep_until(60.0)
    return serial.serial_for_url(f"twin://{rig._name}/axes", baudrate=115200, timeout=0.06)


def test_an_exchange_takes_the_time_of_its_bytes(port: serial.Serial, clock: VirtualClock) -> None:
    start = clock.now()
    port.write(FRAME)
    assert clock.now() == start  # a port with a buffer returns at once
    assert len(port.read(9)) == 9
    assert clock.now() - start == pytest.approx(18 * 10 / 115200 + 3e-4, abs=1e-9)


def test_bytes_arrive_one_after_the_other(port: serial.Serial, clock: VirtualClock) -> None:
    start = clock.now()
    port.write(FRAME)
    port.read(1)
    first = clock.now()
    port.read(1)
    assert first - start == pytest.approx(10 * 10 / 115200 + 3e-4, abs=1e-9)
    assert clock.now() - first == pytest.approx(10 / 115200, abs=1e-9)


def test_a_silent_device_costs_the_timeout(port: serial.Serial, clock: VirtualClock) -> None:
    start = clock.now()
    assert port.read(9) == b""
    assert clock.now() - start == pytest.approx(0.06)


def test_the_wrong_baud_rate_is_not_understood(opened: RigOpener, clock: VirtualClock) -> None:
    rig = opened(clock=clock)
    port = serial.serial_for_url(f"twin://{rig._name}/axes", baudrate=9600, timeout=0.5)
    port.write(FRAME)
    assert port.read(9) == b""


def test_in_waiting_counts_what_has_arrived(port: serial.Serial, clock: VirtualClock) -> None:
    port.write(FRAME)
    assert port.in_waiting == 0
    clock.sleep_until(clock.now() + 1.0)
    assert port.in_waiting == 9
    port.reset_input_buffer()
    assert port.in_waiting == 0


def test_an_event_on_the_way_happens_at_its_time(port: serial.Serial, clock: VirtualClock) -> None:
    seen: list[float] = []
    clock.at(clock.now() + 0.03, lambda: seen.append(clock.now()))
    start = clock.now()
    port.read(9)
    assert seen == [pytest.approx(start + 0.03)]


@pytest.mark.parametrize("address", ["twin://virtual/nothing", "twin://unknown/axes", "twin://virtual/adc-0"])
def test_an_address_without_a_device_cannot_be_opened(opened: RigOpener, address: str) -> None:
    opened()
    with pytest.raises(serial.SerialException):
        serial.serial_for_url(address)


def test_a_closed_port_sends_nothing(port: serial.Serial) -> None:
    port.close()
    with pytest.raises(serial.SerialException):
        port.write(FRAME)
