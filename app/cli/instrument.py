"""Which ports there are, and who answers on them: asked by name only, so that nothing moves.

Saying where the axes are: by their reference searches, or by somebody who has looked.

The commands that say where the axes are: `goniotwin home` and `goniotwin here`.
"""

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import serial
import typer
import usb.core
from rich.console import Console
from serial.tools import list_ports

from goniotwin.app.campaign.campaign import clock_for
from goniotwin.app.errors import UserError
from goniotwin.app.rig import AXES, RigDescription, open_rig, read_rig
from goniotwin.app.rig.lock import RigLock
from goniotwin.drivers import Axis, DeviceError, Monochromator, MonochromatorSettings, Rig, TmclModule, wait
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.usbtmc import INTERFACE_CLASS

AXES_BAUDRATES = (115200, 9600)
OF_A_RIG = "rig"


@dataclass(frozen=True)
class Found:
    """A place where a device may be, who answers there, and if nobody does, what was tried."""

    bus: str
    address: str
    answers: str | None
    tried: str = ""

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {"bus": self.bus, "address": self.address, "answers": self.answers, "tried": self.tried}


def found_devices(rig: Path | None) -> list[Found]:
    """Of a rig file, or of this computer. Raises UserError."""
    if rig is None:
        return of_computer(RealClock())
    description = read_rig(rig)
    return of_rig(description, VirtualClock() if description.file.twin is not None else RealClock())


def in_words(found: list[Found]) -> str:
    """A line each, for people."""
    if not found:
        return "no serial port and no USB instrument; Modbus modules have no list, so name a rig with --rig"
    return "\n".join(f"{each.bus:7}{each.address or '-':24}{each.answers or f'no answer ({each.tried})'}" for each in found)


def exit_status(found: list[Found]) -> int:
    """1 when a device of a rig file does not answer. That nobody answers on some port of this computer is no fault."""
    return int(any(each.bus == OF_A_RIG and each.tried for each in found))


def of_rig(rig: RigDescription, clock: Clock) -> list[Found]:
    """The devices of a rig file. Raises UserError where another program has the rig."""
    with open_rig(rig, clock) as opened:
        outcome = opened.rig.connect()
        return [
            Found(OF_A_RIG, device, opened.rig.identities.get(device), "" if error is None else str(error))
            for device, error in outcome.items()
        ]


def of_computer(clock: Clock) -> list[Found]:
    """Serial ports and USB instruments of this computer."""
    return [*_serial_ports(clock), *_usb_instruments()]


def _serial_ports(clock: Clock) -> Iterator[Found]:
    for port in sorted(list_ports.comports()):
        try:
            lock = RigLock([port.device], "goniotwin devices")
        except UserError as error:
            yield Found("serial", port.device, None, str(error))
            continue
        try:
            yield _who_is_at(port.device, clock)
        finally:
            lock.release()


def _who_is_at(device: str, clock: Clock) -> Found:
    tried = []
    probes: list[tuple[str, Callable[[], str]]] = [
        *((f"TMCL at {rate} Bd", _tmcl(device, rate, clock)) for rate in AXES_BAUDRATES),
        ("Cornerstone at 9600 Bd", _cornerstone(device, clock)),
    ]
    for name, probe in probes:
        try:
            return Found("serial", device, probe())
        except DeviceError as error:
            tried.append(f"{name}: {error.happened}")
    return Found("serial", device, None, "; ".join(tried))


def _open(device: str) -> Callable[[int, float], serial.Serial]:
    return lambda baudrate, timeout_s: serial.serial_for_url(device, baudrate=baudrate, timeout=timeout_s)


def _tmcl(device: str, baudrate: int, clock: Clock) -> Callable[[], str]:
    def ask() -> str:
        module = TmclModule(_open(device), clock, baudrate)
        try:
            return f"TMCM-{module.identify()}"
        finally:
            module.close()

    return ask


def _cornerstone(device: str, clock: Clock) -> Callable[[], str]:
    def ask() -> str:
        monochromator = Monochromator(_open(device), MonochromatorSettings(), clock)
        try:
            return monochromator.connect()
        finally:
            monochromator.close()

    return ask


def _usb_instruments() -> Iterator[Found]:
    import libusb_package

    try:
        backend = libusb_package.get_libusb1_backend()
        devices = list(usb.core.find(find_all=True, backend=backend, custom_match=_is_instrument))
    except (usb.core.NoBackendError, usb.core.USBError) as error:
        yield Found("usb", "", None, str(error))
        return
    for device in devices:
        address = f"{device.idVendor:04x}:{device.idProduct:04x}"
        try:
            yield Found("usb", f"{address}:{device.serial_number}", f"{device.manufacturer} {device.product}")
        except (usb.core.USBError, ValueError) as error:
            yield Found("usb", address, None, f"{error}; see that its driver lets this program in")


