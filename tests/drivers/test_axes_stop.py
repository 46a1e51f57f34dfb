"""Stop: all stop frames are sent within 200 ms, in any state of the line."""

import contextlib
import threading
from collections.abc import Callable
from typing import Any

import pytest

from goniotwin.drivers import DeviceError, TmclAxis, wait
from goniotwin.drivers.motion import StopPhase, StopSteps, stop_all
from goniotwin.drivers.motion.tmcl.controller import LONGEST_REPLY_TIMEOUT_S
from goniotwin.mocks.faults import Fault, ScriptedFaults
from goniotwin.mocks.faulty_line import FaultyLine
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame
from goniotwin.twin.devices.line import SerialDevice
from tests.drivers.axis_bench import AxisBench

MOST_S = 0.2


class StopRecorder:
    """The wire to a device; it records the stop frames. `deaf`: the device receives nothing."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate, self.outbox = device.baudrate, device.outbox
        self.deaf = False
        self.stops: list[tuple[float, int]] = []
        self.note_request: Callable[[], object] = int

    def receive(self, data: bytes, t: float) -> None:
        self.note_request()
        if data[1] == Command.MST:
            self.stops.append((t, data[3]))
        if not self.deaf:
            self.device.receive(data, t)

    def reset(self, t: float) -> None:
        self.device.reset(t)


class StopBench(AxisBench):
    """Four axes on a wire that records the times of stop frames."""

    def __init__(self, clock: Clock | None = None, reply_timeout_s: float | None = None) -> None:
        super().__init__(axes=4, clock=clock, wire=self._insert_recorder, reply_timeout_s=reply_timeout_s)
        self.connect()

    def _insert_recorder(self, device: SerialDevice) -> SerialDevice:
        self.recorder = StopRecorder(device)
        return self.recorder

    def stop(self) -> list[DeviceError]:
        """Stop all axes, as the rig does."""
        return stop_all(
            {"axes": self.module.begin_stop([each for axis in self.axes.values() for each in axis.stop_requests()])}
        )


def start_all(bench: StopBench) -> list[Any]:
    return [axis.start(120.0) for axis in bench.axes.values()]


@pytest.mark.parametrize("deaf", [False, True])
@pytest.mark.parametrize("where", range(40))
def test_a_stop_in_the_middle_of_an_exchange_is_sent_in_time(deaf: bool, where: int) -> None:
    """A stop by an event of the clock, at any time of an exchange of 1.9 ms, or of one without reply."""
    bench = StopBench()
    start_all(bench)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.recorder.deaf = deaf
    now = bench.clock.now()
    requested = now + where * (0.005 if deaf else 0.0001)
    failures: list[list[DeviceError]] = []
    event = bench.clock.at(requested, lambda: failures.append(bench.stop()))
    outcome: object = None
    try:
        outcome = bench.axis.position_deg()
    except DeviceError as error:
        outcome = error
    bench.clock.sleep_until(requested + 1.0)
    assert not event.cancelled
    assert len(failures) == 1
    assert {motor for _, motor in bench.recorder.stops[:4]} == {0, 3, 4, 5}
    assert max(t for t, _ in bench.recorder.stops[:4]) - requested < MOST_S
    assert len(failures[0]) == (4 if deaf else 0)
    if not deaf:
        bench.clock.sleep_until(requested + 3.0)
        rest = bench.angle()
        assert rest < 20.0  # the motors brake
        bench.clock.sleep_until(requested + 30.0)
        assert bench.angle() == rest == pytest.approx(bench.axis.position_deg(), abs=1e-3)
        # The interrupted read was repeated, and has its own reply.
        assert isinstance(outcome, float)
        assert 4.0 < outcome < 12.0


@pytest.mark.parametrize("reply_timeout_s", [0.25, LONGEST_REPLY_TIMEOUT_S])
@pytest.mark.parametrize("where", range(10))
def test_a_stop_does_not_wait_for_the_timeout_of_a_reply(where: int, reply_timeout_s: float) -> None:
    """At a network port, or where the rig file gives a longer one; at any time of an exchange without reply."""
    bench = StopBench(reply_timeout_s=reply_timeout_s)
    start_all(bench)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    bench.recorder.deaf = True
    now = bench.clock.now()
    requested = now + (0.1 * where + 0.001) * reply_timeout_s
    bench.clock.at(requested, bench.stop)
    with pytest.raises(DeviceError):
        bench.axis.read_errors()  # which is sent once
    bench.clock.sleep_until(now + 10.0)
    assert {motor for _, motor in bench.recorder.stops[:4]} == {0, 3, 4, 5}
    assert bench.recorder.stops[3][0] - requested < MOST_S


def test_a_reply_is_waited_for_as_long_as_the_rig_file_states() -> None:
    for timeout_s in (0.06, 0.25):
        bench = StopBench(reply_timeout_s=timeout_s)
        bench.recorder.deaf = True
        with pytest.raises(DeviceError, match=f"0 of 9 bytes within {timeout_s:.3f} s"):
            bench.axis.read_errors()


@pytest.mark.parametrize("where", range(30))
def test_an_interrupted_move_is_not_sent_again(where: int) -> None:
    """A start takes 5.6 ms: position, canary, move; the stop comes before, during or after these."""
    bench = StopBench()
    requested = bench.clock.now() + where * 0.0002
    bench.clock.at(requested, bench.stop)
    with contextlib.suppress(DeviceError):
        bench.axis.start(90.0)
    bench.clock.sleep_until(requested + 60.0)
    assert len(bench.recorder.stops) == 4
    assert bench.recorder.stops[3][0] - requested < MOST_S
    assert bench.angle() < 0.1
    assert bench.axis.referenced


def test_a_stop_during_a_resynchronisation_is_sent_in_time() -> None:
    for where in range(0, 300, 7):
        bench = StopBench()
        start_all(bench)
        bench.clock.sleep_until(bench.clock.now() + 1.0)
        bench.recorder.deaf = True
        now = bench.clock.now()
        requested = now + where * 0.001
        bench.clock.at(requested, bench.stop)
        with pytest.raises(DeviceError):
            bench.axis.position_deg()
        bench.clock.sleep_until(now + 1.0)
        assert len(bench.recorder.stops) >= 4
        assert bench.recorder.stops[3][0] - requested < MOST_S


def test_without_a_reference_search_only_mst_is_sent() -> None:
    bench = StopBench()
    assert [request.command for _, request in bench.axis.stop_requests()] == [Command.MST]


def test_failures_of_a_stop_name_the_silent_axes() -> None:
    bench = StopBench()
    bench.recorder.deaf = True
    assert [failure.device for failure in bench.stop()] == list(bench.axes)
    bench.recorder.deaf = False
    assert bench.axis.position_deg() == 0.0


def test_a_stop_frame_without_reply_is_repeated() -> None:
    bench = AxisBench(axes=4, wire=lambda device: FaultyLine(device, ScriptedFaults([]))).connect()
    assert isinstance(bench.device, FaultyLine)
    bench.device.misfortune = ScriptedFaults([Fault.NONE, Fault.LOST])
    requests = [each for axis in bench.axes.values() for each in axis.stop_requests()]
    assert stop_all({"axes": bench.module.begin_stop(requests)}) == []


def test_a_stop_with_a_closed_port_fails_for_every_axis() -> None:
    bench = StopBench()
    bench.module.close()
    assert len(bench.stop()) == 4


@pytest.mark.parametrize("deaf", [False, True])
def test_a_stop_from_another_thread_goes_first(deaf: bool) -> None:
    """The engine's thread reads without pause, or waits for a reply; real time."""
    clock = RealClock()
    bench = StopBench(clock)
    start_all(bench)
    ending = threading.Event()
    outcomes: list[object] = []

    def read() -> None:
        while not ending.is_set():
            try:
                outcomes.append(bench.axes["beta"].position_deg())
            except DeviceError as error:
                outcomes.append(error)

    worker = threading.Thread(target=read)
    worker.start()
    try:
        worst = 0.0
        for _ in range(5):
            clock.sleep_until(clock.now() + 0.05)
            bench.recorder.deaf = deaf
            clock.sleep_until(clock.now() + 0.03)
            bench.recorder.stops.clear()
            requested = clock.now()
            failures = bench.stop()
            worst = max(worst, bench.recorder.stops[3][0] - requested)
            assert len(failures) == (4 if deaf else 0)
            bench.recorder.deaf = False
        assert worst < MOST_S
    finally:
        ending.set()
        worker.join()
    assert any(isinstance(each, float) for each in outcomes)


