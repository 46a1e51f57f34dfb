"""The converter modules on wires with faults, TCP and RTU: no wrong value, bounded time, recovery."""

import contextlib

import numpy as np
import pytest

from goniotwin.app.rig import OpenRig
from goniotwin.drivers import DeviceError, NoAnswer, PhotodiodeArray
from goniotwin.mocks.faults import ON_MODBUS, ON_MODBUS_RTU, Fault, FaultPlan, ScriptedFaults
from goniotwin.protocols.clock import Clock
from tests.drivers.bounded_calls import BoundedCalls
from tests.drivers.photodiode_bench import BenchOpener, bench, insert_faults, read

__all__ = ["bench"]

MOST_S = 5.0
"""Five timeouts of 1 s: see drivers.photodiodes.adam."""


@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize("fault", [Fault.LATE, Fault.LOST, Fault.UNHEARD, Fault.REPEATED, Fault.TRUNCATED, Fault.MERGED])
def test_a_single_fault_gives_no_error_and_no_wrong_value(bench: BenchOpener, serial: bool, fault: Fault) -> None:
    rig = bench(serial)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    gain = 0 if serial else 3
    read(array, clock, gain)
    expected = read(array, clock, gain)
    script = ScriptedFaults([])
    insert_faults(rig, script, late_s=1.0 + 0.02)
    read(array, clock, gain)
    script.script = [Fault.NONE, fault]
    np.testing.assert_allclose(read(array, clock, gain, 2), np.repeat(expected, 2, axis=0), atol=1)
    assert script.met == [fault]


def read_with_faults(rig: OpenRig, serial: bool, misfortune: FaultPlan, late_s: float) -> BoundedCalls:
    """Groups of readings until the last fault; every returned value is true. Then there are no faults, and it recovers."""
    array, clock = rig.rig.photodiodes, rig.rig.clock
    gains = (0,) if serial else (3, 0, 2)
    expected = {gain: read(array, clock, gain, 2)[1] for gain in gains}
    insert_faults(rig, misfortune, late_s)
    calls = BoundedCalls(clock, "photodiodes", MOST_S)
    for _ in range(500):
        if misfortune.exchanges >= misfortune.until + 20:
            break
        failed = len(calls.errors)
        gain = gains[(calls.good + failed) % len(gains)]
        with calls.attempt():
            calls.wait(array.start_gain(gain))
            readings = array.start_readings(2)
            calls.wait(readings)
            np.testing.assert_allclose(readings.counts, [expected[gain]] * 2, atol=1)
        if len(calls.errors) > failed:
            reconnect(array, clock)
    for gain in gains:
        np.testing.assert_allclose(read(array, clock, gain), [expected[gain]], atol=1)
    return calls


def reconnect(array: PhotodiodeArray, clock: Clock) -> None:
    """Reconnect with retries, as the engine or the operator does."""
    for _ in range(20):
        with contextlib.suppress(DeviceError):
            array.reconnect()
            return
        clock.sleep_until(clock.now() + 0.1)


UNDETECTED_OVER_TCP = (Fault.CORRUPTED, Fault.NOISE)


def read_with_random_faults(rig: OpenRig, serial: bool, seed: int) -> BoundedCalls:
    """A late reply comes after the timeout of 1 s: while the line is drained, while a marker is read, or after recovery."""
    late_s = 0.98 + 0.005 * (seed % 60)
    kinds = ON_MODBUS_RTU if serial else tuple(each for each in ON_MODBUS if each not in UNDETECTED_OVER_TCP)
    return read_with_faults(rig, serial, FaultPlan(seed, kinds, 0.02, until=200), late_s)


@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize("seed", [pytest.param(each, marks=pytest.mark.long if each % 12 else []) for each in range(0, 60, 6)])
def test_a_wire_with_faults_gives_no_wrong_value(bench: BenchOpener, serial: bool, seed: int) -> None:
    calls = read_with_random_faults(bench(serial), serial, seed)
    assert calls.good + len(calls.errors) >= 3


@pytest.mark.long
@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize("hundred", range(10))
def test_a_thousand_wires_with_faults_give_no_wrong_value(bench: BenchOpener, serial: bool, hundred: int) -> None:
    good = failed = 0
    for seed in range(1000 + 100 * hundred, 1100 + 100 * hundred):
        calls = read_with_random_faults(bench(serial), serial, seed)
        good, failed = good + calls.good, failed + len(calls.errors)
    assert good > 300
    assert failed > 20


@pytest.mark.parametrize("serial", [False, True])
def test_a_disconnected_wire_is_reopened_when_it_is_connected_again(bench: BenchOpener, serial: bool) -> None:
    rig = bench(serial)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    expected = read(array, clock)
    script = ScriptedFaults([])
    insert_faults(rig, script)
    script.script = [Fault.UNPLUGGED]
    if serial:
        with pytest.raises(NoAnswer, match=r"photodiodes module 0: .*check address, cable and power"):
            read(array, clock)
        clock.sleep_until(clock.now() + 0.5)
    np.testing.assert_allclose(read(array, clock), expected, atol=1)
    assert script.met == [Fault.UNPLUGGED]


@pytest.mark.parametrize("seed", range(5))
def test_changed_bytes_over_tcp_raise_only_device_errors(bench: BenchOpener, seed: int) -> None:
    """Modbus TCP has no checksum: a changed count passes. No other exception than DeviceError may be raised."""
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    insert_faults(rig, FaultPlan(seed, UNDETECTED_OVER_TCP, 0.5, until=100))
    for _ in range(10):
        try:
            read(array, clock, 3)
        except DeviceError:
            continue
