"""The grating's second order and the order-sorting filters, in the photocurrents and in the monitor's current."""

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
    """Plant with the etalon mounted, the shutter open and everything at rest since time 0."""
    model = read_rig(RIG).model()
    assert model is not None
    result = Plant(replace(model, noise=False, light=replace(model.light, drift_per_hour=0.0), order_sorting=sorting))
    result.mount("etalon", 0.0)
    result.shutter_open.set(0.0, True)
    result.wavelength_nm.set(0.0, wavelength_nm)
    result.wheel.set(0.0, float(position))
    return result


def light(plant: Plant) -> tuple[float, float]:
    """Largest photocurrent, and the monitor's current without its dark current, A."""
    return float(plant.photocurrents_a(1.0).max()), plant.monitor_a(1.0, 1.1) - plant.model.monitor.dark_a


@pytest.mark.parametrize(
    ("position", "first", "second"),
    [(1, 1.0, SHARE), (2, 0.9, 0.0), (3, 0.8, 0.8 * SHARE)],  # open; red glass; a cut-on below 380 nm
)
def test_each_filter_transmits_its_share_of_both_orders(position: int, first: float, second: float) -> None:
    bare_diode, bare_monitor = light(plant(OrderSorting()))
    diode, monitor = light(plant(OrderSorting(SHARE, (RED, GREEN)), position=position))
    expected = first + second * LAMP[380.0] * DIODES[380.0] / (LAMP[760.0] * DIODES[760.0])
    assert diode / bare_diode == pytest.approx(expected, rel=1e-9)
    assert monitor / bare_monitor == pytest.approx(first + second * LAMP[380.0] / LAMP[760.0], rel=1e-9)


def test_there_is_no_second_order_of_light_up_to_355_nm() -> None:
    for wavelength, present in ((710.0, False), (710.1, True)):
        first, both = (light(plant(OrderSorting(share), wavelength)) for share in (0.0, SHARE))
        assert (both[0] > first[0], both[1] > first[1]) == (present, present)


def test_a_filter_blocks_a_set_wavelength_below_its_cut_on() -> None:
    assert light(plant(OrderSorting(SHARE, (RED,)), 500.0, 2)) == (0.0, 0.0)


def test_filters_outside_the_beam_do_not_change_a_bit_of_the_result() -> None:
    """Without a second order, with filters in other positions of the wheel."""
    for wavelength in (550.0, 760.0):
        plain, other = plant(OrderSorting(), wavelength), plant(OrderSorting(0.0, (RED, GREEN)), wavelength)
        np.testing.assert_array_equal(plain.photocurrents_a(1.0), other.photocurrents_a(1.0))
        assert light(plain) == light(other)


def test_the_nearest_position_is_in_the_beam_while_the_wheel_turns() -> None:
    turning = plant(OrderSorting(0.0, (RED,)))
    open_light = light(turning)[0]
    turning.wheel.slew(2.0, 4.0, 3.0)  # past the red glass, to an open position
    shares = [float(turning.photocurrents_a(t).max()) / open_light for t in (2.4, 2.6, 3.4, 3.6, 9.0)]
    assert shares == pytest.approx([1.0, 0.9, 0.9, 1.0, 1.0])
    whole, changing = turning.monitor_a(10.0, 12.0), turning.monitor_a(2.0, 4.0)
    assert changing / whole == pytest.approx(0.95, abs=0.01)  # half of that time behind 0.9


def test_a_reading_after_a_turn_of_the_wheel_is_of_the_new_filter() -> None:
    turned = plant(OrderSorting(0.0, (RED,)))
    before = turned.volts(0, 5.0).copy()
    turned.wheel.slew(6.0, 7.0, 2.0)
    after = turned.volts(0, 8.0)
    turned.shutter_open.set(9.0, False)
    dark = turned.volts(0, 60.0)
    lit = int(np.argmax(before))
    assert (after[lit] - dark[lit]) / (before[lit] - dark[lit]) == pytest.approx(0.9, rel=1e-6)
