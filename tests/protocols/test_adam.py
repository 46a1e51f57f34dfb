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
    loop = adam.RANGES[0x0180]
    assert [loop.shown(0), loop.shown(65535)] == pytest.approx([4.0, 20.0])
    assert loop.raw(12e-3 * 120.0) in (32767, 32768)  # half way, over 120 ohm


NET_LIBRARY = {
    0x07: (4.0, 20.0), 0x08: (-10.0, 10.0), 0x09: (-5.0, 5.0), 0x0A: (-1.0, 1.0), 0x0B: (-500.0, 500.0), 0x0C: (-150.0, 150.0),
    0x0D: (-20.0, 20.0), 0x15: (-15.0, 15.0), 0x48: (0.0, 10.0), 0x49: (0.0, 5.0), 0x4A: (0.0, 1.0), 0x4B: (0.0, 500.0),
    0x4C: (0.0, 150.0), 0x4D: (0.0, 20.0), 0x55: (0.0, 15.0),
}  # fmt: skip
"""Codes and limits of the ADAM-4117 in the maker's .NET library: `Adam4117_InputRange`, `GetAdam4117RangeHighLow`."""


def test_the_codes_of_a_4117_are_those_of_the_makers_own_library() -> None:
    assert adam.ADAM_4117.ranges == NET_LIBRARY.keys()
    for code, limits in NET_LIBRARY.items():
        each = adam.RANGES[code]
        assert (each.shown(0), each.shown(65535)) == pytest.approx(limits)


def test_a_code_of_the_6000_series_is_the_same_range_of_a_4117() -> None:
    for code in adam.ADAM_6017.ranges:
        there, here = adam.RANGES[code], adam.ADAM_4117.range(code)
        assert here is not None
        assert (here.low_v, here.high_v, here.current) == (there.low_v, there.high_v, there.current)
        assert here.code <= 0xFF
    assert adam.ADAM_6017.range(0x15) is None  # +-15 V
    assert adam.ADAM_4117.range(0x0141) is None


def test_the_manuals_example_of_twos_complement() -> None:
    """ADAM-4000 Series User's Manual, B.1.3: -1.234 V in the range of +-5 V is E069, full scale 7FFF and 8000."""
    narrow, flip = adam.RANGES[0x09], adam.sign_bit("twos-complement")
    assert narrow.volts(0xE069 ^ flip) == pytest.approx(-1.234, abs=narrow.lsb_v)
    assert [narrow.volts(0x8000 ^ flip), narrow.volts(0x7FFF ^ flip)] == pytest.approx([-5.0, 5.0])
    assert adam.sign_bit("unsigned") == 0


def test_small_ranges_show_millivolts() -> None:
    assert adam.RANGES[0x0103].shown(65535) == pytest.approx(150.0)
    assert adam.RANGES[0x0140].shown(65535) == pytest.approx(1.0)


def test_a_firmware_version_reads_as_in_the_manual() -> None:
    assert adam.firmware([0x0506, 0]) == "5.06"
