"""A settled light is not computed again for each reading; every change is taken into account all the same."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from goniotwin.app.rig import read_rig
from goniotwin.twin import TwinModel
from goniotwin.twin.plant import OrderSorting, Plant, WheelFilter
from goniotwin.twin.plant.history import History
from goniotwin.twin.plant.motion import ramp_to_target
from goniotwin.twin.plant.plant import TICKS_AHEAD
from goniotwin.twin.plant.shaft import Heartbeat
from tests.conftest import RIG
from tests.rig_tables import disturbances

pytestmark = pytest.mark.xdist_group("settled")

STEPS = (0.0, 1e-4, 4e-4, 0.003, 0.0808, 0.5, 2.0)
"""Time between two readings, s: several within a conversion, and long enough for everything to come to rest."""


@pytest.fixture(scope="module")
def model() -> TwinModel:
    """The example rig with second order and filters, and with disturbances that mountings and moves draw again."""
    result = read_rig(RIG).model()
    assert result is not None
    sorting = OrderSorting(0.3, (WheelFilter(2, 520.0), WheelFilter(3, 350.0, 0.7)))
    off = disturbances(sample_tilt_deg=0.2, position_deg=0.05, repeatability=0.01, mounting=0.01, linearity_per_decade=0.01)
    return replace(result, order_sorting=sorting, disturbances=off)


def disturb(plant: Plant, t: float, kind: int, choice: int) -> None:
    """Change something, or nothing; sometimes in the past, as a module does whose host has been silent."""
    match kind:
        case 0:
            plant.gain[choice % plant.modules].set(t, choice % 4)
        case 1:
            plant.shutter_open.set(t, choice % 5 > 0)
        case 2:
            plant.wavelength_nm.slew(t, t + 0.1 * (choice % 10), (500.0, 550.0, 720.0)[choice % 3])
        case 3:
            plant.mount(("etalon", "gaussian-5", None)[choice % 3], t)
        case 4:
            plant.tilt_sample((0.0, 0.05)[choice % 2], t)
        case 5:
            shaft = list(plant.shafts.values())[choice % 4]
            start = t - (0.0, 0.4)[choice % 2]
            counter = shaft.drive(start).counter(start)
            trajectory = ramp_to_target(start, counter, 0.0, counter + 40.0 * (choice - 500), 3e4, 6e4, 6e4)
            shaft.follow(start, trajectory, 6e4, Heartbeat(t + (0.1, 60.0)[choice % 2]))
        case 6:
            plant.fade(choice % 36, 0.9)
        case 7:
            plant.wheel.slew(t, t + 0.1 * (choice % 10), 1.0 + choice % 3)


@pytest.mark.long
@settings(deadline=None)
@given(
    st.lists(st.tuples(st.sampled_from(STEPS), st.integers(0, 9), st.integers(0, 1000)), min_size=20, max_size=60),
)
def test_every_reading_equals_that_of_a_plant_without_a_cache(model: TwinModel, history: list[tuple[float, int, int]]) -> None:
    cached, fresh, t = Plant(model), Plant(model), 3.0
    for plant in (cached, fresh):
        plant.mount("etalon", 0.0)
        plant.shutter_open.set(0.0, True)
    for step, kind, choice in history:
        t += step
        for plant in (cached, fresh):
            disturb(plant, t, kind, choice)
        fresh.fade(0, 1.0)  # nothing is kept over a change of a photodiode, even by this factor
        module = choice % cached.modules
        single = fresh.volts(module, t)
        np.testing.assert_array_equal(cached.volts(module, t), single)
        coming = cached.coming_readings(tick := cached.tick(t))
        if coming is not None and coming.steady[module]:
            np.testing.assert_array_equal(coming.volts[module, tick - coming.first], single)


@pytest.mark.parametrize("crosstalk", [0.0, 0.01])
def test_coming_readings_are_those_of_each_tick(model: TwinModel, crosstalk: float) -> None:
    plant = Plant(replace(model, disturbances=disturbances(crosstalk=crosstalk)))
    plant.mount("etalon", 0.0)
    plant.shutter_open.set(0.0, True)
    plant.gain[1].set(2.0, 1)
    tick_s = plant.conversion_period_s / 8
    first = plant.tick(5.0 * tick_s + 10.0)
    coming = plant.coming_readings(first)
    assert coming is not None
    assert all(coming.steady)
    for tick in range(TICKS_AHEAD):
        t = (first + tick + 1.3) * tick_s  # within the tick that has ended last
        assert plant.tick(t) == first + tick
        for module in range(plant.modules):
            np.testing.assert_array_equal(coming.volts[module, tick], plant.volts(module, t))
    plant.gain[1].set(t, 0)
    later = plant.coming_readings(first + TICKS_AHEAD)
    assert later is not None
    assert later.steady == [True, False, True, True, True]
    plant.shutter_open.set(t, False)
    assert plant.coming_readings(first + TICKS_AHEAD) is None


def test_a_heartbeat_that_expires_after_a_reading_changes_the_next(model: TwinModel) -> None:
    plant = Plant(replace(model, noise=False, disturbances=disturbances()))  # back at the same position after another move
    plant.mount("gaussian-5", 0.0)
    plant.shutter_open.set(0.0, True)
    before = plant.volts(0, 10.0)
    sigma = plant.shafts["sigma"]
    sigma.follow(10.0, ramp_to_target(10.0, 0.0, 0.0, 153_600.0, 51_200.0, 51_200.0, 51_200.0), 51_200.0, Heartbeat(11.0))
    moved = plant.volts(0, 30.0)
    assert np.abs(moved - before).max() > 1e-5
    sigma.follow(
        11.0, ramp_to_target(11.0, sigma.drive(11.0).counter(11.0), 0.0, 0.0, 51_200.0, 51_200.0, 51_200.0)
    )  # in the past
    np.testing.assert_allclose(plant.volts(0, 30.0), before, atol=1e-6)  # the lamp drifts


def test_a_history_has_the_start_time_of_each_value() -> None:
    line = History("a", keep=2)
    assert line.held_since(0.0) == float("-inf")
    line.set(1.0, "b")
    line.set(2.0, "c")
    assert [line.held_since(t) for t in (0.0, 1.5, 2.0, 9.0)] == [1.0, 1.0, 2.0, 2.0]
    assert (line.newest, line.last_change) == ("c", 2.0)
