"""The monitor on a bus that fails: no wrong value, an end in bounded time, and recovery."""

import contextlib
from collections.abc import Callable
from dataclasses import replace

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, Refused, wait
from goniotwin.mocks.faults import ON_USB, Fault, Misfortune, Script
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.usbtmc import HEADER_BYTES
from goniotwin.twin.devices.usbtmc import BULK_IN, BULK_OUT
from tests.conftest import RigOpener
from tests.drivers.failing import Calls
from tests.drivers.monitor_bench import TRUTH_A, Bench, bench

__all__ = ["bench"]

FAULTS: dict[str, Callable[[bytes], bytes]] = {
    "another tag": lambda data: bytes((data[0], data[1] ^ 1, data[2] ^ 1)) + data[3:],
    "a broken header": lambda data: data[:1] + bytes((data[1] ^ 4,)) + data[2:],
    "another message": lambda data: b"\x7f" + data[1:],
    "cut off": lambda data: data[:-6],
    "no header": lambda data: data[:5],
    "empty": lambda data: b"",
    "two at once": lambda data: data + data,
    "no number": lambda data: data[:HEADER_BYTES] + b"x" * (len(data) - HEADER_BYTES),
    "an overrange": lambda data: data[:HEADER_BYTES] + b"9.90000000E+37\n" + data[27:],
    "not a number": lambda data: data[:HEADER_BYTES] + b"9.91000000E+37\n" + data[27:],
    "beyond the range": lambda data: data[:HEADER_BYTES] + b"1.00000000E-03\n" + data[27:],
}


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_no_answer_is_an_error_and_the_next_call_works(bench: Bench, fault: str) -> None:
    bench.mean()
    mean = bench.monitor.start_mean(0.1)
    bench.fail_once("bulk_in", FAULTS[fault])
    start = bench.clock.now()
    with pytest.raises(DeviceError, match="monitor: READ"):
        wait(bench.clock, [mean])
    assert bench.clock.now() - start < 5.0
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


