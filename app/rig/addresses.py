"""Addresses of devices, as a rig file has them: parsing, and names that all spellings of one device have in common.

| bus | address |
|---|---|
| virtual rig | `twin://RIG/NAME` |
| serial | path of a device, `COMn`, `socket://HOST:PORT`, `rfc2217://HOST:PORT`, `hwgrep://TEXT` (the port so described) |
| Modbus TCP | `HOST` or `HOST:PORT`, with `?unit=N` for a module that responds to another unit than 1 |
| Modbus RTU | `rtu:PORT?unit=N&baudrate=9600`; units of one port share one client and one lock |
| USB | `VENDOR:PRODUCT:SERIAL`, or `usbip:HOST:PORT/BUSID` |

There are no other kinds. A rig file may come of unknown origin, and pyserial's further URLs do more than open a port:
`spy://PORT?file=NAME` empties the file.
"""

import contextlib
import os
import re
import socket
import stat
from ipaddress import IPv6Address, ip_address
from pathlib import Path
from typing import Any
from urllib.parse import parse_qsl

from goniotwin.app.errors import UserError
from goniotwin.protocols import adam

TWIN, RTU, USBIP, HWGREP = "twin://", "rtu:", "usbip:", "hwgrep://"
MODBUS_PORT = "502"
BAUDRATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)
LONGEST_ADDRESS = 300
_HOST = r"(?:[A-Za-z0-9_][A-Za-z0-9_.-]*|\[[0-9A-Fa-f:.]+(?:%[A-Za-z0-9]+)?\])"
_SERIAL = "|".join(
    (
        r"/(?!.*://)[^\x00-\x1f\x7f?]+",
        r"\\\\\.\\[A-Za-z0-9_]+",  # a device of Windows; any other path that begins with \\ would contact another computer
        r"(?i:com)[0-9]{1,3}",
        rf"(?i:socket)://{_HOST}:[0-9]{{1,5}}/?",
        rf"(?i:rfc2217)://{_HOST}:[0-9]{{1,5}}/?(?:\?(?:&?(?:ign_set_control|poll_modem|timeout=[0-9.]{{1,6}}))+)?",
        # A regular expression of pyserial, as far as one of unknown origin cannot take for ever.
        rf"(?i:{HWGREP})(?!(?:.*\*){{4}})[A-Za-z0-9_ .:=/@*-]{{1,100}}",
    )
)
_NETWORK_PORT = re.compile(r"(?i:socket|rfc2217)://")
_TWIN = rf"{TWIN}[^/?#\x00-\x1f]+/[^/?#\x00-\x1f]+"
_SERIAL_PORT = re.compile(f"{_TWIN}|{_SERIAL}")
_KNOWN = re.compile(
    "|".join(
        (
            _TWIN,
            _SERIAL,
            rf"{RTU}(?:{_SERIAL}|[^:/?]*)(?:\?[^/]*)?",
            rf"{USBIP}{_HOST}(?::[0-9]{{1,5}})?/[A-Za-z0-9.-]+",
            r"[0-9a-fA-F]{4}:[0-9a-fA-F]{4}(?::[^/\x00-\x1f]*)?",
            rf"{_HOST}(?::[0-9]{{1,5}})?(?:\?unit=[^/\x00-\x1f]*)?",
        )
    )
)


def check_address(address: str) -> None:
    """Raise ValueError for an address of a rig file that is of no known kind. Nothing is opened or looked up."""
    if len(address) > LONGEST_ADDRESS or not _KNOWN.fullmatch(address):
        shown = address if len(address) <= LONGEST_ADDRESS else f"{address[:LONGEST_ADDRESS]}..."
        raise ValueError(
            f"{shown!r} is not an address of a known kind; give the path of a device (/dev/ttyUSB0), COMn, socket://HOST:PORT, "
            "rfc2217://HOST:PORT, hwgrep://TEXT, HOST:PORT, rtu:PORT?unit=N, VENDOR:PRODUCT or usbip:HOST:PORT/BUSID"
        )


