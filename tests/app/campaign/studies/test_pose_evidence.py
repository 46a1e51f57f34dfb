"""Light against view by the scans of the open beam: on drawn rigs, by the virtual rig's own optics, and in `verify`."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.pose import (
    Views,
    mounting_inputs,
    photodiode_inputs,
    pose_effects,
    rig_inputs,
)
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.angles import displacement_of
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule, read_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.notes import reduction_notes
from goniotwin.app.campaign.studies.pose_evidence import PoseEvidence, pose_evidence
from goniotwin.app.campaign.studies.sample_alignment import align_sample
from goniotwin.app.cli.main import app
from goniotwin.app.rig import nominal_instrument, read_rig
from goniotwin.arrays import Floats
from tests import rig_tables
from tests.app.campaign.studies.alignment_bench import PROOF, drawn_plan, run
from tests.app.campaign.studies.closure_bench import FILE, DrawnRig, scans_of
from tests.conftest import SMALL, Change, Writer
from tests.sizes import some

SETTINGS = reduction_settings(FILE, parse_schedule(SMALL, "small.toml").file, None, "")
SCANS = scans_of("[15, 40, 65]")
OPEN_BEAM: Change = (
    "gains_v_per_a = [1e8, 1e10]\nreadings = 2\ndark_readings = 4\n",
    "gains_v_per_a = [1e6, 1e8, 1e10]\nreadings = 2\ndark_readings = 4\n[open_beam]\nposes = 11\nstep_deg = 0.24\n",
)
MIRROR_LEVERS = (0.354, 0.707, 1.061)


def evidence_of(seed: int, sigma_zero_deg: float | None = None) -> PoseEvidence:
    """That of three scans on a drawn rig, with all that the rig file states drawn, or another zero of sigma."""
    rig = DrawnRig(seed)
    if sigma_zero_deg is not None:
        rig.zeros["sigma"] = sigma_zero_deg
    found = pose_evidence([rig.closure(scan, stops=True)[0].beam for scan in SCANS], SETTINGS)
    assert found is not None
    return found


def test_centroids_of_drawn_rigs_have_the_law_that_is_stated() -> None:
    """Six centroids of each of 20 rigs: chi-square, and a chance that is as often in each half."""
    found = [evidence_of(seed) for seed in range(20)]
    assert np.mean([each.posterior.chi_square for each in found]) == pytest.approx(6.0, abs=3.0 * math.sqrt(12.0 / 20))
    assert 4 <= sum(each.posterior.chance < 0.5 for each in found) <= 16
    assert all(each.verdict != "fails" for each in found)
    assert found[0].posterior.rank == pytest.approx(5.9, abs=0.1)
    assert "is where the inputs of pose allow it" in next(each for each in found if each.verdict == "holds").text


@pytest.mark.parametrize(("zero_deg", "least_warned", "least_failed"), [(0.3, 9, 6), (-0.3, 9, 6), (0.2, 3, 0)])
def test_a_wrong_zero_of_sigma_is_named_with_its_size(zero_deg: float, least_warned: int, least_failed: int) -> None:
    """All other inputs are drawn: 0.3 deg is 4.2 u in the mean and 0.2 deg is 2.8 u, each with a scatter of one u."""
    found = [evidence_of(seed, zero_deg) for seed in range(10)]
    assert sum(each.verdict != "holds" for each in found) >= least_warned
    assert sum(each.verdict == "fails" for each in found) >= least_failed
    for each in found:
        (zero,) = [one for one in each.posterior.single_errors if one.input.name == "sigma_zero"]
        assert zero.u == pytest.approx(0.071, abs=0.002)
        assert zero.size == pytest.approx(zero_deg, abs=3.0 * zero.u)
        if each.verdict == "fails":
            assert "sigma_zero" in {one.input.name for one in each.explanations}
            assert each.explanations[0].input.name in each.text


@pytest.mark.long
def test_false_alarms_are_as_many_as_stated() -> None:
    """Of 300 drawn rigs some 5 % are a warning, and 0.2 % a contradiction."""
    chances = np.array([evidence_of(seed).posterior.chance for seed in range(300)])
    print(f"\n  chance below 0.05: {np.mean(chances < 0.05):.3f}, below 0.002: {np.mean(chances < 0.002):.4f}")
    assert np.mean(chances < 0.05) < 0.05 + 3.0 * math.sqrt(0.05 * 0.95 / 300)
    assert np.sum(chances < 0.002) <= 3
    for level in (0.2, 0.5, 0.8):
        assert np.mean(chances < level) == pytest.approx(level, abs=3.5 * math.sqrt(level * (1.0 - level) / 300))


def test_a_rig_that_states_no_angle_has_no_evidence() -> None:
    none = {each: 0.0 for each in vars(FILE.uncertainty) if each.endswith(("_deg", "_mm"))}
    beams = [DrawnRig(0).closure(scan)[0].beam for scan in SCANS]
    assert pose_evidence(beams, replace(SETTINGS, rig=replace(FILE, uncertainty=rig_tables.stated(**none)))) is None
    assert pose_evidence([], SETTINGS) is None
    assert pose_evidence([replace(each, edge=0.5) for each in beams], SETTINGS) is None


def test_a_known_alignment_is_what_scans_begin_with() -> None:
    """Its modes keep their place in a budget; the inputs of the photodiodes in the beam have their names."""
    inputs = Alignment.stated(rig_inputs(FILE.uncertainty)).inputs
    turned = np.random.default_rng(2).normal(size=(len(inputs), len(inputs)))
    off = np.random.default_rng(3).normal(scale=0.01, size=len(inputs))
    u = np.array([each.u for each in inputs])
    covariance = 0.01 * u[:, None] * (turned @ turned.T) * u
    known = Alignment(inputs, off, covariance, "alignment of a day")
    found = pose_evidence([DrawnRig(1).closure(scan)[0].beam for scan in SCANS], replace(SETTINGS, alignment=known))
    assert found is not None
    assert found.alignment.source == "alignment of a day, scans of the open beam"
    assert found.posterior.before.values["sigma_zero"] == known.values["sigma_zero"]
    names = [each.name for each in found.alignment.modes[0]]
    assert names[0] == "alignment[1]"
    assert [each for each in names if each.startswith("scan_centroid")] == names[-2 * len(SCANS) :]
    prior = found.posterior.before.covariance
    assert np.all(np.linalg.eigvalsh(prior - found.alignment.covariance) > -1e-12)


def view(sigma_deg: float, polar_deg: float, *, lower: bool, transmitted: bool, gamma_deg: float = 0.0) -> Views:
    angles = np.array([[sigma_deg], [gamma_deg], [math.radians(polar_deg)], [math.pi]], dtype=float)
    return Views(*angles, *(np.array([each]) for each in (lower, transmitted, False)))


def pose_u(at: Views, known: Alignment, photodiode: int, mounting: str = "paint#1") -> tuple[float, float]:
    """u of the angle between lobe and view at a direction, along the arc and across it, without positions."""
    table, effects = FILE.uncertainty, pose_effects(nominal_instrument(FILE), at)
    known = known.with_inputs([*mounting_inputs(table, "sample", mounting), *photodiode_inputs(table, photodiode)])
    parts = [
        (rig_inputs(table), effects.common),
        (mounting_inputs(table, "sample", mounting), effects.sample),
        (photodiode_inputs(table, photodiode), effects.photodiode),
    ]
    moved = displacement_of(known, parts)
    along, across = (math.sqrt(float((each @ known.covariance @ each.T)[0, 0])) for each in (moved.along, moved.across))
    return along, across


@pytest.mark.parametrize("gamma_deg", [0.0, 180.0])
@pytest.mark.parametrize(("lower", "gain"), [(False, (0.99, 1.01)), (True, (1.015, 1.03))])
def test_one_scan_hardly_lowers_the_u_of_reflected_light_in_the_plane(
    lower: bool, gain: tuple[float, float], gamma_deg: float
) -> None:
    """By the rotations about y of a few lines: the scan has light less view, reflected light has light and view.

    Rectangular inputs of one half width, so that variances count squares: three mirrors and sigma's zero in the light, arc,
    shift, sensor and photodiode in the view, the sample's tilt twice.
    """
    (beam,) = [DrawnRig(0).closure(scan)[0].beam for scan in SCANS[1:2]]
    scanned = pose_evidence([beam], SETTINGS)
    assert scanned is not None
    at = view(140.0 if lower else 40.0, 40.0, lower=lower, transmitted=False, gamma_deg=gamma_deg)
    before, after = pose_u(at, scanned.posterior.before, 1), pose_u(at, scanned.alignment, 1)
    # Light; arc; shift; sensor; own photodiode, the scan's, the sample: in the sense of a rotation from z to x.
    light, up = math.fsum(each**2 for each in MIRROR_LEVERS) + 1.0, -1.0 if lower else 1.0
    value = np.array([math.sqrt(light), 1.0, -up, -1.0, -up, 0.0, 2.0])
    scan = np.array([-math.sqrt(light), 1.0, -1.0, -1.0, 0.0, -1.0, 0.0])
    by_hand = 1.0 / math.sqrt(1.0 - (value @ scan) ** 2 / ((value @ value) * (scan @ scan)))
    assert gain[0] < before[0] / after[0] < gain[1]
    assert before[0] / after[0] == pytest.approx(by_hand, abs=0.01)
    assert before[0] == pytest.approx(0.05 / math.sqrt(3.0) * float(np.linalg.norm(value)), rel=0.02)
    # Across the plane the mirror image of the light moves as the light itself does: there a scan shows what counts.
    assert before[1] / after[1] > 1.2


def test_transmitted_light_is_seen_as_the_scan_sees_it() -> None:
    """The same light, and the same arc: what is left in the plane is the photodiodes' own angles, and stops."""
    (beam,) = [DrawnRig(0).closure(scan)[0].beam for scan in SCANS[1:2]]
    scanned = pose_evidence([beam], SETTINGS)
    assert scanned is not None
    at = view(140.0, 40.0, lower=False, transmitted=True)
    before, after = pose_u(at, scanned.posterior.before, 1), pose_u(at, scanned.alignment, 1)
    assert before[0] == pytest.approx(0.075, abs=0.002)
    own = 0.05 / math.sqrt(3.0) * math.sqrt(2.0)
    assert after[0] == pytest.approx(math.hypot(own, 0.01 / math.sqrt(3.0)), rel=0.05)


