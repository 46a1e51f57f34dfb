"""A hole that is lit in part: the place of the light in the open beam and at the sample, against the twin's."""

import math
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.geometry.open_beam import BeamScan
from goniotwin.app.campaign.measurement_model.light_place import SeenLight, across_beam, place_law, seen_light
from goniotwin.app.campaign.measurement_model.lit_share import SLIT_IMAGE
from goniotwin.app.campaign.measurement_model.pose import LIGHT, VIEW, Views, disc_moves, image_shifts
from goniotwin.app.campaign.studies.closure import (
    light_effects,
    scanned_beam,
)
from goniotwin.twin.optics import Deviation, Instrument, arc_direction
from tests import rig_tables
from tests.app.campaign.studies.closure_bench import FILE, beam_signal, etalon_signal, plain_ratio, scans_of


def by_tilts(scan: BeamScan, tilts: dict[str, float], off: dict[str, Deviation], *, lit: bool = False) -> float:
    """ln of the ratio of the two routes on a rig whose mirror 1 has `tilts`, with other deviations `off`."""
    deviations = {"mirror_1": Deviation(**tilts), **off}
    instrument = Instrument(deviations=deviations, lit_everywhere=lit)
    return plain_ratio(scan, scanned_beam(scan, 550.0, beam_signal(scan, instrument)), etalon_signal(scan, instrument))


def at_places(scan: BeamScan, tilts: dict[str, float]) -> tuple[SeenLight, SeenLight]:
    """The light at the etalon and of the open beam, with the slit's image where tilts of mirror 1 bring it."""
    found, nominal = [], Instrument()
    view = arc_direction(scan.at_deg, 180.0, False)
    for sigma in (scan.etalon_pose[1], float(scan.poses[0, 1])):
        ways = image_shifts(nominal, sigma) @ across_beam(sigma).T
        place = sum(angle * ways[LIGHT.index(f"mirror_1_tilt_{name[1]}")] for name, angle in tilts.items())
        found.append(seen_light(nominal, (sigma, 0.0), view, np.atleast_2d(place)))
    return found[0], found[1]


@pytest.mark.parametrize(
    ("sigmas", "tilts", "least"),
    [
        ("[15]", {"rx_deg": 0.1}, 0.0),
        ("[15]", {"ry_deg": 0.1}, 0.0),
        ("[15]", {"rx_deg": 0.05, "ry_deg": 0.07}, 0.004),
        ("[15]", {"rx_deg": 0.08, "ry_deg": -0.1}, -0.015),
        ("[65]", {"rx_deg": 0.05, "ry_deg": 0.07}, -0.025),
        ("[65]", {"rx_deg": 0.08, "ry_deg": -0.1}, 0.13),
    ],
)
def test_a_dark_corner_of_the_hole_is_another_one_at_the_open_beam(sigmas: str, tilts: dict[str, float], least: float) -> None:
    """Against the twin with the slit's image, and without. An image that is off in one direction alone does nothing."""
    (scan,) = scans_of(sigmas)
    seen = by_tilts(scan, tilts, {}) - by_tilts(scan, tilts, {}, lit=True)
    etalon, beam = at_places(scan, tilts)
    known = float(etalon.logarithm[0] - beam.logarithm[0])
    assert known == pytest.approx(seen, rel=0.05, abs=2.5e-3)
    assert min(float(np.exp(each.logarithm[0])) for each in (etalon, beam)) < 0.98
    assert abs(known) >= abs(least)
    assert known * least >= 0.0


@pytest.mark.parametrize(
    ("tilts", "off"),
    [
        ({"ry_deg": 0.1}, {"ry_deg": 0.05}),
        ({"ry_deg": 0.1}, {"rx_deg": 0.05}),
        ({"ry_deg": 0.1}, {"x_mm": 0.1}),
        ({"rx_deg": 0.1}, {"ry_deg": 0.05}),
    ],
)
def test_a_disc_that_is_off_sees_two_dark_sides_unlike(tilts: dict[str, float], off: dict[str, float]) -> None:
    """Both ways, against the twin: the part of the hole that is lit at the etalon is opposite to that of the open beam."""
    (scan,) = scans_of("[15]")
    seen = 0.0
    for sign in (1.0, -1.0):
        rig = {"sensor": Deviation(**{name: sign * each for name, each in off.items()})}
        seen += sign * (by_tilts(scan, tilts, rig) - by_tilts(scan, tilts, rig, lit=True))
    etalon, beam = at_places(scan, tilts)
    no = np.zeros(1, dtype=bool)
    at, zero = np.full(1, scan.at_deg), np.zeros(1)
    views = Views(at, zero, np.radians(at), np.full(1, math.pi), no, no, no)
    (disc,) = disc_moves(Instrument(), views)[1]
    names = {"rx_deg": "sensor_tilt_x", "ry_deg": "sensor_tilt_y", "x_mm": "sensor_shift_x"}
    known = sum(float((etalon.by_disc - beam.by_disc)[0] @ disc[VIEW.index(names[name])]) * each for name, each in off.items())
    assert known == pytest.approx(0.5 * seen, rel=0.1, abs=1e-3)


def test_the_law_of_the_images_place_is_that_of_its_inputs() -> None:
    """Variance of a sum of rectangular inputs, and its range; one input alone is rectangular itself."""
    ways, half = np.array([[1.0, 0.0], [0.0, 2.0], [0.0, 3.0], [0.5, 0.0]]), np.array([0.3, 0.2, 0.1, 0.4])
    law = place_law(ways, half)
    assert law.probability.sum() == pytest.approx(1.0, rel=1e-12)
    variances = np.sum((ways * half[:, None]) ** 2, axis=0) / 3.0
    assert law.probability @ law.places**2 == pytest.approx(variances, rel=0.01)
    assert np.abs(law.places).max(axis=0) == pytest.approx([0.5, 0.7], rel=0.04)
    still = place_law(ways, 0.0 * half)
    assert not still.places.any()


def test_a_rig_without_tilts_has_no_component_of_the_lights_place() -> None:
    (scan,) = scans_of("[42]")
    still = rig_tables.stated(mirror_tilt_deg=0.0, mirror_shift_mm=0.0, illumination_shift_mm=0.0)
    assert math.hypot(*(each.u for each in light_effects(scan, replace(FILE, uncertainty=still)).components)) < 1e-9
    stated = {each.name: each for each in light_effects(scan, FILE).components}
    assert stated[SLIT_IMAGE].u > 2e-3
    assert "slit_image*sensor_tilt_y" in stated
