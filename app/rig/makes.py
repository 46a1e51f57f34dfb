"""The makes of devices that the program has itself: their tables, their drivers and their twin devices."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, Literal

from annotated_types import MinLen

from goniotwin.app.rig.addresses import is_network_port
from goniotwin.app.rig.axes import AnyAxis, AxesTable
from goniotwin.app.rig.kinds import DeviceKind, Kind, MotionKind, register
from goniotwin.drivers import TmclController, TmclModule, monochromator
from goniotwin.drivers.monitor.settings import MonitorSettings
from goniotwin.drivers.monochromator.settings import MonochromatorSettings
from goniotwin.drivers.motion.settings import AxisSettings
from goniotwin.drivers.motion.tmcl import TmclSettings, axis_timing, default_reply_timeout_s, exchange_seconds
from goniotwin.drivers.motion.tmcl import explain as explain_tmcl
from goniotwin.drivers.photodiodes.settings import PhotodiodeSettings
from goniotwin.drivers.tap import as_text
from goniotwin.keys import values_of
from goniotwin.protocols import adam
from goniotwin.twin.devices import FurtherTmclLine

if TYPE_CHECKING:  # the libraries of the buses are loaded when a rig is opened
    from goniotwin.app.rig.wires import Wires
    from goniotwin.drivers import Monitor, PhotodiodeArray
    from goniotwin.drivers.device import PortOpener
    from goniotwin.protocols.clock import Clock

DEFAULT_KIND = "tmcl"
"""The kind of the controller of `[axes]`, where it has none."""
SWITCHES_BEYOND_DEG = 1.0
NETWORK_REPLY_TIMEOUT_S = 0.25
"""Longest wait for a reply of axes behind a serial server: it and the network are late more often than a cable."""


@dataclass(frozen=True, kw_only=True)
class MonochromatorTable(MonochromatorSettings):
    """The monochromator, at a serial line.

    `kind`: model of the monochromator: a Newport Cornerstone. `port`: its serial line, such as "/dev/ttyUSB0" or "COM4".
    """

    kind: Literal["cornerstone"]
    port: str


@dataclass(frozen=True, kw_only=True)
class PhotodiodesTable(PhotodiodeSettings):
    """The photodiodes and their converters.

    `units`: addresses of the converter modules, one for each eight channels: "HOST:PORT" for Modbus TCP, "rtu:PORT?unit=3" for
    Modbus RTU.
    """

    units: Annotated[tuple[str, ...], MinLen(1)]

    def __post_init__(self) -> None:
        super().__post_init__()
        if len(self.units) != self.modules:
            wrong = f"{self.count} photodiodes need {self.modules} units of {adam.CHANNELS} channels, not {len(self.units)}"
            raise ValueError(f"{wrong}; correct units, upper_deg or lower_deg")


@dataclass(frozen=True, kw_only=True)
class MonitorTable(MonitorSettings):
    """The monitor, on USB.

    `kind`: model of the instrument: a Thorlabs PM100D. `usb`: its vendor, product and serial number, such as
    "1313:8078:P0012345".
    """

    kind: Literal["pm100d"]
    usb: str


@dataclass(frozen=True, kw_only=True)
class TmclAxesTable(AxesTable[AnyAxis], TmclSettings):
    """Axes that Trinamic modules turn; each of them may have a controller of its own instead.

    `kind`: kind of the controller of all axes without one of their own: Trinamic modules. `port`: serial line of this
    controller.
    """

    kind: Literal["tmcl"]
    port: str


@dataclass(frozen=True, kw_only=True)
class TmclAxisTable(AxisSettings, TmclSettings):
    """An axis with a motion controller of its own.

    `kind`: kind of this controller: Trinamic modules. `port`: serial line of this controller.
    """

    kind: Literal["tmcl"]
    port: str


def _open_tmcl(wires: "Wires", name: str, table: Any, axes: Mapping[str, AxisSettings]) -> "TmclController":
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
        "motor": axis.motor,
        "module": axis.module,
        "gear": axis.gear,
        "sense": axis.sense,
        "zero_deg": axis.zero_offset_deg,
        "full_steps": axis.full_steps,
        "encoder": axis.encoder,
        "backlash_deg": axis.backlash_deg,
    }
    if axis.encoder and axis.encoder_counts is not None:
        mechanics["encoder_counts"] = axis.encoder_counts
    if axis.switches:
        mechanics["lower_switch_deg"] = axis.lower_deg - SWITCHES_BEYOND_DEG
        mechanics["upper_switch_deg"] = axis.upper_deg + SWITCHES_BEYOND_DEG
        assumptions.append(f"{name}'s limit switches are {SWITCHES_BEYOND_DEG:g} deg beyond its soft limits")
    return mechanics


def _open_cornerstone(wires: "Wires", table: Any) -> "monochromator.Monochromator":
    tap, found = wires.tap("monochromator", as_text), wires.found(table.port)
    return monochromator.Monochromator(wires.serial(table.port), table, wires.clock, tap, found, wires.guard(table.port))


def _open_adam(wires: "Wires", table: Any) -> "PhotodiodeArray":
    # The libraries of the buses, pymodbus and usb, load some 90 modules: 70 ms, which `check` does without; below as well.
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
    from goniotwin.drivers.usb.control_endpoint import explain

    return explain(direction, data)


def _probe_tmcl(open_port: "PortOpener", clock: "Clock", baudrate: int) -> str:
    module = TmclModule(open_port, clock, baudrate)
    try:
        return f"TMCM-{module.identify()}"
    finally:
        module.close()


def _probe_cornerstone(open_port: "PortOpener", clock: "Clock") -> str:
    device = monochromator.Monochromator(open_port, MonochromatorSettings(), clock)
    try:
        return device.identify()
    finally:
        device.close()


OWN_KINDS: tuple[Kind, ...] = (
    MotionKind(
        "tmcl",
        controller=TmclSettings,
        axis=AxisSettings,
        axes=TmclAxesTable,
        own_axis=TmclAxisTable,
        open=_open_tmcl,
        timing=lambda controller, axis: axis_timing(axis, exchange_seconds(controller.baudrate)),
        check=_check_motors,
        explain=explain_tmcl,
        twins=(FurtherTmclLine,),
        describe=_describe_tmcl,
        probes=tuple((f"TMCL at {rate} Bd", partial(_probe_tmcl, baudrate=rate)) for rate in (115200, 9600)),
    ),
    DeviceKind(
        "monochromator",
        "cornerstone",
        MonochromatorTable,
        _open_cornerstone,
        probes=(("Cornerstone at 9600 Bd", _probe_cornerstone),),
    ),
    *(DeviceKind("photodiodes", model, PhotodiodesTable, _open_adam, _explain_modbus) for model in adam.MODELS),
    DeviceKind("monitor", "pm100d", MonitorTable, _open_pm100d, _explain_usbtmc),
)
for _kind in OWN_KINDS:
    register(_kind)
