"""The virtual monitor instrument: SCPI and the USB class, and a client program written by others."""

import pytest
import usb.core
import usbtmc

from goniotwin.app.rig import read_rig
from goniotwin.mocks.usb_endpoints import install_backend
from goniotwin.protocols.clock import RealClock, VirtualClock
from goniotwin.protocols.usbtmc import MsgId, message, request_in
from goniotwin.twin import TwinModel, VirtualRig
from goniotwin.twin.devices import Pm100d, UsbTmcDevice
from goniotwin.twin.devices.usb_standard import BULK_OUT
from goniotwin.twin.devices.usbtmc_transfers import Stall
from goniotwin.twin.doors import TwinUsbBackend
from tests.conftest import RIG, RigOpener


@pytest.fixture(scope="module")
def model() -> TwinModel:
    found = read_rig(RIG).model()
    assert found is not None
    return found


@pytest.fixture
def rig(model: TwinModel) -> VirtualRig:
    return VirtualRig.build(model, VirtualClock(1.0))


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
    rig = opened(clock=RealClock(speed=25.0)).virtual
    assert rig is not None
    with install_backend(TwinUsbBackend(rig)):
        client = usbtmc.Instrument("USB::0x1313::0x8078::TWIN0001::INSTR")
        assert client.ask("*IDN?") == "Thorlabs,PM100D,TWIN0001,2.8.0"
        client.write("SENSE:AVERAGE:COUNT 10")
        assert client.ask("Sense:Average:COUNt?") == "10"
        rig.plant.shutter_open.set(rig.clock.now(), True)
        current = float(client.ask("MEAS:CURR?"))
        now = rig.clock.now()  # the lamp drifts, and a busy computer lets hours pass
        assert current == pytest.approx(rig.plant.monitor_a(now, now + 0.01), rel=0.05)
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
        (b"SENS:CORR:WAV MIN", b"SENS:CORR:WAV?", b"2.00000000E+02"),  # Thorlabs, S120VC: 200 to 1100 nm
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
        # The commands and their forms: Thorlabs, PM400 SCPI commands 1.5.1.3; for LFRequency, CONTrast and FREQuency:RANGe
        # ThorlabsPM100 1.2.2, which follows the manual. What Thorlabs' own VISA driver 2.0.0 sends and accepts is marked.
        (b"SYST:BEEP", b"SYST:BEEP:STAT?", b"1"),
        (b"System:Beeper:Immediate;State OFF", b"SYST:BEEP:STAT?", b"0"),
        (b"SYST:LFR 60", b"SYSTem:LFRequency?", b"60"),  # driver: %hd
        (b"SYST:LFR MIN", b"SYST:LFR? MAX;LFR?", b"60;50"),
        (b"SYST:LFR 58.0", b"SYST:LFR?", b"60"),  # manual: rounded where only some values are possible
        (b"SYST:DATE 2026, 11, 22", b"SYST:DATE?", b"2026,11,22"),  # driver: "SYST:DATE %d, %d, %d"
        (b"System:Time 10, 34, 48", b"SYST:TIME?", b"10,34,48"),  # manual, p. 46: "SYST:TIME 10, 34, 48"
        (b"DISP:BRIG 0.25", b"DISPLAY:BRIGHTNESS?", b"2.50000000E-01"),
        (b"DISP:CONT 0.750000", b"DISP:CONT?", b"7.50000000E-01"),  # driver: %f
        (b"INP:ADAP THERMAL", b"INPUT:ADAPTER:TYPE?", b"THER"),
        (b"INP:ADAP:TYPE PYRo", b"INP:ADAP?", b"PYR"),  # driver: compares with PHOT, THER, PYR
        (b"SENS:POW:REF 0.00030W", b"SENSE:POWER:DC:REFERENCE?", b"3.00000000E-04"),
        (b"POW:REF 1 uW;REF:STAT ON", b"POW:REF:STAT?;:POW:REF? DEF", b"1;0.00000000E+00"),
        (b"SENS:CURR:REF 2 uA", b"CURR:DC:REF? ", b"2.00000000E-06"),  # driver: a blank for the present value
        (b"Sense:Current:DC:Reference:State 1", b"CURR:REF:STAT?", b"1"),
        (b"CURR:REF MIN", b"CURR:REF?;REF? MAX", b"-5.00000000E-03;5.00000000E-03"),
        (b"SENS:PEAK 25", b"SENSE:PEAKDETECTOR:THRESHOLD?", b"2.50000000E+01"),
        (b"PEAK:THR MAX", b"PEAK?;PEAK? MIN", b"1.00000000E+02;0.00000000E+00"),
        (b"CONF:PDEN", b"CONF?", b"PDEN"),
        (b"Configure:Scalar:Frequency", b"CONF?", b"FREQ"),
        (b"CONF:CURR;:CONF:SCAL", b"CONF?", b"POW"),  # [:POWer]
        (b"CONF:TEMP", b"CONF?", b"TEMP"),
    ],
)
def test_every_command_in_its_spellings(instrument: Pm100d, command: bytes, query: bytes, answer: bytes) -> None:
    assert instrument.execute(command + b"\n", 10.0) == []
    assert ask(instrument, query) == answer
    assert ask(instrument, b"SYST:ERR?") == b'+0,"No error"'


