"""Stop: all stop frames on the wire within 200 ms, whatever else is going on."""

import contextlib
import threading
from typing import Any

import pytest

from goniotwin.drivers import Axis, DeviceError, wait
from goniotwin.mocks.faults import Fault, Script
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command, Reply, Request
from goniotwin.twin.devices.line import SerialDevice
from tests.drivers.axis_bench import DriverBench

MOST_S = 0.2


class Silent:
    """A device of which a test says whether it hears; it notes when which stop frame arrives."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate, self.outbox = device.baudrate, device.outbox
        self.deaf = False
        self.stops: list[tuple[float, int]] = []

    def receive(self, data: bytes, t: float) -> None:
        if data[1] == Command.MST:
            self.stops.append((t, data[3]))
        if not self.deaf:
            self.device.receive(data, t)

    def reset(self, t: float) -> None:
        self.device.reset(t)


class StopBench(DriverBench):
    """Four axes on a wire whose stop frames are timed."""

    def __init__(self, clock: Clock | None = None) -> None:
        super().__init__(axes=4, clock=clock, wire=self._listen)
        self.connect()

    def _listen(self, device: SerialDevice) -> SerialDevice:
        self.silent = Silent(device)
        return self.silent

    def stop(self) -> list[DeviceError]:
        """As the rig does it."""
        return self.module.stop([each for axis in self.axes.values() for each in axis.stop_requests()])


def starting(bench: StopBench) -> list[Any]:
    return [axis.start(120.0) for axis in bench.axes.values()]


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("where", range(40))
def test_a_stop_in_the_middle_of_an_exchange_is_on_the_wire_in_time(deaf: bool, where: int) -> None:
    """An event of the clock, at any moment of an exchange of 1.9 ms (or of one that hangs), on the same port."""
    bench = StopBench()
    starting(bench)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.silent.deaf = deaf
    now = bench.clock.now()
    called = now + where * (0.005 if deaf else 0.0001)
    failures: list[list[DeviceError]] = []
    event = bench.clock.at(called, lambda: failures.append(bench.stop()))
    told: object = None
    try:
        told = bench.axis.position_deg()
    except DeviceError as error:
        told = error
    bench.clock.sleep_until(called + 1.0)
    assert not event.cancelled
    assert len(failures) == 1
    assert {motor for _, motor in bench.silent.stops[:4]} == {0, 3, 4, 5}
    assert max(t for t, _ in bench.silent.stops[:4]) - called < MOST_S
    assert len(failures[0]) == (4 if deaf else 0)
    if not deaf:
        bench.clock.sleep_until(called + 3.0)
        rest = bench.angle()
        assert rest < 20.0  # the motors brake
        bench.clock.sleep_until(called + 30.0)
        assert bench.angle() == rest == pytest.approx(bench.axis.position_deg(), abs=1e-3)
        # The interrupted question has been asked again, and has its own answer.
        assert isinstance(told, float)
        assert 4.0 < told < 12.0


@pytest.mark.parametrize("where", range(30))
def test_an_interrupted_move_is_not_sent_again(where: int) -> None:
    """Starting takes 5.6 ms: where it is, the canary, the move; the stop comes before, in the midst and after."""
    bench = StopBench()
    called = bench.clock.now() + where * 0.0002
    bench.clock.at(called, bench.stop)
    with contextlib.suppress(DeviceError):
        bench.axis.start(90.0)
    bench.clock.sleep_until(called + 60.0)
    assert len(bench.silent.stops) == 4
    assert bench.silent.stops[3][0] - called < MOST_S
    assert bench.angle() < 0.1
    assert bench.axis.referenced


def test_a_stop_during_a_resynchronisation() -> None:
    for where in range(0, 300, 7):
        bench = StopBench()
        starting(bench)
        bench.clock.sleep_until(bench.clock.now() + 1.0)
        bench.silent.deaf = True
        now = bench.clock.now()
        called = now + where * 0.001
        bench.clock.at(called, bench.stop)
        with pytest.raises(DeviceError):
            bench.axis.position_deg()
        bench.clock.sleep_until(now + 1.0)
        assert len(bench.silent.stops) >= 4
        assert bench.silent.stops[3][0] - called < MOST_S


def test_a_home_search_is_told_to_end_as_well() -> None:
    bench = StopBench()
    assert [request.command for _, request in bench.axis.stop_requests()] == [Command.MST]


def test_silent_axes_are_named() -> None:
    bench = StopBench()
    bench.silent.deaf = True
    assert [failure.device for failure in bench.stop()] == list(bench.axes)
    bench.silent.deaf = False
    assert bench.axis.position_deg() == 0.0


def test_one_lost_confirmation_is_asked_for_again() -> None:
    bench = DriverBench(axes=4, wire=lambda device: FaultyLine(device, Script([]))).connect()
    assert isinstance(bench.device, FaultyLine)
    bench.device.misfortune = Script([Fault.NONE, Fault.LOST])
    assert bench.module.stop([each for axis in bench.axes.values() for each in axis.stop_requests()]) == []


def test_with_the_port_closed_every_axis_says_so() -> None:
    bench = StopBench()
    bench.module.close()
    assert len(bench.stop()) == 4


@pytest.mark.parametrize("deaf", [False, True])
def test_a_stop_from_another_thread_goes_first(deaf: bool) -> None:
    """The engine's thread asks without pause, or hangs in an exchange; real time."""
    clock = RealClock()
    bench = StopBench(clock)
    starting(bench)
    ending = threading.Event()
    asked: list[object] = []

    def ask() -> None:
        while not ending.is_set():
            try:
                asked.append(bench.axes["beta"].position_deg())
            except DeviceError as error:
                asked.append(error)

    worker = threading.Thread(target=ask)
    worker.start()
    try:
        worst = 0.0
        for _ in range(5):
            clock.sleep_until(clock.now() + 0.05)
            bench.silent.deaf = deaf
            clock.sleep_until(clock.now() + 0.03)
            bench.silent.stops.clear()
            called = clock.now()
            failures = bench.stop()
            worst = max(worst, bench.silent.stops[3][0] - called)
            assert len(failures) == (4 if deaf else 0)
            bench.silent.deaf = False
        assert worst < MOST_S
    finally:
        ending.set()
        worker.join()
    assert any(isinstance(each, float) for each in asked)


def test_two_stops_at_once() -> None:
    clock = RealClock()
    bench = StopBench(clock)
    starting(bench)
    outcomes: list[list[DeviceError]] = []
    threads = [threading.Thread(target=lambda: outcomes.append(bench.stop())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes == [[], [], [], []]
    assert bench.axis.position_deg() < 10.0


def test_the_reply_to_a_stop_is_not_the_reply_to_a_question() -> None:
    """Nor that of another command: the value of a reply to GAP is believed only after a GAP."""
    bench = StopBench()
    bench.line.outbox.append((bench.clock.now() + 1e-3, Reply(2, 1, 100, Command.MST, 77).encode()))
    assert bench.module.exchange(Request(1, Command.GAP, 1, 4)) == 0


def test_after_a_stop_the_axes_go_on_where_they_are_sent() -> None:
    bench = StopBench(VirtualClock())
    moves = starting(bench)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    assert bench.stop() == []
    with pytest.raises(DeviceError, match="a stop from elsewhere"):
        wait(bench.clock, moves)
    axis: Axis = bench.axis
    assert axis.referenced
    bench.move(50.0)
    assert bench.angle() == pytest.approx(50.0, abs=1e-3)