def check_serial_port(address: str) -> None:
    """Raise UserError for an address that is not a serial port's."""
    if not _SERIAL_PORT.fullmatch(address):
        wrong = f"{address!r} is not a serial port: neither the path of a device, COMn, socket://HOST:PORT"
        raise UserError(f"{wrong}, rfc2217://HOST:PORT nor hwgrep://TEXT; correct it in the rig file")


def is_network_port(address: str) -> bool:
    """Whether a serial port is that of a serial server on the network."""
    return _NETWORK_PORT.match(address) is not None


def resolve_port(address: str) -> str:
    """The address with the name of the one serial port that its `hwgrep://TEXT` describes; any other address as it is.

    Raises UserError where no port matches, or several do.
    """
    found = re.fullmatch(rf"({RTU})?(?i:{HWGREP})([^?]*)(.*)", address)
    if found is None:
        return address
    bus, text, query = found[1] or "", found[2], found[3]
    check_serial_port(f"{HWGREP}{text}")
    # Loads 6 modules: 3 ms, which `check` does without.
    from serial.tools import list_ports

    try:
        ports = sorted({str(port.device) for port in list_ports.grep(text)})
    except re.error as error:
        raise UserError(f"{address!r} is not a valid pattern ({error}); correct it in the rig file") from None
    if len(ports) != 1:
        what = (
            f"fits several serial ports, {', '.join(ports)}; write more of"
            if ports
            else "fits no serial port; connect it, or correct"
        )
        raise UserError(f"{address!r} {what} its description in the rig file")
    return f"{bus}{ports[0]}{query}"


class InvalidAddress(UserError):
    """An address of a rig file that is not valid; its key is unknown here, and `open_rig` names it."""

    def __init__(self, address: str, reason: str) -> None:
        super().__init__(f"{address!r}: {reason}; correct it in the rig file")
        self.address = address


def device_names(address: str) -> frozenset[str]:
    """Names of the device at an address: links followed, host names resolved, the port given, the query removed.

    Two addresses of one device have a name in common, but for `1313:8078`, without a serial number, and `1313:8078:P1`:
    `RigLock` compares these. Raises UserError as `resolve_port` does.
    """
    plain = resolve_port(address).removeprefix(RTU).partition("?")[0]
    if match := _NETWORK_PORT.match(plain):
        return _tcp_names(plain[match.end() :].partition("/")[0], "")
    if plain.startswith(USBIP):
        place, slash, bus_id = plain.removeprefix(USBIP).partition("/")
        return frozenset(f"{each}{slash}{bus_id}" for each in _tcp_names(place, _usbip_port()))
    if match := re.fullmatch(r"(?i)(?:\\\\[.?]\\)?(com[0-9]+)", plain):
        return frozenset({f"serial:{match[1].upper()}"})
    if plain.startswith("/") or Path(plain).exists():
        return _port_names(os.path.realpath(plain))
    if re.fullmatch(r"[0-9a-fA-F]{4}:[0-9a-fA-F]{4}(:.*)?", plain):
        return frozenset({f"usb:{plain[:9].lower()}{plain[9:]}"})
    return _tcp_names(plain, MODBUS_PORT)


def _port_names(path: str) -> frozenset[str]:
    """A serial port by its path and by its device number: macOS has two paths for each port, and more can be made."""
    names = {f"serial:{path.replace('/dev/tty.', '/dev/cu.')}"}
    with contextlib.suppress(OSError):
        status = Path(path).stat()
        if stat.S_ISCHR(status.st_mode):
            names.add(f"serial:{os.major(status.st_rdev)}:{os.minor(status.st_rdev)}")
    return frozenset(names)


