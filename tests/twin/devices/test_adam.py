"""The virtual converter modules: register and coil maps, ranges, statistics, refusals, power-on."""

import struct

import numpy as np
import pytest

from goniotwin.protocols import adam
from goniotwin.twin.devices import Adam4117, Adam6017, ConverterModule
from goniotwin.twin.devices.adam import ModbusFault
from goniotwin.twin.plant import Plant
from tests.conftest import RigOpener

T = 100.0
PERIOD = 0.08  # eight channels at 100 conversions a second


@pytest.fixture
def plant(opened: RigOpener) -> Plant:
    rig = opened(("noise = true", "noise = false"))
    assert rig.virtual is not None
    return rig.virtual.plant


@pytest.fixture
def module(plant: Plant) -> Adam6017:
    found = Adam6017(plant, 0)
    found.write_coils(adam.DIGITAL_OUTPUT, [True, True], 1.0)  # gain 3, so that each input has a voltage of its own
    return found


def test_the_average_is_that_of_the_enabled_channels(module: Adam6017) -> None:
    counts = module.registers(adam.AI_VALUE, 9, T)
    assert counts[8] == round(np.mean(counts[:8]))
    module.write_registers(adam.CHANNEL_ENABLE, [0b101], T)
    fewer = module.registers(adam.AI_VALUE, 9, T)
    assert fewer[8] == round((counts[0] + counts[2]) / 2)
    assert [fewer[c] for c in (1, 3, 4, 5, 6, 7)] == [0] * 6


def test_floats_come_low_word_first_in_volts(module: Adam6017) -> None:
    words = module.registers(adam.FLOAT_VALUE, 18, T)
    floats = [struct.unpack(">f", struct.pack(">HH", words[at + 1], words[at]))[0] for at in range(0, 18, 2)]
    raw = module.registers(adam.AI_VALUE, 9, T)
    scale = adam.RANGES[adam.PLUS_MINUS_10_V]
    assert floats == pytest.approx([scale.volts(each) for each in raw], rel=1e-6)


def test_maximum_and_minimum_hold_an_unread_peak_until_they_are_reset(module: Adam6017) -> None:
    rest = module.registers(adam.AI_VALUE, 1, T)[0]
    module.registers(adam.MAXIMUM, 9, T)
    module.write_coils(adam.DIGITAL_OUTPUT, [False, False], T + 0.1)  # gain 0: the dark voltage vanishes for a second
    module.write_coils(adam.DIGITAL_OUTPUT, [True, True], T + 1.1)
    later = T + 4.0
    low = module.registers(adam.MINIMUM, 1, later)[0]
    assert low < rest
    assert module.registers(adam.MAXIMUM, 1, later)[0] >= rest
    module.write_coils(adam.RESET_MINIMUM, [True], later)
    assert module.registers(adam.MINIMUM, 1, later + 1.0)[0] == pytest.approx(rest, abs=1)
    assert module.coils(adam.RESET_MINIMUM, 1, later) == [False]


@pytest.mark.parametrize("code", sorted(adam.RANGES))
def test_each_range_scales_and_clips(module: ConverterModule, plant: Plant, code: int) -> None:
    module = module if code in module.model.ranges else Adam4117(plant, 0)
    module.write_registers(adam.RANGE_CODE, [code] * 8, T)
    t = T + 1.0
    volts = plant.volts(0, t)
    assert module.registers(adam.AI_VALUE, 8, t) == [adam.RANGES[code].raw(v) for v in volts]


def test_a_change_of_range_loses_the_next_reading(module: Adam6017, plant: Plant) -> None:
    before = module.registers(adam.AI_VALUE, 8, T)
    module.write_registers(adam.RANGE_CODE, [0x0140] * 8, T)
    assert module.registers(adam.AI_VALUE, 8, T + 0.99 * PERIOD) == before
    after = module.registers(adam.AI_VALUE, 8, T + 2.0 * PERIOD)
    assert after == [adam.RANGES[0x0140].raw(v) for v in plant.volts(0, T + 2.0 * PERIOD)]
    assert after != before
    module.write_registers(adam.RANGE_CODE, [0x0140], T + 1.0)  # the same again changes nothing
    assert module.registers(adam.AI_VALUE, 8, T + 1.0) == after


