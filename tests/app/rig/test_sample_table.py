"""Samples of a rig file: models, sums of them, measured tables; and the model hash, which covers them."""

import math
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.ddr import write as write_ddr
from goniotwin.app.formats.zemax import ZemaxBsdf, write_zemax
from goniotwin.app.rig import read_rig
from goniotwin.twin.optics import Scatterer, albedo, evaluate, from_specular, light_direction
from goniotwin.twin.plant import TwinModel
from tests.conftest import Writer

GAUSSIAN = """[twin.samples.gaussian-5]
model = "gaussian"
width_deg = 5.0
form = "one_over_e"
quantity = "luminance"
reflectance = 0.9
"""


def model(write_rig: Writer, sample: str) -> TwinModel:
    twin_model = read_rig(write_rig((GAUSSIAN, f"[twin.samples.it]\n{sample}\n"))).model()
    assert twin_model is not None
    return twin_model


def sample_of(write_rig: Writer, text: str) -> Scatterer:
    return model(write_rig, text).samples["it"]


def albedos(sample: Scatterer) -> list[float]:
    """Reflected and transmitted, of light from the front and from the back."""
    return [round(albedo(sample, sigma, through), 6) for sigma in (0.0, 180.0) for through in (False, True)]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ('model = "lambertian"\nreflectance = 0.3\ntransmittance = 0.6\nside = "both"', [0.3, 0.6, 0.3, 0.6]),
        ('model = "lambertian"\nreflectance = 0.3\ntransmittance = 0.6', [0.3, 0.6, 0.0, 0.6]),
        ('model = "gaussian"\nwidth_deg = 5.0\ntransmits = true\nreflectance = 0.5', [0.0, 0.5, 0.0, 0.5]),
        ('model = "gaussian"\nwidth_deg = 5.0\ntransmits = true\nreflectance = 0.5\nside = "front"', [0.0, 0.5, 0.0, 0.0]),
        ('model = "gaussian"\nwidth_deg = 5.0\ntransmits = true\nrefraction = 1.5', [0.0, 0.9, 0.0, 0.0]),
        ('model = "gaussian"\nwidth_deg = 5.0\ntransmits = true\nrefraction = 1.5\nside = "back"', [0.0, 0.0, 0.0, 0.9]),
        ('model = "anisotropic-gaussian"\nalong_deg = 4.0\nacross_deg = 12.0\nreflectance = 0.5', [0.5, 0.0, 0.0, 0.0]),
        ('model = "wide-tailed"\nwidth_deg = 2.0\ntransmits = true\nside = "both"', [0.0, 0.9, 0.0, 0.9]),
        ('model = "ward"\nalpha_x = 0.002\nalpha_y = 0.003\nreflectance = 0.7\nside = "back"', [0.0, 0.0, 0.7, 0.0]),
        ('model = "regular"\nreflectance = 0.4', [0.4, 0.0, 0.0, 0.0]),
        ('model = "regular"\nreflectance = [0.04, 1.0]\nsigma_deg = [0.0, 90.0]\nside = "both"', [0.04, 0.0, 0.04, 0.0]),
    ],
)
def test_a_sample_acts_on_the_sides_given_in_its_file(write_rig: Writer, text: str, expected: list[float]) -> None:
    assert albedos(sample_of(write_rig, text)) == pytest.approx(expected, abs=1e-5)


def test_a_sample_may_be_a_sum_of_models(write_rig: Writer) -> None:
    text = """model = "sum"
    lobes = [
        {model = "lambertian", reflectance = 0.3},
        {model = "gaussian", width_deg = 8.0, reflectance = 0.2},
        {model = "regular", reflectance = 0.1, transmits = true},
    ]"""
    sample = sample_of(write_rig, text)
    assert albedos(sample) == pytest.approx([0.5, 0.1, 0.0, 0.1], abs=1e-5)


