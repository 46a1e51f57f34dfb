"""A whole virtual rig at work as in a campaign, with wires that are watched, and that a test lets fall silent."""

import contextlib
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.drivers import DeviceError, LimitError, Pending, Rig, wait
from goniotwin.protocols.tmcl import Command
from goniotwin.twin import VirtualRig
from goniotwin.twin.devices.line import SerialDevice

MODULE = "adc-2"
"""The converter module that falls silent."""
TRIES = 8
AFTER_A_FAULT_S = 0.02
ABORT_S = 0.02
"""How long `ABORT` is on its way at 9600 Bd, and some more."""
RESOLUTION_S = 1e-5
STILL_DEG = 1e-8


class Stopped(Exception):
    """Whoever drives the rig has heard of the stop."""


class Watched:
    """The wire to a device: it notes when stop frames have arrived whole, and calls back at the n-th request from now.

    `deaf`: the device hears nothing any more. `mute`: it does what it is told, and nobody hears it.
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
        """`action` is called with the time at which the n-th request from now has arrived, before it is heard."""
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
        there = len(self.outbox)
        self.device.receive(data, t)
        while self.mute and len(self.outbox) > there:
            self.outbox.pop()

    def reset(self, t: float) -> None:
        """Of the device behind it."""
        self.device.reset(t)


@dataclass(frozen=True)
class Stop:
    """What came of a stop, in s from the call: the last of the first four stop frames, the return, and all axes at rest.

    `ramp_s` is how long those axes that turned at the call take to rest from the speed that they had.
    """

    last_frame_s: float
    returned_s: float
    rest_s: float
    ramp_s: float
    failures: list[DeviceError]


@dataclass
class BusyRig:
    """Drivers, and the virtual rig behind their wires. The wires are watched from the next connection on.

    Axes turn for about `reach_s` at a time; whether they rest is looked at `rest_s` after a stop.
    """

    rig: Rig
    virtual: VirtualRig
    seed: int
    reach_s: float = 3.0
    rest_s: float = 5.0

    def __post_init__(self) -> None:
        self.clock = self.rig.clock
        self.random = np.random.default_rng(self.seed)
        self.axes = Watched(self.virtual.serial["axes"])
        self.mono = Watched(self.virtual.serial["mono"])
        self.virtual.serial |= {"axes": self.axes, "mono": self.mono}
        self.module = Watched(_Nobody())
        self.virtual.modbus_wires[MODULE] = self._watch_module
        self.stopped = False
        self._called = self._returned = self._ramp_s = 0.0
        self._failures: list[DeviceError] = []

    def _watch_module(self, device: SerialDevice) -> SerialDevice:
        """A connection ends with the driver's timeout; what the next one finds is as silent as before."""
        self.module.device, self.module.outbox = device, device.outbox
        return self.module

    # ---- at work ----

    def work(self) -> None:
        """Pose after pose is measured, until somebody has said stop."""
        self.stopped = False
        with contextlib.suppress(Stopped):
            while True:
                try:
                    self._row()
                except DeviceError:
                    self._heed()  # a stop came between question and answer; or a device is silent, and work goes on
                    self.clock.sleep_until(self.clock.now() + AFTER_A_FAULT_S)

    def _row(self) -> None:
        rig, moves = self.rig, list[Pending]()
        for name, axis in rig.axes.items():
            self._heed()
            settings = axis.settings
            reach = self.reach_s * settings.speed
            here = self.virtual.plant.angle_deg(name, self.clock.now())
            target = float(np.clip(here + self.random.uniform(-reach, reach), settings.lower_deg, settings.upper_deg))
            with contextlib.suppress(LimitError):
                moves.append(rig.start(name, target))
        self._heed()
        moves.append(rig.monochromator.start_wavelength(float(self.random.integers(400, 760))))
        if self.random.integers(2):  # now and then the photodiodes are read on the way
            moves.append(rig.photodiodes.start_readings(4))
        self._wait(moves)
        self._wait([rig.monochromator.start_shutter(opened=bool(self.random.integers(2)))])
        self._wait([rig.photodiodes.start_gain(int(self.random.integers(4)))])
        self._wait([rig.photodiodes.start_readings(2), rig.monitor.start_mean(0.2)])
        for axis in rig.axes.values():
            self._heed()
            axis.position_deg()
            axis.encoder_deg()

    def _wait(self, started: list[Pending]) -> None:
        wait(self.clock, started, self._heed)
        self._heed()  # it may have come with the last answer

    def _heed(self) -> None:
        if self.stopped:
            raise Stopped

    def recover(self) -> None:
        """As the engine does it: every device is asked again until it answers, without being opened anew."""
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
        """As somebody who presses the button; whoever drives the rig hears of it."""
        self.axes.stops.clear()
        self._called, self._ramp_s = self.clock.now(), self._ramp()
        self.stopped = True
        self._failures = self.rig.stop()
        self._returned = self.clock.now()

    def outcome(self) -> Stop:
        """Of the last stop, some seconds after it; a silent device may hear again from then on."""
        self.clock.sleep_until(self._called + self.rest_s)
        for wire in (self.axes, self.mono, self.module):
            wire.deaf = wire.mute = False
        first = self.axes.stops[:4]
        assert {motor for _, motor in first} == {axis.settings.motor for axis in self.rig.axes.values()}
        rest = max(self._came_to_rest(name) for name in self.virtual.plant.shafts)
        last, returned, rest = (t - self._called for t in (first[-1][0], self._returned, rest))
        return Stop(last, returned, rest, self._ramp_s, self._failures)

    def wavelengths_since_nm(self) -> tuple[float, float]:
        """Of the grating soon after the stop's return, and now."""
        wavelength = self.virtual.plant.wavelength_nm
        return wavelength.at(self._returned + ABORT_S), wavelength.at(self.clock.now())

    def angles_deg(self) -> list[float]:
        """Of all axes, now: the truth."""
        now = self.clock.now()
        return [self.virtual.plant.angle_deg(name, now) for name in self.rig.axes]

    def _ramp(self) -> float:
        seconds = 0.0
        for name, shaft in self.virtual.plant.shafts.items():
            now, settings = self.clock.now(), self.rig.axes[name].settings
            steps_per_s = abs(shaft.drive(now).trajectory.velocity(now))
            seconds = max(seconds, steps_per_s / settings.pps(settings.acceleration))
        return seconds

    def _came_to_rest(self, name: str) -> float:
        """By the true angle alone: the first moment from which on it is what it is in the end."""
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


class _Nobody:
    """Before the first connection."""

    baudrate = 0
    outbox: deque[tuple[float, bytes]] = deque()

    def receive(self, data: bytes, t: float) -> None:
        """Nobody hears it."""

    def reset(self, t: float) -> None:
        """Nor this."""
