"""USB/IP 1.1.1: USB transfers over TCP, as the Linux kernel's `vhci_hcd` and `usbip` speak it.

A connection begins with one operation: list the exported devices, or import one. After an import it carries transfers:
each is submitted under a number, answered under it, and can be taken back. Numbers are big-endian, but a setup packet
is as on the bus. Isochronous transfers, which no instrument here has, are not spoken.

Source: the Linux kernel's documentation, usb/usbip_protocol ("Version 1, 31 Mar 2021").
"""

import struct
from dataclasses import dataclass

VERSION = 0x0111
PORT = 3240
FULL_SPEED = 2
HEADER_BYTES = 48
LONGEST_TRANSFER = 1 << 24
MOST_DEVICES = 256
NOT_ISOCHRONOUS = 0xFFFF_FFFF
NO_SETUP = bytes(8)

LIST_REQUEST, LIST_REPLY, IMPORT_REQUEST, IMPORT_REPLY = 0x8005, 0x0005, 0x8003, 0x0003
SUBMIT, UNLINK, SUBMITTED, UNLINKED = 1, 2, 3, 4

OPERATION = struct.Struct(">HHI")
DEVICE = struct.Struct(">256s32sIIIHHHBBBBBB")
SUBMIT_FIELDS = struct.Struct(">IIIIIIIIII8s")
SUBMITTED_FIELDS = struct.Struct(">IIIIIiIIII8x")
UNLINK_FIELDS = struct.Struct(">IIIIII24x")
UNLINKED_FIELDS = struct.Struct(">IIIIIi24x")


class UsbIpError(ValueError):
    """Bytes that are no USB/IP."""


@dataclass(frozen=True)
class ExportedDevice:
    """A device as it is listed and imported; `interfaces` (class, subclass, protocol each) only in a list."""

    path: str
    bus_id: str
    bus: int
    address: int
    speed: int
    vendor_id: int
    product_id: int
    release: int
    device_class: tuple[int, int, int]
    configuration: int
    configurations: int
    interface_count: int
    interfaces: tuple[tuple[int, int, int], ...] = ()

    @property
    def number(self) -> int:
        """By which transfers name it."""
        return self.bus << 16 | self.address

    def encode(self) -> bytes:
        """312 bytes, without the interfaces."""
        return DEVICE.pack(
            self.path.encode()[:255],
            self.bus_id.encode()[:31],
            self.bus,
            self.address,
            self.speed,
            self.vendor_id,
            self.product_id,
            self.release,
            *self.device_class,
            self.configuration,
            self.configurations,
            self.interface_count,
        )

    @classmethod
    def decode(cls, data: bytes) -> "ExportedDevice":
        """From 312 bytes. Raises UsbIpError."""
        if len(data) != DEVICE.size:
            raise UsbIpError(f"a device of {len(data)} bytes, not {DEVICE.size}")
        path, bus_id, bus, address, speed, vendor, product, release, *rest = DEVICE.unpack(data)
        return cls(
            _text(path), _text(bus_id), bus, address, speed, vendor, product, release, (rest[0], rest[1], rest[2]), *rest[3:]
        )


@dataclass(frozen=True)
class ListRequest:
    """Which devices are there?"""

    def encode(self) -> bytes:
        """8 bytes."""
        return OPERATION.pack(VERSION, LIST_REQUEST, 0)


@dataclass(frozen=True)
class ImportRequest:
    """Let me have this one."""

    bus_id: str

    def encode(self) -> bytes:
        """40 bytes."""
        return OPERATION.pack(VERSION, IMPORT_REQUEST, 0) + self.bus_id.encode()[:31].ljust(32, b"\0")


@dataclass(frozen=True)
class Imported:
    """Here it is; None is a refusal."""

    device: ExportedDevice | None

    def encode(self) -> bytes:
        """8 bytes, and 312 with a device."""
        refused = self.device is None
        return OPERATION.pack(VERSION, IMPORT_REPLY, int(refused)) + (b"" if self.device is None else self.device.encode())


@dataclass(frozen=True)
class Submit:
    """A transfer: `endpoint` without its direction bit; `data` of one to the device, `length` of either."""

    number: int
    device: int
    endpoint: int
    to_host: bool
    length: int
    data: bytes = b""
    setup: bytes = NO_SETUP
    flags: int = 0
    interval: int = 0
    packets: int = NOT_ISOCHRONOUS

    def encode(self) -> bytes:
        """48 bytes, and what goes to the device."""
        return (
            SUBMIT_FIELDS.pack(
                SUBMIT,
                self.number,
                self.device,
                int(self.to_host),
                self.endpoint,
                self.flags,
                self.length,
                0,
                self.packets,
                self.interval,
                self.setup,
            )
            + self.data
        )


@dataclass(frozen=True)
class Unlink:
    """Take back the transfer `of`."""

    number: int
    device: int
    of: int

    def encode(self) -> bytes:
        """48 bytes."""
        return UNLINK_FIELDS.pack(UNLINK, self.number, self.device, 0, 0, self.of)


@dataclass(frozen=True)
class Submitted:
    """How a transfer ended: 0 or a negative errno, and what came from the device or how much went to it."""

    number: int
    status: int
    length: int
    data: bytes = b""

    def encode(self) -> bytes:
        """48 bytes, and what comes from the device."""
        return (
            SUBMITTED_FIELDS.pack(SUBMITTED, self.number, 0, 0, 0, self.status, self.length, 0, NOT_ISOCHRONOUS, 0) + self.data
        )


