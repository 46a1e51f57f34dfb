"""The forward estimator with real sensors: compared with the simplified detectors, and with a plain Monte Carlo in
this file.
"""

import math
from dataclasses import replace

import numba
import numpy as np
import pytest

from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import (
    Deviation,
    Estimate,
    Instrument,
    RealSensor,
    SampleFrames,
    Scatterer,
    arc_direction,
    evaluate,
    forward_throughput,
    from_specular,
    light_direction,
)
from goniotwin.twin.optics.forward.paths import BLOCK, DX, PX, ROWS, STOP, WEIGHT
from goniotwin.twin.optics.forward.scoring import find_cells, make_hit_buffer, make_sensor_targets, score, score_segment
from goniotwin.twin.optics.forward.setting import set_up
from goniotwin.twin.optics.montecarlo import CHUNK
from tests.sizes import parted
from tests.twin.optics.agreement import agree
from tests.twin.optics.models import gaussian, lambertian, model_name

WIDE = RealSensor(lens_diameter_mm=12.0, aperture_mm=1.05)
OUT_OF_FOCUS = replace(WIDE, diaphragm_mm=15.0)
NARROW = replace(OUT_OF_FOCUS, aperture_mm=0.7)
SMALL = replace(WIDE, detector_mm=22.0, detector_side_mm=0.5)
NOT_SIMPLE = {"out of focus": OUT_OF_FOCUS, "out of focus, narrow": NARROW, "small detector": SMALL}
ALL = {"simple": WIDE, **NOT_SIMPLE}
POLAR_DEG, AZIMUTH_DEG = np.linspace(8.0, 70.0, 24), np.arange(24) * 137.50776405003785


def sides_of(directions: Floats) -> tuple[Floats, Floats]:
    """Unit vectors along the arc, away from the sample's normal, and across it, (n, 3) each."""
    across = np.cross([0.0, 0.0, 1.0], directions)
    across /= np.linalg.norm(across, axis=1)[:, None]
    return np.cross(across, directions), across


def accepted(sensor: RealSensor, place: Floats, slope: Floats) -> Flags:
    """Whether rays (..., 2) reach the detector, from the common point in the focal plane of all rays of their slope."""
    focus = sensor.focal_length_mm * slope
    aside = {z: place + (focus - place) * (z / sensor.focal_length_mm) for z in (sensor.diaphragm_mm, sensor.detector_mm)}
    through = np.hypot(*np.moveaxis(aside[sensor.diaphragm_mm], -1, 0)) <= 0.5 * sensor.aperture_mm
    on_the_lens = np.hypot(*np.moveaxis(place, -1, 0)) <= 0.5 * sensor.lens_diameter_mm
    hit = np.all(np.abs(aside[sensor.detector_mm]) <= 0.5 * sensor.detector_side_mm, axis=-1)
    return np.asarray(on_the_lens & through & hit)


def on_a_disc(random: np.random.Generator, count: int) -> Floats:
    radius, turn = np.sqrt(random.random(count)), 2.0 * math.pi * random.random(count)
    return np.stack([radius * np.cos(turn), radius * np.sin(turn)], axis=1)


def plain_monte_carlo(
    instrument: Instrument, sensor: RealSensor, sigma_deg: float, directions: Floats, scatterer: Scatterer, count: int
) -> tuple[Floats, Floats]:
    """Throughput (n,), m^2 sr, and its error, of detectors in `directions` (n, 3): random points of pupil, hole and lens."""
    random = np.random.Generator(np.random.Philox(17))
    towards = light_direction(sigma_deg)
    across = np.stack([np.array([0.0, 1.0, 0.0]), np.cross(towards, [0.0, 1.0, 0.0])])
    lens = 0.5 * sensor.lens_diameter_mm
    hole, pupil = instrument.spot_side_mm, instrument.pupil_radius_mm
    areas = math.pi * pupil**2 * hole**2 * math.pi * lens**2
    means, errors = [], []
    for axis, side, other in zip(directions, *sides_of(directions), strict=True):
        spot = np.column_stack([random.uniform(-0.5 * hole, 0.5 * hole, (count, 2)), np.zeros(count)])
        light = instrument.pupil_distance_mm * towards + pupil * on_a_disc(random, count) @ across - spot
        place = lens * on_a_disc(random, count)
        view = instrument.arc_radius_mm * axis + place @ np.stack([side, other]) - spot
        far, near = np.linalg.norm(light, axis=1), np.linalg.norm(view, axis=1)
        light, view = light / far[:, None], view / near[:, None]
        slope = np.stack([view @ side, view @ other], axis=1) / (view @ axis)[:, None]
        weight = light[:, 2] * (light @ towards) / far**2 * view[:, 2] * (view @ axis) / near**2
        weight = weight * evaluate(scatterer, light, view) * accepted(sensor, place, slope)
        means.append(weight.mean())
        errors.append(weight.std() / math.sqrt(count))
    scale = instrument.mirror_reflectance**3 * areas * 1e-6  # type: ignore[operator]
    return scale * np.array(means), scale * np.array(errors)


