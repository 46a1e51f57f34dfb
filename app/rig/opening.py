"""Opening of a rig file: drivers on their wires, and the virtual rig behind them."""

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from goniotwin.app.errors import UserError, unusable
from goniotwin.app.rig.addresses import TWIN, InvalidAddress, device_names, resolve_port
from goniotwin.app.rig.alignment import RigIdentity, alignment_notes, check_alignment, parse_alignment, read_alignment
from goniotwin.app.rig.axes import AXES, Controller
from goniotwin.app.rig.file import RigFile, arc_clearance, check_kinds, rig_file_table, tables_without_ports
from goniotwin.app.rig.kinds import ROLES, Role, device_kind, load_plugins
from goniotwin.app.rig.model_hash import model_hashes
from goniotwin.app.rig.twin_file import check_detectors, twin_model
from goniotwin.app.toml_file import parse_toml, read_toml, validate_table
from goniotwin.drivers import Transcript

if TYPE_CHECKING:  # the libraries of the buses are loaded when a rig is opened
    from goniotwin.app.guardian.guard import RigGuard
    from goniotwin.app.rig.lock import RigLock
    from goniotwin.app.rig.wires import Wires
    from goniotwin.drivers import Device, Rig, Transcript
    from goniotwin.protocols.clock import Clock
    from goniotwin.twin import TwinModel, VirtualRig

ARC_KEYS = ("upper_deg", "lower_deg")
"""Keys of [photodiodes] that are angles on the arc."""
AXIS_KEYS = ("gear", "sense", "zero_offset_deg")
"""Keys of an axis that decide where it is, whatever its kind."""
WITHOUT_ANGLES = ("shadow_margin_deg", "reply_timeout_s")
"""Keys of [geometry] and [axes] that change no angle."""


@dataclass(frozen=True)
class RigDescription:
    """A rig file: its text, its tables, the folder that paths in it are relative to, and the text of its alignment file."""

    text: str
    file: RigFile
    folder: Path
    name: str
    alignment: str | None = None

    @property
    def digest(self) -> str:
        """SHA-256 of the text."""
        return hashlib.sha256(self.text.encode()).hexdigest()

    @property
    def simulated(self) -> bool:
        """Whether the rig is simulated."""
        return self.file.simulated is not None

    @property
    def seed(self) -> int | None:
        """The seed of a simulated rig, None for a real one."""
        return self.file.simulated.seed if self.file.simulated is not None else None

    @property
    def identity(self) -> RigIdentity:
        """What an alignment states of its rig, and what it depends on."""
        content = tables_without_ports(self.file)
        content.pop("alignment", None)
        name = content.pop("name")
        photodiodes, axes = content["photodiodes"], content["axes"]
        for table in (axes, *(axes[name] for name in AXES)):
            for key in WITHOUT_ANGLES:
                table.pop(key, None)
        geometry = {
            **{key: value for key, value in content.pop("geometry").items() if key not in WITHOUT_ANGLES},
            **{key: photodiodes.pop(key, None) for key in ARC_KEYS},
            **{f"{axis}.{key}": axes[axis].pop(key, None) for axis in AXES for key in AXIS_KEYS},
        }
        digests = {table: _digest(each) for table, each in content.items()}
        return RigIdentity(name, self.simulated, self.seed, _digest(geometry), digests)

    @property
    def alignment_notes(self) -> list[str]:
        """What is stated wherever the rig's alignment is used: doubtful residuals, and tables that have changed since it."""
        return [] if self.alignment is None else alignment_notes(parse_alignment(self.alignment, self.name), self.identity)

    def model(self) -> "TwinModel | None":
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
    """Read a rig file, and the alignment file that it names. Raises UserError with the file, the key and the reason."""
    text, content = read_toml(path)
    file = _file(content, str(path))
    alignment = None
    if file.alignment is not None:
        alignment = read_alignment(path.parent, file.alignment)
        check_alignment(alignment, str(path), RigDescription(text, file, path.parent, str(path)).identity)
    return RigDescription(text, file, path.parent, str(path), alignment)


