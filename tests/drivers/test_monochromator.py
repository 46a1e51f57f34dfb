"""The monochromator's driver."""

from typing import Any

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, NoAnswer, Refused, wait
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.monochromator.line import CornerstoneLine
from goniotwin.drivers.tap import no_tap
from goniotwin.protocols.cornerstone import ErrorCode, Grating, Statement
from goniotwin.twin.devices.cornerstone_statements import StatementRefused, StatementResult, Statements, UnitState
from tests.conftest import RigOpener
from tests.drivers.monochromator_bench import DIALECTS, MonochromatorBench


def test_a_wavelength_is_reached_in_the_expected_time(opened: RigOpener) -> None:
    rig = opened().rig
    start = rig.clock.now()
    wait(rig.clock, [rig.monochromator.start_wavelength(725.0)])
    assert rig.clock.now() - start == pytest.approx(175.0 / 175.0 + 0.1, abs=0.08)  # and 70 ms for the bytes at 9600 baud
    assert rig.monochromator.wavelength_nm() == 725.0


def test_a_slew_does_not_block_other_devices(opened: RigOpener) -> None:
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


def test_an_error_of_the_unit_is_reported_as_text(opened: RigOpener) -> None:
    rig = opened().rig
    with pytest.raises(Refused, match="destination not allowed"):
        wait(rig.clock, [rig.monochromator.start_filter(9)])
    assert rig.monochromator.wavelength_nm() == 550.0  # the next exchange works


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
@pytest.mark.parametrize("unit", [{"status_digits": 1, "status_decimal": True}, {"zero_is_no_error": True}])
def test_units_may_write_status_and_error_otherwise(
    opened: RigOpener, echo: bool, handshake: bool, unit: dict[str, Any]
) -> None:
    bench = MonochromatorBench(opened, echo, handshake, **unit)  # its units are those of test_cornerstone260.py
    bench.go(600.0)
    with pytest.raises(Refused, match="destination not allowed"):
        wait(bench.clock, [bench.driver.start_filter(9)])
    wait(bench.clock, [bench.driver.start_filter(3)])
    assert (bench.driver.filter(), bench.true_wavelength_nm()) == (3, 600.0)
    assert not any("resynchronised" in each for each in bench.driver.events)


HANDSHAKE_QUERY = Statement("HANDSHAKE", query=True)


@pytest.mark.parametrize("echo", [True, False])
@pytest.mark.parametrize("found", ["0", "1"])
def test_a_unit_without_the_query_of_handshake_mode_is_left_as_it_was(
    opened: RigOpener, monkeypatch: pytest.MonkeyPatch, echo: bool, found: str
) -> None:
    """`HANDSHAKE?` is assumed; that every statement is acknowledged in this mode is on p. 51 of MCS260."""
    perform = Statements.perform

    def refuse(statements: Statements, state: UnitState, statement: Statement, t: float) -> StatementResult:
        if statement == HANDSHAKE_QUERY:
            raise StatementRefused(ErrorCode.NOT_UNDERSTOOD)
        return perform(statements, state, statement, t)

    monkeypatch.setattr(Statements, "perform", refuse)
    bench = MonochromatorBench(opened, echo)
    bench.driver.close()
    bench.unit.receive(f"HANDSHAKE {found}\n".encode(), bench.clock.now())
    bench.unit.outbox.clear()
    bench.driver.connect()
    bench.go(600.0)
    assert bench.unit.state.handshake
    bench.driver.close()
    assert bench.unit.state.handshake is (found == "1")
    bench.driver.connect()  # it is not locked out by what it has done
    bench.go(610.0)


def test_a_query_without_acknowledgement_ends_a_resynchronisation(opened: RigOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    """In handshake mode every statement is acknowledged (MCS260 p. 51), so that this is no unit without `HANDSHAKE?`."""
    bench = MonochromatorBench(opened, echo=False)
    receive = bench.unit.receive
    monkeypatch.setattr(bench.unit, "receive", lambda data, t: receive(data.replace(b"HANDSHAKE?\n", b""), t))
    bench.unit.outbox.append((bench.clock.now(), b"unasked\r\n"))
    bench.clock.sleep_until(bench.clock.now() + 0.1)
    with pytest.raises(NoAnswer, match=r"HANDSHAKE\?: not responding"):
        bench.driver.wavelength_nm()


def test_a_status_that_has_lost_a_digit_is_no_status(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    line = CornerstoneLine(bench.wires.serial("twin://virtual/mono"), 9600, bench.clock, no_tap, FoundSettings())
    line.open()
    with pytest.raises(BadAnswer, match="not the status byte of this unit"):
        line.status_of(Statement("STB", query=True), b"0")  # "20" without its first digit
    line.close()


def test_a_line_without_echo_is_detected(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened, echo=False)
    assert "Cornerstone" in bench.driver.connect()
    bench.go(600.0)
    assert bench.driver.wavelength_nm() == 600.0


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


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_everything_works_with_and_without_echo_and_handshake(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    driver = bench.driver
    bench.go(633.0)
    assert driver.wavelength_nm() == bench.true_wavelength_nm() == 633.0
    wait(bench.clock, [driver.start_grating(2)])
    assert driver.grating() == Grating(2, 600, "NIR")
    wait(bench.clock, [driver.start_filter(4)])
    assert driver.filter() == 4
    wait(bench.clock, [driver.start_slit(2, 350.0)])
    assert driver.slit_um(2) == 350.0
    wait(bench.clock, [driver.start_step(-50)])
    assert bench.true_wavelength_nm() == pytest.approx(632.0)  # 0.02 nm per step with 600 lines/mm
    with pytest.raises(Refused, match="destination not allowed"):
        wait(bench.clock, [driver.start_filter(9)])
    driver.check()


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_queries_during_a_slew_are_refused_and_the_next_motion_waits_for_its_end(
    opened: RigOpener, echo: bool, handshake: bool
) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    bench.driver.start_wavelength(725.0)
    with pytest.raises(DeviceError, match="not responding until it arrives"):
        bench.driver.wavelength_nm()
    wait(bench.clock, [bench.driver.start_shutter(opened=True)])
    assert bench.true_wavelength_nm() == 725.0
    assert bench.driver.shutter_is_open()


@pytest.mark.parametrize(("echo", "handshake"), DIALECTS)
def test_a_slew_can_be_aborted_and_the_next_one_works(opened: RigOpener, echo: bool, handshake: bool) -> None:
    bench = MonochromatorBench(opened, echo, handshake)
    move = bench.driver.start_wavelength(725.0)
    bench.clock.at(bench.clock.now() + 0.5, bench.driver.abort)
    with pytest.raises(DeviceError, match="aborted"):
        wait(bench.clock, [move])
    assert 550.0 < bench.true_wavelength_nm() < 725.0
    assert bench.driver.wavelength_nm() == pytest.approx(bench.true_wavelength_nm(), abs=0.001)
    bench.go(600.0)


def test_the_true_wavelength_follows_the_slew(opened: RigOpener) -> None:
    bench = MonochromatorBench(opened)
    start = bench.clock.now()
    bench.driver.start_wavelength(725.0)
    assert bench.plant.wavelength_nm.at(start + 0.5) == pytest.approx(550.0 + 0.5 * 175.0, abs=4.0)
