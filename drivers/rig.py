"""The rig: all devices of one goniophotometer, connected, started and stopped together."""

import contextlib
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass, field

from goniotwin.drivers.device import Device, Identifiable
from goniotwin.drivers.errors import BadAnswer, DeviceError, FaultText, LimitError, NoAnswer, WrongDevice
from goniotwin.drivers.monitor.monitor import Monitor
from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.motion.axis import Axis, PendingMove
from goniotwin.drivers.motion.clearance import ArcClearance
from goniotwin.drivers.motion.controller import MotionController
from goniotwin.drivers.motion.stop import driver_failure, request_stop, stop_all
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from goniotwin.protocols.clock import Clock

LOG = logging.getLogger(__name__)
SIMULATED_SERIAL = "TWIN"
PLURAL = ("axes", PhotodiodeArray.name)
"""Names of devices that are more than one, in a sentence."""


@dataclass(frozen=True)
class _Path:
    """Path of a move of an axis; it has arrived since `due`, s."""

    from_deg: float
    target_deg: float
    due: float


@dataclass
class Rig:
    """The devices. `axes` are those of all controllers, with the keys gamma, sigma, beta and shift in this order."""

    clock: Clock
    controllers: tuple[MotionController, ...]
    axes: dict[str, Axis]
    monochromator: Monochromator
    photodiodes: PhotodiodeArray
    monitor: Monitor
    simulated: bool
    clearance: ArcClearance | None = None
    identities: dict[str, str] = field(default_factory=dict)
    _paths: dict[str, "_Path"] = field(default_factory=dict)
    _stopping: threading.RLock = field(default_factory=threading.RLock)

    @property
    def devices(self) -> tuple[Device, ...]:
        """All devices, in the order in which they are connected and listed."""
        return (*self.controllers, self.monochromator, self.photodiodes, self.monitor)

    def device(self, name: str) -> Device:
        """The device that an error names: by its name, or by one of its axes or modules. Raises KeyError."""
        for device in self.devices:
            if name == device.name or name in device.parts:
                return device
        raise KeyError(name)

    def plain_name(self, name: str) -> str:
        """A device, axis or module as an operator calls it: with its model, as far as that is known. `Axes (TMCM-6214)`."""
        model = ""
        with contextlib.suppress(KeyError):  # the driver of another package may name anything
            model = getattr(self.device(name), "model", "")
        called = f"axis {name}" if name in self.axes else name
        return f"{called[:1].upper()}{called[1:]}" + (f" ({model})" if model else "")

    def in_words(self, error: DeviceError) -> FaultText:
        """A fault of this rig for people."""
        return error.in_words(self.plain_name(error.device), plural=error.device in PLURAL)

    def controller(self, axis: str) -> MotionController:
        """The controller of an axis."""
        return next(each for each in self.controllers if axis in each.axes)

    def identify(self) -> dict[str, DeviceError | None]:
        """Open every device and read its identity; nothing is written. Returns the error, or None, of each device."""
        self.identities = {}
        return {
            each.name: self._open(each, each.identify if isinstance(each, Identifiable) else each.connect)
            for each in self.devices
        }

    def connect(self) -> dict[str, DeviceError | None]:
        """Open every device and write its settings; nothing moves. Returns the error, or None, of each device."""
        self.identities = {}
        return {device.name: self._open(device, device.connect) for device in self.devices}

    def connect_device(self, name: str) -> DeviceError | None:
        """Connect one device anew; nothing moves. Returns the error, or None. Raises KeyError for an unknown name."""
        device = self.device(name)
        if device in self.controllers:
            self._paths.clear()
        return self._open(device, device.connect)

    def close(self) -> None:
        """Close every device, with the settings that it was found with. Nothing moves."""
        for device in self.devices:
            with contextlib.suppress(DeviceError):
                device.close()
        LOG.info("closed: %s", ", ".join(device.name for device in self.devices))

    def start(self, name: str, target_deg: float) -> PendingMove:
        """Start a move of an axis, unless the arc would collide. Raises LimitError before anything is sent, DeviceError."""
        axis = self.axes[name]
        stop_count = self.controller(name).stop_count  # a stop from now on prevents the move
        if self.clearance is not None and name in ("beta", "shift"):
            axis.check_limits(target_deg)
            angles = {each: self._possible_angles(each) for each in ("beta", "shift")}
            angles[name] = (*angles[name], target_deg)
            collision = self.clearance.collision(angles["beta"], angles["shift"])
            if collision is not None:
                raise LimitError(name, f"move to {target_deg:g} deg", collision)
        path = self._paths.pop(name, None)  # until the move is sent the end of the path is unknown
        pending = axis.start(target_deg, stop_count)
        started_from = target_deg if path is None else path.target_deg
        self._paths[name] = _Path(started_from, target_deg, pending.arrival)
        return pending

    def _possible_angles(self, name: str) -> tuple[float, ...]:
        """Angles between which an axis may be: on its path, at its last target, or at its position. Raises DeviceError."""
        path = self._paths.get(name)
        if path is None:
            axis = self.axes[name]
            if axis.is_moving():  # on its ramp after a stop, or moved from elsewhere: where it will rest is unknown
                raise LimitError(name, "predict its position", "it is moving", "start again when it is at rest")
            here = axis.position_deg()
            self._paths[name] = _Path(here, here, self.clock.now())
            return (here,)
        return (path.target_deg,) if self.clock.now() >= path.due else (path.from_deg, path.target_deg)

    def stop(self) -> list[DeviceError]:
        """Stop every axis over its ramp, then the grating; return the failures. Thread-safe.

        The stop frames of each controller are on its wire within 200 ms, whatever the other controllers do.
        """
        self._paths.clear()  # the rest positions have to be read
        failures: list[DeviceError] = []

        def stop_the_rest() -> None:
            try:
                self.monochromator.stop()
            except Exception as error:  # noqa: BLE001  (the second attempt for the axes must follow)
                failures.append(driver_failure(self.monochromator.name, error))

        stops = {each.name: request_stop(each.begin_stop) for each in self.controllers}
        with self._stopping:  # two stops at once, each with one of two lines, would wait for each other
            return [*stop_all(stops, stop_the_rest), *failures]

    def reconnect(self, name: str) -> None:
        """Restore the connection of the device that an error names; an axis whose controller has reset becomes unreferenced.

        No other device is touched, and nothing moves. Raises DeviceError.
        """
        device = self.device(name)
        if device in self.controllers:
            self._paths.clear()
        device.reconnect()
        LOG.info("%s: reconnected", device.name)

    def _open(self, device: Device, action: Callable[[], str]) -> DeviceError | None:
        """`action` opens a device and returns its identity."""
        try:
            try:
                identity = action()
            except (NoAnswer, BadAnswer) as first:  # nothing moves: once more
                LOG.info("%s; trying again", first)
                identity = action()
            if SIMULATED_SERIAL in identity and not self.simulated:
                device.close()
                raise WrongDevice(
                    device.name,
                    "identify it",
                    f"{identity} is a simulated instrument, but the rig file has no [simulated] table",
                    "add a [simulated] table to the rig file, or connect the real instrument",
                )
        except DeviceError as error:
            LOG.info("%s: not connected: %s", device.name, error)
            return error
        LOG.info("%s: connected: %s", device.name, identity)
        self.identities[device.name] = identity
        return None