@pytest.mark.parametrize(
    ("program", "code"),
    [
        (b"SENS2:AVER 1", -114),
        (b"CURR:RANG 5 V", -131),
        (b"AVER 5 s", -138),
        (b"CONF:VOLT", -241),
        (b"CURR:RANG:AUTO maybe", -224),
        (b"CURR:RANG? 7", -224),
        (b"*IDN? 1", -108),
        (b"ABORTNOWPLEASEDO", -112),
        (b"AVER 1,,2", -103),
        (b"AVER '1", -151),
        (b"AVER 1" + b"0" * 5000, -223),
        # Voltage and energy are of other sensors: "Pyro, thermopile and four quadrant thermopile only" (PM400 SCPI commands).
        (b"MEAS:VOLT?", -241),
        (b"MEASURE:SCALAR:VOLTAGE:DC?", -241),
        (b"MEAS:ENER?", -241),
        (b"CONF:EDEN", -241),
        # A measurement is a query: ThorlabsPM100 1.2.2 sends `Measure:Scalar:POWer`, another program of public use notes that
        # this "does nothing".
        (b"Measure:Scalar:POWer", -113),
        (b"CAL:STR 'mine'", -113),
        (b"SENS:FREQ:RANG 5", -113),
        (b"Sense:Power:Dc:Reference:value 1", -113),
        (b"INP:ADP:TYPE PHOT", -113),
        (b"SYST:LFREQ 50", -113),
        (b"SENS:CORR:WAV 199", -222),
        (b"SYST:LFR 49", -222),
        (b"SYST:LFR 50 V", -131),
        (b"DISP:BRIG 1.01", -222),
        (b"SYST:BEEP 1", -108),
        (b"SYST:BEEP:STAT LOUD", -224),
        (b"INP:ADAP DIODE", -224),
        (b"INP:ADAP", -109),
        (b"INP:ADAP? MIN", -108),
        (b"SENS:PEAK 101", -222),
        (b"SENS:PEAK -1", -222),
        (b"SENS:POW:REF 1 A", -131),
        (b"SENS:CURR:REF 5.1 mA", -222),
        (b"SENS:CURR:REF? 5", -224),
        (b"CAL:STR? 1", -108),
        (b"MEAS:TEMP? 1", -108),
        (b"SYST:DATE 2026,2,29", -222),
        (b"SYST:DATE 1999,12,31", -222),
        (b"SYST:DATE 2026,11", -109),
        (b"SYST:DATE 2026,11,22,1", -108),
        (b"SYST:DATE", -109),
        (b"SYST:DATE 2026,November,22", -104),
        (b"SYST:TIME 24,0,0", -222),
        (b"SYST:TIME 1E99999,0,0", -222),
        (b"SYST:TIME? 1", -108),
        (b"FETC? 5", -108),
        (b"INIT 1", -108),
        (b"*RST 1", -108),
        (b"CONF:VOLT 5", -108),
        (b"STAT:OPER? 1", -108),
    ],
)
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


def test_power_density_is_power_over_the_area_of_the_beam(rig: VirtualRig, instrument: Pm100d) -> None:
    """W/cm2 with the beam's diameter in mm: PM400 SCPI commands, MEAS:PDEN?."""
    rig.plant.shutter_open.set(5.0, True)
    watts = float(ask(instrument, b"SENS:CORR:BEAM 4;:MEAS?"))
    assert float(ask(instrument, b"POW:UNIT DBM;:MEAS:PDEN?")) == pytest.approx(watts / 0.12566, rel=0.01)  # pi (0.2 cm)2
    instrument.execute(b"POW:RANG MIN", 10.0)
    assert float(ask(instrument, b"READ?;:STAT:QUES:COND?").split(b";")[0]) == 9.9e37


