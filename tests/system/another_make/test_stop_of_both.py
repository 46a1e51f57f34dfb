"""Stop on the wires of two makes: the stop frames of every axis are sent within 200 ms, whatever the other controller does."""

import contextlib
import threading
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from serial import SerialException

from goniotwin.app.rig import OpenRig, open_rig, read_rig
from goniotwin.drivers import DeviceError, Monochromator, Rig
from goniotwin.drivers.motion import StopPhase, StopSteps
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command
from goniotwin.twin.devices.line import SerialDevice
from tests.drivers.test_stop_times import MOST_S
from tests.system.another_make.driver import EspController

WIRES = ("axes", "esp")
STATES = ("works", "deaf", "unplugged")
WITHIN_S = 30.0
RAMPS_S = 2.0
"""All axes of the rig brake in a second at most; the rest is the time until the stop."""


class Wire:
    """The wire to a controller. It records stop frames; `state` is one of STATES."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate, self.outbox = device.baudrate, device.outbox
        self.state = "works"
        self.stops: list[float] = []

    def receive(self, data: bytes, t: float) -> None:
        if self.state == "unplugged":
            raise SerialException("unplugged")
        if (len(data) == 9 and data[1] == Command.MST) or data.startswith(b"1ST"):
            self.stops.append(t)
        if self.state == "works":
            self.device.receive(data, t)

    def reset(self, t: float) -> None:
        self.device.reset(t)


def open_moving(path: Path, clock: Clock) -> tuple[OpenRig, dict[str, Wire]]:
    """The mixed rig on recording wires, with all axes in motion."""
    opened = open_rig(read_rig(path), clock)
    assert opened.virtual is not None
    wires = {name: Wire(opened.virtual.serial[name]) for name in WIRES}
    opened.virtual.serial |= wires
    opened.connect()
    for name, target in (("gamma", 300.0), ("sigma", 150.0), ("beta", 200.0), ("shift", 5.0)):
        opened.rig.start(name, target)
    return opened, wires


def stop_into(rig: Rig, stopped: list[list[DeviceError]]) -> None:
    stopped.append(rig.stop())


def check(opened: OpenRig, wires: dict[str, Wire], requested: float, failures: list[DeviceError]) -> None:
    """Frames in time on each wire that takes them, failures of the others' axes only, and nothing that moves later."""
    rig, virtual = opened.rig, opened.virtual
    assert virtual is not None
    axes = {"axes": ["gamma", "sigma", "beta"], "esp": ["shift"]}
    for name, wire in wires.items():
        if wire.state != "unplugged":
            assert len(wire.stops) >= len(axes[name])
            assert wire.stops[len(axes[name]) - 1] - requested < MOST_S
    silent = [axis for name in WIRES if wires[name].state != "works" for axis in axes[name]]
    assert [failure.device for failure in failures] == silent
    rig.clock.sleep_until(requested + RAMPS_S)
    working = [axis for name in WIRES if wires[name].state == "works" for axis in axes[name]]
    rest = [virtual.plant.angle_deg(axis, rig.clock.now()) for axis in working]
    rig.clock.sleep_until(requested + 2.0 * RAMPS_S)
    assert [virtual.plant.angle_deg(axis, rig.clock.now()) for axis in working] == rest


@pytest.mark.parametrize("axes", STATES)
@pytest.mark.parametrize("esp", STATES)
@pytest.mark.parametrize("asked", ["beta", "shift"])
@pytest.mark.parametrize("step_ms", [20, pytest.param(7, marks=pytest.mark.long)])
def test_a_stop_in_the_middle_of_an_exchange_is_sent_in_time_on_both_wires(
    mixed_rig: Callable[..., Path], axes: str, esp: str, asked: str, step_ms: int
) -> None:
    """On the virtual clock: the stop is an event in an exchange with either controller, in any of its milliseconds."""
    for where_ms in range(0, 60, step_ms):
        opened, wires = open_moving(mixed_rig(), VirtualClock())
        with opened:
            rig, stopped = opened.rig, list[list[DeviceError]]()
            rig.clock.sleep_until(rig.clock.now() + 0.2)
            wires["axes"].state, wires["esp"].state = axes, esp
            requested = rig.clock.now() + 1e-3 * where_ms
            rig.clock.at(requested, partial(stop_into, rig, stopped))
            with contextlib.suppress(DeviceError):
                rig.axes[asked].position_deg()
            rig.clock.sleep_until(requested)
            assert len(stopped) == 1
            check(opened, wires, requested, stopped[0])


