"""Commands on a virtual rig for other programs: `goniotwin serve`, `usb` and `replay`."""

import getpass
import json
import re
import runpy
import secrets
import sys
import tempfile
import threading
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from goniotwin.app.cli.output import Json, RigOption, Speed, answer, print_note
from goniotwin.app.errors import UserError

if TYPE_CHECKING:  # the twin is compiled code, which a command's help does not need
    from usb.backend import IBackend

    from goniotwin.app.rig import RigDescription
    from goniotwin.twin import TwinModel

app = typer.Typer()


@app.command()
def serve(
    rig: RigOption,
    speed: Speed = 1.0,
    write_rig: Annotated[
        Path | None,
        typer.Option(
            "--write-rig", metavar="FILE", help="Write a rig file for programs that measure on this rig.", show_default=False
        ),
    ] = None,
    control: Annotated[
        bool, typer.Option("--control/--no-control", help="Open the simulation control port (JSON commands).")
    ] = True,
    ptys: Annotated[
        Path | None,
        typer.Option("--ptys", metavar="DIR", help="Folder for links to the pseudo-terminals.", show_default=False),
    ] = None,
) -> None:
    """Serve a virtual rig on ports of this computer.

    Prints one JSON line for each port: `device`, `kind`, and `path` of a pseudo-terminal or `host` and `port`; `unit` for
    Modbus; `bus_id` for USB/IP. All ports belong to one instrument. `control` is the simulation control port. Ctrl-C or
    SIGTERM ends it.

    Programs that use USB but not USB/IP reach the monitor with `goniotwin usb`.
    """
    print_note(f"preparing the virtual rig of {rig}")  # before the imports, which load compiled code
    # Loads 740 modules, numba and pymodbus among them: 0.8 s, which help does without.
    from goniotwin.app.rig import read_rig
    from goniotwin.app.rig.lock import lock_served_rig
    from goniotwin.app.rig.served_file import FIRST_LINE, check_served_rig, served_alignment, served_rig, write_served_rig
    from goniotwin.mocks.served import ServedRig

    description = read_rig(rig)
    folder = ptys if ptys is not None else default_folder(description.file.name)
    alignment = None if write_rig is None else served_alignment(write_rig, description)
    for path in (write_rig, alignment):
        if path is not None:
            check_served_rig(path)
    served = ServedRig(_twin_model(description), speed, folder.absolute(), control=control)
    lock = None
    try:
        served.start()
        if write_rig is not None:
            if alignment is not None:
                write_served_rig(alignment, f"{FIRST_LINE}\n{description.alignment}")
            server = secrets.token_hex(8)
            lock = lock_served_rig(server, f"goniotwin serve of {description.name}")
            write_served_rig(write_rig, served_rig(description, served.endpoints, speed, alignment, server))
        for endpoint in served.endpoints:
            print(json.dumps(endpoint.as_dict()), flush=True)
        threading.Event().wait()
    except OSError as error:
        advice = "; check that the names and ports are free" if error.errno is not None else ""
        raise UserError(f"{description.name}: cannot be served: {error}{advice}") from None
    except KeyboardInterrupt:
        print("goniotwin: serving ended", file=sys.stderr)
    finally:
        served.stop()
        if lock is not None:
            lock.release(remove=True)


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True, "allow_interspersed_args": False})
def usb(
    context: typer.Context,
    program: Annotated[
        Path,
        typer.Argument(metavar="PROGRAM.py", help="Program that uses pyusb; its own arguments follow.", show_default=False),
    ],
    rig: RigOption,
) -> None:
    """Run a pyusb program with the USB devices of a virtual rig.

    With the rig file of a served rig (`goniotwin serve --write-rig`) they are those of that rig, which no other program may use
    meanwhile. The program is not modified.
    """
    # Loads 707 modules, numba and pymodbus among them: 0.7 s, which help does without.
    from goniotwin.app.rig import read_rig
    from goniotwin.app.rig.lock import RigLock
    from goniotwin.mocks import install_backend

    description = read_rig(rig)
    if not program.is_file():
        raise UserError(f"{program}: no such program; check the name")
    backend = _usb_backend(description)
    served = [] if description.file.in_process else [description.file.monitor.usb]
    lock = RigLock(served, f"goniotwin usb {program.name}")
    sys.argv = [str(program), *context.args]
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


def _usb_backend(rig: "RigDescription") -> "IBackend":
    """pyusb's backend with the USB devices of a rig: of one in this process, or of one behind a USB/IP server.

    Raises UserError.
    """
    # Loads 702 modules, numba and pymodbus among them: 0.7 s, which help does without.
    import usb.core

    from goniotwin.app.rig.addresses import USBIP, usbip_address
    from goniotwin.app.rig.lock import check_server
    from goniotwin.drivers.usb.usbip import UsbIpBackend, exported_devices
    from goniotwin.protocols.clock import RealClock
    from goniotwin.twin import VirtualRig
    from goniotwin.twin.doors import TwinUsbBackend

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


@app.command()
def replay(
    transcripts: Annotated[list[Path], typer.Argument(metavar="TRANSCRIPT.txt", help="Files that --transcript wrote.")],
    rig: RigOption,
    device: Annotated[
        str | None, typer.Option("--device", help="Device of the file, if the file name does not have it.")
    ] = None,
    mount: Annotated[str | None, typer.Option("--mount", metavar="SAMPLE", help="Sample that is mounted at the start.")] = None,
    as_json: Json = False,
) -> None:
    """Replay transcripts on the twin and list the differences.

    Each difference is shown byte by byte. No real device is opened.

    The file name is the device: axes, monochromator, photodiodes-0 and so on, monitor. Give all files of one recording
    together: they are replayed in the order of their times, so that shutter and axes are where they were.

    Values that depend on time and noise differ: counts, encoder positions, measured currents. Serial numbers do too.

    Exit status: 1 if anything differs, else 0.
    """
    # Loads 701 modules, numba and pymodbus among them: 0.7 s, which help does without.
    from goniotwin.app.cli.replay import replay_transcripts
    from goniotwin.app.rig import read_rig

    result = replay_transcripts(transcripts, read_rig(rig), device, mount)
    answer(as_json, result, lambda: print(result.text()))
    raise typer.Exit(1 if result.differences else 0)


def default_folder(rig: str) -> Path:
    """The folder of a rig's pseudo-terminals: a name of this user's and this rig's own, without blanks and separators."""
    user, name = (re.sub(r"[^\w-]+", "-", each) for each in (getpass.getuser(), rig))
    return Path(tempfile.gettempdir()) / f"goniotwin-{user}" / name


def _twin_model(rig: "RigDescription") -> "TwinModel":
    model = rig.model()
    if model is None:
        raise UserError(f"{rig.name}: has no [twin] table, so there is no virtual rig; name another rig file")
    return model
