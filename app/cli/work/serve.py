"""A virtual rig on ports of this computer."""

import getpass
import json
import logging
import re
import secrets
import sys
import tempfile
import threading
from pathlib import Path

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.rig.lock import lock_served_rig
from goniotwin.app.rig.served_file import FIRST_LINE, check_served_rig, served_alignment, served_rig, write_served_rig
from goniotwin.mocks.served import ServedRig
from goniotwin.twin import TwinModel

LOG = logging.getLogger(__name__)


def serve_rig(rig: Path, speed: float, write_rig: Path | None, ptys: Path | None, *, control: bool) -> None:
    """Serve a virtual rig until Ctrl-C. Raises UserError."""
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
            LOG.info("%s: %s", endpoint.device, endpoint.path or f"{endpoint.host}:{endpoint.port}")  # without its token
        threading.Event().wait()
    except OSError as error:
        advice = "; check that the names and ports are free" if error.errno is not None else ""
        raise UserError(f"{description.name}: cannot be served: {error}{advice}") from None
    except KeyboardInterrupt:
        print("goniotwin: serving ended", file=sys.stderr)
        LOG.info("serving ended")
    finally:
        served.stop()
        if lock is not None:
            lock.release(remove=True)


def default_folder(rig: str) -> Path:
    """The folder of a rig's pseudo-terminals: a name of this user's and this rig's own, without blanks and separators."""
    user, name = (re.sub(r"[^\w-]+", "-", each) for each in (getpass.getuser(), rig))
    return Path(tempfile.gettempdir()) / f"goniotwin-{user}" / name


def _twin_model(rig: RigDescription) -> TwinModel:
    model = rig.model()
    if model is None:
        raise UserError(f"{rig.name}: has no [twin] table, so there is no virtual rig; name another rig file")
    return model