def _is_instrument(device: Any) -> bool:
    try:
        return any(
            (each.bInterfaceClass, each.bInterfaceSubClass) == INTERFACE_CLASS
            for configuration in device
            for each in configuration
        )
    except usb.core.USBError:
        return False


Say = Callable[[str], None]


def home_axes(path: Path, names: list[str], say: Say) -> None:
    """Homes axes one after the other, all that have a [homing] table where none is named.

    Raises UserError before anything moves, DeviceError after; the axes are at rest then.
    """
    file = read_rig(path).file
    for name in names:
        _known(path, name)
        if getattr(file.axes, name).homing is None:
            raise UserError(
                f"{path}: axes.{name}: has no [axes.{name}.homing] table; add it, or say where the axis is: "
                f"goniotwin here --rig {path} {name} DEG"
            )
    chosen = [name for name in AXES if (name in names if names else getattr(file.axes, name).homing is not None)]
    if not chosen:
        raise UserError(
            f"{path}: no axis has a [homing] table; add them, or say where each axis is: goniotwin here --rig {path} AXIS DEG"
        )
    with _connected(path) as rig:
        for name in chosen:
            _home(rig, rig.axes[name])
            astray = rig.axes[name].last_reference_deg
            told = "" if astray is None else f" (its reference was at {astray:.3f} deg by the old counter)"
            say(f"{name}: homed, at {rig.axes[name].position_deg():.3f} deg{told}")


def state_place(path: Path, name: str, angle_deg: float, say: Say) -> None:
    """Somebody says that an axis stands at an angle: nothing moves. Raises UserError, DeviceError."""
    _known(path, name)
    with _connected(path) as rig:
        axis = rig.axes[name]
        limits = axis.settings
        if not limits.lower_deg <= angle_deg <= limits.upper_deg:
            raise UserError(
                f"{path}: {name} has soft limits of {limits.lower_deg:g} to {limits.upper_deg:g} deg, and "
                f"{angle_deg:g} deg is outside; turn it back by hand, or change the limits"
            )
        axis.set_position(angle_deg)
        say(f"{name}: is at {axis.position_deg():.3f} deg, as you say")


def _known(path: Path, name: str) -> None:
    if name not in AXES:
        raise UserError(f"{path}: {name!r} is no axis; there are {', '.join(AXES)}")


@contextmanager
def _connected(path: Path) -> Iterator[Rig]:
    """A rig of which the axes are connected, and nobody else has it."""
    description = read_rig(path)
    with open_rig(description, clock_for(description.file)) as opened:
        try:
            opened.rig.reconnect_axes()
        except DeviceError as error:
            raise UserError(str(error)) from None
        yield opened.rig


def _home(rig: Rig, axis: Axis) -> None:
    try:
        wait(rig.clock, [axis.start_homing()])
    except (DeviceError, KeyboardInterrupt):
        rig.stop()
        raise


RigOption = Annotated[Path, typer.Option("--rig", metavar="RIG.toml", help="Where the devices are.", show_default=False)]
AxisArgument = Annotated[str, typer.Argument(metavar="AXIS", help="gamma, sigma, beta or shift.", show_default=False)]
errors = Console(stderr=True, highlight=False, soft_wrap=True)


def add_axes_commands(app: typer.Typer) -> None:
    """Registers them."""
    app.command()(home)
    app.command(context_settings={"ignore_unknown_options": True})(here)  # -10 is an angle


def home(
    rig: RigOption,
    axes: Annotated[
        list[str] | None, typer.Argument(metavar="[AXIS ...]", help="All that can, if none is named.", show_default=False)
    ] = None,
) -> None:
    """Have axes look for their references, one after the other: they move.

    Only axes with a [homing] table in the rig file can. Ends with status 0 when all are homed, 1 after a fault; Ctrl-C stops
    the axes.
    """

    with _faults_are_status_1():
        home_axes(rig, list(axes or []), print)


def here(
    rig: RigOption,
    axis: AxisArgument,
    angle: Annotated[float, typer.Argument(metavar="DEG", help="Where it stands.", show_default=False)],
) -> None:
    """Say that an axis stands at an angle: somebody has looked. Nothing moves."""

    with _faults_are_status_1():
        state_place(rig, axis, angle, print)


@contextlib.contextmanager
def _faults_are_status_1() -> Iterator[None]:
    from goniotwin.drivers import DeviceError

    try:
        yield
    except DeviceError as error:
        errors.print(f"goniotwin: {error}", style="red", markup=False)
        raise typer.Exit(1) from None
