"""The USB side of the virtual instrument: transfers, halts, aborts, clears, the status byte."""

import pytest

from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.usbtmc import ClassRequest, Header, MsgId, RequestStatus, message, request_in, trigger
from goniotwin.twin.devices import Pm100d, UsbTmcDevice
from goniotwin.twin.devices.usb_standard import BULK_IN, BULK_OUT, INTERRUPT_IN, configuration_descriptor
from goniotwin.twin.devices.usbtmc_transfers import Overflow, Stall
from tests.conftest import RigOpener

OUT = MsgId.DEV_DEP_MSG_OUT
IDENTITY = b"Thorlabs,PM100D,TWIN0001,2.8.0\n"


@pytest.fixture
def device(opened: RigOpener) -> UsbTmcDevice:
    virtual = opened(clock=VirtualClock(1.0)).virtual
    assert virtual is not None
    return UsbTmcDevice(Pm100d(virtual.plant), 1e-3)


def errors(device: UsbTmcDevice) -> list[bytes]:
    answers: list[bytes] = []
    while True:
        ((_, answer),) = device.instrument.execute(b"SYST:ERR?", 50.0)
        if answer.startswith(b"+0"):
            return answers
        answers.append(answer)


@pytest.mark.parametrize(
    "bad",
    [
        message(77, 1, b""),  # no MsgID of a host
        request_in(1, 0),
        Header(MsgId.DEV_DEP_MSG_OUT, 1, 4, end=True, term_char=10).encode() + b"*CLS",  # a bit that OUT does not have
        message(OUT, 1, b"*IDN?")[:-3],  # not filled up
        message(OUT, 1, b"*IDN?") + bytes(4),  # more bytes than the header states
        message(OUT, 1, b"*IDN?")[:8],
        Header(MsgId.TRIGGER, 1, 5, end=False).encode(),
        Header(MsgId.VENDOR_OUT, 1, 0, end=False).encode(),
    ],
)
def test_what_the_class_forbids_halts_bulk_out(device: UsbTmcDevice, bad: bytes) -> None:
    with pytest.raises(Stall):
        device.bulk_out(bad, 10.0)
    assert device.control(0x82, 0, 0, BULK_OUT, 2, 10.0) == b"\x01\x00"  # GET_STATUS: halted
    assert device.control(0x02, 1, 0, BULK_OUT, 0, 10.0) == b""  # CLEAR_FEATURE(ENDPOINT_HALT)
    device.bulk_out(message(OUT, 2, b"*CLS\n"), 10.0)


def test_a_tag_used_twice_in_a_row_halts_and_one_left_out_is_noted(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 7, b"*CLS\n"), 10.0)
    device.bulk_out(message(OUT, 9, b"*CLS\n"), 10.0)
    assert list(device.complaints) == ["bTag 9 after 7"]
    with pytest.raises(Stall):
        device.bulk_out(message(OUT, 9, b"*CLS\n"), 10.0)


def test_a_command_may_be_split_over_packets_and_transfers(device: UsbTmcDevice) -> None:
    text = b"SENS:AVER:COUN 5;" + b" " * 60
    whole = message(OUT, 1, text, end=False)
    device.bulk_out(whole[:64], 10.0)
    device.bulk_out(whole[64:], 10.0)
    device.bulk_out(message(OUT, 2, b"*IDN?"), 10.0)
    device.bulk_out(request_in(3, 100), 10.0)
    assert device.bulk_in()[12:].startswith(IDENTITY)
    assert errors(device) == []


def test_a_second_request_while_one_is_pending_halts(device: UsbTmcDevice) -> None:
    device.bulk_out(request_in(1, 100), 10.0)
    with pytest.raises(Stall):
        device.bulk_out(request_in(2, 100), 10.0)
    assert any(b"-420" in each for each in errors(device))  # asked for an answer without a question


def test_a_request_without_an_answer_is_not_acknowledged_until_there_is_one(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"SENS:AVER:COUN 3000;:READ?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.0)
    assert device.bulk_in_ready() == pytest.approx(11.0, abs=0.01)


def test_an_answer_ends_at_the_term_char(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 100, term_char=ord(",")), 10.0)
    first = device.bulk_in()
    assert first[:12] == bytes.fromhex("02 02 fd 00 09 00 00 00 02 00 00 00")  # bit 1: ended by TermChar
    assert first[12:21] == b"Thorlabs,"


