"""Opening of a rig: drivers on their wires, and the virtual rig behind them."""

import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from goniotwin.app.errors import UserError, unusable
from goniotwin.app.guardian.guard import RigGuard
from goniotwin.app.rig.addresses import TWIN, InvalidAddress, device_names, resolve_port
from goniotwin.app.rig.axes import AXES, Controller
from goniotwin.app.rig.description import RigDescription
from goniotwin.app.rig.file import RigFile, arc_clearance
from goniotwin.app.rig.kinds import ROLES, Role, device_kind
from goniotwin.app.rig.last_rig import remember_rig
from goniotwin.app.rig.lock import RigLock, check_server
from goniotwin.app.rig.wires import Wires
from goniotwin.drivers import Device, Rig, Transcript
from goniotwin.protocols.clock import Clock
from goniotwin.twin import VirtualRig
from goniotwin.twin.doors import register, unregister

LOG = logging.getLogger(__name__)


@dataclass
class OpenRig:
    """Drivers with their wires, not connected yet, and the virtual rig behind them, if any."""

    rig: Rig
    file: RigFile
    virtual: VirtualRig | None
    _name: str | None
    _transcript: Transcript | None
    guard: RigGuard
    _wires: Callable[[], Wires]
    _lock: RigLock | None = None

    def connect(self) -> None:
        """Connect every device. Raises UserError for the first that does not respond, after closing everything."""
        for error in self.rig.connect().values():
            if error is not None:
                self.close()
                raise UserError(str(self.rig.in_words(error)))
        remember_rig(self.file)

    def close(self) -> None:
        """Close all devices, files and locks. No axis moves."""
        self.rig.close()
        self.guard.close()  # before the locks: what it keeps is of no other program
        if self._name is not None:
            unregister(self._name)
            self._name = None
        if self._transcript is not None:
            self._transcript.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def wires(self) -> Wires:
        """The wires of the rig for another client of its devices, by their addresses in the file; without transcripts."""
        return self._wires()

    @property
    def transcript_failure(self) -> str | None:
        """The reason why the transcripts are incomplete; None if they are complete, or not written at all."""
        return self._transcript.failure if self._transcript is not None else None

    def lock(self, addresses: list[str], purpose: str) -> None:
        """Lock real devices against other programs until `close`. Raises RigInUse with the program that has one."""
        self._lock = RigLock(addresses, purpose)
        self.guard.begin(self._lock.files, self._lock.names)

    def __enter__(self) -> "OpenRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_rig(description: RigDescription, clock: Clock, transcript: Path | None = None) -> OpenRig:
    """Drivers of a rig on `clock`, and the devices of a virtual rig. Nothing is connected yet.

    With a folder in `transcript` every byte on every wire is written to files there. Raises UserError.
    """
    file = description.file
    if file.simulated is not None and not file.in_process:
        check_server(file.simulated.server, description.name)
    try:
        transcripts = Transcript(transcript, clock) if transcript is not None else None
    except OSError as error:
        raise unusable(transcript or "", "cannot hold transcripts", error, "give another folder") from None

    virtual, name = None, None
    model = description.model()
    in_this_process: Callable[[str], str] = cache(resolve_port)  # once, so that what is locked is what is opened
    if model is not None and any(each.startswith(TWIN) for each in file.addresses):
        virtual = VirtualRig.build(model, clock)
        file_name = next(each for each in file.addresses if each.startswith(TWIN)).split("/")[2]
        name = register(file_name, virtual)  # another one if this process has a virtual rig of that name already

        resolved = in_this_process

        def in_this_process(file_address: str) -> str:
            return resolved(file_address).replace(f"{TWIN}{file_name}/", f"{TWIN}{name}/", 1)

    guard = RigGuard(file.name)
    try:
        speed = 1.0 if file.in_process else file.speed
        rig = _rig(description, Wires(clock, virtual, transcripts, in_this_process, guard, speed))
    except UserError:
        if name is not None:
            unregister(name)
        if transcripts is not None:
            transcripts.close()
        raise
    opened = OpenRig(rig, file, virtual, name, transcripts, guard, lambda: Wires(clock, virtual, None, in_this_process))
    try:
        opened.lock(
            [in_this_process(each) for each in file.addresses if not each.startswith(TWIN)], f"{file.name} ({description.name})"
        )
    except UserError:
        opened.close()
        raise
    for each in file.devices:
        LOG.info("%s at %s", each.name, in_this_process(each.address))
    return opened


def _rig(description: RigDescription, wires: Wires) -> Rig:
    """Drivers of a rig. Raises UserError for an address that is not valid."""
    file = description.file
    lines: dict[str, Controller] = {}
    for each in file.axes.controllers:
        names = {each.port} if each.port.startswith(TWIN) else device_names(each.port)
        if (other := next((lines[name] for name in names if name in lines), None)) is not None:
            place = f"{description.name}: {'.'.join(each.places[0])}.port"
            raise UserError(
                f"{place}: {each.port} is the same line as {other.port} of {'.'.join(other.places[0])}; write both alike"
            )
        lines |= dict.fromkeys(names, each)
    try:
        controllers = tuple(each.kind.open(wires, each.name, each.table, each.axes) for each in file.axes.controllers)
        devices: dict[str, Any] = {role: _open(wires, role, getattr(file, role)) for role in ROLES[1:]}
    except InvalidAddress as error:
        places = [each.places[0] for each in file.devices if each.address == error.address]
        keys = [f"{'.'.join(part for part in place if isinstance(part, str))}: " for place in places]
        raise UserError(f"{description.name}: {''.join(keys[:1])}{error}") from None
    axes = {name: axis for controller in controllers for name, axis in controller.axes.items()}
    return Rig(
        clock=wires.clock,
        controllers=controllers,
        axes={name: axes[name] for name in AXES},
        simulated=description.simulated,
        clearance=arc_clearance(file),
        **devices,
    )


def _open(wires: Wires, role: Role, table: Any) -> Device:
    return device_kind(role, table.kind).open(wires, table)
