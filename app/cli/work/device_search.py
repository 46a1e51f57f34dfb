"""Search for devices: the ports of this computer or of a rig file, and the identity of the device at each.

Only identities are read, and whether the shutter of a rig file is closed: nothing moves, and every device keeps its settings.
What a killed program has left changed at the devices of a rig file is restored.
"""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import usb.core
from serial.tools import list_ports

from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, open_rig, read_rig
from goniotwin.app.rig.kinds import kinds
from goniotwin.app.rig.lock import RigLock
from goniotwin.app.rig.wires import open_serial
from goniotwin.app.station.orders import end_shutter_orders
from goniotwin.drivers import Device, DeviceError
from goniotwin.drivers.guard import Guarded
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.usbtmc import INTERFACE_CLASS

RIG_BUS = "rig"


@dataclass(frozen=True)
class PortStatus:
    """A port, the identity of the device there, and without one, what was tried. `bus` is "serial", "usb" or "rig".

    `order` is a safety order about the device, empty without one.
    """

    bus: str
    address: str
    identity: str | None
    tried: str = ""
    order: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        order = {"order": self.order} if self.order else {}
        return {"bus": self.bus, "address": self.address, "answers": self.identity, "tried": self.tried, **order}


def find_devices(rig: Path | None) -> list[PortStatus]:
    """Find the devices of a rig file, or of this computer without one. Raises UserError."""
    if rig is None:
        clock = RealClock()
        return [*_serial_ports(clock), *_usb_instruments()]
    description = read_rig(rig)
    return _rig_devices(description, VirtualClock() if description.file.twin is not None else RealClock())


def status_table(ports: list[PortStatus]) -> str:
    """One line for each port."""
    if not ports:
        return "no serial port and no USB instrument; Modbus modules cannot be listed: name a rig file with --rig"
    return "\n".join(
        f"{each.bus:7}{each.address or '-':24}{each.identity or f'not responding ({each.tried})'}" for each in ports
    )


def exit_status(ports: list[PortStatus]) -> int:
    """1 if a device of a rig file does not respond, else 0: a port of this computer may have no device."""
    return int(any(each.bus == RIG_BUS and each.tried for each in ports))


def _rig_devices(rig: RigDescription, clock: Clock) -> list[PortStatus]:
    """The devices of a rig file. Raises UserError if another program has the rig open."""
    with open_rig(rig, clock) as opened:
        outcome = opened.rig.identify()
        return [
            PortStatus(
                RIG_BUS,
                device.name,
                opened.rig.identities.get(device.name),
                "" if error is None else str(opened.rig.in_words(error)),
                _order(opened, device, answers=error is None),
            )
            for device, error in zip(opened.rig.devices, outcome.values(), strict=True)
        ]


def _order(opened: OpenRig, device: Device, *, answers: bool) -> str:
    """The order for a device that is not safe, as it answers, or as a program that died has left it; empty without one."""
    left = opened.guard.left
    if left is not None and (left.done or left.device != device.name):
        left = None
    if isinstance(device, Guarded) and answers:
        with contextlib.suppress(DeviceError):
            if device.is_safe():
                if left is not None:
                    opened.guard.settle()
                    end_shutter_orders(left)
                return ""
            if left is None:
                will = device.last_will()
                return f"{will.remedy}: {will.danger}, and no program controls it"
    return "" if left is None else left.text


def _serial_ports(clock: Clock) -> Iterator[PortStatus]:
    for port in sorted(list_ports.comports()):
        try:
            lock = RigLock([port.device], "goniotwin devices")
        except UserError as error:
            yield PortStatus("serial", port.device, None, str(error))
            continue
        try:
            yield probe_port(port.device, clock)
        finally:
            lock.release()


def probe_port(device: str, clock: Clock) -> PortStatus:
    """Ask for the identity with each protocol in turn, motion controllers last.

    Their binary frames are a wrong statement to a device that reads lines; they drop what a line has left after a silence.
    """
    tried = []
    in_turn = sorted(kinds(), key=lambda kind: kind.role == "axes")
    for name, probe in [each for kind in in_turn for each in kind.probes]:
        try:
            return PortStatus("serial", device, probe(partial(open_serial, device), clock))
        except DeviceError as error:
            tried.append(f"{name}: {error.happened}")
    return PortStatus("serial", device, None, "; ".join(tried))


def _usb_instruments() -> Iterator[PortStatus]:
    # Loads 7 modules, which a search by a rig file does without.
    import libusb_package

    try:
        backend = libusb_package.get_libusb1_backend()
        devices = list(usb.core.find(find_all=True, backend=backend, custom_match=_is_instrument))
    except (usb.core.NoBackendError, usb.core.USBError) as error:
        yield PortStatus("usb", "", None, str(error))
        return
    for device in devices:
        address = f"{device.idVendor:04x}:{device.idProduct:04x}"
        try:
            yield PortStatus("usb", f"{address}:{device.serial_number}", f"{device.manufacturer} {device.product}")
        except (usb.core.USBError, ValueError) as error:
            yield PortStatus("usb", address, None, f"{error}; check that its driver gives this program access")


def _is_instrument(device: Any) -> bool:
    try:
        return any(
            (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS
            for configuration in device
            for each in configuration
        )
    except usb.core.USBError:
        return False
