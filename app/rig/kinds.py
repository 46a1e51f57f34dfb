"""Registry of device kinds: what a value of `kind` in a rig file stands for.

A kind names its table in the rig file (a frozen dataclass), its driver, and the tables of its twin devices. `register` adds a
kind. Kinds of installed packages come from the entry-point group `goniotwin.devices`, where the name of an entry point is the
kind; they are loaded when a rig file has that kind, so that one that cannot be loaded stops no other rig.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Annotated, Any, Literal, Protocol

from annotated_types import MinLen

from goniotwin.app.errors import UserError
from goniotwin.app.rig.addresses import is_network_port
from goniotwin.drivers.monitor.settings import MonitorDescription, MonitorSettings
from goniotwin.drivers.monochromator.settings import MonochromatorDescription, MonochromatorSettings
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.tmcl import TmclSettings, axis_timing, default_reply_timeout_s, exchange_seconds
from goniotwin.drivers.motion.tmcl import explain as explain_tmcl
from goniotwin.drivers.photodiodes.description import ConverterDescription
from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings
from goniotwin.drivers.tap import Explain, as_text
from goniotwin.keys import values_of
from goniotwin.protocols import adam
from goniotwin.twin.devices import FurtherTmclLine

if TYPE_CHECKING:  # the libraries of the buses are loaded when a rig is opened
    from goniotwin.app.rig.wires import Wires
    from goniotwin.drivers import Device, Monitor, Monochromator, MotionController, PhotodiodeArray, TmclController
    from goniotwin.drivers.device import PortOpener
    from goniotwin.drivers.motion import AxisTiming
    from goniotwin.protocols.clock import Clock
    from goniotwin.twin.plant import ControllerModel, DeviceModel

GROUP = "goniotwin.devices"
Role = Literal["axes", "monochromator", "photodiodes", "monitor"]
ROLES: tuple[Role, ...] = ("axes", "monochromator", "photodiodes", "monitor")
"""The devices of a rig, in the order in which they are listed. `axes` has one controller or several."""
SWITCHES_BEYOND_DEG = 1.0
NETWORK_REPLY_TIMEOUT_S = 0.25
"""Longest wait for a reply of axes behind a serial server: it and the network are late more often than a cable."""


Probe = tuple[str, Callable[["PortOpener", "Clock"], str]]
"""A name, and a function for the identity of the device at a serial port; nothing moves. It raises DeviceError."""


@dataclass(frozen=True)
class MotionKind:
    """A make of motion controllers.

    `controller` is the table of what a controller has beside `kind` and `port`, all of it with defaults, and `axis` that of
    one of its axes, an `AxisDescription`. `open` makes the driver, from the wires, its name, the controller's table and those
    of its axes; `timing` gives the durations of an axis' moves, from both tables. `check` raises ValueError for axes that
    contradict each other. `twins` are the tables of `[twin.controllers.NAME]`. `describe` gives such a table without axes, and
    the mechanics of each axis in `[twin.axes]`, for the rehearsal of a real rig; it appends what it assumes to a list. The
    `probes` are for `goniotwin devices`.
    """

    name: str
    controller: type[Any]
    axis: type[Any]
    open: Callable[["Wires", str, Any, Mapping[str, Any]], "MotionController"]
    timing: Callable[[Any, Any], "AxisTiming"]
    check: Callable[[Mapping[str, Any]], object] = len
    explain: Explain = as_text
    twins: "tuple[type[ControllerModel], ...]" = ()
    describe: Callable[[Any, Mapping[str, Any], list[str]], tuple[dict[str, Any], dict[str, dict[str, Any]]]] | None = None
    probes: tuple[Probe, ...] = ()
    role: Role = "axes"

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


# ---- the makes that the program has itself ----


@dataclass(frozen=True, kw_only=True)
class MonochromatorTable(MonochromatorSettings):
    """The monochromator of this `kind`, at the serial line `port`."""

    kind: Literal["cornerstone"]
    port: str


@dataclass(frozen=True, kw_only=True)
class PhotodiodesTable(PhotodiodeSettings):
    """The photodiodes and their converters; `units` are the addresses of the converter modules."""

    units: Annotated[tuple[str, ...], MinLen(1)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.units) != self.modules:
            wrong = f"{self.count} photodiodes need {self.modules} units of {adam.CHANNELS} channels, not {len(self.units)}"
            raise ValueError(f"{wrong}; correct units, upper_deg or lower_deg")


@dataclass(frozen=True, kw_only=True)
class MonitorTable(MonitorSettings):
    """The monitor of this `kind`, at the address `usb`."""

    kind: Literal["pm100d"]
    usb: str


def _open_tmcl(wires: "Wires", name: str, table: Any, axes: Mapping[str, AxisSettings]) -> "TmclController":
    from goniotwin.drivers import TmclController

    tap = wires.tap(name, explain_tmcl)
    opener, found = wires.serial(table.port), wires.found(table.port)
    settings = TmclSettings(**values_of(table, TmclSettings))
    if settings.reply_timeout_s is None and is_network_port(table.port):
        longest_s = max(NETWORK_REPLY_TIMEOUT_S, default_reply_timeout_s(settings.baudrate))
        settings = replace(settings, reply_timeout_s=longest_s)
    return TmclController(name, opener, wires.clock, settings, axes, tap, wires.session, found, wires.speed)


def _check_motors(axes: Mapping[str, AxisSettings]) -> None:
    """Raise ValueError for two axes of one motor."""
    wired: dict[tuple[int, int], str] = {}
    for name, axis in axes.items():
        other = wired.setdefault((axis.module, axis.motor), name)
        if other != name:
            wrong = f"{other} and {name} are both motor {axis.motor} of module {axis.module}"
            raise ValueError(f"{wrong}; correct one of them")


def _describe_tmcl(
    table: Any, axes: Mapping[str, AxisSettings], assumptions: list[str]
) -> tuple[dict[str, Any], dict[str, dict[str, Any]]]:
    """One module with six motors; for several module addresses, several modules on one bus."""
    several = len({axis.module for axis in axes.values()}) > 1
    single_motors = several and all(axis.motor == 0 for axis in axes.values())
    controller = {
        "kind": "tmcm-1240" if single_motors else "tmcm-6214",
        "wire": "rs485" if several else "usb",
        "baudrate": table.baudrate,
    }
    return controller, {name: _tmcl_mechanics(name, axis, assumptions) for name, axis in axes.items()}


def _tmcl_mechanics(name: str, axis: AxisSettings, assumptions: list[str]) -> dict[str, Any]:
    mechanics: dict[str, Any] = {
        "motor": axis.motor, "module": axis.module, "gear": axis.gear, "sense": axis.sense, "zero_deg": axis.zero_offset_deg,
        "full_steps": axis.full_steps, "encoder": axis.encoder, "backlash_deg": axis.backlash_deg,
    }  # fmt: skip
    if axis.encoder and axis.encoder_counts is not None:
        mechanics["encoder_counts"] = axis.encoder_counts
    if axis.switches:
        mechanics["lower_switch_deg"] = axis.lower_deg - SWITCHES_BEYOND_DEG
        mechanics["upper_switch_deg"] = axis.upper_deg + SWITCHES_BEYOND_DEG
        assumptions.append(f"{name}'s limit switches are {SWITCHES_BEYOND_DEG:g} deg beyond its soft limits")
    return mechanics


def _open_cornerstone(wires: "Wires", table: Any) -> "Monochromator":
    from goniotwin.drivers import Monochromator

    tap, found = wires.tap("monochromator", as_text), wires.found(table.port)
    return Monochromator(wires.serial(table.port), table, wires.clock, tap, found, wires.guard(table.port))


def _open_adam(wires: "Wires", table: Any) -> "PhotodiodeArray":
    from goniotwin.drivers import PhotodiodeArray

    units = [wires.modbus(address, f"photodiodes-{k}") for k, address in enumerate(table.units)]
    return PhotodiodeArray(units, table, wires.clock)


def _open_pm100d(wires: "Wires", table: Any) -> "Monitor":
    from goniotwin.drivers import Monitor

    tap, found = wires.tap("monitor", _explain_usbtmc), wires.found(table.usb)
    return Monitor(wires.usb(table.usb), table, wires.clock, tap, found)


def _explain_modbus(direction: str, data: bytes) -> str:
    from goniotwin.drivers.photodiodes.modbus import explain

    return explain(direction, data)


def _explain_usbtmc(direction: str, data: bytes) -> str:
    from goniotwin.drivers.usb.usbtmc import explain

    return explain(direction, data)


def _probe_tmcl(open_port: "PortOpener", clock: "Clock", baudrate: int) -> str:
    from goniotwin.drivers import TmclModule

    module = TmclModule(open_port, clock, baudrate)
    try:
        return f"TMCM-{module.identify()}"
    finally:
        module.close()


def _probe_cornerstone(open_port: "PortOpener", clock: "Clock") -> str:
    from goniotwin.drivers import Monochromator

    monochromator = Monochromator(open_port, MonochromatorSettings(), clock)
    try:
        return monochromator.identify()
    finally:
        monochromator.close()


OWN_KINDS: tuple[Kind, ...] = (
    MotionKind(
        "tmcl", controller=TmclSettings, axis=AxisSettings, open=_open_tmcl,
        timing=lambda controller, axis: axis_timing(axis, exchange_seconds(controller.baudrate)),
        check=_check_motors, explain=explain_tmcl, twins=(FurtherTmclLine,), describe=_describe_tmcl,
        probes=tuple((f"TMCL at {rate} Bd", partial(_probe_tmcl, baudrate=rate)) for rate in (115200, 9600)),
    ),
    DeviceKind(
        "monochromator", "cornerstone", MonochromatorTable, _open_cornerstone,
        probes=(("Cornerstone at 9600 Bd", _probe_cornerstone),),
    ),
    *(DeviceKind("photodiodes", model, PhotodiodesTable, _open_adam, _explain_modbus) for model in adam.MODELS),
    DeviceKind("monitor", "pm100d", MonitorTable, _open_pm100d, _explain_usbtmc),
)  # fmt: skip
for _kind in OWN_KINDS:
    register(_kind)