def test_a_transfer_of_whole_packets_ends_with_an_empty_one(device: UsbTmcDevice) -> None:
    """52 bytes of payload and 12 of header are one packet of 64."""
    device.bulk_out(message(OUT, 1, b"*IDN?;*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 52), 10.0)
    assert len(device.bulk_in(64)) == 64
    assert device.bulk_in_ready() is not None
    assert device.bulk_in(64) == b""


def test_a_host_that_leaves_too_little_room_overflows(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.0)
    with pytest.raises(Overflow):
        device.bulk_in(40)


@pytest.mark.parametrize("keeps", [False, True])
def test_an_aborted_answer_ends_with_a_short_packet(device: UsbTmcDevice, keeps: bool) -> None:
    device.keeps_fifo = keeps
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.1)
    assert device.control_in(ClassRequest.INITIATE_ABORT_BULK_IN, 9, 11.0) == bytes((RequestStatus.TRANSFER_NOT_IN_PROGRESS, 2))
    assert device.control_in(ClassRequest.INITIATE_ABORT_BULK_IN, 2, 11.0) == bytes((RequestStatus.SUCCESS, 2))
    if keeps:
        assert device.control_in(ClassRequest.CHECK_ABORT_BULK_IN_STATUS, 0, 11.0)[:2] == bytes((RequestStatus.PENDING, 1))
    assert device.bulk_in() == b""
    assert device.control_in(ClassRequest.CHECK_ABORT_BULK_IN_STATUS, 0, 11.0)[:2] == bytes((RequestStatus.SUCCESS, 0))
    assert device.control_in(ClassRequest.INITIATE_ABORT_BULK_IN, 2, 11.0) == bytes((RequestStatus.FAILED, 2))
    assert device.bulk_in_ready() is None


def test_a_host_that_checks_without_reading_finds_no_short_packet_later(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.1)
    device.control_in(ClassRequest.INITIATE_ABORT_BULK_IN, 2, 11.0)
    assert device.control_in(ClassRequest.CHECK_ABORT_BULK_IN_STATUS, 0, 11.0)[0] == RequestStatus.SUCCESS
    assert device.bulk_in_ready() is None


def test_a_half_written_command_is_aborted(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"NONSENSE " * 10, end=False)[:64], 10.0)
    assert device.control_in(ClassRequest.INITIATE_ABORT_BULK_OUT, 1, 10.0) == bytes((RequestStatus.SUCCESS, 1))
    received = device.control_in(ClassRequest.CHECK_ABORT_BULK_OUT_STATUS, 0, 10.0)
    assert int.from_bytes(received[4:], "little") == 52
    with pytest.raises(Stall):  # until the host clears the halt
        device.bulk_out(message(OUT, 2, b"*CLS\n"), 10.0)
    device.clear_halt(BULK_OUT)
    device.bulk_out(message(OUT, 2, b"*CLS\n"), 10.0)
    assert errors(device) == []


