"""The manufacturer's own client, PyTrinamic, against the virtual module: its bytes in, the module's bytes out."""

from typing import Any

import pytest
from pytrinamic.connections.tmcl_interface import TmclInterface
from pytrinamic.modules import TMCM1240, TMCM6214
from pytrinamic.tmcl import GetInfoNotAvailableError, TMCLCommand, TMCLReplyChecksumError, TMCLReplyStatusError

from goniotwin.protocols.tmcl_parameters import SearchMode
from goniotwin.twin.devices import TmclLine
from goniotwin.twin.plant import AxisController
from tests.twin.devices.tmcl_bench import PER_DEG, Bench

MOTOR = 4


class Wire(TmclInterface):  # type: ignore[misc]
    """PyTrinamic's connection to a twin device; `t` is the time of the clock."""

    def __init__(self, line: TmclLine) -> None:
        super().__init__()
        self.line = line
        self.t = 10.0

    def _send(self, host_id: int, module_id: int, data: bytes) -> None:
        self.t += 0.002
        self.line.receive(bytes(data), self.t)

    def _recv(self, host_id: int, module_id: int) -> bytes:
        if not self.line.outbox:
            raise RuntimeError("no reply")
        return self.line.outbox.popleft()[1]

    def _reply_check(self, reply: Any) -> None:
        if not reply.is_checksum_correct():
            raise TMCLReplyChecksumError(reply)


@pytest.fixture
def bench() -> Bench:
    return Bench(home_deg=2.0, upper_switch_deg=20.0)


@pytest.fixture
def wire(bench: Bench) -> Wire:
    return Wire(bench.line)


def test_the_module_identifies_itself(wire: Wire) -> None:
    assert wire.get_version_string() == "6214V117"
    with pytest.raises(GetInfoNotAvailableError):
        wire.get_info("FWModuleID")


def test_an_axis_is_set_up_moved_and_read(bench: Bench, wire: Wire) -> None:
    motor = TMCM6214(wire).motors[MOTOR]
    motor.set_axis_parameter(motor.AP.UnitMode, 1)
    motor.linear_ramp.max_velocity = 20_000
    motor.linear_ramp.max_acceleration = 40_000
    motor.drive_settings.max_current = 100
    motor.drive_settings.standby_current = 10
    motor.drive_settings.microstep_resolution = motor.ENUM.MicrostepResolution256Microsteps
    assert (motor.linear_ramp.max_velocity, motor.drive_settings.max_current) == (20_000, 100)
    motor.move_to(-51_200)
    assert motor.target_position == -51_200
    assert motor.get_position_reached() == 0
    wire.t += 1.0
    assert motor.actual_velocity == -20_000
    wire.t += 10.0
    assert (motor.actual_position, motor.get_position_reached()) == (-51_200, 1)
    assert bench.angle(wire.t) == pytest.approx(-10.0)
    assert motor.get_axis_parameter(motor.AP.EncoderPosition, signed=True) == pytest.approx(-51_200, abs=1)
    motor.move_by(200)
    wire.t += 1.0
    assert motor.actual_position == -51_000


def test_turning_and_stopping(wire: Wire) -> None:
    motor = TMCM6214(wire).motors[MOTOR]
    motor.rotate(-1_000)
    wire.t += 1.0
    assert motor.actual_velocity == -1_000
    motor.stop()
    wire.t += 1.0
    assert motor.actual_velocity == 0


def test_every_axis_parameter_of_its_map_has_an_answer(wire: Wire) -> None:
    motor = TMCM6214(wire).motors[MOTOR]
    for name, number in vars(motor.AP).items():
        if isinstance(number, int):
            assert isinstance(motor.get_axis_parameter(number), int), name


def test_every_axis_parameter_of_the_other_module_has_one_too() -> None:
    bench = Bench(AxisController(kind="tmcm-1240"), motor=0)
    motor = TMCM1240(Wire(bench.line)).motors[0]
    for name, number in vars(motor.AP).items():
        if isinstance(number, int):
            assert isinstance(motor.get_axis_parameter(number), int), name
    assert motor.get_axis_parameter(motor.AP.ActualPosition) == 0


def test_every_global_parameter_of_its_map_has_one_too(wire: Wire) -> None:
    for bank, numbers in ((0, TMCM6214.GP0), (3, TMCM6214.GP3)):
        for name, number in vars(numbers).items():
            if isinstance(number, int):
                assert isinstance(wire.get_global_parameter(number, bank), int), name
    wire.set_and_store_global_parameter(10, 2, 1234)
    wire.line.reset(wire.t)
    assert wire.get_global_parameter(10, 2) == 1234


def test_a_reference_search(bench: Bench, wire: Wire) -> None:
    motor = TMCM6214(wire).motors[MOTOR]
    motor.set_axis_parameter(motor.AP.ReferenceSearchMode, SearchMode.HOME_POSITIVE_NO_STOPS)
    wire.reference_search(0, MOTOR)
    assert wire.reference_search(2, MOTOR) != 0
    wire.t += 600.0
    assert wire.reference_search(2, MOTOR) == 0
    assert motor.actual_position == 0
    assert bench.angle(wire.t) == pytest.approx(2.0, abs=2.0 / PER_DEG)
    assert motor.get_axis_parameter(motor.AP.LastReferencePosition, signed=True) == pytest.approx(2 * PER_DEG, abs=2)


def test_its_errors_are_its_own(wire: Wire) -> None:
    with pytest.raises(TMCLReplyStatusError):
        wire.get_axis_parameter(99, MOTOR)
    with pytest.raises(TMCLReplyStatusError):
        wire.send(TMCLCommand.MVP, 0, 9, 0)
    assert wire.get_analog_input(8) == 240
