"""The filter wheel: which filter belongs to which wavelength, and how the driver turns to it."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.drivers import DeviceError, FilterWheel, NoAnswer, OrderFilter, Refused, wait
from goniotwin.drivers.errors import Interrupted
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, Script
from tests.conftest import RigOpener
from tests.drivers.monochromator_bench import DIALECTS, Bench

WHEEL = FilterWheel(
    (OrderFilter(1, "open", 380.0), OrderFilter(4, "GG495", 550.0, 495.0), OrderFilter(2, "RG610", 650.0, 610.0))
)


def told(bench: Bench) -> list[str]:
    """The lines that the unit hears from now on."""
    lines: list[str] = []
    receive = bench.unit.receive

    def noting(data: bytes, t: float) -> None:
        lines.append(data.decode("ascii").strip())
        receive(data, t)

    bench.unit.receive = noting  # type: ignore[method-assign]
    return lines


def test_the_filter_is_a_function_of_the_wavelength() -> None:
    found = [WHEEL.at(nm) for nm in (380.0, 549.999, 550.0, 649.0, 650.0, 780.0)]
    assert [each.position for each in found if each is not None] == [1, 1, 4, 4, 2, 2]
    assert WHEEL.positions(np.array([780.0, 380.0, 600.0])).tolist() == [2, 1, 4]
    assert FilterWheel().at(500.0) is None
    assert not FilterWheel()
    assert FilterWheel().numbers(np.array([380.0, 780.0])).tolist() == [0, 0]


def test_a_filter_is_known_to_hold_back_what_is_below_its_cut_on() -> None:
    clear, yellow, _ = WHEEL.filters
    assert not clear.blocks(380.0)
    assert yellow.blocks(494.9)
    assert not yellow.blocks(495.0)


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_it_takes_its_time_for_each_position_and_is_not_given_up_meanwhile(
    opened: RigOpener, echo: bool, handshake: bool
) -> None:
    bench = Bench(opened, echo, handshake)
    before = bench.clock.now()
    wait(bench.clock, [bench.driver.start_filter(6)])
    assert bench.clock.now() - before == pytest.approx(5.0, abs=0.25)  # a second each, and words
    assert bench.driver.filter() == bench.plant.filter_position(bench.clock.now()) == 6
    assert list(bench.driver.events) == []


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_where_it_is_already_nothing_is_sent(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = Bench(opened, echo, handshake)
    lines = told(bench)
    for position in (1, 3, 3):
        wait(bench.clock, [bench.driver.start_filter(position)])
    assert [line for line in lines if line.startswith("FILTER ")] == ["FILTER 3"]
    assert not bench.driver.moving


def test_a_unit_without_a_wheel_is_told_apart(opened: RigOpener) -> None:
    bench = Bench(opened)
    bench.unit._statements._drive = replace(bench.unit._statements._drive, filters=0)
    with pytest.raises(DeviceError, match=r"monochromator: turn the filter wheel to 2: it has no filter wheel; remove mono"):
        bench.driver.start_filter(2)
    bench.go(600.0)


def test_what_is_started_after_it_waits_for_it_and_both_are_confirmed(opened: RigOpener) -> None:
    bench = Bench(opened)
    lines = told(bench)
    before = bench.clock.now()
    wait(bench.clock, [bench.driver.start_filter(3), bench.driver.start_wavelength(725.0), bench.driver.start_filter(2)])
    assert bench.clock.now() - before == pytest.approx(2.0 + 1.1 + 1.0, abs=0.4)
    assert [line for line in lines if not line.endswith("?")] == ["FILTER 3", "GOWAVE 725.000", "FILTER 2"]
    assert lines[-1] == "FILTER?"
    assert (bench.light_nm(), bench.driver.filter()) == (725.0, 2)
    assert list(bench.driver.events) == []


def test_a_failure_is_told_to_who_waits_for_it_though_what_came_after_has_heard_it_first(opened: RigOpener) -> None:
    bench = Bench(opened)
    wheel = bench.driver.start_filter(9)
    slew = bench.driver.start_wavelength(600.0)
    wait(bench.clock, [slew])
    for _ in range(2):
        with pytest.raises(Refused, match="destination not allowed"):
            wheel.poll()


def test_a_stop_between_the_question_and_the_order_leaves_the_wheel_alone(opened: RigOpener) -> None:
    bench = Bench(opened)
    lines = told(bench)
    bench.clock.at(bench.clock.now() + 0.005, bench.driver.stop)  # the answer takes 20 ms
    with pytest.raises(Interrupted):
        bench.driver.start_filter(4)
    assert set(lines) == {"FILTER?"}
    assert bench.plant.filter_position(bench.clock.now() + 10.0) == 1


def test_it_is_stopped_on_its_way_and_stands_where_it_says(opened: RigOpener) -> None:
    bench = Bench(opened)
    turn = bench.driver.start_filter(6)
    bench.clock.at(bench.clock.now() + 2.2, bench.driver.stop)
    with pytest.raises(DeviceError, match="aborted"):
        wait(bench.clock, [turn])
    assert bench.driver.filter() == bench.plant.filter_position(bench.clock.now() + 10.0) == 3
    wait(bench.clock, [bench.driver.start_filter(6)])
    assert bench.driver.filter() == 6


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
@pytest.mark.parametrize("fault", ON_A_TEXT_LINE)
def test_under_each_fault_it_is_where_it_is_said_to_be_or_that_is_told(
    opened: RigOpener, fault: Fault, echo: bool, handshake: bool
) -> None:
    bench = Bench(opened, echo, handshake)
    for clean in range(4):  # it meets the questions before, the order, what comes after
        for position in (5, 2):
            bench.misfortune(Script([*[Fault.NONE] * clean, fault], clean))
            start = bench.clock.now()
            with contextlib.suppress(DeviceError):
                wait(bench.clock, [bench.driver.start_filter(position)])
                assert bench.plant.filter_position(bench.clock.now()) == position
            assert bench.clock.now() - start < 60.0
            bench.misfortune(Script([]))
            with contextlib.suppress(DeviceError):  # what was still lost is found out here
                bench.driver.wavelength_nm()
            bench.clock.sleep_until(bench.clock.now() + 10.0)
    with contextlib.suppress(DeviceError):
        bench.driver.wavelength_nm()
    wait(bench.clock, [bench.driver.start_filter(4)])
    assert bench.plant.filter_position(bench.clock.now()) == 4


def test_a_wheel_that_sticks_is_no_success(opened: RigOpener) -> None:
    bench = Bench(opened)
    bench.plant.wheel.slew = lambda start, end, value: None  # type: ignore[method-assign]
    with pytest.raises(NoAnswer, match="FILTER 4: it is not at its target"):
        wait(bench.clock, [bench.driver.start_filter(4)])
