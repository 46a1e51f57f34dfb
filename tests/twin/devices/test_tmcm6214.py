"""The virtual motion module, by its frames."""

import pytest

from goniotwin.app.rig import OpenRig
from goniotwin.protocols.tmcl import Command, CommandFrame, MoveType, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter, GlobalParameter
from goniotwin.twin.devices import TmclLine
from tests.conftest import RigOpener

SIGMA = 4


@pytest.fixture
def module(opened: RigOpener) -> TmclLine:
    rig: OpenRig = opened(("noise = true", "noise = false"))
    assert rig.virtual is not None
    device = rig.virtual.serial["axes"]
    assert isinstance(device, TmclLine)
    value(device, Command.SGP, GlobalParameter.HEARTBEAT, bank=0)  # the driver has set it, and these tests are slower
    return device


def ask(module: TmclLine, request: CommandFrame | bytes, t: float) -> bytes:
    module.receive(request if isinstance(request, bytes) else request.encode(), t)
    _, answer = module.outbox.popleft()
    return answer


def value(module: TmclLine, command: Command, kind: int, number: int = 0, t: float = 100.0, bank: int = SIGMA) -> int:
    reply = ReplyFrame.decode(ask(module, CommandFrame(1, command, kind, bank, number), t))
    assert reply.status == ReplyStatus.OK
    return reply.value


def test_the_module_identifies_itself(module: TmclLine) -> None:
    assert ask(module, bytes.fromhex("01 88 00 00 00 00 00 00 89"), 100.0) == b"\x026214V117"
    assert value(module, Command.FIRMWARE_VERSION, 1) == 6214 << 16 | 1 << 8 | 17


def test_a_move_follows_its_ramp_and_reports_its_arrival(module: TmclLine) -> None:
    value(module, Command.SAP, AxisParameter.UNIT_MODE, 1)
    for parameter in (AxisParameter.MAX_VELOCITY, AxisParameter.MAX_ACCELERATION, AxisParameter.MAX_DECELERATION):
        value(module, Command.SAP, parameter, 10_000)
    assert value(module, Command.MVP, MoveType.ABSOLUTE, 20_000) == 20_000
    # A trapezoid: 1 s up, 1 s along, 1 s down.
    assert value(module, Command.GAP, AxisParameter.ACTUAL_POSITION, t=101.0) == 5_000
    assert value(module, Command.GAP, AxisParameter.ACTUAL_VELOCITY, t=101.5) == 10_000
    assert value(module, Command.GAP, AxisParameter.POSITION_REACHED, t=102.9) == 0
    assert value(module, Command.GAP, AxisParameter.POSITION_REACHED, t=103.01) == 1
    assert value(module, Command.GAP, AxisParameter.ACTUAL_VELOCITY, t=103.01) == 0
    assert value(module, Command.MVP, MoveType.RELATIVE, -20_000, t=104.0) == 0


def test_a_stop_brakes_and_leaves_the_target_alone(module: TmclLine) -> None:
    value(module, Command.SAP, AxisParameter.UNIT_MODE, 1)
    for parameter in (AxisParameter.MAX_VELOCITY, AxisParameter.MAX_ACCELERATION, AxisParameter.MAX_DECELERATION):
        value(module, Command.SAP, parameter, 10_000)
    value(module, Command.MVP, MoveType.ABSOLUTE, 200_000)
    value(module, Command.MST, 0, t=105.0)
    assert value(module, Command.GAP, AxisParameter.ACTUAL_VELOCITY, t=106.01) == 0
    assert value(module, Command.GAP, AxisParameter.ACTUAL_POSITION, t=107.0) == 50_000
    assert value(module, Command.GAP, AxisParameter.TARGET_POSITION, t=107.0) == 200_000
    assert value(module, Command.GAP, AxisParameter.POSITION_REACHED, t=107.0) == 0


