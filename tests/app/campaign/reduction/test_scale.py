"""What values share by the etalon, the mountings and the light: closed forms of their covariances."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import replace
from datetime import date
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from goniotwin.app.campaign.reduction.arc_geometry import ArcGeometry
from goniotwin.app.campaign.reduction.components import Signal
from goniotwin.app.campaign.reduction.pipeline import add_shared
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.polarisation import light_state, light_words
from goniotwin.app.campaign.reduction.readings import Measurements, Repeats, repeats
from goniotwin.app.campaign.reduction.scale import certificate_effects, factor_effects, shape_of, shared_families
from goniotwin.app.campaign.reduction.settings import BeamScale, ReductionSettings, reduction_settings
from goniotwin.app.campaign.schedule.certificate import parse_certificate
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from goniotwin.app.rig.inputs import MOUNTING, REPEATABILITY
from goniotwin.app.rig.light import LightTable
from goniotwin.arrays import Floats
from tests.app.campaign.reduction.made_points import made_points
from tests.conftest import RIG, SMALL, Writer
from tests.rig_tables import stated

RIG_FILE = read_rig(RIG).file
SCHEDULE = parse_schedule(SMALL, "small.toml").file
MODES = """level = 0.002
wavelength = 0.003
angle = 0.001
calibrated = 2026-01-15
wavelength_nm, zenith_deg, radiance_factor, relative_uncertainty
400, 0, 1.0, 0.005
400, 80, 0.9, 0.006
600, 0, 1.0, 0.004
600, 80, 0.9, 0.008
"""
ONE_ENTRY = "level = 0.003\nradiance_factor, relative_uncertainty\n1.0, 0.005\n"
OLD = "wavelength_nm, radiance_factor, relative_uncertainty\n400, 1.0, 0.005\n500, 1.0, 0.003\n600, 1.0, 0.004\n"


def settings(
    text: str = MODES, *, light: LightTable | None = None, schedule: str = SMALL, **uncertainty: float
) -> ReductionSettings:
    rig = replace(RIG_FILE, light=light or LightTable(), uncertainty=stated(**uncertainty))
    file = parse_schedule(schedule, "small.toml").file
    return ReductionSettings(rig, ArcGeometry(rig), file, parse_certificate(text, "c.csv"), sample="gaussian-5")


def points_at(wavelength_nm: list[float], zenith: list[float]) -> BsdfPoints:
    """Points of value 2 in the plane of incidence at sigma 30."""
    made = made_points(30.0, np.array(zenith), np.zeros(len(zenith)), np.full(len(zenith), 2.0), 0.0)
    places = made.places.copy()
    places[:, 0] = wavelength_nm
    return replace(made, places=places)


def covariance(points: BsdfPoints, of: ReductionSettings) -> Floats:
    effects = certificate_effects(points, of)
    assert effects is not None
    everything = np.arange(points.size)
    return effects.covariance(everything, everything)


def test_two_wavelengths_of_a_certificate_share_its_level_and_have_opposite_slopes() -> None:
    found = covariance(points_at([400.0, 600.0, 510.0], [40.0, 40.0, 40.0]), settings()) / 4.0
    assert found[0, 1] == pytest.approx(0.002**2 - 0.003**2)  # the angle is in the middle of the table: no slope
    assert found[0, 2] == pytest.approx(0.002**2 - 0.1 * 0.003**2)
    # With itself it has what the table states, interpolated.
    assert np.diag(found)[:2] == pytest.approx([0.0055**2, 0.006**2])
    found = covariance(points_at([400.0, 400.0, 400.0], [0.0, 80.0, 1.0]), settings()) / 4.0
    assert found[0, 1] == pytest.approx(0.002**2 + 0.003**2 - 0.001**2)
    # Values nearest to one entry share all of it.
    assert found[0, 2] == pytest.approx(math.sqrt(found[0, 0] * found[2, 2]), rel=1e-3)


@given(st.floats(400.0, 600.0), st.floats(0.0, 80.0))
def test_the_modes_make_the_uncertainty_of_the_table(wavelength: float, zenith: float) -> None:
    points = points_at([wavelength], [zenith])
    for text in (MODES, OLD, ONE_ENTRY):
        of = settings(text)
        _, relative = of.certificate.interpolate(wavelength, 30.0, np.array([zenith]), np.zeros(1))
        effects = certificate_effects(points, of)
        assert effects is not None
        assert math.sqrt(math.fsum(float(each[0]) for each in effects.variances().values())) == pytest.approx(
            2.0 * relative[0], rel=1e-9
        )
        assert sum(each.u**2 for each in effects.budget(0)) == pytest.approx((2.0 * relative[0]) ** 2, rel=1e-9)


def test_of_an_old_certificate_the_smallest_uncertainty_is_common_and_the_rest_by_entry() -> None:
    of = settings(OLD)
    assert of.certificate.level == pytest.approx(0.003)
    found = covariance(points_at([400.0, 600.0, 420.0], [0.0, 0.0, 0.0]), of) / 4.0
    assert found[0, 1] == pytest.approx(0.003**2)
    assert found[0, 0] == pytest.approx(0.005**2)
    assert found[0, 2] > 0.003**2
    assert reduction_settings(RIG_FILE, SCHEDULE, None, "").certificate.level == RIG_FILE.etalon.relative_uncertainty


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (MODES.replace("level", "levels"), "levels: there is no such key; did you mean 'level'"),
        (MODES.replace("0.002", "0.2 %"), "not TOML.*line 1"),
        (MODES.replace("level = 0.002", "level = 2.0"), "level: .*less than 1"),
        (MODES.replace("level = 0.002", "level = 0.004"), r"make 0\.005\d* at 600 nm, 0 deg zenith, more than .*0\.004; lower"),
        (OLD.replace("wave", "angle = 0.001\nwave", 1), "angle: is a slope over zenith_deg, .*remove angle"),
        (f'geometry = "8:d"\n{MODES}', "geometry: 8:d is a measurement of one geometry, but the table has zenith_deg"),
        (f'geometry = "8/d"\n{OLD}', "geometry: '8/d' is no geometry: give .*8:d"),
        (f'geometry = "90:d"\n{OLD}', "geometry: '90:d' is no geometry"),
        (MODES.replace("2026-01-15", '"2026-01-15"'), "calibrated: should be a date"),
        ("level = 0.001\n", "is empty"),
    ],
)
def test_wrong_keys_of_a_certificate_are_refused_in_one_line(text: str, message: str) -> None:
    with pytest.raises(UserError, match=rf"^c\.csv: .*{message}") as refused:
        parse_certificate(text, "c.csv")
    assert "\n" not in str(refused.value)


def test_the_etalons_age_goes_from_its_calibration_to_the_measurement() -> None:
    measured = date(2028, 1, 15)
    assert reduction_settings(RIG_FILE, SCHEDULE, MODES, "c.csv", measured).etalon_years == pytest.approx(2.0, abs=0.01)
    assert reduction_settings(RIG_FILE, SCHEDULE, OLD, "c.csv", measured).etalon_years == 1.0
    points = points_at([500.0], [0.0])
    aged = add_shared(points, replace(settings(etalon_age_per_year=0.004), etalon_years=2.5))
    assert aged.budget["etalon_age"] == pytest.approx([2.0 * 0.01])


def test_a_rig_file_states_age_and_geometry_of_its_etalon_as_a_certificate_does(write_rig: Writer) -> None:
    keys = 'geometry = "8:d"\nshape = 0.02\ncalibrated = 2026-01-15\n'
    rig = read_rig(write_rig(("[etalon] ", f"[etalon]\n{keys}#"))).file
    of_rig = reduction_settings(rig, SCHEDULE, None, "", date(2028, 1, 15))
    text = f"{keys}level = 0.002\nradiance_factor, relative_uncertainty\n0.99, 0.002\n"
    of_file = reduction_settings(RIG_FILE, SCHEDULE, text, "c.csv", date(2028, 1, 15))
    points = points_at([500.0, 500.0], [0.0, 85.0])
    assert of_rig.etalon_years == of_file.etalon_years == pytest.approx(2.0, abs=0.01)
    one, other = (add_shared(points, each).budget for each in (of_rig, of_file))
    assert {name: each.tolist() for name, each in one.items()} == {name: each.tolist() for name, each in other.items()}
    plain = add_shared(points, reduction_settings(RIG_FILE, SCHEDULE, None, "", date(2028, 1, 15))).budget
    assert np.all(one["certificate"] > 2.0 * plain["certificate"])
    assert one["etalon_age"] == pytest.approx(plain["etalon_age"] * of_rig.etalon_years)
    with pytest.raises(UserError, match=r"etalon.geometry: .8/d. is no geometry: give .*8:d"):
        read_rig(write_rig(("[etalon] ", '[etalon]\ngeometry = "8/d"\n#')))


def test_a_hemispherical_certificate_leaves_the_angles_unknown_and_keeps_the_reflectance() -> None:
    theta = np.degrees(np.linspace(0.0, 0.5 * np.pi, 2001))
    weight = np.sin(2.0 * np.radians(theta)) * np.radians(theta[1])  # cos dOmega / pi
    assert np.sum(weight * shape_of("8:d", np.full(theta.size, 8.0), theta)) == pytest.approx(0.0, abs=1e-5)
    assert shape_of("0:45", np.zeros(1), np.full(1, 45.0)) == pytest.approx([0.0], abs=1e-12)
    assert shape_of("8:d", theta, np.full(theta.size, 20.0)) == pytest.approx(shape_of("8:d", np.full(theta.size, 20.0), theta))
    of = settings(f'geometry = "8:d"\nshape = 0.02\n{OLD}')
    points = points_at([500.0, 500.0], [0.0, 85.0])
    effects = certificate_effects(points, of)
    assert effects is not None
    known = 3.0 * math.cos(math.radians(30.0)) - 3.0 * math.cos(math.radians(8.0))
    expected = 0.02 * np.array([known + 1.0, known + 3.0 * math.cos(math.radians(85.0)) - 2.0])
    assert effects.variances()["certificate[geometry]"] == pytest.approx((2.0 * expected) ** 2)
    assert effects.covariance(np.array([0]), np.array([1]))[0, 0] < 0.0


def test_a_mounting_is_common_to_a_sample_and_that_of_the_etalon_to_all_samples() -> None:
    points, of = points_at([500.0, 500.0], [0.0, 20.0]), settings(mounting=0.01)
    one, other = (factor_effects(MOUNTING, points, each) for each in (of, replace(of, sample="paint")))
    assert one is not None
    assert other is not None
    assert one.covariance(np.array([0]), np.array([1])) == pytest.approx(np.full((1, 1), 4.0 * 2e-4))
    names = [{each.input.name for each in effects.budget(0) if each.input is not None} for effects in (one, other)]
    assert names[0] & names[1] == {"mounting@etalon#1"}
    assert names[0] ^ names[1] == {"mounting@gaussian-5#1", "mounting@paint#1"}


def test_a_mean_of_repeats_has_half_the_variance_of_the_samples_rows_and_all_of_the_etalons() -> None:
    points = points_at([500.0, 500.0, 510.0], [0.0, 0.0, 0.0])
    points = replace(points, row=np.array([10, 11, 12]), etalon_row=np.array([3, 3, 4]))
    effects = factor_effects(REPEATABILITY, points, settings(repeatability=0.01))
    assert effects is not None
    assert effects.variances()["repeatability"] == pytest.approx(np.full(3, 4.0 * 2e-4))
    assert effects.covariance(np.array([0, 0]), np.array([1, 2]))[0] == pytest.approx([4e-4, 0.0])
    mean = effects.of_sum(np.array([0.5, 0.5, 0.0]))
    assert sum(each.u**2 for each in mean) == pytest.approx(4.0 * 1.5e-4)


@pytest.mark.long
def test_the_open_beam_takes_the_place_of_certificate_age_and_edge_where_it_is_the_scale() -> None:
    """Transmitted light at one wavelength and sigma; the other points have the certificate."""
    points = points_at([500.0, 500.0, 510.0], [120.0, 40.0, 120.0])
    points = replace(points, transmitted=np.array([True, False, True]))
    scales = {(500.0, 30.0, True): BeamScale(1.01, 0.006, 3), (500.0, 30.0, False): BeamScale(1.02, 0.1, 3)}
    of = replace(settings(OLD), absolute=scales)
    found = add_shared(points, of)
    assert found.budget["open_beam"] == pytest.approx([2.0 * 0.006, 0.0, 0.0])
    for name in ("certificate", "etalon_age", "etalon_edge"):
        assert (found.budget[name] > 0.0).tolist() == [False, True, True]
    # The etalon's mounting is in the scan's scale as in the value: it cancels there.
    mounted = add_shared(points, replace(of, rig=settings(mounting=0.01).rig)).budget["mounting"]
    assert mounted == pytest.approx([2.0 * 0.01, 2.0 * math.hypot(0.01, 0.01), 2.0 * math.hypot(0.01, 0.01)])
    back = add_shared(replace(points, back=np.ones(3, dtype=bool)), of)
    assert back.budget["open_beam"] == pytest.approx([2.0 * 0.1, 0.0, 0.0])
    noisy = replace(found, own={**found.own, "noise": np.full(3, 1e-8)})
    assert np.all(noisy.own_variance(0.003) >= 1e-8)


def test_an_etalon_that_is_compared_with_itself_has_no_mounting_and_no_repeat() -> None:
    points, of = points_at([500.0], [20.0]), settings(mounting=0.01, repeatability=0.02)
    same = add_shared(replace(points, etalon_row=points.row), replace(of, sample=of.schedule.etalon))
    assert float(same.budget["mounting"][0]) == float(same.budget["repeatability"][0]) == 0.0
    assert add_shared(points, of).budget["mounting"] == pytest.approx(2.0 * math.hypot(0.01, 0.01))


def test_what_is_zero_or_unknown_is_no_component() -> None:
    keys = "etalon_age_per_year etalon_edge mounting uniformity repeatability wavelength_nm monochromator_stray"
    zeros = stated(**dict.fromkeys(keys.split(), 0.0))
    of = replace(settings(), rig=replace(RIG_FILE, uncertainty=zeros))
    points = points_at([500.0], [0.0])
    assert add_shared(points, of).components.keys() == {"noise", "certificate"}
    known = replace(points, wavelength_slope=np.array([0.01]), band_correction=np.array([0.02]))
    assert [name for name, effects_of in shared_families().items() if effects_of(known, of)] == ["certificate", "bandwidth"]


# The light.


@given(st.floats(0.0, 1.0), st.floats(-180.0, 179.0), st.floats(0.0, 180.0))
def test_equal_mirrors_turn_the_polarisation_and_keep_its_degree(degree: float, azimuth: float, sigma: float) -> None:
    light = LightTable(polarisation=degree, azimuth_deg=azimuth, mirror_s=0.9, mirror_p=0.9)
    q, u = light_state(light, np.array([sigma]))
    assert math.hypot(q[0], u[0]) == pytest.approx(degree, abs=1e-12)
    assert q[0] == pytest.approx(degree * math.cos(2.0 * math.radians(azimuth - sigma)), abs=1e-12)


def test_mirrors_polarise_light_along_the_samples_p_at_every_sigma() -> None:
    q, u = light_state(LightTable(mirror_s=0.96, mirror_p=0.92), np.array([0.0, 40.0, 140.0]))
    s, p = 0.92**3, 0.96**3  # the mirrors' p is the sample's s
    assert q == pytest.approx(np.full(3, (s - p) / (s + p)))
    assert u == pytest.approx(np.zeros(3))
    words = light_words(LightTable(mirror_s=0.96, mirror_p=0.92), np.array([40.0]))
    assert words.endswith("6.4 % at 90 deg for sigma 40")


def test_vertical_light_is_the_samples_s_at_sigma_0_and_its_p_at_90() -> None:
    """The mirrors' plane of incidence goes through the axis of sigma and the light's direction: at sigma 0 the vertical."""
    q, _ = light_state(LightTable(polarisation=1.0, mirror_s=0.9, mirror_p=0.8), np.array([0.0, 90.0]))
    assert q == pytest.approx([1.0, -1.0])


def test_polarisation_is_in_u_where_the_schedule_states_the_diattenuation() -> None:
    light, points = LightTable(polarisation=0.3, azimuth_deg=20.0), points_at([500.0], [0.0])
    assert "polarisation" not in add_shared(points, settings(light=light)).components
    stated = add_shared(points, settings(light=light, schedule=f"{SMALL}[diattenuation]\ngaussian-5 = 0.2\n"))
    q, _ = light_state(light, np.array([30.0]))
    assert stated.budget["polarisation"] == pytest.approx(np.abs(q) * 0.2 * 2.0)
    with pytest.raises(UserError, match=r"^small\.toml: diattenuation: 'paint' is not among the samples; name one of them"):
        parse_schedule(f"{SMALL}[diattenuation]\npaint = 0.2\n", "small.toml")


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("polarisation = 1.5", r"light\.polarisation: "),
        ("mirror_s = 0.0", r"light\.mirror_s: "),
        ("bandwidth_nm = -1.0", r"light\.bandwidth_nm: "),
        ("degree = 0.1", r"light\.degree: there is no such key"),
    ],
)
def test_wrong_keys_of_the_light_are_refused(table: str, message: str, write_rig: Writer) -> None:
    with pytest.raises(UserError, match=message):
        read_rig(write_rig(("[etalon]", f"[light]\n{table}\n\n[etalon]")))


# Repeats.


def drawn_measurements(scatter: float, noise: float, poses: int, seed: int = 2) -> Measurements:
    """Rows of a sample at some poses, each twice: a factor of this scatter for each row, and noise for each photodiode."""
    rng = np.random.default_rng(seed)
    names = ("wavelength_nm", "gamma_deg", "sigma_deg", "beta_deg", "shift_deg")
    table = np.zeros(2 * poses, dtype=[("number", "i8"), *((name, "f8") for name in names)])
    table["number"], table["beta_deg"] = np.arange(2 * poses), np.tile(np.arange(poses), 2)
    factor = 1.0 + scatter * rng.standard_normal((2 * poses, 1))
    values = factor * (1.0 + noise * rng.standard_normal((2 * poses, 18)))

    def row_signals(numbers: Iterable[int]) -> Iterator[Any]:
        for k in numbers:
            yield SimpleNamespace(signal=Signal(values[k], {"noise": np.full(18, noise**2)}, gain=np.zeros(18, dtype=np.int64)))

    return cast(
        Measurements, SimpleNamespace(row_table=lambda _sample: table, keep_signals=lambda numbers: list(row_signals(numbers)))
    )


def test_repeats_show_what_noise_and_monitor_do_not_explain() -> None:
    quiet = repeats(drawn_measurements(0.0, 0.002, 12), ["paint"], 0.0)
    assert quiet is not None
    assert quiet.scatter == pytest.approx(quiet.expected, rel=0.4)
    assert quiet.excess == 0.0
    found = repeats(drawn_measurements(0.01, 0.002, 12), ["paint"], 0.0)
    assert found is not None
    assert found.freedom == 12
    assert found.excess == pytest.approx(0.01, rel=0.4)
    assert repeats(drawn_measurements(0.01, 0.002, 12), ["paint"], 0.01**2).excess == 0.0  # type: ignore[union-attr]
    assert repeats(drawn_measurements(0.01, 0.002, 9), ["paint"], 0.0) is None


def test_a_sentence_has_whether_the_stated_repeatability_is_replaced() -> None:
    found = Repeats(300, 150, 0.01, 0.002)
    assert "in u as repeatability, in place of the stated 0.10%" in found.sentence(0.001)
    assert "agrees with the stated repeatability of 2.00%" in found.sentence(0.02)
