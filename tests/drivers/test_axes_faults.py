"""Axes on a wire that fails: no wrong value, nothing twice that may happen once, an end in bounded time, and recovery."""

import contextlib

import pytest

from goniotwin.drivers import DeviceError, wait
from goniotwin.drivers.errors import Forgotten, NoAnswer
from goniotwin.mocks.faults import ON_A_SERIAL_LINE, Fault, Misfortune, Script
from goniotwin.mocks.faulty_line import FaultyLine, foreign_tmcl, plug_in
from goniotwin.protocols.tmcl import Command, MoveType, Reply, Request, checksum
from goniotwin.twin.devices.line import SerialDevice
from tests.drivers.axis_bench import DriverBench

PER_DEG = 5120
LONGEST_S = 1.3
"""A call of three exchanges, each with its repetition and its resynchronisations: seven timeouts of 60 ms each."""
REPEATED_AT_ONCE = [each for each in ON_A_SERIAL_LINE if each not in (Fault.HANG, Fault.RESET, Fault.UNPLUGGED)]


class Watched:
    """Counts the commands that reach a device."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.baudrate, self.outbox = device.baudrate, device.outbox
        self.heard: list[Request] = []

    def receive(self, data: bytes, t: float) -> None:
        self.heard.append(Request.decode(data)) if len(data) == 9 and checksum(data[:8]) == data[8] else None
        self.device.receive(data, t)

    def reset(self, t: float) -> None:
        self.device.reset(t)


class Broken(DriverBench):
    """A bench whose wire does what a script or a seed says, once it has been connected."""

    def __init__(self, misfortune: Misfortune, **settings: object) -> None:
        self.misfortune = Script(())
        super().__init__(dict(settings), wire=self._break)
        plug_in(self.faulty, self.clock, lambda end: setattr(self, "device", end))
        self.connect()
        self.clock.sleep_until(self.clock.now() + 0.05)  # so long after the last question none other comes between
        self.faulty.misfortune = misfortune

    def _break(self, device: SerialDevice) -> SerialDevice:
        self.watched = Watched(device)
        self.faulty = FaultyLine(self.watched, Script(()), foreign=foreign_tmcl)
        return self.faulty

    def timed(self, call: object, *arguments: object) -> object:
        """The call's result or its error; it has taken no longer than it may."""
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
        """What a person does: connect again, let the axis come to rest, say where it is. Raises DeviceError."""
        self.connect()
        self.axis.stop()
        self.clock.sleep_until(self.clock.now() + 5.0)
        self.axis.set_position(self.angle())


@pytest.mark.parametrize("fault", REPEATED_AT_ONCE)
def test_a_question_is_repeated_after_any_single_fault(fault: Fault) -> None:
    bench = Broken(Script(()))
    bench.move(12.5)
    bench.faulty.misfortune = Script([fault])
    assert bench.axis.position_deg() == pytest.approx(12.5)
    assert bench.axis.encoder_deg() == pytest.approx(12.5, abs=1e-3)
    assert bench.axis.switches() == bench.axis.switches()


@pytest.mark.parametrize("fault", REPEATED_AT_ONCE)
def test_a_move_arrives_after_any_single_fault_of_its_command(fault: Fault) -> None:
    bench = Broken(Script(()))
    bench.faulty.misfortune = Script([Fault.NONE, Fault.NONE, fault])  # where it is, the canary, the move
    bench.move(12.5)
    assert bench.angle() == pytest.approx(12.5, abs=1.0 / PER_DEG)


@pytest.mark.parametrize("fault", [each for each in ON_A_SERIAL_LINE if each is not Fault.RESET])
def test_a_relative_move_is_heard_once_at_most(fault: Fault) -> None:
    bench = Broken(Script(()))
    bench.faulty.misfortune = Script([Fault.NONE, Fault.NONE, fault])
    outcome = bench.timed(bench.axis.start_relative, 1.0)
    moves = [each for each in bench.watched.heard if each.command == Command.MVP and each.type == MoveType.RELATIVE]
    assert len(moves) <= 1
    if isinstance(outcome, DeviceError):
        assert not bench.axis.referenced
        assert "sigma" in str(outcome) or "axes" in str(outcome)
        bench.clock.sleep_until(bench.clock.now() + 0.5)  # by then a plug is in again
        assert bench.axis.position_deg() == pytest.approx(len(moves), abs=1.0)  # and the driver works again


def test_a_lost_reply_to_an_absolute_move_that_stays_lost_leaves_the_axis_unreferenced() -> None:
    bench = Broken(Script(()))
    bench.faulty.misfortune = Script([Fault.NONE, Fault.NONE, *[Fault.HANG] * 20])
    with pytest.raises(DeviceError, match="MVP"):
        bench.axis.start(12.5)
    assert "received" in bench.axis.unreferenced_reason
    bench.faulty.misfortune = Script(())
    bench.axis.set_position()
    bench.move(12.5)


