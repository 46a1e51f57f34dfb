"""Axes on a wire with faults: no wrong value, no repeated relative move, bounded time, recovery."""

import contextlib

import pytest

from goniotwin.drivers import DeviceError, wait
from goniotwin.drivers.errors import Forgotten, NoAnswer
from goniotwin.mocks.faults import ON_A_SERIAL_LINE, Fault, FaultPlan, ScriptedFaults
from goniotwin.mocks.faulty_line import FaultyLine, foreign_tmcl, plug_in
from goniotwin.protocols.tmcl import Command, CommandFrame, MoveType, ReplyFrame, checksum
from goniotwin.twin.devices.line import SerialDevice
from tests.drivers.axis_bench import AxisBench

PER_DEG = 5120
LONGEST_S = 1.3
"""A call of three exchanges, each with one repetition and its resynchronisations: seven timeouts of 60 ms each."""
REPEATED_AT_ONCE = [each for each in ON_A_SERIAL_LINE if each not in (Fault.HANG, Fault.RESET, Fault.UNPLUGGED)]


class RequestRecorder:
    """Records the requests that reach a device."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate, self.outbox = device.baudrate, device.outbox
        self.requests: list[CommandFrame] = []

    def receive(self, data: bytes, t: float) -> None:
        self.requests.append(CommandFrame.decode(data)) if len(data) == 9 and checksum(data[:8]) == data[8] else None
        self.device.receive(data, t)

    def reset(self, t: float) -> None:
        self.device.reset(t)


class FaultyAxisBench(AxisBench):
    """Axes on a wire with faults by a script or a seed, after the connection."""

    def __init__(self, misfortune: FaultPlan, **settings: object) -> None:
        self.misfortune = ScriptedFaults(())
        super().__init__(dict(settings), wire=self._insert_faults)
        plug_in(self.faulty, self.clock, lambda end: setattr(self, "device", end))
        self.connect()
        self.clock.sleep_until(self.clock.now() + 0.05)  # no additional exchange is needed this long after the last request
        self.faulty.misfortune = misfortune

    def _insert_faults(self, device: SerialDevice) -> SerialDevice:
        self.recorder = RequestRecorder(device)
        self.faulty = FaultyLine(self.recorder, ScriptedFaults(()), foreign=foreign_tmcl)
        return self.faulty

    def timed(self, call: object, *arguments: object) -> object:
        """Result or error of a call, which must end within LONGEST_S."""
        start = self.clock.now()
        try:
            result = call(*arguments)  # type: ignore[operator]
        except DeviceError as error:
            result = error
        assert self.clock.now() - start < LONGEST_S
        if isinstance(result, DeviceError):
            assert result.device in ("axes", "sigma")
            assert str(result).startswith(f"{result.device}: {result.doing}: {result.happened}")
        return result

    def recover(self) -> None:
        """Recovery by the operator: connect again, stop the axis, set its position. Raises DeviceError."""
        self.connect()
        self.axis.stop()
        self.clock.sleep_until(self.clock.now() + 5.0)
        self.axis.set_position(self.angle())


@pytest.mark.parametrize("fault", REPEATED_AT_ONCE)
def test_a_read_is_repeated_after_any_single_fault(fault: Fault) -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.move(12.5)
    bench.faulty.misfortune = ScriptedFaults([fault])
    assert bench.axis.position_deg() == pytest.approx(12.5)
    assert bench.axis.encoder_deg() == pytest.approx(12.5, abs=1e-3)
    assert bench.axis.switches() == bench.axis.switches()


@pytest.mark.parametrize("fault", REPEATED_AT_ONCE)
def test_a_move_arrives_after_any_single_fault_of_its_command(fault: Fault) -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.faulty.misfortune = ScriptedFaults([Fault.NONE, Fault.NONE, fault])  # position, canary, move
    bench.move(12.5)
    assert bench.angle() == pytest.approx(12.5, abs=1.0 / PER_DEG)


@pytest.mark.parametrize("fault", [each for each in ON_A_SERIAL_LINE if each is not Fault.RESET])
def test_a_relative_move_is_received_once_at_most(fault: Fault) -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.faulty.misfortune = ScriptedFaults([Fault.NONE, Fault.NONE, fault])
    outcome = bench.timed(bench.axis.start_relative, 1.0)
    moves = [each for each in bench.recorder.requests if each.command == Command.MVP and each.type == MoveType.RELATIVE]
    assert len(moves) <= 1
    if isinstance(outcome, DeviceError):
        assert not bench.axis.referenced
        assert "sigma" in str(outcome) or "axes" in str(outcome)
        bench.clock.sleep_until(bench.clock.now() + 0.5)  # the plug is connected again by then
        assert bench.axis.position_deg() == pytest.approx(len(moves), abs=1.0)  # the driver has recovered


def test_a_move_without_any_reply_leaves_the_axis_unreferenced() -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.faulty.misfortune = ScriptedFaults([Fault.NONE, Fault.NONE, *[Fault.HANG] * 20])
    with pytest.raises(DeviceError, match="MVP"):
        bench.axis.start(12.5)
    assert "received" in bench.axis.unreferenced_reason
    bench.faulty.misfortune = ScriptedFaults(())
    bench.axis.set_position()
    bench.move(12.5)


def test_a_reset_is_detected_at_any_exchange() -> None:
    for place in range(12):
        bench = FaultyAxisBench(ScriptedFaults(()))
        bench.move(12.5)
        bench.faulty.misfortune = ScriptedFaults([*[Fault.NONE] * place, Fault.RESET])
        with pytest.raises(Forgotten):
            _read_until_error(bench)


def _read_until_error(bench: FaultyAxisBench) -> None:
    while True:
        assert bench.axis.position_deg() == pytest.approx(12.5)
        assert bench.axis.encoder_deg() == pytest.approx(12.5, abs=1e-3)


def test_a_disconnected_port_is_an_error_at_once_and_reopened_when_it_is_connected_again() -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.move(12.5)
    bench.faulty.pull()
    opened = len(bench.ports)
    for _ in range(3):
        with pytest.raises(NoAnswer, match=r"axes: .*the port failed.*check cable and power"):
            bench.axis.position_deg()
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    assert bench.axis.position_deg() == pytest.approx(12.5)
    assert bench.axis.referenced
    assert list(bench.module.events)[-2:] == ["port reopened", "line resynchronised"]
    assert not any(port.is_open for port in bench.ports[opened - 1 : -1])


def test_a_power_cycle_during_a_disconnection_is_detected() -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.move(12.5)
    bench.faulty.pull()
    bench.line.reset(bench.clock.now())
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    with pytest.raises(Forgotten):
        bench.axis.position_deg()
    assert not bench.axis.referenced


def test_a_stop_reopens_a_port_that_failed() -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.axis.start(90.0)
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    bench.faulty.pull()
    with pytest.raises(NoAnswer, match=r"sigma: stop: the port failed.*cut the motors' power"):
        bench.axis.stop()
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    bench.axis.stop()
    bench.clock.sleep_until(bench.clock.now() + 2.0)
    assert bench.plant.angle_deg("sigma", bench.clock.now()) == pytest.approx(bench.axis.position_deg(), abs=1.0 / PER_DEG)
    assert bench.angle() < 60.0


def test_lost_error_flags_are_not_read_again_and_leave_the_axis_unreferenced() -> None:
    bench = FaultyAxisBench(ScriptedFaults(()))
    bench.faulty.misfortune = ScriptedFaults([Fault.LOST])
    with pytest.raises(DeviceError):
        bench.axis.read_errors()
    assert "error flags" in bench.axis.unreferenced_reason


def test_the_checksum_passes_one_in_255_of_errors_in_two_bytes() -> None:
    """The checksum is a sum: for each error of the first byte, one of the 255 errors of the second compensates it."""
    frame = ReplyFrame(2, 1, 100, Command.GAP, 64_000).encode()
    passed = 0
    for first in range(1, 256):
        for second in range(1, 256):
            wrong = bytes((*frame[:5], frame[5] ^ first, frame[6], frame[7] ^ second))
            passed += checksum(wrong) == frame[8]
    assert passed == 255  # of 255 * 255


def test_unrequested_frames_are_discarded() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    bench.module.exchange(CommandFrame(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4))
    for k in range(5):
        bench.move(10.0 + k)
        assert bench.axis.position_deg() == pytest.approx(10.0 + k)


def test_replies_to_another_host_or_from_another_module_are_discarded() -> None:
    bench = AxisBench().connect()
    for host, address in ((3, 1), (2, 9)):
        bench.line.outbox.append((bench.clock.now() + 1e-3, ReplyFrame(host, address, 100, Command.GAP, 77_777).encode()))
        assert bench.axis.position_deg() == 0.0


def storm(seed: int, steps: int = 30, share: float = 0.15) -> dict[str, int]:
    """Moves and reads on a wire with faults; every returned value is true. Returns counts of values, errors and faults."""
    bench = FaultyAxisBench(FaultPlan(seed, ON_A_SERIAL_LINE, share))
    counts = {"values": 0, "errors": 0}
    for step in range(steps):
        target = float((seed * 7 + step * 13) % 90)
        outcome = bench.timed(bench.axis.start, target)
        if not isinstance(outcome, DeviceError):
            try:
                wait(bench.clock, [outcome])  # type: ignore[list-item]
                assert bench.angle() == pytest.approx(target, abs=2.0 / PER_DEG)
            except DeviceError:
                counts["errors"] += 1
                bench.clock.sleep_until(bench.clock.now() + 15.0)  # without polls the heartbeat has stopped it by now
        for ask in (bench.axis.position_deg, bench.axis.encoder_deg):
            value = bench.timed(ask)
            if isinstance(value, DeviceError):
                counts["errors"] += 1
            elif not bench.axis.unreferenced_reason:
                counts["values"] += 1
                assert value == pytest.approx(bench.angle(), abs=3.0 / PER_DEG)
        if bench.axis.unreferenced_reason:  # as the engine or the operator: connect again, set the position, continue
            for _ in range(20):
                bench.clock.sleep_until(bench.clock.now() + 0.5)
                with contextlib.suppress(DeviceError):
                    bench.recover()
                    break
    faulty = bench.faulty.misfortune
    bench.faulty.misfortune = ScriptedFaults(())
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    bench.recover()
    bench.move(45.0)
    assert bench.axis.position_deg() == pytest.approx(45.0)
    assert bench.angle() == pytest.approx(45.0, abs=2.0 / PER_DEG)
    return counts | {fault.value: faulty.met.count(fault) for fault in set(faulty.met)}


@pytest.mark.parametrize("seed", range(8))
def test_many_faults_give_no_wrong_value(seed: int) -> None:
    counts = storm(seed)
    assert counts["values"] > 0


@pytest.mark.long
def test_a_thousand_wires_with_many_faults_give_no_wrong_value(capsys: pytest.CaptureFixture[str]) -> None:
    total: dict[str, int] = {}
    for seed in range(1000):
        for key, count in storm(seed).items():
            total[key] = total.get(key, 0) + count
    with capsys.disabled():
        print("\naxes:", ", ".join(f"{key} {count}" for key, count in sorted(total.items())))
    assert total["values"] > 10_000
