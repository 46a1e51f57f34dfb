"""A USBTMC instrument on pyusb: messages out, replies in, and resynchronisation after a fault.

A reply is accepted if its header has the tag of the request, its length is right, and no earlier reply is due. After
anything else the wire is out of step: the request is aborted, halted endpoints are released, the buffers are cleared, and
`*IDN?` must return the identity of the same instrument. A device that was unplugged is searched for again. Each step takes
bounded time.

The bus has checksums and repeats packets by itself, so that corruption on the bus is detected. A byte corrupted elsewhere
(in a driver, a hub) is detected in a header or a length, but not in a digit: there only the range limits the damage.

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

from goniotwin.drivers.errors import BadAnswer, DeviceError, NoAnswer, WrongDevice, unless_late
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, no_tap
from goniotwin.drivers.usb.control_endpoint import ControlEndpoint
from goniotwin.protocols.clock import Clock
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

UsbOpener = Callable[[], Any]
"""Finds the pyusb device; None if it is not connected."""

REPLY_BYTES = 4096
LONGEST_REPLY = 1 << 20
LARGEST_PACKET = 512
IDENTITY = "*IDN?"
EVENTS_KEPT = 100
DISCONNECTED = (errno.ENODEV, errno.ENOENT)


class UsbTmc:
    """The wire to one instrument. `events` are its own actions (resynchronised, found again), newest last."""

    def __init__(self, name: str, opener: UsbOpener, clock: Clock, timeout_s: float = 1.0, tap: Tap = no_tap) -> None:
        self.name = name
        self._opener = opener
        self._clock = clock
        self._waiting_since = 0.0
        self._timeout_ms = round(1000 * timeout_s)
        self._tap = tap
        self._lock = threading.RLock()
        self._device: Any = None
        self._connected = False
        self._tag = 0
        self._status_tag = 0
        self._reply_due = False
        self._requested_tag: int | None = None
        self.in_step = False
        self.identity = ""
        self.resynchronisations = 0
        self.events: deque[str] = deque(maxlen=EVENTS_KEPT)

    def connect(self) -> str:
        """Find the device, claim its USBTMC interface, clear its buffers, return its identity. Raises DeviceError."""
        with self._lock:
            self.close()
            self._connected, self.identity = True, ""
            self._open()
            self._resynchronise()
            return self.identity

    def close(self) -> None:
        """Release the interface."""
        with self._lock:
            self._connected = False
            self._drop()

    def ready(self) -> None:
        """Resynchronise the wire unless it is in step. Raises DeviceError."""
        with self._lock:
            if not self._connected:
                raise NoAnswer(self.name, "use it", "not connected", "connect it first")
            if self._device is None:
                self._open()
                self.events.append("disconnected, found again")
            if not self.in_step or self._reply_due:
                self._resynchronise()

    def write(self, command: str, *, expects_reply: bool = False) -> None:
        """Send a program message; `expects_reply` for a query whose reply is read later. Raises DeviceError."""
        with self._lock:
            self.ready()
            self._write(command)
            self._reply_due = expects_reply

    def read(self, query: str) -> bytes:
        """Fetch the reply to `query`, which was written before. Raises DeviceError."""
        with self._lock:
            if not self._reply_due or self._device is None:
                raise NoAnswer(self.name, query, "no query was sent, or its reply is lost", "ask again")
            reply = self._read(query)
            self._reply_due = False
            return reply

    def query(self, query: str) -> bytes:
        """Send a query and read its reply. Raises DeviceError."""
        with self._lock:
            self.ready()
            self._write(query)
            self._reply_due = True
            return self.read(query)

    def clear(self) -> None:
        """Device clear: empties input and output buffers, keeps the settings. Raises DeviceError."""
        with self._lock, self._fault("clear its buffers"):
            self._reply_due, self._requested_tag = False, None
            self._control.clear(self._in, self._out)

    def abort(self) -> None:
        """Abort the request for a reply, and discard what was received of it. Raises DeviceError."""
        with self._lock, self._fault("abort a transfer"):
            self._abort()

    def status_byte(self) -> int:
        """Status byte (READ_STATUS_BYTE); does not disturb a message in progress. Raises DeviceError."""
        with self._lock, self._fault("READ_STATUS_BYTE"):
            self._status_tag = next_status_tag(self._status_tag)
            return self._control.status_byte(self._status_tag, self._interrupt)

    # ---- resynchronisation ----

    def _resynchronise(self) -> None:
        """Abort, release, clear, then read the identity as a marker. Raises DeviceError."""
        with self._fault("resynchronise"):
            self._reply_due = False
            for endpoint in (self._in, self._out):
                self._control.clear_halt(endpoint)
            self._abort()
            self._control.clear(self._in, self._out)
        self._write(IDENTITY)
        identity = self._read(IDENTITY).decode("ascii", "replace")
        if not identity or (self.identity and identity != self.identity):
            self.in_step = False
            wrong = f"{identity!r} is connected, not {self.identity}"
            raise WrongDevice(self.name, "identify it", wrong, "connect the right one")
        if self.identity:
            self.events.append("wire resynchronised")
            self.resynchronisations += 1
        self.identity = identity
        self.in_step = True

    def _abort(self) -> None:
        if self._requested_tag is not None:
            tag, self._requested_tag = self._requested_tag, None
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

    def _read(self, query: str) -> bytes:
        """The reply to a query."""
        reply = b""
        deadline, over = self._clock.now() + self._timeout_ms / 1000.0, False
        with self._fault(query):
            while True:
                self._tag = next_tag(self._tag)
                self._requested_tag = self._tag
                self._send(request_in(self._tag, REPLY_BYTES))
                header, payload = self._decoded(query, self._receive())
                if header.tag != self._tag or header.msg_id != MsgId.DEV_DEP_MSG_IN:
                    raise BadAnswer(self.name, query, f"a reply to transfer {header.tag}, not {self._tag}", "ask again")
                self._requested_tag = None
                reply += payload
                if header.end:
                    return reply.rstrip(b"\r\n")
                if over or not payload or len(reply) > LONGEST_REPLY:
                    raise BadAnswer(self.name, query, f"a reply without an end: {len(reply)} bytes", "ask again")
                over = self._clock.now() > deadline

    def _send(self, data: bytes) -> None:
        self._tap(TO_DEVICE, data)
        self._waiting_since = self._clock.now()
        sent = self._device.write(self._out, data, self._timeout_ms)
        if sent != len(data):
            raise BadAnswer(self.name, "write", f"{sent} of {len(data)} bytes were sent", "ask again")

    def _receive(self) -> bytes:
        size = -(-(REPLY_BYTES + HEADER_BYTES + 3) // LARGEST_PACKET) * LARGEST_PACKET
        self._waiting_since = self._clock.now()
        data = bytes(self._device.read(self._in, size, self._timeout_ms))
        self._tap(FROM_DEVICE, data)
        return data

    def _decoded(self, doing: str, data: bytes) -> tuple[Header, bytes]:
        """Header and payload of a reply. Raises BadAnswer."""
        try:
            header = Header.decode(data)
        except HeaderError as error:
            raise BadAnswer(self.name, doing, str(error), "ask again") from None
        # Devices need not pad their replies to a multiple of four bytes.
        if not HEADER_BYTES + header.size <= len(data) <= HEADER_BYTES + header.size + 3:
            raise BadAnswer(self.name, doing, f"{len(data) - HEADER_BYTES} of {header.size} bytes", "ask again")
        return header, data[HEADER_BYTES : HEADER_BYTES + header.size]

    @contextlib.contextmanager
    def _fault(self, doing: str) -> Iterator[None]:
        """Turn pyusb's exceptions into DeviceErrors; the wire is then out of step."""
        if self._device is None:
            raise NoAnswer(self.name, doing, "not connected", "connect it first")
        self._waiting_since = self._clock.now()
        try:
            yield
        except usb.core.USBTimeoutError:
            self.in_step = False
            timeout_s = self._timeout_ms / 1000
            late_s = self._clock.now() - self._waiting_since - timeout_s
            silent = unless_late(late_s, timeout_s, f"not responding within {timeout_s:g} s", "check cable and power")
            raise NoAnswer(self.name, doing, *silent) from None
        except usb.core.USBError as error:
            self.in_step = False
            if error.errno in DISCONNECTED:
                self._drop()
                raise NoAnswer(self.name, doing, "disconnected", "plug it in again") from None
            stalled = error.errno == errno.EPIPE
            what = "it halted the endpoint (stall)" if stalled else str(error)
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
            raise NoAnswer(self.name, "find it on USB", "not connected", "check address, cable and power")
        try:
            self._claim(device)
        except usb.core.USBError as error:
            self._drop()
            raise DeviceError(self.name, "open it", str(error), "close other programs that use it") from None

    def _drop(self) -> None:
        device, self._device = self._device, None
        self.in_step = self._reply_due = False
        self._requested_tag = None
        if device is not None:
            with contextlib.suppress(usb.core.USBError):
                usb.util.dispose_resources(device)

    def _claim(self, device: Any) -> None:
        interface = next(
            (each for each in device[0] if (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS),
            None,
        )
        if interface is None:
            raise BadAnswer(self.name, "open it", "it is not a USBTMC instrument", "check the address in the rig file")
        number = interface.bInterfaceNumber
        kinds = {(each.bmAttributes & 3, each.bEndpointAddress & 0x80): each.bEndpointAddress for each in interface}
        if (2, 0x00) not in kinds or (2, 0x80) not in kinds:
            raise BadAnswer(self.name, "open it", "it has no bulk endpoints", "check the address in the rig file")
        self._out, self._in, self._interrupt = kinds[2, 0x00], kinds[2, 0x80], kinds.get((3, 0x80))
        self._device = device
        with contextlib.suppress(NotImplementedError):  # of libusb on Windows and macOS
            if device.is_kernel_driver_active(number):
                device.detach_kernel_driver(number)
        usb.util.claim_interface(device, number)
        self._control = ControlEndpoint(self.name, device, number, self._timeout_ms, self._clock, self._tap)
