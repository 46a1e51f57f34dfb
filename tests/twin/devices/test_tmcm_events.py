"""Command 138: the only unsolicited frame of a module, sent when the motors are at their targets."""

import pytest

from goniotwin.protocols.tmcl import Command, CommandFrame, ReplyFrame, ReplyStatus
from goniotwin.protocols.tmcl_parameters import AxisParameter
from tests.twin.devices.tmcl_bench import Bench


def test_arrival_is_reported_on_request() -> None:
    bench = Bench()
    request = CommandFrame(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4)
    first, second = (ReplyFrame.decode(data) for data in bench.frames(request, 0.5))
    assert (first.status, second.status) == (ReplyStatus.OK, ReplyStatus.TARGET_REACHED)  # it is at its target
    bench.line.receive(request.encode(), 1.0)
    bench.line.receive(bytes.fromhex("01 04 00 04 00 00 4e 20 77"), 1.0)  # MVP ABS 20000: three seconds
    assert ReplyFrame.decode(bench.line.outbox.popleft()[1]).command == Command.REQUEST_TARGET_REACHED
    (_, reply), (when, event) = bench.line.outbox
    assert ReplyFrame.decode(reply) == ReplyFrame(2, 1, ReplyStatus.OK, Command.MVP, 20_000)
    assert when == pytest.approx(4.0)
    assert ReplyFrame.decode(event) == ReplyFrame(2, 1, ReplyStatus.TARGET_REACHED, Command.REQUEST_TARGET_REACHED, 1 << 4)
    bench.line.receive(bytes.fromhex("01 03 00 04 00 00 00 00 08"), 2.0)  # stopped, it will not arrive
    assert [ReplyFrame.decode(data).command for _, data in bench.line.outbox] == [Command.MVP, Command.MST]


def test_arrival_is_reported_once() -> None:
    """One request, one frame: neither queries nor another target cause a second one."""
    bench = Bench()
    bench.line.receive(CommandFrame(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4).encode(), 0.5)
    bench.line.outbox.clear()
    assert bench.get(AxisParameter.POSITION_REACHED, 1.0) == 1
    assert bench.go(20_000, 1.1) == 20_000
    assert bench.get(AxisParameter.POSITION_REACHED, 9.0) == 1


def test_queries_before_arrival_do_not_consume_the_request() -> None:
    bench = Bench()
    bench.go(20_000, 0.9)
    bench.line.receive(CommandFrame(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4).encode(), 1.0)
    for k in range(3):
        bench.line.receive(CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 4, 0).encode(), 1.5 + 0.1 * k)
    times = [when for when, data in bench.line.outbox if ReplyFrame.decode(data).status == ReplyStatus.TARGET_REACHED]
    assert times == [pytest.approx(3.9)]


def test_continuous_queries_do_not_delay_the_report() -> None:
    bench = Bench()
    bench.line.receive(CommandFrame(1, Command.REQUEST_TARGET_REACHED, 0, 0, 1 << 4).encode(), 0.5)
    for k in range(20):
        bench.line.receive(CommandFrame(1, Command.GAP, AxisParameter.ACTUAL_POSITION, 4, 0).encode(), 0.501 + 1e-3 * k)
    times = [when for when, data in bench.line.outbox if ReplyFrame.decode(data).status == ReplyStatus.TARGET_REACHED]
    assert times == [pytest.approx(0.502)]
