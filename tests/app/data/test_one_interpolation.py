"""`Dataset.at` depends on the points alone, and not on the format that has carried them; it is held against closed forms."""

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import goniotwin
from goniotwin.app.data.conversion import Choice, convert_content
from goniotwin.app.data.interpolation import direction_grid
from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.formats import registry, writing
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Floats
from tests.app.data.made import gaussian, lambertian, rings, table

DIRECTIONS = 200
EQUAL = 1e-6
RESAMPLED = re.compile(r"([0-9.]+) % at most")
"""What a format with a grid of its own states of its deviation from the table, and of the table's between its nodes."""
SIGMAS = np.array([0.0, 40.0])


def turned(part: ScatteredBsdf, *, psi_deg: float, scale: float) -> ScatteredBsdf:
    """Values of the sample turned in its plane, so many times as large."""
    return replace(
        part,
        psi_deg=part.psi_deg + psi_deg,
        azimuth_deg=np.mod(part.azimuth_deg + psi_deg, 360.0),
        values=scale * part.values,
        u=scale * part.u,
        isotropic=False,
    )


def joined(*parts: ScatteredBsdf) -> ScatteredBsdf:
    names = ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg", "values", "u", "wavelength_nm", "back", "transmitted")
    columns: dict[str, Any] = {name: np.concatenate([getattr(each, name) for each in parts]) for name in names}
    return ScatteredBsdf(**columns, isotropic=all(each.isotropic for each in parts))


def one_sided(theta: Floats, phi: Floats) -> Floats:
    """A lobe whose two halves are not alike."""
    return np.asarray(np.exp(-((theta / 8.0) ** 2)) * (1.0 + 0.4 * np.sin(np.radians(phi)) * np.sin(np.radians(theta))) + 0.01)


def whole_turn() -> BsdfTable:
    made = table(lambertian(1.0), SIGMAS, 2.5)
    phi = np.arange(0.0, 360.1, 360.0 / 14.0)
    at, around = np.meshgrid(made.theta_deg, phi)
    return BsdfTable(SIGMAS, phi, made.theta_deg, np.tile(one_sided(at, around), (1, 1, SIGMAS.size, 1, 1)))


def anisotropic_table() -> BsdfTable:
    made = whole_turn()
    psi = np.arange(0.0, 361.0, 90.0)
    scale = 2.0 + np.cos(np.radians(psi))
    return replace(made, psi_deg=psi, values=made.values * scale[None, :, None, None, None])


def anisotropic_half() -> BsdfTable:
    """A table to phi 180: the other half is its mirror image."""
    made = table(gaussian(8.0), SIGMAS, 2.5)
    scale = np.array([1.0, 0.5, 2.0, 0.7]).reshape(1, 4, 1, 1, 1)
    return replace(made, psi_deg=np.array([0.0, 90.0, 180.0, 270.0]), values=scale * made.values)


def spectral_table() -> BsdfTable:
    made = table(gaussian(8.0), SIGMAS, 2.0, u=0.01)
    scale = np.array([1.0, 0.7, 0.3]).reshape(3, 1, 1, 1, 1)
    assert made.u is not None
    return replace(made, wavelengths_nm=(450.0, 550.0, 650.0), values=scale * made.values, u=scale * made.u)


def free_directions() -> ScatteredBsdf:
    return joined(
        *(rings(gaussian(12.0), sigma, np.arange(0.0, 86.0, 2.5), np.arange(0.0, 181.0, 7.5), u=0.01) for sigma in SIGMAS)
    )


def anisotropic_points() -> ScatteredBsdf:
    each = rings(one_sided, 20.0, np.arange(0.0, 86.0, 2.5), np.arange(0.0, 360.0, 10.0), u=0.01, isotropic=False)
    return joined(*(turned(each, psi_deg=psi, scale=1.0 + psi / 90.0) for psi in (0.0, 33.3, 90.0)))


def both_sides() -> ScatteredBsdf:
    each = free_directions()
    return joined(each, replace(each, back=np.ones(each.size, dtype=bool), values=0.5 * each.values))


def spectral_points() -> ScatteredBsdf:
    each = free_directions()
    return joined(
        *(replace(each, wavelength_nm=np.full(each.size, nm), values=each.values * nm / 500.0) for nm in (450.0, 612.5))
    )


