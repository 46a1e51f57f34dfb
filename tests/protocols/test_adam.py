"""Scaling of the ADAM's registers."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.protocols import adam


def test_ten_volts_either_way_as_the_manual_has_it() -> None:
    bipolar = adam.RANGES[adam.PLUS_MINUS_10_V]
    assert bipolar.volts(0) == -10.0
    assert bipolar.volts(65535) == pytest.approx(10.0, abs=1e-12)
    assert bipolar.raw(0.0) == 32768
    assert bipolar.lsb_v == pytest.approx(0.305e-3, rel=1e-3)


@given(st.sampled_from(sorted(adam.RANGES)), st.integers(0, 65535))
def test_a_raw_value_comes_back(code: int, raw: int) -> None:
    assert adam.RANGES[code].raw(adam.RANGES[code].volts(raw)) == raw


@given(st.sampled_from(sorted(adam.RANGES)), st.floats(-100.0, 100.0))
def test_a_voltage_is_kept_to_half_a_step_or_clipped(code: int, volts: float) -> None:
    each = adam.RANGES[code]
    raw = int(each.raw(volts))
    if each.low_v <= volts <= each.high_v:
        assert abs(each.volts(raw) - volts) <= 0.5001 * each.lsb_v
    else:
        assert each.saturated(np.array([raw], dtype=np.uint16)).all()


def test_a_current_is_the_voltage_over_the_shunt() -> None:
    loop = adam.RANGES[adam.FOUR_TO_TWENTY_MA]
    assert [loop.shown(0), loop.shown(65535)] == pytest.approx([4.0, 20.0])
    assert loop.raw(12e-3 * 120.0) in (32767, 32768)  # half way, over 120 ohm
    assert loop.code not in adam.VOLTAGE_RANGES


def test_small_ranges_show_millivolts() -> None:
    assert adam.RANGES[0x0103].shown(65535) == pytest.approx(150.0)
    assert adam.RANGES[0x0140].shown(65535) == pytest.approx(1.0)


def test_a_firmware_version_reads_as_in_the_manual() -> None:
    assert adam.firmware([0x0506, 0]) == "5.06"
