"""Addresses of devices, as a rig file has them: parsing, and one canonical form for all spellings of one device.

| bus | address |
|---|---|
| virtual rig | `twin://RIG/NAME` |
| serial | a port's name, or a URL of pyserial such as `socket://HOST:PORT` |
| Modbus TCP | `HOST` or `HOST:PORT` |
| Modbus RTU | `rtu:PORT?unit=N&baudrate=9600`; units of one port share one client and one lock |
| USB | `VENDOR:PRODUCT:SERIAL`, or `usbip:HOST:PORT/BUSID` |
"""

import contextlib
import os
import re
import socket
from pathlib import Path
from urllib.parse import parse_qsl

from pymodbus.client import ModbusTcpClient
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.framer import FramerType

from goniotwin.app.errors import UserError
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusOpener, ModbusUnit, RtuClient, Trace, explain, explain_rtu
from goniotwin.drivers.tap import Explain
from goniotwin.protocols import adam, usbip
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinModbusClient, TwinRtuClient

TWIN, RTU, USBIP = "twin://", "rtu:", "usbip:"
MODBUS_PORT, USBIP_PORT = "502", str(usbip.PORT)
MODBUS_TIMEOUT_S = 1.0
BAUDRATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)


def canonical_address(address: str) -> str:
    """The canonical form of an address: links followed, host names resolved, the port given, the query removed.

    Two addresses of one device have the same canonical form.
    """
    plain = address.removeprefix(RTU).partition("?")[0]
    for scheme, port in (("socket://", ""), ("rfc2217://", ""), (USBIP, USBIP_PORT)):
        if plain.startswith(scheme):
            host, slash, bus_id = plain.removeprefix(scheme).partition("/")
            return f"{_canonical_host(host, port)}{slash}{bus_id}"
    if plain.startswith(("/", "\\\\")) or Path(plain).exists():
        return os.path.realpath(plain)
    if re.fullmatch(r"(?i)com[0-9]+", plain):
        return plain.upper()
    if re.fullmatch(r"[0-9a-fA-F]{4}:[0-9a-fA-F]{4}(:.*)?", plain):
        return plain[:9].lower() + plain[9:]
    return _canonical_host(plain, MODBUS_PORT)


def _canonical_host(place: str, default_port: str) -> str:
    """`HOST:PORT` with the numeric address of the host, or with its name where the name cannot be resolved."""
    host, port = host_and_port(place.lower(), default_port)
    with contextlib.suppress(OSError):
        host = str(socket.getaddrinfo(host, None, proto=socket.IPPROTO_TCP)[0][4][0])
    return f"{host}:{port}"


def host_and_port(place: str, default: str) -> tuple[str, str]:
    """Host and port of `HOST`, `HOST:PORT`, `[HOST]` or `[HOST]:PORT`; the port is text, and is not checked."""
    host, colon, port = place.rpartition(":") if not place.endswith("]") else (place, "", "")
    return (host.strip("[]"), port) if colon else (place.strip("[]"), default)


def is_port(text: str) -> bool:
    """Whether a text is the number of a TCP port."""
    return text.isascii() and text.isdecimal() and 0 < int(text) < 65536


