"""Simulation control of the plant: its effect on the light."""

import numpy as np
import pytest

from goniotwin.protocols.clock import VirtualClock
from goniotwin.twin import VirtualRig
from goniotwin.twin.plant.view import Aspect
from tests.conftest import RigOpener


@pytest.fixture
def rig(opened: RigOpener) -> VirtualRig:
    virtual = opened(("noise = true", "noise = false"), clock=VirtualClock(1000.0)).virtual
    assert virtual is not None
    return virtual


def test_an_unknown_sample_is_refused_with_the_known_names(rig: VirtualRig) -> None:
    with pytest.raises(KeyError, match="'satin'; it has: etalon, gaussian-5"):
        rig.mount("satin")


def test_the_lamp_drifts_from_its_present_level_and_jumps_to_a_set_level(rig: VirtualRig) -> None:
    rig.plant.shutter_open.set(0.0, True)
    dark = rig.plant.model.monitor.dark_a
    before = rig.plant.monitor_a(1000.0, 1000.1) - dark
    rig.plant.set_lamp(1000.0, drift_per_hour=3.6)  # 1e-3 per second
    assert rig.plant.monitor_a(1000.0, 1000.1) - dark == pytest.approx(before, rel=2e-4)
    assert rig.plant.monitor_a(1100.0, 1100.1) - dark == pytest.approx(before + 0.1 * 1.4e-7, rel=1e-3)
    rig.plant.set_lamp(1200.0, drift_per_hour=0.0, level=0.5)
    assert rig.plant.monitor_a(1300.0, 1300.1) - dark == pytest.approx(0.7e-7, rel=1e-6)


def test_a_tilt_of_the_sample_turns_the_specular_direction_by_twice_the_angle(rig: VirtualRig) -> None:
    rig.plant.mount("gaussian-5", 1000.0)
    straight = rig.plant.throughputs_m2sr(1001.0)
    rig.plant.tilt_sample(1.0, 1002.0)
    tilted = rig.plant.throughputs_m2sr(1003.0)
    # At sigma 0 and beta 0 the photodiodes at 5 and 10 deg are on the light's side, the direction of a positive tilt:
    # their distance from the specular direction, now at 2 deg, is 3 and 8 deg.
    assert tilted[2] / straight[2] == pytest.approx(np.exp((10.0**2 - 8.0**2) / 5.0**2), rel=0.03)
    rig.plant.tilt_sample(0.0, 1004.0)
    np.testing.assert_array_equal(rig.plant.throughputs_m2sr(1005.0), straight)


def test_the_light_of_an_aspect_equals_that_of_the_rig_in_it(rig: VirtualRig) -> None:
    plant = rig.plant
    plant.mount("gaussian-5", 0.0)
    plant.shutter_open.set(0.0, True)
    wavelength = plant.wavelength_nm.at(1.0)
    sigma, gamma, beta, shift = (plant.angle_deg(axis, 1.0) for axis in ("sigma", "gamma", "beta", "shift"))
    currents = plant.steady_photocurrents_a(Aspect("gaussian-5", 0.0, wavelength, sigma, gamma, beta, shift))
    assert currents.max() > 0.0
    assert currents == pytest.approx(plant.photocurrents_a(1.0)[: len(currents)], rel=1e-12)
