"""Where the converters are: `HOST`, `HOST:PORT`, `rtu:PORT?unit=N&baudrate=9600`, or `twin://RIG/NAME`.

Units that name the same serial port share it: one client, one lock.

What an address means: two spellings of one device are one place.
"""

import contextlib
import os
import re
import socket
from pathlib import Path
from urllib.parse import parse_qsl

from pymodbus.client import ModbusSerialClient, ModbusTcpClient
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.framer import FramerType

from goniotwin.app.errors import UserError
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusOpener, ModbusUnit, Trace, explain, explain_rtu
from goniotwin.drivers.tap import Explain
from goniotwin.protocols import adam, usbip
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinModbusClient, TwinRtuClient

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


TWIN, RTU = "twin://", "rtu:"
MODBUS_TIMEOUT_S = 1.0
BAUDRATES = (1200, 2400, 4800, 9600, 19200, 38400, 57600, 115200)


class ModbusUnits:
    """Makes units of addresses, those on one serial line over one bus. `virtual` is the rig behind `twin://`."""

    def __init__(self, virtual: VirtualRig | None) -> None:
        self._virtual = virtual
        self._lines: dict[str, tuple[ModbusBus, int, dict[int, str]]] = {}

    def unit(self, address: str) -> ModbusUnit:
        """The unit of an address. Raises UserError naming an address that is none."""
        if address.startswith(TWIN):
            return self._twin(address)
        if address.startswith(RTU):
            port, unit, baudrate = rtu_address(address)
            return self._on_line(port, unit, baudrate, address, _serial_opener(port, baudrate))
        host, number = host_and_port(address, MODBUS_PORT)
        if not host or not is_port(number) or "?" in address:
            raise _bad(address, "it is neither HOST, HOST:PORT nor rtu:PORT?unit=N")
        return ModbusUnit(ModbusBus(_tcp_opener(host, int(number))))

    @staticmethod
    def explain(unit: ModbusUnit) -> Explain:
        """What puts the bytes on a unit's wire into words."""
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
        bus, speed, taken = self._lines.setdefault(port, (ModbusBus(opener, rtu=True), baudrate, {}))
        if speed != baudrate:
            raise _bad(address, f"another unit on {port} has {speed} baud, and a line has one speed")
        if unit in taken:
            raise _bad(address, f"{taken[unit]} is unit {unit} of the same line")
        taken[unit] = address
        return ModbusUnit(bus, unit)


def rtu_address(address: str) -> tuple[str, int, int]:
    """Port, unit and baud rate of `rtu:PORT?unit=N&baudrate=B`; they are 1 and 9600 where not given. Raises UserError."""
    port, _, query = address.removeprefix(RTU).partition("?")
    if not port or port.startswith(TWIN):
        raise _bad(address, "it names no serial port")
    try:
        pairs = parse_qsl(query, keep_blank_values=True, strict_parsing=True) if query else []
    except ValueError:
        raise _bad(address, "what follows the ? is not of the form unit=N&baudrate=B") from None
    settings = dict(pairs)
    if len(settings) < len(pairs):
        raise _bad(address, "it says something twice")
    if unknown := sorted(settings.keys() - {"unit", "baudrate"}):
        raise _bad(address, f"it has {', '.join(unknown)}, and takes only unit and baudrate")
    unit = _whole(address, "unit", settings.get("unit", str(adam.UNIT)))
    baudrate = _whole(address, "baudrate", settings.get("baudrate", str(adam.BAUDRATE)))
    if not 1 <= unit <= adam.LAST_UNIT:
        raise _bad(address, f"unit is 1 to {adam.LAST_UNIT}, not {unit}")
    if baudrate not in BAUDRATES:
        raise _bad(address, f"baudrate is one of {', '.join(map(str, BAUDRATES))}, not {baudrate}")
    return port, unit, baudrate


def _whole(address: str, what: str, text: str) -> int:
    if not (text.isascii() and text.isdecimal()):
        raise _bad(address, f"{what} is a whole number, not {text!r}")
    return int(text)


def _bad(address: str, why: str) -> UserError:
    return UserError(f"photodiodes.units: {address!r}: {why}; mend it in the rig file")


def _tcp_opener(host: str, port: int) -> ModbusOpener:
    def opener(trace: Trace | None) -> ModbusBaseSyncClient:
        return ModbusTcpClient(host, port=port, timeout=MODBUS_TIMEOUT_S, retries=0, trace_packet=trace)

    return opener


def _serial_opener(port: str, baudrate: int) -> ModbusOpener:
    def opener(trace: Trace | None) -> ModbusBaseSyncClient:
        return ModbusSerialClient(
            port, framer=FramerType.RTU, baudrate=baudrate, timeout=MODBUS_TIMEOUT_S, retries=0, trace_packet=trace
        )

    return opener
