"""Driver of the controller: its line, its axes, its tables in the rig file, and its registration."""

import contextlib
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from serial import Serial, SerialException

from goniotwin.app.rig.axes import AnyAxis, AxesTable
from goniotwin.app.rig.kinds import MotionKind
from goniotwin.app.rig.wires import Wires
from goniotwin.arrays import Floats
from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer
from goniotwin.drivers.device import Poll, PortOpener
from goniotwin.drivers.errors import Interrupted, Unreferenced
from goniotwin.drivers.motion import AxisTiming, StopLock, StopPhase, StopSteps, check_limits
from goniotwin.drivers.motion.settings import move_seconds
from goniotwin.drivers.tap import FROM_DEVICE, TO_DEVICE, Tap, as_text
from goniotwin.protocols.clock import Clock
from tests.system.another_make import protocol
from tests.system.another_make.protocol import EspCommand
from tests.system.another_make.twin import EspModel

SLICE_S, PATIENCE_S, TIMEOUT_S = 0.01, 0.03, 0.15
POLL_S, ARRIVED_AFTER_S, LATENCY_S = 0.05, 0.005, 2.0e-3
REFERENCED, UNREFERENCED = 0.125, 0.25
"""The jog speed is not used: its value marks whether the axis is referenced. After a power-up it has neither value."""
PORT_FAULTS = (SerialException, OSError)


@dataclass(frozen=True, kw_only=True)
class EspSettings:
    """A controller: the speed of its line."""

    baudrate: int = 19200


@dataclass(frozen=True, kw_only=True)
class EspHoming:
    """A search for the negative limit switch, which is at `angle_deg`."""

    speed_deg_s: float
    angle_deg: float
    longest_s: float = 60.0


@dataclass(frozen=True, kw_only=True)
class EspAxisSettings:
    """An axis by its number at the controller; the counter's zero is at `zero_offset_deg`."""

    number: int
    lower_deg: float
    upper_deg: float
    speed_deg_s: float
    acceleration_deg_s2: float
    settling_s: float = 0.1
    zero_offset_deg: float = 0.0
    homing: EspHoming | None = None
    homing_required: bool = False
    power_up_at_reference: bool = False

    encoder, backlash_deg, overshoot_deg = False, 0.0, 0.0
    approach_from: Literal["below"] = "below"


@dataclass(frozen=True, kw_only=True)
class EspAxesTable(AxesTable[AnyAxis], EspSettings):
    """`[axes]` with such a controller for all axes that have none of their own."""

    kind: Literal["esp"]
    port: str


@dataclass(frozen=True, kw_only=True)
class EspAxisTable(EspAxisSettings, EspSettings):
    """`[axes.NAME]` of an axis with such a controller of its own."""

    kind: Literal["esp"]
    port: str


def axis_timing(controller: EspSettings, axis: EspAxisSettings) -> AxisTiming:
    """The durations of an axis' moves."""
    start = protocol.encode(*EspAxis.start_commands(axis, axis.upper_deg))
    reading = protocol.encode(*EspAxis.reading_commands(axis))

    def exchange_s(request: bytes, replies: int) -> float:
        return 10.0 * (len(request) + 9.0 * replies) / controller.baudrate + LATENCY_S

    def travel_seconds(start_deg: Floats, stop_deg: Floats) -> Floats:
        distance = stop_deg - np.where(np.isnan(start_deg), axis.zero_offset_deg, start_deg)
        return move_seconds(distance, axis.speed_deg_s, axis.acceleration_deg_s2) + ARRIVED_AFTER_S

    read_s, arrived_s = exchange_s(reading, 2), exchange_s(protocol.encode(EspCommand(axis.number, "MD", query=True)), 1)
    return AxisTiming(
        starting_s=read_s + exchange_s(start, 1),
        ending_s=arrived_s + read_s,
        settling_s=axis.settling_s,
        read_back_s=read_s,
        approach=0,
        travel_seconds=travel_seconds,
    )


