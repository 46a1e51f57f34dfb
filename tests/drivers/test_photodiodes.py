"""The array of converter modules: gain, settling, missing readings, detection of resets, restored settings."""

import re
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.drivers import BadAnswer, DeviceError, Forgotten, NoAnswer, PhotodiodeSettings, Refused, wait
from goniotwin.drivers.found import FoundSettings
from goniotwin.drivers.photodiodes.adam import AdamModule
from goniotwin.drivers.photodiodes.modbus import ModbusUnit
from goniotwin.protocols import adam
from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin.devices import RtuStation
from tests.conftest import RigOpener
from tests.drivers.photodiode_bench import NARROW, QUIET, SERIAL, BenchOpener, bench, read
from tests.drivers.test_left_as_found import Notes

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


TWOS_COMPLEMENT = (
    ("gain_uncertainty", 'raw_format = "twos-complement"\ngain_uncertainty'),
    ("[twin.electronics]\n", '[twin.electronics]\nraw_format = "twos-complement"\n'),
)


def test_the_raw_format_of_the_rig_file_is_that_of_the_module(opened: RigOpener) -> None:
    found = []
    for changes in ((), TWOS_COMPLEMENT, TWOS_COMPLEMENT[1:]):
        rig = opened(QUIET, *SERIAL, *changes, clock=VirtualClock(10.0))
        found.append(read(rig.rig.photodiodes, rig.rig.clock))
    np.testing.assert_array_equal(found[0], found[1])
    assert abs(found[0] - found[2]).min() == 0x8000  # the file has another format


def test_a_range_by_its_code_of_the_6000_series_is_written_by_that_of_the_4117(bench: BenchOpener) -> None:
    """`range_code = 0x0142`, as files of earlier versions have it."""
    rig = bench(True)
    assert rig.virtual is not None
    assert rig.virtual.modbus["adc-4"].inputs.ranges == [0x09] * 8
    assert rig.rig.photodiodes.settings.range.code == 0x09


@pytest.mark.parametrize(
    ("changes", "kind", "wrong"),
    [
        (
            {"range_code": 0x0180},
            "adam-6017",
            "0x0180 is not the code of a voltage range of an ADAM-6017; give one of 0x0103, ",
        ),
        (
            {"range_code": 0x07},
            "adam-4117",
            "0x07 is not the code of a voltage range of an ADAM-4117; give one of 0x08, 0x09, ",
        ),
        ({"range_code": 0x15}, "adam-6017", "0x15 is not the code"),
        ({"range_code": -1}, "adam-4117", "is not the code"),
        ({"raw_format": "twos-complement"}, "adam-6017", "raw_format: the registers of an ADAM-6017 are unsigned"),
    ],
)
def test_settings_that_a_module_cannot_have_are_refused(changes: dict[str, Any], kind: adam.ModelName, wrong: str) -> None:
    with pytest.raises(ValueError, match=wrong):
        PhotodiodeSettings((0.0,), (), (1e6,), kind, **changes)


def test_a_module_that_refuses_function_16_is_written_one_by_one_with_function_6(opened: RigOpener, tmp_path: Path) -> None:
    """Reported of an ADAM-4017+ on its hardware: function 16 fails on the registers of the ranges, function 6 works."""
    refusing = ("[twin.electronics]\n", "[twin.electronics]\nmultiple_writes = false\n")
    rig = opened(QUIET, NARROW, *SERIAL, refusing, clock=VirtualClock(10.0), transcript=tmp_path)
    assert rig.virtual is not None
    module, clock = rig.virtual.modbus["adc-4"], rig.rig.clock
    before = read(rig.rig.photodiodes, clock)
    assert module.inputs.ranges == [0x09] * 8
    module.reset(clock.now())
    assert rig.rig.photodiodes.reconnect() == ["photodiodes module 4: ranges set"]
    np.testing.assert_allclose(read(rig.rig.photodiodes, clock), before, atol=1)
    rig.close()
    functions = Counter(re.findall(r"write registers?, unit 5", (tmp_path / "photodiodes-4.txt").read_text(encoding="utf-8")))
    assert functions == {"write registers, unit 5": 2, "write register, unit 5": 2 * 3 * 8}  # connect, reconnect, close


@pytest.mark.parametrize("written", [1, 7])
def test_ranges_of_which_a_killed_program_has_written_some_are_restored(opened: RigOpener, written: int) -> None:
    """Function 06 takes one register of a module that refuses 16 (HC2, of an ADAM-4017P)."""
    rig = opened(QUIET, NARROW, *SERIAL, ("[twin.electronics]\n", "[twin.electronics]\nmultiple_writes = false\n"))
    assert rig.virtual is not None
    rig.rig.close()
    first, module, clock = rig.rig.photodiodes.modules[0], rig.virtual.modbus["adc-0"], rig.rig.clock
    notes = Notes()

    def driver() -> AdamModule:
        unit = ModbusUnit(first.bus, first.registers.unit, found=FoundSettings(notes))
        return AdamModule("module", unit, adam.ADAM_4117, 0x09, clock)

    write, left = module.write_registers, [written]

    def kill(address: int, values: list[int], t: float) -> None:
        if len(values) == 1 and not left[0]:
            raise KeyboardInterrupt
        left[0] -= len(values) == 1
        write(address, values, t)

    module.write_registers = kill  # type: ignore[method-assign]
    killed = driver()
    with pytest.raises(KeyboardInterrupt):
        killed.connect()
    killed.release()
    module.write_registers = write  # type: ignore[method-assign]
    assert module.inputs.ranges == [0x09] * written + [0x08] * (8 - written)
    following = driver()
    following.identify()
    following.close()
    assert (module.inputs.ranges, notes.text) == ([0x08] * 8, "")


def test_so_is_one_whose_confirmation_of_function_16_is_illegible(opened: RigOpener, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reported of an ADAM-4017+ on its hardware: the confirmation has a wrong checksum."""
    receive = RtuStation.receive

    def garble(station: RtuStation, data: bytes, t: float) -> None:
        receive(station, data, t)
        if data[1:2] == b"\x10" and station.outbox:
            due, reply = station.outbox.pop()
            station.outbox.append((due, reply[:-1] + bytes([reply[-1] ^ 0xFF])))

    monkeypatch.setattr(RtuStation, "receive", garble)
    rig = opened(QUIET, NARROW, *SERIAL, clock=VirtualClock(10.0))
    assert rig.rig.photodiodes.identities == ["ADAM-4117 firmware 5.06"] * 5
    assert read(rig.rig.photodiodes, rig.rig.clock).shape == (1, 36)


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


def test_a_module_with_the_letter_of_a_revision_in_its_name_is_the_same_model(bench: BenchOpener) -> None:
    rig = bench(False)
    assert rig.virtual is not None
    rig.virtual.modbus["adc-0"].model = replace(adam.ADAM_6017, name=(0x6017, 0x4400))
    assert rig.rig.photodiodes.reconnect() == []


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