def test_writing_the_position_moves_nothing(opened: RigOpener) -> None:
    rig = opened(("noise = true", "noise = false"))
    assert rig.virtual is not None
    module = rig.virtual.serial["axes"]
    assert isinstance(module, TmclLine)
    value(module, Command.MVP, MoveType.ABSOLUTE, 51_200)
    there = rig.virtual.plant.angle_deg("sigma", 200.0)
    value(module, Command.SAP, AxisParameter.ACTUAL_POSITION, 0, t=200.0)
    value(module, Command.SAP, AxisParameter.MICROSTEP_RESOLUTION, 4, t=201.0)
    assert rig.virtual.plant.angle_deg("sigma", 202.0) == pytest.approx(there)
    assert value(module, Command.GAP, AxisParameter.ACTUAL_POSITION, t=202.0) == 0
    assert there == pytest.approx(10.0)  # 51200 microsteps are a turn of the motor, the gear is 36


def test_the_same_resolution_again_shifts_nothing(opened: RigOpener) -> None:
    """A driver writes its settings at each start. The motor may have been stopped between two microsteps, or be on its ramp."""
    rig = opened(("noise = true", "noise = false"))
    assert rig.virtual is not None
    module = rig.virtual.serial["axes"]
    assert isinstance(module, TmclLine)
    value(module, Command.MVP, MoveType.ABSOLUTE, 153_600, t=100.0)
    value(module, Command.MST, 0, t=101.2345)
    for t in (101.3, 150.0):
        resting = rig.virtual.plant.angle_deg("sigma", 200.0)
        assert resting * 5120.0 != pytest.approx(round(resting * 5120.0), abs=0.01)
        value(module, Command.SAP, AxisParameter.MICROSTEP_RESOLUTION, 8, t=t)
        assert rig.virtual.plant.angle_deg("sigma", 200.0) == resting
    value(module, Command.MVP, MoveType.ABSOLUTE, 153_600, t=210.0)
    assert rig.virtual.plant.angle_deg("sigma", 300.0) == pytest.approx(30.0, abs=1e-12)


@pytest.mark.parametrize(
    ("request_", "status"),
    [
        (CommandFrame(1, 77, 0, 0), ReplyStatus.INVALID_COMMAND),
        (CommandFrame(1, Command.GAP, 99, 0), ReplyStatus.WRONG_TYPE),
        (CommandFrame(1, Command.GAP, AxisParameter.ENCODER_POSITION, 0), ReplyStatus.WRONG_TYPE),  # the shift has no encoder
        (CommandFrame(1, Command.GAP, 1, 6), ReplyStatus.INVALID_VALUE),
        (CommandFrame(1, Command.SAP, AxisParameter.MICROSTEP_RESOLUTION, 0, 9), ReplyStatus.INVALID_VALUE),
        (CommandFrame(1, Command.MVP, 7, 0), ReplyStatus.WRONG_TYPE),
        (CommandFrame(1, Command.GGP, 99, 0), ReplyStatus.WRONG_TYPE),
    ],
)
def test_what_it_does_not_know_it_refuses(module: TmclLine, request_: CommandFrame, status: ReplyStatus) -> None:
    reply = ReplyFrame.decode(ask(module, request_, 100.0))
    assert reply == ReplyFrame(2, 1, status, request_.command, 0)


def test_a_wrong_checksum_is_reported(module: TmclLine) -> None:
    reply = ReplyFrame.decode(ask(module, bytes.fromhex("01 06 08 03 00 00 00 00 13"), 100.0))
    assert reply.status == ReplyStatus.WRONG_CHECKSUM


def test_a_partial_frame_is_forgotten_after_a_pause(module: TmclLine) -> None:
    frame = CommandFrame(1, Command.GAP, AxisParameter.POSITION_REACHED, SIGMA).encode()
    module.receive(frame[:4], 100.0)
    assert not module.outbox
    assert ReplyFrame.decode(ask(module, frame, 100.2)).status == ReplyStatus.OK


def test_a_frame_in_pieces_is_one_frame(module: TmclLine) -> None:
    frame = CommandFrame(1, Command.GAP, AxisParameter.POSITION_REACHED, SIGMA).encode()
    module.receive(frame[:4], 100.0)
    module.receive(frame[4:], 100.001)
    assert len(module.outbox) == 1
