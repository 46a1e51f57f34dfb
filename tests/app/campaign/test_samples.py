"""Samples of every kind that a rig file can name, measured and reduced like a user's: the values are theirs, within u."""

import math
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.components import COVERAGE
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.budget import finished_blocks
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import BsdfDataset, reduce_journal
from goniotwin.app.campaign.studies.reflectance import components_of_sum, integration_settings, quadrature
from goniotwin.app.campaign.studies.theory import deviations_in_u, theoretical_bsdf, true_bsdf
from goniotwin.app.formats import BsdfTable
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.ddr import write as write_ddr
from goniotwin.app.rig import read_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics import anisotropic_gaussian, evaluate, from_specular, light_direction
from goniotwin.twin.plant import TwinModel
from tests.conftest import RIG, SMALL, Change, Writer, changed

pytestmark = pytest.mark.xdist_group("samples")

HEAD = "[twin.samples.etalon]"
SAMPLES = """[twin.samples.brushed]
model = "anisotropic-gaussian"
along_deg = 12.0
across_deg = 25.0
direction_deg = 30.0

[twin.samples.rough]
model = "ward"
alpha_x = 0.15
alpha_y = 0.3
direction_deg = 20.0

[twin.samples.tails]
model = "wide-tailed"
width_deg = 8.0
wavelengths_nm = [400, 500, 600, 700]
factors = [0.1, 0.2, 0.8, 0.9]

[twin.samples.turned]
model = "table"
file = "turned.ddr"
symmetry = "orthotropic"

[twin.samples.etalon]"""
POSES = (
    ('samples = ["gaussian-5"]', 'symmetry = "anisotropic"\nsamples = ["brushed", "rough", "tails", "turned"]'),
    ("sigma_deg = [30]", "sigma_deg = [30]\ngamma_deg = [0, 40]"),
    ("[550]", "[500, 600]"),
    ("[0, 1]", "[0]"),
    ("beta_deg = [180]", "beta_deg = [172, 180, 188]"),  # the slopes across a lobe that need not be round
    ("[1e8, 1e10]", "[1e6, 1e8, 1e10]"),
    ("dark_readings = 4", "dark_readings = 16"),
)
BROAD = anisotropic_gaussian(12.0, 25.0, reflectance=0.5)


def measure(rig: Path, schedule: Path, journal: Path) -> BsdfDataset:
    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), journal)
    with Journal.open(journal) as opened:
        return reduce_journal(opened)


def write_turned(path: Path) -> None:
    """A lobe of two widths as a table of four dimensions, of a quarter turn: the rest of it is its mirror image."""
    psi, sigma, phi = np.arange(0.0, 91.0, 15.0), np.arange(0.0, 91.0, 10.0), np.arange(0.0, 361.0, 15.0)
    theta = np.array([*np.arange(0.0, 60.0, 2.5), *np.arange(60.0, 181.0, 10.0)])
    values = np.empty((1, psi.size, sigma.size, phi.size, theta.size))
    for k, incidence in enumerate(sigma.tolist()):
        seen = from_specular(incidence, theta, phi[:, None])
        seen *= np.where(seen[..., 2:] > 0.0, 1.0, [1.0, 1.0, -1.0])
        for n, azimuth in enumerate(psi.tolist()):  # a sample turned by gamma sees the light at -gamma
            values[0, n, k] = evaluate(BROAD, light_direction(incidence), seen, gamma_deg=-azimuth)
    write_ddr(path, BsdfFile((BsdfTable(sigma, phi, theta, values, None, psi, generated=True),)))


def usable(points: BsdfPoints) -> BsdfPoints:
    return points.where(points.good & ~points.flag("field") & ~points.flag("steep"))


@pytest.fixture(scope="module")
def kinds(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, TwinModel]:
    """The journal of a campaign of all kinds, and the model of its rig."""
    folder = tmp_path_factory.mktemp("kinds")
    write_turned(folder / "turned.ddr")
    rig, schedule = folder / "rig.toml", folder / "schedule.toml"
    rig.write_text(changed(RIG.read_text(encoding="utf-8"), ((HEAD, SAMPLES),)), encoding="utf-8")
    schedule.write_text(changed(SMALL, POSES), encoding="utf-8")
    model = read_rig(rig).model()
    assert model is not None
    run_campaign(make_plan(read_schedule(schedule), read_rig(rig)), folder / "kinds.journal")
    return folder / "kinds.journal", model