def test_after_a_stop_no_axis_of_either_make_starts_by_an_older_order(mixed_rig: Callable[..., Path]) -> None:
    """A stop during the checks before a move of the shift, which read the other controller too, prevents the move."""
    for where_ms in range(0, 30, 3):
        with open_rig(read_rig(mixed_rig()), VirtualClock()) as opened:
            opened.connect()
            rig = opened.rig
            rig.clock.at(rig.clock.now() + 1e-3 * where_ms, rig.stop)
            with contextlib.suppress(DeviceError):
                rig.start("shift", 5.0)
            rig.clock.sleep_until(rig.clock.now() + 10.0)
            assert opened.virtual is not None
            assert opened.virtual.plant.angle_deg("shift", rig.clock.now()) < 0.05


def _raising(controller: EspController) -> StopSteps:
    raise RuntimeError("an error in the driver")


def _no_steps(controller: EspController) -> Iterator[StopPhase]:
    return iter(())


def _no_phase(controller: EspController) -> Iterator[str]:
    yield "no phase"


def _no_list(controller: EspController) -> Iterator[StopPhase]:
    yield StopPhase.ATTEMPTED


def _never_closed(controller: EspController) -> Iterator[StopPhase]:
    try:
        yield StopPhase.ATTEMPTED
        yield StopPhase.ENDED
    finally:
        raise RuntimeError("an error in the driver")


@pytest.mark.parametrize("faulty", [_raising, _no_steps, _no_phase, _no_list, _never_closed])
def test_an_error_in_the_stop_of_one_driver_is_a_failure_of_its_own_axes_only(
    mixed_rig: Callable[..., Path], monkeypatch: pytest.MonkeyPatch, faulty: Callable[[EspController], Any]
) -> None:
    opened, wires = open_moving(mixed_rig(), VirtualClock())
    with opened:
        monkeypatch.setattr(EspController, "begin_stop", faulty)
        rig = opened.rig
        rig.clock.sleep_until(rig.clock.now() + 0.2)
        requested = rig.clock.now()
        assert [failure.device for failure in rig.stop()] == ["axes-shift"]
        assert len(wires["axes"].stops) >= 3
        assert wires["axes"].stops[2] - requested < MOST_S
        assert opened.virtual is not None
        rig.clock.sleep_until(requested + RAMPS_S)
        rest = [opened.virtual.plant.angle_deg(axis, rig.clock.now()) for axis in ("gamma", "sigma", "beta")]
        rig.clock.sleep_until(requested + 2.0 * RAMPS_S)
        assert [opened.virtual.plant.angle_deg(axis, rig.clock.now()) for axis in ("gamma", "sigma", "beta")] == rest
        assert rig.axes["gamma"].position_deg() == pytest.approx(rest[0], abs=0.01)  # its line is free again


def test_an_error_in_the_monochromators_driver_leaves_the_second_attempt_to_the_axes(
    mixed_rig: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    opened, wires = open_moving(mixed_rig(), VirtualClock())
    with opened:
        monkeypatch.setattr(Monochromator, "stop", lambda _: 1 // 0)
        wires["axes"].state = "deaf"
        failures = opened.rig.stop()
        assert [failure.device for failure in failures] == ["gamma", "sigma", "beta", "monochromator"]
        assert len(wires["axes"].stops) == 6


@pytest.mark.endpoint
def test_two_stops_at_once_wait_for_each_other_on_neither_wire(mixed_rig: Callable[..., Path]) -> None:
    """The window's thread and the engine's may stop at the same time: each must get both lines."""
    opened, wires = open_moving(mixed_rig(), RealClock())
    with opened:
        for _ in range(20):
            failures = list[list[DeviceError]]()
            threads = [threading.Thread(target=stop_into, args=(opened.rig, failures), daemon=True) for _ in range(4)]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(WITHIN_S)
            assert failures == [[]] * len(threads)
        assert len(wires["esp"].stops) == 80


@pytest.mark.long
@pytest.mark.endpoint
@pytest.mark.parametrize("axes", STATES)
@pytest.mark.parametrize("esp", STATES)
def test_a_stop_from_another_thread_is_sent_in_time_on_both_wires(mixed_rig: Callable[..., Path], axes: str, esp: str) -> None:
    """On the real clock: a thread keeps asking both controllers. The bound is guaranteed in real time."""
    with contextlib.ExitStack() as stack:
        stops = []
        for k in range(5):
            opened, wires = open_moving(mixed_rig(), RealClock())
            stack.enter_context(opened)
            rig, over = opened.rig, threading.Event()

            def work(opened: OpenRig = opened, over: threading.Event = over) -> None:
                while not over.is_set():
                    for axis in opened.rig.axes.values():
                        with contextlib.suppress(DeviceError):
                            axis.position_deg()

            worker = threading.Thread(target=work)
            worker.start()
            try:
                wires["axes"].state, wires["esp"].state = axes, esp
                rig.clock.sleep_until(rig.clock.now() + 0.05 + 0.017 * k)
                requested = rig.clock.now()
                failures = rig.stop()
            finally:
                over.set()
                worker.join()
            stops.append((opened, wires, requested, failures))
        for stop in stops:  # all of them come to rest in the time of one
            check(*stop)
