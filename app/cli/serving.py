"""A virtual rig for other programs: on real endpoints, and as USB devices of a program that runs here."""

import getpass
import json
import runpy
import sys
import tempfile
import threading
from pathlib import Path

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.served_file import check_served_rig, served_rig, write_served_rig
from goniotwin.mocks import installed
from goniotwin.mocks.served import ServedRig
from goniotwin.protocols.clock import RealClock
from goniotwin.twin import TwinModel, VirtualRig
from goniotwin.twin.doors import TwinUsbBackend


def serve_until_interrupted(
    rig: RigDescription, speed: float, ptys: Path | None, write_rig: Path | None = None, *, control: bool = True
) -> None:
    """Prints where the devices are, and serves until SIGINT or SIGTERM. Raises UserError."""
    folder = ptys if ptys is not None else Path(tempfile.gettempdir()) / f"goniotwin-{getpass.getuser()}" / rig.file.name
    if write_rig is not None:
        check_served_rig(write_rig)
    served = ServedRig(_model(rig), speed, folder.absolute(), control=control)
    try:
        served.start()
        if write_rig is not None:
            write_served_rig(write_rig, served_rig(rig, served.endpoints, speed))
        for endpoint in served.endpoints:
            print(json.dumps(endpoint.as_dict()), flush=True)
        threading.Event().wait()
    except OSError as error:
        advice = "; see that the names and ports are free" if error.errno is not None else ""
        raise UserError(f"{rig.name}: cannot be served: {error}{advice}") from None
    except KeyboardInterrupt:
        print("goniotwin: no longer served", file=sys.stderr)
    finally:
        served.stop()


def run_with_usb(rig: RigDescription, program: Path, arguments: list[str]) -> None:
    """Runs a Python program in this process, in which pyusb finds the twin's devices. Raises UserError."""
    if not program.is_file():
        raise UserError(f"{program}: there is no such program; check the name")
    virtual = VirtualRig.build(_model(rig), RealClock())
    sys.argv = [str(program), *arguments]
    with installed(TwinUsbBackend(virtual)):
        runpy.run_path(str(program), run_name="__main__")


def _model(rig: RigDescription) -> TwinModel:
    model = rig.model()
    if model is None:
        raise UserError(f"{rig.name}: has no [twin] table, so there is no virtual rig to serve; name another rig file")
    return model