def test_a_device_that_resets_is_never_believed() -> None:
    for place in range(12):
        bench = Broken(Script(()))
        bench.move(12.5)
        bench.faulty.misfortune = Script([*[Fault.NONE] * place, Fault.RESET])
        with pytest.raises(Forgotten):
            _ask_for_ever(bench)


def _ask_for_ever(bench: Broken) -> None:
    while True:
        assert bench.axis.position_deg() == pytest.approx(12.5)
        assert bench.axis.encoder_deg() == pytest.approx(12.5, abs=1e-3)


def test_a_port_that_is_gone_is_an_error_at_once_and_opened_again_when_it_is_back() -> None:
    bench = Broken(Script(()))
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


def test_a_module_that_was_without_power_while_its_port_was_gone_is_not_believed() -> None:
    bench = Broken(Script(()))
    bench.move(12.5)
    bench.faulty.pull()
    bench.line.reset(bench.clock.now())
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    with pytest.raises(Forgotten):
        bench.axis.position_deg()
    assert not bench.axis.referenced


def test_a_stop_opens_a_port_that_has_failed_and_is_back() -> None:
    bench = Broken(Script(()))
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


def test_error_flags_are_read_once_and_their_loss_is_said() -> None:
    bench = Broken(Script(()))
    bench.faulty.misfortune = Script([Fault.LOST])
    with pytest.raises(DeviceError):
        bench.axis.read_errors()
    assert "error flags" in bench.axis.unreferenced_reason


def test_of_two_wrong_bytes_the_checksum_passes_one_in_255() -> None:
    """A sum: whatever the first is wrong by, one of the 255 wrong values of the second makes up for it."""
    frame = Reply(2, 1, 100, Command.GAP, 64_000).encode()
    passed = 0
    for first in range(1, 256):
        for second in range(1, 256):
            wrong = bytes((*frame[:5], frame[5] ^ first, frame[6], frame[7] ^ second))
            passed += checksum(wrong) == frame[8]
    assert passed == 255  # of 255 * 255


def test_unasked_frames_are_not_believed() -> None:
    bench = DriverBench().connect()
    bench.move(10.0)
    bench.module.exchange(Request(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4))
    for k in range(5):
        bench.move(10.0 + k)
        assert bench.axis.position_deg() == pytest.approx(10.0 + k)


def test_another_hosts_replies_are_not_believed() -> None:
    bench = DriverBench().connect()
    for host, address in ((3, 1), (2, 9)):
        bench.line.outbox.append((bench.clock.now() + 1e-3, Reply(host, address, 100, Command.GAP, 77_777).encode()))
        assert bench.axis.position_deg() == 0.0


def storm(seed: int, steps: int = 30, share: float = 0.15) -> dict[str, int]:
    """Moves and questions on a wire that fails; every value that is returned is the truth. Counts what happened."""
    bench = Broken(Misfortune(seed, ON_A_SERIAL_LINE, share))
    happened = {"values": 0, "errors": 0}
    for step in range(steps):
        target = float((seed * 7 + step * 13) % 90)
        outcome = bench.timed(bench.axis.start, target)
        if not isinstance(outcome, DeviceError):
            try:
                wait(bench.clock, [outcome])  # type: ignore[list-item]
                assert bench.angle() == pytest.approx(target, abs=2.0 / PER_DEG)
            except DeviceError:
                happened["errors"] += 1
                bench.clock.sleep_until(bench.clock.now() + 15.0)  # nobody polls it any more: by now it rests
        for ask in (bench.axis.position_deg, bench.axis.encoder_deg):
            value = bench.timed(ask)
            if isinstance(value, DeviceError):
                happened["errors"] += 1
            elif not bench.axis.unreferenced_reason:
                happened["values"] += 1
                assert value == pytest.approx(bench.angle(), abs=3.0 / PER_DEG)
        if bench.axis.unreferenced_reason:  # the engine or a person: connect again, look, go on
            for _ in range(20):
                bench.clock.sleep_until(bench.clock.now() + 0.5)
                with contextlib.suppress(DeviceError):
                    bench.recover()
                    break
    faulty = bench.faulty.misfortune
    bench.faulty.misfortune = Script(())
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    bench.recover()
    bench.move(45.0)
    assert bench.axis.position_deg() == pytest.approx(45.0)
    assert bench.angle() == pytest.approx(45.0, abs=2.0 / PER_DEG)
    return happened | {fault.value: faulty.met.count(fault) for fault in set(faulty.met)}


@pytest.mark.parametrize("seed", range(50))
def test_in_a_storm_of_faults_every_value_is_the_truth(seed: int) -> None:
    happened = storm(seed)
    assert happened["values"] > 0


@pytest.mark.long
def test_in_a_thousand_storms(capsys: pytest.CaptureFixture[str]) -> None:
    total: dict[str, int] = {}
    for seed in range(1000):
        for key, count in storm(seed).items():
            total[key] = total.get(key, 0) + count
    with capsys.disabled():
        print("\naxes:", ", ".join(f"{key} {count}" for key, count in sorted(total.items())))
    assert total["values"] > 10_000
