"""Opening of a rig file: drivers on their wires. Only this module opens ports and devices by name."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import serial
import usb.core

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import TWIN, USBIP, ModbusUnits, usbip_address
from goniotwin.app.rig.file import (
    RigFile,
    arc_clearance,
    axis_settings,
    monitor_settings,
    monochromator_settings,
    photodiode_settings,
)
from goniotwin.app.rig.lock import RigLock
from goniotwin.app.rig.model_hash import model_hashes
from goniotwin.app.rig.twin_file import twin_model
from goniotwin.app.toml_file import parse_toml, read_toml, validate_table
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


@dataclass(frozen=True)
class RigDescription:
    """A rig file: its text, its tables, and the folder that paths in it are relative to."""

    text: str
    file: RigFile
    folder: Path
    name: str

    @property
    def simulated(self) -> bool:
        """Whether the rig is simulated."""
        return self.file.simulated is not None

    @property
    def seed(self) -> int | None:
        """The seed of a simulated rig, None for a real one."""
        return self.file.simulated.seed if self.file.simulated is not None else None

    def model(self) -> TwinModel | None:
        """The model of the virtual rig, None where the file has no [twin].

        Raises UserError for the file of a sample that cannot be read.
        """
        if self.file.twin is None:
            return None
        return twin_model(self.file.twin, self.seed or 0, self.folder, self.name)

    def model_hash(self) -> str | None:
        """The hash of the virtual rig's model, None for a real rig."""
        return self.model_hashes()[0]

    def model_hashes(self) -> tuple[str | None, ...]:
        """All hashes that identify the model of the virtual rig: the present version first, then the older one."""
        model = self.model()
        if model is not None:
            return model_hashes(model)
        table = self.file.simulated
        if table is None:
            return (None,)
        return (table.model,) if table.old_model is None else (table.model, table.old_model)


def read_rig(path: Path) -> RigDescription:
    """Read a rig file. Raises UserError with the file, the key and the reason."""
    text, content = read_toml(path)
    return RigDescription(text, validate_table(RigFile, content, str(path)), path.parent, str(path))


def parse_rig(text: str, folder: Path, name: str) -> RigDescription:
    """Parse the text of a rig file, such as a journal contains. Raises UserError."""
    return RigDescription(text, validate_table(RigFile, parse_toml(text, name), name), folder, name)


@dataclass
class OpenRig:
    """Drivers with their wires, not connected yet, and the virtual rig behind them, if any."""

    rig: Rig
    virtual: VirtualRig | None
    _name: str | None
    _transcript: Transcript | None
    _lock: RigLock | None = None

    def connect(self) -> None:
        """Connect every device. Raises UserError for the first that does not respond, after closing everything."""
        for error in self.rig.connect().values():
            if error is not None:
                self.close()
                raise UserError(str(error))

    def close(self) -> None:
        """Close all devices, files and locks. No axis moves."""
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
        """The reason why the transcripts are incomplete; None if they are complete, or not written at all."""
        return self._transcript.failure if self._transcript is not None else None

    def lock(self, addresses: list[str], purpose: str) -> None:
        """Lock real devices against other programs until `close`. Raises RigInUse with the program that has one."""
        self._lock = RigLock(addresses, purpose)

    def __enter__(self) -> "OpenRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_rig(description: RigDescription, clock: Clock, transcript: Path | None = None) -> OpenRig:
    """Drivers of a rig on `clock`, and the devices of a virtual rig. Nothing is connected yet.

    With a folder in `transcript` every byte on every wire is written to files there. Raises UserError.
    """
    file = description.file
    try:
        transcripts = Transcript(transcript, clock) if transcript is not None else None
    except OSError as error:
        raise UserError(f"{transcript}: cannot hold transcripts: {error.strerror}; give another folder") from None

    def tap(device: str, explain: Explain) -> Tap:
        return transcripts.tap(device, explain) if transcripts is not None else no_tap

    virtual, name = None, None
    model = description.model()
    address: Callable[[str], str] = str
    if model is not None and any(each.startswith(TWIN) for each in file.addresses):
        virtual = VirtualRig.build(model, clock)
        file_name = next(each for each in file.addresses if each.startswith(TWIN)).split("/")[2]
        name = register(file_name, virtual)  # another one if this process has a virtual rig of that name already

        def address(file_address: str) -> str:
            return file_address.replace(f"{TWIN}{file_name}/", f"{TWIN}{name}/", 1)

    try:
        rig = _rig(description, clock, tap, virtual, address)
    except UserError:
        if name is not None:
            unregister(name)
        if transcripts is not None:
            transcripts.close()
        raise
    opened = OpenRig(rig, virtual, name, transcripts)
    try:
        opened.lock(
            [each.partition("?")[0] for each in file.addresses if not each.startswith(TWIN)],
            f"{file.name} ({description.name})",
        )
    except UserError:
        opened.close()
        raise
    return opened


def _rig(
    description: RigDescription,
    clock: Clock,
    tap: Callable[[str, Explain], Tap],
    virtual: VirtualRig | None,
    address: Callable[[str], str],
) -> Rig:
    """Drivers of a rig; `address` gives the address in this process of one in the file. Raises UserError for a wrong one."""
    file = description.file
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
    return Rig(
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


def _serial(address: str) -> PortOpener:
    """An opener for the name of a port, or for any URL of pyserial."""

    def opener(baudrate: int, timeout_s: float) -> serial.Serial:
        return serial.serial_for_url(address, baudrate=baudrate, timeout=timeout_s)

    return opener


def _usb(address: str, virtual: VirtualRig | None) -> UsbOpener:
    """An opener for `VENDOR:PRODUCT` or `VENDOR:PRODUCT:SERIAL` (hexadecimal), or `usbip:HOST:PORT/BUSID`.

    Raises UserError for another form.
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
        wrong = f"monitor.usb: {address!r} is neither VENDOR:PRODUCT:SERIAL nor usbip:HOST:PORT/BUSID"
        raise UserError(f"{wrong}; correct it in the rig file") from None
    serial_number = {"serial_number": parts[2]} if len(parts) > 2 else {}

    def opener() -> Any:
        import libusb_package

        return usb.core.find(backend=libusb_package.get_libusb1_backend(), idVendor=vendor, idProduct=product, **serial_number)

    return opener