def in_plane() -> ScatteredBsdf:
    return rings(gaussian(5.0), 30.0, np.arange(0.0, 86.0, 1.0), np.array([0.0, 180.0]), u=0.01)


CONTENTS: dict[str, Callable[[], BsdfTable | ScatteredBsdf]] = {
    "grid": lambda: table(gaussian(5.0), SIGMAS, 2.0, u=0.01),
    "wide lobe": lambda: table(gaussian(30.0), SIGMAS, 5.0, u=0.01),
    "transmitted grid": lambda: replace(table(gaussian(5.0), SIGMAS, 2.0, u=0.01), transmitted=True),
    "grid of the whole turn": whole_turn,
    "anisotropic grid": anisotropic_table,
    "anisotropic half": anisotropic_half,
    "spectral grid": spectral_table,
    "free directions": free_directions,
    "anisotropic points": anisotropic_points,
    "both sides": both_sides,
    "spectral points": spectral_points,
    "plane of incidence": in_plane,
}


def holds(form: Format, content: BsdfFile) -> bool:
    """Whether a format can hold a content as it is: a grid is also its nodes."""
    needs = writing.content_needs(content)
    if Holds.POINTS in form.holds and Holds.GRID in needs:
        needs = (needs - {Holds.GRID}) | {Holds.POINTS}
    return form.writes and form.holds.issuperset(needs)


def is_short(name: str, form: Format) -> bool:
    """Whether the short run has it: a grid in all formats, and all contents in two."""
    return name == "grid" or form.name in ("csv", "archive")


def carried() -> list[Any]:
    return [
        pytest.param(name, form.name, marks=[pytest.mark.long] if form.resamples or not is_short(name, form) else [])
        for name, made in CONTENTS.items()
        for form in registry.BUILT_IN
        if holds(form, BsdfFile((made(),))) and (name == "wide lobe" or not form.resamples)
    ]