@pytest.mark.long
def test_the_u_of_the_pose_before_and_after_a_scan_and_an_alignment(tmp_path: Path) -> None:
    """examples/proof/alignment.toml: a lobe on both sides at three gammas and six sigmas, and a scan of each arc.

    Beside it a least squares by hand: each pose of the lobe shows where it is seen, as well as photodiodes and stops allow.
    """
    schedule, rig = read_schedule(PROOF / "alignment.toml"), read_rig(PROOF / "rig.toml")
    path = run(drawn_plan(schedule, rig, 1), tmp_path / "a.journal")
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        aligned = align_sample(evaluation.reduction, evaluation.closure, "two-sided-5")
    assert evaluation.pose is not None
    scanned, table = evaluation.pose, rig.file.uncertainty
    inputs = [*rig_inputs(table), *mounting_inputs(table, "sample", aligned.mountings[0])]
    stated, u = Alignment.stated(inputs), np.array([each.u for each in inputs])

    def moved(at: Views) -> Floats:
        effects = pose_effects(nominal_instrument(rig.file), at)
        both = ([getattr(effects.common, way), getattr(effects.sample, way)] for way in ("along", "across"))
        return np.asarray(np.concatenate([np.concatenate(each, axis=1) for each in both]) * u)

    of_photodiode, stop = 0.05 / math.sqrt(3.0), 0.01 / math.sqrt(3.0)
    sides = [(sigma, gamma, lower) for sigma in (5, 17, 30, 42, 60, 75) for gamma in (0, 45, 180) for lower in (False, True)]
    rows = [moved(view(180.0 - s if lower else s, s, lower=lower, transmitted=False, gamma_deg=g)) for s, g, lower in sides]
    jacobian = np.concatenate(rows)
    seen = jacobian @ jacobian.T + (of_photodiode**2 + 2.0 * stop**2) / 4.0 * np.eye(len(jacobian))  # four photodiodes a lobe
    left = np.eye(u.size) - jacobian.T @ np.linalg.solve(seen, jacobian)
    print("\n  sigma  light        along: stated, scans, lobe, by hand   across: the same")
    for sigma in (17.0, 40.0, 65.0):
        for lower in (False, True):
            for gamma in (0.0, 180.0):
                at = view(180.0 - sigma if lower else sigma, sigma, lower=lower, transmitted=False, gamma_deg=gamma)
                own = np.sqrt(np.diag(moved(at) @ left @ moved(at).T) + of_photodiode**2)
                known = [pose_u(at, each, 1, aligned.mountings[0]) for each in (stated, scanned.alignment, aligned.alignment)]
                arc = "lower" if lower else "upper"
                along, across = (" ".join(f"{x[k]:.4f}" for x in (*known, own.tolist())) for k in (0, 1))
                print(f"  {sigma:5g}  {arc} {gamma:3g}    {along}    {across}")
                assert 1.0 <= known[0][0] / known[1][0] < 1.06
                assert 1.2 < known[0][1] / known[1][1] < 2.1
                assert known[2] == pytest.approx(own.tolist(), rel=0.03)


