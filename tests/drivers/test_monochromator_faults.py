"""The monochromator on a wire that fails: no wrong value, no step twice, an end in bounded time, and recovery."""

import contextlib

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, wait
from goniotwin.mocks.faults import ON_A_TEXT_LINE, Fault, Misfortune, Script
from goniotwin.protocols.cornerstone import Grating
from tests.conftest import RigOpener
from tests.drivers.failing import Calls
from tests.drivers.monochromator_bench import DIALECTS, Bench


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
@pytest.mark.parametrize("late_s", [0.1, 5.0])
@pytest.mark.parametrize("fault", ON_A_TEXT_LINE)
def test_under_each_fault_a_relative_step_is_made_once_or_not_at_all(
    opened: RigOpener, fault: Fault, late_s: float, echo: bool, handshake: bool
) -> None:
    bench = Bench(opened, echo, handshake)
    for clean in range(3):  # the fault meets the question before, the statement, what comes after
        before = bench.light_nm()
        bench.misfortune(Script([*[Fault.NONE] * clean, fault]), late_s)
        start = bench.clock.now()
        with contextlib.suppress(DeviceError):
            wait(bench.clock, [bench.driver.start_step(100)])
            assert bench.light_nm() == pytest.approx(before + 1.0)
        assert bench.clock.now() - start < 60.0
        bench.clock.sleep_until(bench.clock.now() + 20.0)
        assert bench.light_nm() == pytest.approx(before) or bench.light_nm() == pytest.approx(before + 1.0)
        with contextlib.suppress(DeviceError):  # what was still lost is found out here
            bench.driver.wavelength_nm()
    with contextlib.suppress(DeviceError):
        bench.go(640.0)
    bench.go(650.0)
    assert bench.light_nm() == 650.0


LONGEST_S = 6.0
"""A call that finds a line out of step: it is drained, asked six questions to bring it into step, and one more; the first of
these that has no answer within a second ends it."""


def storm(bench: Bench, seed: int) -> Calls:
    """A fifth of all exchanges fail somehow; every value is the truth. Then none fails, and it works again."""
    bench.misfortune(Misfortune(seed, ON_A_TEXT_LINE, until=150), (0.1, 1.5, 5.0)[seed % 3])
    calls = Calls(bench.clock, "monochromator", LONGEST_S)
    driver = bench.driver
    for wavelength in (400.0, 725.0, 633.1, 550.0, 612.34):
        start = bench.clock.now()
        with calls.attempt():
            with calls.call():
                move = driver.start_wavelength(wavelength)
            calls.wait(move)
            assert bench.light_nm() == pytest.approx(wavelength, abs=0.011)
        assert bench.clock.now() - start < 60.0
        opened_now = wavelength > 600.0
        with calls.attempt():
            with calls.call():
                move = driver.start_shutter(opened=opened_now)
            calls.wait(move)
            assert bench.plant.shutter_open.at(bench.clock.now()) is opened_now
        for _ in range(3):
            with calls.attempt(), calls.call():
                assert driver.wavelength_nm() == pytest.approx(bench.light_nm(), abs=0.001)
            with calls.attempt(), calls.call():
                assert driver.grating() == Grating(1, 1200, "VIS")
            with calls.attempt(), calls.call():
                assert driver.filter() == 1
    bench.misfortune(Script([]))
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    for _ in range(2):  # a reset in the meantime is told once
        with contextlib.suppress(DeviceError):
            bench.go(555.0)
    bench.go(560.0)
    assert bench.light_nm() == driver.wavelength_nm() == 560.0
    return calls


@pytest.mark.parametrize("seed", range(52))
def test_a_wire_that_fails_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    storm(Bench(opened, *DIALECTS[seed % 4]), seed)


@pytest.mark.long
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_wires_that_fail_give_no_wrong_value(opened: RigOpener, hundred: int) -> None:
    good = failed = 0
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        calls = storm(Bench(opened, *DIALECTS[seed % 4]), seed)
        good, failed = good + calls.good, failed + len(calls.errors)
    assert good > 300
    assert failed > 100


def test_a_port_that_is_gone_is_opened_again_when_it_is_back(opened: RigOpener) -> None:
    bench = Bench(opened)
    bench.go(600.0)
    bench.line.pull()
    for _ in range(3):
        with pytest.raises(NoAnswer, match=r"monochromator: .*the port failed"):
            bench.driver.wavelength_nm()
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    assert bench.driver.wavelength_nm() == 600.0
    assert list(bench.driver.events)[-2:] == ["port reopened", "line resynchronised"]


def test_a_move_survives_a_plug_that_is_out_for_a_moment(opened: RigOpener) -> None:
    bench = Bench(opened)
    move = bench.driver.start_wavelength(725.0)
    bench.clock.at(bench.clock.now() + 0.9, bench.line.pull)  # it is back after the move has ended
    wait(bench.clock, [move])
    assert bench.light_nm() == 725.0


def test_a_unit_that_has_reset_itself_says_so_once(opened: RigOpener) -> None:
    bench = Bench(opened)
    bench.go(600.0)
    bench.unit.reset(bench.clock.now())
    with pytest.raises(DeviceError):  # the status line is missing
        bench.driver.check()
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        bench.driver.check()
    bench.driver.check()
    assert bench.driver.wavelength_nm() == 600.0


def test_another_unit_in_its_place_is_refused(opened: RigOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(opened)
    bench.misfortune(Script([Fault.LOST]))
    with pytest.raises(DeviceError):
        bench.driver.wavelength_nm()
    monkeypatch.setattr("goniotwin.twin.devices.cornerstone_statements.IDENTITY", "Cornerstone 130 virtual")
    with pytest.raises(BadAnswer, match="Cornerstone 130 virtual is connected"):
        bench.driver.wavelength_nm()
