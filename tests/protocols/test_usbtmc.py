"""USBTMC headers."""

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import usbtmc

TAG = st.integers(1, 255)


def test_messages_are_the_golden_bytes() -> None:
    assert usbtmc.message(usbtmc.MsgId.DEV_DEP_MSG_OUT, 1, b"*IDN?") == bytes.fromhex(
        "01 01 FE 00 05 00 00 00 01 00 00 00 2A 49 44 4E 3F 00 00 00"
    )
    assert usbtmc.request_in(2, 1024) == bytes.fromhex("02 02 FD 00 00 04 00 00 00 00 00 00")
    answer = b"Thorlabs,PM100D,P0012345,2.8.0\n"
    golden = bytes.fromhex("02 02 FD 00 1F 00 00 00 01 00 00 00") + answer + b"\0"
    assert usbtmc.message(usbtmc.MsgId.DEV_DEP_MSG_IN, 2, answer) == golden


@given(st.sampled_from([1, 2]), TAG, st.integers(0, 2**32 - 1), st.booleans(), st.none() | st.integers(0, 255))
def test_a_header_survives_the_wire(msg_id: int, tag: int, size: int, end: bool, term: int | None) -> None:
    header = usbtmc.Header(msg_id, tag, size, end, term)
    assert usbtmc.Header.decode(header.encode()) == header


@given(TAG, st.binary(max_size=300))
def test_a_message_is_padded_to_four_bytes(tag: int, payload: bytes) -> None:
    data = usbtmc.message(usbtmc.MsgId.DEV_DEP_MSG_OUT, tag, payload)
    header = usbtmc.Header.decode(data)
    assert len(data) % 4 == 0
    assert data[12 : 12 + header.size] == payload


@given(st.binary(max_size=30))
def test_other_bytes_are_header_errors(data: bytes) -> None:
    try:
        header = usbtmc.Header.decode(data)
    except usbtmc.HeaderError:
        return
    assert header.tag == data[1] == data[2] ^ 0xFF


def test_tags_go_round_without_zero() -> None:
    tags = [1]
    for _ in range(255):
        tags.append(usbtmc.next_tag(tags[-1]))
    assert tags[:255] == list(range(1, 256))
    assert tags[255] == 1


def test_a_header_of_reserved_bytes_is_refused() -> None:
    data = bytearray(usbtmc.request_in(1, 10))
    data[3] = 1
    with pytest.raises(usbtmc.HeaderError, match="reserved"):
        usbtmc.Header.decode(bytes(data))


MESSAGES = st.lists(st.tuples(TAG, st.binary(max_size=50), st.booleans()), max_size=5)


@given(MESSAGES, st.booleans(), st.lists(st.integers(0, 400), max_size=8))
def test_messages_are_the_same_however_the_bytes_are_split(
    messages: list[tuple[int, bytes, bool]], from_host: bool, cuts: list[int]
) -> None:
    kind = usbtmc.MsgId.DEV_DEP_MSG_OUT if from_host else usbtmc.MsgId.DEV_DEP_MSG_IN
    data = b"".join(usbtmc.message(kind, tag, payload, end=end) for tag, payload, end in messages)
    places = sorted({0, len(data), *(cut for cut in cuts if cut < len(data))})
    found, pending = [], b""
    for start, stop in pairwise(places):
        pending += data[start:stop]
        while True:
            message, pending = usbtmc.take_message(pending, from_host=from_host)
            if message is None:
                break
            found.append(message)
    assert pending == b""
    assert [(each.header.tag, each.payload, each.header.end) for each in found] == messages


@given(st.binary(max_size=60), st.booleans())
def test_other_bytes_are_header_errors_or_not_whole(data: bytes, from_host: bool) -> None:
    try:
        message, rest = usbtmc.take_message(data, from_host=from_host)
    except usbtmc.HeaderError:
        return
    assert len(rest) < len(data) or message is None


def test_an_excessive_size_is_refused_before_data_are_stored() -> None:
    header = usbtmc.Header(usbtmc.MsgId.DEV_DEP_MSG_OUT, 1, 0xFFFF_FFFF).encode()
    with pytest.raises(usbtmc.HeaderError, match="4294967295 bytes"):
        usbtmc.take_message(header, from_host=True)


def test_status_tags_go_from_2_to_127() -> None:
    tags = [0]
    for _ in range(127):
        tags.append(usbtmc.next_status_tag(tags[-1]))
    assert tags[1:127] == list(range(2, 128))
    assert tags[127] == 2
