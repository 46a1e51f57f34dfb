"""A USBTMC instrument on pyusb: messages out, answers in, and back into step after what went wrong.

An answer is believed where its header carries the tag of the request, the bytes are as many as it says, and nothing was
owed from before. After anything else the line is out of step: what was asked for is aborted, halted endpoints are
released, the buffers are cleared, and `*IDN?` has to be answered by the same instrument. A device that is gone is looked
for again. Each step waits for a bounded time.

The bus has its own checksums and repeats by itself, so bytes are not damaged in silence; what a wrong byte beyond them
(in a driver, a hub) would do shows where it hits a header or a length, and not in a digit: there only the range limits it.

Source: USB-IF, USBTMC 1.0 sections 3.2 and 3.3 (bulk messages), 4.2.1 (abort, clear); USB488 section 4.3.
"""

import contextlib
import errno
import threading
from collections import deque
from collections.abc import Callable, Iterator
from typing import Any

import usb.core
import usb.util

from goniotwin.drivers.errors import BadAnswer, DeviceError, NoAnswer
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from goniotwin.drivers.usb.control import Control, explain
from goniotwin.protocols.usbtmc import (
    HEADER_BYTES,
    INTERFACE_CLASS,
    Header,
    HeaderError,
    MsgId,
    message,
    next_status_tag,
    next_tag,
    request_in,
)

__all__ = ["UsbOpener", "UsbTmc", "explain"]

UsbOpener = Callable[[], Any]
"""Finds the pyusb device, None where it is not there."""

ANSWER_BYTES = 4096
LONGEST_ANSWER = 1 << 20
LARGEST_PACKET = 512
IDENTITY = "*IDN?"
SAID_KEPT = 100
GONE = (errno.ENODEV, errno.ENOENT)


