"""What an address means: two spellings of one device are one place."""

import contextlib
import os
import re
import socket
from pathlib import Path

from goniotwin.protocols import usbip

MODBUS_PORT, USBIP_PORT = "502", str(usbip.PORT)


def place_of(address: str) -> str:
    """Of any address that a rig file may have: links followed, hosts resolved, ports stated, queries left out."""
    plain = address.removeprefix("rtu:").partition("?")[0]
    for scheme, port in (("socket://", ""), ("rfc2217://", ""), ("usbip:", USBIP_PORT)):
        if plain.startswith(scheme):
            host, slash, bus_id = plain.removeprefix(scheme).partition("/")
            return f"{_host(host, port)}{slash}{bus_id}"
    if plain.startswith(("/", "\\\\")) or Path(plain).exists():
        return os.path.realpath(plain)
    if re.fullmatch(r"(?i)com[0-9]+", plain):
        return plain.upper()
    if re.fullmatch(r"[0-9a-fA-F]{4}:[0-9a-fA-F]{4}(:.*)?", plain):
        return plain[:9].lower() + plain[9:]
    return _host(plain, MODBUS_PORT)


def host_and_port(place: str, default: str) -> tuple[str, str]:
    """Of `HOST`, `HOST:PORT`, `[HOST]` or `[HOST]:PORT`; the port as it is written."""
    host, colon, port = place.rpartition(":") if not place.endswith("]") else (place, "", "")
    return (host.strip("[]"), port) if colon else (place.strip("[]"), default)


def is_port(text: str) -> bool:
    """Whether it is the number of a TCP port."""
    return text.isascii() and text.isdecimal() and 0 < int(text) < 65536


def _host(place: str, default_port: str) -> str:
    """`HOST:PORT` with the host's number; with its name where nobody knows the number."""
    host, port = host_and_port(place.lower(), default_port)
    with contextlib.suppress(OSError):
        host = str(socket.getaddrinfo(host, None, proto=socket.IPPROTO_TCP)[0][4][0])
    return f"{host}:{port}"
