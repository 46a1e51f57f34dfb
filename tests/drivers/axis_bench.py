"""Test bench: axes of a virtual motion module with their drivers, on a wire that a test may replace."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from goniotwin.drivers import AxisSettings, TmclAxis, TmclModule, wait
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.devices.line import SerialDevice
from goniotwin.twin.doors.protocol_twin import Serial
from goniotwin.twin.plant import AxisController, Mechanics, Plant, TwinModel

SIGMA = AxisSettings(4, 36.0, -20.0, 190.0, 10.0, 20.0, power_up_at_reference=True)
NAMES = ("sigma", "beta", "gamma", "shift")


class AxisBench:
    """Axis `sigma` (motor 4, gear 36) and, with `axes` > 1, equal axes at motors 5, 3 and 0."""

    def __init__(
        self,
        settings: dict[str, Any] | None = None,
        mechanics: dict[str, Any] | None = None,
        *,
        axes: int = 1,
        clock: Clock | None = None,
        wire: Callable[[SerialDevice], SerialDevice] = lambda device: device,
        heartbeat_s: float = 2.0,
        reply_timeout_s: float | None = None,
    ) -> None:
        self.clock = clock if clock is not None else VirtualClock()
        motors = dict(zip(NAMES[:axes], (4, 5, 3, 0), strict=False))
        mechanics_by_name = {name: replace(Mechanics(motor, 36.0), **(mechanics or {})) for name, motor in motors.items()}
        self.plant = Plant(
            TwinModel(1, mechanics_by_name, {}, controller=AxisController(encoder_noise_microsteps=0.0), noise=False)
        )
        self.line = TmclLine(self.plant)
        self.device = wire(self.line)
        self.ports: list[Serial] = []
        self.module = TmclModule(self.open_port, self.clock, heartbeat_s=heartbeat_s, reply_timeout_s=reply_timeout_s)
        axis_settings = replace(SIGMA, **(settings or {}))
        self.axes = {
            name: TmclAxis(name, self.module, replace(axis_settings, motor=motor), self.clock) for name, motor in motors.items()
        }
        self.axis = self.axes["sigma"]

    def open_port(self, baudrate: int, timeout_s: float) -> Any:
        port = Serial(baudrate=baudrate, timeout=timeout_s)
        port.connect_to(self.device, self.clock)
        self.ports.append(port)
        return port

    def connect(self) -> "AxisBench":
        """Connect module and axes."""
        self.module.connect()
        for axis in self.axes.values():
            axis.connect()
        return self

    def next_process(self, **settings: Any) -> "AxisBench":
        """New drivers with changed settings on the same module, as in the next process; connected."""
        self.module.close()
        self.module = TmclModule(self.open_port, self.clock, heartbeat_s=self.module.heartbeat_s)
        self.axes = {
            name: TmclAxis(name, self.module, replace(axis.settings, **settings), self.clock)
            for name, axis in self.axes.items()
        }
        self.axis = self.axes["sigma"]
        return self.connect()

    def move(self, angle_deg: float) -> None:
        """Move the axis to an angle."""
        wait(self.clock, [self.axis.start(angle_deg)])

    def angle(self) -> float:
        """True angle of the axis, degrees."""
        return self.plant.angle_deg("sigma", self.clock.now())

    def poll_for(self, pending: Any, seconds: float) -> None:
        """Poll a move for some seconds, each time it is due."""
        until = self.clock.now() + seconds
        while pending.due < until:
            self.clock.sleep_until(pending.due)
            assert not pending.poll()
        self.clock.sleep_until(until)