def directions(scatterer: Scatterer, sigma_deg: float) -> Floats:
    """Directions about a lobe, or over the hemisphere."""
    if scatterer.name == lambertian().name:
        return arc_direction(POLAR_DEG, AZIMUTH_DEG)
    return from_specular(sigma_deg, np.linspace(2.0, 16.0, 24), np.arange(24) * 50.0)


@parted(4)
@pytest.mark.parametrize("sigma_deg", [30.0, 60.0])
@pytest.mark.parametrize("scatterer", [lambertian(), gaussian(8.0)], ids=model_name)
@pytest.mark.parametrize("sensor", [WIDE, RealSensor()], ids=["wide", "default"])
def test_simple_sensors_agree_with_the_simplified_detectors(
    sensor: RealSensor, scatterer: Scatterer, sigma_deg: float, part: int
) -> None:
    instrument, seen = Instrument(sensor=sensor), directions(scatterer, sigma_deg)
    paths = (4_000_000 if sensor == WIDE else 16_000_000) // part
    real = forward_throughput(instrument, sigma_deg, seen, scatterer, paths, seed=1)
    virtual = forward_throughput(instrument.simplified(), sigma_deg, seen, scatterer, paths, seed=2)
    assert np.median(real.standard_error / real.throughput_m2sr) < 0.08 * math.sqrt(part)
    agree(real.throughput_m2sr, real.standard_error, virtual.throughput_m2sr, virtual.standard_error)


