"""Axes over TMCL, on the virtual module and on a port with scripted replies."""

from collections.abc import Callable

import pytest
import serial

from goniotwin.drivers import (
    AxisSettings,
    BadAnswer,
    DeviceError,
    Forgotten,
    LimitError,
    NoAnswer,
    Refused,
    TmclAxis,
    TmclModule,
    wait,
)
from goniotwin.drivers.errors import Taken
from goniotwin.drivers.motion.tmcl.rules import CANARY, MARKER_VARIABLE, UNREFERENCED
from goniotwin.protocols.clock import Clock, VirtualClock
from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter
from tests.conftest import RigOpener, tmcl_axis
from tests.drivers.axis_bench import AxisBench


def test_nothing_moves_on_connect(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    now = rig.rig.clock.now()
    assert [rig.virtual.plant.angle_deg(axis, now) for axis in ("gamma", "sigma", "beta", "shift")] == [0.0] * 4
    assert not any(shaft.moved_since(now) for shaft in rig.virtual.plant.shafts.values())


def test_an_axis_reaches_its_target(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    beta = tmcl_axis(rig.rig, "beta")
    wait(rig.rig.clock, [beta.start(123.4)])
    now = rig.rig.clock.now()
    assert rig.virtual.plant.angle_deg("beta", now) == pytest.approx(123.4, abs=0.5 / beta.settings.microsteps_per_deg)
    assert beta.position_deg() == pytest.approx(123.4, abs=1e-3)
    assert beta.encoder_deg() == pytest.approx(123.4, abs=0.01)


def test_axes_move_at_the_same_time(opened: RigOpener) -> None:
    rig = opened().rig
    start = rig.clock.now()
    wait(rig.clock, [rig.axes["sigma"].start(60.0), rig.axes["beta"].start(180.0), rig.axes["gamma"].start(180.0)])
    slowest = max(
        float(tmcl_axis(rig, name).settings.ramp_seconds(way))
        for name, way in (("sigma", 60.0), ("beta", 180.0), ("gamma", 180.0))
    )
    assert rig.clock.now() - start == pytest.approx(slowest, abs=0.03)


def test_an_axis_without_encoder_has_no_encoder_position(opened: RigOpener) -> None:
    assert opened().rig.axes["shift"].encoder_deg() is None


@pytest.mark.parametrize("target", [-5.1, 360.5, float("nan")])
def test_a_target_outside_the_soft_limits_sends_nothing(opened: RigOpener, target: float) -> None:
    rig = opened()
    assert rig.virtual is not None
    with pytest.raises(LimitError, match=r"beta.*limits"):
        rig.rig.axes["beta"].start(target)
    assert not rig.virtual.plant.shafts["beta"].moved_since(rig.rig.clock.now())


def test_stop_brings_the_axes_to_rest_over_their_ramps(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    clock = rig.rig.clock
    move = rig.rig.axes["beta"].start(180.0)
    until = clock.now() + 3.0
    while move.due < until:  # a moving axis must be polled because of its module's heartbeat
        clock.sleep_until(move.due)
        assert not move.poll()
    clock.sleep_until(until)
    start = clock.now()
    assert rig.rig.stop() == []
    assert clock.now() - start < 0.2
    clock.sleep_until(start + 1.2)  # 30 deg/s at 30 deg/s^2
    resting = rig.virtual.plant.angle_deg("beta", clock.now())
    assert 60.0 < resting < 120.0
    assert rig.virtual.plant.angle_deg("beta", clock.now() + 100.0) == resting


def test_a_stop_from_elsewhere_is_a_fault_of_the_move(opened: RigOpener) -> None:
    rig = opened().rig
    move = rig.axes["beta"].start(180.0)
    rig.clock.sleep_until(rig.clock.now() + 1.0)
    tmcl_axis(rig, "beta").stop()
    with pytest.raises(DeviceError, match="stopped at"):
        wait(rig.clock, [move])


def test_microsteps_follow_the_sense_the_gear_and_the_offset() -> None:
    settings = AxisSettings(4, 36.0, -10.0, 190.0, 10.0, 10.0, sense=-1, zero_offset_deg=5.0)
    assert settings.counter(15.0) == -51_200  # one turn of the motor is 10 deg, and 51200 microsteps
    assert settings.angle_deg(-51_200) == pytest.approx(15.0)


class ScriptedPort(serial.Serial):
    """A port with a scripted reply to each frame."""

    def __init__(self, clock: Clock, replies: list[bytes]) -> None:
        super().__init__()
        self._clock = clock
        self._replies = replies
        self._waiting = b""
        self.sent: list[bytes] = []
        self.timeout = 0.06

    def write(self, data: object, /) -> int:
        request = CommandFrame.decode(bytes(data))  # type: ignore[call-overload]
        if (request.command, request.type) == (Command.SGP, MARKER_VARIABLE):
            self._waiting += ReplyFrame(2, 1, ReplyStatus.OK, Command.SGP, request.value).encode()
            return 9
        self.sent.append(request.encode())
        if self._replies:
            self._waiting += self._replies.pop(0)
        return 9

    @property
    def in_waiting(self) -> int:
        return len(self._waiting)

    def read(self, size: int = 1, /) -> bytes:
        data, self._waiting = self._waiting[:size], self._waiting[size:]
        if len(data) < size:
            self._clock.sleep_until(self._clock.now() + 0.01)
        return data

    def reset_input_buffer(self) -> None:
        self._waiting = b""

    def close(self) -> None: ...


VERSION_REPLY = ReplyFrame(2, 1, ReplyStatus.OK, Command.FIRMWARE_VERSION, 6214 << 16).encode()
HEARTBEAT_REPLY = ReplyFrame(2, 1, ReplyStatus.OK, Command.GGP, 2000).encode()
CANARY_REPLY = ReplyFrame(2, 1, ReplyStatus.OK, Command.GGP, CANARY).encode()
Module = Callable[..., tuple[TmclModule, ScriptedPort]]


@pytest.fixture
def module() -> Module:
    def connect(*replies: bytes) -> tuple[TmclModule, ScriptedPort]:
        clock = VirtualClock()
        wire = ScriptedPort(clock, [VERSION_REPLY, CANARY_REPLY, HEARTBEAT_REPLY, *replies])
        module = TmclModule(lambda baud, timeout: wire, clock)
        assert module.connect() == 6214
        wire.sent.clear()
        return module, wire

    return connect


def test_a_late_reply_to_another_request_is_discarded(module: Module) -> None:
    late = ReplyFrame(2, 1, ReplyStatus.OK, Command.SAP, 77).encode()
    expected = ReplyFrame(2, 1, ReplyStatus.OK, Command.GAP, 5).encode()
    driver, _ = module(late + expected)
    assert driver.exchange(CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 4)) == 5


def test_a_request_is_repeated_after_a_corrupted_reply(module: Module) -> None:
    good = ReplyFrame(2, 1, ReplyStatus.OK, Command.GAP, 5).encode()
    driver, wire = module(good[:-1] + bytes((good[-1] ^ 1,)), good)
    assert driver.exchange(CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 4)) == 5
    assert len(wire.sent) == 2


@pytest.mark.parametrize("reply", [b"", b"\x02\x01"])
def test_a_relative_move_is_never_sent_twice(module: Module, reply: bytes) -> None:
    driver, wire = module(reply)
    with pytest.raises(NoAnswer):
        driver.exchange(CommandFrame(1, Command.MVP, 1, 4, 100))
    assert len(wire.sent) == 1


def test_a_corrupted_reply_to_a_relative_move_is_an_error(module: Module) -> None:
    good = ReplyFrame(2, 1, ReplyStatus.OK, Command.MVP, 5).encode()
    driver, wire = module(good[:-1] + bytes((good[-1] ^ 1,)))
    with pytest.raises(BadAnswer, match="checksum"):
        driver.exchange(CommandFrame(1, Command.MVP, 1, 4, 100))
    assert len(wire.sent) == 1


def test_a_rejected_request_is_reported_with_its_status(module: Module) -> None:
    driver, _ = module(ReplyFrame(2, 1, ReplyStatus.INVALID_VALUE, Command.SAP, 0).encode())
    with pytest.raises(Refused, match="INVALID_VALUE"):
        driver.exchange(CommandFrame(1, Command.SAP, AxisParameter.MAX_VELOCITY, 4, -1))


def test_the_error_of_a_missing_port_names_the_remedy() -> None:
    def nothing(baudrate: int, timeout_s: float) -> serial.Serial:
        raise serial.SerialException("could not open port COM9")

    with pytest.raises(DeviceError, match=r"COM9.*rig file"):
        TmclModule(nothing, VirtualClock()).connect()


def other_program(bench: AxisBench, session: int) -> TmclModule:
    """Another program that has connected to the controller."""
    other = TmclModule(bench.open_port, bench.clock, session=session)
    other.connect()
    return other


def test_a_program_leaves_the_controller_to_another_one_that_has_taken_it() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    other = other_program(bench, session=77)
    for act in (lambda: bench.axis.start(20.0), bench.axis.position_deg, bench.axis.connect, bench.module.connect):
        with pytest.raises(Taken, match="another program has taken the controller; end that program"):
            act()
    assert bench.angle() == pytest.approx(10.0, abs=0.01)
    other.check_canary(1)  # nothing of it has been overwritten
    bench.axis.stop()  # a stop is sent all the same
    assert TmclAxis("sigma", other, bench.axis.settings, bench.clock).position_deg() == pytest.approx(10.0, abs=0.01)


def test_a_connection_is_not_restored_to_a_controller_that_another_program_has_taken() -> None:
    bench = AxisBench().connect()
    other = other_program(bench, session=77)
    with pytest.raises(Taken):
        bench.module.connect()
    other.check_canary(1)


def test_a_dead_program_leaves_nothing_that_would_have_to_be_released() -> None:
    bench = AxisBench().connect()
    bench.move(10.0)
    axis = TmclAxis("sigma", other_program(bench, session=77), bench.axis.settings, bench.clock)
    axis.connect()
    assert axis.referenced
    assert axis.position_deg() == pytest.approx(10.0, abs=0.01)


def test_a_canary_that_was_corrupted_once_is_no_other_program(module: Module) -> None:
    corrupted = ReplyFrame(2, 1, ReplyStatus.OK, Command.GGP, CANARY ^ 0x0101).encode()
    marks = [ReplyFrame(2, 1, ReplyStatus.OK, Command.SGP, UNREFERENCED).encode()] * 6
    driver, _ = module(corrupted, CANARY_REPLY, *marks)
    with pytest.raises(Forgotten, match="has reset"):
        driver.check_canary(1)
