"""Sensitivities to errors of angles: closed forms in the plane of incidence, and finite differences of the fast estimator.

The estimator has deviations of its own for each element. The sensitivities are computed without it.
"""

import itertools
import math
import re
from dataclasses import replace

import numpy as np
import pytest

from goniotwin.app.campaign.measurement_model.pose import (
    ASIDE,
    LIGHT,
    MOUNTED,
    POSITIONS,
    VIEW,
    Displacement,
    PoseEffects,
    Views,
    acceptance,
    common_disc,
    moments,
    mounting_inputs,
    photodiode_inputs,
    pose_effects,
    position_input,
    rig_inputs,
    standard_uncertainties,
    variance,
)
from goniotwin.app.rig.inputs import PHOTODIODE_ANGLE
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Scatterer,
    arc_axis,
    arc_direction,
    forward_throughput,
    gaussian,
    lambertian,
    throughput,
)

INSTRUMENT = Instrument(obstruction=False)
TABLE = UncertaintyTable()
COMMON = (*LIGHT, *VIEW)
NAMES = (
    *COMMON,
    *(f"sample_{each}" for each in MOUNTED),
    *(f"etalon_{each}" for each in MOUNTED),
    *(f"sample_position_{each}" for each in POSITIONS),
    *(f"etalon_position_{each}" for each in POSITIONS),
    "photodiode_angle",
    "photodiode_across",
)
"""All inputs; those that act on the sample alone, or on the etalon, begin with that word."""
INPUTS = (
    *rig_inputs(TABLE),
    *mounting_inputs(TABLE, "sample", "a"),
    *mounting_inputs(TABLE, "etalon", "b"),
    *(position_input(TABLE, axis, 1) for axis in (*POSITIONS, *POSITIONS)),
    *photodiode_inputs(TABLE, 3),
)
U = np.array([each.u for each in INPUTS])
TILT_U = 0.05 / 3.0**0.5
"""Of the beam, whose tilt has no uncertainty by default."""
CERTIFICATE = 0.002
"""That of the examples' etalon: the largest component of a diffuser."""
DIFFUSER = lambertian(1.0, side="both")


def views(
    sigma: float,
    polar: list[float],
    azimuth: list[float],
    *,
    lower: bool = False,
    transmitted: bool = False,
    gamma: float = 0.0,
    reverse: list[bool] | None = None,
) -> Views:
    n = len(polar)
    flags = np.full(n, lower), np.full(n, transmitted), np.array(reverse or [False] * n)
    return Views(np.full(n, sigma), np.full(n, gamma), np.radians(polar), np.radians(azimuth), *flags)


def in_plane(name: str, effects: PoseEffects) -> float:
    """Displacement in the plane of incidence, deg for a unit."""
    return float(effects.common.along[0, COMMON.index(name)])


# Closed forms (deg for a deg, deg for a mm), in the plane of incidence. A mirror turns the beam by the root of 2 times its tilt
# about a side that is at 45 deg to the beam, and the light by the share of the path before the mirror: 1/4, 2/4, 3/4.


@pytest.mark.parametrize("sigma", [0.0, 30.0, 65.0])
def test_in_the_plane_of_incidence_tilts_have_their_closed_forms(sigma: float) -> None:
    effects = pose_effects(INSTRUMENT, views(sigma, [sigma + 2.0], [180.0]))
    for mirror in (1, 2, 3):
        assert abs(in_plane(f"mirror_{mirror}_tilt_y", effects)) == pytest.approx(math.sqrt(2.0) * mirror / 4.0, rel=1e-12)
        assert in_plane(f"mirror_{mirror}_tilt_x", effects) == pytest.approx(0.0, abs=1e-12)
        shift = math.degrees(math.sqrt(2.0) / 800.0)
        assert math.hypot(
            in_plane(f"mirror_{mirror}_shift_z", effects), effects.common.across[0, COMMON.index(f"mirror_{mirror}_shift_z")]
        ) == pytest.approx(shift, rel=1e-12)
    assert in_plane("sigma_zero", effects) == pytest.approx(-1.0, rel=1e-12)
    assert in_plane("shift_zero", effects) == 1.0
    assert abs(in_plane("arc_tilt_y", effects)) == pytest.approx(1.0, rel=1e-12)
    assert abs(effects.sample.along[0, MOUNTED.index("tilt_y")]) == pytest.approx(2.0, rel=1e-12)
    assert effects.sample.along[0, MOUNTED.index("tilt_x")] == pytest.approx(0.0, abs=1e-12)
    assert not effects.etalon.along.any()


