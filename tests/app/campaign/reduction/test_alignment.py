"""The alignment: what it finds of misaligned rigs against the twin's back door, its file, and the values that it corrects."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.reduction.reduction import align_journal, rig_alignment
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.uncertainty.alignment import Alignment, halfway, known_displacement
from goniotwin.app.campaign.uncertainty.inputs import Input
from goniotwin.app.errors import UserError
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.app.rig.alignment import AlignmentFile, aligned_model, alignment_text, parse_alignment
from tests.app.campaign.reduction.alignment_bench import (
    PROOF,
    RigFindings,
    alignment_rig,
    drawn_plan,
    find,
    judge_alignment,
    model_of,
    run,
    true_displacement,
    unmeasured_views,
)

SMALL = """
name = "small alignment"
side = "both"
symmetry = "anisotropic"
samples = ["two-sided-5"]
etalon = "white-tile"
sigma_deg = [5, 30, 60]
gamma_deg = [0, 180]
beta_deg = [165, 188]
shift_deg = [0, 2.5]
wavelength_nm = [560]
order = ["sigma", "shift", "beta", "gamma", "wavelength"]
gains_v_per_a = [1e8, 1e10]
readings = 2
dark_every_s = 6000
"""
MOST_U = 4.0
"""Largest of ten errors over their u: a normal law exceeds it once in 1,600 rigs."""


@dataclass(frozen=True)
class Small:
    """A journal of 98 rows, what its alignment has found against the truth, the alignment and its file."""

    path: Path
    plan: NewPlan
    found: RigFindings
    alignment: Alignment
    file: AlignmentFile


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Small:
    plan = drawn_plan(parse_schedule(SMALL, "small"), alignment_rig(), 3)
    path = run(plan, tmp_path_factory.mktemp("small") / "small.journal")
    result, file = align_journal(path)
    return Small(path, plan, judge_alignment(result, plan), result.alignment, file)


def test_nine_combinations_are_found_within_their_uncertainties(small: Small) -> None:
    """The truth is that of the back door. Stated are 0.1 deg for tilts and 0.2 deg for zeros: u of 0.06 and 0.12 deg."""
    found = small.found
    scores = np.array(found.errors) / found.u
    assert len(scores) == 9
    assert np.max(np.abs(scores)) < MOST_U
    assert found.direction < 0.01
    assert 0.5 < found.residuals < 1.5
    assert not found.findings


def test_the_reduction_reads_the_rig_from_the_file_without_the_sample(small: Small) -> None:
    file, text = small.file, alignment_text(small.file)
    assert parse_alignment(text, "file") == parse_alignment(alignment_text(parse_alignment(text, "file")), "again")
    assert file.simulated
    assert "SIMULATED" in text
    assert file.mountings == ("two-sided-5#1",)
    of_rig = rig_alignment(text, alignment_rig().file)
    assert not [name for name in of_rig.values if "@" in name]
    whole = small.alignment.only([each.name for each in of_rig.inputs])
    # The file does not have what the data say of combinations that they hardly determine.
    u = np.array([each.u for each in whole.inputs])
    assert of_rig.value / u == pytest.approx(whole.value / u, abs=0.05)
    assert of_rig.covariance / np.outer(u, u) == pytest.approx(whole.covariance / np.outer(u, u), abs=0.05)


def test_a_flat_sample_determines_nothing_and_that_is_one_line(tmp_path: Path) -> None:
    flat = SMALL.replace("two-sided-5", "grey").replace('side = "both"', 'side = "front"')
    path = run(drawn_plan(parse_schedule(flat, "flat"), alignment_rig(), 3), tmp_path / "flat.journal")
    with pytest.raises(UserError, match=r"^[^\n]*flat.journal: grey: its values determine no misalignment[^\n]*$"):
        align_journal(path)


def test_displacements_follow_the_exact_geometry_to_the_second_order() -> None:
    """All tilts and zeros of one random rig at once: the sensitivities half way are off by less than 0.001 deg."""
    rig = alignment_rig()
    plan = drawn_plan(parse_schedule(SMALL, "small"), rig, 7)
    model, drawn = model_of(plan)
    views, instrument = unmeasured_views(), nominal_instrument(rig.file)
    tilts = [drawn[f"sample_{each}@two-sided-5#1"] for each in ("tilt_x", "tilt_y", "height")]
    mounted = np.tile(tilts, (views.polar.size, 1))
    truth = true_displacement(model, drawn, views, "two-sided-5#1")
    found, _ = known_displacement(instrument, views, drawn, mounted)
    both = np.concatenate([found.along, found.across], axis=1)
    assert np.max(np.abs(truth)) > 0.1
    assert np.max(np.abs(both - truth)) < 1e-3
    assert halfway(views, {"sigma_zero": 0.2}).sigma_deg[0] == pytest.approx(views.sigma_deg[0] + 0.1)


def test_combinations_of_a_file_are_the_conditional_expectation() -> None:
    """Two inputs of u 3 and 4, whose sum is 10 exactly: closed form, the weights are the variances."""
    inputs = [Input(name, "deg", u, "normal", "", "", "") for name, u in (("sigma_zero", 3.0), ("arc_tilt_y", 4.0))]
    text = (
        'alignment = 1\nsimulated = true\nrig = "a"\nrig_sha256 = ""\ncampaign = ""\njournal = ""\nmeasured = ""\n'
        'sample = "s"\nmountings = []\nvalues = 1\nchi_square = 1.0\nopen_beam = 0\ncovariance = [[0.0]]\n'
        "[inputs]\n[[combinations]]\n"
        "value = 10.0\nu = 0.0\nprior_u = 5.0\ncoefficients = { sigma_zero = 1.0, arc_tilt_y = 1.0 }\n"
    )
    found = Alignment.of_file(parse_alignment(text, "file"), inputs, "")
    assert found.value == pytest.approx([3.6, 6.4])
    assert found.covariance == pytest.approx(np.array([[5.76, -5.76], [-5.76, 5.76]]), abs=1e-6)
    modes, of_modes = found.modes
    assert of_modes @ np.diag([each.u**2 for each in modes]) @ of_modes.T == pytest.approx(found.covariance, abs=1e-6)


def test_an_alignment_of_another_rig_is_refused(small: Small, tmp_path: Path) -> None:
    file = small.file
    rig = (PROOF / "rig.toml").read_text(encoding="utf-8") + '\n[alignment]\nfile = "found.toml"\n'
    (tmp_path / "rig.toml").write_text(rig, encoding="utf-8")
    (tmp_path / "found.toml").write_text(alignment_text(file), encoding="utf-8")
    described = read_rig(tmp_path / "rig.toml")
    assert described.alignment is not None
    (tmp_path / "found.toml").write_text(alignment_text(replace(file, rig="another")), encoding="utf-8")
    with pytest.raises(UserError, match=r"alignment.file: is of the rig 'another', not of "):
        read_rig(tmp_path / "rig.toml")
    (tmp_path / "found.toml").write_text("name = 1\n", encoding="utf-8")
    with pytest.raises(UserError, match="is not an alignment file"):
        read_rig(tmp_path / "rig.toml")


def test_the_twin_of_a_prediction_is_off_by_what_was_found(small: Small) -> None:
    alignment = small.alignment
    model, _ = model_of(small.plan)
    found = aligned_model(model, small.file)
    assert found.axes["sigma"].zero_deg == pytest.approx(alignment.values["sigma_zero"], rel=1e-6)
    assert found.instrument.deviation("arc").rx_deg == pytest.approx(alignment.values["arc_tilt_x"], rel=1e-6)


@pytest.mark.long
@pytest.mark.parametrize("seed", [1, 2])
def test_an_alignment_through_the_wires_is_the_same(seed: int, tmp_path: Path) -> None:
    found = find(seed, tmp_path, wires=True, cut=False)
    assert found.rows <= 800
    assert len(found.errors) == 10
    assert np.max(np.abs(np.array(found.errors) / found.u)) < MOST_U
    assert found.direction < 0.006


@pytest.mark.long
def test_fifty_random_rigs(tmp_path: Path) -> None:
    """Each combination has a median error below 0.005 deg; directions at other poses, and the corrected cut, as stated."""
    rigs = [find(seed, tmp_path) for seed in range(1, 51)]
    assert all(each.rows <= 800 and len(each.errors) == 10 and not each.findings for each in rigs)
    assert np.max(np.median(np.abs([each.errors for each in rigs]), axis=0)) < 0.005
    assert np.median([each.direction for each in rigs]) < 0.002
    assert 0.8 < np.mean([each.predictions for each in rigs]) < 1.25
    assert 0.8 < np.mean([each.residuals for each in rigs]) < 1.25
    assert np.median([each.cuts_percent[1] - each.cuts_percent[2] for each in rigs]) < 0.1
