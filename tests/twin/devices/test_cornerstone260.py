"""The virtual monochromator, by its lines."""

from dataclasses import replace
from typing import Any

import pytest

from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices import Cornerstone260
from tests.conftest import RigOpener


@pytest.fixture
def rig(opened: RigOpener) -> VirtualRig:
    virtual = opened(clock=VirtualClock(100.0)).virtual
    assert virtual is not None
    return virtual


@pytest.fixture
def device(rig: VirtualRig) -> Cornerstone260:
    return Cornerstone260(rig.plant)  # as after power-on: no handshake mode


def exchange(device: Cornerstone260, line: bytes, t: float) -> list[tuple[float, bytes]]:
    device.receive(line, t)
    answers = list(device.outbox)
    device.outbox.clear()
    return answers


@pytest.mark.parametrize("line", [b"WAVE?\n", b"wave? \r\n"])
def test_it_echoes_byte_for_byte_and_answers(device: Cornerstone260, line: bytes) -> None:
    (echo, answer) = exchange(device, line, 200.0)
    assert echo == (200.0, line)  # MCS260 p. 50: to WAVE?[lf] it answers WAVE?[lf]500[cr][lf]
    assert answer[1] == b"550.000\r\n"


def test_while_it_moves_the_next_answer_waits(device: Cornerstone260) -> None:
    assert [text for _, text in exchange(device, b"GOWAVE 725\n", 200.0)] == [b"GOWAVE 725\n"]  # p. 50
    (_, answer) = exchange(device, b"wave?\n", 200.1)
    assert answer[1] == b"725.000\r\n"
    assert answer[0] == pytest.approx(200.0 + 175.0 / 175.0 + 0.1, abs=0.01)  # 175 nm at 175 nm/s, and 0.1 s to settle


def test_handshake_mode_reports_completion(device: Cornerstone260) -> None:
    assert [text for _, text in exchange(device, b"HANDSHAKE 1\n", 200.0)] == [b"HANDSHAKE 1\n", b"00\r\n"]  # p. 51
    (_, done) = exchange(device, b"SHUTTER O\n", 201.0)
    assert done[1] == b"00\r\n"
    assert done[0] == pytest.approx(201.15, abs=0.01)
    (_, failed) = exchange(device, b"GOWAVE 9999\n", 202.0)
    assert failed[1] == b"20\r\n"
    assert [text for _, text in exchange(device, b"ERROR?\n", 203.0)][1] == b"3\r\n"


@pytest.mark.parametrize(
    ("line", "error"),
    [(b"NONSENSE\n", b"1"), (b"GOWAVE x\n", b"2"), (b"GOWAVE -1\n", b"3"), (b"SHUTTER Q\n", b"2"), (b"FILTER 9\n", b"3")],
)
def test_errors_are_silent_until_asked_for(device: Cornerstone260, line: bytes, error: bytes) -> None:
    assert len(exchange(device, line, 200.0)) == 1  # the echo
    assert exchange(device, b"STB?\n", 201.0)[1][1] == b"20\r\n"  # MCS260 p. 58, in either mode
    assert exchange(device, b"STB?\n", 202.0)[1][1] == b"00\r\n"
    assert exchange(device, b"ERROR?\n", 203.0)[1][1] == error + b"\r\n"
    assert exchange(device, b"ERROR?\n", 204.0)[1][1] == b"\r\n"  # 0 is a system error (p. 58); fsc2's oriel_cs_260.c