def test_in_plane_uncertainty_of_the_papers_table_2_and_of_the_defaults() -> None:
    effects = pose_effects(INSTRUMENT, views(30.0, [35.0], [180.0]))
    sums = moments((effects.common, U[: len(COMMON)]), (effects.sample, U[len(COMMON) : len(COMMON) + 3]))
    zeros = [COMMON.index(name) for name in ("sigma_zero", "shift_zero")]
    # The design's figures: 0.080 deg of tilts and shifts alone, and 0.094 deg with zeros and a photodiode's own angle.
    table_2 = sums[0, 0] - float(np.sum((effects.common.along[0, zeros] * U[zeros]) ** 2))
    assert math.sqrt(table_2) == pytest.approx(0.081, abs=0.0015)
    assert math.hypot(math.sqrt(sums[0, 0]), TABLE.u(PHOTODIODE_ANGLE)) == pytest.approx(0.095, abs=0.0015)


@pytest.mark.parametrize("sigma", [20.0, 160.0])
def test_the_samples_tilt_does_not_move_transmitted_light(sigma: float) -> None:
    effects = pose_effects(INSTRUMENT, views(sigma, [25.0, 15.0], [180.0, 170.0], lower=sigma < 90.0, transmitted=True))
    assert not effects.sample.along[:, :2].any()
    assert not effects.sample.across[:, :2].any()
    # The etalon is lit from the other side: where the incidence grows at the sample it falls at the etalon.
    expected = -2.0 * math.tan(math.radians(20.0)) * math.pi / 180.0
    assert np.abs(effects.common.diffuse[:, 0]) == pytest.approx(np.full(2, abs(expected)), rel=1e-9)


def test_what_moves_sample_and_etalon_alike_does_nothing_to_a_diffuser_in_reflected_light() -> None:
    effects = pose_effects(INSTRUMENT, views(50.0, [10.0, 70.0], [180.0, 30.0], gamma=70.0))
    assert not effects.common.diffuse.any()
    assert np.abs(effects.sample.diffuse + effects.etalon.diffuse).max() == 0.0
    tilt = math.tan(math.radians(50.0)) * math.pi / 180.0
    # A tilt towards light and photodiode alike: tan(theta_i) w_i + tan(theta_r) w_r; the disc cuts a part of the spot's edge.
    both = pose_effects(INSTRUMENT, views(50.0, [0.0], [0.0]))
    assert abs(both.sample.diffuse[0, 1]) == pytest.approx(tilt, rel=1e-12)


def test_the_lower_arc_lit_from_behind_is_the_mirror_image_of_the_upper_one() -> None:
    above = pose_effects(INSTRUMENT, views(40.0, [35.0, 62.0], [170.0, 20.0]))
    below = pose_effects(INSTRUMENT, views(140.0, [35.0, 62.0], [170.0, 20.0], lower=True))
    # Mirrored in the sample's plane: turns about x and y change their sign, those about z and shifts along x do not.
    for name, sign in (("arc_tilt_x", -1.0), ("arc_tilt_z", 1.0), ("shift_zero", 1.0), ("sigma_zero", -1.0)):
        k = COMMON.index(name)
        assert below.common.along[:, k] == pytest.approx(sign * above.common.along[:, k], abs=1e-12)
        # Across is to the right of the way along: its sign changes with the mirror image.
        assert below.common.across[:, k] == pytest.approx(-sign * above.common.across[:, k], abs=1e-12)


