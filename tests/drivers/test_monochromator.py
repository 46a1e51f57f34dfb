"""The monochromator's driver."""

import contextlib
from dataclasses import replace

import pytest

from drivers import BadAnswer, DeviceError, Forgotten, Refused, wait
from mocks.faults import ON_A_SERIAL_LINE, Fault, Misfortune, Script
from mocks.faulty_line import FaultyLine
from protocols.cornerstone import Grating, Statement
from tests.conftest import RigOpener
from twin.devices import Cornerstone260


def test_it_goes_to_a_wavelength_and_says_when_it_is_there(opened: RigOpener) -> None:
    rig = opened().rig
    start = rig.clock.now()
    wait(rig.clock, [rig.monochromator.start_wavelength(725.0)])
    assert rig.clock.now() - start == pytest.approx(175.0 / 175.0 + 0.1, abs=0.08)  # and 70 ms for the bytes at 9600 baud
    assert rig.monochromator.wavelength_nm() == 725.0


def test_it_holds_up_nobody_while_it_moves(opened: RigOpener) -> None:
    rig = opened().rig
    slew = rig.monochromator.start_wavelength(725.0)
    start = rig.clock.now()
    assert rig.axes["sigma"].position_deg() == 0.0
    assert rig.clock.now() - start < 0.01
    assert slew.poll() is False
    wait(rig.clock, [slew])


def test_the_shutter_is_opened_and_closed(opened: RigOpener) -> None:
    rig = opened().rig
    assert not rig.monochromator.shutter_is_open()
    wait(rig.clock, [rig.monochromator.start_shutter(opened=True)])
    assert rig.monochromator.shutter_is_open()
    wait(rig.clock, [rig.monochromator.start_shutter(opened=False)])
    assert not rig.monochromator.shutter_is_open()


@pytest.mark.parametrize("wavelength_nm", [100.0, 900.0, float("nan")])
def test_a_wavelength_out_of_range_sends_nothing(opened: RigOpener, wavelength_nm: float) -> None:
    rig = opened().rig
    with pytest.raises(DeviceError, match="outside 380 to 780 nm"):
        rig.monochromator.start_wavelength(wavelength_nm)
    assert rig.monochromator.wavelength_nm() == 550.0


def test_an_error_of_the_device_is_told_in_words(opened: RigOpener) -> None:
    rig = opened().rig
    with pytest.raises(Refused, match="destination not allowed"):
        wait(rig.clock, [rig.monochromator.start_filter(9)])
    assert rig.monochromator.wavelength_nm() == 550.0  # and it works again


