"""The virtual monitor instrument: SCPI and the USB class, and a client program written by others."""

import pytest
import usb.core
import usbtmc

from goniotwin.mocks.usb_endpoints import install_backend
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.protocols.usbtmc import MsgId, message, request_in
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import Pm100d, UsbTmcDevice
from goniotwin.twin.devices.usbtmc import BULK_OUT, Stall
from goniotwin.twin.doors import TwinUsbBackend
from tests.conftest import RigOpener


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


def test_the_identification_names_the_model_and_the_twin(instrument: Pm100d) -> None:
    assert ask(instrument, b"*IDN?\n") == b"Thorlabs,PM100D,TWIN0001,2.8.0"


def test_averaging_takes_its_time(instrument: Pm100d) -> None:
    instrument.execute(b"SENS:AVER:COUN 3000\n", 10.0)
    ((ready, _),) = instrument.execute(b"READ?\n", 10.0)
    assert ready == pytest.approx(11.0, abs=0.01)


def test_a_range_that_is_too_small_reads_over(rig: VirtualRig, instrument: Pm100d) -> None:
    rig.plant.shutter_open.set(5.0, True)
    instrument.execute(b"CONF:CURR;:SENS:CURR:RANG 500E-9\n", 10.0)
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


def test_a_full_error_queue_reports_overflow(instrument: Pm100d) -> None:
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
    with install_backend(TwinUsbBackend(rig)):
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


@pytest.mark.parametrize(
    ("command", "query", "answer"),
    [
        (b"Sense:Average:COUNt 300", b"Sense:Average:COUNt?", b"300"),
        (b"SENS1:AVER1:COUN MAX", b"AVER?", b"10000"),
        (b"Sense:Correction:WAVelength 633 nm", b"SENSE:CORR:WAV?", b"6.33000000E+02"),
        (b"SENS:CORR:WAV MIN", b"SENS:CORR:WAV? MAX", b"1.10000000E+03"),
        (b"Configure:Scalar:Current:DC", b"CONFigure?", b"CURR"),
        (b"CONF:POW", b"CONF?", b"POW"),
        (b"Sense:Current:Dc:Range:AUTO 1", b"CURR:RANG:AUTO?", b"1"),
        (b"SENS:CURR:RANG:AUTO OFF", b"POW:RANG:AUTO?", b"0"),
        (b"CURR:RANG 40 uA", b"CURR:RANG?", b"5.00000000E-05"),
        (b"Input:Pdiode:Filter:Lpass:STATe 1", b"INP:FILT?", b"1"),
        (b"SENS:POW:UNIT DBM", b"POW:UNIT?", b"DBM"),
        (b"SENS:CORR:LOSS:INP:MAGN 3", b"SENS:CORR:LOSS?", b"3.00000000E+00"),
        (b"SENS:CORR:BEAM 5mm", b"SENS:CORR:BEAM?", b"5.00000000E+00"),
        (b"SENS:CORR:POW:PDI:RESP 0.2 A/W", b"SENS:CORR:POW:PDI:RESP?", b"2.00000000E-01"),
        (b"*ESE 60;*SRE 48", b"*ESE?;*SRE?", b"60;48"),
        (b"STAT:OPER:ENAB 16;PTR 0;NTR 16", b"STAT:OPER:ENAB?;PTR?;NTR?", b"16;0;16"),
        (b"STAT:PRES", b"STAT:MEAS:PTR?;:STAT:AUX:COND?", b"32767;0"),
        (b"*CLS", b"SYST:ERR:NEXT?;COUN?", b'+0,"No error";0'),
        (b"*RST", b"*TST?;SYST:VERS?", b"0;1999.0"),
    ],
)
def test_every_command_in_its_spellings(instrument: Pm100d, command: bytes, query: bytes, answer: bytes) -> None:
    assert instrument.execute(command + b"\n", 10.0) == []
    assert ask(instrument, query) == answer
    assert ask(instrument, b"SYST:ERR?") == b'+0,"No error"'


