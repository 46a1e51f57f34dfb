"""`goniotwin.compare`: formula 5 with its range, deviations in u, chi-square by the covariance."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.data.comparison import _quadratic, compare_figure_13
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.rig import read_rig
from tests.app.data.made import gaussian, lambertian, rings, table
from tests.conftest import Writer

POLAR, AZIMUTH = np.arange(0.0, 86.0, 2.0), np.arange(0.0, 181.0, 10.0)


def dataset_of(*parts: Any) -> goniotwin.Dataset:
    return dataset_of_file(BsdfFile(parts), "made")


def scaled(part: ScatteredBsdf, factor: Any) -> ScatteredBsdf:
    return replace(part, values=factor * part.values)


def test_formula_5_is_that_of_the_paper() -> None:
    """Values 1 and 3 against 1 and 1: (2 / 2)^2 and 0, over two directions: the root of a half."""
    one = rings(lambertian(math.pi), 0.0, np.array([10.0, 20.0]), np.array([180.0]))
    result = goniotwin.compare(dataset_of(scaled(one, np.array([1.0, 3.0]))), dataset_of(one))
    assert result.relative_rms_percent == pytest.approx(100.0 * math.sqrt(0.5))
    assert [each.count for each in result.lights] == [2]
    assert np.isnan(result.lights[0].z).all()
    assert math.isnan(result.lights[0].chi_square)
    assert result.notes == ("neither of the two has uncertainties: there is no z and no chi-square",)
    assert "nan" not in str(result)
    assert str(result).splitlines()[1] == "sigma 0 deg: relative RMS 70.7 % over 2 directions"


def test_a_direction_that_both_have_twice_is_compared_value_by_value() -> None:
    """A dataset is itself, also where one direction was measured several times; a further value meets the last one there."""
    one = rings(lambertian(math.pi), 0.0, np.array([10.0, 20.0, 10.0]), np.array([180.0]), u=0.01)
    twice = dataset_of(scaled(one, np.array([1.0, 3.0, 2.0])))
    (found,) = goniotwin.compare(twice, twice).lights
    assert (found.relative_rms_percent, found.count, found.largest_z) == (0.0, 2, 0.0)
    thrice = rings(lambertian(math.pi), 0.0, np.array([10.0, 10.0, 10.0]), np.array([180.0]), u=0.01)
    (found,) = goniotwin.compare(dataset_of(thrice), twice).lights
    np.testing.assert_allclose(found.second, [1.0, 2.0, 2.0])


def test_a_journal_against_its_theory_is_the_comparison_of_the_virtual_rig(dataset: goniotwin.Dataset) -> None:
    truth = goniotwin.theory(dataset)
    result = goniotwin.compare(dataset, truth, theta_deg=10.0, in_plane=True, least_share=0.0)
    aside = np.abs(np.sin(np.radians(dataset.azimuth_deg - dataset.psi_deg)) * np.sin(np.radians(dataset.polar_deg)))
    here = dataset.good & (dataset.theta_deg <= 10.0) & (dataset.polar_deg <= 85.0) & (aside < 1e-9)
    pairs: dict[tuple[float, float], list[tuple[float, float]]] = {}
    for k in np.flatnonzero(here).tolist():
        pairs.setdefault((dataset.polar_deg[k], dataset.azimuth_deg[k]), []).append((dataset.bsdf[k], truth.bsdf[k]))
    means = [np.mean(each, axis=0) for each in pairs.values()]
    expected = 100.0 * math.sqrt(sum(((a - b) / (0.5 * (a + b))) ** 2 for a, b in means) / len(means))
    (found,) = result.lights
    assert found.count == len(means) > 10
    assert found.relative_rms_percent == pytest.approx(expected)
    assert dataset.reduced is not None
    assert dataset.only.measured is not None
    figure = compare_figure_13(dataset.reduced.rig, "gaussian-5", dataset.only.measured.points)
    assert figure.by_sigma == {found.light.sigma_deg: pytest.approx(found.relative_rms_percent)}
    assert (figure.lights[0].count, str(figure.range)) == (found.count, str(result.range))
    assert str(result.range) == "in the plane of incidence, theta to 10 deg, polar angle to 85 deg"
    np.testing.assert_array_equal(found.second, truth.bsdf[found.index])
    assert (found.u_second == 0.0).all()
    assert found.share_within_2 == 1.0
    assert found.largest_z < 2.0
    # The model in words has the same values.
    in_words = goniotwin.theory(dataset, "gaussian:width_deg=5,form=one_over_e,quantity=luminance,reflectance=0.9")
    assert in_words.u.tolist() == [0.0] * dataset.size


def test_z_and_chi_square_of_a_journal_have_the_covariance(dataset: goniotwin.Dataset) -> None:
    truth = goniotwin.theory(dataset)
    (found,) = goniotwin.compare(dataset, truth, least_share=0.0, polar_deg=90.0).lights
    covariance = dataset.where(found.index).covariance()
    linear = np.abs(found.z) < 0.3
    np.testing.assert_allclose(
        found.z[linear], ((found.first - found.second) / np.sqrt(np.diag(covariance)))[linear], rtol=0.1, atol=0.03
    )
    difference = (found.first - found.second)[found.in_range]
    inner = covariance[np.ix_(found.in_range, found.in_range)]
    assert found.degrees == difference.size
    assert found.chi_square == pytest.approx(difference @ np.linalg.solve(inner, difference), rel=1e-6)
    assert 0.2 * found.degrees < found.chi_square < 2.0 * found.degrees


def test_a_common_error_counts_once_in_chi_square() -> None:
    part = rings(lambertian(1.0), 30.0, POLAR, AZIMUTH, u=0.01)
    shared = replace(part, u_shared=np.sqrt(0.9) * np.asarray(part.u))
    exact = replace(part, u=np.zeros(part.size))
    (found,) = goniotwin.compare(dataset_of(scaled(shared, 1.02)), dataset_of(exact)).lights
    np.testing.assert_allclose(found.z, 2.0, rtol=1e-6)
    own, common = 0.1 * 0.01**2, 0.9 * 0.01**2
    assert found.chi_square == pytest.approx(0.02**2 * found.degrees / (own + found.degrees * common), rel=1e-6)
    assert found.chi_square < 5.0


def test_a_table_is_compared_between_its_nodes_and_incidences() -> None:
    lobe = gaussian(15.0)
    measured = rings(lobe, 20.0, POLAR, AZIMUTH, u=0.001)
    of_table = table(lobe, np.array([0.0, 30.0, 90.0]), 1.0, u=0.001)
    result = goniotwin.compare(dataset_of(measured), dataset_of(of_table))
    assert result.relative_rms_percent < 0.3
    assert math.isnan(result.lights[0].chi_square)
    assert any("share of their u is not known" in note for note in result.notes)
    assert np.isfinite(result.lights[0].z).all()
    with pytest.raises(goniotwin.GoniotwinError, match=r"sigma 90 deg and the second has .* in the other order"):
        goniotwin.compare(dataset_of(of_table), dataset_of(measured))  # of one incidence that the table does not have


def test_what_the_second_does_not_have_is_left_out_in_words() -> None:
    def at(sigma_deg: float) -> ScatteredBsdf:
        return rings(lambertian(1.0), sigma_deg, POLAR, AZIMUTH, u=0.01)

    result = goniotwin.compare(dataset_of(at(0.0), at(30.0)), dataset_of(at(0.0)))
    assert [each.light.sigma_deg for each in result.lights] == [0.0]
    assert any("sigma 30 deg" in note for note in result.notes)
    assert "sigma 0 deg" in str(result)
    with pytest.raises(goniotwin.GoniotwinError, match="the first has sigma 30 deg and the second has sigma 0 deg"):
        goniotwin.compare(dataset_of(at(30.0)), dataset_of(at(0.0)))


def test_directions_that_are_not_trusted_are_counted_by_flag() -> None:
    part = rings(lambertian(1.0), 30.0, np.array([10.0, 20.0]), np.array([0.0, 180.0]))
    lost = replace(part, flags=np.array(["clipped", "shadowed clipped", "", "clipped under-range"]))
    dim = replace(part, flags=np.array(["shadowed", "under-range", "", ""]))
    result = goniotwin.compare(dataset_of(lost), dataset_of(dim))
    assert result.notes[:2] == (
        "the first: 3 of 4 directions are left out, because they are not trusted: 2 clipped, 1 shadowed",
        "the second: 1 of 4 directions are left out, because they are not trusted: 1 shadowed",
    )


def test_the_notes_on_uncertainties_do_not_contradict_each_other() -> None:
    part = rings(lambertian(1.0), 30.0, np.array([10.0, 20.0]), np.array([0.0, 180.0]), u=0.01)
    none = replace(part, u=np.full(part.size, np.nan))
    some = replace(part, u=np.where(np.arange(part.size) == 0, np.nan, np.asarray(part.u)))
    unknown = "there is no chi-square where the covariance is not known: "
    assert goniotwin.compare(dataset_of(part), dataset_of(none)).notes == (
        "the second has no uncertainties: z is there in that of the first alone",
        f"{unknown}the second has no uncertainties; what values of the first share of their u is not known",
    )
    assert goniotwin.compare(dataset_of(some), dataset_of(part)).notes[0] == (
        "the first has no uncertainty of some values: z is there in that of the second alone"
    )
    both = goniotwin.compare(dataset_of(part), dataset_of(part))
    assert both.notes == (f"{unknown}what values of the first and the second share of their u is not known",)
    negative = goniotwin.compare(dataset_of(scaled(part, -1.0)), dataset_of(scaled(part, -1.0)))
    assert str(negative).startswith("relative RMS (formula 5) has no direction: ")
    assert "sigma 30 deg: no direction in range, largest" not in str(negative)


def test_the_azimuth_of_the_light_repeats_and_does_not_count_for_an_isotropic_sample() -> None:
    part = rings(lambertian(1.0), 30.0, np.array([10.0, 20.0]), np.array([0.0, 180.0]), u=0.01, isotropic=False)
    for psi in (360.0, -360.0):
        turned = replace(part, psi_deg=np.full(part.size, psi))
        assert goniotwin.compare(dataset_of(part), dataset_of(turned)).lights[0].count > 0
    opposite = replace(part, psi_deg=np.full(part.size, 180.0), azimuth_deg=part.azimuth_deg + 180.0)
    with pytest.raises(goniotwin.GoniotwinError, match="wavelength, side and azimuth of the light have to be equal"):
        goniotwin.compare(dataset_of(part), dataset_of(opposite))
    assert goniotwin.compare(dataset_of(replace(part, isotropic=True)), dataset_of(opposite)).lights[0].count > 0
    in_another_order = part.where(np.arange(part.size)[::-1])
    assert goniotwin.compare(dataset_of(part), dataset_of(in_another_order)).relative_rms_percent == 0.0


def test_directions_on_no_grid_are_not_those_between_which_another_is_compared() -> None:
    rng = np.random.default_rng(5)
    n = 40
    polar, azimuth = rng.uniform(0.0, 80.0, n), rng.uniform(0.0, 360.0, n)
    scattered = dataset_of(ScatteredBsdf(np.full(n, 30.0), np.zeros(n), polar, azimuth, np.ones(n), isotropic=True))
    of_rings = dataset_of(rings(lambertian(1.0), 30.0, POLAR, AZIMUTH))
    assert goniotwin.compare(scattered, of_rings).lights[0].count > 0
    with pytest.raises(goniotwin.GoniotwinError, match=r"of the second are on no grid.*; give them in the other order"):
        goniotwin.compare(of_rings, scattered)
    with pytest.raises(goniotwin.GoniotwinError, match=r"neither on rings nor on a grid.* with select or where"):
        scattered.at(theta_deg=12.0, phi_deg=40.0)


def test_wavelengths_have_to_be_the_same_unless_one_has_none() -> None:
    part = rings(lambertian(1.0), 0.0, POLAR, AZIMUTH, u=0.01)
    green, red = (replace(part, wavelength_nm=np.full(part.size, nm)) for nm in (550.0, 650.0))
    assert goniotwin.compare(dataset_of(green), dataset_of(part)).lights[0].count > 0
    with pytest.raises(goniotwin.GoniotwinError, match="the first has 550 nm, sigma 0 deg and the second has 650 nm"):
        goniotwin.compare(dataset_of(green), dataset_of(red))
    two = goniotwin.compare(dataset_of(green, red), dataset_of(red, green))
    assert [each.light.wavelength_nm for each in two.lights] == [550.0, 650.0]


def test_the_theory_of_a_model_is_exact_also_for_scattered_directions_on_both_sides() -> None:
    rng = np.random.default_rng(3)
    n = 40
    ones = np.ones(n, dtype=bool)
    part = ScatteredBsdf(
        np.full(n, 40.0), np.full(n, 70.0), rng.uniform(0.0, 80.0, n), rng.uniform(0.0, 360.0, n), np.ones(n), isotropic=False
    )
    for back, transmitted in ((False, False), (False, True), (True, False), (True, True)):
        d = dataset_of(replace(part, back=ones & back, transmitted=ones & transmitted))
        model = (
            f"gaussian:width_deg=20,peak=2,side=both,transmits={str(transmitted).lower()},quantity=luminance,form=one_over_e"
        )
        truth = goniotwin.theory(d, model)
        expected = 2.0 * np.exp(-((d.theta_deg / 20.0) ** 2))
        np.testing.assert_allclose(truth.bsdf, expected, rtol=1e-6)
        assert goniotwin.compare(truth, truth).relative_rms_percent == 0.0


def test_an_anisotropic_theory_turns_with_psi() -> None:
    polar = np.array([20.0, 20.0])
    azimuth = np.array([0.0, 90.0])  # along the wide direction of the sample, and across it
    n = polar.size
    for psi in (0.0, 35.0):
        d = dataset_of(ScatteredBsdf(np.zeros(n), np.full(n, psi), polar, azimuth, np.ones(n), isotropic=False))
        truth = goniotwin.theory(d, "anisotropic-gaussian:along_deg=30,across_deg=5,direction_deg=0,peak=1")
        assert truth.bsdf[0] > 100.0 * truth.bsdf[1]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"theta_deg": -1.0}, "theta_deg"),
        ({"polar_deg": "x"}, "polar_deg"),
        ({"least_share": 2.0}, "least_share"),
        ({"theta_deg": float("nan")}, "theta_deg"),
        ({"in_plane": 1}, "in_plane"),
        ({"theta_deg": True}, "theta_deg"),
    ],
)
def test_a_range_that_is_none_is_refused(arguments: dict[str, Any], message: str) -> None:
    d = dataset_of(rings(lambertian(1.0), 0.0, POLAR, AZIMUTH))
    with pytest.raises(goniotwin.GoniotwinError, match=message):
        goniotwin.compare(d, d, **arguments)


@pytest.mark.parametrize(
    ("name", "remedy"), [("theory", r"theory\(d\)"), ("gaussian:width_deg=5", r"theory\(d, 'gaussian:width_deg=5'\)")]
)
def test_the_name_of_a_model_points_to_its_theory(name: str, remedy: str) -> None:
    d = dataset_of(rings(lambertian(1.0), 0.0, POLAR, AZIMUTH))
    with pytest.raises(goniotwin.GoniotwinError, match=rf"{name}: there is no such file.* goniotwin\.{remedy}"):
        goniotwin.compare(d, name)


def test_what_has_no_theory_is_refused(dataset: goniotwin.Dataset) -> None:
    d = dataset_of(rings(lambertian(1.0), 0.0, POLAR, AZIMUTH))
    with pytest.raises(goniotwin.GoniotwinError, match="is not one of a virtual rig"):
        goniotwin.theory(d)
    for wrong in ("mirror", 3):
        with pytest.raises(goniotwin.GoniotwinError, match="sample"):
            goniotwin.theory(dataset, wrong)  # type: ignore[arg-type]


def test_a_singular_covariance_counts_the_combinations_that_it_has() -> None:
    assert _quadratic(np.ones((3, 3)), np.ones(3)) == pytest.approx((1.0, 1))
    assert _quadratic(np.diag([1.0, 4.0]), np.array([1.0, 2.0])) == pytest.approx((2.0, 2))
    assert math.isnan(_quadratic(np.zeros((1, 1)), np.ones(1))[0])


def test_a_campaign_of_two_samples(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    path = tmp_path / "two.journal"
    schedule = write_schedule(('["gaussian-5"]', '["gaussian-5", "white-tile"]'))
    run_campaign(make_plan(read_schedule(schedule), read_rig(write_rig())), path)
    d = goniotwin.open(path)
    assert d.samples == ("gaussian-5", "white-tile")
    with pytest.raises(goniotwin.GoniotwinError, match="'gaussian-5', 'white-tile'"):
        goniotwin.compare(d, d)
    (found,) = goniotwin.compare(d["gaussian-5"], d["white-tile"], least_share=0.0).lights
    assert found.relative_rms_percent > 50.0
    plain = np.hypot(found.u_first, found.u_second)
    # What both share, the certificate first of all, is not in the uncertainty of their difference.
    bright = (found.first > 0.3) & (found.second > 0.2)
    assert bright.any()
    z_without = (found.first - found.second)[bright] / plain[bright]
    assert (np.abs(found.z[bright]) > np.abs(z_without)).all()
