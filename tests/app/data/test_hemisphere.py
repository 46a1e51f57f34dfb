"""`Dataset.reflectance`: of journals, tables, rings and regular factors."""

import math
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import goniotwin
from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.budget import budget_of_reflectance, parse_place
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.data.hemisphere import grid_weights
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.formats.content import ABSENT, BsdfFile, RegularTable
from goniotwin.app.formats.table import BsdfTable
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import from_specular
from tests.app.data.made import gaussian, lambertian, rings, table
from tests.conftest import Writer

POLAR, AZIMUTH = np.arange(0.0, 86.0, 5.0), np.arange(0.0, 360.0, 15.0)


def dataset_of(*parts: Any) -> goniotwin.Dataset:
    return dataset_of_file(BsdfFile(parts), "made")


def test_a_journal_has_that_of_its_budget_with_the_journal_closed(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = tmp_path / "tile.journal"
    schedule = write_schedule(
        ("beta_deg = [180]", "beta_deg = [0, 30, 60, 90, 120, 150, 180]"),
        ('["gaussian-5"]', '["white-tile"]'),
        ("shift_deg = [0, 1]", "shift_deg = [0]"),
    )
    run_campaign(make_plan(read_schedule(schedule), read_rig(write_rig())), path)
    with Journal.open(path) as journal:
        expected = budget_of_reflectance(evaluate_journal(journal).reduction, parse_place("sigma=30"))
    d = goniotwin.open(path)
    shutil.move(path, path.with_suffix(".away"))
    found = d.reflectance(sigma_deg=30)
    value, u = found
    assert (value, u, found.unit) == (pytest.approx(expected.value), pytest.approx(expected.u), "1")
    assert abs(value - 0.99) < 3.0 * u
    assert "covariance: of all inputs" in found.about[0]
    components = sum(each**2 for each in d.components.values())
    np.testing.assert_allclose(np.sqrt(components)[d.good], d.u[d.good])
    some = d.where(d.good).where(np.arange(5))
    np.testing.assert_allclose(np.sqrt(np.diag(some.covariance())), some.u)
    assert some.covariance()[0, 1] > 0.0
    with pytest.raises(goniotwin.GoniotwinError, match="do not cover the half sphere"):
        d.select(azimuth_deg=90).reflectance()
    with pytest.raises(goniotwin.GoniotwinError, match="sigma_deg 31"):
        d.reflectance(sigma_deg=31)


@settings(max_examples=25)
@given(st.floats(0.0, 80.0), st.booleans(), st.booleans())
def test_the_weights_of_a_grid_add_up_to_the_half_sphere(sigma_deg: float, mirrored: bool, one: bool) -> None:
    theta = np.array([0.0, 1.0, 3.0, 10.0, 40.0, 90.0, 180.0])
    phi = np.array([0.0]) if one else np.arange(0.0, 181.0 if mirrored else 360.0, 20.0)
    weights, beyond = grid_weights(theta, phi, sigma_deg, mirrored=mirrored)
    assert weights.shape == (phi.size, theta.size)
    assert weights.sum() == pytest.approx(math.pi, rel=2e-3)
    assert beyond == 0.0
    held, share = grid_weights(theta[:4], phi, sigma_deg, mirrored=mirrored)
    assert held.sum() == pytest.approx(math.pi, rel=2e-3)
    assert 0.9 < share < 1.0


def test_the_weights_of_a_grid_have_the_cosine_at_each_direction() -> None:
    theta, phi = np.arange(0.5, 180.0, 1.0), np.arange(1.0, 180.0, 2.0)
    t, p = np.meshgrid(theta, phi)
    towards_the_normal = 1.0 + np.cos(np.radians(p))
    cosine = np.maximum(from_specular(60.0, t, p)[..., 2], 0.0)
    expected = 2.0 * np.sum(towards_the_normal * cosine * np.sin(np.radians(t))) * math.radians(1.0) * math.radians(2.0)
    at, around = np.array([0.0, 180.0]), np.arange(0.0, 181.0, 10.0)
    weights, _ = grid_weights(at, around, 60.0, mirrored=True)
    assert np.sum(weights * (1.0 + np.cos(np.radians(around)))[:, None]) == pytest.approx(expected, rel=4e-3)


@pytest.mark.parametrize("sigma_deg", [0.0, 60.0])
@pytest.mark.parametrize("kind", ["rings", "table"])
def test_a_diffuser_has_its_reflectance_at_any_incidence(kind: str, sigma_deg: float) -> None:
    diffuse = lambertian(0.7)
    part: Any = (
        rings(diffuse, sigma_deg, POLAR, AZIMUTH, u=0.01)
        if kind == "rings"
        else table(diffuse, np.array([sigma_deg]), 5.0, u=0.01)
    )
    found = dataset_of(part).reflectance(sigma_deg=sigma_deg)
    assert found.value == pytest.approx(0.7, rel=2e-3)
    # u is taken as common to all values, with a remark.
    assert found.u == pytest.approx(0.007, rel=0.15)
    assert any("u is common to all values" in each for each in found.about)


def test_a_lobe_has_its_albedo() -> None:
    def albedo(width: float) -> float:
        theta = np.radians(np.linspace(0.0, 90.0, 100_001))
        f = np.exp(-((theta / math.radians(width)) ** 2)) * np.cos(theta) * np.sin(theta)
        return float(2.0 * math.pi * np.sum(f) * (theta[1] - theta[0]))

    found = dataset_of(table(gaussian(10.0), np.array([0.0]), 1.0, u=0.01)).reflectance()
    assert found.value == pytest.approx(albedo(10.0), rel=3e-3)
    assert abs(found.value - albedo(10.0)) < 2.0 * found.u


def test_what_values_share_counts_once_the_rest_averages_out() -> None:
    part = rings(lambertian(0.7), 0.0, np.arange(0.0, 90.0, 3.0), np.arange(0.0, 360.0, 10.0), u=0.01)
    shared = dataset_of(replace(part, u_shared=0.3 * np.asarray(part.u))).reflectance()
    assert 0.0021 < shared.u < 0.0030
    assert any("the rest of u is independent" in each for each in shared.about)
    unknown = dataset_of(replace(part, u=ABSENT)).reflectance()
    assert math.isnan(unknown.u)
    assert any("u is not known" in each for each in unknown.about)


def test_what_was_not_measured_is_in_u_with_a_remark() -> None:
    made = table(lambertian(0.7), np.array([0.0]), 5.0, u=0.001)
    known = np.ones(made.values.shape, dtype=bool)
    known[..., :6] = False
    found = dataset_of(replace(made, known=known)).reflectance()
    share = math.sin(math.radians(27.5)) ** 2  # of the half sphere, to half of the way between two rings
    assert found.u > 0.8 * share * 0.7 / math.sqrt(3.0)
    assert any("% of it is of directions without a measured value" in each for each in found.about)


def test_the_regular_part_of_a_file_is_part_of_it() -> None:
    regular = RegularTable(np.array([0.0, 60.0]), np.array([[[0.1, 0.2]]]), u=np.array([[[0.001, 0.002]]]))
    diffuse = table(lambertian(0.5), np.array([0.0, 30.0, 60.0]), 5.0, u=0.0)
    both = dataset_of(diffuse, regular).reflectance(sigma_deg=30)
    assert both.value == pytest.approx(0.65, rel=2e-3)
    assert any("0.15 of it is the regular part" in each for each in both.about)
    alone = dataset_of(regular)
    assert alone.size == 0
    assert tuple(alone.reflectance(sigma_deg=30)) == (pytest.approx(0.15), pytest.approx(0.0015))
    for arguments, message in (({}, "sigma_deg: is missing"), ({"sigma_deg": 61}, "no regular factor at sigma 61")):
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            alone.reflectance(**arguments)  # type: ignore[arg-type]


def test_what_is_no_half_sphere_is_refused() -> None:
    short = table(lambertian(0.5), np.array([0.0]), 5.0, last_deg=40.0)
    plane = rings(lambertian(0.5), 0.0, POLAR, np.array([0.0, 180.0]))
    for part, message in ((short, "ends at theta 40 deg, and 59 %"), (plane, "do not cover the half sphere")):
        with pytest.raises(goniotwin.GoniotwinError, match=message):
            dataset_of(part).reflectance()
    cut = dataset_of(table(lambertian(0.5), np.array([30.0]), 5.0))
    with pytest.raises(goniotwin.GoniotwinError, match="does not begin at theta 0"):
        cut.where(cut.theta_deg >= 5.0).reflectance()
    with pytest.raises(goniotwin.GoniotwinError, match="is no journal"):
        _ = cut.components


def test_the_covariance_of_a_file_is_an_assumption() -> None:
    part = rings(lambertian(0.5), 0.0, np.array([10.0]), np.array([0.0, 180.0]), u=0.1)
    u = np.asarray(part.u)[0]
    np.testing.assert_allclose(dataset_of(part).covariance(), np.full((2, 2), u**2))
    shared = dataset_of(replace(part, u_shared=0.6 * np.asarray(part.u))).covariance()
    np.testing.assert_allclose(shared, [[u**2, 0.36 * u**2], [0.36 * u**2, u**2]])
    with pytest.raises(goniotwin.GoniotwinError, match="select at most 5000"):
        dataset_of(table(lambertian(0.5), np.array([0.0, 30.0, 60.0]), 0.5)).covariance()


def test_a_table_without_a_phi_axis_has_the_same_value_at_all() -> None:
    theta = np.arange(0.0, 91.0, 2.0)
    made = BsdfTable(np.array([0.0]), np.array([0.0]), theta, np.full((1, 1, 1, 1, theta.size), 0.3 / math.pi))
    assert dataset_of(made).reflectance().value == pytest.approx(0.3, rel=2e-3)
