"""TMCL frames, against those of the manufacturer's own client and manual."""

import contextlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import tmcl
from goniotwin.protocols.tmcl_parameters import AxisParameter

BYTE = st.integers(0, 255)
VALUE = st.integers(-(2**31), 2**31 - 1)

# Captured from PyTrinamic.
GOLDEN = [
    (tmcl.CommandFrame(1, tmcl.Command.FIRMWARE_VERSION, 0, 0, 0), "01 88 00 00 00 00 00 00 89"),
    (tmcl.CommandFrame(1, tmcl.Command.SAP, 6, 3, 100), "01 05 06 03 00 00 00 64 73"),
    (tmcl.CommandFrame(1, tmcl.Command.MVP, tmcl.MoveType.ABSOLUTE, 3, 51200), "01 04 00 03 00 00 c8 00 d0"),
    (tmcl.CommandFrame(1, tmcl.Command.GAP, AxisParameter.POSITION_REACHED, 3, 0), "01 06 08 03 00 00 00 00 12"),
]


@pytest.mark.parametrize(("request_", "frame"), GOLDEN)
def test_requests_are_the_published_frames(request_: tmcl.CommandFrame, frame: str) -> None:
    assert request_.encode() == bytes.fromhex(frame)
    assert tmcl.CommandFrame.decode(bytes.fromhex(frame)) == request_


def test_an_error_reply_is_the_published_frame() -> None:
    reply = tmcl.ReplyFrame(2, 1, tmcl.ReplyStatus.WRONG_TYPE, tmcl.Command.GAP, 0)
    assert reply.encode() == bytes.fromhex("02 01 03 06 00 00 00 00 0c")


def test_the_version_text_is_the_manuals_special_reply() -> None:
    assert tmcl.encode_version_text(2, "6214V117") == b"\x026214V117"
    assert tmcl.decode_version_text(b"\x026214V117") == "6214V117"


@given(BYTE, BYTE, BYTE, BYTE, VALUE)
def test_a_request_survives_the_wire(address: int, command: int, kind: int, motor: int, value: int) -> None:
    request = tmcl.CommandFrame(address, command, kind, motor, value)
    assert tmcl.CommandFrame.decode(request.encode()) == request
    assert str(request)


@given(BYTE, BYTE, BYTE, BYTE, VALUE)
def test_a_reply_survives_the_wire(host: int, address: int, status: int, command: int, value: int) -> None:
    reply = tmcl.ReplyFrame(host, address, status, command, value)
    assert tmcl.ReplyFrame.decode(reply.encode()) == reply
    assert str(reply)


@given(st.binary(max_size=20))
def test_other_bytes_are_frame_errors(data: bytes) -> None:
    for decode in (tmcl.CommandFrame.decode, tmcl.ReplyFrame.decode, tmcl.decode_version_text):
        try:
            decode(data)
        except tmcl.FrameError:
            continue
        assert len(data) == tmcl.FRAME_BYTES


@given(st.integers(0, 8), st.integers(1, 255), VALUE)
def test_one_changed_byte_is_noticed(place: int, change: int, value: int) -> None:
    frame = bytearray(tmcl.CommandFrame(1, 5, 4, 3, value).encode())
    frame[place] = (frame[place] + change) & 0xFF
    with pytest.raises(tmcl.FrameError):
        tmcl.CommandFrame.decode(bytes(frame))


def test_what_does_not_fit_is_refused() -> None:
    with pytest.raises(tmcl.FrameError, match="does not fit"):
        tmcl.CommandFrame(1, 4, 0, 0, 2**31).encode()
    with pytest.raises(tmcl.FrameError, match="8 characters"):
        tmcl.encode_version_text(2, "short")


@given(st.binary(max_size=60), st.lists(st.integers(0, 60), max_size=8))
def test_any_split_of_the_bytes_gives_the_same_frames(data: bytes, cuts: list[int]) -> None:
    whole, rest = tmcl.split(data)
    places = sorted({0, *(min(cut, len(data)) for cut in cuts), len(data)})
    frames: list[bytes] = []
    left = b""
    for begin, end in pairwise(places):
        found, left = tmcl.split(left + data[begin:end])
        frames += found
        assert len(left) < tmcl.FRAME_BYTES
    assert (frames, left) == (whole, rest)
    assert b"".join(frames) + left == data


@given(st.lists(st.tuples(BYTE, BYTE, BYTE, BYTE, VALUE), max_size=5))
def test_frames_in_a_row_are_the_frames(fields: list[tuple[int, int, int, int, int]]) -> None:
    requests = [tmcl.CommandFrame(*each) for each in fields]
    frames, rest = tmcl.split(b"".join(request.encode() for request in requests))
    assert [tmcl.CommandFrame.decode(frame) for frame in frames] == requests
    assert rest == b""


def test_one_in_255_errors_of_two_bytes_is_not_noticed() -> None:
    """What a sum cannot see: of all changes of two given bytes, each to another value, one second one for each first."""
    frame = tmcl.ReplyFrame(2, 1, 100, 6, 51_200).encode()
    passed = 0
    for first in range(1, 256):
        for second in range(1, 256):
            changed = bytearray(frame)
            changed[6] = (changed[6] + first) & 0xFF
            changed[7] = (changed[7] + second) & 0xFF
            passed += tmcl.checksum(bytes(changed[:8])) == changed[8]
    assert passed == 255  # of 255 * 255


@pytest.mark.long
def test_a_million_inputs_raise_nothing_but_the_decoders_error() -> None:
    generator = np.random.default_rng(1)
    for _ in range(1000):
        block = generator.integers(0, 256, 12_000, dtype=np.uint8).tobytes()
        lengths = generator.integers(0, 12, 1000)
        place = 0
        for length in lengths:
            data = block[place : place + int(length)]
            place += int(length)
            for decode in (tmcl.CommandFrame.decode, tmcl.ReplyFrame.decode, tmcl.decode_version_text):
                with contextlib.suppress(tmcl.FrameError):
                    assert str(decode(data))
            frames, rest = tmcl.split(data)
            assert b"".join(frames) + rest == data
