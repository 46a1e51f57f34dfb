"""A million generated inputs for every decoder: nothing escapes but its own error, and memory stays bounded."""

from collections.abc import Callable, Iterator

import numpy as np
import pytest

from goniotwin.protocols import cornerstone, scpi, tmcl, usb_descriptors, usbip, usbtmc

pytestmark = pytest.mark.long
INPUTS = 1_000_000
LONGEST = 40


def _taker(take: Callable[[bytearray], object], zeros: int | None = None) -> Callable[[bytes], object]:
    """A decoder that takes from a buffer; with `zeros` so many before the input and 24 behind it, so that headers are whole."""
    if zeros is None:
        return lambda data: take(bytearray(data))
    return lambda data: take(bytearray(bytes(zeros) + data + bytes(24)))


# Bytes that mean something to a decoder are drawn as often as all others together, so that it gets far.
DECODERS: dict[str, tuple[Callable[[bytes], object], type[ValueError], bytes]] = {
    "TMCL request": (tmcl.CommandFrame.decode, tmcl.FrameError, bytes(range(9))),
    "TMCL reply": (tmcl.ReplyFrame.decode, tmcl.FrameError, bytes((1, 2, 4, 5, 6, 100))),
    "TMCL version": (tmcl.decode_version_text, tmcl.FrameError, b"6214V1"),
    "Cornerstone statement": (cornerstone.Statement.decode, cornerstone.StatementError, b"GOWAVE? 0123.\r\n"),
    "Cornerstone status": (cornerstone.decode_status, cornerstone.StatementError, b"0123456789ABCDEF\r\n"),
    "Cornerstone number": (cornerstone.decode_number, cornerstone.StatementError, b"0123456789.eE+-\r\n"),
    "SCPI program": (scpi.parse, scpi.ScpiError, b"SENSe:CURR*?;, '\"0123.E-\n"),
    "SCPI number": (scpi.decode_number, scpi.ScpiError, b"0123456789.eE+-\n"),
    "SCPI error": (scpi.decode_error, scpi.ScpiError, b'+-0123,"No error"'),
    "USB device": (usb_descriptors.decode_device, usb_descriptors.DescriptorError, bytes((1, 2, 4, 5, 9, 18))),
    "USB configuration": (usb_descriptors.decode_configuration, usb_descriptors.DescriptorError, bytes((2, 4, 5, 7, 9, 32))),
    "USB string": (usb_descriptors.decode_string, usb_descriptors.DescriptorError, bytes((2, 3, 4, 40))),
    "USB/IP operation": (_taker(usbip.take_request), usbip.UsbIpError, bytes((0, 1, 0x11, 3, 5, 0x80))),
    "USB/IP list": (_taker(usbip.take_list), usbip.UsbIpError, bytes((0, 1, 0x11, 3, 5))),
    "USB/IP import": (_taker(usbip.take_import), usbip.UsbIpError, bytes((0, 1, 0x11, 3))),
    "USB/IP command": (_taker(usbip.take_command, 0), usbip.UsbIpError, bytes((0, 1, 2, 0xFF))),
    "USB/IP result": (_taker(lambda buffer: usbip.take_result(buffer, {0}), 2), usbip.UsbIpError, bytes((0, 3, 4))),
    "USBTMC header": (usbtmc.Header.decode, usbtmc.HeaderError, bytes((0, 1, 2, 0xFE, 0xFD))),
}


def inputs(alphabet: bytes) -> Iterator[bytes]:
    """Byte strings of 0 to 40 bytes, half of each from the alphabet."""
    generator = np.random.Generator(np.random.Philox(2026))
    known = np.frombuffer(alphabet, dtype=np.uint8)
    for _ in range(INPUTS // 1000):
        any_byte = generator.integers(0, 256, (1000, LONGEST), dtype=np.uint8)
        meant = known[generator.integers(0, known.size, (1000, LONGEST))]
        block = np.where(generator.random((1000, LONGEST)) < generator.random((1000, 1)), any_byte, meant)
        for row, length in zip(block, generator.integers(0, LONGEST + 1, 1000), strict=True):
            yield row[:length].tobytes()


@pytest.mark.parametrize("name", DECODERS)
def test_nothing_escapes_but_the_decoders_own_error(name: str) -> None:
    decode, error, alphabet = DECODERS[name]
    understood = 0
    for data in inputs(alphabet):
        try:
            decode(data)
        except error:
            continue
        understood += 1
    print(f"{name}: {understood} of {INPUTS} understood")


def test_framing_keeps_little_and_loses_nothing() -> None:
    tmcl_rest = lines_rest = b""
    for data in inputs(b"\r\nGOWAVE"):
        frames, tmcl_rest = tmcl.split(tmcl_rest + data)
        assert all(len(frame) == tmcl.FRAME_BYTES for frame in frames)
        assert len(tmcl_rest) < tmcl.FRAME_BYTES
        _, lines_rest = cornerstone.take_lines(lines_rest, data)
        assert len(lines_rest) <= 2 * cornerstone.MAX_LINE