def test_a_stop_from_another_thread_does_not_wait_for_a_reply_at_a_network_port() -> None:
    """The engine's thread waits 0.25 s for a reply that does not come; real time."""
    clock = RealClock()
    bench = StopBench(clock, 0.25)
    start_all(bench)
    bench.recorder.deaf = True
    waiting, outcomes = threading.Event(), list[DeviceError]()
    bench.recorder.note_request = waiting.set

    def read() -> None:
        with pytest.raises(DeviceError) as failure:
            bench.axis.read_errors()
        outcomes.append(failure.value)

    worker = threading.Thread(target=read)
    worker.start()
    assert waiting.wait(20.0)
    requested = clock.now()
    bench.stop()
    worker.join()
    assert len(outcomes) == 1
    assert bench.recorder.stops[3][0] - requested < MOST_S


def test_simultaneous_stops_all_succeed() -> None:
    clock = RealClock()
    bench = StopBench(clock)
    start_all(bench)
    outcomes: list[list[DeviceError]] = []
    threads = [threading.Thread(target=lambda: outcomes.append(bench.stop())) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert outcomes == [[], [], [], []]
    assert bench.axis.position_deg() < 10.0


def test_the_reply_to_a_stop_is_not_taken_for_the_reply_to_a_read() -> None:
    """The value of a reply is accepted only for the command of its request."""
    bench = StopBench()
    bench.line.outbox.append((bench.clock.now() + 1e-3, ReplyFrame(2, 1, 100, Command.MST, 77).encode()))
    assert bench.module.exchange(CommandFrame(1, Command.GAP, 1, 4)) == 0


def test_after_a_stop_the_axes_can_be_moved_again() -> None:
    bench = StopBench(VirtualClock())
    moves = start_all(bench)
    bench.clock.sleep_until(bench.clock.now() + 1.0)
    assert bench.stop() == []
    with pytest.raises(DeviceError, match="a stop from elsewhere"):
        wait(bench.clock, moves)
    axis: TmclAxis = bench.axis
    assert axis.referenced
    bench.move(50.0)
    assert bench.angle() == pytest.approx(50.0, abs=1e-3)


def steps(name: str, carried_out: list[str], *phases: StopPhase) -> StopSteps:
    """A stop that notes the number of each of its steps."""
    for number, phase in enumerate(phases):
        carried_out.append(f"{name}{number}")
        yield phase
    return []


def test_the_stops_of_several_lines_are_interleaved() -> None:
    """A line that waits for its replies delays the frames of no other line."""
    done: list[str] = []
    sending, attempted = StopPhase.SENDING, StopPhase.ATTEMPTED
    stops = {name: steps(name, done, sending, sending, attempted) for name in "abc"}
    assert stop_all(stops, lambda: done.append("then")) == []
    assert done == ["a0", "b0", "c0", "a1", "b1", "c1", "a2", "b2", "c2", "then"]


def test_a_step_that_may_block_waits_until_the_other_lines_have_been_attempted() -> None:
    done: list[str] = []
    sending, blocking, attempted = StopPhase.SENDING, StopPhase.BLOCKING, StopPhase.ATTEMPTED
    stops = {"a": steps("a", done, blocking, attempted), "b": steps("b", done, sending, sending, attempted)}
    assert stop_all(stops) == []
    assert done == ["a0", "b0", "b1", "b2", "a1"]
