"""From a rig file to drivers on their wires: the one place that opens things by name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial
import usb.core

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import USBIP_PORT, ModbusUnits, host_and_port, is_port
from goniotwin.app.rig.file import RigFile
from goniotwin.app.rig.lock import RigLock
from goniotwin.app.rig.model_hash import model_hashes
from goniotwin.app.rig.settings import (
    arc_clearance,
    axis_settings,
    monitor_settings,
    monochromator_settings,
    photodiode_settings,
)
from goniotwin.app.rig.twin_file import twin_model
from goniotwin.app.toml_file import checked, parse_toml, read_toml
from goniotwin.drivers import Axis, Monitor, Monochromator, PhotodiodeArray, Rig, TmclModule, Transcript
from goniotwin.drivers.device import PortOpener
from goniotwin.drivers.motion import tmcl
from goniotwin.drivers.tap import Explain, Tap, as_text, no_tap
from goniotwin.drivers.usb import usbtmc as usbtmc_driver
from goniotwin.drivers.usb.usbip import find_usbip
from goniotwin.drivers.usb.usbtmc import UsbOpener
from goniotwin.protocols.clock import Clock
from goniotwin.twin import TwinModel, VirtualRig
from goniotwin.twin.doors import TwinUsbBackend, register, unregister

TWIN, USBIP = "twin://", "usbip:"


@dataclass(frozen=True)
class RigDescription:
    """A rig file that has been read: its text, what it says, and from where its files are named."""

    text: str
    file: RigFile
    folder: Path
    name: str

    @property
    def simulated(self) -> bool:
        """Whether nothing of it is real."""
        return self.file.simulated is not None

    @property
    def seed(self) -> int | None:
        """Of a simulated rig."""
        return self.file.simulated.seed if self.file.simulated is not None else None

    def model(self) -> TwinModel | None:
        """What the virtual rig is; None where the file has no [twin]. Raises UserError for a sample's file."""
        if self.file.twin is None:
            return None
        return twin_model(self.file.twin, self.seed or 0, self.folder, self.name)

    def model_hash(self) -> str | None:
        """The hash of the virtual rig's model, None for a real rig."""
        return self.model_hashes()[0]

    def model_hashes(self) -> tuple[str | None, ...]:
        """All hashes by which the virtual rig's model may be known, older ones too; the one that is written now first."""
        model = self.model()
        if model is not None:
            return model_hashes(model)
        stated = self.file.simulated
        if stated is None:
            return (None,)
        return (stated.model,) if stated.old_model is None else (stated.model, stated.old_model)


def read_rig(path: Path) -> RigDescription:
    """A rig file. Raises UserError: file, key, reason."""
    text, content = read_toml(path)
    return RigDescription(text, checked(RigFile, content, str(path)), path.parent, str(path))


def parse_rig(text: str, folder: Path, name: str) -> RigDescription:
    """A rig file's text, such as a journal holds. Raises UserError."""
    return RigDescription(text, checked(RigFile, parse_toml(text, name), name), folder, name)