def test_every_kind_of_sample_is_measured_within_its_uncertainty(kinds: tuple[Path, TwinModel]) -> None:
    path, model = kinds
    with Journal.open(path) as journal:
        reduced = reduce_journal(journal)
    assert set(reduced.samples) == {"brushed", "rough", "tails", "turned"}
    every = []
    for name, measured in reduced.samples.items():
        points = usable(measured)
        z = deviations_in_u(points, true_bsdf(model.samples[name], points))
        assert np.count_nonzero(points.u_bsdf < 0.05 * points.bsdf) >= 20, name
        assert np.abs(z).max() < 5.0, name
        every.append(z)
        if name != "tails":
            at = [measured.where((measured.gamma_deg == gamma) & (measured.wavelength_nm == 500.0)) for gamma in (0.0, 40.0)]
            one, other = at
            both = one.good & other.good & (one.zenith_deg == other.zenith_deg)
            apart = np.abs(one.bsdf - other.bsdf)[both] / np.hypot(one.u_bsdf, other.u_bsdf)[both]
            assert apart.max() > 3.0, name
    inside = np.abs(np.concatenate(every)) <= COVERAGE
    assert inside.mean() > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / inside.size)


def test_components_of_values_and_of_integrals_square_and_sum_to_u_squared(kinds: tuple[Path, TwinModel]) -> None:
    """Of all values of several samples by the named inputs, and of their integrals by the covariance of all values."""
    with Journal.open(kinds[0]) as journal:
        reduction = evaluate_journal(journal).reduction
        for name in reduction.schedule.samples:
            points = BsdfPoints.join(list(finished_blocks(reduction, name)))
            good = points.where(points.good)
            effects = effects_of(good, reduction.settings)
            total = np.sum(list(effects.variances().values()), axis=0)
            assert np.abs(total / good.u_bsdf**2 - 1.0).max() < 1e-12, name
            for k in (0, good.size // 2, int(np.argmax(good.bsdf))):
                squares = math.fsum(each.u**2 for each in effects.budget(k))
                assert squares == pytest.approx(float(good.u_bsdf[k]) ** 2, rel=1e-12), name
            for setting in list(integration_settings(points))[:1]:
                here = points.where(setting.index)
                weight = quadrature(here, "anisotropic").weight
                used = np.flatnonzero(weight != 0.0)
                matrix = effects_of(here.where(used), reduction.settings).covariance(np.arange(used.size), np.arange(used.size))
                of_values = math.fsum(each.u**2 for each in components_of_sum(here, weight, reduction.settings))
                assert of_values == pytest.approx(float(weight[used] @ matrix @ weight[used]), rel=1e-12), name


# ---- the band of the light ----

BAND_NM, CURVE_NM = 20.0, 60.0
NODES_NM = np.arange(440.0, 661.0, 2.0)


def band_changes(band: str) -> tuple[Change, ...]:
    curve = 0.9 * np.exp(-0.5 * ((NODES_NM - 550.0) / CURVE_NM) ** 2)
    lists = f"wavelengths_nm = {NODES_NM.tolist()}\nfactors = {curve.tolist()}"
    return (
        (HEAD, f'[twin.samples.green]\nmodel = "lambertian"\nreflectance = 0.9\n{lists}\n\n{HEAD}'),
        ("[twin.light]", f'[twin.light]\nband = "{band}"\nband_nm = {BAND_NM}'),
        ("[etalon] ", f"[light]\nbandwidth_nm = {BAND_NM}\n\n[etalon] "),
        ("noise = true", "noise = false"),
    )


def test_a_triangular_band_is_corrected_end_to_end(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    wavelengths = [510.0, 530.0, 550.0, 570.0, 590.0]
    changes = (('"gaussian-5"', '"green"'), ("[550]", str(wavelengths)), ("[1e8, 1e10]", "[1e10, 1e11]"), ("[0, 1]", "[0]"))
    schedule = write_schedule(*changes)

    def errors(band: str) -> tuple[BsdfPoints, Floats]:
        reduced = measure(write_rig(*band_changes(band)), schedule, tmp_path / f"{band}.journal")
        points = usable(reduced.samples["green"])
        return points, points.bsdf / theoretical_bsdf(reduced.rig, "green", points) - 1.0

    points, error = errors("triangle")
    assert np.unique(points.wavelength_nm).tolist() == wavelengths
    peak = points.wavelength_nm == 550.0
    # From the peak of a Gaussian curve the band takes s^2 / (2 curve^2), s^2 = band^2 / 6.
    taken = BAND_NM**2 / 6.0 / (2.0 * CURVE_NM**2)
    uncorrected = error - points.band_correction
    assert uncorrected[peak] == pytest.approx(np.full(peak.sum(), -taken), rel=0.15)
    inner = (points.wavelength_nm > 520.0) & (points.wavelength_nm < 580.0)
    assert np.abs(error[peak]).max() < 0.3 * taken
    assert np.all(np.abs(error[inner]) < 2.0 * (points.u_bsdf / points.bsdf)[inner])
    assert points.budget["bandwidth"][peak] / points.bsdf[peak] == pytest.approx(0.5 * taken, rel=0.35)