def test_a_photodiode_beyond_the_pole_moves_the_other_way() -> None:
    there = views(30.0, [5.0], [180.0], reverse=[True])
    effects = pose_effects(INSTRUMENT, there)
    assert in_plane("shift_zero", effects) == -1.0
    assert effects.photodiode.along.tolist() == [[-1.0, 0.0]]
    assert effects.photodiode.across.tolist() == [[0.0, -1.0]]
    assert effects.position.along[0].tolist()[3] == -1.0


# The acceptance of a photodiode.


def test_the_lens_of_two_discs_has_its_area_and_its_moment() -> None:
    line = (np.arange(600) + 0.5) / 300.0 - 1.0
    x, y = np.meshgrid(1.5 * line, 1.5 * line)
    apart = np.array([0.0, 0.2, 0.5, 0.9, 1.3, 1.9])
    for radius, other in ((1.0, 0.6), (0.6, 1.0), (1.0, 1.0)):
        area, first = common_disc(radius, other, apart)
        for k, each in enumerate(apart):
            inside = (x**2 + y**2 < radius**2) & ((x - each) ** 2 + y**2 < other**2)
            assert area[k] == pytest.approx(inside.sum() * 0.005**2, abs=4e-3)
            assert first[k] == pytest.approx(x[inside].sum() * 0.005**2, abs=4e-3)


def test_a_cone_alone_follows_its_axis_and_a_disc_alone_its_place() -> None:
    narrow = acceptance(replace(INSTRUMENT, field_deg=0.05, detector_diameter_mm=15.0))
    assert narrow.turn_along == pytest.approx(np.zeros(narrow.turn_along.size), abs=1e-6)
    assert narrow.nearer == pytest.approx(np.zeros(narrow.turn_along.size), abs=1e-6)
    wide = acceptance(replace(INSTRUMENT, field_deg=5.0))
    assert wide.turn_along == pytest.approx(np.ones(wide.turn_along.size), abs=1e-6)
    assert wide.spot_along == pytest.approx(np.zeros(wide.turn_along.size), abs=1e-6)
    # A disc's light goes as the square of the distance; and it sees the whole spot.
    assert wide.nearer == pytest.approx(np.full(wide.turn_along.size, 2.0), rel=1e-2)
    assert wide.share == pytest.approx(np.ones(wide.turn_along.size), rel=1e-3)


# Finite differences.


def deviation(name: str, size: float) -> tuple[str, Deviation]:
    """The element of the estimator and its deviation, for an input."""
    if name.startswith("beam_tilt_"):  # the unit about the sample's centre, 800 mm from the exit pupil
        far = INSTRUMENT.pupil_distance_mm * math.sin(math.radians(size))
        return "pupil", Deviation(rx_deg=size, z_mm=-far) if name.endswith("x") else Deviation(rz_deg=size, x_mm=far)
    found = re.fullmatch(r"(mirror_\d|arc|sensor|illumination|sample|etalon)_(tilt|shift|height)_?([xyz]?)", name)
    assert found is not None
    element = {"illumination": "pupil", "etalon": "sample"}.get(found[1], found[1])
    key = f"r{found[3]}_deg" if found[2] == "tilt" else f"{found[3] or 'z'}_mm"
    return element, Deviation(**{key: size})