def test_a_broken_wire_shows_in_the_range_of_4_to_20_ma(module: Adam6017, plant: Plant) -> None:
    """Coils 0 to 7 of an ADAM-4117: two public drivers, `ADAM411xRegister` of SolarNode and `Adam_4117` for MinimalModbus."""
    for each, first, code in ((module, 120, 0x0180), (Adam4117(plant, 0), 0, 0x07)):
        assert each.coils(first, 8, T) == [False] * 8
        each.write_registers(adam.RANGE_CODE + 2, [code], T)
        assert each.coils(first, 8, T + 1.0) == [channel == 2 for channel in range(8)]
    assert module.coils(adam.HIGH_ALARM, 8, T) + module.coils(adam.LOW_ALARM, 8, T) == [False] * 16


@pytest.mark.parametrize(("address", "count"), [(9, 1), (8, 2), (29, 1), (48, 1), (100, 1), (208, 2), (214, 1), (221, 1)])
def test_there_is_nothing_between_the_registers(module: Adam6017, address: int, count: int) -> None:
    with pytest.raises(ModbusFault, match="2"):
        module.registers(address, count, T)


@pytest.mark.parametrize(
    ("address", "values", "code"),
    [
        (adam.RANGE_CODE, [0x0143, 0x0007], 3),
        (adam.RANGE_CODE + 7, [0x0143, 0x0143], 2),
        (adam.AI_VALUE, [1], 2),
        (adam.CHANNEL_ENABLE, [0x100], 3),
        (adam.MODULE_NAME, [1], 2),
    ],
)
def test_what_cannot_be_written_changes_nothing(module: Adam6017, address: int, values: list[int], code: int) -> None:
    before = module.registers(adam.RANGE_CODE, 8, T)
    with pytest.raises(ModbusFault, match=str(code)):
        module.write_registers(address, values, T)
    assert module.registers(adam.RANGE_CODE, 8, T) == before


def test_power_on_forgets_ranges_gain_and_outputs(module: Adam6017, plant: Plant) -> None:
    module.write_registers(adam.RANGE_CODE, [0x0140] * 8, T)
    module.write_registers(adam.CHANNEL_ENABLE, [1], T)
    assert plant.gain[0].at(T) == 3
    module.reset(T + 1.0)
    assert module.registers(adam.RANGE_CODE, 8, T + 1.0) == [adam.PLUS_MINUS_10_V] * 8
    assert module.coils(adam.DIGITAL_OUTPUT, 2, T + 1.0) == [False, False]
    assert module.registers(adam.CHANNEL_ENABLE, 1, T + 1.0) == [0xFF]
    assert plant.gain[0].at(T + 1.0) == 0


def test_a_serial_module_has_no_outputs_and_no_statistics_but_a_watchdog(plant: Plant) -> None:
    module = Adam4117(plant, 0)
    assert module.registers(adam.MODULE_NAME, 2, T) == [0x4117, 0x0000]
    assert module.registers(adam.COMM_SAFETY_ENABLE, 2, T) == [0, 0]
    assert module.registers(adam.RANGE_CODE, 8, T) == [0x08] * 8
    for foreign in (0x0143, 0x02):
        with pytest.raises(ModbusFault, match="3"):
            module.write_registers(adam.RANGE_CODE, [foreign], T)
    module.write_registers(adam.COMM_SAFETY_ENABLE, [1], T)
    assert module.registers(adam.COMM_SAFETY_ENABLE, 2, T) == [1, 0]
    for address in (adam.AVERAGE, adam.MAXIMUM, adam.FLOAT_VALUE):
        with pytest.raises(ModbusFault, match="2"):
            module.registers(address, 1, T)
    with pytest.raises(ModbusFault, match="2"):
        module.write_coils(adam.DIGITAL_OUTPUT, [True], T)


def test_a_failure_or_busyness_is_answered_as_often_as_asked_for(module: Adam6017) -> None:
    module.refusals.extend([adam.DEVICE_FAILURE, adam.BUSY])
    for code in (adam.DEVICE_FAILURE, adam.BUSY):
        with pytest.raises(ModbusFault, match=str(code)):
            module.registers(adam.AI_VALUE, 8, T)
    assert len(module.registers(adam.AI_VALUE, 8, T)) == 8