def parse_rig(text: str, folder: Path, name: str, alignment: str | None = None) -> RigDescription:
    """Parse the text of a rig file, such as a journal contains, with that of its alignment file. Raises UserError."""
    return RigDescription(text, _file(parse_toml(text, name), name), folder, name, alignment)


def _digest(table: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(table, sort_keys=True, default=str).encode()).hexdigest()


def _file(content: dict[str, Any], name: str) -> RigFile:
    if "sigma_deg" in content and "axes" not in content:
        raise UserError(f"{name}: looks like a schedule, not like a rig file; open it as a schedule")
    load_plugins(content, name)
    try:
        check_kinds(content)
        check_detectors(content)
    except ValueError as error:
        raise UserError(f"{name}: {error}") from None
    return validate_table(rig_file_table(), content, name)


@dataclass
class OpenRig:
    """Drivers with their wires, not connected yet, and the virtual rig behind them, if any."""

    rig: "Rig"
    file: RigFile
    virtual: "VirtualRig | None"
    _name: str | None
    _transcript: "Transcript | None"
    guard: "RigGuard"
    _wires: "Callable[[], Wires]"
    _lock: "RigLock | None" = None

    def connect(self) -> None:
        """Connect every device. Raises UserError for the first that does not respond, after closing everything."""
        for error in self.rig.connect().values():
            if error is not None:
                self.close()
                raise UserError(str(self.rig.in_words(error)))
        # Loads 2 modules: 2 ms, which `check` does without.
        from goniotwin.app.rig.last_rig import remember_rig

        remember_rig(self.file)

    def close(self) -> None:
        """Close all devices, files and locks. No axis moves."""
        self.rig.close()
        self.guard.close()  # before the locks: what it keeps is of no other program
        if self._name is not None:
            # Loads 410 modules, numba and pymodbus among them: 0.4 s, which `check` does without.
            from goniotwin.twin.doors import unregister

            unregister(self._name)
            self._name = None
        if self._transcript is not None:
            self._transcript.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    def wires(self) -> "Wires":
        """The wires of the rig for another client of its devices, by their addresses in the file; without transcripts."""
        return self._wires()

    @property
    def transcript_failure(self) -> str | None:
        """The reason why the transcripts are incomplete; None if they are complete, or not written at all."""
        return self._transcript.failure if self._transcript is not None else None

    def lock(self, addresses: list[str], purpose: str) -> None:
        """Lock real devices against other programs until `close`. Raises RigInUse with the program that has one."""
        # Loads 14 modules: 18 ms, which `check` does without.
        from goniotwin.app.rig.lock import RigLock

        self._lock = RigLock(addresses, purpose)
        self.guard.begin(self._lock.files, self._lock.names)

    def __enter__(self) -> "OpenRig":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def open_rig(description: RigDescription, clock: "Clock", transcript: Path | None = None) -> OpenRig:
    """Drivers of a rig on `clock`, and the devices of a virtual rig. Nothing is connected yet.

    With a folder in `transcript` every byte on every wire is written to files there. Raises UserError.
    """
    # Loads 436 modules, numba and pymodbus among them: 0.4 s, which `check` does without.
    from goniotwin.app.guardian.guard import RigGuard
    from goniotwin.app.rig.lock import check_server
    from goniotwin.app.rig.wires import Wires
    from goniotwin.twin import VirtualRig
    from goniotwin.twin.doors import register, unregister

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
    return opened


def _rig(description: RigDescription, wires: "Wires") -> "Rig":
    """Drivers of a rig. Raises UserError for an address that is not valid."""
    # Loads 109 modules, pymodbus and usb among them: 0.1 s, which `check` does without.
    from goniotwin.drivers import Rig

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


def _open(wires: "Wires", role: Role, table: Any) -> "Device":
    return device_kind(role, table.kind).open(wires, table)