class EspLine:
    """The serial line of a controller: one exchange at a time, and a stop before everything else."""

    def __init__(self, name: str, open_port: PortOpener, clock: Clock, baudrate: int, tap: Tap) -> None:
        self.name, self.lock = name, StopLock()
        self._open_port, self._clock, self._baudrate, self._tap = open_port, clock, baudrate, tap
        self._port: Serial | None = None

    def open(self) -> None:
        """Open the port. Raises DeviceError."""
        self.close()
        with self.lock.hold():
            try:
                self._port = self._open_port(self._baudrate, SLICE_S)
                self._port.write_timeout = TIMEOUT_S
            except (*PORT_FAULTS, ValueError) as error:
                raise DeviceError(self.name, "open the port", str(error), "check the port in the rig file") from None

    def close(self) -> None:
        """Close the port."""
        port, self._port = self._port, None
        if port is not None:
            with contextlib.suppress(*PORT_FAULTS):
                port.close()

    def exchange(self, *commands: EspCommand, stop_count: int | None = None) -> list[str]:
        """Send a request; return the lines of its replies. Raises NoAnswer, and Interrupted after a newer stop."""
        request, lines = protocol.encode(*commands), sum(command.has_reply for command in commands)
        with self.lock.hold():
            if stop_count is not None and stop_count != self.lock.requested:
                raise Interrupted(self.name, str(commands[0]), "not sent because a stop was requested")
            stops, received = self.lock.acquired, b""
            try:
                self._send(request)
                deadline, patience = self._clock.now() + TIMEOUT_S, self._clock.now() + PATIENCE_S
                while received.count(protocol.REPLY_END) < lines:
                    now = self._clock.now()
                    if stops != self.lock.acquired or now >= deadline or (self.lock.stop_waiting and now >= patience):
                        raise NoAnswer(self.name, str(commands[0]), "not responding", "check cable and power")
                    received += self._read()
            except PORT_FAULTS as error:
                self.close()
                raise NoAnswer(self.name, str(commands[0]), f"the port failed: {error}", "check cable and power") from None
            return received.decode("ascii", "replace").split("\r\n")[:lines]

    def stop_steps(self, numbers: Mapping[str, int]) -> StopSteps:
        """Send the stop of each axis, twice if it is not confirmed."""
        silent = dict(numbers)
        for first in (True, False):
            try:
                for axis, number in list(silent.items()):
                    self._send(protocol.encode(EspCommand(number, "ST"), EspCommand(number, "MD", query=True)))
                    deadline, received = self._clock.now() + PATIENCE_S, b""
                    while protocol.REPLY_END not in received and self._clock.now() < deadline:
                        yield StopPhase.SENDING
                        received += self._read()
                    if protocol.REPLY_END in received:
                        del silent[axis]
            except PORT_FAULTS:
                self.close()
            if first:
                yield StopPhase.ATTEMPTED
            if not silent:
                break
        return [NoAnswer(axis, "stop", "the controller has not confirmed it", "cut the motors' power") for axis in silent]

    def _send(self, request: bytes) -> None:
        if self._port is None:
            raise SerialException("the port is not open")
        while waiting := self._port.in_waiting:
            self._tap(FROM_DEVICE, self._port.read(waiting))
        self._tap(TO_DEVICE, request)
        self._port.write(request)

    def _read(self) -> bytes:
        assert self._port is not None
        data = bytes(self._port.read(64 if self._port.in_waiting > 1 else 1))
        self._tap(FROM_DEVICE, data)
        return data


class EspAxis:
    """One axis of the controller."""

    last_reference_deg: float | None = None

    def __init__(self, name: str, line: EspLine, settings: EspAxisSettings, clock: Clock) -> None:
        self.name, self.settings = name, settings
        self._line, self._clock, self._connected = line, clock, False
        self.unreferenced_reason = "it has not been connected"

    @staticmethod
    def start_commands(settings: EspAxisSettings, target_deg: float) -> tuple[EspCommand, ...]:
        """The commands of a move to an angle."""
        return EspCommand(settings.number, "PA", target_deg - settings.zero_offset_deg), EspCommand(0, "TE", query=True)

    @staticmethod
    def reading_commands(settings: EspAxisSettings) -> tuple[EspCommand, ...]:
        """The commands that read the position and the mark."""
        return EspCommand(settings.number, "TP"), EspCommand(settings.number, "JW", query=True)

    def connect(self) -> None:
        """Write the settings; find out whether the axis is referenced."""
        [value] = self._line.exchange(self._command("JW", query=True))
        if value != f"{REFERENCED:.4f}":
            reset = self._connected and value != f"{UNREFERENCED:.4f}"
            known = self.settings.power_up_at_reference and not reset and value != f"{UNREFERENCED:.4f}"
            self.unreferenced_reason = "" if known else "its controller has reset" if reset else "it has not been homed"
        elif not self._connected:
            self.unreferenced_reason = ""
        self._do(self._command("VA", self.settings.speed_deg_s), self._command("AC", self.settings.acceleration_deg_s2))
        if self.settings.homing is not None:
            self._do(self._command("OH", self.settings.homing.speed_deg_s))
        self._do(self._command("JW", UNREFERENCED if self.unreferenced_reason else REFERENCED))
        self._connected = True

    def check_limits(self, target_deg: float) -> None:
        """Raise LimitError for a target outside the soft limits."""
        check_limits(self.name, self.settings, target_deg)

    def start(self, target_deg: float, stop_count: int | None = None) -> "EspMove":
        """Start a move to an angle."""
        self.check_limits(target_deg)
        if self.unreferenced_reason:
            raise Unreferenced(self.name, f"move to {target_deg:g} deg", self.unreferenced_reason, "home it")
        stop_count = self._line.lock.requested if stop_count is None else stop_count
        here = self.position_deg()
        self._do(*self.start_commands(self.settings, target_deg)[:-1], stop_count=stop_count)
        seconds = float(move_seconds(target_deg - here, self.settings.speed_deg_s, self.settings.acceleration_deg_s2))
        return EspMove(self, target_deg, self._clock.now() + seconds + ARRIVED_AFTER_S, self._clock)

    def start_homing(self) -> Poll:
        """Search for the negative limit switch."""
        homing = self.settings.homing
        if homing is None:
            raise DeviceError(self.name, "home", "the rig file has no [homing] for it", "add [homing]")
        stop_count, before = self._line.lock.requested, self.position_deg()
        self._mark("its reference search has not ended")
        self._do(self._command("OR"), stop_count=stop_count)
        deadline = self._clock.now() + homing.longest_s

        def is_over() -> bool:
            if self.is_moving():
                if self._clock.now() > deadline:
                    raise DeviceError(self.name, "home", f"no switch within {homing.longest_s:g} s", "check the switch")
                return False
            if stop_count != self._line.lock.requested or abs(self._counter_deg()) > 1e-3:
                raise DeviceError(self.name, "home", "the search was ended before it found the switch", "home it again")
            self.last_reference_deg = before
            self.set_position(homing.angle_deg)
            return True

        return Poll(self._clock, self._clock.now() + POLL_S, POLL_S, is_over)

    def set_position(self, angle_deg: float | None = None) -> None:
        """Set the current position; None accepts the counter."""
        if angle_deg is not None:
            self._do(self._command("DH", angle_deg - self.settings.zero_offset_deg))
        self._mark("")

    def position_deg(self) -> float:
        """Position by the counter."""
        return self.settings.zero_offset_deg + self._counter_deg()

    def encoder_deg(self) -> None:
        """The axis has no encoder."""

    def is_moving(self) -> bool:
        """Whether the motor turns."""
        return float(self._line.exchange(self._command("MD", query=True))[0]) == 0.0

    def read_back(self) -> tuple[float, None]:
        """Position of a referenced axis."""
        here = self.position_deg()
        if self.unreferenced_reason:
            raise Unreferenced(self.name, f"read back its position {here:.3f} deg", self.unreferenced_reason, "home it")
        return here, None

    def _counter_deg(self) -> float:
        position, mark = self._line.exchange(*self.reading_commands(self.settings))
        if float(mark) not in (REFERENCED, UNREFERENCED):
            self.unreferenced_reason = "its controller has reset"
            raise Forgotten(self.name, "read its position", "the controller has reset", "connect again, then home it")
        return float(position)

    def _mark(self, reason: str) -> None:
        self.unreferenced_reason = reason
        self._do(self._command("JW", UNREFERENCED if reason else REFERENCED))

    def _command(self, mnemonic: str, value: float | None = None, *, query: bool = False) -> EspCommand:
        return EspCommand(self.settings.number, mnemonic, value, query)

    def _do(self, *commands: EspCommand, stop_count: int | None = None) -> None:
        [code] = self._line.exchange(*commands, EspCommand(0, "TE", query=True), stop_count=stop_count)
        if code != str(protocol.NO_ERROR):
            raise BadAnswer(self.name, str(commands[0]), f"error {code}", "check the settings in the rig file")


