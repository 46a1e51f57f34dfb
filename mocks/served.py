"""A virtual rig on real endpoints: everything that another process, or another program, needs to work with it."""

from collections.abc import Iterator
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from pathlib import Path
from typing import Any

from goniotwin.mocks.control import ControlPort, ControlServer
from goniotwin.mocks.faulty_wires import FaultyWires
from goniotwin.mocks.modbus_endpoints import GAP_S, ModbusEndpoints
from goniotwin.mocks.serial_endpoints import SerialEndpoints, ptys_exist
from goniotwin.mocks.usb_endpoints import UsbEndpoints
from goniotwin.protocols.clock import RealClock
from goniotwin.protocols.loopback import LOOPBACK
from goniotwin.twin import TwinModel, VirtualRig
from goniotwin.twin.addresses import CONVERTER_LINE
from goniotwin.twin.devices import RtuStation, TmclLine
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.devices.tmcl_line import IDLE_GAP_S

CONTROL = "control"


class Wire(StrEnum):
    """How the bytes of an endpoint travel."""

    SERIAL = "serial"
    MODBUS_TCP = "modbus-tcp"
    MODBUS_RTU = "modbus-rtu"
    USBIP = "usbip"
    JSON = "json"


@dataclass(frozen=True)
class Endpoint:
    """Where a device can be reached: a path for a pseudo-terminal, host and port for TCP; a serial line has a baud rate.

    With the unit for Modbus. A USB device has its bus id on the USB/IP server that host and port name. The control port has a
    token.
    """

    device: str
    kind: str
    wire: Wire
    path: str | None = None
    baudrate: int | None = None
    host: str | None = None
    port: int | None = None
    unit: int | None = None
    bus_id: str | None = None
    token: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """The fields that are set."""
        return {key: value for key, value in vars(self).items() if value is not None}


class ServedRig:
    """Serial lines on pseudo-terminals and TCP, Modbus modules on TCP, the monitor over USB/IP, and the control port."""

    def __init__(self, model: TwinModel, speed: float, folder: Path, *, control: bool = True) -> None:
        self.clock = RealClock(speed)
        self.rig = VirtualRig.build(model, self.clock)
        self._folder = folder
        self._wires = FaultyWires(self.rig, self.clock)
        self._lines = SerialEndpoints(self.clock, self.rig.lock)
        self._modules = ModbusEndpoints(self.rig)
        self._usb = UsbEndpoints(self.rig)
        self._control = ControlServer(ControlPort(self.rig, self._wires.orders)) if control else None
        self._endpoints: list[Endpoint] = []

    @property
    def endpoints(self) -> list[Endpoint]:
        """All of them, once started; the control port, where there is one, is the last."""
        return list(self._endpoints)

    def start(self) -> None:
        """Open all endpoints. Raises OSError."""
        self._endpoints = [*self._serial(), *self._modbus(), *self._on_usb()]
        self._lines.start()
        if self._control is not None:
            self._control.start()
            self._endpoints.append(
                Endpoint(
                    CONTROL,
                    "simulation control port",
                    Wire.JSON,
                    host=LOOPBACK,
                    port=self._control.port,
                    token=self._control.token,
                )
            )

    def stop(self) -> None:
        """Close all endpoints; release ports and names."""
        if self._control is not None:
            self._control.stop()
        self._usb.stop()
        self._modules.stop()
        self._lines.stop()

    def _serial(self) -> Iterator[Endpoint]:
        for name, device in self.rig.serial.items():
            line = self._wires.line(
                name, self._heard(name, device), partial(self._lines.unplug, name), partial(self._lines.replug, name)
            )
            places: list[dict[str, Any]] = []
            if ptys_exist():
                path = self._lines.add_pty(name, line, self._folder / name)
                places.append({"path": str(path)})
            places.append({"host": LOOPBACK, "port": self._lines.add_tcp(name, line)})
            for place in places:
                place["baudrate"] = device.baudrate
                if name == CONVERTER_LINE:
                    for module, each in self.rig.modbus.items():
                        yield Endpoint(module, self.rig.kinds[module], Wire.MODBUS_RTU, **place, unit=each.unit)
                else:
                    yield Endpoint(name, self.rig.kinds[name], Wire.SERIAL, **place)

    def _heard(self, name: str, device: SerialDevice) -> SerialDevice:
        """On an endpoint bytes come when the system brings them, so that a frame's end is a longer pause."""
        if isinstance(device, TmclLine):
            device.idle_gap_s = IDLE_GAP_S * self.clock.speed
        if name != CONVERTER_LINE:
            return device
        return RtuStation([*self.rig.modbus.values()], device.baudrate, GAP_S * self.clock.speed)

    def _modbus(self) -> Iterator[Endpoint]:
        """Modules with an Ethernet port; those on a serial line are behind that line."""
        names = [name for name in self.rig.modbus if CONVERTER_LINE not in self.rig.serial]
        for name in names:
            self._wires.connections(name, partial(self._modules.unplug, name), partial(self._modules.replug, name))
            self._modules.add_tcp(name)
        self._modules.start()
        for name in names:
            port, unit = self._modules.ports[name], self.rig.modbus[name].unit
            yield Endpoint(name, self.rig.kinds[name], Wire.MODBUS_TCP, host=LOOPBACK, port=port, unit=unit)

    def _on_usb(self) -> Iterator[Endpoint]:
        for name in list(self.rig.usb):
            self._wires.usb(name, partial(self._usb.unplug, name), partial(self._usb.replug, name))
        self._usb.start()
        for name, bus_id in self._usb.bus_ids.items():
            yield Endpoint(name, self.rig.kinds[name], Wire.USBIP, host=LOOPBACK, port=self._usb.port, bus_id=bus_id)
