"""Residuals that are not those of a displaced lobe: they make no alignment, or it is stated wherever it is used."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.reduction.settings import rig_alignment
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.journals import align_journal, watch_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig, read_rig
from goniotwin.app.rig.alignment import AlignmentFile, alignment_text
from tests.app.campaign.studies.alignment_bench import PROOF, run

pytestmark = pytest.mark.xdist_group("alignment residuals")

BRUSHED = """
name = "brushed"
symmetry = "anisotropic"
samples = ["brushed"]
etalon = "etalon"
sigma_deg = [30]
beta_deg = [168, 174, 180, 186, 192]
shift_deg = [0, 2.5]
wavelength_nm = [560]
gains_v_per_a = [1e8, 1e10]
readings = 2
dark_every_s = 6000
"""
LOBE = BRUSHED.replace("brushed", "gaussian-5").replace("[1e8, 1e10]", "[1e6, 1e8, 1e10]")
PAINT = """
name = "paint"
samples = ["paint", "grey"]
etalon = "etalon"
sigma_deg = [20, 62]
beta_deg = [0, 60, 120, 180]
shift_deg = [0, 2.5]
wavelength_nm = [480]
gains_v_per_a = [1e8, 1e10]
readings = 4
dark_every_s = 6000
"""
NO_LOBE = r"brushed: the residuals are not those of a lobe that is displaced \(chi-square .* per degree of freedom\): "


def measured(schedule: str, folder: Path, alignment: str | None = None, further: str = "") -> Path:
    """The journal of a schedule on the rig of the proof with further tables, and the text of an alignment file in it."""
    text = f"{(PROOF / 'rig.toml').read_text(encoding='utf-8')}\n{further}"
    named = text if alignment is None else f'{text}\n[alignment]\nfile = "found.toml"\n'
    plan = make_plan(parse_schedule(schedule, "schedule"), parse_rig(named, PROOF, "rig", alignment))
    return run(plan, folder / "measured.journal")


@pytest.fixture(scope="module")
def lobe(tmp_path_factory: pytest.TempPathFactory) -> AlignmentFile:
    """The alignment file of a round lobe on an aligned rig."""
    return align_journal(measured(LOBE, tmp_path_factory.mktemp("lobe")))[1]


def with_chi_square(file: AlignmentFile, chi_square: float) -> str:
    return alignment_text(replace(file, chi_square=chi_square))


def named_by_rig(folder: Path, text: str) -> RigDescription:
    rig = (PROOF / "rig.toml").read_text(encoding="utf-8")
    (folder / "rig.toml").write_text(f'{rig}\n[alignment]\nfile = "found.toml"\n', encoding="utf-8")
    (folder / "found.toml").write_text(text, encoding="utf-8")
    return read_rig(folder / "rig.toml")


def test_a_lobe_that_is_not_round_makes_no_alignment_and_corrects_no_value(tmp_path: Path) -> None:
    """A brushed metal, three times as wide across as along: no displacement of a round lobe has its values."""
    path = measured(BRUSHED.replace("readings", 'align = "brushed"\nreadings'), tmp_path)
    with pytest.raises(UserError, match=f"^{path}: {NO_LOBE}"):
        align_journal(path)
    with Journal.open(path) as journal:
        reduced = reduce_journal(journal)
        assert evaluate_journal(journal).reduction.settings.alignment is None
    assert [each for each in reduced.notes if each.startswith("not aligned: brushed: the residuals are not those")]
    assert not [each for each in reduced.notes if each.startswith("values are corrected")]


def test_a_lobe_on_a_pedestal_and_a_flat_sample_are_not_watched(tmp_path: Path) -> None:
    """Paint and grey on a rig that is aligned: nothing is off."""
    found = watch_journal(measured(PAINT, tmp_path))
    assert not found.misalignments
    assert found.without == ("paint", "grey")


def test_a_round_lobe_has_residuals_of_its_noise_alone(lobe: AlignmentFile) -> None:
    assert 0.5 < lobe.chi_square < 1.5


def test_residuals_of_worse_positions_than_stated_widen_the_uncertainties(lobe: AlignmentFile, tmp_path: Path) -> None:
    """Axes that stop 0.08 deg beside, where 0.01 are stated."""
    result, file = align_journal(measured(LOBE, tmp_path, further="[twin.disturbances]\nposition_deg = 0.08\n"))
    assert 1.5 < result.chi_square < 5.0
    assert "as large" in result.findings[0]
    for narrow, wide in zip(lobe.combinations, file.combinations, strict=True):
        assert wide.u > 1.4 * narrow.u
        assert abs(wide.value) < 3.0 * wide.u


def test_a_rig_that_names_an_alignment_of_no_lobe_is_refused(lobe: AlignmentFile, tmp_path: Path) -> None:
    for chi_square in (12054.0, 35.6, 5.01, -1.0):
        with pytest.raises(UserError, match=r"rig.toml: alignment.file: the residuals are not those of a lobe"):
            named_by_rig(tmp_path, with_chi_square(lobe, chi_square))
    assert named_by_rig(tmp_path, with_chi_square(lobe, 1.3)).alignment is not None


def test_doubtful_residuals_of_a_file_are_in_the_notes_of_every_campaign(lobe: AlignmentFile, tmp_path: Path) -> None:
    path = measured(BRUSHED, tmp_path, with_chi_square(lobe, 2.25))
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        assert evaluation.reduction.settings.alignment is not None
        (found,) = [each for each in evaluation.findings if "chi-square 2.25" in each]
    assert found.startswith("[alignment] gaussian-5, ")
    assert found.endswith("the uncertainties of the alignment are 1.5 times as large")


def test_a_journal_with_an_alignment_of_no_lobe_is_reduced_without_it(lobe: AlignmentFile, tmp_path: Path) -> None:
    path = measured(BRUSHED, tmp_path, with_chi_square(lobe, 35.6))
    with Journal.open(path) as journal:
        assert evaluate_journal(journal).reduction.settings.alignment is None
        notes = reduce_journal(journal).notes
    assert [each for each in notes if each.startswith("not corrected by [alignment] gaussian-5, ") and "35.6" in each]


def test_variances_are_widened_by_chi_square_and_stay_within_what_is_stated(lobe: AlignmentFile) -> None:
    """Birge's ratio: each mode's variance in proportion; one that the data do not determine stays as stated."""
    known = rig_alignment(alignment_text(lobe), read_rig(PROOF / "rig.toml").file)
    wide = known.widened(2.25)
    before, after = (np.array([each.u for each in one.modes[0]]) for one in (known, wide))
    assert after == pytest.approx(np.minimum(1.5 * before, np.maximum(before, 1.0)), abs=1e-7)
    assert after[0] == pytest.approx(1.5 * before[0])
