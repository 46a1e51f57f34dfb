"""The monochromator on a wire with faults: no wrong value, no repeated step, bounded time, recovery."""

import contextlib

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, wait
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, FaultPlan, ScriptedFaults
from goniotwin.protocols.cornerstone import Grating
from goniotwin.twin.devices import Cornerstone260
from tests.conftest import RigOpener
from tests.drivers.bounded_calls import BoundedCalls
from tests.drivers.monochromator_bench import DIALECTS, MonochromatorBench

DIALECTS_AND_LATE = [
    pytest.param(echo, handshake, late_s, marks=[] if (late_s > 1.0) is (echo is handshake) else pytest.mark.long)
    for late_s in (0.1, 5.0)
    for echo, handshake in DIALECTS
]
"""Each dialect with one time of a late reply, and with the other in the long run."""


@pytest.mark.parametrize(("echo", "handshake", "late_s"), DIALECTS_AND_LATE)
@pytest.mark.parametrize("fault", ON_A_TEXT_LINE)
def test_a_relative_step_is_made_once_at_most_under_each_fault(
    opened: RigOpener, fault: Fault, echo: bool, handshake: bool, late_s: float
) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    for clean in range(3):  # the fault is at the query before, at the statement, or at the exchange after
        before = bench.true_wavelength_nm()
        bench.set_faults(ScriptedFaults([*[Fault.NONE] * clean, fault]), late_s)
        start = bench.clock.now()
        with contextlib.suppress(DeviceError):
            wait(bench.clock, [bench.driver.start_step(100)])
            assert bench.true_wavelength_nm() == pytest.approx(before + 1.0)
        assert bench.clock.now() - start < 60.0
        bench.clock.sleep_until(bench.clock.now() + 20.0)
        assert bench.true_wavelength_nm() == pytest.approx(before) or bench.true_wavelength_nm() == pytest.approx(before + 1.0)
        with contextlib.suppress(DeviceError):  # an error that is still pending is raised here
            bench.driver.wavelength_nm()
    with contextlib.suppress(DeviceError):
        bench.go(640.0)
    bench.go(650.0)
    assert bench.true_wavelength_nm() == 650.0


LONGEST_S = 6.0
"""A call on a line that is out of step: the line is drained, resynchronised with six queries, and used for one more; the
first of these without reply within a second ends the call."""


def storm(bench: MonochromatorBench, seed: int) -> BoundedCalls:
    """A fifth of all exchanges fail; every returned value is true. Then no exchange fails, and the driver recovers."""
    bench.set_faults(FaultPlan(seed, ON_A_TEXT_LINE, until=150), (0.1, 1.5, 5.0)[seed % 3])
    calls = BoundedCalls(bench.clock, "monochromator", LONGEST_S)
    driver = bench.driver
    for wavelength in (400.0, 725.0, 633.1, 550.0, 612.34):
        start = bench.clock.now()
        with calls.attempt():
            with calls.call():
                move = driver.start_wavelength(wavelength)
            calls.wait(move)
            assert bench.true_wavelength_nm() == pytest.approx(wavelength, abs=0.011)
        assert bench.clock.now() - start < 60.0
        opened_now = wavelength > 600.0
        with calls.attempt():
            with calls.call():
                move = driver.start_shutter(opened=opened_now)
            calls.wait(move)
            assert bench.plant.shutter_open.at(bench.clock.now()) is opened_now
        for _ in range(3):
            with calls.attempt(), calls.call():
                assert driver.wavelength_nm() == pytest.approx(bench.true_wavelength_nm(), abs=0.001)
            with calls.attempt(), calls.call():
                assert driver.grating() == Grating(1, 1200, "VIS")
            with calls.attempt(), calls.call():
                assert driver.filter() == 1
    bench.set_faults(ScriptedFaults([]))
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    for _ in range(2):  # an earlier reset is reported once
        with contextlib.suppress(DeviceError):
            bench.go(555.0)
    bench.go(560.0)
    assert bench.true_wavelength_nm() == driver.wavelength_nm() == 560.0
    return calls


@pytest.mark.parametrize("seed", range(12))  # each dialect with each time of a late reply
def test_a_wire_with_faults_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    storm(MonochromatorBench(opened, *DIALECTS[seed % 4]), seed)


@pytest.mark.long
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_wires_with_faults_give_no_wrong_value(opened: RigOpener, hundred: int) -> None:
    good = failed = 0
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        calls = storm(MonochromatorBench(opened, *DIALECTS[seed % 4]), seed)
        good, failed = good + calls.good, failed + len(calls.errors)
    assert good > 300
    assert failed > 100


def test_a_disconnected_port_is_reopened_when_it_is_connected_again(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.go(600.0)
    bench.line.pull()
    for _ in range(3):
        with pytest.raises(NoAnswer, match=r"monochromator: .*the port failed"):
            bench.driver.wavelength_nm()
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    assert bench.driver.wavelength_nm() == 600.0
    assert list(bench.driver.events)[-2:] == ["port reopened", "line resynchronised"]


def test_a_slew_succeeds_though_the_port_is_disconnected_for_a_moment(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    move = bench.driver.start_wavelength(725.0)
    bench.clock.at(bench.clock.now() + 0.9, bench.line.pull)  # connected again after the end of the slew
    wait(bench.clock, [move])
    assert bench.true_wavelength_nm() == 725.0


def test_a_reset_of_the_unit_is_reported_once(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.go(600.0)
    bench.unit.reset(bench.clock.now())
    with pytest.raises(DeviceError):  # the status line is missing
        bench.driver.check()
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        bench.driver.check()
    bench.driver.check()
    assert bench.driver.wavelength_nm() == 600.0


def test_whether_a_unit_responds_can_be_asked_without_taking_its_reset_from_the_next_use(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.go(600.0)
    bench.driver.ask()
    bench.unit.reset(bench.clock.now())
    for _ in range(2):
        bench.driver.ask()
    bench.line.pull()
    with pytest.raises(NoAnswer, match="the port failed"):
        bench.driver.ask()
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    bench.driver.ask()
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        bench.driver.check()


def test_a_unit_with_another_identity_is_refused(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    bench.set_faults(ScriptedFaults([Fault.LOST]))
    with pytest.raises(DeviceError):
        bench.driver.wavelength_nm()
    other = Cornerstone260(bench.plant, "Cornerstone 130 virtual")
    other.outbox = bench.line.outbox
    bench.line.device = other
    with pytest.raises(BadAnswer, match="Cornerstone 130 virtual is connected"):
        bench.driver.wavelength_nm()