@pytest.mark.parametrize(
    ("program", "code"),
    [
        (b"SENS2:AVER 1", -114), (b"CURR:RANG 5 V", -131), (b"AVER 5 s", -138), (b"CONF:VOLT", -241),
        (b"CURR:RANG:AUTO maybe", -224),
        (b"CURR:RANG? 7", -224), (b"*IDN? 1", -108), (b"ABORTNOWPLEASEDO", -112), (b"AVER 1,,2", -103), (b"AVER '1", -151),
        (b"AVER 1" + b"0" * 5000, -223),
        (b"FETC? 5", -108), (b"INIT 1", -108), (b"*RST 1", -108), (b"CONF:VOLT 5", -108), (b"STAT:OPER? 1", -108),
    ],
)  # fmt: skip
def test_each_mistake_has_its_number(instrument: Pm100d, program: bytes, code: int) -> None:
    assert instrument.execute(program, 10.0) == []
    assert ask(instrument, b"SYST:ERR?").startswith(f"{code},".encode())


def test_after_a_command_error_the_rest_is_not_done_and_after_another_it_is(instrument: Pm100d) -> None:
    instrument.execute(b"AVER 5;NONSENSE;AVER 6", 10.0)
    assert ask(instrument, b"AVER?") == b"5"
    instrument.execute(b"AVER 1E9;:AVER 7", 10.0)
    assert ask(instrument, b"AVER?") == b"7"


def test_power_is_current_over_responsivity(rig: VirtualRig, instrument: Pm100d) -> None:
    rig.plant.shutter_open.set(5.0, True)
    current = float(ask(instrument, b"MEAS:CURR?"))
    watts = float(ask(instrument, b"SENS:CORR:POW:RESP 0.2;:MEAS:POW?"))
    assert watts == pytest.approx(current / 0.2, rel=0.01)
    assert float(ask(instrument, b"POW:UNIT DBM;:READ?")) == pytest.approx(-31.5, abs=0.3)  # 0.7 uW over 1 mW
    assert float(ask(instrument, b"POW:UNIT W;:CORR:LOSS:INP 10;:READ?")) == pytest.approx(10.0 * watts, rel=0.01)


def test_a_dark_zero_takes_its_time_and_is_subtracted(rig: VirtualRig, instrument: Pm100d) -> None:
    dark = float(ask(instrument, b"MEAS:CURR?"))
    assert dark == pytest.approx(1.0e-11, rel=0.01)
    assert instrument.execute(b"SENS:CORR:COLL:ZERO", 20.0) == []
    assert ask(instrument, b"SENS:CORR:COLL:ZERO:STAT?;:STAT:OPER:COND?", 20.5) == b"1;1"
    assert ask(instrument, b"SENS:CORR:COLL:ZERO:STAT?;:STAT:OPER:COND?", 21.5) == b"0;0"
    assert float(ask(instrument, b"SENS:CORR:COLL:ZERO:MAGN?", 21.6)) == pytest.approx(dark, rel=0.01)
    assert abs(float(ask(instrument, b"MEAS:CURR?", 22.0))) < 1e-13
    rig.plant.shutter_open.set(25.0, True)
    instrument.execute(b"SENS:CORR:COLL:ZERO", 30.0)
    assert ask(instrument, b"*OPC?;SYST:ERR?", 30.1).startswith(b'1;-200,"Execution error; too much light')


def test_operation_complete_comes_with_the_end_of_the_measurement(instrument: Pm100d) -> None:
    instrument.execute(b"*CLS;*ESE 1;:AVER 3000;:INIT;*OPC", 10.0)
    assert ask(instrument, b"*ESR?", 10.5) == b"0"
    assert ask(instrument, b"*ESR?", 11.1) == b"1"


def test_a_power_cycle_forgets_every_setting(instrument: Pm100d) -> None:
    instrument.execute(b"AVER 77;*SRE 4", 10.0)
    instrument.power_cycle(20.0)
    assert ask(instrument, b"AVER?;*SRE?", 21.0) == b"1;0"
    assert ask(instrument, b"*ESR?", 22.0) == b"128"  # power on