class ModbusUnits:
    """Units of Modbus addresses, with one bus for all units of a serial line; `virtual` is the rig behind `twin://`."""

    def __init__(self, virtual: VirtualRig | None) -> None:
        self._virtual = virtual
        self._lines: dict[str, tuple[ModbusBus, int, dict[int, str]]] = {}

    def unit(self, address: str) -> ModbusUnit:
        """The unit of an address. Raises UserError with an address that is not valid."""
        if address.startswith(TWIN):
            return self._twin(address)
        if address.startswith(RTU):
            port, unit, baudrate = rtu_address(address)
            return self._on_line(port, unit, baudrate, address, _serial_opener(port, baudrate))
        host, number = host_and_port(address, MODBUS_PORT)
        if not host or not is_port(number) or "?" in address:
            raise _invalid_address(address, "is neither HOST, HOST:PORT nor rtu:PORT?unit=N")
        return ModbusUnit(ModbusBus(_tcp_opener(host, int(number))))

    @staticmethod
    def explain(unit: ModbusUnit) -> Explain:
        """The function that describes the bytes on a unit's wire as text, for transcripts."""
        return explain_rtu if unit.bus.rtu else explain

    def _twin(self, address: str) -> ModbusUnit:
        device = self._virtual.modbus.get(address.rsplit("/", 1)[1]) if self._virtual is not None else None
        if device is None or not device.model.serial:
            return ModbusUnit(ModbusBus(lambda trace: TwinModbusClient(address, timeout=MODBUS_TIMEOUT_S, trace_packet=trace)))
        assert self._virtual is not None
        baudrate = self._virtual.plant.model.electronics.baudrate

        def opener(trace: Trace | None) -> ModbusBaseSyncClient:
            return TwinRtuClient(address, baudrate=baudrate, timeout=MODBUS_TIMEOUT_S, trace_packet=trace)

        return self._on_line(address.rsplit("/", 1)[0], device.unit, baudrate, address, opener)

    def _on_line(self, port: str, unit: int, baudrate: int, address: str, opener: ModbusOpener) -> ModbusUnit:
        bus, line_baudrate, used = self._lines.setdefault(port, (ModbusBus(opener, rtu=True), baudrate, {}))
        if line_baudrate != baudrate:
            raise _invalid_address(address, f"another unit on {port} has {line_baudrate} baud, and a line has one speed")
        if unit in used:
            raise _invalid_address(address, f"{used[unit]} is unit {unit} of the same line")
        used[unit] = address
        return ModbusUnit(bus, unit)


def rtu_address(address: str) -> tuple[str, int, int]:
    """Port, unit and baud rate of `rtu:PORT?unit=N&baudrate=B`; the defaults are unit 1 and 9600 baud. Raises UserError."""
    port, _, query = address.removeprefix(RTU).partition("?")
    if not port or port.startswith(TWIN):
        raise _invalid_address(address, "has no serial port")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError:
        raise _invalid_address(address, "the text after ? is not of the form unit=N&baudrate=B") from None
    settings = dict(pairs)
    if len(settings) < len(pairs):
        raise _invalid_address(address, "has a setting twice")
    if unknown := sorted(settings.keys() - {"unit", "baudrate"}):
        raise _invalid_address(address, f"has the setting {', '.join(unknown)}, and only unit and baudrate are known")
    unit = _whole_number(address, "unit", settings.get("unit", str(adam.UNIT)))
    baudrate = _whole_number(address, "baudrate", settings.get("baudrate", str(adam.BAUDRATE)))
    if not 1 <= unit <= adam.LAST_UNIT:
        raise _invalid_address(address, f"unit is 1 to {adam.LAST_UNIT}, not {unit}")
    if baudrate not in BAUDRATES:
        raise _invalid_address(address, f"baudrate is one of {', '.join(map(str, BAUDRATES))}, not {baudrate}")
    return port, unit, baudrate


def usbip_address(address: str) -> tuple[str, int, str]:
    """Host, port and bus id of `usbip:HOST:PORT/BUSID`; the default port is 3240. Raises UserError."""
    place, _, bus_id = address.removeprefix(USBIP).partition("/")
    host, number = host_and_port(place, USBIP_PORT)
    if not host or not bus_id or not is_port(number):
        wrong = f"monitor.usb: {address!r} is not usbip:HOST:PORT/BUSID, such as usbip:127.0.0.1:3240/1-1"
        raise UserError(f"{wrong}; correct it in the rig file")
    return host, int(number), bus_id


def _whole_number(address: str, name: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise _invalid_address(address, f"{name} is a whole number, not {text!r}")
    return int(text)


def _invalid_address(address: str, reason: str) -> UserError:
    return UserError(f"photodiodes.units: {address!r}: {reason}; correct it in the rig file")


def _tcp_opener(host: str, port: int) -> ModbusOpener:
    def opener(trace: Trace | None) -> ModbusBaseSyncClient:
        return ModbusTcpClient(host, port=port, timeout=MODBUS_TIMEOUT_S, retries=0, trace_packet=trace)

    return opener


def _serial_opener(port: str, baudrate: int) -> ModbusOpener:
    def opener(trace: Trace | None) -> ModbusBaseSyncClient:
        return RtuClient(
            port, framer=FramerType.RTU, baudrate=baudrate, timeout=MODBUS_TIMEOUT_S, retries=0, trace_packet=trace
        )

    return opener
