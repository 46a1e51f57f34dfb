"""Replay of serial transcripts: to twin devices, and to drivers in place of the devices."""

from collections import deque
from pathlib import Path

import pytest
import serial
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.drivers import TmclModule
from goniotwin.drivers.errors import DeviceError
from goniotwin.mocks.replay import RecordedDevice, replay_to_device
from goniotwin.mocks.transcript import Transfer, read_transcript
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame
from goniotwin.protocols.tmcl_parameters import AxisParameter
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.doors import protocol_twin
from tests.conftest import RigOpener
from tests.mocks.replay_bench import QUIET, RigMaker, transcripts, virtual
from tests.mocks.replay_bench import rig_of as rig_of


@pytest.fixture
def recorded(opened: RigOpener, tmp_path: Path) -> Path:
    """The transcript of the axes' wire of a rig that was connected and queried."""
    rig = opened(QUIET, transcript=tmp_path / "wires")
    rig.rig.axes["sigma"].position_deg()
    rig.close()
    return tmp_path / "wires" / "axes.txt"


def test_the_same_device_gives_the_same_answers_again(opened: RigOpener, recorded: Path) -> None:
    rig = opened(QUIET).virtual
    assert rig is not None
    assert replay_to_device(TmclLine(rig.plant), read_transcript(recorded)) == []


def test_another_device_is_detected_byte_by_byte(opened: RigOpener, recorded: Path) -> None:
    rig = opened(QUIET).virtual
    assert rig is not None
    transcript = read_transcript(recorded)
    asked = next(each for each in transcript if each.data[1:4] == bytes((Command.GAP, AxisParameter.ACTUAL_POSITION, 4)))
    device = TmclLine(rig.plant)
    device.receive(CommandFrame(1, Command.SAP, AxisParameter.ACTUAL_POSITION, 4, 258).encode(), 0.0)
    device.outbox.clear()
    difference, *others = replay_to_device(device, transcript)
    assert all("byte 6: 00 recorded, 01 now" in str(each) for each in others)  # it was asked for more than once
    assert difference.line == asked.line + 1
    assert "byte 6: 00 recorded, 01 now; byte 7: 00 recorded, 02 now" in str(difference)


class Port(protocol_twin.Serial):
    """A port whose other end is a recorded device."""

    def __init__(self, device: RecordedDevice, clock: VirtualClock) -> None:
        super().__init__(baudrate=device.baudrate, timeout=0.06)
        self.connect_to(device, clock)


def test_drivers_that_send_the_same_requests_get_the_same_answers(recorded: Path) -> None:
    transcript = read_transcript(recorded)
    device = RecordedDevice(transcript, 115200)
    clock = VirtualClock()
    module = TmclModule(lambda baud, timeout: _port(device, clock), clock)
    requests = [CommandFrame.decode(each.data) for each in transcript if each.direction == ">"]
    assert module.connect() == 6214
    for request in requests[5:]:  # connect() has read the identity and set heartbeat and canary
        if request.type == AxisParameter.ACTUAL_POSITION:
            clock.sleep_until(clock.now() + 0.05)  # as long after the last question as to need no other between
        module.exchange(request)
    assert device.finished
    assert 0.0 < clock.now() < transcript[-1].t - transcript[0].t  # as fast as it was, without the pauses


def test_drivers_that_send_other_requests_are_detected(recorded: Path) -> None:
    device = RecordedDevice(read_transcript(recorded), 115200)
    clock = VirtualClock()
    module = TmclModule(lambda baud, timeout: _port(device, clock), clock)
    module.connect()
    with pytest.raises(DeviceError):
        module.exchange(CommandFrame(1, Command.GAP, 99, 5))
    assert device.differences[0].direction == ">"


def test_the_monochromator_connects_to_what_was_recorded(rig_of: RigMaker, tmp_path: Path) -> None:
    first, again = rig_of(QUIET, transcript=tmp_path), rig_of(QUIET)
    identity = first.rig.monochromator.connect()
    first.close()
    (transcript,) = transcripts(tmp_path, "monochromator")
    assert replay_to_device(virtual(rig_of(QUIET)).serial["mono"], transcript) == []
    device = virtual(again).serial["mono"] = RecordedDevice(transcript, 9600)
    assert again.rig.monochromator.connect() == identity
    again.rig.monochromator.close()
    assert device.finished


def _port(device: RecordedDevice, clock: VirtualClock) -> serial.Serial:
    return Port(device, clock)  # type: ignore[return-value]


def passed(*exchanges: tuple[bytes, bytes]) -> list[Transfer]:
    """Requests and recorded answers, one second apart."""
    found = []
    for k, (request, answer) in enumerate(exchanges):
        found.append(Transfer(float(k), ">", request, 2 * k + 1))
        found += [Transfer(k + 0.5, "<", answer, 2 * k + 2)] if answer else []
    return found


