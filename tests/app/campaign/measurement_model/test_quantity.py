"""Quantities carry the effects of their inputs as GTC does, which differentiates the formula of a value by itself."""

import functools
import operator

import GTC
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.campaign.measurement_model.quantity import NONE, Quantity
from goniotwin.arrays import Floats, Indices

INPUTS = 5
VALUES = st.floats(0.5, 2.0)
EFFECTS = st.lists(st.floats(-0.1, 0.1), min_size=3, max_size=3)


@st.composite
def readings(draw: st.DrawFn) -> tuple[float, float, float, dict[int, float]]:
    """A value, what it has alone, the effect of what all have, and those of some of the grouped inputs, by their numbers."""
    some = draw(st.dictionaries(st.integers(0, INPUTS - 1), st.floats(-0.1, 0.1), min_size=1, max_size=3))
    return draw(VALUES), draw(st.floats(0.001, 0.1)), draw(st.floats(-0.1, 0.1)), some


Reading = tuple[float, float, float, dict[int, float]]


def quantity(several: list[Reading]) -> Quantity:
    """The values (n,) of readings."""
    m = max(len(some) for *_, some in several)
    member, effect = np.full((len(several), m), NONE, dtype=np.int32), np.zeros((len(several), m))
    for k, (*_, some) in enumerate(several):
        member[k, : len(some)], effect[k, : len(some)] = list(some), list(some.values())
    values, own, common = (np.array([each[k] for each in several]) for k in range(3))
    return Quantity(values, {"noise": own**2}).with_common("tilt", common).with_grouped("lamp", member, effect)


class Independent:
    """The same readings as uncertain numbers of GTC."""

    def __init__(self) -> None:
        self.tilt = GTC.ureal(0.0, 1.0)
        self.lamps = [GTC.ureal(0.0, 1.0) for _ in range(INPUTS)]

    def number(self, reading: Reading) -> GTC.lib.UncertainReal:
        value, own, common, some = reading
        lamps = sum(effect * self.lamps[number] for number, effect in some.items())
        return value + GTC.ureal(0.0, own) + common * self.tilt + lamps


@given(st.lists(st.tuples(readings(), readings(), readings()), min_size=1, max_size=4))
def test_differences_and_quotients_have_the_uncertainty_and_the_components_that_gtc_finds(
    several: list[tuple[Reading, Reading, Reading]],
) -> None:
    found = [quantity([each[k] for each in several]) for k in range(3)]
    result = (found[0] - found[1]) / found[2].scaled(1.5)
    for k, each in enumerate(several):
        program = Independent()
        one, other, divisor = map(program.number, each)
        expected = (one - other) / (1.5 * divisor)
        assert result.value[k] == pytest.approx(GTC.value(expected), rel=1e-12, abs=1e-15)
        assert result.variance[k] == pytest.approx(GTC.variance(expected), rel=1e-9, abs=1e-18)
        assert result.common["tilt"][k] == pytest.approx(sensitivity(expected, program.tilt), rel=1e-9, abs=1e-14)
        terms = result.grouped["lamp"]
        numbers = [number for number in terms.member[k].tolist() if number != NONE]
        assert len(numbers) == len(set(numbers))
        by_number = dict(zip(terms.member[k].tolist(), terms.effect[k].tolist(), strict=True))
        for number, lamp in enumerate(program.lamps):
            assert by_number.get(number, 0.0) == pytest.approx(sensitivity(expected, lamp), rel=1e-9, abs=1e-14)


def sensitivity(result: GTC.lib.UncertainReal, source: GTC.lib.UncertainReal) -> float:
    """The derivative by an input, whose standard uncertainty is 1."""
    return float(GTC.rp.sensitivity(result, source))


@given(st.lists(readings(), min_size=1, max_size=6))
def test_a_mean_of_repeats_has_each_input_by_its_number_of_readings(several: list[Reading]) -> None:
    program = Independent()
    numbers = [program.number(each) for each in several]
    expected = functools.reduce(operator.add, numbers) / len(numbers)
    mean = quantity(several).summed().scaled(1.0 / len(several))
    assert float(mean.variance) == pytest.approx(GTC.variance(expected), rel=1e-9)
    # The same of values in a second axis: the repeats are along the first.
    table = quantity(several).each(lambda array: np.stack([array, array], axis=1))
    assert (table.summed().scaled(1.0 / len(several))).variance == pytest.approx(np.full(2, GTC.variance(expected)), rel=1e-9)


@given(st.lists(readings(), min_size=1, max_size=4))
def test_one_reading_over_itself_is_certain_but_for_what_each_has_alone(several: list[Reading]) -> None:
    """The same row as sample and as etalon: a term is an input of the value, whatever path it came by."""
    signal = quantity(several)
    rows = np.arange(len(several), dtype=np.int32)
    quotient = signal.own_as("reading", rows) / signal.own_as("reading", rows)
    assert quotient.value == pytest.approx(np.ones(len(several)), rel=1e-15)
    assert quotient.variance == pytest.approx(np.zeros(len(several)), abs=1e-30)


@given(st.lists(readings(), min_size=2, max_size=6), st.data())
def test_joined_parts_and_columns_are_the_whole(several: list[Reading], data: st.DataObject) -> None:
    cut = data.draw(st.integers(1, len(several) - 1))
    whole = quantity(several)
    joined = Quantity.join([quantity(several[:cut]), quantity(several[cut:])])
    for each in (joined, Quantity(np.zeros(0)).of_columns(whole.columns())):
        assert np.array_equal(each.value, whole.value)
        assert each.components.keys() == whole.components.keys()
        assert all(np.array_equal(each.components[name], variance) for name, variance in whole.components.items())


def test_a_part_without_a_family_has_none_of_it() -> None:
    one = Quantity(np.ones(2)).with_grouped("lamp", np.array([[3], [4]], dtype=np.int32), np.ones((2, 1)))
    joined = Quantity.join([Quantity(np.ones(1), {"noise": np.ones(1)}), one])
    assert joined.components["lamp"].tolist() == [0.0, 1.0, 1.0]
    assert joined.components["noise"].tolist() == [1.0, 0.0, 0.0]
    member: Indices = joined.grouped["lamp"].member
    assert member.tolist() == [[NONE], [3], [4]]


@pytest.mark.parametrize("factor", [2.0, np.array([1.0, -3.0])])
def test_an_exact_factor_scales_effects_with_their_signs(factor: Floats | float) -> None:
    found = Quantity(np.ones(2), {"noise": np.ones(2)}).with_common("tilt", np.array([0.1, 0.2])).scaled(factor)
    assert found.common["tilt"] == pytest.approx(np.array([0.1, 0.2]) * factor)
    assert found.own["noise"] == pytest.approx(np.square(factor) * np.ones(2))
