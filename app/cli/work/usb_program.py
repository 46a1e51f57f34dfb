"""A pyusb program with the USB devices of a virtual rig."""

import runpy
import sys
import traceback
from pathlib import Path

import typer
import usb.core
from usb.backend import IBackend

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.rig.addresses import USBIP, usbip_address
from goniotwin.app.rig.lock import RigLock, check_server
from goniotwin.drivers.usb.usbip import UsbIpBackend, exported_devices
from goniotwin.mocks import install_backend
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import TwinUsbBackend


def run_program(rig: Path, program: Path, arguments: list[str]) -> None:
    """Run a Python program. Raises UserError, and Exit where the program fails."""
    description = read_rig(rig)
    if not program.is_file():
        raise UserError(f"{program}: no such program; check the name")
    backend = _usb_backend(description)
    served = [] if description.file.in_process else [description.file.monitor.usb]
    lock = RigLock(served, f"goniotwin usb {program.name}")
    sys.argv = [str(program), *arguments]
    before = list(sys.path)
    sys.path.insert(0, str(program.resolve().parent))  # as Python itself does for a program
    try:
        with install_backend(backend):
            runpy.run_path(str(program), run_name="__main__")
    except Exception:  # noqa: BLE001  (of another program: in full, as without this command)
        traceback.print_exc()
        raise typer.Exit(1) from None
    finally:
        sys.path[:] = before
        lock.release()


def _usb_backend(rig: RigDescription) -> IBackend:
    """pyusb's backend with the USB devices of a rig: of one in this process, or of one behind a USB/IP server.

    Raises UserError.
    """
    model, address = rig.model(), rig.file.monitor.usb
    if model is not None:
        return TwinUsbBackend(VirtualRig.build(model, RealClock()))
    if not address.startswith(USBIP):
        raise UserError(
            f"{rig.name}: has no [twin] table, and the monitor is at {address}, which is no USB/IP server; name the file of a "
            "virtual rig, or the one that goniotwin serve --write-rig has written"
        )
    host, port, bus_id = usbip_address(address)
    if rig.file.simulated is not None:
        check_server(rig.file.simulated.server, rig.name)
    try:
        exported = {each.bus_id for each in exported_devices(host, port)}
    except usb.core.USBError as error:
        raise UserError(f"{rig.name}: monitor: {error.strerror or error}; start goniotwin serve") from None
    if bus_id not in exported:
        raise UserError(f"{rig.name}: monitor: {address}: the server has no device {bus_id}; plug it in, or serve the rig anew")
    return UsbIpBackend(host, port, bus_id)
