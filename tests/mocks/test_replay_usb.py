"""Replay of the monitor's USB transcript: to the twin's instrument, and to the driver in its place."""

from pathlib import Path

import pytest

from goniotwin.drivers import DeviceError
from goniotwin.mocks.replay_usb import RecordedUsb, replay_to_usb
from goniotwin.mocks.transcript import Transfer
from goniotwin.protocols.usbtmc import ClassRequest, StatusByte
from goniotwin.twin.devices.usb_standard import BULK_IN, BULK_OUT
from goniotwin.twin.devices.usbtmc import UsbTmcDevice
from tests.mocks.replay_bench import QUIET, RigMaker, read_monitor, same, transcripts, virtual
from tests.mocks.replay_bench import rig_of as rig_of

SLOW = 0.3  # s, for which a device clear goes on


def twin(rig_of: RigMaker, *, hoards: bool = False) -> UsbTmcDevice:
    """The monitor of a fresh rig. One that hoards keeps what is aborted until it is read, and takes its time to clear."""
    device = virtual(rig_of(QUIET)).usb["monitor"]
    device.keeps_fifo, device.clear_s = hoards, SLOW if hoards else 0.0
    return device


def record(rig_of: RigMaker, folder: Path, *, hoards: bool = False) -> tuple[list[Transfer], float]:
    """Record connection, reading, status query, abort and clear; return the transcript and the readings."""
    rig = rig_of(QUIET, transcript=folder)
    device = virtual(rig).usb["monitor"]
    device.keeps_fifo, device.clear_s = hoards, SLOW if hoards else 0.0
    rig.rig.monitor.connect()
    current = read_monitor(rig.rig)
    rig.close()
    (transcript,) = transcripts(folder, "monitor")
    return transcript, current


@pytest.mark.parametrize("hoards", [False, True], ids=["quick", "hoarding"])
def test_the_same_instrument_gives_the_same_answers_again(rig_of: RigMaker, tmp_path: Path, hoards: bool) -> None:
    transcript, _ = record(rig_of, tmp_path, hoards=hoards)
    assert replay_to_usb(twin(rig_of, hoards=hoards), transcript) == []


def test_a_session_has_all_kinds_of_transfers(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    sent = [each.data for each in transcript if each.direction == ">"]
    received = [each.data for each in transcript if each.direction == "<"]
    assert any(len(data) > 12 for data in sent)
    assert any(len(data) > 12 for data in received)
    assert bytes((0x02, 1, 0, 0, BULK_OUT, 0, 0, 0)) in sent
    assert any(data[:2] == bytes((0xA1, ClassRequest.READ_STATUS_BYTE)) for data in sent)
    assert any(len(data) == 2 and data[0] & 0x80 for data in received)


def test_another_reading_is_detected_byte_by_byte(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, current = record(rig_of, tmp_path)
    fresh = virtual(rig_of(QUIET))
    fresh.plant.shutter_open.set(0.0, True)
    (difference,) = replay_to_usb(fresh.usb["monitor"], transcript)
    assert float(difference.recorded[12:-1]) == pytest.approx(current)
    assert float(difference.replayed[12:-1]) > 100.0 * current
    assert difference.recorded[:12] == difference.replayed[:12]
    assert f"monitor.txt, line {difference.line}, from the device: byte 1" in str(difference)
    assert difference.asked[0] == 2  # a request for an answer


def test_another_status_is_detected_in_its_notice(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    asked = next(k for k, each in enumerate(transcript) if each.data[:2] == bytes((0xA1, ClassRequest.READ_STATUS_BYTE)))
    device = twin(rig_of)
    assert replay_to_usb(device, transcript[:asked]) == []
    device.instrument.execute(b"*ESE 32;NONSENSE", transcript[asked].t)
    difference = replay_to_usb(device, transcript[asked:])[0]
    notice = transcript[asked + 2]
    assert (difference.line, difference.recorded) == (notice.line, notice.data)
    status = StatusByte.ESB | StatusByte.EAV
    assert difference.replayed == bytes((notice.data[0], notice.data[1] | status))
    assert str(difference).endswith(
        f"from the device: byte 1: {notice.data[1]:02x} recorded, {notice.data[1] | status:02x} now"
    )


def test_a_stalled_instrument_sends_nothing(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    connected = next(k for k, each in enumerate(transcript) if b"*CLS" in each.data)
    rest = transcript[connected:]
    device = twin(rig_of)
    device.halt(BULK_IN)
    first = replay_to_usb(device, rest)[0]
    assert (first.recorded, first.replayed) == (rest[2].data, b"")
    assert "byte 0: 02 recorded, nothing now" in str(first)


def test_an_answer_that_was_not_recorded_is_a_difference(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    unheard = next(each for each in transcript if b"Thorlabs" in each.data)
    asked = transcript[transcript.index(unheard) - 1]
    (difference,) = replay_to_usb(twin(rig_of), [each for each in transcript if each is not unheard])
    assert (difference.line, difference.recorded, difference.replayed) == (asked.line, b"", unheard.data)
    assert "byte 0: nothing recorded, 02 now" in str(difference)


@pytest.mark.parametrize("hoards", [False, True], ids=["quick", "hoarding"])
def test_the_driver_gets_the_same_from_a_recorded_instrument(rig_of: RigMaker, tmp_path: Path, hoards: bool) -> None:
    transcript, current = record(rig_of, tmp_path / "first", hoards=hoards)
    again = rig_of(QUIET, transcript=tmp_path / "again")
    recorded = virtual(again).usb["monitor"] = RecordedUsb(virtual(again).usb["monitor"], transcript)
    assert again.rig.monitor.connect() == "Thorlabs,PM100D,TWIN0001,2.8.0"
    assert read_monitor(again.rig) == current
    again.close()
    assert recorded.finished
    (heard,) = transcripts(tmp_path / "again", "monitor")
    assert same(transcript, heard, 0.0)


def test_a_driver_that_sends_other_requests_is_detected(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    other = rig_of(QUIET, ("range_a = 500e-9", "range_a = 50e-9"))
    recorded = virtual(other).usb["monitor"] = RecordedUsb(virtual(other).usb["monitor"], transcript)
    with pytest.raises(DeviceError, match="monitor"):
        other.rig.monitor.connect()
    (difference,) = recorded.differences
    assert difference.direction == ">"
    assert b"RANG 5.0E-07" in difference.recorded
    assert b"RANG 5.0E-08" in difference.replayed
    assert "byte 33: 37 recorded, 38 now" in str(difference)
    assert not recorded.finished


def test_after_the_end_of_a_recording_there_is_nothing(rig_of: RigMaker, tmp_path: Path) -> None:
    transcript, _ = record(rig_of, tmp_path)
    more = rig_of(QUIET)
    recorded = virtual(more).usb["monitor"] = RecordedUsb(virtual(more).usb["monitor"], transcript)
    more.rig.monitor.connect()
    read_monitor(more.rig)
    with pytest.raises(DeviceError):
        more.rig.monitor.check()
    (difference,) = recorded.differences
    assert (difference.line, difference.recorded) == (transcript[-1].line, b"")
