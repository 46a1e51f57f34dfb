"""Registry of device kinds: what a value of `kind` in a rig file stands for.

A kind names its table in the rig file (a frozen dataclass), its driver, and the tables of its twin devices. `register` adds a
kind. Kinds of installed packages come from the entry-point group `goniotwin.devices`, where the name of an entry point is the
kind; they are loaded when a rig file has that kind, so that one that cannot be loaded stops no other rig.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, Literal, Protocol

from goniotwin.app.errors import UserError
from goniotwin.drivers.monitor.settings import MonitorDescription
from goniotwin.drivers.monochromator.settings import MonochromatorDescription
from goniotwin.drivers.photodiodes.description import ConverterDescription
from goniotwin.drivers.tap import Explain, as_text

if TYPE_CHECKING:  # the libraries of the buses are loaded when a rig is opened
    from goniotwin.app.rig.wires import Wires
    from goniotwin.drivers import Device, MotionController
    from goniotwin.drivers.device import PortOpener
    from goniotwin.drivers.motion import AxisTiming
    from goniotwin.protocols.clock import Clock
    from goniotwin.twin.plant import ControllerModel, DeviceModel

GROUP = "goniotwin.devices"
Role = Literal["axes", "monochromator", "photodiodes", "monitor"]
ROLES: tuple[Role, ...] = ("axes", "monochromator", "photodiodes", "monitor")
"""The devices of a rig, in the order in which they are listed. `axes` has one controller or several."""


Probe = tuple[str, Callable[["PortOpener", "Clock"], str]]
"""A name, and a function for the identity of the device at a serial port; nothing moves. It raises DeviceError."""


@dataclass(frozen=True)
class MotionKind:
    """A make of motion controllers.

    `controller` is the table of what a controller has beside `kind` and `port`, all of it with defaults, and `axis` that of
    one of its axes, an `AxisDescription`. With `kind` and `port` they make tables of the rig file: `axes` is `[axes]`, which
    extends `AxesTable[AnyAxis]` and the controller; `own_axis` is `[axes.NAME]` of an axis with a controller of its own, which
    extends the axis and the controller. `open` makes the driver, from the wires, its name, the controller's table and those
    of its axes; `timing` gives the durations of an axis' moves, from both tables. `check` raises ValueError for axes that
    contradict each other. `twins` are the tables of `[twin.controllers.NAME]`. `describe` gives such a table without axes, and
    the mechanics of each axis in `[twin.axes]`, for the rehearsal of a real rig; it appends what it assumes to a list. The
    `probes` are for `goniotwin devices`.
    """

    name: str
    controller: type[Any]
    axis: type[Any]
    axes: type[Any]
    own_axis: type[Any]
    open: Callable[["Wires", str, Any, Mapping[str, Any]], "MotionController"]
    timing: Callable[[Any, Any], "AxisTiming"]
    check: Callable[[Mapping[str, Any]], object] = len
    explain: Explain = as_text
    twins: "tuple[type[ControllerModel], ...]" = ()
    describe: Callable[[Any, Mapping[str, Any], list[str]], tuple[dict[str, Any], dict[str, dict[str, Any]]]] | None = None
    probes: tuple[Probe, ...] = ()
    role: Role = "axes"

    def __post_init__(self) -> None:
        if not getattr(self.axes, "__parameters__", ()):
            raise TypeError(f"axes: {self.axes.__name__} does not leave the type of its axes open; extend AxesTable[AnyAxis]")

    def check_axes(self, axes: Mapping[str, Any]) -> None:
        """Check the axes of a controller. Raises ValueError, also for any other exception of `check`."""
        try:
            self.check(axes)
        except ValueError:
            raise
        except Exception as error:
            wrong = f"the check of the kind {self.name!r} fails: {type(error).__name__}: {error}"
            raise ValueError(f"{wrong}; correct {', '.join(axes)}, or update the package of this kind") from error


@dataclass(frozen=True)
class DeviceKind:
    """A make of another device. `table` has its key `kind` and its address; `open` makes the driver from the wires and it.

    The table is a `MonochromatorEntry`, a `PhotodiodesEntry` or a `MonitorEntry`, and the driver has the methods of the first
    make: `Monochromator`, `PhotodiodeArray` or `Monitor`. `twins` are the tables of
    `[twin.devices.NAME]`, `probes` as in `MotionKind`.
    """

    role: Role
    name: str
    table: type[Any]
    open: Callable[["Wires", Any], "Device"]
    explain: Explain = as_text
    twins: "tuple[type[DeviceModel], ...]" = ()
    probes: tuple[Probe, ...] = ()


class MonochromatorEntry(MonochromatorDescription, Protocol):
    """The table of a monochromator of any `kind`; `port` is its address."""

    @property
    def kind(self) -> str: ...
    @property
    def port(self) -> str: ...


class PhotodiodesEntry(ConverterDescription, Protocol):
    """The table of photodiodes with converters of any `kind`; `units` are the addresses of the converters."""

    @property
    def kind(self) -> str: ...
    @property
    def units(self) -> tuple[str, ...]: ...


class MonitorEntry(MonitorDescription, Protocol):
    """The table of a monitor of any `kind`; `usb` is its address."""

    @property
    def kind(self) -> str: ...
    @property
    def usb(self) -> str: ...


Kind = MotionKind | DeviceKind
_registered: dict[tuple[Role, str], Kind] = {}


def register(kind: Kind) -> None:
    """Add a kind. Raises ValueError if its role has another kind of this name."""
    key = (kind.role, kind.name)
    if _registered.setdefault(key, kind) is not kind:
        raise ValueError(f"there is a kind {kind.name!r} of {kind.role} already")


def unregister(kind: Kind) -> None:
    """Remove a kind."""
    _registered.pop((kind.role, kind.name), None)


def kinds() -> tuple[Kind, ...]:
    """All kinds, in the order in which they were registered."""
    return tuple(_registered.values())


def motion_kind(name: str) -> MotionKind:
    """A make of motion controllers. Raises KeyError."""
    kind = _registered["axes", name]
    assert isinstance(kind, MotionKind)
    return kind


def device_kind(role: Role, name: str) -> DeviceKind:
    """A make of another device. Raises KeyError."""
    kind = _registered[role, name]
    assert isinstance(kind, DeviceKind)
    return kind


def load_plugins(content: Mapping[str, Any], name: str) -> None:
    """Load the installed plug-ins of the kinds in a rig file. Raises UserError with one that cannot be loaded.

    The kinds of `[twin]` come with those of the operator's part.
    """
    wanted = {(role, kind) for role in ROLES for kind in _kinds_in(content.get(role))} - _registered.keys()
    names = {kind for _, kind in wanted}
    for entry in entry_points(group=GROUP) if names else ():
        if entry.name in names and (fault := _load(entry)):
            raise UserError(f"{name}: {fault}; update or remove that package, or use another kind")


def load_all_plugins() -> list[str]:
    """Load all installed plug-ins. Returns a message for each that cannot be loaded."""
    return [fault for entry in entry_points(group=GROUP) if (fault := _load(entry))]


def unknown_kind(kind: str, role: Role | None, tables: Iterable[str]) -> str:
    """The message about a kind that is not known: of a role, or one of the twin's with these `tables`."""
    known, place = set(tables), "the twin's device"
    if role is not None:
        known, place = {name for each, name in _registered if each == role}, f"[{role}]"
        known |= {entry.name for entry in entry_points(group=GROUP) if _role(entry) in (role, None)}
    listed = " or ".join(map(repr, sorted(known))) or "none"
    return f"{kind!r} is not a known kind of device; for {place} give {listed}, or install the package that has this kind"


