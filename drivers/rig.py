"""The rig: all devices of one goniophotometer, connected, started and stopped together."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

from goniotwin.drivers.device import Pending
from goniotwin.drivers.errors import BadAnswer, DeviceError, LimitError
from goniotwin.drivers.monitor.monitor import Monitor
from goniotwin.drivers.monochromator.monochromator import Monochromator
from goniotwin.drivers.motion.axis import Axis
from goniotwin.drivers.motion.clearance import ArcClearance
from goniotwin.drivers.motion.tmcl.module import TmclModule
from goniotwin.drivers.photodiodes.array import PhotodiodeArray
from goniotwin.protocols.clock import Clock

SIMULATED_SERIAL = "TWIN"


@dataclass(frozen=True)
class _Path:
    """Path of a move of an axis; it has arrived since `due`, s."""

    from_deg: float
    target_deg: float
    due: float


@dataclass
class Rig:
    """The devices. `axes` have the keys gamma, sigma, beta and shift."""

    clock: Clock
    axes_module: TmclModule
    axes: dict[str, Axis]
    monochromator: Monochromator
    photodiodes: PhotodiodeArray
    monitor: Monitor
    simulated: bool
    clearance: ArcClearance | None = None
    identities: dict[str, str] = field(default_factory=dict)
    _paths: dict[str, "_Path"] = field(default_factory=dict)

    def connect(self) -> dict[str, DeviceError | None]:
        """Open every device and write its settings; nothing moves. Returns the error, or None, of each device."""
        self.identities = {}
        outcome: dict[str, DeviceError | None] = {}
        for device, connect in (
            ("axes", self._connect_axes),
            ("monochromator", self.monochromator.connect),
            ("photodiodes", lambda: f"{len(self.photodiodes.connect())} modules {self.photodiodes.settings.model.title}"),
            ("monitor", self._connect_monitor),
        ):
            outcome[device] = self._attempt(device, connect)
        return outcome

    def close(self) -> None:
        """Close every device. Nothing moves."""
        for device in (self.axes_module, self.monochromator, self.photodiodes, self.monitor):
            with contextlib.suppress(DeviceError):
                device.close()

    def start(self, name: str, target_deg: float) -> Pending:
        """Start a move of an axis, unless the arc would collide. Raises LimitError before anything is sent, DeviceError."""
        axis = self.axes[name]
        stop_count = self.axes_module.stop_count  # a stop from now on prevents the move
        if self.clearance is not None and name in ("beta", "shift"):
            axis.check_limits(axis.settings, target_deg)
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
        """Stop every axis over its ramp, then the grating; return the failures. Thread-safe."""
        self._paths.clear()  # the rest positions have to be read
        requests = [each for axis in self.axes.values() for each in axis.stop_requests()]
        failures: list[DeviceError] = []

        def stop_the_rest() -> None:
            try:
                self.monochromator.stop()
            except DeviceError as error:
                failures.append(error)

        return [*self.axes_module.stop(requests, stop_the_rest), *failures]

    def _attempt(self, device: str, connect: Callable[[], str]) -> DeviceError | None:
        try:
            self.identities[device] = connect()
        except DeviceError as error:
            return error
        return None

    def reconnect_axes(self) -> str:
        """Open the axes' port again and restore their settings; an axis whose module has reset becomes unreferenced.

        Returns the identity. Nothing moves. Raises DeviceError.
        """
        self._paths.clear()
        return self._connect_axes()

    def _connect_axes(self) -> str:
        module = self.axes_module.connect()
        for axis in self.axes.values():
            axis.connect()
        return f"TMCM-{module}"

    def _connect_monitor(self) -> str:
        identity = self.monitor.connect()
        if SIMULATED_SERIAL in identity and not self.simulated:
            self.monitor.close()
            raise BadAnswer(
                "monitor", "identify it", f"{identity} is a simulated instrument, but the rig file has no [simulated] table",
                "add a [simulated] table to the rig file, or connect the real instrument",
            )  # fmt: skip
        return identity