def _tcp_names(place: str, default_port: str) -> frozenset[str]:
    """`tcp:HOST:PORT` for each numeric address of the host, or with its name where the name cannot be resolved.

    All addresses of this computer are `localhost`: a server listens on several of them, mostly.
    """
    host, port = host_and_port(place.lower(), default_port)
    port = port.lstrip("0") or port  # 04001 is opened as 4001
    found: set[str] = set()
    with contextlib.suppress(OSError, UnicodeError):
        for family, *_, address in socket.getaddrinfo(host, None, proto=socket.IPPROTO_TCP):
            number = ip_address(str(address[0]).partition("%")[0])
            number = (number.ipv4_mapped if isinstance(number, IPv6Address) else None) or number
            here = number.is_loopback or number.is_unspecified or _is_of_this_computer(family, address)
            found.add("localhost" if here else str(number))
    return frozenset(f"tcp:{each}:{port}" for each in found or {host})


def _is_of_this_computer(family: int, address: tuple[Any, ...]) -> bool:
    """Whether a socket can have this address as its own."""
    with contextlib.suppress(OSError), socket.socket(family, socket.SOCK_DGRAM) as own:
        own.bind((address[0], 0, *address[2:]))
        return True
    return False


def host_and_port(place: str, default: str) -> tuple[str, str]:
    """Host and port of `HOST`, `HOST:PORT`, `[HOST]` or `[HOST]:PORT`; the port is text, and is not checked."""
    host, colon, port = place.rpartition(":") if not place.endswith("]") else (place, "", "")
    return (host.strip("[]"), port) if colon else (place.strip("[]"), default)


def is_port(text: str) -> bool:
    """Whether a text is the number of a TCP port."""
    return text.isascii() and text.isdecimal() and 0 < int(text) < 65536


def rtu_address(address: str) -> tuple[str, int, int]:
    """Port, unit and baud rate of `rtu:PORT?unit=N&baudrate=B`; the defaults are unit 1 and 9600 baud. Raises UserError."""
    port, _, query = address.removeprefix(RTU).partition("?")
    if not _SERIAL_PORT.fullmatch(port) or port.startswith(TWIN):
        raise InvalidAddress(address, "has no serial port")
    settings = address_settings(address, query, "unit", "baudrate")
    unit = whole_number(address, "unit", settings.get("unit", str(adam.UNIT)))
    baudrate = whole_number(address, "baudrate", settings.get("baudrate", str(adam.BAUDRATE)))
    if not 1 <= unit <= adam.LAST_UNIT:
        raise InvalidAddress(address, f"unit is 1 to {adam.LAST_UNIT}, not {unit}")
    if baudrate not in BAUDRATES:
        raise InvalidAddress(address, f"baudrate is one of {', '.join(map(str, BAUDRATES))}, not {baudrate}")
    return port, unit, baudrate


def address_settings(address: str, query: str, *known: str) -> dict[str, str]:
    """The settings after the ? of an address. Raises InvalidAddress."""
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError:
        raise InvalidAddress(address, f"the text after ? is not of the form {'=N&'.join(known)}=N") from None
    settings = dict(pairs)
    if len(settings) < len(pairs):
        raise InvalidAddress(address, "has a setting twice")
    if unknown := sorted(settings.keys() - set(known)):
        raise InvalidAddress(address, f"has the setting {', '.join(unknown)}, and can only have {' and '.join(known)}")
    return settings


def usbip_address(address: str) -> tuple[str, int, str]:
    """Host, port and bus id of `usbip:HOST:PORT/BUSID`; the default port is 3240. Raises UserError."""
    place, _, bus_id = address.removeprefix(USBIP).partition("/")
    host, number = host_and_port(place, _usbip_port())
    if not host or not bus_id or not is_port(number):
        raise InvalidAddress(address, "is not usbip:HOST:PORT/BUSID, such as usbip:127.0.0.1:3240/1-1")
    return host, int(number), bus_id


def _usbip_port() -> str:
    from goniotwin.protocols import usbip  # 8 ms, which `check` does without

    return str(usbip.PORT)


def whole_number(address: str, name: str, text: str) -> int:
    """The whole number of a setting. Raises InvalidAddress."""
    if not (text.isascii() and text.isdecimal()):
        raise InvalidAddress(address, f"{name} is a whole number, not {text!r}")
    return int(text)