class Twin:
    """Values of the fast estimator: the sample's throughput over that of the etalon, at `views`."""

    def __init__(self, sample: Scatterer, at: Views) -> None:
        self._sample, self._at = sample, at
        self._lower, self._far = bool(at.lower[0]), bool(at.transmitted[0])
        self._sign = np.where(at.reverse, -1.0, 1.0)
        self._plain = self._throughput(True), self._throughput(False)

    def value(self, name: str, size: float) -> Floats:
        of_sample = self._plain[0] if name.startswith("etalon") else self._throughput(True, name, size)
        of_etalon = self._plain[1] if name.startswith("sample") else self._throughput(False, name, size)
        return of_sample / of_etalon

    def slopes(self, step: float = 0.02) -> tuple[Floats, Floats]:
        """Slopes of the values per degree, along the arc and across it."""
        d = arc_direction(np.degrees(self._at.polar), np.degrees(self._at.azimuth), self._lower)
        found = []
        for way in self._ways():
            there = [self._ratio(d + sign * math.radians(step) * way) for sign in (1.0, -1.0)]
            found.append(np.log(there[0] / there[1]) / (2.0 * step))
        return found[0], found[1]

    def _ways(self) -> tuple[Floats, Floats]:
        """Unit vectors along the arc and across it."""
        polar, azimuth, up = self._at.polar, self._at.azimuth, -1.0 if self._lower else 1.0
        along = arc_direction(np.degrees(polar) + 90.0, np.degrees(azimuth), self._lower)
        return along, up * np.stack([-np.sin(azimuth), np.cos(azimuth), np.zeros_like(polar)], axis=1)

    def _axes(self) -> Floats:
        """The axes of the arcs: of one beyond the pole beta is at the opposite azimuth."""
        return arc_axis(np.degrees(self._at.azimuth) + np.where(self._at.reverse, 180.0, 0.0))

    def _ratio(self, directions: Floats) -> Floats:
        return self.of(True, INSTRUMENT, 0.0, directions) / self.of(False, INSTRUMENT, 0.0, directions)

    def _throughput(self, of_sample: bool, name: str = "", size: float = 0.0) -> Floats:
        polar, azimuth = np.degrees(self._at.polar), np.degrees(self._at.azimuth)
        turned, gamma, instrument = 0.0, 0.0, INSTRUMENT
        match name.removeprefix("sample_").removeprefix("etalon_"):
            case "sigma_zero" | "position_sigma":
                turned = size
            case "beta_zero" | "position_beta":
                azimuth = azimuth + size
            case "shift_zero" | "position_shift" | "photodiode_angle":
                polar = polar + size * self._sign
            case "photodiode_across":  # towards growing beta, on both arcs
                level = self._axes()
                directions = arc_direction(polar, azimuth, self._lower) + math.radians(size) * level
                return self.of(of_sample, INSTRUMENT, 0.0, directions)
            case "position_gamma":
                gamma = size
            case "":
                pass
            case _:
                element, moved = deviation(name, size)
                instrument = replace(INSTRUMENT, deviations={element: moved})
        return self.of(of_sample, instrument, turned, arc_direction(polar, azimuth, self._lower), gamma)

    def of(self, of_sample: bool, instrument: Instrument, turned: float, directions: Floats, gamma: float = 0.0) -> Floats:
        sigma = float(self._at.sigma_deg[0])
        at = sigma if of_sample or not self._far else 180.0 - sigma
        scatterer = self._sample if of_sample else DIFFUSER
        directions = np.concatenate([directions, self._axes()], axis=1)
        return throughput(instrument, at + turned, directions, scatterer, gamma_deg=float(self._at.gamma_deg[0]) + gamma)


def compare(sample: Scatterer, at: Views, step: float = 0.02) -> None:
    """Every sensitivity: to 5 % of it, or to 2 % of the point's largest component."""
    twin, effects = Twin(sample, at), pose_effects(INSTRUMENT, at)
    along, across = twin.slopes()
    parts: list[Displacement] = [
        effects.common,
        effects.sample,
        effects.etalon,
        effects.position,
        effects.etalon_position,
        effects.photodiode,
    ]
    computed = np.concatenate([part.relative(along, across) for part in parts], axis=1)
    differences = [np.log(twin.value(name, step) / twin.value(name, -step)) / (2.0 * step) for name in NAMES]
    u = np.where(np.array([name.startswith("beam_tilt") for name in NAMES]), TILT_U, U)
    component, found = computed * u, np.stack(differences, axis=1) * u
    largest = np.maximum(np.abs(found).max(axis=1, keepdims=True), CERTIFICATE)
    wrong = np.abs(component - found) > np.maximum(0.05 * np.abs(found), 0.02 * largest)
    assert [(NAMES[k], i, component[i, k], found[i, k]) for i, k in zip(*np.nonzero(wrong), strict=True)] == []
    # The mirror image of the test: with every sensitivity's sign changed it fails.
    assert np.any(np.abs(component + found) > 0.02 * largest)