@parted(2)
@pytest.mark.parametrize(
    ("sensor", "scatterer"),
    [
        pytest.param(sensor, scatterer, id=f"{name}-{model_name(scatterer)}", marks=[] if quick else pytest.mark.long)
        for name, sensor in NOT_SIMPLE.items()
        for scatterer, quick in ((lambertian(), sensor is not NARROW), (gaussian(8.0), sensor is NARROW))
    ],
)
def test_other_sensors_agree_with_plain_monte_carlo(sensor: RealSensor, scatterer: Scatterer, part: int) -> None:
    instrument = Instrument(sensor=sensor, obstruction=False)
    seen = directions(scatterer, 30.0)
    result = forward_throughput(instrument, 30.0, seen, scatterer, 10_000_000 // part, seed=3)
    agree(
        result.single_m2sr, result.single_error, *plain_monte_carlo(instrument, sensor, 30.0, seen, scatterer, 60_000 // part)
    )
    # A disc and cone of the same dimensions give another result.
    virtual = forward_throughput(replace(instrument, sensor=None), 30.0, seen, scatterer, 10_000_000 // part, seed=4)
    error = math.hypot(*(np.linalg.norm(each.single_error) for each in (result, virtual)))
    assert abs(result.single_m2sr.sum() - virtual.single_m2sr.sum()) > 10.0 * error


@parted(4)
def test_plain_monte_carlo_agrees_with_the_simplified_detectors_too(part: int) -> None:
    instrument = Instrument(sensor=WIDE, obstruction=False)
    seen = directions(lambertian(), 60.0)
    virtual = forward_throughput(instrument.simplified(), 60.0, seen, lambertian(), 6_000_000 // part, seed=5)
    plain = plain_monte_carlo(instrument, WIDE, 60.0, seen, lambertian(), 60_000 // part)
    agree(virtual.single_m2sr, virtual.single_error, *plain)


@pytest.mark.parametrize("sensor", ALL.values(), ids=ALL)
def test_every_ray_is_counted_by_exactly_the_sensors_that_it_passes(sensor: RealSensor) -> None:
    random = np.random.Generator(np.random.Philox(2))
    axes = arc_direction(POLAR_DEG, AZIMUTH_DEG)
    axes[::2] *= -1.0
    along, level = sides_of(axes)
    # From the hole to a sensor, so close that its whole field is needed.
    centres, which = 120.0 * axes, np.arange(BLOCK) % len(axes)
    places = np.column_stack([random.uniform(-2.5, 2.5, (BLOCK, 2)), np.zeros(BLOCK)]).astype(np.float32).astype(np.float64)
    on_the_lens = 7.0 * random.uniform(-1.0, 1.0, (2, BLOCK, 1)) ** 3
    rays = centres[which] + on_the_lens[0] * along[which] + on_the_lens[1] * level[which] - places
    rays = (rays / np.linalg.norm(rays, axis=1)[:, None]).astype(np.float32).astype(np.float64)

    def expected(change: float) -> Flags:
        changed = replace(
            sensor,
            lens_diameter_mm=sensor.lens_diameter_mm + change,
            aperture_mm=sensor.aperture_mm + change,
            detector_side_mm=sensor.detector_side_mm + change,
        )
        ahead = rays @ axes.T
        distance = ((centres - places[:, None]) * axes).sum(axis=2) / ahead
        off = places[:, None] + distance[..., None] * rays[:, None] - centres
        place = np.stack([(off * side).sum(axis=2) for side in (along, level)], axis=2)
        slope = np.stack([rays @ side.T / ahead for side in (along, level)], axis=2)
        return np.asarray(accepted(changed, place, slope) & (distance > 0.0))

    surely, unsure = expected(0.0), np.count_nonzero(expected(1e-4) != expected(-1e-4), axis=0)
    assert np.count_nonzero(surely) > 100
    assert unsure.sum() < 10

    result, sums = make_sensor_targets(centres, axes, along, sensor), np.zeros((len(axes), 4))
    buffer = np.zeros(ROWS * BLOCK, np.float32)
    buffer[WEIGHT : WEIGHT + BLOCK], buffer[STOP : STOP + BLOCK] = 1.0, np.inf
    buffer[DX : DX + 3 * BLOCK], buffer[PX : PX + 2 * BLOCK] = rays.T.ravel(), places[:, :2].T.ravel()
    cells, hit_buffer = np.empty(BLOCK, np.uint32), make_hit_buffer(int(np.diff(result.starts).max()))
    find_cells(buffer, BLOCK, result.cells, cells)
    score(buffer, BLOCK, 0.0, cells, result, hit_buffer, sums, 0)
    for (px, py, pz), (dx, dy, dz) in zip(places, rays, strict=True):
        score_segment(result, px, py, pz, dx, dy, dz, math.inf, 1.0, sums)
    for column in (0, 2):
        assert np.all(np.abs(sums[:, column] - surely.sum(axis=0)) <= unsure)


def test_a_ray_that_is_blocked_before_the_lens_is_not_counted() -> None:
    axes, sums = np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 4))
    result = make_sensor_targets(300.0 * axes, axes, np.array([[1.0, 0.0, 0.0]]), RealSensor())
    for stop, counts in ((299.0, 0.0), (301.0, 1.0)):
        score_segment(result, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, stop, 1.0, sums)
        assert sums[0, 2] == counts


@pytest.mark.parametrize(("sigma_deg", "gamma_deg"), [(30.0, 0.0), (30.0, 25.0), (150.0, 25.0)])
@pytest.mark.parametrize("turned_deg", [0.0, 30.0])
def test_the_sides_of_the_square_lie_along_and_across_the_arc(sigma_deg: float, gamma_deg: float, turned_deg: float) -> None:
    sample, turn = Deviation(rx_deg=2.0, y_mm=1.0), math.radians(turned_deg)
    sensor = Deviation(rz_deg=turned_deg)
    instrument = Instrument(sensor=SMALL, deviations={"sample": sample, "sensor": sensor})
    seen = arc_direction(POLAR_DEG, AZIMUTH_DEG)
    setting = set_up(instrument, sigma_deg, seen, lambertian(side="both"), gamma_deg, None, None, 8, SampleFrames())
    along, level = sides_of(seen)
    expected = (math.cos(turn) * along + math.sin(turn) * level) @ setting.scene.to_sample.T
    assert set(setting.targets.numbers) == set(range(len(seen)))
    assert setting.targets.frames[:, 6:9] == pytest.approx(expected, abs=1e-6)


def test_a_shifted_sensor_sees_another_part_of_the_spot() -> None:
    # By half of the spot and the lens' radius: no light on the axis is left.
    aside = {"sensor": Deviation(x_mm=30.0)}
    result = forward_throughput(
        Instrument(sensor=SMALL, deviations=aside), 30.0, arc_direction([50.0], [90.0]), lambertian(), 200_000
    )
    assert result.single_m2sr[0] == 0.0


def test_results_are_bit_identical_for_one_seed_and_any_number_of_threads() -> None:
    instrument, seen = Instrument(sensor=SMALL), directions(gaussian(8.0), 30.0)
    threads, result = numba.get_num_threads(), list[Estimate]()
    try:
        for count in (1, threads):
            numba.set_num_threads(count)
            result.append(forward_throughput(instrument, 30.0, seen, gaussian(8.0), 4 * CHUNK + 77, seed=3))
    finally:
        numba.set_num_threads(threads)
    for name in ("throughput_m2sr", "standard_error", "stray_m2sr", "stray_error"):
        assert np.array_equal(getattr(result[0], name), getattr(result[1], name))
    assert np.any(result[0].stray_m2sr > 0.0)


def test_without_detectors_the_result_is_empty() -> None:
    assert forward_throughput(Instrument(sensor=WIDE), 30.0, np.zeros((0, 3)), lambertian(), BLOCK).throughput_m2sr.shape == (
        0,
    )
