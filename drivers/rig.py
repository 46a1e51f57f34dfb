"""The rig: all devices of one goniophotometer, connected, asked, stopped together."""

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
class _Move:
    """An axis on its way, or arrived since `due`."""

    from_deg: float
    target_deg: float
    due: float


@dataclass
class Rig:
    """The devices. `axes` are by their names: gamma, sigma, beta, shift."""

    clock: Clock
    axes_module: TmclModule
    axes: dict[str, Axis]
    monochromator: Monochromator
    photodiodes: PhotodiodeArray
    monitor: Monitor
    simulated: bool
    clearance: ArcClearance | None = None
    identities: dict[str, str] = field(default_factory=dict)
    _moves: dict[str, "_Move"] = field(default_factory=dict)

    def connect(self) -> dict[str, DeviceError | None]:
        """Opens every device and writes its settings; nothing moves. What failed is told by device, and the rest works."""
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
        """Gives every wire back. Nothing moves."""
        for device in (self.axes_module, self.monochromator, self.photodiodes, self.monitor):
            with contextlib.suppress(DeviceError):
                device.close()

    def start(self, name: str, target_deg: float) -> Pending:
        """Sends an axis to an angle, if no other axis forbids it. Raises LimitError before anything is sent, DeviceError."""
        axis = self.axes[name]
        stops = self.axes_module.stop_count  # a stop from now on, whatever is just being asked, forbids the move
        if self.clearance is not None and name in ("beta", "shift"):
            axis.check_limits(axis.settings, target_deg)
            ways = {each: self._way(each) for each in ("beta", "shift")}
            ways[name] = (*ways[name], target_deg)
            reason = self.clearance.veto(ways["beta"], ways["shift"])
            if reason is not None:
                raise LimitError(name, f"move to {target_deg:g} deg", reason)
        way = self._moves.pop(name, None)  # until the move is sent nobody knows where the axis ends
        pending = axis.start(target_deg, stops)
        started_from = target_deg if way is None else way.target_deg
        self._moves[name] = _Move(started_from, target_deg, pending.arrival)
        return pending

    def _way(self, name: str) -> tuple[float, ...]:
        """Angles between which an axis may be: on its way, or at its last target, or where it says that it is."""
        move = self._moves.get(name)
        if move is None:
            axis = self.axes[name]
            if axis.is_moving():  # over its ramp after a stop, or sent by somebody else: nobody knows yet where it will rest
                raise LimitError(name, "say where it will be", "it still turns", "start again when it rests")
            here = axis.position_deg()
            self._moves[name] = _Move(here, here, self.clock.now())
            return (here,)
        return (move.target_deg,) if self.clock.now() >= move.due else (move.from_deg, move.target_deg)

    def stop(self) -> list[DeviceError]:
        """Has every axis come to rest over its ramp, then the grating, from any thread; returns what could not be told."""
        self._moves.clear()  # where the axes come to rest they have to be asked
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
        """Opens the axes' port anew and restores their settings; an axis whose module has reset is unreferenced then.

        Returns who answers. Nothing moves. Raises DeviceError.
        """
        self._moves.clear()
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
                "monitor", "ask who it is", f"{identity} is a simulated instrument, and the rig file does not say so",
                "give the rig file a [simulated] table, or connect the real instrument",
            )  # fmt: skip
        return identity
