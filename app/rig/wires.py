"""Wires of a rig: openers for the addresses of its file, taps, notes of settings as found.

Only this module opens ports and devices by name.
"""

import contextlib
import errno
import secrets
import socket
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import serial
import usb.core

from goniotwin.app.guardian.guard import RigGuard
from goniotwin.app.rig.addresses import TWIN, USBIP, InvalidAddress, check_serial_port, device_names, usbip_address
from goniotwin.app.rig.lock import file_stem
from goniotwin.app.rig.modbus_units import ModbusUnits
from goniotwin.drivers import Transcript
from goniotwin.drivers.device import PortOpener
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.guard import Guard, NoGuard
from goniotwin.drivers.motion.tmcl import CANARY
from goniotwin.drivers.photodiodes.modbus import ModbusUnit
from goniotwin.drivers.tap import Explain, Tap, no_tap
from goniotwin.drivers.usb.usbip import find_usbip
from goniotwin.drivers.usb.usbtmc import UsbOpener
from goniotwin.own_files import make_own_folder, replace_text, state_folder
from goniotwin.protocols.clock import Clock
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinUsbBackend

FOUND_NOTES = "found"
LONGEST_NOTE = 100_000


SOCKET = "socket://"


def open_serial(address: str, baudrate: int, timeout_s: float) -> serial.Serial:
    """Open a port, which no other program, of any user, can open in this way then. Raises SerialException, OSError."""
    try:
        port = serial.serial_for_url(address, baudrate=baudrate, timeout=timeout_s, exclusive=True)
        if address.lower().startswith(SOCKET):
            _send_at_once(port)
        return port
    except serial.SerialException as error:
        if error.errno in (errno.EAGAIN, errno.EBUSY):
            raise serial.SerialException(f"{address} is in use by another program; end that program") from None
        raise


def _send_at_once(port: serial.Serial) -> None:
    """Have the system send each frame at once, as for rfc2217://: by itself it waits for the answer to the one before.

    A stop of an axis would wait for a controller that does not answer.
    """
    with socket.fromfd(port.fileno(), socket.AF_INET, socket.SOCK_STREAM) as connection:  # has the same options
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


class FoundNote:
    """The note about the device at an address, kept in the user's state folder for what a killed program leaves changed.

    `unit` is that of a module among several at the address, whose text may have it or not.
    """

    def __init__(self, address: str, unit: int | None = None) -> None:
        self._name = min(device_names(address)) + ("" if unit is None else f" unit={unit}")

    def read(self) -> str:
        """The note; empty if there is none that can be read."""
        try:
            with self._path.open(encoding="utf-8") as file:
                return file.read(LONGEST_NOTE)
        except (OSError, UnicodeError):
            return ""

    def write(self, text: str) -> None:
        """Replace the note; an empty one is removed. Without it settings are restored as well: a full disk is no error."""
        with contextlib.suppress(OSError):
            if text:
                make_own_folder(self._path.parent)
                replace_text(self._path, text)
            else:
                self._path.unlink()

    @property
    def _path(self) -> Path:
        return state_folder() / FOUND_NOTES / f"{file_stem(self._name)}.json"


class Wires:
    """Openers for addresses as a rig file has them; `virtual` is the rig behind `twin://`.

    `session` is a number by which a controller's driver knows its own settings from those of another program. On the virtual
    rig it is always the same, as all bytes are.

    `speed` is the time of the rig's clock in a second of real time, in which the programs at both ends of a wire can be late.

    `in_this_process` gives the address in this process of one in the file: another virtual rig may have the same name.
    `guard` keeps last wills of devices outside this process.
    """

    def __init__(
        self,
        clock: Clock,
        virtual: VirtualRig | None,
        transcripts: Transcript | None,
        in_this_process: Callable[[str], str] = str,
        guard: RigGuard | None = None,
        speed: float = 1.0,
    ) -> None:
        self.clock, self.speed = clock, speed
        self._guard = guard
        self.session = CANARY if virtual is not None else secrets.randbelow(2**31 - 1) + 1
        self._virtual = virtual
        self._transcripts = transcripts
        self._in_this_process = in_this_process
        self._units = ModbusUnits(virtual)

    def tap(self, device: str, explain: Explain) -> Tap:
        """The tap on the wire of a device, which writes its transcript; `explain` describes the bytes."""
        return self._transcripts.tap(device, explain) if self._transcripts is not None else no_tap

    def serial(self, file_address: str) -> PortOpener:
        """An opener for a serial port. Raises UserError for an address that is none."""
        address = self._in_this_process(file_address)
        check_serial_port(address)

        return partial(open_serial, address)

    def modbus(self, file_address: str, device: str) -> ModbusUnit:
        """The unit of an address, with its tap. Raises InvalidAddress."""
        unit = self._units.unit(self._in_this_process(file_address))
        unit.tap = self.tap(device, self._units.explain(unit))
        unit.found = self.found(file_address, unit.unit)
        return unit

    def found(self, file_address: str, unit: int | None = None) -> FoundSettings:
        """The settings as a driver finds them at an address; the note of them outlives this program.

        A device in this process does not, and its driver asks for nothing more than it needs, so that no duration changes.
        """
        address = self._in_this_process(file_address)
        if address.startswith(TWIN):
            return FoundSettings(asks=False)
        return FoundSettings(FoundNote(address, unit))

    def guard(self, file_address: str) -> Guard:
        """The guard of a device with a serial line; a device in this process ends with it, and needs none."""
        address = self._in_this_process(file_address)
        if self._guard is None or address.startswith(TWIN):
            return NoGuard()
        return self._guard.device(file_stem(min(device_names(address))), address)

    def usb(self, file_address: str) -> UsbOpener:
        """An opener for `VENDOR:PRODUCT` or `VENDOR:PRODUCT:SERIAL` (hexadecimal), or `usbip:HOST:PORT/BUSID`.

        Raises InvalidAddress for another form.
        """
        address = self._in_this_process(file_address)
        if address.startswith(TWIN):
            virtual, wanted = self._virtual, address.rsplit("/", 1)[1]

            def twin_opener() -> Any:
                if virtual is None or wanted not in virtual.usb:
                    raise LookupError(f"nothing at {address}")
                return usb.core.find(backend=TwinUsbBackend(virtual), serial_number=virtual.usb[wanted].serial_number)

            return twin_opener
        if address.startswith(USBIP):
            host, port, bus_id = usbip_address(address)
            return lambda: find_usbip(host, port, bus_id)
        parts = address.split(":")
        try:
            vendor, product = int(parts[0], 16), int(parts[1], 16)
        except (ValueError, IndexError):
            raise InvalidAddress(address, "is neither VENDOR:PRODUCT:SERIAL nor usbip:HOST:PORT/BUSID") from None
        return partial(_find_usb, vendor, product, **({"serial_number": parts[2]} if len(parts) > 2 else {}))


def _find_usb(vendor: int, product: int, **serial_number: str) -> Any:
    import libusb_package  # loads libusb, which most rigs do without

    return usb.core.find(backend=libusb_package.get_libusb1_backend(), idVendor=vendor, idProduct=product, **serial_number)