@pytest.mark.parametrize("endpoint", [BULK_IN, BULK_OUT])
def test_a_stall_is_said_and_released(bench: Bench, endpoint: int) -> None:
    bench.mean()
    bench.device.halt(endpoint)
    with pytest.raises(NoAnswer, match="stall"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert "resynchronised" in bench.monitor.events[-1]


@pytest.mark.parametrize("keeps_fifo", [False, True])
def test_a_late_answer_is_never_taken_for_the_next_one(bench: Bench, keeps_fifo: bool) -> None:
    """The host gives up after a second; the answer comes after three."""
    bench.device.keeps_fifo = keeps_fifo
    bench.mean()
    wire = bench.monitor._wire
    wire.query("*OPC?")
    wire.write("SENS:AVER:COUN 9000")
    start = bench.clock.now()
    with pytest.raises(NoAnswer, match="not responding within 1 s"):
        wire.query("READ?")
    assert bench.clock.now() - start < 1.5
    bench.clock.sleep_until(bench.clock.now() + 5.0)
    assert wire.query("*IDN?").startswith(b"Thorlabs")
    assert wire.query("SENS:AVER:COUN?") == b"9000"  # the settings have stayed
    with pytest.raises(Forgotten):  # but they are not the driver's
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_an_unplugged_one_is_gone_and_works_again_when_it_is_back(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    for _ in range(3):
        with pytest.raises(NoAnswer, match=r"disconnected|not connected"):
            bench.mean()
    bench.backend.replug("monitor")
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert any("found again" in each for each in bench.monitor.events)


def test_one_that_has_lost_its_power_says_so_once_and_gets_its_settings_back(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.backend.replug("monitor", reset=True)
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_a_reset_without_unplugging_is_seen_by_the_canary(bench: Bench) -> None:
    bench.mean()
    bench.device.instrument.power_cycle(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.monitor.check()
    bench.monitor.check()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_another_instrument_in_its_place_is_refused(bench: Bench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.device.instrument.serial_number = "TWIN0002"
    bench.backend.replug("monitor")
    with pytest.raises(BadAnswer, match="TWIN0002"):
        bench.mean()


def test_a_device_that_hangs_is_an_error_in_bounded_time(bench: Bench) -> None:
    bench.mean()
    bench.device.bulk_in_ready = lambda: None  # type: ignore[method-assign]
    for _ in range(3):
        start = bench.clock.now()
        with pytest.raises(NoAnswer):
            bench.mean()
        assert bench.clock.now() - start < 5.0
    del bench.device.bulk_in_ready
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


class Broken(Bench):
    """A bench whose bus does what a script or a seed says, from `misfortune` on."""

    def __init__(self, opened: RigOpener) -> None:
        opened_rig = opened(("noise = true", "noise = false"), clock=VirtualClock(1.0))
        assert opened_rig.virtual is not None
        opened_rig.rig.monitor.close()
        devices = opened_rig.virtual.usb
        devices["monitor"] = self.faulty = FaultyUsb(devices["monitor"], Script([]), opened_rig.virtual.clock)
        super().__init__(opened_rig.virtual)
        self.monitor.connect()


@pytest.mark.parametrize("fault", ON_USB)
def test_after_any_single_fault_there_is_no_wrong_value_and_it_works_again(opened: RigOpener, fault: Fault) -> None:
    bench = Broken(opened)
    truth = bench.mean()
    for clean in range(4):  # the fault meets the question, the request for its answer, and the same of the canary
        script = bench.faulty.misfortune = Script([*[Fault.NONE] * clean, fault])
        calls = Calls(bench.clock, "monitor", MOST_S)
        with calls.attempt():
            assert bench.mean() == pytest.approx(truth, rel=2e-3)
        assert script.met == [fault]
        bench.faulty.misfortune = Script([])
        bench.clock.sleep_until(bench.clock.now() + 0.5)
        with contextlib.suppress(Forgotten):  # is told once
            bench.mean()
        assert bench.mean() == pytest.approx(truth, rel=2e-3)


def test_what_was_read_after_a_reset_is_not_believed(opened: RigOpener) -> None:
    """It wakes up measuring power, but for 635 nm: a number like any other."""
    bench = Broken(opened)
    wait(bench.clock, [bench.monitor.start_mean(0.1, "power")])
    bench.faulty.misfortune = Script([Fault.RESET])
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        wait(bench.clock, [bench.monitor.start_mean(0.1, "power")])
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm


MOST_S = 2.5
"""A call that finds the bus out of step: the first of its messages that has no answer within a second ends it, and when a
setting had none its error is asked for too."""


def storm(bench: Broken, seed: int) -> Calls:
    """A fifth of all exchanges fail somehow; every value is the truth. Then none fails, and it works again."""
    truth = bench.mean()
    bench.faulty.misfortune = Misfortune(seed, ON_USB, 0.08, until=150)
    calls = Calls(bench.clock, "monitor", MOST_S)
    for _ in range(12):
        with calls.attempt():
            with calls.call():
                mean = bench.monitor.start_mean(0.1)
            calls.wait(mean)
            assert mean.current_a == pytest.approx(truth, rel=2e-3)  # the lamp drifts by 2 % an hour
        bench.clock.sleep_until(bench.clock.now() + 0.2)
    bench.faulty.misfortune = Script([])
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    for _ in range(2):  # settings that were lost are told once
        with contextlib.suppress(DeviceError):
            bench.mean()
    assert bench.mean() == pytest.approx(truth, rel=2e-3)
    return calls


@pytest.mark.parametrize("seed", range(50))
def test_a_bus_that_fails_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    storm(Broken(opened), seed)


@pytest.mark.long
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_buses_that_fail_give_no_wrong_value(opened: RigOpener, hundred: int) -> None:
    good = failed = 0
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        calls = storm(Broken(opened), seed)
        good, failed = good + calls.good, failed + len(calls.errors)
    assert good > 500
    assert failed > 300


def test_a_setting_that_was_not_heard_is_an_error(opened: RigOpener) -> None:
    bench = Broken(opened)
    bench.mean()
    bench.faulty.misfortune = Script([Fault.UNHEARD])
    with pytest.raises(NoAnswer, match="monitor: CONF:POW"):
        bench.monitor.start_mean(0.1, "power")
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm


def test_a_setting_that_it_does_not_know_is_refused_in_its_own_words(bench: Bench) -> None:
    bench.monitor._dialect = replace(bench.monitor._dialect, low_pass="INP:NONSENSE {:d}")
    with pytest.raises(Refused, match="set the filter: error -113"):
        bench.monitor.set_low_pass(True)
