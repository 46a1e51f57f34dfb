"""The virtual monochromator, by its lines."""

import pytest

from protocols.clock import VirtualClock
from tests.conftest import RigOpener
from twin import VirtualRig
from twin.devices import Cornerstone260


@pytest.fixture
def rig(opened: RigOpener) -> VirtualRig:
    virtual = opened(clock=VirtualClock(100.0)).virtual
    assert virtual is not None
    return virtual


@pytest.fixture
def device(rig: VirtualRig) -> Cornerstone260:
    return Cornerstone260(rig.plant)  # as after power-on: no handshake mode


def say(device: Cornerstone260, line: bytes, t: float) -> list[tuple[float, bytes]]:
    device.receive(line, t)
    said = list(device.outbox)
    device.outbox.clear()
    return said


def test_it_echoes_and_answers(device: Cornerstone260) -> None:
    (echo, answer) = say(device, b"WAVE?\n", 200.0)
    assert echo == (200.0, b"WAVE?\r\n")
    assert answer[1] == b"550.000\r\n"


def test_while_it_moves_the_next_answer_waits(device: Cornerstone260) -> None:
    assert [text for _, text in say(device, b"GOWAVE 725\n", 200.0)] == [b"GOWAVE 725\r\n"]
    (_, answer) = say(device, b"wave?\n", 200.1)
    assert answer[1] == b"725.000\r\n"
    assert answer[0] == pytest.approx(200.0 + 175.0 / 175.0 + 0.1, abs=0.01)  # 175 nm at 175 nm/s, and 0.1 s to settle


def test_handshake_mode_says_when_it_is_done(device: Cornerstone260) -> None:
    assert [text for _, text in say(device, b"HANDSHAKE 1\n", 200.0)] == [b"HANDSHAKE 1\r\n", b"00\r\n"]
    (_, done) = say(device, b"SHUTTER O\n", 201.0)
    assert done[1] == b"00\r\n"
    assert done[0] == pytest.approx(201.15, abs=0.01)
    (_, failed) = say(device, b"GOWAVE 9999\n", 202.0)
    assert failed[1] == b"20\r\n"
    assert [text for _, text in say(device, b"ERROR?\n", 203.0)][1] == b"3\r\n"


@pytest.mark.parametrize(
    ("line", "error"),
    [(b"NONSENSE\n", b"1"), (b"GOWAVE x\n", b"2"), (b"GOWAVE -1\n", b"3"), (b"SHUTTER Q\n", b"2"), (b"FILTER 9\n", b"3")],
)
def test_errors_are_silent_until_asked_for(device: Cornerstone260, line: bytes, error: bytes) -> None:
    assert len(say(device, line, 200.0)) == 1  # the echo
    assert say(device, b"STB?\n", 201.0)[1][1] == b"32\r\n"
    assert say(device, b"STB?\n", 202.0)[1][1] == b"00\r\n"
    assert say(device, b"ERROR?\n", 203.0)[1][1] == error + b"\r\n"
    assert say(device, b"ERROR?\n", 204.0)[1][1] == b"0\r\n"


def test_the_shutter_lets_light_through_when_it_has_opened(rig: VirtualRig, device: Cornerstone260) -> None:
    say(device, b"SHUTTER O\n", 200.0)
    assert rig.plant.pupil_radiance(200.1) == 0.0
    assert rig.plant.pupil_radiance(200.2) > 0.0


def test_an_endless_line_fills_no_memory(device: Cornerstone260) -> None:
    device.receive(b"A" * 100_000, 200.0)
    device.outbox.clear()
    (_, *_) = say(device, b"\n", 201.0)
    assert say(device, b"ERROR?\n", 202.0)[1][1] == b"1\r\n"
