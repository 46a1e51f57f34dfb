"""Test bench for stops: a virtual rig that measures as in a campaign, on wires that can be silenced and record stops."""

import contextlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.drivers import DeviceError, LimitError, Pending, Rig, wait
from goniotwin.protocols.tmcl import Command
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.line import SerialDevice
from tests.conftest import tmcl_axis

MODULE = "adc-2"
"""The converter module that becomes silent."""
TRIES = 8
AFTER_A_FAULT_S = 0.02
ABORT_S = 0.02
"""Transmission time of `ABORT` at 9600 Bd, with a margin."""
RESOLUTION_S = 1e-5
STILL_DEG = 1e-8


class StopRequested(Exception):
    """The worker ends because a stop was requested."""


class RecordingWire:
    """The wire to a device: it records the times of complete stop frames, and calls back at the n-th request from now.

    `deaf`: the device receives nothing. `mute`: it receives everything, and its replies are lost.
    """

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate = device.baudrate
        self.outbox: deque[tuple[float, bytes]] = device.outbox
        self.deaf = self.mute = False
        self.stops: list[tuple[float, int]] = []
        self._left = 0
        self._action: Callable[[float], object] = float

    def call_at(self, request: int, action: Callable[[float], object]) -> None:
        """Call `action` with the arrival time of the n-th request from now, before the device receives it."""
        self._left, self._action = request, action

    def receive(self, data: bytes, t: float) -> None:
        """Bytes from the driver."""
        if len(data) == 9 and data[1] == Command.MST:
            self.stops.append((t, data[3]))
        self._left -= 1
        if self._left == 0:
            self._action(t)
        if self.deaf:
            return
        length = len(self.outbox)
        self.device.receive(data, t)
        while self.mute and len(self.outbox) > length:
            self.outbox.pop()

    def reset(self, t: float) -> None:
        """Reset the device behind it."""
        self.device.reset(t)


@dataclass(frozen=True)
class StopTimes:
    """Times of a stop, s from the call: the last of the first four stop frames, the return, and all axes at rest.

    `ramp_s` is the longest ramp to rest of the axes that moved at the call.
    """

    last_frame_s: float
    returned_s: float
    rest_s: float
    ramp_s: float
    failures: list[DeviceError]


