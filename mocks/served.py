"""A virtual rig on real endpoints: everything that another process, or another program, needs to work with it."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mocks.control import BackDoor, ControlServer
from mocks.modbus_endpoints import ModbusEndpoints
from mocks.serial_endpoints import LOOPBACK, SerialEndpoints, ptys_exist
from protocols.clock import RealClock
from twin import TwinModel, VirtualRig
from twin.rig import CONVERTER_LINE

KINDS = {"axes": "tmcl", "mono": "cornerstone", "adcs": "adam-4117"}


@dataclass(frozen=True)
class Endpoint:
    """Where a device can be reached: a path for a pseudo-terminal, host and port for TCP, and the unit for Modbus."""

    device: str
    kind: str
    path: str | None = None
    host: str | None = None
    port: int | None = None
    unit: int | None = None

    def as_dict(self) -> dict[str, Any]:
        """What it has, and nothing else."""
        return {key: value for key, value in vars(self).items() if value is not None}


class ServedRig:
    """Serial lines on pseudo-terminals and TCP, Modbus modules on TCP, the back door beside them."""

    def __init__(self, model: TwinModel, speed: float, folder: Path) -> None:
        self.clock = RealClock(speed)
        self.rig = VirtualRig.build(model, self.clock)
        self._folder = folder
        self._lines = SerialEndpoints(self.clock, self.rig.lock)
        self._modules = ModbusEndpoints(self.rig)
        self._control = ControlServer(BackDoor(self.rig))
        self._endpoints: list[Endpoint] = []

    @property
    def endpoints(self) -> list[Endpoint]:
        """All of them, once started."""
        return list(self._endpoints)

    def start(self) -> None:
        """Opens everything. Raises OSError."""
        self._endpoints = [*self._serial(), *self._modbus()]
        self._lines.start()
        self._control.start()
        self._endpoints.append(Endpoint("control", "back door", host=LOOPBACK, port=self._control.port))

    def stop(self) -> None:
        """Closes everything; ports and names are free again."""
        self._control.stop()
        self._modules.stop()
        self._lines.stop()

    def _serial(self) -> Iterator[Endpoint]:
        for name, device in self.rig.serial.items():
            kind = KINDS.get(name, name)
            if ptys_exist():
                path = self._lines.add_pty(name, device, self._folder / name)
                yield Endpoint(name, kind, path=str(path))
            yield Endpoint(name, kind, host=LOOPBACK, port=self._lines.add_tcp(name, device))

    def _modbus(self) -> Iterator[Endpoint]:
        """Modules with an Ethernet port; those on a serial line are behind that line."""
        names = [name for name in self.rig.modbus if CONVERTER_LINE not in self.rig.serial]
        for name in names:
            self._modules.add_tcp(name)
        self._modules.start()
        for name in names:
            yield Endpoint(name, "adam-6017", host=LOOPBACK, port=self._modules.ports[name], unit=self.rig.modbus[name].unit)
