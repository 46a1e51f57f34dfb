"""USB/IP: golden bytes of the kernel's documentation, and any split of the bytes gives the same messages."""

from collections.abc import Callable
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import usbip

T = TypeVar("T")
WORD = st.integers(0, 0xFFFF_FFFF)
NAME = st.text("abcdefghijklmnopqrstuvwxyz0123456789-./", max_size=31)
BYTE = st.integers(0, 255)
KIND = st.tuples(BYTE, BYTE, BYTE)
HALF = st.integers(0, 0xFFFF)


@st.composite
def devices(draw: st.DrawFn) -> usbip.ExportedDevice:
    kinds = tuple(draw(st.lists(KIND, max_size=3)))
    return usbip.ExportedDevice(
        draw(NAME),
        draw(NAME),
        draw(WORD),
        draw(WORD),
        draw(WORD),
        draw(HALF),
        draw(HALF),
        draw(HALF),
        draw(KIND),
        draw(BYTE),
        draw(BYTE),
        len(kinds),
        kinds,
    )


SUBMITS = st.builds(
    lambda number, device, endpoint, to_host, length, data, setup, flags: usbip.Submit(
        number, device, endpoint, to_host, length if to_host else len(data), b"" if to_host else data, setup, flags
    ),
    WORD,
    WORD,
    st.integers(0, 15),
    st.booleans(),
    st.integers(0, usbip.LONGEST_TRANSFER),
    st.binary(max_size=60),
    st.binary(min_size=8, max_size=8),
    WORD,
)
COMMANDS = st.one_of(SUBMITS, st.builds(usbip.Unlink, WORD, WORD, WORD))


def pieces(data: bytes, sizes: list[int], take: Callable[[bytearray], T | None]) -> list[T]:
    """What `take` finds where the bytes come in pieces of these sizes, and then all the rest."""
    buffer, found = bytearray(), []
    for size in (*sizes, len(data)):
        buffer += data[:size]
        data = data[size:]
        while (message := take(buffer)) is not None:
            found.append(message)
    assert not buffer
    return found


def test_the_documented_transfers() -> None:
    """Captured from a wire, in the kernel's documentation: an interrupt transfer of 64 bytes each way."""
    to_host = bytes.fromhex(
        "00000001 00000d05 0001000f 00000001 00000001 00000200 00000040 ffffffff 00000000 00000004 00000000 00000000"
    )
    found = usbip.take_command(bytearray(to_host))
    assert found == usbip.Submit(0xD05, 0x1000F, 1, True, 64, flags=0x200, interval=4, packets=0)
    ended = bytes.fromhex(
        "00000003 00000d06 00000000 00000000 00000000 00000000 00000040 ffffffff 00000000 00000000 00000000 00000000"
    )
    assert usbip.take_result(bytearray(ended), set()) == usbip.Submitted(0xD06, 0, 64)
    assert usbip.take_request(bytearray.fromhex("0111 8005 00000000")) == usbip.ListRequest()
    request = bytearray.fromhex("0111 8003 00000000") + b"3-2".ljust(32, b"\0")
    assert usbip.take_request(request) == usbip.ImportRequest("3-2")


@given(st.lists(COMMANDS, max_size=4), st.lists(st.integers(1, 70), max_size=10))
def test_commands_survive_any_split(commands: list[usbip.Submit | usbip.Unlink], sizes: list[int]) -> None:
    data = b"".join(each.encode() for each in commands)
    assert pieces(data, sizes, usbip.take_command) == commands


@given(
    st.lists(st.tuples(WORD, st.integers(-200, 0), st.binary(max_size=60)), max_size=4, unique_by=lambda each: each[0]),
    st.lists(st.integers(1, 70), max_size=10),
)
def test_results_survive_any_split(results: list[tuple[int, int, bytes]], sizes: list[int]) -> None:
    sent = [usbip.Submitted(number, status, len(data), data) for number, status, data in results]
    ended = [usbip.Unlinked(number, status) for number, status, _ in results]
    data = b"".join([each.encode() for each in sent] + [each.encode() for each in ended])
    assert pieces(data, sizes, lambda buffer: usbip.take_result(buffer, {each.number for each in sent})) == [*sent, *ended]


@given(st.lists(devices(), max_size=4), st.lists(st.integers(1, 400), max_size=6))
def test_lists_and_imports_survive_any_split(exported: list[usbip.ExportedDevice], sizes: list[int]) -> None:
    assert pieces(usbip.listed(exported), sizes, usbip.take_list) == [exported]
    for device in exported:
        (found,) = pieces(usbip.Imported(device).encode(), sizes, usbip.take_import)
        assert found.device == usbip.ExportedDevice(**{**vars(device), "interfaces": ()})
    assert pieces(usbip.Imported(None).encode(), sizes, usbip.take_import) == [usbip.Imported(None)]


@given(st.binary(max_size=400))
def test_nothing_escapes_but_its_own_error(data: bytes) -> None:
    for take in (usbip.take_request, usbip.take_list, usbip.take_import, usbip.take_command):
        try:
            take(bytearray(data))
        except usbip.UsbIpError:
            continue


def test_what_would_fill_the_memory_is_refused() -> None:
    huge = usbip.Submit(1, 1, 2, False, 0x7FFF_FFFF).encode()
    with pytest.raises(usbip.UsbIpError, match="2147483647 bytes"):
        usbip.take_command(bytearray(huge))
    with pytest.raises(usbip.UsbIpError, match="devices"):
        usbip.take_list(bytearray.fromhex("0111 0005 00000000 ffffffff"))
