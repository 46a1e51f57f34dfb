"""The rig: all devices of one goniophotometer, connected, asked, stopped together."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, field

from drivers.axis import Axis
from drivers.errors import BadAnswer, DeviceError
from drivers.monitor import Monitor
from drivers.monochromator import Monochromator
from drivers.photodiodes import PhotodiodeArray
from drivers.tmcl import TmclModule
from protocols.clock import Clock

SIMULATED_SERIAL = "TWIN"


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
    identities: dict[str, str] = field(default_factory=dict)

    def connect(self) -> dict[str, DeviceError | None]:
        """Opens every device and writes its settings; nothing moves. What failed is told by device, and the rest works."""
        self.identities = {}
        outcome: dict[str, DeviceError | None] = {}
        for device, connect in (
            ("axes", self._connect_axes),
            ("monochromator", self.monochromator.connect),
            ("photodiodes", lambda: f"{len(self.photodiodes.connect())} modules ADAM-6017"),
            ("monitor", self._connect_monitor),
        ):
            outcome[device] = self._attempt(device, connect)
        return outcome

    def close(self) -> None:
        """Gives every wire back. Nothing moves."""
        for device in (self.axes_module, self.monochromator, self.photodiodes, self.monitor):
            with contextlib.suppress(DeviceError):
                device.close()

    def stop(self) -> list[DeviceError]:
        """Has every axis come to rest over its ramp, from any thread; returns what could not be told to its axis."""
        failures = []
        for axis in self.axes.values():
            try:
                axis.stop()
            except DeviceError as error:
                failures.append(error)
        return failures

    def _attempt(self, device: str, connect: Callable[[], str]) -> DeviceError | None:
        try:
            self.identities[device] = connect()
        except DeviceError as error:
            return error
        return None

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