@pytest.mark.parametrize(
    ("unit", "without", "with_error", "no_error"),
    [
        ({"status_digits": 1, "status_decimal": True}, b"0", b"32", b""),  # fsc2's oriel_cs_260.c
        ({"status_decimal": True, "zero_is_no_error": True}, b"00", b"32", b"0"),  # MCS260B p. 62
    ],
)
@pytest.mark.parametrize("handshake", [False, True])
def test_units_differ_in_status_and_error(
    rig: VirtualRig, unit: dict[str, Any], without: bytes, with_error: bytes, no_error: bytes, handshake: bool
) -> None:
    rig.plant.model = replace(rig.plant.model, monochromator=replace(rig.plant.model.monochromator, **unit))
    device = Cornerstone260(rig.plant)
    exchange(device, b"HANDSHAKE %d\n" % handshake, 200.0)
    status = [without] * handshake
    assert lines(device, b"STB?\n", 201.0) == [without, *status]
    assert lines(device, b"ERROR?\n", 202.0) == [no_error, *status]
    assert lines(device, b"GOWAVE x\n", 203.0) == [with_error] * handshake
    assert lines(device, b"STB?\n", 204.0) == [without if handshake else with_error, *status]  # sent is read
    assert lines(device, b"ERROR?\n", 205.0) == [b"2", *status]


def test_it_has_a_gpib_address_that_outlives_the_power(device: Cornerstone260) -> None:
    assert lines(device, b"ADDRESS?\n", 200.0) == [b"4"]
    exchange(device, b"ADDRESS  9\n", 201.0)  # as fsc2's oriel_cs_260.c sends it
    device.reset(202.0)
    assert lines(device, b"ADDRESS?\n", 203.0) == [b"9"]


def test_the_shutter_lets_light_through_when_it_has_opened(rig: VirtualRig, device: Cornerstone260) -> None:
    exchange(device, b"SHUTTER O\n", 200.0)
    assert rig.plant.pupil_radiance(200.1) == 0.0
    assert rig.plant.pupil_radiance(200.2) > 0.0


def test_an_endless_line_fills_no_memory(device: Cornerstone260) -> None:
    device.receive(b"A" * 100_000, 200.0)
    device.outbox.clear()
    (_, *_) = exchange(device, b"\n", 201.0)
    assert exchange(device, b"ERROR?\n", 202.0)[1][1] == b"1\r\n"


def lines(device: Cornerstone260, line: bytes, t: float) -> list[bytes]:
    """The lines of an answer, without the echo."""
    return [text.rstrip() for _, text in exchange(device, line, t)][1:]


def test_the_wavelength_changes_continuously_while_the_grating_turns(rig: VirtualRig, device: Cornerstone260) -> None:
    exchange(device, b"GOWAVE 725\n", 200.0)  # 175 nm at 175 nm/s
    assert rig.plant.wavelength_nm.at(200.502) == pytest.approx(550.0 + 87.5, abs=1e-6)
    assert rig.plant.wavelength_nm.at(199.0) == 550.0
    assert rig.plant.wavelength_nm.at(300.0) == 725.0


def test_abort_stops_the_grating_and_queued_commands_follow(rig: VirtualRig, device: Cornerstone260) -> None:
    device.receive(b"GOWAVE 725\n", 200.0)
    device.receive(b"SHUTTER O\nWAVE?\n", 200.1)
    device.receive(b"abort\n", 200.502)
    answers = [text.rstrip() for _, text in device.outbox]
    assert answers == [b"GOWAVE 725", b"abort", b"SHUTTER O", b"WAVE?", b"637.500"]
    assert max(t for t, _ in device.outbox) < 201.0
    assert rig.plant.wavelength_nm.at(300.0) == pytest.approx(637.5)
    assert rig.plant.shutter_open.at(300.0)
    assert not rig.plant.shutter_open.at(200.6)


def test_in_handshake_mode_an_aborted_statement_ends_with_its_status(device: Cornerstone260) -> None:
    lines(device, b"HANDSHAKE 1\n", 200.0)
    device.receive(b"GOWAVE 725\n", 201.0)
    device.receive(b"ABORT\n", 201.5)
    assert [text.rstrip() for _, text in device.outbox] == [b"GOWAVE 725", b"00", b"ABORT", b"00"]