@dataclass(frozen=True)
class Unlinked:
    """-ECONNRESET: taken back; 0: it had ended before."""

    number: int
    status: int

    def encode(self) -> bytes:
        """48 bytes."""
        return UNLINKED_FIELDS.pack(UNLINKED, self.number, 0, 0, 0, self.status)


def listed(devices: list[ExportedDevice]) -> bytes:
    """The answer to a list request."""
    each = (device.encode() + b"".join(bytes((*kind, 0)) for kind in device.interfaces) for device in devices)
    return OPERATION.pack(VERSION, LIST_REPLY, 0) + len(devices).to_bytes(4, "big") + b"".join(each)


def take_request(buffer: bytearray) -> ListRequest | ImportRequest | None:
    """The operation at the beginning of `buffer`, which loses it; None where it is not whole yet. Raises UsbIpError."""
    code = _operation(buffer, LIST_REQUEST, IMPORT_REQUEST)
    size = OPERATION.size + (32 if code == IMPORT_REQUEST else 0)
    if code is None or len(buffer) < size:
        return None
    data = _taken(buffer, size)
    return ListRequest() if code == LIST_REQUEST else ImportRequest(_text(data[OPERATION.size :]))


def take_list(buffer: bytearray) -> list[ExportedDevice] | None:
    """The answer to a list request, like `take_request`."""
    if _operation(buffer, LIST_REPLY) is None or len(buffer) < OPERATION.size + 4:
        return None
    place, devices = OPERATION.size + 4, []
    count = int.from_bytes(buffer[OPERATION.size : place], "big")
    if count > MOST_DEVICES:
        raise UsbIpError(f"a list of {count} devices")
    for _ in range(count):
        if len(buffer) < place + DEVICE.size:
            return None
        device = ExportedDevice.decode(bytes(buffer[place : place + DEVICE.size]))
        place += DEVICE.size
        kinds = bytes(buffer[place : place + 4 * device.interface_count])
        if len(kinds) < 4 * device.interface_count:
            return None
        place += len(kinds)
        found = tuple((kinds[k], kinds[k + 1], kinds[k + 2]) for k in range(0, len(kinds), 4))
        devices.append(ExportedDevice(**{**vars(device), "interfaces": found}))
    _taken(buffer, place)
    return devices


def take_import(buffer: bytearray) -> Imported | None:
    """The answer to an import request, like `take_request`."""
    if _operation(buffer, IMPORT_REPLY) is None:
        return None
    if int.from_bytes(buffer[4:8], "big"):
        _taken(buffer, OPERATION.size)
        return Imported(None)
    if len(buffer) < OPERATION.size + DEVICE.size:
        return None
    return Imported(ExportedDevice.decode(_taken(buffer, OPERATION.size + DEVICE.size)[OPERATION.size :]))


def take_command(buffer: bytearray) -> Submit | Unlink | None:
    """What a host sends after an import, like `take_request`."""
    if len(buffer) < HEADER_BYTES:
        return None
    command = int.from_bytes(buffer[:4], "big")
    if command == UNLINK:
        _, number, device, _, _, of = UNLINK_FIELDS.unpack(_taken(buffer, HEADER_BYTES))
        return Unlink(number, device, of)
    if command != SUBMIT:
        raise UsbIpError(f"command {command:#x}")
    fields = SUBMIT_FIELDS.unpack(bytes(buffer[:HEADER_BYTES]))
    _, number, device, direction, endpoint, flags, length, _, packets, interval, setup = fields
    if direction > 1 or endpoint > 15 or packets not in (0, NOT_ISOCHRONOUS):
        raise UsbIpError(f"a transfer of direction {direction}, endpoint {endpoint}, {packets} packets")
    size = HEADER_BYTES + (0 if direction else _bounded(length))
    if len(buffer) < size:
        return None
    data = _taken(buffer, size)[HEADER_BYTES:]
    return Submit(number, device, endpoint, bool(direction), _bounded(length), data, setup, flags, interval, packets)


def take_result(buffer: bytearray, reading: set[int]) -> Submitted | Unlinked | None:
    """What a device's side sends after an import, like `take_request`; `reading` are the numbers that bring data."""
    if len(buffer) < HEADER_BYTES:
        return None
    command = int.from_bytes(buffer[:4], "big")
    if command == UNLINKED:
        _, number, *_, status = UNLINKED_FIELDS.unpack(_taken(buffer, HEADER_BYTES))
        return Unlinked(number, status)
    if command != SUBMITTED:
        raise UsbIpError(f"command {command:#x}")
    _, number, _, _, _, status, length, *_ = SUBMITTED_FIELDS.unpack(bytes(buffer[:HEADER_BYTES]))
    size = HEADER_BYTES + (_bounded(length) if number in reading else 0)
    if len(buffer) < size:
        return None
    return Submitted(number, status, length, _taken(buffer, size)[HEADER_BYTES:])


def _operation(buffer: bytearray, *codes: int) -> int | None:
    if len(buffer) < OPERATION.size:
        return None
    version, code, _ = OPERATION.unpack(bytes(buffer[: OPERATION.size]))
    if code not in codes or version >> 8 != VERSION >> 8:
        raise UsbIpError(f"operation {code:#06x} of version {version:#06x}")
    return int(code)


def _bounded(length: int) -> int:
    if length > LONGEST_TRANSFER:
        raise UsbIpError(f"a transfer of {length} bytes")
    return length


def _taken(buffer: bytearray, size: int) -> bytes:
    data = bytes(buffer[:size])
    del buffer[:size]
    return data


def _text(data: bytes) -> str:
    try:
        return data.split(b"\0", 1)[0].decode()
    except UnicodeDecodeError:
        raise UsbIpError(f"{data[:32]!r} is no text") from None