def _load(entry: EntryPoint) -> str | None:
    """Register a plug-in. Returns a message if it cannot be loaded."""
    try:
        register(_plugin(entry))
    except Exception as error:  # noqa: BLE001  (the code of another package)
        package = entry.dist.name if entry.dist is not None else entry.value
        wrong = f"{type(error).__name__}: {error}"
        return f"the device kind {entry.name!r} cannot be loaded from the package {package}: {wrong}"
    return None


def _plugin(entry: EntryPoint) -> Kind:
    kind = entry.load()
    if not isinstance(kind, MotionKind | DeviceKind):
        raise TypeError(f"it is a {type(kind).__name__}, neither a MotionKind nor a DeviceKind")
    if kind.name != entry.name:
        raise ValueError(f"the entry point {entry.name!r} has the kind {kind.name!r}; both need the same name")
    return kind


def _role(entry: EntryPoint) -> Role | None:
    """The role of a plug-in; None for one that cannot be loaded."""
    try:
        return _plugin(entry).role
    except Exception:  # noqa: BLE001  (the code of another package)
        return None


def _kinds_in(content: Any) -> Iterable[str]:
    if isinstance(content, Mapping):
        if isinstance(kind := content.get("kind"), str):
            yield kind
        for value in content.values():
            yield from _kinds_in(value)
