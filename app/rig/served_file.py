"""The rig file that `goniotwin serve` writes: with it another process measures on the virtual rig that is served here."""

import tempfile
from collections.abc import Iterable
from pathlib import Path

import tomlkit

from goniotwin.app.errors import UserError, unusable
from goniotwin.app.rig.description import RigDescription
from goniotwin.app.rig.file import set_addresses
from goniotwin.mocks.served import CONTROL, Endpoint, Wire
from goniotwin.own_files import replace_text
from goniotwin.protocols import adam

FIRST_LINE = "# Written by goniotwin serve, which writes it anew at every start. SIMULATED."


def served_rig(
    description: RigDescription,
    endpoints: Iterable[Endpoint],
    speed: float,
    alignment: Path | None = None,
    server: str | None = None,
) -> str:
    """The text of the rig file: the operator's part with the addresses of the endpoints, marked as simulated.

    Of the [twin] table it has only the hash of the model, in both versions. `alignment` is the file beside it that has the
    rig's alignment, `server` the key of `lock_served_rig`.
    """
    addresses: dict[str, str] = {}
    control: Endpoint | None = None
    for endpoint in endpoints:
        if endpoint.device == CONTROL:
            control = endpoint
        else:
            addresses.setdefault(endpoint.device, endpoint_address(endpoint))  # a pseudo-terminal comes before its TCP port
    document = tomlkit.parse(description.text)
    document.remove("twin")
    set_addresses(document, description.file, lambda device: addresses[device.twin])
    simulated = tomlkit.table()
    hashes = zip(("model", "old_model"), description.model_hashes(), strict=False)  # not every model has an old hash
    simulated.update({"seed": description.seed, **dict(hashes), "speed": speed})
    if server is not None:
        simulated["server"] = server
    if control is not None:
        simulated.update({"control_port": control.port, "control_token": control.token})
    document["simulated"] = simulated
    if alignment is not None:
        document["alignment"] = {"file": alignment.name}
    return f"{FIRST_LINE}\n{tomlkit.dumps(document)}"


def endpoint_address(endpoint: Endpoint) -> str:
    """The address of an endpoint in a rig file."""
    place = f"{endpoint.host}:{endpoint.port}"
    port = endpoint.path if endpoint.path is not None else f"socket://{place}"
    match endpoint.wire:
        case Wire.USBIP:
            return f"usbip:{place}/{endpoint.bus_id}"
        case Wire.MODBUS_TCP:
            return place if endpoint.unit == adam.UNIT else f"{place}?unit={endpoint.unit}"
        case Wire.MODBUS_RTU:
            return f"rtu:{port}?unit={endpoint.unit}&baudrate={endpoint.baudrate}"
        case _:
            return port


def served_alignment(path: Path, description: RigDescription) -> Path | None:
    """The file of the rig's alignment beside the rig file to be written; None for a rig without one."""
    return None if description.alignment is None else path.with_name(f"{path.stem}-alignment.toml")


def check_served_rig(path: Path) -> None:
    """Check that the file can be written and replaces no other file. Raises UserError; changes nothing."""
    try:
        exists = path.exists() or path.is_symlink()
        if exists and not (path.is_file() and path.read_text(encoding="utf-8", errors="replace").startswith(FIRST_LINE)):
            raise UserError(f"{path}: exists already, and was not written by goniotwin serve; choose another name")
        with tempfile.TemporaryFile(dir=path.parent):
            pass
    except OSError as error:
        raise _unwritable(path, error) from None


def write_served_rig(path: Path, text: str) -> None:
    """Write the rig file, or that of its alignment, for this user alone: the former has the token of the control port.

    Raises UserError; a file that was not written by `goniotwin serve` is not replaced.
    """
    check_served_rig(path)
    try:
        replace_text(path, text)
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> UserError:
    return unusable(path, "cannot be written", error, "choose another name")
