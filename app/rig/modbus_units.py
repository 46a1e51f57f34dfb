"""Units of Modbus addresses: in this process, over TCP, and on serial lines, each with its opener."""

from pymodbus.client import ModbusTcpClient
from pymodbus.client.base import ModbusBaseSyncClient
from pymodbus.framer import FramerType

from goniotwin.app.rig.addresses import (
    MODBUS_PORT,
    RTU,
    TWIN,
    InvalidAddress,
    address_settings,
    host_and_port,
    is_port,
    rtu_address,
    whole_number,
)
from goniotwin.drivers.photodiodes.modbus import ModbusBus, ModbusOpener, ModbusUnit, RtuClient, Trace, explain, explain_rtu
from goniotwin.drivers.tap import Explain
from goniotwin.protocols import adam
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinModbusClient, TwinRtuClient

MODBUS_TIMEOUT_S = 1.0


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
        place, _, query = address.partition("?")
        host, number = host_and_port(place, MODBUS_PORT)
        if not host or not is_port(number):
            raise InvalidAddress(address, "is neither HOST, HOST:PORT nor rtu:PORT?unit=N")
        unit = whole_number(address, "unit", address_settings(address, query, "unit").get("unit", str(adam.UNIT)))
        if unit > adam.LAST_TCP_UNIT:
            raise InvalidAddress(address, f"unit is 0 to {adam.LAST_TCP_UNIT} over TCP, not {unit}")
        return ModbusUnit(ModbusBus(_tcp_opener(host, int(number))), unit)

    @staticmethod
    def explain(unit: ModbusUnit) -> Explain:
        """The function that describes the bytes on a unit's wire as text, for transcripts."""
        return explain_rtu if unit.bus.rtu else explain

    def _twin(self, address: str) -> ModbusUnit:
        device = self._virtual.modbus.get(address.rsplit("/", 1)[1]) if self._virtual is not None else None
        if device is None or not device.model.serial:
            bus = ModbusBus(lambda trace: TwinModbusClient(address, timeout=MODBUS_TIMEOUT_S, trace_packet=trace))
            return ModbusUnit(bus, adam.UNIT if device is None else device.unit)
        assert self._virtual is not None
        baudrate = self._virtual.plant.model.electronics.baudrate

        def opener(trace: Trace | None) -> ModbusBaseSyncClient:
            return TwinRtuClient(address, baudrate=baudrate, timeout=MODBUS_TIMEOUT_S, trace_packet=trace)

        return self._on_line(address.rsplit("/", 1)[0], device.unit, baudrate, address, opener)

    def _on_line(self, port: str, unit: int, baudrate: int, address: str, opener: ModbusOpener) -> ModbusUnit:
        bus, line_baudrate, used = self._lines.setdefault(port, (ModbusBus(opener, rtu=True), baudrate, {}))
        if line_baudrate != baudrate:
            raise InvalidAddress(address, f"another unit on {port} has {line_baudrate} baud, and a line has one speed")
        if unit in used:
            raise InvalidAddress(address, f"{used[unit]} is unit {unit} of the same line")
        used[unit] = address
        return ModbusUnit(bus, unit)


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
