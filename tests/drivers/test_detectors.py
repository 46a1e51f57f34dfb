"""Photodiodes and monitor: values read by their drivers."""

import numpy as np
import pytest

from goniotwin.drivers import DeviceError, Rig, wait
from goniotwin.protocols import adam
from tests.conftest import RigOpener

QUIET = ("noise = true", "noise = false")


def illuminate(rig: Rig) -> None:
    wait(rig.clock, [rig.axes["sigma"].start(30.0), rig.axes["beta"].start(180.0)])
    wait(rig.clock, [rig.monochromator.start_shutter(opened=True)])


def test_the_etalon_gives_the_photocurrent_of_the_closed_form(opened: RigOpener) -> None:
    """A Lambertian's photocurrent: E rho / pi times the etendue of a photodiode times its responsivity."""
    exact = ("[twin.light]", "[twin.electronics]\ngain_spread = 0.0\n\n[twin.light]")
    rig = opened(QUIET, ("drift_per_hour = 0.02", "drift_per_hour = 0.0"), exact)
    assert rig.virtual is not None
    rig.virtual.mount("etalon")
    wait(rig.rig.clock, [rig.rig.photodiodes.start_gain(3)])
    dark = rig.rig.photodiodes.start_readings(1)
    wait(rig.rig.clock, [dark])
    illuminate(rig.rig)
    bright = rig.rig.photodiodes.start_readings(1)
    wait(rig.rig.clock, [bright])
    step = adam.RANGES[adam.PLUS_MINUS_10_V].lsb_v
    current = (bright.counts[0, 0].astype(float) - dark.counts[0, 0]) * step / 1e11
    # At the normal: irradiance of the spot at 30 deg, times rho/pi, times the etendue of the 5 mm disc at 300 mm with its
    # 0.5 deg field. Parts of the field look past the 5 mm spot, so the closed form is an upper bound, about 1.1e-11 A * 1.25.
    irradiance = 2.0e3 * 5.0 * 0.18 * np.pi * 5.0**2 / 800.0**2 * np.cos(np.radians(30.0))
    field = np.pi * np.radians(0.25) ** 2
    etendue = np.pi * 2.5e-3**2 * field
    bound = irradiance * 0.99 / np.pi * etendue * 0.3
    assert 0.7 * bound < current < bound


def test_a_reading_waits_for_the_settling_time_of_the_amplifiers(opened: RigOpener) -> None:
    rig = opened(QUIET).rig
    wait(rig.clock, [rig.photodiodes.start_gain(3)])
    first, second = rig.photodiodes.start_readings(1), rig.photodiodes.start_readings(1)
    wait(rig.clock, [first])
    rig.clock.sleep_until(rig.clock.now() + 10.0)
    wait(rig.clock, [second])
    np.testing.assert_allclose(first.counts.astype(float), second.counts.astype(float), atol=1.0)


def test_readings_are_one_conversion_apart_and_never_repeated(opened: RigOpener) -> None:
    rig = opened().rig
    wait(rig.clock, [rig.photodiodes.start_gain(3)])
    start = rig.clock.now()
    readings = rig.photodiodes.start_readings(32)
    wait(rig.clock, [readings])
    settings = rig.photodiodes.settings
    expected = settings.wait_s + 31 * settings.period_s + settings.fetching_seconds(after_change=True)
    assert rig.clock.now() - start == pytest.approx(expected, abs=0.01)
    repeated = np.all(readings.counts[1:] == readings.counts[:-1], axis=1)
    assert not repeated.any()


def test_two_reads_within_a_conversion_give_the_same_value(opened: RigOpener) -> None:
    rig = opened()
    assert rig.virtual is not None
    module = rig.virtual.modbus["adc-0"]
    assert module.registers(0, 8, 100.001) == module.registers(0, 8, 100.002)
    assert module.registers(0, 8, 100.001) != module.registers(0, 8, 100.2)


def test_the_monitor_averages_over_the_given_time(opened: RigOpener) -> None:
    rig = opened().rig
    illuminate(rig)
    start = rig.clock.now()
    mean = rig.monitor.start_mean(2.5)
    wait(rig.clock, [mean])
    assert rig.clock.now() - start == pytest.approx(2.5, abs=0.05)
    assert mean.current_a == pytest.approx(1.4e-7, rel=0.02)


def test_lamp_and_monitor_drift_together(opened: RigOpener) -> None:
    rig = opened(QUIET, ("drift_per_hour = 0.02", "drift_per_hour = 1.0"))
    assert rig.virtual is not None
    rig.virtual.mount("etalon")
    illuminate(rig.rig)
    wait(rig.rig.clock, [rig.rig.photodiodes.start_gain(3)])
    ratios = []
    for _ in range(2):
        readings, mean = rig.rig.photodiodes.start_readings(4), rig.rig.monitor.start_mean(0.3)
        wait(rig.rig.clock, [readings, mean])
        ratios.append((readings.counts[:, 1].mean() - 32768.0 - 660.0) / mean.current_a)
        rig.rig.clock.sleep_until(rig.rig.clock.now() + 360.0)
    assert ratios[1] == pytest.approx(ratios[0], rel=0.01)


def test_an_overrange_of_the_monitor_is_an_error_and_not_a_value(opened: RigOpener) -> None:
    rig = opened(("range_a = 500e-9", "range_a = 50e-9")).rig
    illuminate(rig)
    with pytest.raises(DeviceError, match="overrange"):
        wait(rig.clock, [rig.monitor.start_mean(0.1)])


def test_a_real_rig_file_with_a_simulated_instrument_is_refused(opened: RigOpener) -> None:
    rig = opened().rig
    rig.simulated = False
    outcome = rig.connect()
    assert outcome["axes"] is None
    assert "simulated" in str(outcome["monitor"])
