"""Directions: every conversion against vectors that are turned by rotation matrices, and the rule of equal directions."""

from dataclasses import replace
from decimal import Decimal

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from goniotwin.app.campaign.geometry.arcs import arc_view, arc_views, polar_deg
from goniotwin.app.campaign.geometry.directions import (
    ARCS,
    Arc,
    direction_keys,
    in_plane_of_incidence,
    is_lower,
    polar_from_zenith,
    rig_sigma_deg,
    scan_plane_deg,
    zenith_deg,
)
from goniotwin.app.campaign.geometry.symmetry import canonical_poses, mirror_images
from goniotwin.app.campaign.schedule.grids import GridRange
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.makes import PhotodiodesTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics import arc_direction, light_direction, to_specular
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, aspecular_deg, polar_and_azimuth, signed_polar
from tests.conftest import RIG

NORMAL = np.array([0.0, 0.0, 1.0])
MIRROR_Y, MIRROR_Z = np.diag([1.0, -1.0, 1.0]), np.diag([1.0, 1.0, -1.0])
BETA = st.floats(-720.0, 720.0)
SIGNED = st.floats(-90.0, 90.0)
TYPED = st.integers(-720_000, 720_000).map(lambda thousandths: thousandths / 1000.0)
"""Angles as people write them in a schedule."""
SIGMA = st.floats(0.0, 89.9)
ARC: st.SearchStrategy[Arc] = st.sampled_from(["upper", "lower"])


def turn(axis: str, angle_deg: float) -> Floats:
    """The rotation matrix (3, 3) about y or z, right-handed."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    rows = [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]] if axis == "y" else [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    return np.array(rows)


def carrier(signed_deg: float, beta_deg: float, arc: Arc = "upper") -> Floats:
    """Unit vector from the sample to a photodiode: tilted from the arc's pole along the arc, which is then turned by beta."""
    upper: Floats = turn("z", beta_deg) @ turn("y", signed_deg) @ NORMAL
    return upper if arc == "upper" else MIRROR_Z @ upper


def keys(zenith: float, azimuth: float) -> list[float]:
    """The key of one direction."""
    found: list[float] = direction_keys(np.array([zenith]), np.array([azimuth]))[0].tolist()
    return found


@given(SIGNED, BETA, ARC)
def test_a_photodiode_looks_where_the_turned_arc_carries_it(signed: float, beta: float, arc: Arc) -> None:
    polar, azimuth = polar_and_azimuth(signed, beta)
    zenith = zenith_deg(polar, arc)
    assert arc_direction(zenith, azimuth) == pytest.approx(carrier(signed, beta, arc), abs=1e-12)
    assert arc_direction(polar, azimuth, lower=arc == "lower") == pytest.approx(carrier(signed, beta, arc), abs=1e-12)
    assert 0.0 <= azimuth < 360.0
    assert polar_from_zenith(zenith) == pytest.approx(polar, abs=1e-12)
    if polar < 89.0:
        assert is_lower(zenith) == (arc == "lower")


@given(SIGNED, BETA)
def test_a_signed_polar_angle_survives_a_round_trip(signed: float, beta: float) -> None:
    polar, azimuth = polar_and_azimuth(signed, beta)
    assert signed_polar(polar, azimuth, beta) == pytest.approx(signed, abs=1e-12)
    assert signed_polar(polar, azimuth, beta + 180.0) == pytest.approx(-signed, abs=1e-12)


@given(TYPED.map(lambda angle: angle % 90.0), TYPED, st.floats(-2e-10, 2e-10), ARC)
def test_both_half_planes_give_the_same_direction(polar: float, beta: float, error: float, arc: Arc) -> None:
    """A photodiode beyond the pole at beta + 180 looks where the one at beta does, whatever the rounding errors of both."""
    one = polar_and_azimuth(polar, beta)
    other = polar_and_azimuth(-polar + error, beta + 180.0 - error)
    first, second = (keys(float(zenith_deg(each[0], arc)), float(each[1])) for each in (one, other))
    assert first == second
    assert carrier(polar, beta, arc) == pytest.approx(carrier(-polar, beta + 180.0, arc), abs=1e-12)


