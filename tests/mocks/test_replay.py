"""Transcripts: recorded, read back, replayed."""

import contextlib
from pathlib import Path

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from drivers import TmclModule
from drivers.errors import DeviceError
from mocks.replay import RecordedDevice, replay_to_device
from mocks.transcript import TranscriptError, read_transcript
from protocols.clock import VirtualClock
from protocols.tmcl import Axis, Command, Request
from tests.conftest import RigOpener
from twin.devices import TmclLine
from twin.doors import protocol_twin

QUIET = ("noise = true", "noise = false")


@pytest.fixture
def recorded(opened: RigOpener, tmp_path: Path) -> Path:
    """The axes' wire of a rig that was connected and asked."""
    rig = opened(QUIET, transcript=tmp_path / "wires")
    rig.rig.axes["sigma"].position_deg()
    rig.close()
    return tmp_path / "wires" / "axes.txt"


def test_the_same_device_says_the_same_again(opened: RigOpener, recorded: Path) -> None:
    rig = opened(QUIET).virtual
    assert rig is not None
    assert replay_to_device(TmclLine(rig.plant), read_transcript(recorded)) == []


def test_another_device_is_found_out_byte_by_byte(opened: RigOpener, recorded: Path) -> None:
    rig = opened(QUIET).virtual
    assert rig is not None
    transcript = read_transcript(recorded)
    asked = next(each for each in transcript if each.data[1:3] == bytes((Command.GAP, Axis.ACTUAL_POSITION)))
    device = TmclLine(rig.plant)
    device.receive(Request(1, Command.SAP, Axis.ACTUAL_POSITION, 4, 258).encode(), 0.0)
    device.outbox.clear()
    (difference,) = replay_to_device(device, transcript)
    assert difference.line == asked.line + 1
    assert "byte 6: 00 recorded, 01 now; byte 7: 00 recorded, 02 now" in str(difference)


class Port(protocol_twin.Serial):
    """A port whose other end is a recorded device."""

    def __init__(self, device: RecordedDevice, clock: VirtualClock) -> None:
        super().__init__(baudrate=device.baudrate, timeout=0.06)
        self.connect_to(device, clock)


def test_drivers_that_say_the_same_get_the_same(recorded: Path) -> None:
    transcript = read_transcript(recorded)
    device = RecordedDevice(transcript, 115200)
    clock = VirtualClock()
    module = TmclModule(lambda baud, timeout: _port(device, clock), clock)
    requests = [Request.decode(each.data) for each in transcript if each.direction == ">"]
    assert module.connect() == 6214
    for request in requests[5:]:  # connecting has asked who it is, and has set heartbeat and canary
        if request.type == Axis.ACTUAL_POSITION:
            clock.sleep_until(clock.now() + 0.05)  # as long after the last question as to need no other between
        module.exchange(request)
    assert device.finished
    assert 0.0 < clock.now() < transcript[-1].t - transcript[0].t  # as fast as it was, without the pauses


def test_drivers_that_say_something_else_are_found_out(recorded: Path) -> None:
    device = RecordedDevice(read_transcript(recorded), 115200)
    clock = VirtualClock()
    module = TmclModule(lambda baud, timeout: _port(device, clock), clock)
    module.connect()
    with pytest.raises(DeviceError):
        module.exchange(Request(1, Command.GAP, 99, 5))
    assert device.differences[0].direction == ">"


def _port(device: RecordedDevice, clock: VirtualClock) -> serial.Serial:
    return Port(device, clock)  # type: ignore[return-value]


@given(st.text(max_size=80))
def test_any_other_text_is_a_transcript_error(tmp_path_factory: pytest.TempPathFactory, text: str) -> None:
    path = tmp_path_factory.mktemp("t") / "other.txt"
    path.write_text(text, encoding="utf-8")
    with contextlib.suppress(TranscriptError):
        assert isinstance(read_transcript(path), list)
