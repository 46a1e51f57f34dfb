"""Which ports there are, and who answers on them: asked by name only, so that nothing moves."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial
import usb.core
from serial.tools import list_ports

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, open_rig, read_rig
from goniotwin.app.rig.lock import RigLock
from goniotwin.drivers import DeviceError, Monochromator, MonochromatorSettings, TmclModule
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.usbtmc import INTERFACE_CLASS

AXES_BAUDRATES = (115200, 9600)
OF_A_RIG = "rig"


@dataclass(frozen=True)
class Found:
    """A place where a device may be, who answers there, and if nobody does, what was tried."""

    bus: str
    address: str
    answers: str | None
    tried: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {"bus": self.bus, "address": self.address, "answers": self.answers, "tried": self.tried}


def found_devices(rig: Path | None) -> list[Found]:
    """Of a rig file, or of this computer. Raises UserError."""
    if rig is None:
        return of_computer(RealClock())
    description = read_rig(rig)
    return of_rig(description, VirtualClock() if description.file.twin is not None else RealClock())


def in_words(found: list[Found]) -> str:
    """A line each, for people."""
    if not found:
        return "no serial port and no USB instrument; Modbus modules have no list, so name a rig with --rig"
    return "\n".join(f"{each.bus:7}{each.address or '-':24}{each.answers or f'no answer ({each.tried})'}" for each in found)


def exit_status(found: list[Found]) -> int:
    """1 when a device of a rig file does not answer. That nobody answers on some port of this computer is no fault."""
    return int(any(each.bus == OF_A_RIG and each.tried for each in found))


def of_rig(rig: RigDescription, clock: Clock) -> list[Found]:
    """The devices of a rig file. Raises UserError where another program has the rig."""
    with open_rig(rig, clock) as opened:
        outcome = opened.rig.connect()
        return [
            Found(OF_A_RIG, device, opened.rig.identities.get(device), "" if error is None else str(error))
            for device, error in outcome.items()
        ]


def of_computer(clock: Clock) -> list[Found]:
    """Serial ports and USB instruments of this computer."""
    return [*_serial_ports(clock), *_usb_instruments()]


def _serial_ports(clock: Clock) -> Iterator[Found]:
    for port in sorted(list_ports.comports()):
        try:
            lock = RigLock([port.device], "goniotwin devices")
        except UserError as error:
            yield Found("serial", port.device, None, str(error))
            continue
        try:
            yield _who_is_at(port.device, clock)
        finally:
            lock.release()


def _who_is_at(device: str, clock: Clock) -> Found:
    tried = []
    probes: list[tuple[str, Callable[[], str]]] = [
        *((f"TMCL at {rate} Bd", _tmcl(device, rate, clock)) for rate in AXES_BAUDRATES),
        ("Cornerstone at 9600 Bd", _cornerstone(device, clock)),
    ]
    for name, probe in probes:
        try:
            return Found("serial", device, probe())
        except DeviceError as error:
            tried.append(f"{name}: {error.happened}")
    return Found("serial", device, None, "; ".join(tried))


def _open(device: str) -> Callable[[int, float], serial.Serial]:
    return lambda baudrate, timeout_s: serial.serial_for_url(device, baudrate=baudrate, timeout=timeout_s)


def _tmcl(device: str, baudrate: int, clock: Clock) -> Callable[[], str]:
    def ask() -> str:
        module = TmclModule(_open(device), clock, baudrate)
        try:
            return f"TMCM-{module.identify()}"
        finally:
            module.close()

    return ask


def _cornerstone(device: str, clock: Clock) -> Callable[[], str]:
    def ask() -> str:
        monochromator = Monochromator(_open(device), MonochromatorSettings(), clock)
        try:
            return monochromator.connect()
        finally:
            monochromator.close()

    return ask


def _usb_instruments() -> Iterator[Found]:
    import libusb_package

    try:
        backend = libusb_package.get_libusb1_backend()
        devices = list(usb.core.find(find_all=True, backend=backend, custom_match=_is_instrument))
    except (usb.core.NoBackendError, usb.core.USBError) as error:
        yield Found("usb", "", None, str(error))
        return
    for device in devices:
        address = f"{device.idVendor:04x}:{device.idProduct:04x}"
        try:
            yield Found("usb", f"{address}:{device.serial_number}", f"{device.manufacturer} {device.product}")
        except (usb.core.USBError, ValueError) as error:
            yield Found("usb", address, None, f"{error}; see that its driver lets this program in")


def _is_instrument(device: Any) -> bool:
    try:
        return any(
            (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS
            for configuration in device
            for each in configuration
        )
    except usb.core.USBError:
        return False
