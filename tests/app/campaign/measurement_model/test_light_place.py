"""The light's place on the sample: what a part-lit hole does to a lobe, against the fast estimator with the slit's image."""

from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.light_place import light_place, lit_spots, spot_weights
from goniotwin.app.campaign.measurement_model.pose import Views, image_shifts, pose_effects
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Deviation, Instrument, arc_direction, gaussian, lambertian, throughput

INSTRUMENT = Instrument(obstruction=False)
TILT_DEG = 0.14
LOBE, WHITE = gaussian(5.0, reflectance=0.9), lambertian(1.0)


def around(sigma_deg: float, gamma_deg: float) -> Views:
    """Views about the specular direction, 6 deg to each side."""
    places = np.array([-6.0, -3.0, 0.0, 3.0, 6.0])
    polar, azimuth = (each.ravel() for each in np.meshgrid(sigma_deg + places, places, indexing="ij"))
    azimuth = 180.0 + azimuth / np.sin(np.radians(sigma_deg))
    none = np.zeros(polar.size, dtype=bool)
    return Views(
        np.full(polar.size, sigma_deg), np.full(polar.size, gamma_deg), np.radians(polar), np.radians(azimuth), none, none, none
    )


def logarithm(instrument: Instrument, views: Views, along: float = 0.0, across: float = 0.0) -> Floats:
    """That of the lobe over the etalon, at the views or a way beside them, deg."""
    azimuth = np.degrees(views.azimuth) + across / np.sin(views.polar)
    directions = arc_direction(np.degrees(views.polar) + along, azimuth)
    sigma, gamma = float(views.sigma_deg[0]), float(views.gamma_deg[0])
    signals = [throughput(instrument, sigma, directions, each, gamma_deg=gamma) for each in (LOBE, WHITE)]
    return np.asarray(np.log(signals[0] / signals[1]))


@pytest.mark.parametrize(
    ("sigma", "gamma", "tilt"),
    [(30.0, 0.0, "rx_deg"), (30.0, 0.0, "ry_deg"), (30.0, 45.0, "rx_deg"), (60.0, 0.0, "rx_deg")],
)
def test_a_part_lit_hole_displaces_the_lobe_as_in_the_fast_estimator(sigma: float, gamma: float, tilt: str) -> None:
    """Against the same rig with a hole that is lit everywhere: two directions by least squares, to 5 % or 0.0005 deg."""
    instrument = replace(INSTRUMENT, deviations={"mirror_1": Deviation(**{tilt: TILT_DEG})})
    lit, views, step = replace(instrument, lit_everywhere=True), around(sigma, gamma), 0.05
    change = logarithm(instrument, views) - logarithm(lit, views)
    along = (logarithm(lit, views, along=step) - logarithm(lit, views, along=-step)) / (2.0 * step)
    across = (logarithm(lit, views, across=step) - logarithm(lit, views, across=-step)) / (2.0 * step)
    seen = np.linalg.lstsq(np.stack([along, across, np.ones(along.size)], axis=1), change, rcond=None)[0]
    rig = {f"mirror_1_tilt_{tilt[1]}": TILT_DEG}
    place = light_place(INSTRUMENT, views, pose_effects(INSTRUMENT, views).common, rig)
    assert np.hypot(*seen[:2]) > 0.006
    for each, found in zip(seen, (place.along, place.across), strict=False):
        assert float(np.mean(found)) == pytest.approx(each, rel=0.05, abs=5e-4)


def test_the_slits_image_moves_by_twice_the_tilt_times_the_path() -> None:
    """0.05 deg of mirrors 1, 2, 3: 1.05, 0.70, 0.35 mm along y; in the plane of incidence 1/root 2 of it; the beam's: none."""
    shifts = image_shifts(INSTRUMENT, 0.0) * 0.05
    assert np.abs(shifts[[1, 4, 7], 1]) == pytest.approx([1.0472, 0.6981, 0.3491], abs=1e-4)
    assert np.abs(shifts[[2, 5, 8], 0]) == pytest.approx(np.array([1.0472, 0.6981, 0.3491]) / 2.0**0.5, abs=1e-4)
    assert not shifts[-2:].any()


@pytest.mark.parametrize(("sigma", "gamma"), [(5.0, 0.0), (30.0, 45.0), (75.0, 180.0), (138.0, 45.0)])
def test_the_light_of_a_search_is_that_of_the_scene(sigma: float, gamma: float) -> None:
    """Cells of 0.25 mm against the polygon, for the image where tilts of mirror 1 put it."""
    rig = {"mirror_1_tilt_x": 0.08, "mirror_1_tilt_y": -0.12}
    beam = np.array([[np.cos(np.radians(sigma)), 0.0, -np.sin(np.radians(sigma))], [0.0, 1.0, 0.0]])
    shifts = image_shifts(INSTRUMENT, sigma) @ beam.T
    place = 0.08 * shifts[1] - 0.12 * shifts[2]
    exact = lit_spots(INSTRUMENT, np.array([[sigma, gamma]]), rig)
    share, middle = spot_weights(INSTRUMENT, sigma, gamma).lit(place[None])
    assert exact.share[0] < 0.99
    # A photodiode sees the hole's edges less than its middle: at most half of what is dark counts less.
    assert 0.0 <= share[0] - exact.share[0] + 0.005 < 0.5 * (1.0 - exact.share[0]) + 0.01
    assert middle[0] == pytest.approx(exact.middle[0, :2], abs=0.02)