def test_a_line_without_echo_is_found_out(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    device = rig.virtual.serial["mono"]
    device._drive = type(device._drive)(echo=False)  # type: ignore[attr-defined]
    assert "Cornerstone" in rig.rig.monochromator.connect()
    wait(rig.rig.clock, [rig.rig.monochromator.start_wavelength(600.0)])
    assert rig.rig.monochromator.wavelength_nm() == 600.0


def test_a_silent_device_is_an_error_in_bounded_time(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    device = rig.virtual.serial["mono"]
    device.receive = lambda data, t: None  # type: ignore[method-assign]
    start = rig.rig.clock.now()
    with pytest.raises(DeviceError, match=r"monochromator: WAVE.*no line within"):
        rig.rig.monochromator.wavelength_nm()
    assert rig.rig.clock.now() - start < 2.0
    assert str(Statement("WAVE", query=True)) == "WAVE?"


DIALECTS = [(echo, handshake) for echo in (True, False) for handshake in (True, False)]


class Bench:
    """A monochromator's driver, the unit behind it, and a wire between them that may fail."""

    def __init__(self, opened: RigOpener, echo: bool = True, handshake: bool = True) -> None:
        rig = opened()
        assert rig.virtual is not None
        self.plant, self.clock = rig.virtual.plant, rig.rig.clock
        drive = replace(self.plant.model.monochromator, echo=echo, handshake=handshake)
        self.plant.model = replace(self.plant.model, monochromator=drive)
        self.unit = Cornerstone260(self.plant)
        self.line = FaultyLine(self.unit, Script([]))
        rig.virtual.serial["mono"] = self.line
        self.driver = rig.rig.monochromator
        self.driver.connect()

    def misfortune(self, misfortune: Misfortune, late_s: float = 0.1) -> None:
        self.line.misfortune, self.line._late_s = misfortune, late_s

    def light_nm(self) -> float:
        return self.plant.wavelength_nm.at(self.clock.now())

    def go(self, wavelength_nm: float) -> None:
        wait(self.clock, [self.driver.start_wavelength(wavelength_nm)])


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_everything_works_with_and_without_echo_and_handshake(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = Bench(opened, echo, handshake)
    driver = bench.driver
    bench.go(633.0)
    assert driver.wavelength_nm() == bench.light_nm() == 633.0
    wait(bench.clock, [driver.start_grating(2)])
    assert driver.grating() == Grating(2, 600, "NIR")
    wait(bench.clock, [driver.start_filter(4)])
    assert driver.filter() == 4
    wait(bench.clock, [driver.start_slit(2, 350.0)])
    assert driver.slit_um(2) == 350.0
    wait(bench.clock, [driver.start_step(-50)])
    assert bench.light_nm() == pytest.approx(632.0)  # 0.02 nm a step with 600 lines/mm
    with pytest.raises(Refused, match="destination not allowed"):
        wait(bench.clock, [driver.start_filter(9)])
    driver.check()


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_questions_during_a_move_are_refused_and_the_next_move_waits_for_it(
    opened: RigOpener, echo: bool, handshake: bool
) -> None:
    bench = Bench(opened, echo, handshake)
    bench.driver.start_wavelength(725.0)
    with pytest.raises(DeviceError, match="answers only when it has arrived"):
        bench.driver.wavelength_nm()
    wait(bench.clock, [bench.driver.start_shutter(opened=True)])
    assert bench.light_nm() == 725.0
    assert bench.driver.shutter_is_open()


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_it_is_aborted_in_the_middle_and_works_again(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = Bench(opened, echo, handshake)
    move = bench.driver.start_wavelength(725.0)
    bench.clock.at(bench.clock.now() + 0.5, bench.driver.abort)
    with pytest.raises(DeviceError, match="aborted"):
        wait(bench.clock, [move])
    assert 550.0 < bench.light_nm() < 725.0
    assert bench.driver.wavelength_nm() == pytest.approx(bench.light_nm(), abs=0.001)
    bench.go(600.0)


def test_the_light_is_where_it_is_in_the_middle_of_a_move(opened: RigOpener) -> None:
    bench = Bench(opened)
    start = bench.clock.now()
    bench.driver.start_wavelength(725.0)
    assert bench.plant.wavelength_nm.at(start + 0.5) == pytest.approx(550.0 + 0.5 * 175.0, abs=4.0)


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
@pytest.mark.parametrize("late_s", [0.1, 5.0])
@pytest.mark.parametrize("fault", ON_A_SERIAL_LINE)
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


@pytest.mark.parametrize("seed", range(52))
def test_a_wire_that_fails_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    """A fifth of all exchanges fail somehow, in each dialect; then none does, and it works again."""
    bench = Bench(opened, *DIALECTS[seed % 4])
    bench.misfortune(Misfortune(seed, ON_A_SERIAL_LINE, until=60), (0.1, 1.5, 5.0)[seed % 3])
    for wavelength in (400.0, 725.0, 633.1, 550.0, 612.34):
        start = bench.clock.now()
        with contextlib.suppress(DeviceError):
            bench.go(wavelength)
            assert bench.light_nm() == pytest.approx(wavelength, abs=0.011)
        assert bench.clock.now() - start < 60.0
        opened_now = wavelength > 600.0
        with contextlib.suppress(DeviceError):
            wait(bench.clock, [bench.driver.start_shutter(opened=opened_now)])
            assert bench.plant.shutter_open.at(bench.clock.now()) is opened_now
        with contextlib.suppress(DeviceError):
            assert bench.driver.wavelength_nm() == pytest.approx(bench.light_nm(), abs=0.001)
    bench.misfortune(Script([]))
    bench.clock.sleep_until(bench.clock.now() + 60.0)
    for _ in range(2):  # a reset in the meantime is told once
        with contextlib.suppress(DeviceError):
            bench.go(555.0)
    bench.go(560.0)
    assert bench.light_nm() == 560.0


def test_a_unit_that_has_reset_itself_says_so_once(opened: RigOpener) -> None:
    bench = Bench(opened)
    bench.go(600.0)
    bench.unit.reset(bench.clock.now())
    with pytest.raises(DeviceError):  # the status line is missing
        bench.driver.check()
    with pytest.raises(Forgotten, match="reset itself; its settings are restored"):
        bench.driver.check()
    bench.driver.check()
    assert bench.driver.wavelength_nm() == 600.0


def test_another_unit_in_its_place_is_refused(opened: RigOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = Bench(opened)
    bench.misfortune(Script([Fault.LOST]))
    with pytest.raises(DeviceError):
        bench.driver.wavelength_nm()
    monkeypatch.setattr("twin.devices.cornerstone_statements.IDENTITY", "Cornerstone 130 virtual")
    with pytest.raises(BadAnswer, match="Cornerstone 130 virtual answers"):
        bench.driver.wavelength_nm()