@dataclass
class BusyRig:
    """Drivers, and the virtual rig behind their wires. The wires record from the next connection on.

    Axes move for about `reach_s` at a time; they are checked for rest `rest_s` after a stop.
    """

    rig: Rig
    virtual: VirtualRig
    seed: int
    reach_s: float = 3.0
    rest_s: float = 5.0

    def __post_init__(self) -> None:
        self.clock = self.rig.clock
        self.random = np.random.default_rng(self.seed)
        self.axes = RecordingWire(self.virtual.serial["axes"])
        self.mono = RecordingWire(self.virtual.serial["mono"])
        self.virtual.serial |= {"axes": self.axes, "mono": self.mono}
        self.module = RecordingWire(_Disconnected())
        self.virtual.modbus_wires[MODULE] = self._record_module
        self.stopped = False
        self._called = self._returned = self._ramp_s = 0.0
        self._failures: list[DeviceError] = []

    def _record_module(self, device: SerialDevice) -> SerialDevice:
        """A connection ends with the driver's timeout; the module of the next connection is as silent as before."""
        self.module.device, self.module.outbox = device, device.outbox
        return self.module

    # ---- at work ----

    def work(self) -> None:
        """Measure pose after pose until a stop is requested."""
        self.stopped = False
        with contextlib.suppress(StopRequested):
            while True:
                try:
                    self._row()
                except DeviceError:
                    self._check_stop()  # otherwise a device is silent, and the work continues
                    self.clock.sleep_until(self.clock.now() + AFTER_A_FAULT_S)

    def _row(self) -> None:
        rig, moves = self.rig, list[Pending]()
        for name, axis in rig.axes.items():
            self._check_stop()
            settings = axis.settings
            reach = self.reach_s * settings.speed_deg_s
            here = self.virtual.plant.angle_deg(name, self.clock.now())
            target = float(np.clip(here + self.random.uniform(-reach, reach), settings.lower_deg, settings.upper_deg))
            with contextlib.suppress(LimitError):
                moves.append(rig.start(name, target))
        self._check_stop()
        moves.append(rig.monochromator.start_wavelength(float(self.random.integers(400, 760))))
        if self.random.integers(2):  # sometimes the photodiodes are read during the moves
            moves.append(rig.photodiodes.start_readings(4))
        self._wait(moves)
        self._wait([rig.monochromator.start_shutter(opened=bool(self.random.integers(2)))])
        self._wait([rig.photodiodes.start_gain(int(self.random.integers(4)))])
        self._wait([rig.photodiodes.start_readings(2), rig.monitor.start_mean(0.2)])
        for axis in rig.axes.values():
            self._check_stop()
            axis.position_deg()
            axis.encoder_deg()

    def _wait(self, started: list[Pending]) -> None:
        wait(self.clock, started, self._check_stop)
        self._check_stop()  # it may have come with the last reply

    def _check_stop(self) -> None:
        if self.stopped:
            raise StopRequested

    def recover(self) -> None:
        """Read every device until all respond, without opening them again, as the engine does."""
        for attempt in range(TRIES):
            try:
                for axis in self.rig.axes.values():
                    axis.position_deg()
                    if axis.unreferenced_reason:
                        axis.set_position()
                self.rig.monochromator.wavelength_nm()
                self.rig.photodiodes.reconnect()
                self.rig.monitor.check()
                return
            except DeviceError:
                if attempt == TRIES - 1:
                    raise

    # ---- the stop ----

    def stop(self) -> None:
        """Request a stop, as the stop button does; the worker ends."""
        self.axes.stops.clear()
        self._called, self._ramp_s = self.clock.now(), self._longest_ramp_s()
        self.stopped = True
        self._failures = self.rig.stop()
        self._returned = self.clock.now()

    def outcome(self) -> StopTimes:
        """Times of the last stop, some seconds after it; silent devices respond again from then on."""
        self.clock.sleep_until(self._called + self.rest_s)
        for wire in (self.axes, self.mono, self.module):
            wire.deaf = wire.mute = False
        first = self.axes.stops[:4]
        assert {motor for _, motor in first} == {tmcl_axis(self.rig, name).settings.motor for name in self.rig.axes}
        rest = max(self._rest_time(name) for name in self.virtual.plant.shafts)
        last, returned, rest = (t - self._called for t in (first[-1][0], self._returned, rest))
        return StopTimes(last, returned, rest, self._ramp_s, self._failures)

    def wavelengths_since_nm(self) -> tuple[float, float]:
        """Wavelength of the grating soon after the return of the stop, and now."""
        wavelength = self.virtual.plant.wavelength_nm
        return wavelength.at(self._returned + ABORT_S), wavelength.at(self.clock.now())

    def angles_deg(self) -> list[float]:
        """True angles of all axes now."""
        now = self.clock.now()
        return [self.virtual.plant.angle_deg(name, now) for name in self.rig.axes]

    def _longest_ramp_s(self) -> float:
        seconds = 0.0
        for name, shaft in self.virtual.plant.shafts.items():
            now, settings = self.clock.now(), tmcl_axis(self.rig, name).settings
            steps_per_s = abs(shaft.drive(now).trajectory.velocity(now))
            seconds = max(seconds, steps_per_s / settings.pps(settings.acceleration_deg_s2))
        return seconds

    def _rest_time(self, name: str) -> float:
        """The first time from which on the true angle is the final angle."""
        plant = self.virtual.plant
        moving, resting = self._called, self._called + self.rest_s
        final = plant.angle_deg(name, resting)
        if abs(plant.angle_deg(name, moving) - final) < STILL_DEG:
            return moving
        while resting - moving > RESOLUTION_S:
            middle = 0.5 * (moving + resting)
            if abs(plant.angle_deg(name, middle) - final) < STILL_DEG:
                resting = middle
            else:
                moving = middle
        return resting


class _Disconnected:
    """A device before the first connection."""

    baudrate = 0
    outbox: deque[tuple[float, bytes]] = deque()

    def receive(self, data: bytes, t: float) -> None:
        """Discard the data."""

    def reset(self, t: float) -> None:
        """Do nothing."""