class EspMove:
    """A move in progress."""

    def __init__(self, axis: EspAxis, target_deg: float, arrival: float, clock: Clock) -> None:
        self._axis, self._target_deg, self._clock = axis, target_deg, clock
        self.arrival = self.due = arrival

    def poll(self) -> bool:
        """Ask whether the motor rests, and then where."""
        if self._axis.is_moving():
            self.due = self._clock.now() + POLL_S
            return False
        here = self._axis.position_deg()
        if not math.isclose(here, self._target_deg, abs_tol=1e-3):
            raise DeviceError(self._axis.name, f"move to {self._target_deg:g} deg", f"stopped at {here:.3f} deg", "start again")
        return True


class EspController:
    """The controller with its axes."""

    def __init__(self, name: str, line: EspLine, axes: Mapping[str, EspAxisSettings], clock: Clock) -> None:
        self.name, self._line = name, line
        self.axes = {axis: EspAxis(axis, line, settings, clock) for axis, settings in axes.items()}
        self.parts = tuple(self.axes)

    @property
    def stop_count(self) -> int:
        """Number of stop requests so far."""
        return self._line.lock.requested

    def connect(self) -> str:
        """Open the port, read the version, write the settings."""
        self._line.open()
        [version] = self._line.exchange(EspCommand(0, "VE", query=True))
        for axis in self.axes.values():
            axis.connect()
        return version

    reconnect = connect

    def close(self) -> None:
        """Close the port."""
        self._line.close()

    def begin_stop(self) -> StopSteps:
        """Stop all axes."""
        numbers = {name: axis.settings.number for name, axis in self.axes.items()}
        return self._line.lock.begin_stop(self._line.stop_steps(numbers))

    def set_heartbeat(self, seconds: float) -> None:
        """The controller has no heartbeat."""


def open_esp(wires: Wires, name: str, table: Any, axes: Mapping[str, EspAxisSettings]) -> EspController:
    """The driver for a table of the rig file."""
    line = EspLine(name, wires.serial(table.port), wires.clock, table.baudrate, wires.tap(name, as_text))
    return EspController(name, line, axes, wires.clock)


ESP = MotionKind(
    "esp",
    controller=EspSettings,
    axis=EspAxisSettings,
    axes=EspAxesTable,
    own_axis=EspAxisTable,
    open=open_esp,
    timing=axis_timing,
    explain=as_text,
    twins=(EspModel,),
)