@dataclass
class OpenRig:
    """Drivers with their wires, not yet connected; the virtual rig behind them where there is one."""

    rig: Rig
    virtual: VirtualRig | None
    _name: str | None
    _transcript: Transcript | None
    _lock: RigLock | None = None

    def connect(self) -> None:
        """Connects every device. Raises UserError for the first that does not answer; closes everything then."""
        for error in self.rig.connect().values():
            if error is not None:
                self.close()
                raise UserError(str(error))

    def close(self) -> None:
        """Gives everything back. Nothing moves."""
        self.rig.close()
        if self._name is not None:
            unregister(self._name)
            self._name = None
        if self._transcript is not None:
            self._transcript.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    @property
    def transcript_failure(self) -> str | None:
        """Why transcripts are not written to their end; None where they are, or are not wanted."""
        return self._transcript.failure if self._transcript is not None else None

    def lock(self, addresses: list[str], doing: str) -> None:
        """Keeps other programs from real devices until `close`. Raises UserError that says who has one."""
        self._lock = RigLock(addresses, doing)

    def __enter__(self) -> "OpenRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_rig(description: RigDescription, clock: Clock, transcript: Path | None = None) -> OpenRig:
    """Drivers for a rig, and for a virtual one its devices, living by `clock`. Nothing is connected yet.

    With a folder in `transcript` each byte on each wire is written there. Raises UserError.
    """
    file = description.file
    try:
        written = Transcript(transcript, clock) if transcript is not None else None
    except OSError as error:
        raise UserError(f"{transcript}: cannot hold transcripts: {error.strerror}; name another folder") from None

    def tap(device: str, explain: Explain) -> Tap:
        return written.tap(device, explain) if written is not None else no_tap

    virtual, name = None, None
    model = description.model()
    address: Callable[[str], str] = str
    if model is not None and any(each.startswith(TWIN) for each in file.addresses):
        virtual = VirtualRig.build(model, clock)
        stated = next(each for each in file.addresses if each.startswith(TWIN)).split("/")[2]
        name = register(stated, virtual)

        def address(stated_address: str) -> str:
            return stated_address.replace(f"{TWIN}{stated}/", f"{TWIN}{name}/", 1)

    settings = axis_settings(file)
    module = TmclModule(
        _serial(address(file.axes.port)),
        clock,
        file.axes.baudrate,
        tap("axes", tmcl.explain),
        [each.module for each in settings.values()],
        file.axes.heartbeat_s,
    )
    addresses = ModbusUnits(virtual)
    units = [addresses.unit(address(each)) for each in file.photodiodes.units]
    for k, unit in enumerate(units):
        unit.tap = tap(f"photodiodes-{k}", addresses.explain(unit))
    rig = Rig(
        clock=clock,
        axes_module=module,
        axes={axis: Axis(module, each, clock) for axis, each in settings.items()},
        monochromator=Monochromator(
            _serial(address(file.monochromator.port)),
            monochromator_settings(file),
            clock,
            tap("monochromator", as_text),
        ),
        photodiodes=PhotodiodeArray(units, photodiode_settings(file), clock),
        monitor=Monitor(
            _usb(address(file.monitor.usb), virtual),
            monitor_settings(file),
            clock,
            tap("monitor", usbtmc_driver.explain),
        ),
        simulated=description.simulated,
        clearance=arc_clearance(file),
    )
    opened = OpenRig(rig, virtual, name, written)
    try:
        opened.lock(
            [each.partition("?")[0] for each in file.addresses if not each.startswith(TWIN)],
            f"{file.name} ({description.name})",
        )
    except UserError:
        opened.close()
        raise
    return opened


def _serial(address: str) -> PortOpener:
    """A port's name, or any URL that pyserial knows."""

    def opener(baudrate: int, timeout_s: float) -> serial.Serial:
        return serial.serial_for_url(address, baudrate=baudrate, timeout=timeout_s)

    return opener


def _usb(address: str, virtual: VirtualRig | None) -> UsbOpener:
    """`VENDOR:PRODUCT` or `VENDOR:PRODUCT:SERIAL`, the numbers in hexadecimal, or `usbip:HOST:PORT/BUSID`.

    Raises UserError for what is none of these.
    """
    if address.startswith(TWIN):
        wanted = address.rsplit("/", 1)[1]

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
        raise UserError(
            f"monitor.usb: {address!r} is neither VENDOR:PRODUCT:SERIAL nor usbip:HOST:PORT/BUSID; mend it in the rig file"
        ) from None
    serial_number = {"serial_number": parts[2]} if len(parts) > 2 else {}

    def opener() -> Any:
        import libusb_package

        return usb.core.find(backend=libusb_package.get_libusb1_backend(), idVendor=vendor, idProduct=product, **serial_number)

    return opener


def usbip_address(address: str) -> tuple[str, int, str]:
    """Host, port and bus id of `usbip:HOST:PORT/BUSID`; the port is 3240 where not given. Raises UserError."""
    place, _, bus_id = address.removeprefix(USBIP).partition("/")
    host, number = host_and_port(place, USBIP_PORT)
    if not host or not bus_id or not is_port(number):
        raise UserError(f"monitor.usb: {address!r} is not usbip:HOST:PORT/BUSID, such as usbip:127.0.0.1:3240/1-1; mend it")
    return host, int(number), bus_id