def test_a_formula_may_have_a_spectrum(write_rig: Writer) -> None:
    text = 'model = "lambertian"\nreflectance = 0.8\nwavelengths_nm = [450.0, 650.0]\nfactors = [0.1, 0.9]'
    sample = sample_of(write_rig, text)
    assert [albedo(sample, 0.0, wavelength_nm=nm) for nm in (400.0, 550.0, 700.0)] == pytest.approx([0.08, 0.4, 0.72])


def ddr(path: Path, psi_deg: list[float], wavelengths_nm: tuple[float, ...] | None = None) -> None:
    """A table whose value is psi / 1000, times the number of the wavelength."""
    psi, count = np.array(psi_deg), 1 if wavelengths_nm is None else len(wavelengths_nm)
    values = 1e-3 * psi[:, None, None, None] * np.arange(1.0, count + 1.0)[:, None, None, None, None]
    sigma, phi, theta = np.array([0.0, 80.0]), np.array([0.0, 360.0]), np.array([0.0, 170.0])
    write_ddr(path, BsdfFile((BsdfTable(sigma, phi, theta, values * np.ones((1, 1, 2, 2, 2)), wavelengths_nm, psi),)))


@pytest.mark.parametrize(
    ("symmetry", "psi_deg", "expected"),
    [
        ("none", [0.0, 90.0, 180.0, 270.0, 300.0], [0.0, 45.0, 180.0, 150.0]),
        ("half_turn", [0.0, 60.0, 120.0], [0.0, 45.0, 0.0, 60.0]),
        ("mirror", [0.0, 90.0, 180.0], [0.0, 45.0, 180.0, 30.0]),
        ("orthotropic", [0.0, 45.0, 90.0], [0.0, 45.0, 0.0, 30.0]),
    ],
)
def test_a_table_of_four_dimensions_is_an_anisotropic_sample(
    write_rig: Writer, tmp_path: Path, symmetry: str, psi_deg: list[float], expected: list[float]
) -> None:
    """Its psi is the azimuth of the light in the sample's frame: a sample turned by gamma sees the light at -gamma."""
    ddr(tmp_path / "brushed.ddr", psi_deg)
    sample = sample_of(write_rig, f'model = "table"\nfile = "brushed.ddr"\nsymmetry = "{symmetry}"')
    light, observer = light_direction(40.0), from_specular(40.0, 10.0, 77.0)
    found = [float(evaluate(sample, light, observer, gamma_deg=-psi)) for psi in (0.0, 45.0, 180.0, 330.0)]
    assert found == pytest.approx([1e-3 * each for each in expected], abs=1e-9)


def test_a_table_of_four_dimensions_may_have_a_spectrum(write_rig: Writer, tmp_path: Path) -> None:
    ddr(tmp_path / "brushed.ddr", [0.0, 100.0, 200.0], (450.0, 650.0))
    sample = sample_of(write_rig, 'model = "table"\nfile = "brushed.ddr"')
    light = light_direction(40.0)
    found = [float(evaluate(sample, light, from_specular(40.0, 10.0, 77.0), nm, -50.0)) for nm in (450.0, 550.0, 650.0)]
    assert found == pytest.approx([0.05, 0.075, 0.1])


def zemax(folder: Path, scatter_type: str) -> None:
    angles = np.array([0.0, 90.0])
    write_zemax(
        folder / "measured.bsdf",
        ZemaxBsdf(
            "Measured",
            "PlaneSymmetrical",
            scatter_type,
            np.array([0.0]),
            np.array([0.0, 60.0]),
            np.array([0.0, 180.0]),
            angles,
            np.full((1, 1, 2, 2, 2), 0.2),
            np.zeros((1, 1, 2)),
        ),
    )


