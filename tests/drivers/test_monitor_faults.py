"""The monitor on a bus with faults: no wrong value, bounded time, recovery."""

import contextlib
from collections.abc import Callable
from dataclasses import replace

import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, Refused, wait
from goniotwin.mocks.faults import ON_USB, Fault, FaultPlan, ScriptedFaults
from goniotwin.mocks.faulty_usb import FaultyUsb
from goniotwin.protocols.clock import VirtualClock
from goniotwin.protocols.usbtmc import HEADER_BYTES
from goniotwin.twin.devices.usb_standard import BULK_IN, BULK_OUT
from tests.conftest import RigOpener
from tests.drivers.bounded_calls import BoundedCalls
from tests.drivers.monitor_bench import TRUTH_A, MonitorBench, bench

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
def test_a_wrong_reply_is_an_error_and_the_next_call_works(bench: MonitorBench, fault: str) -> None:
    bench.mean()
    mean = bench.monitor.start_mean(0.1)
    bench.change_next_reply(FAULTS[fault])
    start = bench.clock.now()
    with pytest.raises(DeviceError, match="monitor: READ"):
        wait(bench.clock, [mean])
    assert bench.clock.now() - start < 5.0
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


@pytest.mark.parametrize("endpoint", [BULK_IN, BULK_OUT])
def test_a_stall_is_reported_and_released(bench: MonitorBench, endpoint: int) -> None:
    bench.mean()
    bench.device.halt(endpoint)
    with pytest.raises(NoAnswer, match="stall"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert "resynchronised" in bench.monitor.events[-1]


@pytest.mark.parametrize("keeps_fifo", [False, True])
def test_a_late_reply_is_never_taken_for_the_next_one(bench: MonitorBench, keeps_fifo: bool) -> None:
    """The host gives up after a second; the reply comes after three."""
    bench.device.keeps_fifo = keeps_fifo
    bench.mean()
    wire = bench.monitor.wire
    wire.query("*OPC?")
    wire.write("SENS:AVER:COUN 9000")
    start = bench.clock.now()
    with pytest.raises(NoAnswer, match="not responding within 1 s"):
        wire.query("READ?")
    assert bench.clock.now() - start < 1.5
    bench.clock.sleep_until(bench.clock.now() + 5.0)
    assert wire.query("*IDN?").startswith(b"Thorlabs")
    assert wire.query("SENS:AVER:COUN?") == b"9000"  # the settings are kept
    with pytest.raises(Forgotten):  # but they differ from the driver's
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_a_disconnected_monitor_is_an_error_until_it_is_connected_again(bench: MonitorBench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    for _ in range(3):
        with pytest.raises(NoAnswer, match=r"disconnected|not connected"):
            bench.mean()
    bench.backend.replug("monitor")
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)
    assert any("found again" in each for each in bench.monitor.events)


def test_a_power_cycle_is_reported_once_and_the_settings_are_restored(bench: MonitorBench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.backend.replug("monitor", reset=True)
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        bench.mean()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_the_canary_detects_a_reset_without_disconnection(bench: MonitorBench) -> None:
    bench.mean()
    bench.device.instrument.power_cycle(bench.clock.now())
    with pytest.raises(Forgotten):
        bench.monitor.check()
    bench.monitor.check()
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


def test_an_instrument_with_another_serial_number_is_refused(bench: MonitorBench) -> None:
    bench.mean()
    bench.backend.unplug("monitor")
    with pytest.raises(NoAnswer):
        bench.mean()
    bench.device.instrument.serial_number = "TWIN0002"
    bench.backend.replug("monitor")
    with pytest.raises(BadAnswer, match="TWIN0002"):
        bench.mean()


def test_a_hanging_instrument_is_an_error_in_bounded_time(bench: MonitorBench) -> None:
    bench.mean()
    bench.hang()
    for _ in range(3):
        start = bench.clock.now()
        with pytest.raises(NoAnswer):
            bench.mean()
        assert bench.clock.now() - start < 5.0
    del bench.device.bulk_in_ready
    assert bench.mean() == pytest.approx(TRUTH_A, rel=0.02)


class FaultyMonitorBench(MonitorBench):
    """A monitor on a bus with faults by a script or a seed."""

    def __init__(self, opened: RigOpener) -> None:
        opened_rig = opened(("noise = true", "noise = false"), clock=VirtualClock(1.0))
        assert opened_rig.virtual is not None
        opened_rig.rig.monitor.close()
        devices = opened_rig.virtual.usb
        devices["monitor"] = self.faulty = FaultyUsb(devices["monitor"], ScriptedFaults([]), opened_rig.virtual.clock)
        super().__init__(opened_rig.virtual)
        self.monitor.connect()


@pytest.mark.parametrize("fault", ON_USB)
def test_a_single_fault_gives_no_wrong_value_and_the_driver_recovers(opened: RigOpener, fault: Fault) -> None:
    bench = FaultyMonitorBench(opened)
    truth = bench.mean()
    for clean in range(4):  # the fault is at the query, the request for its reply, or those of the canary
        script = bench.faulty.misfortune = ScriptedFaults([*[Fault.NONE] * clean, fault])
        calls = BoundedCalls(bench.clock, "monitor", MOST_S)
        with calls.attempt():
            assert bench.mean() == pytest.approx(truth, rel=2e-3)
        assert script.met == [fault]
        bench.faulty.misfortune = ScriptedFaults([])
        bench.clock.sleep_until(bench.clock.now() + 0.5)
        with contextlib.suppress(Forgotten):  # reported once
            bench.mean()
        assert bench.mean() == pytest.approx(truth, rel=2e-3)


def test_a_reading_after_a_reset_is_rejected(opened: RigOpener) -> None:
    """After power-on it measures power for 635 nm, which is a plausible number."""
    bench = FaultyMonitorBench(opened)
    wait(bench.clock, [bench.monitor.start_mean(0.1, "power")])
    bench.faulty.misfortune = ScriptedFaults([Fault.RESET])
    with pytest.raises(Forgotten, match="has reset; its settings are restored"):
        wait(bench.clock, [bench.monitor.start_mean(0.1, "power")])
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm


MOST_S = 2.5
"""A call on a bus that is out of step: the first message without reply within a second ends it; after a setting without
reply the error queue is read, too."""


def storm(bench: FaultyMonitorBench, seed: int) -> BoundedCalls:
    """A part of all exchanges fail; every returned value is true. Then no exchange fails, and the driver recovers."""
    truth = bench.mean()
    bench.faulty.misfortune = FaultPlan(seed, ON_USB, 0.08, until=150)
    calls = BoundedCalls(bench.clock, "monitor", MOST_S)
    for _ in range(12):
        with calls.attempt():
            with calls.call():
                mean = bench.monitor.start_mean(0.1)
            calls.wait(mean)
            assert mean.current_a == pytest.approx(truth, rel=2e-3)  # the lamp drifts by 2 % an hour
        bench.clock.sleep_until(bench.clock.now() + 0.2)
    bench.faulty.misfortune = ScriptedFaults([])
    bench.clock.sleep_until(bench.clock.now() + 0.5)
    for _ in range(2):  # lost settings are reported once
        with contextlib.suppress(DeviceError):
            bench.mean()
    assert bench.mean() == pytest.approx(truth, rel=2e-3)
    return calls


@pytest.mark.parametrize("seed", [pytest.param(each, marks=pytest.mark.long if each % 2 else []) for each in range(16)])
def test_a_bus_with_faults_gives_no_wrong_value(opened: RigOpener, seed: int) -> None:
    storm(FaultyMonitorBench(opened), seed)


@pytest.mark.long
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_buses_with_faults_give_no_wrong_value(opened: RigOpener, hundred: int) -> None:
    good = failed = 0
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        calls = storm(FaultyMonitorBench(opened), seed)
        good, failed = good + calls.good, failed + len(calls.errors)
    assert good > 500
    assert failed > 300


def test_a_lost_setting_is_an_error(opened: RigOpener) -> None:
    bench = FaultyMonitorBench(opened)
    bench.mean()
    bench.faulty.misfortune = ScriptedFaults([Fault.UNHEARD])
    with pytest.raises(NoAnswer, match="monitor: CONF:POW"):
        bench.monitor.start_mean(0.1, "power")
    power = bench.monitor.start_mean(0.1, "power")
    wait(bench.clock, [power])
    assert power.power_w == pytest.approx(TRUTH_A / 0.08, rel=0.02)  # 0.08 A/W at 550 nm


def test_an_unknown_setting_is_refused_with_the_error_of_the_instrument(bench: MonitorBench) -> None:
    bench.monitor.dialect = replace(bench.monitor.dialect, low_pass="INP:NONSENSE {:d}")
    with pytest.raises(Refused, match="set the filter: error -113"):
        bench.monitor.set_low_pass(True)
