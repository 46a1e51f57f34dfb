"""pyusb's door, seen by pyusb and by python-usbtmc, a client written by others."""

import pytest
import usb.core
import usb.util
import usbtmc

from goniotwin.mocks.usb_endpoints import install_backend
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.protocols.usbtmc import MsgId, message, request_in
from goniotwin.twin.doors import TwinUsbBackend
from goniotwin.twin.rig import VirtualRig
from tests.conftest import RigOpener

RESOURCE = "USB::0x1313::0x8078::TWIN0001::INSTR"
IDENTITY = "Thorlabs,PM100D,TWIN0001,2.8.0"


@pytest.fixture
def rig(opened: RigOpener) -> VirtualRig:
    virtual = opened(clock=VirtualClock(1.0)).virtual
    assert virtual is not None
    return virtual


@pytest.fixture
def fast(opened: RigOpener) -> VirtualRig:
    virtual = opened(clock=RealClock(speed=25.0)).virtual
    assert virtual is not None
    return virtual


def test_a_timeout_takes_its_time_and_is_pyusbs(rig: VirtualRig) -> None:
    device = usb.core.find(backend=TwinUsbBackend(rig))
    start = rig.clock.now()
    with pytest.raises(usb.core.USBTimeoutError) as caught:
        device.read(0x82, 512, 250)
    assert (caught.value.backend_error_code, caught.value.errno) == (-7, 110)
    assert rig.clock.now() - start == pytest.approx(0.25)


def test_a_stall_is_pyusbs_and_is_cleared(rig: VirtualRig) -> None:
    device = usb.core.find(backend=TwinUsbBackend(rig))
    with pytest.raises(usb.core.USBError) as caught:
        device.write(0x02, b"nothing of USBTMC", 100)
    assert (caught.value.backend_error_code, caught.value.errno) == (-9, 32)
    device.clear_halt(0x02)
    assert device.write(0x02, message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 100) == 20
    device.write(0x02, request_in(2, 100), 100)
    assert IDENTITY.encode() in bytes(device.read(0x82, 512, 100))


def test_too_little_room_overflows(rig: VirtualRig) -> None:
    device = usb.core.find(backend=TwinUsbBackend(rig))
    device.write(0x02, message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 100)
    device.write(0x02, request_in(2, 100), 100)
    with pytest.raises(usb.core.USBError) as caught:
        device.read(0x82, 20, 100)
    assert (caught.value.backend_error_code, caught.value.errno) == (-8, 75)


def test_an_unplugged_device_is_gone_for_good_and_a_new_one_is_found(rig: VirtualRig) -> None:
    backend = TwinUsbBackend(rig)
    old = usb.core.find(backend=backend)
    assert old.serial_number == "TWIN0001"
    backend.unplug("monitor")
    assert usb.core.find(backend=backend) is None
    for _ in range(2):
        with pytest.raises(usb.core.USBError) as caught:
            old.write(0x02, message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 100)
        assert (caught.value.backend_error_code, caught.value.errno) == (-4, 19)
        backend.replug("monitor")  # the old handle stays dead
    new = usb.core.find(backend=backend)
    new.write(0x02, message(MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?\n"), 100)


def test_unplugging_ends_a_read_that_waits(rig: VirtualRig) -> None:
    backend = TwinUsbBackend(rig)
    device = usb.core.find(backend=backend)
    device.write(0x02, message(MsgId.DEV_DEP_MSG_OUT, 1, b"SENS:AVER:COUN 3000;:READ?\n"), 100)
    device.write(0x02, request_in(2, 100), 100)
    start = rig.clock.now()
    rig.clock.at(start + 0.3, lambda: backend.unplug("monitor"))
    with pytest.raises(usb.core.USBError) as caught:
        device.read(0x82, 512, 5000)
    assert caught.value.errno == 19
    assert rig.clock.now() - start == pytest.approx(0.3, abs=0.01)


def test_python_usbtmc_opens_it_in_all_its_forms(fast: VirtualRig) -> None:
    with install_backend(TwinUsbBackend(fast)):
        (found,) = usbtmc.list_devices()
        for client in (
            usbtmc.Instrument(RESOURCE),
            usbtmc.Instrument(0x1313, 0x8078),
            usbtmc.Instrument(0x1313, 0x8078, "TWIN0001"),
            usbtmc.Instrument(found),
            usbtmc.Instrument(device=found),
            usbtmc.Instrument("USB0::4883::32888::INSTR"),
        ):
            assert client.ask("*IDN?") == IDENTITY
            client.close()
    assert not fast.usb["monitor"].complaints


def test_python_usbtmc_reads_status_pulses_and_triggers(fast: VirtualRig, capsys: pytest.CaptureFixture[str]) -> None:
    with install_backend(TwinUsbBackend(fast)):
        client = usbtmc.Instrument(RESOURCE)
        assert client.read_stb() == 0
        client.write("NONSENSE")
        assert client.read_stb() == 0x04  # the error queue
        assert client.ask("SYST:ERR?").startswith("-113")
        client.write("*IDN?")
        assert client.read_stb() == 0x10  # MAV
        assert client.read() == IDENTITY
        client.pulse()
        client.trigger()
        assert float(client.ask("FETC?")) > 0.0
        client.close()
    assert fast.usb["monitor"].pulses == 1


def test_python_usbtmc_gets_large_answers_whole_and_in_pieces(fast: VirtualRig) -> None:
    with install_backend(TwinUsbBackend(fast)):
        client = usbtmc.Instrument(RESOURCE)
        question = ";".join(["*IDN?"] * 300)
        assert client.ask(question) == ";".join([IDENTITY] * 300)
        client.max_transfer_size = 100
        assert client.ask("*IDN?;*IDN?;*IDN?;*IDN?") == ";".join([IDENTITY] * 4)
        client.write("*IDN?")
        assert client.read(8) == "Thorlabs"
        client.close()


def test_python_usbtmc_goes_on_after_a_timeout(fast: VirtualRig) -> None:
    with install_backend(TwinUsbBackend(fast)):
        client = usbtmc.Instrument(RESOURCE)
        client.timeout = 1.0
        client.write("SENS:AVER:COUN 9000")
        with pytest.raises(usb.core.USBTimeoutError):
            client.ask("READ?")  # three seconds
        assert client.ask("*IDN?") == IDENTITY
        assert client.ask("SYST:ERR?").startswith("-410")  # the reading was not waited for
        client.clear()
        assert client.ask("SYST:ERR?") == '+0,"No error"'
        client.close()