class ScriptedDevice:
    """A device that answers each request at once with the next listed answer."""

    baudrate = 0

    def __init__(self, *answers: bytes) -> None:
        self.outbox: deque[tuple[float, bytes]] = deque()
        self._answers = deque(answers)

    def receive(self, data: bytes, t: float) -> None:
        self.outbox.append((t, self._answers.popleft()))

    def reset(self, t: float) -> None:
        pass


def find_differences(transcript: list[Transfer], *answers: bytes) -> list[tuple[int, bytes, bytes]]:
    """Differences: line, recorded bytes, replayed bytes."""
    differences = replay_to_device(ScriptedDevice(*answers), transcript)
    return [(each.line, each.recorded, each.replayed) for each in differences]


def test_bytes_read_one_exchange_later_are_no_difference() -> None:
    late = passed((b"move", b"move"), (b"where?", b"00where?12"), (b"again?", b"again?12"))
    assert find_differences(late, b"move00", b"where?12", b"again?12") == []
    early = passed((b"move", b"move00"), (b"where?", b"where?12"))
    assert find_differences(early, b"move", b"00where?12") == []


def test_a_wrong_byte_does_not_make_the_next_bytes_wrong() -> None:
    late = passed((b"a?", b"a?550"), (b"b?", b"00b?12"), (b"c?", b"00c?34"))
    assert find_differences(late, b"a?55100", b"b?1300", b"c?34") == [(2, b"a?550", b"a?551"), (4, b"00b?12", b"00b?13")]


def test_an_answer_of_another_length_is_one_difference() -> None:
    recorded = passed((b"a?", b"550.0"), (b"b?", b"12"))
    assert find_differences(recorded, b"550.000", b"12") == [(1, b"", b"00")]
    assert find_differences(recorded, b"55", b"12") == [(2, b"0.0", b"")]


def test_an_answer_that_is_missing_or_new_is_a_difference_of_its_own_line() -> None:
    recorded = passed((b"a?", b"1"), (b"b?", b""), (b"c?", b"3"), (b"d?", b"4"))
    assert find_differences(recorded, b"", b"", b"3", b"4") == [(2, b"1", b"")]
    assert find_differences(recorded, b"1", b"2", b"3", b"4") == [(3, b"", b"2")]
    assert find_differences(recorded, b"", b"", b"", b"") == [(2, b"1", b""), (6, b"3", b""), (8, b"4", b"")]


def test_bytes_after_the_end_of_the_recording_are_no_difference() -> None:
    assert find_differences(passed((b"a?", b"1")), b"12") == []


@given(st.lists(st.tuples(st.binary(min_size=1, max_size=4), st.binary(max_size=6)), max_size=8))
def test_a_device_with_the_same_answers_never_differs(exchanges: list[tuple[bytes, bytes]]) -> None:
    transcript = passed(*exchanges)
    assert find_differences(transcript, *(answer for _, answer in exchanges)) == []


@given(
    st.lists(st.tuples(st.binary(min_size=1, max_size=4), st.binary(min_size=1, max_size=6)), min_size=1, max_size=8), st.data()
)
def test_one_changed_byte_is_one_difference(exchanges: list[tuple[bytes, bytes]], data: st.DataObject) -> None:
    number = data.draw(st.integers(0, len(exchanges) - 1))
    answers = [answer for _, answer in exchanges]
    at = data.draw(st.integers(0, len(answers[number]) - 1))
    changed = bytearray(answers[number])
    changed[at] ^= data.draw(st.integers(1, 255))
    replayed = [*answers[:number], bytes(changed), *answers[number + 1 :]]
    (difference,) = replay_to_device(ScriptedDevice(*replayed), passed(*exchanges))
    assert difference.places == [(at, answers[number][at], changed[at])]
    assert (difference.line, difference.asked) == (2 * number + 2, exchanges[number][0])


@given(
    st.lists(st.tuples(st.binary(min_size=1, max_size=4), st.binary(max_size=6)), max_size=8),
    st.lists(st.binary(max_size=6), min_size=8, max_size=8),
)
def test_no_recorded_byte_is_reported_twice(exchanges: list[tuple[bytes, bytes]], replayed: list[bytes]) -> None:
    transcript = passed(*exchanges)
    differences = replay_to_device(ScriptedDevice(*replayed), transcript)
    recorded = b"".join(each.data for each in transcript if each.direction == "<")
    assert sum(len(each.recorded) for each in differences) <= len(recorded)
    assert sum(len(each.replayed) for each in differences) <= sum(map(len, replayed))
    assert all(each.places for each in differences)
