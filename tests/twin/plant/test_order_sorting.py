"""The grating's second order and the filters that hold it back, in the photocurrents and in the monitor's."""

from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.rig import read_rig
from goniotwin.twin.plant import OrderSorting, Plant, WheelFilter
from tests.conftest import RIG

SHARE = 0.25
LAMP = {380.0: 0.75, 760.0: 0.95 - 0.05 * 110.0 / 130.0}
DIODES = {380.0: 0.10, 760.0: 0.38 + 0.10 * 110.0 / 130.0}
"""Relative radiance and responsivity, A/W: twin/plant/model.py, on the line between 650 and 780 nm."""
RED, GREEN = WheelFilter(2, 610.0, 0.9), WheelFilter(3, 370.0, 0.8)


def plant(sorting: OrderSorting, wavelength_nm: float = 760.0, position: int = 1) -> Plant:
    """With the etalon mounted, the shutter open and everything at rest since time 0."""
    model = read_rig(RIG).model()
    assert model is not None
    made = Plant(replace(model, noise=False, light=replace(model.light, drift_per_hour=0.0), order_sorting=sorting))
    made.mount("etalon", 0.0)
    made.shutter_open.set(0.0, True)
    made.wavelength_nm.set(0.0, wavelength_nm)
    made.wheel.set(0.0, float(position))
    return made


def light(made: Plant) -> tuple[float, float]:
    """The strongest photocurrent, and the monitor's current without its dark current, A."""
    return float(made.photocurrents_a(1.0).max()), made.monitor_a(1.0, 1.1) - made.model.monitor.dark_a


@pytest.mark.parametrize(
    ("position", "first", "second"),
    [(1, 1.0, SHARE), (2, 0.9, 0.0), (3, 0.8, 0.8 * SHARE)],  # open; red glass; one that cuts on below 380 nm
)
def test_each_filter_lets_its_share_of_both_orders_through(position: int, first: float, second: float) -> None:
    bare_diode, bare_monitor = light(plant(OrderSorting()))
    diode, monitor = light(plant(OrderSorting(SHARE, (RED, GREEN)), position=position))
    expected = first + second * LAMP[380.0] * DIODES[380.0] / (LAMP[760.0] * DIODES[760.0])
    assert diode / bare_diode == pytest.approx(expected, rel=1e-9)
    assert monitor / bare_monitor == pytest.approx(first + second * LAMP[380.0] / LAMP[760.0], rel=1e-9)


def test_the_lamp_has_nothing_up_to_355_nm() -> None:
    for wavelength, there in ((710.0, False), (710.1, True)):
        first, both = (light(plant(OrderSorting(share), wavelength)) for share in (0.0, SHARE))
        assert (both[0] > first[0], both[1] > first[1]) == (there, there)


def test_a_filter_holds_back_the_very_light_that_is_set_below_its_cut_on() -> None:
    assert light(plant(OrderSorting(SHARE, (RED,)), 500.0, 2)) == (0.0, 0.0)


def test_without_a_second_order_and_without_filters_every_bit_is_as_it_was() -> None:
    """Whatever stands in positions of the wheel that are not in the beam."""
    for wavelength in (550.0, 760.0):
        plain, other = plant(OrderSorting(), wavelength), plant(OrderSorting(0.0, (RED, GREEN)), wavelength)
        np.testing.assert_array_equal(plain.photocurrents_a(1.0), other.photocurrents_a(1.0))
        assert light(plain) == light(other)


def test_while_the_wheel_turns_the_nearest_position_is_in_the_beam() -> None:
    made = plant(OrderSorting(0.0, (RED,)))
    open_light = light(made)[0]
    made.wheel.slew(2.0, 4.0, 3.0)  # past the red glass, to an open position
    shares = [float(made.photocurrents_a(t).max()) / open_light for t in (2.4, 2.6, 3.4, 3.6, 9.0)]
    assert shares == pytest.approx([1.0, 0.9, 0.9, 1.0, 1.0])
    whole, part = made.monitor_a(10.0, 12.0), made.monitor_a(2.0, 4.0)
    assert part / whole == pytest.approx(0.95, abs=0.01)  # half of that time behind 0.9


def test_a_reading_after_the_wheel_has_turned_is_of_the_new_filter() -> None:
    made = plant(OrderSorting(0.0, (RED,)))
    before = made.volts(0, 5.0).copy()
    made.wheel.slew(6.0, 7.0, 2.0)
    after = made.volts(0, 8.0)
    offset = made.model.electronics.offset_v
    lit = int(np.argmax(before))
    dark = made._dark_a[lit] * made._gains[0] * (1.0 + made._deviation[0, lit])
    assert (after[lit] - offset - dark) / (before[lit] - offset - dark) == pytest.approx(0.9, rel=1e-6)