@pytest.mark.parametrize(("scatter_type", "expected"), [("BRDF", [0.2, 0.0]), ("BTDF", [0.0, 0.2])])
def test_a_measured_table_reflects_or_transmits_by_its_scatter_type(
    write_rig: Writer, tmp_path: Path, scatter_type: str, expected: list[float]
) -> None:
    zemax(tmp_path, scatter_type)
    sample = sample_of(write_rig, 'model = "zemax"\nfile = "measured.bsdf"')
    light = light_direction(30.0)
    assert [float(evaluate(sample, light, d)) for d in (light, -light)] == pytest.approx(expected)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('model = "lambertian"\nreflectance = 1.2', "twin.samples.it: reflectance is 1.2"),
        ('model = "lambertian"\nreflectance = 0.7\ntransmittance = 0.6', "add up to more than 1"),
        ('model = "wide-tailed"\nwidth_deg = 5.0\npeak = 1.0\nreflectance = 0.5', "peak and reflectance are both given"),
        ('model = "ward"\nalpha_x = 0.1\nalpha_y = 0.0', "twin.samples.it: alpha_y is 0.0"),
        ('model = "anisotropic-gaussian"\nalong_deg = 5.0\nacross_deg = nan', "across_deg"),
        ('model = "lambertian"\nfactors = [0.5]', "wavelengths_nm is missing"),
        ('model = "lambertian"\nwavelengths_nm = [500.0, 600.0]\nfactors = [0.5, 1.5]', "factors has 1.5"),
        ('model = "lambertian"\nwavelengths_nm = [500.0, 600.0]\nfactors = [0.5]', "factors has the shape"),
        ('model = "gaussian"\nwidth_deg = -2.0', "twin.samples.it: width_deg is -2.0"),
        ('model = "gaussian"\nwidth_deg = 2.0\nrefraction = 1.5', "only a transmitted lobe is refracted"),
        ('model = "regular"\nreflectance = [0.1, 0.2]', "or sigma_deg for a list"),
        ('model = "sum"\nlobes = []', "twin.samples.it.lobes"),
        ('model = "sum"\nlobes = [{model = "gaussian", width_deg = 0.0}]', r"twin.samples.it.lobes.0: width_deg is 0.0"),
        ('model = "sum"\nlobes = [{model = "zemax", file = "no.bsdf"}]', r"twin.samples.it.lobes.0: .*no.bsdf"),
        ('model = "mirror"', "twin.samples.it"),
    ],
)
def test_an_impossible_sample_is_refused_with_its_key(write_rig: Writer, text: str, message: str) -> None:
    with pytest.raises(UserError, match=message):
        model(write_rig, text)


def test_the_model_hash_covers_every_property_of_a_sample(write_rig: Writer) -> None:
    def model_hash(text: str) -> str:
        digest = read_rig(write_rig((GAUSSIAN, f"[twin.samples.it]\n{text}\n"))).model_hash()
        assert digest is not None
        return digest

    lobes = '{model = "lambertian", reflectance = 0.3}', '{model = "gaussian", width_deg = 8.0, reflectance = 0.2}'
    texts = [
        'model = "gaussian"\nwidth_deg = 8.0',
        'model = "gaussian"\nwidth_deg = 8.0\ntransmits = true',
        'model = "gaussian"\nwidth_deg = 8.0\ntransmits = true\nrefraction = 1.5',
        'model = "gaussian"\nwidth_deg = 8.0\nside = "back"',
        'model = "gaussian"\nwidth_deg = 8.0\nside = "both"',
        f'model = "sum"\nlobes = [{lobes[0]}]',
        f'model = "sum"\nlobes = [{lobes[0]}, {lobes[1]}]',
        f'model = "sum"\nlobes = [{lobes[1]}, {lobes[0]}]',
        'model = "regular"\nreflectance = [0.1, 0.5]\nsigma_deg = [0.0, 80.0]',
        'model = "regular"\nreflectance = [0.1, 0.5]\nsigma_deg = [0.0, 81.0]',
        'model = "regular"\nreflectance = [0.1, 0.6]\nsigma_deg = [0.0, 80.0]',
    ]
    assert len({model_hash(text) for text in texts}) == len(texts)
    assert model_hash(texts[6]) == model_hash(texts[6])


def test_the_default_diffuser_is_the_ideal_one(write_rig: Writer) -> None:
    sample = sample_of(write_rig, 'model = "lambertian"')
    assert evaluate(sample, light_direction(20.0), light_direction(-60.0)) == pytest.approx(1.0 / math.pi)