def test_a_statement_byte_by_byte_is_the_same_statement(device: Cornerstone260) -> None:
    for k, byte in enumerate(b"UNITS?\r\n"):
        device.receive(bytes((byte,)), 200.0 + 1e-3 * k)
    assert b"".join(text for _, text in device.outbox) == b"UNITS?\r\nNM\r\n"


@pytest.mark.parametrize(
    ("command", "query", "answer"),
    [
        (b"GRAT1LABEL red", b"GRAT1LABEL?", b"red"),
        (b"GRAT2LINES 300", b"GRAT2LINES?", b"300"),
        (b"GRAT1ZERO 0.25", b"GRAT1ZERO?", b"0.2500"),
        (b"GRAT1FACTOR 1.001", b"GRAT1FACTOR?", b"1.001000"),
        (b"GRAT2OFFSET -0.25", b"GRAT2OFFSET?", b"-0.250000"),
        (b"GRAT1OFFSET 0.5", b"WAVE?", b"550.500"),
        (b"CALIBRATE 551.5", b"GRAT1OFFSET?", b"1.500000"),
        (b"GRAT 2", b"GRAT?", b"2,600,NIR"),
        (b"FILTER 3", b"FILTER?", b"3"),
        (b"FILTER3LABEL OG550", b"FILTER3LABEL?", b"OG550"),
        (b"OUTPORT 2", b"OUTPORT?", b"2"),
        (b"SLIT2MICRONS 500", b"SLIT2MICRONS?", b"500"),
        (b"BANDPASS 3.2", b"BANDPASS?", b"3.200"),
        (b"UNITS um", b"WAVE?", b"0.550000"),
        (b"UNITS WN", b"WAVE?", b"18181.82"),
        (b"STEP 100", b"WAVE?", b"551.000"),  # 0.01 nm a step with 1200 lines/mm
        (b"STEP -100", b"STEP?", b"54900"),
        (b"CALIBRATE 551.5", b"WAVE?", b"551.500"),
        (b"Shutter  o  ", b"shutter?", b"O"),
    ],
)
def test_a_query_returns_the_set_value(device: Cornerstone260, command: bytes, query: bytes, answer: bytes) -> None:
    assert lines(device, command + b"\r\n", 200.0) == []
    assert lines(device, query + b"\n", 300.0) == [answer]
    assert lines(device, b"STB?\n", 301.0) == [b"00"]


@pytest.mark.parametrize(
    ("line", "error"),
    [
        (b"GRAT1LABEL much too long", b"9"),
        (b"GRAT 9", b"3"),
        (b"GRAT9LINES?", b"2"),
        (b"SLIT4MICRONS 10", b"2"),
        (b"SLIT1MICRONS 99999", b"3"),
        (b"OUTPORT 3", b"2"),
        (b"UNITS ell", b"2"),
        (b"STEP 1.5", b"2"),
        (b"STEP 999999", b"3"),
        (b"ADDRESS 31", b"2"),
        (b"HANDSHAKE 2", b"2"),
        (b"\xff\xfe", b"1"),
        (b"WAVE", b"1"),
        (b"GOWAVE nan", b"2"),
        (b"IDLE?", b"1"),
    ],
)
def test_an_unsupported_command_sets_the_error_code(device: Cornerstone260, line: bytes, error: bytes) -> None:
    lines(device, line + b"\n", 200.0)
    assert lines(device, b"ERROR?\n", 201.0) == [error]


def test_a_calibration_moves_the_numbers_and_not_the_light(rig: VirtualRig, device: Cornerstone260) -> None:
    exchange(device, b"CALIBRATE 560\n", 200.0)
    assert rig.plant.wavelength_nm.at(201.0) == 550.0
    exchange(device, b"GOWAVE 570\n", 202.0)
    assert rig.plant.wavelength_nm.at(300.0) == pytest.approx(560.0)