@given(ARC, BETA, BETA, st.floats(-4e-7, 4e-7))
def test_at_a_pole_all_azimuths_are_one_direction(arc: Arc, one: float, other: float, error: float) -> None:
    pole = 0.0 if arc == "upper" else 180.0
    assert keys(abs(pole - abs(error)), one) == keys(pole, other)


@given(TYPED.map(lambda angle: angle % 90.0), TYPED, st.sampled_from([(0.001, 0.0), (0.0, 0.001)]))
def test_directions_a_thousandth_of_a_degree_apart_are_two(polar: float, beta: float, apart: tuple[float, float]) -> None:
    polar = max(polar, 0.001)  # at the pole itself the azimuth does not count
    assert keys(polar, beta) != keys(polar + apart[0], beta + apart[1])


@given(TYPED, st.floats(-2e-10, 2e-10))
def test_an_arc_scans_one_plane_from_either_half(beta: float, error: float) -> None:
    plane = scan_plane_deg(np.array([beta + error, beta + 180.0 - error, beta - 180.0, beta + 360.0]))
    assert len(set(plane.tolist())) == 1
    assert 0.0 <= plane[0] < 180.0
    normal = np.cross(carrier(40.0, beta), carrier(-40.0, beta))
    assert carrier(70.0, float(plane[0])) @ normal == pytest.approx(0.0, abs=1e-12)


@given(TYPED | st.sampled_from([0.0, 180.0, 360.0, -180.0]), TYPED.map(lambda angle: angle % 180.0))
def test_a_direction_without_a_component_across_is_in_the_plane_of_incidence(azimuth: float, zenith: float) -> None:
    """The light comes in the x-z plane. A thousandth of a degree in both angles is 3e-10 across."""
    across = abs(float(arc_direction(zenith, azimuth)[1]))
    assert in_plane_of_incidence(np.array([zenith]), np.array([azimuth])).tolist() == [across < 1e-12]


@given(SIGMA, SIGNED)
def test_the_aspecular_angle_is_positive_towards_the_normal(sigma: float, signed: float) -> None:
    """In the plane of incidence it is sigma less the polar angle on the side of the specular direction."""
    direction = carrier(signed, SPECULAR_AZIMUTH_DEG)
    assert aspecular_deg(*to_specular(sigma, direction)) == pytest.approx(sigma - signed, abs=1e-9)


@given(SIGMA)
def test_sigma_of_the_rig_for_the_back_lights_the_back_at_the_same_incidence(sigma: float) -> None:
    front, back = light_direction(rig_sigma_deg(sigma, "front")), light_direction(rig_sigma_deg(sigma, "back"))
    assert back == pytest.approx(MIRROR_Z @ front, abs=1e-8)  # sigma is rounded to 5e-7 deg


@example(1.0, 0.0, -0.875, False)
@given(SIGMA, BETA, st.floats(-4.0, 4.0), st.booleans())
def test_the_back_is_seen_by_the_lower_arc_as_the_front_by_the_upper_one(
    sigma: float, beta: float, shift: float, transmitted: bool
) -> None:
    """Turned about the x axis, the front with its light and arcs becomes the back: beta changes its sign."""
    rig = read_rig(RIG).file
    assert isinstance(rig.photodiodes, PhotodiodesTable)
    rig = replace(rig, photodiodes=replace(rig.photodiodes, lower_deg=rig.photodiodes.upper_deg))
    sigma = round(sigma, 3)
    arcs: tuple[Arc, Arc] = ("lower", "upper") if transmitted else ("upper", "lower")
    front = arc_view(rig, (0.0, sigma, beta, shift), arcs[0])
    back = arc_view(rig, (0.0, 180.0 - sigma, -beta, shift), arcs[1])
    assert (front.transmitted, back.transmitted) == (transmitted, transmitted)
    assert (front.back, back.back) == (False, True)
    assert back.polar == pytest.approx(front.polar)
    assert back.theta == pytest.approx(front.theta, abs=1e-5)
    apart = np.abs(np.sin(0.5 * np.radians(back.phi - front.phi)))  # 0 and 360 are one azimuth
    assert (apart * np.sin(np.radians(front.theta))).max() < 1e-7
    assert [len(each.channels) for each in arc_views(rig, (0.0, sigma, beta, shift))] == [len(front.channels)] * 2