def directions(d: goniotwin.Dataset, lobe: tuple[Floats, Floats]) -> tuple[Floats, Floats]:
    """Directions on nodes and between them, about the lobe and elsewhere."""
    rng = np.random.default_rng(5)
    n = DIRECTIONS // 2
    here = rng.choice(np.flatnonzero(d.good), n)
    between = np.concatenate([rng.uniform(0.0, 12.0, n // 2), rng.uniform(12.0, 60.0, n - n // 2)])
    around = rng.choice(np.unique(lobe[1]), n) if np.unique(lobe[1]).size < 3 else rng.uniform(0.0, 360.0, n)
    return np.concatenate([d.theta_deg[here], between]), np.concatenate([d.phi_deg[here], around])


@pytest.mark.parametrize(("name", "form_name"), carried())
def test_a_format_that_carries_the_points_carries_the_values_between_them(name: str, form_name: str, tmp_path: Path) -> None:
    part = CONTENTS[name]()
    content = BsdfFile((part,))
    form = next(each for each in registry.BUILT_IN if each.name == form_name)
    path = tmp_path / f"made{form.suffixes[0]}"
    notes = convert_content(content, path, form, Choice()).notes
    one, other = dataset_of_file(content, "made"), goniotwin.open(path)
    for light in one.only.lights:
        asked = {
            "sigma_deg": light.sigma_deg,
            "psi_deg": light.psi_deg if name.startswith("anisotropic") else None,
            "wavelength_nm": None if math.isnan(light.wavelength_nm) else light.wavelength_nm,
            "back": light.back,
            "transmitted": light.transmitted,
        }
        here = one.where(light.index)
        theta, phi = directions(here, (here.theta_deg, here.phi_deg))
        expected = one.at(theta_deg=theta, phi_deg=phi, **asked)  # type: ignore[arg-type]
        found = other.at(theta_deg=theta, phi_deg=phi, **asked)  # type: ignore[arg-type]
        known = np.isfinite(expected.value)
        assert known.sum() > DIRECTIONS // 2
        if form.resamples:
            stated = sum(float(each) for note in notes for each in RESAMPLED.findall(note)) / 100.0
            known &= np.isfinite(found.value) & (expected.value > 0.01 * here.bsdf.max())
            assert stated < 0.1
            np.testing.assert_allclose(found.value[known], expected.value[known], rtol=stated)
            continue
        np.testing.assert_array_equal(np.isfinite(found.value), known)
        np.testing.assert_allclose(found.value[known], expected.value[known], rtol=EQUAL)
        on_nodes = np.flatnonzero(known[: DIRECTIONS // 2])
        nodes = np.random.default_rng(5).choice(np.flatnonzero(here.good), DIRECTIONS // 2)
        np.testing.assert_allclose(expected.value[on_nodes], here.bsdf[nodes[on_nodes]], rtol=1e-9)
        if np.isfinite(other.u).any():
            np.testing.assert_allclose(found.u[known], expected.u[known], rtol=1e-5, atol=1e-9)
        if name == "plane of incidence":
            with pytest.raises(goniotwin.GoniotwinError, match="do not cover the half sphere"):
                other.reflectance(**asked)  # type: ignore[arg-type]
            continue
        of_one, of_other = (each.reflectance(**asked) for each in (one, other))  # type: ignore[arg-type]
        assert of_other.value == pytest.approx(of_one.value, rel=EQUAL)


@pytest.mark.parametrize("sigma_deg", [0.0, 30.0, 60.0])
@pytest.mark.parametrize("width_deg", [5.0, 15.0, None])
@pytest.mark.parametrize("frame", ["rings", "specular"])
def test_the_interpolation_is_that_of_a_closed_form_within_its_own_u(
    frame: str, width_deg: float | None, sigma_deg: float
) -> None:
    """The Gaussian lobe of the paper's formula 6, and the ideal diffuser: values without an error of their own."""
    bsdf = lambertian(0.8) if width_deg is None else gaussian(width_deg)
    part = (
        rings(bsdf, sigma_deg, np.arange(0.0, 90.1, 1.0), np.arange(0.0, 360.0, 2.5), u=1e-9)
        if frame == "rings"
        else table(bsdf, np.array([sigma_deg]), u=1e-9)
    )
    d = dataset_of_file(BsdfFile((part,)), "made")
    made = direction_grid(d.only, d.only.lights[0])
    assert made is not None
    assert sigma_deg == 0.0 or made.frame == frame
    rng = np.random.default_rng(3)
    theta = rng.uniform(0.0, 3.0 * (width_deg or 20.0), 2000)
    phi = rng.uniform(0.0, 360.0, theta.size)
    value, u = d.at(theta_deg=theta, phi_deg=phi)
    known = np.isfinite(value)
    assert known.mean() > 0.7
    error = np.abs(value - bsdf(theta, phi))[known]
    assert error.max() < (1e-12 if width_deg is None else 0.02)
    assert np.mean(error <= 2.0 * u[known] + 1e-12) > 0.95
    assert np.mean(error <= 3.0 * u[known] + 1e-12) > 0.99


def test_a_mirror_image_counts_where_one_half_was_measured() -> None:
    polar = np.arange(0.0, 86.0, 5.0)
    half = rings(gaussian(20.0), 30.0, polar, np.arange(0.0, 181.0, 10.0))
    checks = rings(lambertian(0.1), 30.0, np.array([40.0]), np.array([200.0, 270.0]))
    whole = rings(one_sided, 30.0, polar, np.arange(0.0, 360.0, 10.0))
    for parts, mirrored in (((half,), True), ((half, checks), True), ((whole,), False)):
        d = dataset_of_file(BsdfFile(parts), "made")
        at = [d.at(polar_deg=33.0, azimuth_deg=azimuth).value for azimuth in (150.0, 210.0)]
        assert (at[0] == pytest.approx(at[1], rel=1e-9)) == mirrored
    # A direction of either half keeps its own value.
    k = int(np.flatnonzero((d.polar_deg == 40.0) & (d.azimuth_deg == 210.0))[0])
    assert d.at(polar_deg=40.0, azimuth_deg=210.0).value == pytest.approx(d.bsdf[k], rel=1e-12)


def test_directions_at_random_are_on_no_grid_however_many_they_are() -> None:
    rng = np.random.default_rng(1)
    n = 400_000
    polar, azimuth = np.degrees(np.arccos(rng.uniform(0.2, 1.0, n))), rng.uniform(0.0, 360.0, n)
    part = ScatteredBsdf(np.full(n, 30.0), np.zeros(n), polar, azimuth, np.ones(n))
    d = dataset_of_file(BsdfFile((part,)), "made")
    assert direction_grid(d.only, d.only.lights[0]) is None