def test_a_device_clear_takes_its_time_and_drops_what_was_under_way(device: UsbTmcDevice) -> None:
    device.clear_s = 0.5
    device.bulk_out(message(OUT, 1, b"SENS:AVER:COUN 300;:READ?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.0)
    assert device.control_in(ClassRequest.INITIATE_CLEAR, 0, 10.01) == b"\x01"
    assert device.control_in(ClassRequest.CHECK_CLEAR_STATUS, 0, 10.2) == bytes((RequestStatus.PENDING, 0))
    assert device.control_in(ClassRequest.CHECK_CLEAR_STATUS, 0, 10.6) == bytes((RequestStatus.SUCCESS, 0))
    device.clear_halt(BULK_OUT)
    device.bulk_out(message(OUT, 3, b"SENS:AVER:COUN?\n"), 10.7)
    device.bulk_out(request_in(4, 100), 10.7)
    assert device.bulk_in()[12:15] == b"300"  # settings stay


def test_a_status_byte_comes_over_the_interrupt_endpoint(device: UsbTmcDevice) -> None:
    assert device.control_in(ClassRequest.READ_STATUS_BYTE, 5, 10.0) == bytes((RequestStatus.SUCCESS, 5, 0))
    assert device.control_in(ClassRequest.READ_STATUS_BYTE, 6, 10.0)[0] == RequestStatus.INTERRUPT_IN_BUSY
    assert device.interrupt_in(10.0) == b"\x85\x00"
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.control_in(ClassRequest.READ_STATUS_BYTE, 7, 10.1)
    assert device.interrupt_in(10.1) == b"\x87\x10"  # MAV
    assert device.control_in(ClassRequest.READ_STATUS_BYTE, 1, 10.0)[0] == RequestStatus.FAILED  # 2 to 127 are tags


def test_a_service_request_gives_its_reason_once(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"*CLS;*ESE 32;*SRE 36\n"), 10.0)
    assert device.interrupt_in_ready() is None
    device.bulk_out(message(OUT, 2, b"NONSENSE\n"), 11.0)
    assert device.interrupt_in_ready() is not None
    assert device.interrupt_in(11.0) == b"\x81\x64"  # SRQ: request, event summary, error available
    assert device.interrupt_in_ready() is None


def test_pulse_remote_and_lockout(device: UsbTmcDevice) -> None:
    assert device.control_in(ClassRequest.INDICATOR_PULSE, 0, 10.0) == b"\x01"
    assert device.pulses == 1
    device.control_in(ClassRequest.REN_CONTROL, 1, 10.0)
    device.control_in(ClassRequest.LOCAL_LOCKOUT, 0, 10.0)
    assert (device.remote, device.locked_out) == (True, True)
    device.control_in(ClassRequest.GO_TO_LOCAL, 0, 10.0)
    assert (device.remote, device.locked_out) == (False, False)


@pytest.mark.parametrize(
    ("kind", "request_number", "index"),
    [
        (0xA1, 99, 0),
        (0xA1, ClassRequest.INITIATE_ABORT_BULK_IN, BULK_IN),
        (0xA2, ClassRequest.INITIATE_CLEAR, 0),
        (0xA1, 7, 3),
        (0xA2, ClassRequest.INITIATE_ABORT_BULK_OUT, BULK_IN),
        (0x80, 99, 0),
    ],
)
def test_other_requests_stall_endpoint_0(device: UsbTmcDevice, kind: int, request_number: int, index: int) -> None:
    with pytest.raises(Stall):
        device.control(kind, request_number, 0, index, 24, 10.0)


def test_a_trigger_starts_a_measurement(device: UsbTmcDevice) -> None:
    device.bulk_out(trigger(1), 10.0)
    device.bulk_out(message(OUT, 2, b"FETC?\n"), 11.0)
    device.bulk_out(request_in(3, 100), 11.0)
    assert float(device.bulk_in()[12:].rstrip(b"\0")) > 0.0


def test_more_answers_than_the_queue_holds_are_a_deadlock(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b";".join([b"*IDN?"] * 600) + b"\n"), 10.0)
    assert any(b"-430" in each for each in errors(device))


def test_the_descriptors_are_those_of_a_usb488_device(device: UsbTmcDevice) -> None:
    configuration = device.control(0x80, 6, 0x0200, 0, 255, 10.0)
    assert configuration == configuration_descriptor()
    assert int.from_bytes(configuration[2:4], "little") == len(configuration) == 39
    assert configuration[14:17] == bytes((0xFE, 3, 1))
    assert [configuration[at + 2] for at in (18, 25, 32)] == [BULK_OUT, BULK_IN, INTERRUPT_IN]
    assert device.control(0x80, 6, 0x0100, 0, 18, 10.0)[8:12] == bytes.fromhex("13 13 78 80")
    assert device.control(0x80, 6, 0x0303, 0x409, 255, 10.0)[2:].decode("utf-16-le") == "TWIN0001"


def test_every_transfer_is_in_the_log(device: UsbTmcDevice) -> None:
    device.bulk_out(message(OUT, 1, b"*IDN?\n"), 10.0)
    device.bulk_out(request_in(2, 100), 10.0)
    device.bulk_in()
    assert [(kind, data[0]) for _, kind, data in device.log] == [("bulk OUT", 1), ("bulk OUT", 2), ("bulk IN", 2)]
