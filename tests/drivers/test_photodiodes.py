"""The array of converter modules: gain, settling, missing readings, detection of resets, restored settings."""

import numpy as np
import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, PhotodiodeSettings, Refused, wait
from goniotwin.protocols import adam
from tests.drivers.photodiode_bench import BenchOpener, bench, read

__all__ = ["bench"]

TIMEOUT_S = 1.0


@pytest.mark.parametrize("serial", [False, True])
def test_both_wires_give_the_same_dark_currents(bench: BenchOpener, serial: bool) -> None:
    rig = bench(serial)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    counts = read(array, clock, 0 if serial else 3, 2)
    # 2 pA with a spread of 5 % at 1e11 V/A, and an offset of 1 mV
    volts = array.settings.range.low_v + counts * array.settings.range.lsb_v
    assert volts.mean() == pytest.approx(0.201, abs=0.01)
    assert np.ptp(volts, axis=0).max() <= 2 * array.settings.range.lsb_v


def test_identities_name_model_and_firmware(bench: BenchOpener) -> None:
    array = bench(True).rig.photodiodes
    assert array.connect() == "5 modules ADAM-4117"
    assert array.identities == ["ADAM-4117 firmware 5.06"] * 5


def test_a_gain_is_set_at_the_amplifiers_and_a_fixed_gain_cannot_be_changed(bench: BenchOpener) -> None:
    rig = bench(False)
    read(rig.rig.photodiodes, rig.rig.clock, 2)
    assert rig.virtual is not None
    assert [gain.at(rig.rig.clock.now()) for gain in rig.virtual.plant.gain] == [2] * 5
    with pytest.raises(Refused, match="gain 4"):
        rig.rig.photodiodes.start_gain(4)
    with pytest.raises(Refused, match="gain 1"):
        bench(True).rig.photodiodes.start_gain(1)


def test_the_first_reading_is_converted_after_the_settling_time() -> None:
    slow = PhotodiodeSettings((0.0,), (), (1e6,), "adam-6017", conversions_per_s=10.0)
    assert slow.wait_s == pytest.approx(2 * 1.01 * 0.8)
    assert PhotodiodeSettings((0.0,), (), (1e6,), "adam-6017").wait_s == pytest.approx(0.25 + 1.01 * 0.09)
    line = PhotodiodeSettings(tuple(float(k) for k in range(36)), (), (1e6,), exchange_s=0.04, kind="adam-4117")
    assert line.period_s == pytest.approx(1.01 * 5 * 0.04)  # reading five modules takes longer than their conversions


def test_counts_have_complete_readings_only(bench: BenchOpener) -> None:
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    readings = array.start_readings(3)
    assert readings.counts.shape == (0, 36)
    assert np.isnan(readings.mean_volts()).all()
    clock.sleep_until(readings.due)
    readings.poll()
    assert readings.counts.shape == (0, 36)  # one module of five


def test_a_saturated_reading_has_no_mean(bench: BenchOpener) -> None:
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    assert rig.virtual is not None
    rig.virtual.modbus["adc-0"].inputs.enabled = 0xFE  # channel 0 reads 0 from now on
    readings = array.start_readings(1)
    wait(clock, [readings])
    assert readings.saturated[0].tolist() == [True] + [False] * 35
    assert np.isnan(readings.mean_volts()).tolist() == [True] + [False] * 35


@pytest.mark.parametrize(("serial", "gain"), [(False, 3), (False, 0), (True, 0)])
def test_a_reset_of_a_module_is_detected_and_its_settings_are_restored(bench: BenchOpener, serial: bool, gain: int) -> None:
    rig = bench(serial)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    assert rig.virtual is not None
    before = read(array, clock, gain)
    rig.virtual.modbus["adc-3"].reset(clock.now())
    readings = array.start_readings(2)
    with pytest.raises(Forgotten, match=r"photodiodes module 3: .*reconnect"):
        wait(clock, [readings])
    with pytest.raises(Forgotten):
        wait(clock, [array.start_readings(1)])
    restored = array.reconnect()
    assert restored[0] == "photodiodes module 3: ranges set"
    assert len(restored) == (2 if gain else 1)
    readings = array.start_readings(1)
    wait(clock, [readings])
    np.testing.assert_allclose(readings.counts, before, atol=1)


def test_settings_that_change_without_a_reset_are_detected_at_intervals(bench: BenchOpener) -> None:
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    read(array, clock, 3)
    assert rig.virtual is not None
    rig.virtual.modbus["adc-1"].inputs.set_range(5, adam.PLUS_MINUS_10_V, clock.now())
    clock.sleep_until(clock.now() + 61.0)
    with pytest.raises(Forgotten, match=r"module 1.*ranges"):
        wait(clock, [array.start_readings(1)])


@pytest.mark.parametrize("serial", [False, True])
def test_a_silent_module_costs_few_timeouts_and_is_named(bench: BenchOpener, serial: bool) -> None:
    rig = bench(serial)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    read(array, clock)
    assert rig.virtual is not None
    rig.virtual.modbus["adc-2"].silent = True
    readings = array.start_readings(1)
    clock.sleep_until(readings.due)
    start = clock.now()
    with pytest.raises(NoAnswer, match=r"photodiodes module 2: .*check address, cable and power"):
        wait(clock, [readings])
    assert clock.now() - start < 5 * TIMEOUT_S
    assert len(readings.counts) == 0
    start = clock.now()
    with pytest.raises(NoAnswer):
        wait(clock, [array.start_readings(1)])
    assert clock.now() - start < 4 * TIMEOUT_S
    rig.virtual.modbus["adc-2"].silent = False
    array.reconnect()
    assert read(array, clock).shape == (1, 36)


def test_an_error_names_all_silent_modules_and_they_can_reconnect_later(bench: BenchOpener) -> None:
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    assert rig.virtual is not None
    for name in ("adc-1", "adc-4"):
        rig.virtual.modbus[name].silent = True
    with pytest.raises(DeviceError, match=r"module 1: .*also photodiodes module 4"):
        array.connect()
    with pytest.raises(NoAnswer, match="not connected"):
        array.start_readings(1)
    for name in ("adc-1", "adc-4"):
        rig.virtual.modbus[name].silent = False
    array.reconnect()
    assert read(array, clock).shape == (1, 36)


def test_a_module_of_another_model_at_the_address_is_refused(bench: BenchOpener) -> None:
    rig = bench(False)
    assert rig.virtual is not None
    rig.virtual.modbus["adc-0"].model = adam.ADAM_4117
    with pytest.raises(BadAnswer, match="it is 4117, not 6017"):
        rig.rig.photodiodes.reconnect()


@pytest.mark.parametrize("code", [adam.DEVICE_FAILURE, adam.BUSY])
def test_a_transient_exception_is_retried_once(bench: BenchOpener, code: int) -> None:
    rig = bench(False)
    array, clock = rig.rig.photodiodes, rig.rig.clock
    expected = read(array, clock)
    assert rig.virtual is not None
    rig.virtual.modbus["adc-0"].refusals.append(code)
    np.testing.assert_array_equal(read(array, clock), expected)
    rig.virtual.modbus["adc-0"].refusals.extend([code, code])
    with pytest.raises(Refused, match=f"exception {code}"):
        read(array, clock)