@given(st.floats(0.0, 180.0).filter(lambda sigma: sigma != 90.0), BETA, st.floats(-4.0, 4.0))
def test_theta_is_the_angle_from_the_specular_direction_or_from_the_one_straight_through(
    sigma: float, beta: float, shift: float
) -> None:
    rig, light = read_rig(RIG).file, light_direction(sigma)
    for arc in ARCS:
        view = arc_view(rig, (0.0, sigma, beta, shift), arc)
        centre = -light if view.transmitted else light * [-1.0, -1.0, 1.0]
        seen = np.array([carrier(polar + shift, beta, arc) for polar in polar_deg(rig, arc)])
        angle = np.degrees(np.arctan2(np.linalg.norm(np.cross(seen, centre), axis=1), seen @ centre))
        assert view.theta == pytest.approx(angle, abs=1e-6)  # incidence on the back is rounded to 5e-7 deg
        assert view.transmitted == (np.sign(light[2]) != np.sign(carrier(0.0, 0.0, arc)[2]))


@given(TYPED, SIGMA, TYPED, SIGNED)
def test_a_mirror_image_is_the_reflection_in_the_samples_plane_of_symmetry(
    gamma: float, sigma: float, beta: float, signed: float
) -> None:
    """The plane is at azimuth 0 of the sample, which the sample unit turns by gamma."""
    pose = np.array([[gamma, sigma, beta, 0.0]])
    image = mirror_images(pose, "plane-symmetric", 0.0)
    assert canonical_poses(image, "plane-symmetric").tolist() == canonical_poses(pose, "plane-symmetric").tolist()
    into, into_image = turn("z", -gamma), turn("z", -float(image[0, 0]))
    assert into_image @ light_direction(sigma) == pytest.approx(MIRROR_Y @ into @ light_direction(sigma), abs=1e-8)
    observed = carrier(signed, float(image[0, 2]))
    assert into_image @ observed == pytest.approx(MIRROR_Y @ into @ carrier(signed, beta), abs=1e-8)


@given(TYPED, SIGMA, TYPED, SIGNED, TYPED)
def test_for_an_isotropic_sample_the_mirror_image_may_be_turned(
    gamma: float, sigma: float, beta: float, signed: float, turned: float
) -> None:
    pose = np.array([[gamma, sigma, beta, 0.0]])
    image = mirror_images(pose, "isotropic", turned)
    assert canonical_poses(image, "isotropic").tolist() == canonical_poses(pose, "isotropic").tolist()
    assert np.cos(np.radians(image[0, 0] - gamma - turned)) == pytest.approx(1.0)
    assert carrier(signed, float(image[0, 2])) == pytest.approx(MIRROR_Y @ carrier(signed, beta), abs=1e-8)


@given(st.integers(-360_000, 360_000), st.integers(1, 5_000), st.integers(0, 500))
def test_a_range_has_the_numbers_that_people_would_write(start: int, step: int, steps: int) -> None:
    """Against decimal arithmetic, which has no rounding errors."""
    first, apart = Decimal(start) / 1000, Decimal(step) / 1000
    grid = GridRange(start=float(first), stop=float(first + steps * apart), step=float(apart))
    assert grid.values() == tuple(float(first + k * apart) for k in range(steps + 1))