@pytest.mark.parametrize(("command", "seconds"), [(b"GRAT 2", 8.0), (b"FILTER 4", 3.0), (b"SLIT1MICRONS 700", 1.0)])
def test_what_moves_takes_its_time(device: Cornerstone260, command: bytes, seconds: float) -> None:
    exchange(device, command + b"\n", 200.0)
    (_, answer) = exchange(device, b"INFO?\n", 200.1)
    assert answer[0] == pytest.approx(200.0 + seconds, abs=0.01)


def test_the_wheel_goes_from_position_to_position_and_an_abort_leaves_it_at_the_nearest(
    rig: VirtualRig, device: Cornerstone260
) -> None:
    exchange(device, b"FILTER 5\n", 200.0)
    assert [rig.plant.filter_position(t) for t in (199.9, 200.4, 201.6, 203.4, 203.6, 300.0)] == [1, 1, 3, 4, 5, 5]
    exchange(device, b"FILTER 1\n", 210.0)  # it answers only when it is there, unless it is aborted
    device.receive(b"ABORT\nFILTER?\n", 211.7)
    assert device.outbox.pop()[1] == b"3\r\n"
    assert [rig.plant.filter_position(t) for t in (211.0, 211.7, 300.0)] == [4, 3, 3]
    device.reset(400.0)
    assert rig.plant.filter_position(400.0) == 1


def test_a_filter_that_waited_behind_what_is_aborted_is_put_in_after_it(rig: VirtualRig, device: Cornerstone260) -> None:
    device.receive(b"GOWAVE 725\nFILTER 3\n", 200.0)
    device.receive(b"ABORT\n", 200.5)
    assert rig.plant.wavelength_nm.at(300.0) == pytest.approx(637.5, abs=0.5)
    assert [rig.plant.filter_position(t) for t in (200.9, 202.0, 203.0)] == [1, 2, 3]


def test_a_unit_without_a_filter_wheel_or_handshake_reports_an_error(rig: VirtualRig) -> None:
    rig.plant.model = replace(rig.plant.model, monochromator=replace(rig.plant.model.monochromator, filters=0, handshake=False))
    device = Cornerstone260(rig.plant)
    lines(device, b"FILTER 2\n", 200.0)
    assert lines(device, b"ERROR?\n", 201.0) == [b"6"]
    assert lines(device, b"HANDSHAKE 1\n", 202.0) == []
    assert lines(device, b"ERROR?\n", 203.0) == [b"1"]


def test_a_reset_forgets_what_is_volatile(rig: VirtualRig, device: Cornerstone260) -> None:
    for command in (b"GRAT1LABEL red\n", b"HANDSHAKE 1\n", b"UNITS WN\n", b"SHUTTER O\n"):
        exchange(device, command, 200.0)
    device.reset(210.0)
    assert lines(device, b"UNITS?\n", 211.0) == [b"NM"]
    assert lines(device, b"GRAT1LABEL?\n", 212.0) == [b"red"]
    assert not rig.plant.shutter_open.at(212.0)


def test_a_line_ends_with_lf_and_cr_alone_ends_none(device: Cornerstone260) -> None:
    assert [text for _, text in exchange(device, b"UNITS?\r", 200.0)] == [b"UNITS?\r"]  # the echo
    assert lines(device, b"\n", 201.0) == [b"NM"]
    assert lines(device, b"UNITS?\rWAVE?\n", 202.0) == []
    assert lines(device, b"ERROR?\r\n", 203.0) == [b"1"]


@pytest.mark.parametrize(("length", "error"), [(256, b"2"), (257, b"1"), (258, b"1"), (700, b"1")])
def test_the_longest_line_is_the_same_in_one_piece_and_byte_by_byte(device: Cornerstone260, length: int, error: bytes) -> None:
    line = b"GOWAVE " + b"x" * (length - 7)
    for pieces in ([line + b"\r\n"], [bytes((byte,)) for byte in line + b"\r\n"]):
        for piece in pieces:
            exchange(device, piece, 200.0)
        assert lines(device, b"ERROR?\n", 201.0) == [error]
