"""One axis of a virtual motion module with its driver, on a wire that a test may break, without the rest of a rig."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from goniotwin.drivers import Axis, AxisSettings, TmclModule, wait
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.doors.protocol_twin import Serial
from goniotwin.twin.plant import AxisController, Mechanics, Plant, TwinModel

SIGMA = AxisSettings("sigma", 4, 36.0, -20.0, 190.0, 10.0, 20.0, power_up_at_reference=True)
NAMES = ("sigma", "beta", "gamma", "shift")


class DriverBench:
    """`sigma` (motor 4, gear 36) and, with `axes` more than 1, others like it at motors 5, 3, 0."""

    def __init__(
        self,
        settings: dict[str, Any] | None = None,
        mechanics: dict[str, Any] | None = None,
        *,
        axes: int = 1,
        clock: Clock | None = None,
        wire: Callable[[SerialDevice], SerialDevice] = lambda device: device,
        heartbeat_s: float = 2.0,
    ) -> None:
        self.clock = clock if clock is not None else VirtualClock()
        wired = dict(zip(NAMES[:axes], (4, 5, 3, 0), strict=False))
        own = {name: replace(Mechanics(motor, 36.0), **(mechanics or {})) for name, motor in wired.items()}
        self.plant = Plant(TwinModel(1, own, {}, controller=AxisController(encoder_noise_microsteps=0.0), noise=False))
        self.line = TmclLine(self.plant)
        self.device = wire(self.line)
        self.ports: list[Serial] = []
        self.module = TmclModule(self._open, self.clock, heartbeat_s=heartbeat_s)
        believed = replace(SIGMA, **(settings or {}))
        self.axes = {
            name: Axis(self.module, replace(believed, name=name, motor=motor), self.clock) for name, motor in wired.items()
        }
        self.axis = self.axes["sigma"]

    def _open(self, baudrate: int, timeout_s: float) -> Any:
        port = Serial(baudrate=baudrate, timeout=timeout_s)
        port.connect_to(self.device, self.clock)
        self.ports.append(port)
        return port

    def connect(self) -> "DriverBench":
        """Module and axes."""
        self.module.connect()
        for axis in self.axes.values():
            axis.connect()
        return self

    def next_process(self, **settings: Any) -> "DriverBench":
        """As a program begins that knows nothing of the one before; connected. The settings are changed."""
        self.module.close()
        self.module = TmclModule(self._open, self.clock, heartbeat_s=self.module.heartbeat_s)
        self.axes = {
            name: Axis(self.module, replace(axis.settings, **settings), self.clock) for name, axis in self.axes.items()
        }
        self.axis = self.axes["sigma"]
        return self.connect()

    def move(self, angle_deg: float) -> None:
        """The axis to an angle."""
        wait(self.clock, [self.axis.start(angle_deg)])

    def angle(self) -> float:
        """The truth."""
        return self.plant.angle_deg("sigma", self.clock.now())

    def keep(self, pending: Any, seconds: float) -> None:
        """Polls a move as it wants to be for a while."""
        until = self.clock.now() + seconds
        while pending.due < until:
            self.clock.sleep_until(pending.due)
            assert not pending.poll()
        self.clock.sleep_until(until)