@pytest.mark.parametrize(("zero_deg", "verdict"), some([(0.3, "fails"), (0.0, "holds"), (0.2, "warns")]))
def test_verify_judges_the_scan_of_a_campaign(
    zero_deg: float, verdict: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    path = tmp_path / "a.journal"
    off = ("sigma = { motor = 4, gear = 36.0 }", f"sigma = {{ motor = 4, gear = 36.0, zero_deg = {zero_deg} }}")
    run_without_wires(make_plan(read_schedule(write_schedule(OPEN_BEAM)), read_rig(write_rig(off))), path)
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        notes = "\n".join(reduction_notes(evaluation, {}))
    findings = [each for each in evaluation.findings if "inputs of pose" in each]
    assert (evaluation.reduction.settings.alignment is None) == (verdict == "fails")
    assert ("the rig's misalignments: scans of the open beam" in notes) == (verdict != "fails")
    assert ("not corrected by the scans of the open beam" in notes) == (verdict == "fails")
    done = CliRunner().invoke(app, ["verify", str(path)])
    assert f"pose by the open beam: {verdict}: the open beam at sigma" in done.stdout
    (line,) = [each for each in done.stdout.splitlines() if each.startswith("  pose by the open beam ")]
    assert line.split()[-1] == verdict
    assert ("values are corrected by it" in done.stdout) == (verdict != "fails")
    assert done.exit_code == (1 if verdict == "fails" else 0)
    assert len(findings) == (1 if verdict == "fails" else 0)
    if verdict != "holds":
        assert f"sigma_zero of {zero_deg:.2f}(" in done.stdout
