"""A lobe in the light of an illumination unit with deviations: anew for each combination, and frozen as the paper's rayset."""

import csv
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.simulation.tolerances.beam_on_sample import BeamOnSample
from goniotwin.app.simulation.tolerances.lobe import GaussianLobe
from goniotwin.app.simulation.tolerances.result import StudyResult, compute_study
from goniotwin.app.simulation.tolerances.study import (
    DeviationsTable,
    GaussianTable,
    Parameter,
    StudyFile,
    limits_of,
    parameters_of,
    read_study,
)
from goniotwin.app.simulation.tolerances.unit_light import LobeInLight
from goniotwin.app.toml_file import validate_table
from goniotwin.twin.optics import (
    Deviation,
    Instrument,
    Pose,
    forward_throughput,
    from_specular,
    gaussian,
    luminance_factors,
    record,
    replay,
    throughput,
)
from goniotwin.twin.optics.geometry.instrument import ILLUMINATION_ELEMENTS
from goniotwin.twin.optics.geometry.mirrors import illumination_place
from goniotwin.twin.optics.illumination.unit import unit_of
from tests.conftest import REPOSITORY
from tests.system.command import invoke
from tests.twin.optics.agreement import agree

pytestmark = pytest.mark.xdist_group("unit light")

CRITERION = GaussianTable(kind="gaussian", step_deg=2.0)
INSTRUMENT = Instrument(obstruction=False)
UNIT = {"elements": ["unit"], "angles": ["rx", "rz"], "limit_deg": 0.05}
CUTTING = {"elements": ["slit", "output_condenser"], "shifts": ["x"], "limit_mm": 0.025}
STUDY = {
    "name": "light",
    "paper": 2,
    "criterion": {"kind": "gaussian", "sigma_deg": [30], "step_deg": 2.0},
    "deviations": [{"elements": ["mirror_1", "sample"], "angles": ["ry"], "limit_deg": 0.05}],
    "yields": {"distributions": []},
    "illumination": {"deviations": [UNIT, CUTTING], "draws": 100},
}


def parameters(*tables: dict[str, object]) -> tuple[Parameter, ...]:
    return parameters_of([DeviationsTable.model_validate(each) for each in tables], INSTRUMENT)


MIRRORS = parameters({"elements": ["mirror_1", "mirror_2", "mirror_3"], "angles": ["rx", "ry"], "limit_deg": 0.05})
OWN = parameters(UNIT, CUTTING)


@pytest.fixture(scope="module")
def compared() -> StudyResult:
    return compute_study(validate_table(StudyFile, STUDY, "study"))


def test_each_combination_has_the_light_of_its_own_unit() -> None:
    lobe = LobeInLight(INSTRUMENT, CRITERION, MIRRORS, OWN)
    random = np.random.default_rng(2)
    limits = limits_of((*MIRRORS, *OWN))
    values = limits * random.choice([-1.0, 1.0], (3, limits.size))
    values[1, len(MIRRORS) :] = values[0, len(MIRRORS) :]  # two combinations with the same unit
    found = lobe.residuals(values)
    poses = [Pose(each.sigma_deg, each.axes) for each in lobe.lobe.directions]
    for combination, residuals in zip(values, found, strict=True):
        tilt_x, tilt_z, slit, condenser = combination[len(MIRRORS) :]
        unit = {
            "unit": Deviation(rx_deg=tilt_x, rz_deg=tilt_z),
            "slit": Deviation(x_mm=slit),
            "output_condenser": Deviation(x_mm=condenser),
        }
        rig = replace(lobe.lobe.with_deviations(combination[: len(MIRRORS)]), illumination=unit)
        (factors,) = luminance_factors(rig, poses, gaussian(5.0, peak=1.0 / math.pi))
        expected = (factors - lobe.lobe.theory) / (0.5 * (factors + lobe.lobe.theory))
        np.testing.assert_allclose(residuals, expected, rtol=1e-9, atol=1e-12)


def test_the_flux_of_an_aligned_unit_is_the_lit_part_of_the_hole() -> None:
    lobe = LobeInLight(INSTRUMENT, CRITERION, MIRRORS, OWN)
    rigs = 0.05 * np.random.default_rng(3).choice([-1.0, 1.0], (20, len(MIRRORS)))
    flux = lobe.flux(np.concatenate([rigs, np.zeros((20, len(OWN)))], axis=1))
    share = BeamOnSample(GaussianLobe(INSTRUMENT, CRITERION, MIRRORS), 30.0).lit_share(rigs)
    assert share.min() < 0.85
    # The incidence changes by up to 0.15 deg, and its cosine by 0.0015; the image's edge is not quite sharp.
    np.testing.assert_allclose(flux, share, atol=4e-3)
    even = LobeInLight(replace(INSTRUMENT, lit_everywhere=True), CRITERION, MIRRORS, OWN)
    np.testing.assert_allclose(even.flux(np.concatenate([rigs, np.zeros((20, len(OWN)))], axis=1)), 1.0, atol=4e-3)


