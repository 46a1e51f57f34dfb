"""The modules' ends of the wires: any split of the bytes gives the same requests, and rubbish gives none."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from goniotwin.twin.devices import Adam4117, Adam6017, ConverterModule, RtuStation, TcpStation
from goniotwin.twin.optics import Instrument
from goniotwin.twin.plant import Plant, TwinModel

BYTE_S = 10 / 9600
PLANT = Plant(TwinModel(seed=1, axes={}, samples={}, instrument=Instrument(), noise=False))


def rtu(body: str) -> bytes:
    data = bytes.fromhex(body)
    return data + FramerRTU.compute_CRC(data).to_bytes(2, "big")


def line() -> RtuStation:
    devices: list[ConverterModule] = [Adam4117(PLANT, 0, 1), Adam4117(PLANT, 1, 2)]
    return RtuStation(devices)


def take_answers(station: RtuStation | TcpStation) -> list[bytes]:
    answers = [data for _, data in station.outbox]
    station.outbox.clear()
    return answers


NAME = rtu("01 03 00 D2 00 01")
NAME_ANSWER = rtu("01 03 02 41 17")


def test_published_frames() -> None:
    """Modicon's own example of a checksum: 02 07 has 41 12."""
    assert rtu("02 07").hex() == "02074112"
    station = line()
    station.receive(NAME, 10.0)
    assert take_answers(station) == [NAME_ANSWER]


@given(st.lists(st.integers(1, 7), max_size=7))
def test_any_split_of_an_rtu_frame_is_the_same_request(cuts: list[int]) -> None:
    station = line()
    edges = sorted({0, *cuts, len(NAME)})
    for start, end in pairwise(edges):
        station.receive(NAME[start:end], 10.0 + end * BYTE_S)
    assert take_answers(station) == [NAME_ANSWER]


@given(st.lists(st.integers(1, 23), max_size=23))
def test_any_split_of_two_tcp_requests_is_the_same_two(cuts: list[int]) -> None:
    station = TcpStation(Adam6017(PLANT, 0))
    stream = bytes.fromhex("0001 0000 0006 01 03 00D2 0002" + "0002 0000 0006 01 04 00D2 0001")
    edges = sorted({0, *cuts, len(stream)})
    for start, end in pairwise(edges):
        station.receive(stream[start:end], 10.0)
    assert take_answers(station) == [
        bytes.fromhex("0001 0000 0007 01 03 04 6017 0000"),
        bytes.fromhex("0002 0000 0005 01 04 02 6017"),
    ]


def test_half_a_frame_is_forgotten_after_a_gap_and_not_before() -> None:
    station = line()
    station.receive(NAME[:5], 10.0)
    station.receive(NAME, 10.0 + 4.0 * BYTE_S + len(NAME) * BYTE_S)
    assert take_answers(station) == [NAME_ANSWER]
    station.receive(NAME[:5], 20.0)
    station.receive(NAME, 20.0 + 3.0 * BYTE_S + len(NAME) * BYTE_S)
    assert take_answers(station) == []


def test_a_wrong_checksum_is_silent_until_the_next_gap() -> None:
    station = line()
    station.receive(NAME[:-1] + b"\0" + NAME, 10.0)
    assert take_answers(station) == []
    station.receive(NAME, 11.0)
    assert take_answers(station) == [NAME_ANSWER]


@pytest.mark.parametrize(("request_", "answer"), [
    ("01 2B 0E 01 00", "01 AB 01"), ("01 17 0000 0001 0000 0001 02 0000", "01 97 01"), ("01 07", "01 87 01"),
    ("01 03 0000 0000", "01 83 03"), ("01 03 0000 007E", "01 83 03"), ("01 05 0010 1234", "01 85 03"),
    ("01 10 00C8 0002 02 0143", "01 90 03"), ("01 03 0063 0001", "01 83 02"), ("01 08 0000 A55A", "01 08 0000 A55A"),
    ("01 08 0001 0000", "01 88 01"), ("01 06 00C8 9999", "01 86 03"),
])  # fmt: skip
def test_what_a_module_does_not_do_is_an_exception(request_: str, answer: str) -> None:
    station = line()
    station.receive(rtu(request_), 10.0)
    assert take_answers(station) == [rtu(answer)]


def test_all_units_of_a_line_hear_a_broadcast_and_none_answers() -> None:
    station = line()
    station.receive(rtu("00 06 00C8 0148"), 10.0)
    assert take_answers(station) == []
    assert [device.inputs.ranges[0] for device in station.devices] == [0x0148, 0x0148]
    station.receive(rtu("03 03 0000 0001"), 11.0)
    assert take_answers(station) == []


def test_a_silent_module_leaves_its_neighbours_alone() -> None:
    station = line()
    station.devices[0].silent = True
    station.receive(NAME, 10.0)
    station.receive(rtu("02 03 00 D2 00 01"), 11.0)
    assert take_answers(station) == [rtu("02 03 02 41 17")]


@given(st.lists(st.binary(max_size=40), max_size=12))
def test_rubbish_is_survived_and_the_next_frame_after_a_gap_is_heard(chunks: list[bytes]) -> None:
    station, t = line(), 10.0
    for chunk in chunks:
        t += 0.003
        station.receive(chunk, t)
    take_answers(station)
    station.reset(t)
    station.receive(NAME, t + 1.0)
    assert take_answers(station) == [NAME_ANSWER]


@given(st.binary(max_size=600))
def test_a_tcp_station_takes_any_bytes_and_keeps_few(rubbish: bytes) -> None:
    station = TcpStation(Adam6017(PLANT, 0))
    station.receive(rubbish, 10.0)
    assert all(len(data) <= 260 for data in take_answers(station))
    assert len(station._buffer) <= 260
