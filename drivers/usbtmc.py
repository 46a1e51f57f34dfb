"""A USBTMC instrument on pyusb: messages out, answers in.

Source: USB-IF, USBTMC 1.0 sections 3.2 and 3.3 (bulk messages), 4.2.1 (clear).
"""

import contextlib
import struct
from collections.abc import Callable
from typing import Any

import usb.core
import usb.util

from drivers.errors import BadAnswer, DeviceError, NoAnswer
from drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from protocols.usbtmc import (
    HEADER_BYTES,
    INTERFACE_CLASS,
    Header,
    HeaderError,
    MsgId,
    Request,
    Status,
    message,
    next_tag,
    request_in,
)

UsbOpener = Callable[[], Any]
"""Finds the pyusb device, None where it is not there."""

ANSWER_BYTES = 4096
CLASS_INTERFACE_IN = 0xA1
CLEAR_HALT_TYPE = 0x02
CLEAR_ROUNDS = 50


class UsbTmc:
    """The wire to one instrument."""

    def __init__(self, name: str, opener: UsbOpener, timeout_s: float = 1.0, tap: Tap = no_tap) -> None:
        self.name = name
        self._opener = opener
        self._timeout_ms = round(1000 * timeout_s)
        self._tap = tap
        self._device: Any = None
        self._tag = 0

    def connect(self) -> None:
        """Finds the device, takes its USBTMC interface, clears its buffers. Raises DeviceError."""
        try:
            device = self._opener()
        except (usb.core.NoBackendError, usb.core.USBError, LookupError, ValueError) as error:
            raise DeviceError(self.name, "find it on USB", str(error), "check the address in the rig file") from None
        if device is None:
            raise NoAnswer(self.name, "find it on USB", "it is not there", "check address, cable and power")
        try:
            self._claim(device)
            self.clear()
        except usb.core.USBError as error:
            self._device = None
            raise DeviceError(self.name, "open it", str(error), "see that no other program has it") from None

    def close(self) -> None:
        """Gives the interface back."""
        if self._device is not None:
            usb.util.dispose_resources(self._device)
            self._device = None

    def clear(self) -> None:
        """Device clear: input and output buffers are empty, settings stay. Raises DeviceError."""
        device = self._device
        self._control(Request.INITIATE_CLEAR, 1)
        for _ in range(CLEAR_ROUNDS):
            status = self._control(Request.CHECK_CLEAR_STATUS, 2)
            if status[0] != Status.PENDING:
                break
            if status[1] & 1:
                with contextlib.suppress(usb.core.USBTimeoutError):
                    device.read(self._in, ANSWER_BYTES, self._timeout_ms)
        else:
            raise BadAnswer(self.name, "clear it", "it stays busy", "switch it off and on")
        self._tap(TO_DEVICE, _setup(CLEAR_HALT_TYPE, 1, 0, self._out, 0))
        device.clear_halt(self._out)

    def _control(self, request: Request, size: int) -> bytes:
        """A class request to the interface; its answer."""
        self._tap(TO_DEVICE, _setup(CLASS_INTERFACE_IN, request, 0, self._interface, size))
        answer = bytes(self._device.ctrl_transfer(CLASS_INTERFACE_IN, request, 0, self._interface, size, self._timeout_ms))
        self._tap(FROM_DEVICE, answer)
        if len(answer) != size:
            raise BadAnswer(self.name, request.name, f"{len(answer)} of {size} bytes")
        return answer

    def write(self, command: str) -> None:
        """Sends a program message. Raises DeviceError."""
        self._tag = next_tag(self._tag)
        self._send(message(MsgId.DEV_DEP_MSG_OUT, self._tag, command.encode("ascii") + b"\n"), command)

    def read(self, question: str) -> bytes:
        """Fetches the answer to `question`, which was written before. Raises DeviceError."""
        answer = b""
        while True:
            self._tag = next_tag(self._tag)
            self._send(request_in(self._tag, ANSWER_BYTES), question)
            header, payload = self._receive(question)
            if header.tag != self._tag or header.msg_id != MsgId.DEV_DEP_MSG_IN:
                raise BadAnswer(self.name, question, f"an answer to transfer {header.tag}, not {self._tag}")
            answer += payload
            if header.end:
                return answer.rstrip(b"\r\n")

    def ask(self, question: str) -> bytes:
        """Writes and reads."""
        self.write(question)
        return self.read(question)

    def _claim(self, device: Any) -> None:
        interface = next(
            (each for each in device[0] if (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS),
            None,
        )
        if interface is None:
            raise BadAnswer(self.name, "open it", "it is no USBTMC instrument", "check the address in the rig file")
        self._device = device
        self._interface = interface.bInterfaceNumber
        endpoints = {each.bEndpointAddress & 0x80: each.bEndpointAddress for each in interface if each.bmAttributes & 3 == 2}
        self._out, self._in = endpoints[0x00], endpoints[0x80]
        with contextlib.suppress(NotImplementedError):
            if device.is_kernel_driver_active(self._interface):
                device.detach_kernel_driver(self._interface)
        usb.util.claim_interface(device, self._interface)

    def _send(self, data: bytes, doing: str) -> None:
        if self._device is None:
            raise NoAnswer(self.name, doing, "it is not open", "connect first")
        self._tap(TO_DEVICE, data)
        try:
            self._device.write(self._out, data, self._timeout_ms)
        except usb.core.USBError as error:
            raise NoAnswer(self.name, doing, str(error), "check cable and power") from None

    def _receive(self, doing: str) -> tuple[Header, bytes]:
        packet = 512
        size = -(-(ANSWER_BYTES + HEADER_BYTES + 3) // packet) * packet
        try:
            data = bytes(self._device.read(self._in, size, self._timeout_ms))
        except usb.core.USBError as error:
            raise NoAnswer(self.name, doing, str(error), "check cable and power") from None
        self._tap(FROM_DEVICE, data)
        try:
            header = Header.decode(data)
        except HeaderError as error:
            raise BadAnswer(self.name, doing, str(error)) from None
        payload = data[HEADER_BYTES : HEADER_BYTES + header.size]
        if len(payload) != header.size:
            raise BadAnswer(self.name, doing, f"{len(payload)} of {header.size} bytes")
        return header, payload


def _setup(kind: int, request: int, value: int, index: int, length: int) -> bytes:
    """The setup packet of a control transfer."""
    return struct.pack("<BBHHH", kind, request, value, index, length)


def explain(direction: str, data: bytes) -> str:
    """A bulk message or a control transfer in words, for transcripts."""
    if len(data) < HEADER_BYTES:
        return _explain_control(direction, data)
    try:
        header = Header.decode(data)
    except HeaderError as error:
        return str(error)
    if direction == TO_DEVICE and header.msg_id == MsgId.DEV_DEP_MSG_IN:
        return f"transfer {header.tag}: up to {header.size} bytes, please"
    payload = data[HEADER_BYTES : HEADER_BYTES + header.size]
    return f"transfer {header.tag}: {payload.decode('ascii', 'backslashreplace')!a}"


def _explain_control(direction: str, data: bytes) -> str:
    if direction == FROM_DEVICE:
        return f"control: {Status(data[0]).name}" if data and data[0] in set(Status) else "control"
    kind, request, *_ = struct.unpack("<BBHHH", data)
    return f"control: {Request(request).name}" if kind == CLASS_INTERFACE_IN else "control: CLEAR_FEATURE(ENDPOINT_HALT)"
