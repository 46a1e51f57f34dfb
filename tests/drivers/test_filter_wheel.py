"""The filter wheel: the filter of a wavelength, and the driver that turns to it."""

import contextlib

import numpy as np
import pytest

from goniotwin.drivers import DeviceError, FilterWheel, NoAnswer, OrderFilter, Refused, wait
from goniotwin.drivers.errors import Interrupted
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, ScriptedFaults
from tests.conftest import RigOpener
from tests.drivers.monochromator_bench import DIALECTS, MonochromatorBench

WHEEL = FilterWheel(
    (
        OrderFilter(1, "open", 380.0, 550.0),
        OrderFilter(4, "GG495", 550.0, 650.0, 495.0),
        OrderFilter(2, "RG610", 650.0, 780.0, 610.0),
    )
)


def record_lines(bench: MonochromatorBench) -> list[str]:
    """Lines that the unit receives from now on."""
    lines: list[str] = []
    receive = bench.unit.receive

    def record(data: bytes, t: float) -> None:
        lines.append(data.decode("ascii").strip())
        receive(data, t)

    bench.unit.receive = record  # type: ignore[method-assign]
    return lines


def test_the_filter_is_a_function_of_the_wavelength() -> None:
    filters = [WHEEL.at(nm) for nm in (380.0, 549.999, 550.0, 649.0, 650.0, 780.0)]
    assert [each.position for each in filters if each is not None] == [1, 1, 4, 4, 2, 2]
    assert WHEEL.positions(np.array([780.0, 380.0, 600.0])).tolist() == [2, 1, 4]
    assert FilterWheel().at(500.0) is None
    assert not FilterWheel()
    assert FilterWheel().numbers(np.array([380.0, 780.0])).tolist() == [0, 0]


def test_a_filter_blocks_wavelengths_below_its_cut_on() -> None:
    clear, yellow, _ = WHEEL.filters
    assert not clear.blocks(380.0)
    assert yellow.blocks(494.9)
    assert not yellow.blocks(495.0)


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_a_turn_takes_its_time_per_position_without_a_timeout(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    before = bench.clock.now()
    wait(bench.clock, [bench.driver.start_filter(6)])
    assert bench.clock.now() - before == pytest.approx(5.0, abs=0.25)  # a second per position, and the exchanges
    assert bench.driver.filter() == bench.plant.filter_position(bench.clock.now()) == 6
    assert list(bench.driver.events) == []


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_nothing_is_sent_if_the_wheel_is_at_the_position_already(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    lines = record_lines(bench)
    for position in (1, 3, 3):
        wait(bench.clock, [bench.driver.start_filter(position)])
    assert [line for line in lines if line.startswith("FILTER ")] == ["FILTER 3"]
    assert not bench.driver.moving


def test_a_unit_without_a_wheel_is_an_error(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened, filters=0)
    with pytest.raises(DeviceError, match=r"monochromator: turn the filter wheel to 2: it has no filter wheel; remove mono"):
        bench.driver.start_filter(2)
    bench.go(600.0)


def test_motions_started_meanwhile_wait_and_all_are_confirmed(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    lines = record_lines(bench)
    before = bench.clock.now()
    wait(bench.clock, [bench.driver.start_filter(3), bench.driver.start_wavelength(725.0), bench.driver.start_filter(2)])
    assert bench.clock.now() - before == pytest.approx(2.0 + 1.1 + 1.0, abs=0.4)
    assert [line for line in lines if not line.endswith("?")] == ["FILTER 3", "GOWAVE 725.000", "FILTER 2"]
    assert lines[-1] == "FILTER?"
    assert (bench.true_wavelength_nm(), bench.driver.filter()) == (725.0, 2)
    assert list(bench.driver.events) == []


def test_a_failure_is_reported_by_its_own_motion_though_the_next_one_has_polled_it(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    wheel = bench.driver.start_filter(9)
    slew = bench.driver.start_wavelength(600.0)
    wait(bench.clock, [slew])
    for _ in range(2):
        with pytest.raises(Refused, match="destination not allowed"):
            wheel.poll()


def test_a_stop_between_query_and_command_leaves_the_wheel_at_rest(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    lines = record_lines(bench)
    bench.clock.at(bench.clock.now() + 0.005, bench.driver.stop)  # the reply takes 20 ms
    with pytest.raises(Interrupted):
        bench.driver.start_filter(4)
    assert set(lines) == {"FILTER?"}
    assert bench.plant.filter_position(bench.clock.now() + 10.0) == 1


def test_a_stopped_wheel_reports_its_true_position(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    turn = bench.driver.start_filter(6)
    bench.clock.at(bench.clock.now() + 2.2, bench.driver.stop)
    with pytest.raises(DeviceError, match="aborted"):
        wait(bench.clock, [turn])
    assert bench.driver.filter() == bench.plant.filter_position(bench.clock.now() + 10.0) == 3
    wait(bench.clock, [bench.driver.start_filter(6)])
    assert bench.driver.filter() == 6


@pytest.mark.parametrize(
    ("echo", "handshake"),
    [pytest.param(*each, marks=[] if each[0] is each[1] else pytest.mark.long) for each in DIALECTS],
)
@pytest.mark.parametrize("fault", ON_A_TEXT_LINE)
def test_a_turn_reaches_its_position_or_is_an_error_under_each_fault(
    opened: RigOpener, fault: Fault, echo: bool, handshake: bool
) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    for clean in range(4):  # the fault is at the queries before, at the command, or at the exchange after
        for position in (5, 2):
            bench.set_faults(ScriptedFaults([*[Fault.NONE] * clean, fault], clean))
            start = bench.clock.now()
            with contextlib.suppress(DeviceError):
                wait(bench.clock, [bench.driver.start_filter(position)])
                assert bench.plant.filter_position(bench.clock.now()) == position
            assert bench.clock.now() - start < 60.0
            bench.set_faults(ScriptedFaults([]))
            with contextlib.suppress(DeviceError):  # an error that is still pending is raised here
                bench.driver.wavelength_nm()
            bench.clock.sleep_until(bench.clock.now() + 10.0)
    with contextlib.suppress(DeviceError):
        bench.driver.wavelength_nm()
    wait(bench.clock, [bench.driver.start_filter(4)])
    assert bench.plant.filter_position(bench.clock.now()) == 4


def test_a_wheel_that_does_not_turn_is_an_error(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.plant.wheel.slew = lambda start, end, value: None  # type: ignore[method-assign]
    with pytest.raises(NoAnswer, match="FILTER 4: it is not at its target"):
        wait(bench.clock, [bench.driver.start_filter(4)])
