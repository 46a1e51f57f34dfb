"""The virtual monitor instrument: SCPI and the USB class, and a client program written by others."""

import pytest
import usb.core
import usbtmc

from mocks.virtual_usb import installed
from protocols.clock import RealClock, VirtualClock
from protocols.usbtmc import MsgId, message, request_in
from tests.conftest import RigOpener
from twin import VirtualRig
from twin.devices import Pm100d, UsbTmcDevice
from twin.devices.usbtmc import BULK_OUT, Stall
from twin.doors import TwinUsbBackend


@pytest.fixture
def rig(opened: RigOpener) -> VirtualRig:
    virtual = opened(clock=VirtualClock(1.0)).virtual
    assert virtual is not None
    return virtual


@pytest.fixture
def instrument(rig: VirtualRig) -> Pm100d:
    return Pm100d(rig.plant)


def ask(instrument: Pm100d, program: bytes, t: float = 10.0) -> bytes:
    ((_, answer),) = instrument.execute(program, t)
    return answer.rstrip(b"\n")


def test_it_says_who_it_is_and_that_it_is_a_twin(instrument: Pm100d) -> None:
    assert ask(instrument, b"*IDN?\n") == b"Thorlabs,PM100D,TWIN0001,2.8.0"


def test_averaging_takes_its_time(instrument: Pm100d) -> None:
    instrument.execute(b"SENS:AVER:COUN 3000\n", 10.0)
    ((ready, _),) = instrument.execute(b"READ?\n", 10.0)
    assert ready == pytest.approx(11.0, abs=0.01)


def test_a_range_that_is_too_small_reads_over(rig: VirtualRig, instrument: Pm100d) -> None:
    rig.plant.shutter_open.set(5.0, True)
    instrument.execute(b"SENS:CURR:RANG 500E-9\n", 10.0)
    assert float(ask(instrument, b"READ?\n")) == pytest.approx(1.4e-7, rel=0.02)
    instrument.execute(b"SENS:CURR:RANG MIN\n", 10.0)
    assert float(ask(instrument, b"READ?\n")) == 9.9e37


@pytest.mark.parametrize(
    ("program", "code"),
    [
        (b"NONSENSE 1\n", -113),
        (b"SENS:AVER\n", -109),
        (b"SENS:AVER 1,2\n", -108),
        (b"SENS:AVER many\n", -104),
        (b"SENS:AVER 1E9\n", -222),
        (b"FETC?\n", -230),
        (b"\xff\n", -101),
    ],
)
def test_errors_queue_up_and_are_read_once(instrument: Pm100d, program: bytes, code: int) -> None:
    assert instrument.execute(program, 10.0) == []
    assert instrument.status_byte() & 0x04
    assert ask(instrument, b"SYST:ERR?\n").startswith(str(code).encode() + b",")
    assert ask(instrument, b"SYST:ERR?\n") == b'+0,"No error"'


def test_a_full_error_queue_says_so(instrument: Pm100d) -> None:
    for _ in range(20):
        instrument.execute(b"NONSENSE\n", 10.0)
    errors = [ask(instrument, b"SYST:ERR?\n") for _ in range(11)]
    assert errors[9] == b'-350,"Queue overflow"'
    assert errors[10] == b'+0,"No error"'


def test_several_queries_are_one_answer(instrument: Pm100d) -> None:
    assert ask(instrument, b"*OPC?;SENS:AVER?;:SENS:CURR:RANG:AUTO?\n") == b"1;1;1"


def test_a_broken_header_halts_the_endpoint_until_it_is_cleared(instrument: Pm100d) -> None:
    device = UsbTmcDevice(instrument, 1e-3)
    broken = bytearray(message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"))
    broken[2] ^= 1
    with pytest.raises(Stall):
        device.bulk_out(bytes(broken), 10.0)
    with pytest.raises(Stall):
        device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 10.0)
    device.clear_halt(BULK_OUT)
    device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 2, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(3, 100), 10.0)
    assert device.bulk_in_ready() is not None


def test_an_answer_comes_in_pieces_where_the_host_wants_few_bytes(instrument: Pm100d) -> None:
    device = UsbTmcDevice(instrument, 1e-3)
    device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 10.0)
    pieces = []
    for tag in range(2, 10):
        device.bulk_out(request_in(tag, 10), 10.0)
        data = device.bulk_in()
        pieces.append(data[12 : 12 + data[4]])
        if data[8] & 1:
            break
    assert b"".join(pieces) == b"Thorlabs,PM100D,TWIN0001,2.8.0\n"


def test_a_second_question_before_the_answer_is_an_interrupted_query(instrument: Pm100d) -> None:
    device = UsbTmcDevice(instrument, 1e-3)
    device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 2, b"SYST:ERR?\n"), 10.0)
    device.bulk_out(request_in(3, 100), 10.0)
    assert b"-410" in device.bulk_in()


def test_pyusb_finds_the_twin_by_its_descriptors(rig: VirtualRig) -> None:
    device = usb.core.find(backend=TwinUsbBackend(rig))
    assert (device.idVendor, device.idProduct) == (0x1313, 0x8078)
    assert device.serial_number.startswith("TWIN")
    interfaces = [interface for configuration in device for interface in configuration]
    assert [(each.bInterfaceClass, each.bInterfaceSubClass) for each in interfaces] == [(0xFE, 3)]


def test_python_usbtmc_unmodified_talks_to_the_twin(opened: RigOpener) -> None:
    """An independent client, found through pyusb as if the instrument were on the bus."""
    rig = opened(clock=RealClock(speed=100.0)).virtual
    assert rig is not None
    with installed(TwinUsbBackend(rig)):
        client = usbtmc.Instrument("USB::0x1313::0x8078::TWIN0001::INSTR")
        assert client.ask("*IDN?") == "Thorlabs,PM100D,TWIN0001,2.8.0"
        client.write("SENSE:AVERAGE:COUNT 10")
        assert client.ask("Sense:Average:COUNt?") == "10"
        rig.plant.shutter_open.set(rig.clock.now(), True)
        assert float(client.ask("MEAS:CURR?")) == pytest.approx(1.4e-7, rel=0.05)
        assert client.ask("SYST:ERR?") == '+0,"No error"'
        client.clear()
        assert client.read_stb() == 0
        client.close()
