"""The real sensor unit and the simplified one: equivalence, differences, and errors of the fast estimator."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import (
    Instrument,
    RealSensor,
    arc_direction,
    lambertian,
    luminance_factor,
    spectral_throughput,
    stray_map,
    stray_throughput,
    throughput,
    visible_fraction,
)
from goniotwin.twin.optics.forward.scoring import passes_sensor
from tests.sizes import parted

OTHERS = [RealSensor(diaphragm_mm=18.0), RealSensor(detector_side_mm=0.1), RealSensor(detector_mm=40.0)]
NAMES = ["diaphragm out of focus", "small detector", "detector far behind"]
DIRECTIONS = arc_direction([20.0, 40.0], [150.0, 60.0])


def accepted(sensor: RealSensor, rays: Floats) -> Flags:
    """Which of rays (n, 4) of points and slopes reach the detector."""
    return np.array([passes_sensor(x, y, p, q, sensor.constants) for x, y, p, q in rays])


def rays(count: int = 20_000, slope: float = 0.01) -> Floats:
    """Rays about the lens and its field, within and beyond."""
    random = np.random.Generator(np.random.Philox(5))
    return np.column_stack([random.uniform(-3.0, 3.0, (count, 2)), random.uniform(-slope, slope, (count, 2))])


def simplified(instrument: Instrument, given: Floats) -> Flags:
    """The same for a disc and a cone."""
    tangent = math.tan(math.radians(0.5 * instrument.field_deg))
    on_the_disc = np.hypot(given[:, 0], given[:, 1]) <= 0.5 * instrument.detector_diameter_mm
    return np.asarray(on_the_disc & (np.hypot(given[:, 2], given[:, 3]) <= tangent))


@pytest.mark.parametrize("aperture_mm", [0.1, 2.0 * 20.0 * math.tan(math.radians(0.25)), 0.8])
def test_with_the_diaphragm_in_the_focal_plane_a_sensor_is_a_disc_with_a_cone(aperture_mm: float) -> None:
    sensor = RealSensor(aperture_mm=aperture_mm)
    given = rays()
    expected = simplified(Instrument(sensor=sensor).simplified(), given)
    assert 100 < np.sum(expected) < len(given)
    assert np.array_equal(accepted(sensor, given), expected)


def test_the_default_has_the_narrowest_field_of_the_paper() -> None:
    assert RealSensor().field_deg == pytest.approx(0.5)
    assert Instrument(sensor=RealSensor()).simplified() == Instrument()


def test_an_instrument_with_a_sensor_has_its_disc_and_field() -> None:
    sensor = RealSensor(lens_diameter_mm=8.0, aperture_mm=1.0)
    instrument = Instrument(detector_diameter_mm=3.0, field_deg=2.0, sensor=sensor)
    assert (instrument.detector_diameter_mm, instrument.field_deg) == (8.0, sensor.field_deg)
    assert replace(instrument, sensor=RealSensor()).detector_diameter_mm == 5.0
    assert instrument != instrument.simplified() == Instrument(detector_diameter_mm=8.0, field_deg=sensor.field_deg)


@pytest.mark.parametrize("other", OTHERS, ids=NAMES)
def test_another_sensor_is_not_simple_and_has_a_reason(other: RealSensor) -> None:
    given = rays()
    assert not np.array_equal(accepted(other, given), simplified(Instrument(), given))
    with pytest.raises(ValueError, match=r"not a simple detector.*use the forward estimator"):
        Instrument(sensor=other).simplified()


@pytest.mark.parametrize(
    ("sensor", "message"),
    [
        (RealSensor(diaphragm_mm=18.0), "diaphragm is at 18 mm and its focal plane at 20 mm"),
        # 0.175 mm of aperture, and (5 + 0.175) / 20 mm more at 1 mm behind it.
        (RealSensor(detector_side_mm=0.1), "detector of 0.1 mm cuts the light, which is 0.4333 mm wide there"),
    ],
)
def test_the_error_states_the_reason(sensor: RealSensor, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Instrument(sensor=sensor).simplified()


@parted(2)
@pytest.mark.parametrize("sensor", [RealSensor(), *OTHERS, RealSensor(focal_length_mm=60.0)], ids=str)
def test_no_ray_outside_its_widest_cone_can_pass(sensor: RealSensor, part: int) -> None:
    limit = math.tan(math.radians(0.5 * sensor.widest_deg))
    # From the edge of the lens: the bound is for the worst point on it.
    edge = rays(200_000 // part, 1.2 * limit)
    edge[:, :2] *= (2.499999 / np.hypot(edge[:, 0], edge[:, 1]))[:, None]
    passing = np.hypot(*edge[accepted(sensor, edge)][:, 2:].T)
    assert passing.size > 100
    assert np.max(passing) <= limit * (1.0 + 1e-9)
    # Few rays reach the corners of a square, so its bound is less tight than the diaphragm's.
    assert np.max(passing) > 0.7 * limit


def fast_calls(instrument: Instrument) -> list[Callable[[], Any]]:
    virtual = stray_map(replace(instrument, sensor=None), 30.0, lambertian(), paths=2)
    return [
        lambda: throughput(instrument, 30.0, DIRECTIONS, lambertian()),
        lambda: throughput(instrument, 30.0, DIRECTIONS, lambertian(), rays=64),
        lambda: spectral_throughput(instrument, 30.0, DIRECTIONS, lambertian(), [500.0, 600.0]),
        lambda: luminance_factor(instrument, 30.0, DIRECTIONS, lambertian()),
        lambda: stray_map(instrument, 30.0, lambertian(), paths=2).values,
        lambda: stray_throughput(virtual, DIRECTIONS, instrument),
    ]


@pytest.mark.parametrize("other", OTHERS, ids=NAMES)
def test_the_fast_estimator_and_the_stray_map_refuse_other_sensors(other: RealSensor) -> None:
    for call in fast_calls(Instrument(sensor=other)):
        with pytest.raises(ValueError, match=r"not a simple detector.*use the forward estimator"):
            call()


def test_a_simple_sensor_gives_the_result_of_its_disc_and_cone() -> None:
    instrument = Instrument(sensor=RealSensor(lens_diameter_mm=6.0, aperture_mm=0.5))
    for call, same in zip(fast_calls(instrument), fast_calls(instrument.simplified()), strict=True):
        assert np.array_equal(call(), same())


@pytest.mark.parametrize("wrong", [{"focal_length_mm": 0.0}, {"aperture_mm": math.nan}, {"detector_mm": 5.0}])
def test_invalid_dimensions_are_refused_by_name(wrong: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        RealSensor(**wrong)


def test_the_obstruction_of_a_sensor_is_for_all_rays_that_could_pass() -> None:
    directions = arc_direction(np.arange(2.0, 5.0, 0.05), 0.0)
    for sensor in (RealSensor(), RealSensor(aperture_mm=0.05, diaphragm_mm=19.0)):
        cone = visible_fraction(Instrument(field_deg=sensor.widest_deg), 0.0, directions)
        np.testing.assert_array_equal(visible_fraction(Instrument(sensor=sensor), 0.0, directions), cone)
        assert np.any((cone > 0.0) & (cone < 1.0))
    nominal = visible_fraction(Instrument(field_deg=sensor.field_deg), 0.0, directions)
    assert np.any(nominal != cone)
