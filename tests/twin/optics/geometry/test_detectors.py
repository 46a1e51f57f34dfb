"""Where photodiodes are and look that are off, by rotations of vectors; on an arc that is turned through its pole."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt
import pytest

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, arc_axis, arc_direction, gaussian, throughput
from goniotwin.twin.optics.geometry.scene import scene_at

RADIUS_MM = 300.0
SENSOR = Deviation(rx_deg=0.4, ry_deg=-0.3, rz_deg=0.2, x_mm=0.3, y_mm=-0.2, z_mm=0.1)
NONE = Deviation()
POLAR_DEG = np.array([-30.0, -1.0, -0.01, 0.0, 0.01, 1.0, 30.0])


def rotated(vector: npt.ArrayLike, axis: Floats, angle_deg: float) -> Floats:
    """A vector (3,) turned about a unit vector, by Rodrigues' formula."""
    v, cos, sin = np.asarray(vector), math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return np.asarray(cos * v + sin * np.cross(axis, v) + (1.0 - cos) * (axis @ v) * axis)


def on_the_arc(polar_deg: float, beta_deg: float, lower: bool, own: Deviation, arc: Deviation = NONE) -> Floats:
    """Place and view (2, 3) of a sensor that is fixed to its arc: the arc is bent, then turned by beta, then off."""
    x, y, z = np.eye(3)
    d = -z if lower else z
    towards = np.cross(y, d)
    centre, view = own.x_mm * towards + own.y_mm * y + (RADIUS_MM + own.z_mm) * d, d
    for axis, angle in ((towards, own.rx_deg), (y, own.ry_deg), (d, own.rz_deg)):
        view = rotated(view, axis, angle)
    found = []
    for each in (centre, view):
        bent = rotated(rotated(each, y, -polar_deg if lower else polar_deg), z, beta_deg)
        for axis, angle in ((x, arc.rx_deg), (y, arc.ry_deg), (z, arc.rz_deg)):
            bent = rotated(bent, axis, angle)
        found.append(bent)
    return np.array(found)


def detectors(instrument: Instrument, polar_deg: Floats, beta_deg: float, lower: bool) -> Floats:
    """Places and views (n, 2, 3) by the virtual rig, at sigma 0."""
    directions = arc_direction(polar_deg, beta_deg, lower)
    rows = np.concatenate([directions, np.broadcast_to(arc_axis(beta_deg), directions.shape)], axis=1)
    return np.stack(scene_at(instrument, 0.0).detectors(instrument, rows), axis=1)


@pytest.mark.parametrize("lower", [False, True])
@pytest.mark.parametrize("beta_deg", [0.0, 37.0, 180.0, 250.0])
def test_a_sensor_that_is_off_is_fixed_to_its_arc_on_either_side_of_the_pole(beta_deg: float, lower: bool) -> None:
    found = detectors(Instrument(deviations={"sensor": SENSOR}), POLAR_DEG, beta_deg, lower)
    for k, polar in enumerate(POLAR_DEG.tolist()):
        assert found[k] == pytest.approx(on_the_arc(polar, beta_deg, lower, SENSOR), abs=1e-11)


def test_so_is_one_on_an_arc_that_is_off_itself() -> None:
    """At the pole exactly; beside it to the second order: a tenth of what the sensor is off by."""
    arc = Deviation(rx_deg=0.05, ry_deg=-0.04, rz_deg=0.03)
    polar = np.linspace(-3.0, 3.0, 61)
    found = detectors(Instrument(deviations={"sensor": SENSOR, "arc": arc}), polar, 70.0, False)
    exact = np.array([on_the_arc(each, 70.0, False, SENSOR, arc) for each in polar.tolist()])
    plain = np.array([on_the_arc(each, 70.0, False, NONE, arc) for each in polar.tolist()])
    difference = np.linalg.norm(found - exact, axis=2)
    assert np.all(difference <= 0.101 * np.linalg.norm(exact - plain, axis=2))
    assert difference[np.abs(polar) < 0.15].max() < 1e-11
    assert difference.max() > 1e-6


def test_a_photodiode_that_is_off_across_its_arc_has_the_axes_of_its_arc() -> None:
    instrument, axis = Instrument(deviations={"sensor": Deviation(rx_deg=0.4)}), arc_axis(20.0)
    along = np.cross(axis, [0.0, 0.0, 1.0])
    aside = rotated([0.0, 0.0, 1.0], -along, 0.05)
    _, view = scene_at(instrument, 0.0).detectors(instrument, [np.concatenate([aside, axis])])
    # Turned about its way along the arc, it looks to the side by both.
    assert view[0] == pytest.approx(rotated(aside, along, 0.4), abs=1e-12)


def test_the_light_of_a_tilted_sensor_goes_through_the_pole_without_a_step() -> None:
    """On the flank of a lobe what a tilt does has one sign on both sides of the pole; free directions have no arc."""
    polar, beta = np.linspace(-1.0, 1.0, 21), 180.0
    axis = np.broadcast_to(arc_axis(beta), (21, 3))
    directions = arc_direction(polar, beta)
    effect = []
    for rows in (np.concatenate([directions, axis], axis=1), directions):
        light = [
            throughput(replace(Instrument(), deviations={"sensor": Deviation(ry_deg=tilt)}), 8.0, rows, gaussian(5.0))
            for tilt in (0.02, -0.02)
        ]
        effect.append(np.log(light[0] / light[1]) / 0.04)
    on_arc, free = effect
    line = np.polynomial.Polynomial.fit(polar, on_arc, 1)
    assert np.abs(on_arc - line(polar)).max() < 0.02 * np.abs(on_arc).max()
    assert on_arc[polar > 1e-9] == pytest.approx(free[polar > 1e-9], rel=1e-12)
    assert on_arc[polar < -1e-9] == pytest.approx(-free[polar < -1e-9], rel=1e-9)
