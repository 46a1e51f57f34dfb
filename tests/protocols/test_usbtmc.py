"""USBTMC headers."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocols import usbtmc

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