def test_a_reference_is_subtracted_while_its_state_is_on(rig: VirtualRig, instrument: Pm100d) -> None:
    """PM400 SCPI commands, SENS:POW:REF: an offset in W, without effect until delta mode is enabled; after reboot zero."""
    rig.plant.shutter_open.set(5.0, True)
    watts, amperes = (float(ask(instrument, program)) for program in (b"MEAS:POW?", b"MEAS:CURR?"))
    instrument.execute(b"POW:REF %.6E;:CURR:REF %.6E" % (0.6 * watts, 2.0 * amperes), 10.0)
    assert float(ask(instrument, b"MEAS:POW?")) == pytest.approx(watts, rel=0.01)
    instrument.execute(b"POW:REF:STAT 1;:CURR:REF:STAT 1", 10.0)
    assert float(ask(instrument, b"MEAS:POW?")) == pytest.approx(0.4 * watts, rel=0.02)
    assert float(ask(instrument, b"MEAS:CURR?")) == pytest.approx(-amperes, rel=0.02)
    instrument.power_cycle(20.0)
    assert ask(instrument, b"POW:REF?;REF:STAT?") == b"0.00000000E+00;0"


def test_light_without_modulation_has_no_frequency_and_chopped_light_its_own(rig: VirtualRig, instrument: Pm100d) -> None:
    """PM400 SCPI commands, MEAS:FREQ?: the signal is compared with the threshold; "CW signal frequency is read back as 0"."""
    rig.plant.shutter_open.set(5.0, True)
    ((ready, answer),) = instrument.execute(b"MEAS:FREQ?", 10.0)
    assert ready == pytest.approx(10.5, abs=0.01)
    assert float(answer) == 0.0
    for half_period in range(8):
        rig.plant.shutter_open.set(20.0 + 0.0625 * half_period, half_period % 2 == 0)
    assert float(ask(instrument, b"CURR:RANG 500E-9;:MEAS:FREQ?", 20.0)) == pytest.approx(8.0, rel=0.02)
    assert float(ask(instrument, b"SENS:PEAK 60;:MEAS:FREQ?", 21.0)) == 0.0  # the light is at 28 % of the range
    assert ask(instrument, b"SENS:FREQ:RANG?;RANG:LOW?") == b"1.50000000E+03;2.00000000E+00"


def test_the_sensor_has_the_temperature_of_the_rig(rig: VirtualRig, instrument: Pm100d) -> None:
    assert float(ask(instrument, b"MEAS:TEMP?")) == pytest.approx(rig.plant.model.electronics.temperature_k - 273.15)


def test_the_sensor_states_what_it_is(instrument: Pm100d) -> None:
    """A public program for the PM400 shows `"S120VC","251111104","12-NOV-2025",1,18,289`; a PM100USB answered
    `S121C,14081201,12-Aug-2014,1,18,289`, and `"Calibrated: 20-Nov-2014"` to CAL:STR?."""
    assert ask(instrument, b"SYST:SENS:IDN?") == b"S120VC,TWIN,virtual photodiode,1,18,289"
    assert ask(instrument, b"CALibration:STRing?") == b'"Calibrated: virtual instrument"'


def test_the_calendar_goes_on_from_what_it_was_set_to(instrument: Pm100d) -> None:
    assert ask(instrument, b"SYST:DATE?;TIME?", 70.0) == b"2000,1,1;0,1,10"
    instrument.execute(b"SYST:DATE 2028,2,28;TIME 23,59,50", 100.0)
    instrument.execute(b"*RST", 105.0)
    assert ask(instrument, b"SYST:DATE?;TIME?", 111.0) == b"2028,2,29;0,0,1"
    instrument.power_cycle(200.0)
    assert ask(instrument, b"SYST:TIME?", 200.0) == b"0,1,30"


def test_a_zero_byte_after_the_end_of_a_message_is_nothing(instrument: Pm100d) -> None:
    """Thorlabs' VISA driver 2.0.0 writes eleven bytes of `SYST:ERR?\\n` and ten of `CAL:STR?\\n`, with the C string's end."""
    assert ask(instrument, b"SYST:ERR?\n\0") == b'+0,"No error"'
    device = UsbTmcDevice(instrument, 1e-3)
    device.bulk_out(message(MsgId.DEV_DEP_MSG_OUT, 1, b"CAL:STR?\n\0"), 10.0)
    device.bulk_out(request_in(2, 100), 10.0)
    assert b'"Calibrated: virtual instrument"\n' in device.bulk_in()
    assert ask(instrument, b"SYST:ERR?", 20.0) == b'+0,"No error"'


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