def test_frozen_is_the_worst_unit_for_the_flux_and_anew_is_at_least_as_bad(compared: StudyResult) -> None:
    lights = compared.lights
    assert lights is not None
    assert [each.light for each in lights.lights] == ["even", "aligned", "frozen", "anew"]
    even, aligned, frozen, anew = lights.lights
    # 800 mm times 0.05 deg, 14 times 0.025 mm by the slit and 15 times by the condenser: 1.42 mm, of which 1 mm is the margin.
    edge_mm = math.radians(0.05) * 800.0 + 0.025 * 14.0 + 0.025 * 15.0
    assert lights.frozen_flux == pytest.approx(1.0 - (edge_mm - 1.0) / 5.0, abs=2e-3)
    np.testing.assert_allclose(even.flux, 1.0, atol=2e-3)
    assert aligned.flux.min() > anew.flux.min()
    assert np.median(frozen.flux) < np.median(anew.flux) < np.median(aligned.flux)
    assert anew.worst.percent >= frozen.worst.percent
    assert min(each.worst.percent - each.combinations.worst_percent for each in lights.lights) >= -1e-9
    # The same combinations in the same order: without the slit's image those of the study itself.
    assert even.worst.percent == pytest.approx(compared.case.worst.percent, rel=1e-12)
    assert lights.difference is not None
    assert lights.difference.median_flux == pytest.approx(np.median(frozen.flux) - np.median(anew.flux))
    assert lights.difference.shares[0][0] == pytest.approx(
        frozen.combinations.shares[0][0] - anew.combinations.shares[0][0], abs=1e-12
    )


def test_the_command_shows_both_lights_and_their_difference(
    compared: StudyResult, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("goniotwin.app.cli.work.tolerances.compute_study", lambda _study, _report: compared)
    monkeypatch.setenv("COLUMNS", "120")
    study = REPOSITORY / "examples" / "tolerances" / "quick.toml"
    text = invoke("tolerances", study, "--out", tmp_path).stdout
    for part in ("frozen - anew", "evenly lit hole", "aligned unit", "Frozen minus anew:", "illumination unit: 100 random"):
        assert part in " ".join(text.split())
    lines = (tmp_path / "quick-illumination.csv").read_text(encoding="utf-8").splitlines()
    rows = list(csv.DictReader(line for line in lines if not line.startswith("#")))
    assert [row["light"] for row in rows] == ["even", "aligned", "frozen", "anew", "frozen minus anew"]
    assert float(rows[3]["least_flux"]) == pytest.approx(float(rows[2]["least_flux"]) - float(rows[4]["least_flux"]), abs=1e-4)
    assert (tmp_path / "quick-limitations.csv").exists()
    done = json.loads(invoke("tolerances", study, "--json").stdout)["illumination"]
    assert [each["light"] for each in done["lights"]] == ["even", "aligned", "frozen", "anew"]
    assert done["frozen_minus_anew"]["shares"][0][1] >= 0.0


def test_a_study_may_have_one_light_alone(compared: StudyResult) -> None:
    study = compared.study
    assert study.illumination is not None
    one = study.illumination.model_copy(update={"light": ["frozen"]})
    lights = compute_study(study.model_copy(update={"illumination": one})).lights
    assert lights is not None
    assert [each.light for each in lights.lights] == ["even", "aligned", "frozen"]
    assert lights.difference is None


@pytest.mark.long
def test_frozen_is_a_rayset_recorded_at_the_worst_corner_of_table_1() -> None:
    """The lobe at the worst corner of Table 2 by 4 million paths of 2 million recorded rays, and by the fast estimator."""
    table2 = read_study(REPOSITORY / "examples" / "tolerances" / "table2.toml")
    assert table2.illumination is not None
    lobe = GaussianLobe(Instrument(obstruction=False), CRITERION, parameters_of(table2.deviations, INSTRUMENT))
    lights = compute_study(
        table2.model_copy(
            update={"illumination": table2.illumination.model_copy(update={"light": ["frozen"], "draws": 100}), "variants": []}
        )
    ).lights
    assert lights is not None
    unit_rows = {name: np.zeros(6) for name in ILLUMINATION_ELEMENTS}
    names = ("rx", "ry", "rz", "x", "y", "z")
    for each, level in zip(lights.parameters, lights.frozen.levels, strict=True):
        unit_rows[each.element][names.index(each.name)] = level * each.limit
    count = len(lobe.parameters)
    worst = lights.lights[-1].worst.levels[:count] * limits_of(lobe.parameters)
    rig = replace(
        lobe.with_deviations(worst),
        illumination={name: Deviation(*row.tolist()) for name, row in unit_rows.items()},
        detector_diameter_mm=15.0,
        field_deg=2.0,
    )
    directions = from_specular(30.0, np.repeat([0.0, 3.0, 6.0, 9.0], 12), np.tile(np.arange(0.0, 360.0, 30.0), 4))[11:]
    unit, (rotation, origin) = unit_of(rig), illumination_place(rig)
    x, y, z = (float(each) for each in origin)
    source = replay(record(unit, 2_000_000, seed=5), unit, (x, y, z), rotation)
    sample = gaussian(5.0, peak=1.0 / math.pi)
    paths = forward_throughput(rig, 30.0, directions, sample, 4_000_000, seed=6, source=source)
    flux, error = paths.single_m2sr * paths.radiance, paths.single_error * paths.radiance
    expected = throughput(rig, 30.0, directions, sample)
    agree(flux / flux.sum(), error / flux.sum(), expected / expected.sum(), 0.0)