@pytest.mark.parametrize(
    ("sample", "at"),
    [
        (gaussian(5.0, reflectance=0.5), views(30.0, [24.0, 26.0, 33.0, 40.0], [176.0, 180.0, 180.0, 185.0])),
        (gaussian(15.0, reflectance=0.5), views(60.0, [30.0, 45.0, 66.0], [180.0, 150.0, 200.0], gamma=40.0)),
        (lambertian(0.04), views(65.0, [10.0, 45.0, 80.0], [180.0, 150.0, 90.0])),
        (gaussian(5.0, reflectance=0.5), views(4.0, [1.0, 0.0, 1.0], [150.0, 150.0, 330.0], reverse=[False, False, True])),
    ],
)
def test_sensitivities_are_those_of_the_fast_estimator(sample: Scatterer, at: Views) -> None:
    compare(sample, at)


def test_a_lift_counts_the_more_where_discs_are_off_already() -> None:
    """The mixed second difference of the fast estimator; of the etalon's lift it is the same with the other sign."""
    at = views(20.0, [0.0, 25.0, 50.0, 75.0], [180.0, 120.0, 60.0, 90.0])
    twin, directions = Twin(lambertian(0.3), at), arc_direction(np.degrees(at.polar), np.degrees(at.azimuth))
    lift, sizes = 0.2, (0.2, 0.2, 0.2, 0.05, 0.2)
    of_lift, computed = pose_effects(INSTRUMENT, at).sample.diffuse[:, 2], pose_effects(INSTRUMENT, at).lifted.diffuse
    for k, (name, size) in enumerate(zip(ASIDE, sizes, strict=True)):
        mixed = np.zeros(directions.shape[0])
        for a, b in itertools.product((1.0, -1.0), repeat=2):
            moved = dict([deviation("sample_height", a * lift), deviation(name, b * size)])
            mixed += a * b * np.log(twin.of(True, replace(INSTRUMENT, deviations=moved), 0.0, directions))
        mixed /= 4.0 * lift * size
        assert computed[:, k] == pytest.approx(mixed, rel=0.15, abs=0.05 * float(np.abs(computed[:, k]).max()))
    assert np.any(np.abs(computed).max(axis=1) * 0.05 > np.abs(of_lift))  # one of 0.05 is as much as the lift itself


BOTH = gaussian(8.0, reflectance=0.5, side="both")
THROUGH = gaussian(8.0, reflectance=0.5, transmits=True, side="both")


@pytest.mark.long
@pytest.mark.parametrize(
    ("sample", "at"),
    [
        (gaussian(5.0, reflectance=0.5), views(0.0, [3.0, 6.0, 10.0], [180.0, 20.0, 90.0])),
        (gaussian(5.0, reflectance=0.5), views(80.0, [72.0, 76.0, 84.0], [180.0, 181.0, 180.0])),
        (gaussian(15.0, reflectance=0.5), views(30.0, [0.0, 10.0, 45.0, 60.0], [30.0, 180.0, 150.0, 200.0])),
        (BOTH, views(140.0, [34.0, 46.0, 43.0], [180.0, 180.0, 184.0], lower=True, gamma=40.0)),
        (THROUGH, views(30.0, [24.0, 36.0, 33.0], [180.0, 180.0, 184.0], lower=True, transmitted=True, gamma=20.0)),
        (THROUGH, views(150.0, [24.0, 36.0, 33.0], [180.0, 180.0, 184.0], transmitted=True, gamma=20.0)),
        (
            lambertian(0.3, 0.3, side="both"),
            views(50.0, [24.0, 66.0], [180.0, 100.0], lower=True, transmitted=True, gamma=20.0),
        ),
        (BOTH, views(176.0, [1.0, 0.0, 1.0], [150.0, 150.0, 330.0], lower=True, reverse=[False, False, True])),
    ],
)
def test_sensitivities_at_the_peak_in_transmission_and_from_behind(sample: Scatterer, at: Views) -> None:
    compare(sample, at)


