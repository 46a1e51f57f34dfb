"""The modules' ends of the wires: any split of the bytes gives the same requests, and rubbish gives none."""

from itertools import pairwise
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from goniotwin.protocols import adam
from goniotwin.twin.devices import Adam4117, Adam6017, ConverterModule, RtuStation, TcpStation
from goniotwin.twin.optics import Instrument
from goniotwin.twin.plant import Electronics, Plant, TwinModel

BYTE_S = 10 / 9600


def plant_of(**electronics: Any) -> Plant:
    model = TwinModel(seed=1, axes={}, samples={}, instrument=Instrument(), noise=False, electronics=Electronics(**electronics))
    return Plant(model)


PLANT = plant_of()


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


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("01 2B 0E 01 00", "01 AB 01"),
        ("01 17 0000 0001 0000 0001 02 0000", "01 97 01"),
        ("01 07", "01 87 01"),
        ("01 03 0000 0000", "01 83 03"),
        ("01 03 0000 007E", "01 83 03"),
        ("01 05 0010 1234", "01 85 03"),
        ("01 10 00C8 0002 02 0008", "01 90 03"),
        ("01 03 0063 0001", "01 83 02"),
        ("01 08 0000 A55A", "01 08 0000 A55A"),
        ("01 08 0001 0000", "01 88 01"),
        ("01 06 00C8 9999", "01 86 03"),
    ],
)
def test_what_a_module_does_not_do_is_an_exception(request_: str, answer: str) -> None:
    station = line()
    station.receive(rtu(request_), 10.0)
    assert take_answers(station) == [rtu(answer)]


def test_all_units_of_a_line_hear_a_broadcast_and_none_answers() -> None:
    station = line()
    station.receive(rtu("00 06 00C8 0048"), 10.0)
    assert take_answers(station) == []
    assert [device.inputs.ranges[0] for device in station.devices] == [0x48, 0x48]
    station.receive(rtu("03 03 0000 0001"), 11.0)
    assert take_answers(station) == []


def test_a_module_without_function_16_has_function_6() -> None:
    station = RtuStation([Adam4117(plant_of(module="adam-4117", multiple_writes=False), 0, 1)])
    station.receive(rtu("01 10 00C8 0001 02 0009"), 10.0)
    assert take_answers(station) == [rtu("01 90 01")]
    station.receive(rtu("01 06 00C8 0009"), 11.0)
    station.receive(rtu("01 04 00C8 0001"), 12.0)
    assert take_answers(station) == [rtu("01 06 00C8 0009"), rtu("01 04 02 0009")]


def test_the_format_of_raw_values_is_a_setting_of_the_module() -> None:
    """Twos complement: ADAM-4000 Series User's Manual, B.1.3. Unsigned: the maker's .NET library divides by 65535."""
    formats: tuple[adam.RawFormat, ...] = ("unsigned", "twos-complement")
    devices = [Adam4117(plant_of(module="adam-4117", raw_format=each), 0, 1) for each in formats]
    for address, count in ((0, 8), (1, 1), (0, 1)):
        unsigned, signed = ([*device.registers(address, count, 10.0)] for device in devices)
        assert [value ^ 0x8000 for value in unsigned] == signed
    assert unsigned[0] in range(0x8000, 0x8010)  # dark, 1 mV: just above zero


@pytest.mark.parametrize(("units", "answered"), [(None, {0, 1, 255}), ((1,), {1}), ((7, 8), {7, 8})])
def test_which_units_a_module_answers_over_tcp_is_a_setting(units: tuple[int, ...] | None, answered: set[int]) -> None:
    """255, and 0 as well, are units of a server that needs none: Modbus Messaging on TCP/IP 1.0b, p. 23, as quoted."""
    device = Adam6017(PLANT if units is None else plant_of(tcp_units=units), 0)
    assert device.unit == (1 if units is None else units[0])
    station = TcpStation(device)
    for unit in range(256):
        station.receive(bytes.fromhex(f"0001 0000 0006 {unit:02x} 03 00D2 0001"), 10.0)
    assert {answer[6] for answer in take_answers(station)} == answered


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


TOO_LONG = [
    pytest.param(bytes.fromhex(f"0009 0000 {length:04x} 01 03") + bytes(written), id=f"{length} stated, {written} there")
    for length in (255, 256, 262, 0xFFFF)
    for written in (0, 4, length - 2 if length < 1000 else 300)
]


@pytest.mark.parametrize("piece", [1, 7, 8, 1000])
@pytest.mark.parametrize("frame", TOO_LONG)
def test_a_tcp_frame_longer_than_any_does_not_take_the_next_ones_with_it(frame: bytes, piece: int) -> None:
    """Modbus Messaging on TCP/IP has 260 bytes at most, of which the stated length counts all but six."""
    station = TcpStation(Adam6017(PLANT, 0))
    stream = frame + bytes.fromhex("0001 0000 0006 01 03 00D2 0002" + "0002 0000 0006 01 04 00D2 0001")
    for start in range(0, len(stream), piece):
        station.receive(stream[start : start + piece], 10.0)
    assert take_answers(station) == [
        bytes.fromhex("0001 0000 0007 01 03 04 6017 0000"),
        bytes.fromhex("0002 0000 0005 01 04 02 6017"),
    ]


@given(st.binary(max_size=600))
def test_a_tcp_station_takes_any_bytes_and_keeps_few(rubbish: bytes) -> None:
    station = TcpStation(Adam6017(PLANT, 0))
    station.receive(rubbish, 10.0)
    assert all(len(data) <= 260 for data in take_answers(station))
    assert station.waiting <= 260
