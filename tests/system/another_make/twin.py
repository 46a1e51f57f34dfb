"""The controller's firmware on the plant of a virtual rig, and its table `[twin.controllers.NAME]`."""

from collections import deque
from dataclasses import dataclass
from typing import Literal

from goniotwin.twin.plant import Plant
from goniotwin.twin.plant.motion import Trajectory, ramp_to_target, ramp_to_velocity
from goniotwin.twin.plant.shaft import Shaft
from tests.system.another_make import protocol
from tests.system.another_make.protocol import EspCommand

COUNTS_PER_STEP = 100
DEFAULT_SPEED, DEFAULT_ACCELERATION = 1.0, 4.0


@dataclass(frozen=True, kw_only=True)
class EspModel:
    """A controller with its axes, numbered from 1 in this order."""

    kind: Literal["esp-301"]
    axes: tuple[str, ...]
    baudrate: int = 19200
    latency_s: float = 2.0e-3

    def build(self, plant: Plant) -> "EspDevice":
        """The device."""
        return EspDevice(plant, self)


class EspMotor:
    """One axis: its trajectory in counts, its volatile settings, and a search for the negative limit switch in progress."""

    def __init__(self, shaft: Shaft) -> None:
        self.shaft = shaft
        self.deg_per_count = shaft.mechanics.deg_per_full_step / COUNTS_PER_STEP
        self.reset(0.0)

    def reset(self, t: float) -> None:
        """Power-up: default settings, the counter is 0, and the shaft stays where it is."""
        self.values = {"VA": DEFAULT_SPEED, "AC": DEFAULT_ACCELERATION, "OH": DEFAULT_SPEED, "JW": protocol.JOG_AT_POWER_UP}
        self.trajectory: Trajectory = self.shaft.recount(t, 0.0, COUNTS_PER_STEP)
        self._search_end: float | None = None

    def is_moving(self, t: float) -> bool:
        """Whether the motor turns, or searches."""
        return self.trajectory.velocity(t) != 0.0 or t < self.trajectory.end

    def counter_deg(self, t: float) -> float:
        """The counter, in degrees from its zero."""
        return self.trajectory.position(t) * self.deg_per_count

    def catch_up(self, t: float) -> None:
        """At the end of a search the counter is 0."""
        if self._search_end is not None and t >= self._search_end:
            self.trajectory = self.shaft.recount(self._search_end, 0.0, COUNTS_PER_STEP)
            self._search_end = None

    def move(self, counts: float, speed_deg_s: float, t: float) -> None:
        """Move to a count."""
        speed, slope = (each / abs(self.deg_per_count) for each in (speed_deg_s, self.values["AC"]))
        position, velocity = self.trajectory.position(t), self.trajectory.velocity(t)
        self._follow(ramp_to_target(t, position, velocity, counts, speed, slope, slope), t)

    def search(self, t: float) -> None:
        """Search for the negative limit switch, which is at the switch's angle of the mechanics."""
        switch_deg = self.shaft.mechanics.lower_switch_deg
        assert switch_deg is not None
        angle = self.shaft.angle_deg(t)
        self.move(self.trajectory.position(t) + (switch_deg - angle) / self.deg_per_count, self.values["OH"], t)
        self._search_end = self.trajectory.end

    def stop(self, t: float) -> None:
        """Brake over the ramp; a search ends without result."""
        slope = self.values["AC"] / abs(self.deg_per_count)
        position, velocity = self.trajectory.position(t), self.trajectory.velocity(t)
        self._follow(ramp_to_velocity(t, position, velocity, 0.0, slope, slope), t)

    def define(self, degrees: float, t: float) -> None:
        """Set the counter of a motor at rest."""
        self.trajectory = self.shaft.recount(t, round(degrees / self.deg_per_count), COUNTS_PER_STEP)

    def _follow(self, trajectory: Trajectory, t: float) -> None:
        self._search_end = None
        self.trajectory = trajectory
        self.shaft.follow(t, trajectory)


class EspDevice:
    """The controller on its serial line."""

    def __init__(self, plant: Plant, model: EspModel) -> None:
        self.baudrate = model.baudrate
        self.outbox: deque[tuple[float, bytes]] = deque()
        self.motors = {number: EspMotor(plant.shafts[axis]) for number, axis in enumerate(model.axes, 1)}
        self._latency_s = model.latency_s
        self._rest = b""
        self._errors: deque[int] = deque()

    def receive(self, data: bytes, t: float) -> None:
        """Bytes of which the last has arrived at `t`."""
        *requests, self._rest = (self._rest + data).split(protocol.REQUEST_END)
        for request in requests:
            replies = [
                reply for text in request.decode("ascii", "replace").split(protocol.JOIN) for reply in self._answer(text, t)
            ]
            if replies:
                lines = b"".join(reply.encode("ascii") + protocol.REPLY_END for reply in replies)
                self.outbox.append((t + self._latency_s, lines))

    def reset(self, t: float) -> None:
        """The power was away for a moment."""
        self._rest = b""
        self._errors.clear()
        self.outbox.clear()
        for motor in self.motors.values():
            motor.reset(t)

    def _answer(self, text: str, t: float) -> list[str]:
        try:
            command = protocol.parse(text)
        except ValueError:
            self._errors.append(protocol.UNKNOWN_COMMAND)
            return []
        if command.axis == 0:
            if command.mnemonic == "VE":
                return ["ESP301 Version 3.09 virtual"]
            return [str(self._errors.popleft() if self._errors else protocol.NO_ERROR)] if command.mnemonic == "TE" else []
        motor = self.motors.get(command.axis)
        if motor is None:
            self._errors.append(protocol.NO_SUCH_AXIS)
            return []
        motor.catch_up(t)
        reply = self._execute(motor, command, t)
        return [] if reply is None else [f"{reply:.{protocol.DECIMALS}f}"]

    def _execute(self, motor: EspMotor, command: EspCommand, t: float) -> float | None:
        match command:
            case EspCommand(mnemonic="TP"):
                return motor.counter_deg(t)
            case EspCommand(mnemonic="MD", query=True):
                return float(not motor.is_moving(t))
            case EspCommand(mnemonic=("VA" | "AC" | "OH" | "JW") as name, query=True):
                return motor.values[name]
            case EspCommand(mnemonic=("VA" | "AC" | "OH" | "JW") as name, value=float(value)) if value > 0.0:
                motor.values[name] = value
            case EspCommand(mnemonic="PA", value=float(value)):
                motor.move(round(value / motor.deg_per_count), motor.values["VA"], t)
            case EspCommand(mnemonic="ST"):
                motor.stop(t)
            case EspCommand(mnemonic="OR"):
                motor.search(t)
            case EspCommand(mnemonic="DH", value=float(value)):
                if motor.is_moving(t):
                    self._errors.append(protocol.NOT_WHILE_MOVING)
                else:
                    motor.define(value, t)
            case _:
                self._errors.append(protocol.BAD_VALUE)
        return None