# Rays traced from the source over the mirrors and the sample to the photodiodes.

STEPS = {"sample_tilt_y": 0.5, "mirror_3_tilt_y": 0.5, "arc_tilt_y": 0.5, "sensor_tilt_y": 0.1}
"""Half the steps of the differences, deg. The logarithm of a Gaussian is quadratic, so that a central difference has no error
of its own; but a photodiode's cone leaves its disc with the sensor's tilt (0.5 deg: 4 %)."""
PATHS = {"sensor_tilt_y": 600_000_000}
FEWER_PATHS = 110_000_000


@pytest.mark.long
@pytest.mark.parametrize("name", STEPS)
def test_sensitivities_at_three_points_are_those_of_traced_rays(name: str) -> None:
    """To 5 % of it or 2 % of the point's largest one, and four standard errors of the rays (0.8 %; sensor 1.6 %)."""
    sample, at, step = gaussian(5.0, reflectance=0.5), views(30.0, [25.0, 34.0, 36.0], [180.0, 180.0, 180.0]), STEPS[name]
    effects, directions = pose_effects(INSTRUMENT, at), arc_direction(np.degrees(at.polar), np.degrees(at.azimuth))
    parts, names = (effects.common, effects.sample), (*COMMON, *(f"sample_{each}" for each in MOUNTED))
    along, across = Twin(sample, at).slopes()
    computed = np.concatenate([part.relative(along, across) for part in parts], axis=1)
    traced, of_etalon = [], []
    for k, sign in enumerate((1.0, -1.0)):
        element, moved = deviation(name, sign * step)
        instrument = replace(INSTRUMENT, deviations={element: moved})
        traced.append(forward_throughput(instrument, 30.0, directions, sample, PATHS.get(name, FEWER_PATHS), seed=7 + k))
        of_etalon.append(throughput(INSTRUMENT if element == "sample" else instrument, 30.0, directions, DIFFUSER))
    value, error = [each.single_m2sr for each in traced], [each.single_error / each.single_m2sr for each in traced]
    found = (np.log(value[0] / value[1]) - np.log(of_etalon[0] / of_etalon[1])) / (2.0 * step)
    standard_error = np.hypot(*error) / (2.0 * step)
    own = computed[:, names.index(name)]
    largest = np.abs(computed).max(axis=1)
    assert np.all(standard_error < (0.017 if name in PATHS else 0.0085) * largest)
    assert np.all(np.abs(own - found) < np.maximum(0.05 * np.abs(found), 0.02 * largest) + 4.0 * standard_error)
    assert np.all(np.abs(own + found) > 0.2 * largest)


def test_a_variance_from_moments_is_the_sum_over_the_inputs() -> None:
    effects = pose_effects(INSTRUMENT, views(40.0, [20.0, 44.0, 70.0], [150.0, 180.0, 30.0], gamma=10.0))
    along, across = np.array([0.3, 0.0, -1.2]), np.array([-0.7, 0.1, 0.0])
    u = standard_uncertainties(rig_inputs(TABLE))
    direct = np.sum((effects.common.relative(along, across) * u) ** 2, axis=1)
    assert variance(moments((effects.common, u)), along, across) == pytest.approx(direct, rel=1e-13)