class UsbTmc:
    """The wire to one instrument. `said` is what it did of its own accord, newest last."""

    def __init__(self, name: str, opener: UsbOpener, timeout_s: float = 1.0, tap: Tap = no_tap) -> None:
        self.name = name
        self._opener = opener
        self._timeout_ms = round(1000 * timeout_s)
        self._tap = tap
        self._lock = threading.RLock()
        self._device: Any = None
        self._wanted = False
        self._tag = 0
        self._status_tag = 0
        self._owed = False
        self._asked: int | None = None
        self.in_step = False
        self.identity = ""
        self.renewed = 0
        self.said: deque[str] = deque(maxlen=SAID_KEPT)

    def connect(self) -> str:
        """Finds the device, takes its USBTMC interface, clears its buffers, asks who it is. Raises DeviceError."""
        with self._lock:
            self.close()
            self._wanted, self.identity = True, ""
            self._open()
            self._find_step()
            return self.identity

    def close(self) -> None:
        """Gives the interface back."""
        with self._lock:
            self._wanted = False
            self._drop()

    def ready(self) -> None:
        """The wire is in step, or brought into step. Raises DeviceError."""
        with self._lock:
            if not self._wanted:
                raise NoAnswer(self.name, "use it", "it is not open", "connect first")
            if self._device is None:
                self._open()
                self.said.append("it was gone, and has been found again")
            if not self.in_step or self._owed:
                self._find_step()

    def write(self, command: str, *, answered: bool = False) -> None:
        """Sends a program message; with `answered`, a question whose answer will be read. Raises DeviceError."""
        with self._lock:
            self.ready()
            self._write(command)
            self._owed = answered

    def read(self, question: str) -> bytes:
        """Fetches the answer to `question`, which was written before. Raises DeviceError."""
        with self._lock:
            if not self._owed or self._device is None:
                raise NoAnswer(self.name, question, "it was not asked, or what it owed is lost", "ask again")
            answer = self._read(question)
            self._owed = False
            return answer

    def ask(self, question: str) -> bytes:
        """Writes and reads."""
        with self._lock:
            self.write(question, answered=True)
            return self.read(question)

    def clear(self) -> None:
        """Device clear: input and output buffers are empty, settings stay. Raises DeviceError."""
        with self._lock, self._fault("clear it"):
            self._owed, self._asked = False, None
            self._control.clear(self._in, self._out)

    def abort(self) -> None:
        """Takes back the request for an answer, and what of the answer is there already. Raises DeviceError."""
        with self._lock, self._fault("abort a transfer"):
            self._abort()

    def status_byte(self) -> int:
        """READ_STATUS_BYTE, without touching the message that is under way. Raises DeviceError."""
        with self._lock, self._fault("READ_STATUS_BYTE"):
            self._status_tag = next_status_tag(self._status_tag)
            return self._control.status_byte(self._status_tag, self._interrupt)

    # ---- into step ----

    def _find_step(self) -> None:
        """Abort, release, clear, marker. Raises DeviceError."""
        with self._fault("bring it into step"):
            self._owed = False
            for endpoint in (self._in, self._out):
                self._control.clear_halt(endpoint)
            self._abort()
            self._control.clear(self._in, self._out)
        self._write(IDENTITY)
        identity = self._read(IDENTITY).decode("ascii", "replace")
        if not identity or (self.identity and identity != self.identity):
            self.in_step = False
            raise BadAnswer(self.name, IDENTITY, f"{identity!r} answers, not {self.identity}", "connect the right one")
        if self.identity:
            self.said.append("it has been brought into step again")
            self.renewed += 1
        self.identity = identity
        self.in_step = True

    def _abort(self) -> None:
        if self._asked is not None:
            tag, self._asked = self._asked, None
            self._control.abort_in(tag, self._in)

    # ---- messages ----

    def _write(self, command: str) -> None:
        self._tag = next_tag(self._tag)
        data = message(MsgId.DEV_DEP_MSG_OUT, self._tag, command.encode("ascii") + b"\n")
        with self._fault(command):
            try:
                self._send(data)
            except usb.core.USBTimeoutError:
                self._control.abort_out(self._tag, self._out)
                raise

    def _read(self, question: str) -> bytes:
        answer = b""
        with self._fault(question):
            while True:
                self._tag = next_tag(self._tag)
                self._asked = self._tag
                self._send(request_in(self._tag, ANSWER_BYTES))
                header, payload = self._receive(question)
                if header.tag != self._tag or header.msg_id != MsgId.DEV_DEP_MSG_IN:
                    raise BadAnswer(self.name, question, f"an answer to transfer {header.tag}, not {self._tag}", "ask again")
                self._asked = None
                answer += payload
                if header.end:
                    return answer.rstrip(b"\r\n")
                if not payload or len(answer) > LONGEST_ANSWER:
                    raise BadAnswer(self.name, question, f"an answer without an end: {len(answer)} bytes", "ask again")

    def _send(self, data: bytes) -> None:
        self._tap(TO_DEVICE, data)
        sent = self._device.write(self._out, data, self._timeout_ms)
        if sent != len(data):
            raise BadAnswer(self.name, "write", f"{sent} of {len(data)} bytes went out", "ask again")

    def _receive(self, doing: str) -> tuple[Header, bytes]:
        size = -(-(ANSWER_BYTES + HEADER_BYTES + 3) // LARGEST_PACKET) * LARGEST_PACKET
        data = bytes(self._device.read(self._in, size, self._timeout_ms))
        self._tap(FROM_DEVICE, data)
        try:
            header = Header.decode(data)
        except HeaderError as error:
            raise BadAnswer(self.name, doing, str(error), "ask again") from None
        # Devices need not fill up what they send to a multiple of four.
        if not HEADER_BYTES + header.size <= len(data) <= HEADER_BYTES + header.size + 3:
            raise BadAnswer(self.name, doing, f"{len(data) - HEADER_BYTES} of {header.size} bytes", "ask again")
        return header, data[HEADER_BYTES : HEADER_BYTES + header.size]

    @contextlib.contextmanager
    def _fault(self, doing: str) -> Iterator[None]:
        """What pyusb raises becomes a DeviceError, and the wire is out of step."""
        if self._device is None:
            raise NoAnswer(self.name, doing, "it is not open", "connect first")
        try:
            yield
        except usb.core.USBTimeoutError:
            self.in_step = False
            within = f"no answer within {self._timeout_ms / 1000:g} s"
            raise NoAnswer(self.name, doing, within, "check cable and power") from None
        except usb.core.USBError as error:
            self.in_step = False
            if error.errno in GONE:
                self._drop()
                raise NoAnswer(self.name, doing, "it is not there any more", "plug it in again") from None
            stalled = error.errno == errno.EPIPE
            what = "it has halted the endpoint (stall)" if stalled else str(error)
            raise NoAnswer(self.name, doing, what, "ask again" if stalled else "check cable and power") from None
        except DeviceError:
            self.in_step = False
            raise

    # ---- the device ----

    def _open(self) -> None:
        try:
            device = self._opener()
        except (usb.core.NoBackendError, usb.core.USBError, LookupError, ValueError) as error:
            raise DeviceError(self.name, "find it on USB", str(error), "check the address in the rig file") from None
        if device is None:
            raise NoAnswer(self.name, "find it on USB", "it is not there", "check address, cable and power")
        try:
            self._claim(device)
        except usb.core.USBError as error:
            self._drop()
            raise DeviceError(self.name, "open it", str(error), "see that no other program has it") from None

    def _drop(self) -> None:
        device, self._device = self._device, None
        self.in_step = self._owed = False
        self._asked = None
        if device is not None:
            with contextlib.suppress(usb.core.USBError):
                usb.util.dispose_resources(device)

    def _claim(self, device: Any) -> None:
        interface = next(
            (each for each in device[0] if (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS),
            None,
        )
        if interface is None:
            raise BadAnswer(self.name, "open it", "it is no USBTMC instrument", "check the address in the rig file")
        number = interface.bInterfaceNumber
        kinds = {(each.bmAttributes & 3, each.bEndpointAddress & 0x80): each.bEndpointAddress for each in interface}
        if (2, 0x00) not in kinds or (2, 0x80) not in kinds:
            raise BadAnswer(self.name, "open it", "it has no bulk endpoints", "check the address in the rig file")
        self._out, self._in, self._interrupt = kinds[2, 0x00], kinds[2, 0x80], kinds.get((3, 0x80))
        self._device = device
        with contextlib.suppress(NotImplementedError):
            if device.is_kernel_driver_active(number):
                device.detach_kernel_driver(number)
        usb.util.claim_interface(device, number)
        self._control = Control(self.name, device, number, self._timeout_ms, self._tap)
