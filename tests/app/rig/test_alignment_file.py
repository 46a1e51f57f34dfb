"""The alignment file that a rig file names: whole, of this rig and of this geometry; anything else is refused in a line."""

from dataclasses import replace
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.rig.alignment import AlignmentFile, Combination, alignment_text
from tests.conftest import REPOSITORY

RIG = (REPOSITORY / "examples" / "proof" / "rig.toml").read_text(encoding="utf-8")
TILT = "sample_tilt_x@lobe#1"
COMBINATIONS = (
    Combination(0.05, 0.01, 0.1, {"sigma_zero": 1.0, "arc_tilt_y": 1.0}),
    Combination(0.02, 0.02, 0.1, {"beta_zero": 1.0, TILT: 2.0}),
)
"""With sigma's zero at 0.02 deg, the arc's tilt at 0.03 deg, and the sample's, which the file does not have."""


def read(folder: Path, text: str, rig: str = RIG) -> RigDescription:
    """The description of a rig that names an alignment file with this text."""
    (folder / "rig.toml").write_text(f'{rig}\n[alignment]\nfile = "found.toml"\n', encoding="utf-8")
    (folder / "found.toml").write_text(text, encoding="utf-8")
    return read_rig(folder / "rig.toml")


@pytest.fixture
def whole(tmp_path: Path) -> AlignmentFile:
    """The alignment file of the rig of the proof."""
    (tmp_path / "plain.toml").write_text(RIG, encoding="utf-8")
    rig = read_rig(tmp_path / "plain.toml")
    return AlignmentFile(
        alignment=1,
        simulated=True,
        seed=1,
        rig=rig.file.name,
        rig_sha256=rig.digest,
        campaign="first",
        journal="",
        measured="2026-11-23",
        sample="lobe",
        mountings=("lobe#1",),
        values=100,
        chi_square=1.0,
        open_beam=0,
        combinations=COMBINATIONS,
        covariance=((1e-4, 1e-4), (1e-4, 4e-4)),
        inputs={"sigma_zero": 0.02, "arc_tilt_y": 0.03},
        geometry_sha256=rig.identity.geometry,
        tables_sha256=dict(rig.identity.tables),
    )


def test_a_whole_file_of_this_rig_is_taken_without_a_note(whole: AlignmentFile, tmp_path: Path) -> None:
    """Ports, the table [alignment] itself, comments and [twin] are no difference."""
    described = read(tmp_path, alignment_text(whole), RIG.replace("twin://virtual/", "twin://another/").replace("# ", "# a "))
    assert described.alignment is not None
    assert described.alignment_notes == []


@pytest.mark.parametrize(
    ("change", "wrong"),
    [
        ({"simulated": False}, "is of a real rig, and this rig is SIMULATED"),
        ({"seed": 2}, "is of the virtual rig of seed 2, not of seed 1"),
        ({"covariance": ((-1e-4, 0.0), (0.0, 4e-4))}, "covariance: has a negative variance"),
        ({"covariance": ((1e-4, 1e-4), (0.0, 4e-4))}, "covariance: is not symmetric"),
        ({"covariance": ((1e-4, 3e-4), (3e-4, 4e-4))}, "a combination would have a negative variance"),
        ({"covariance": ((4e-4, 1e-4), (1e-4, 4e-4))}, "its diagonal is not the square of the combinations' u"),
        ({"inputs": {"sigma_zero": 0.02, "arc_tilt_y": -0.03}}, "inputs: do not make the value of combinations.0"),
        ({"inputs": {"sigma_zero": 0.02, "arc_tilt_y": 0.03, "moon_tilt_x": 0.1}}, "inputs: there is no input 'moon_tilt_x'"),
        (
            {"combinations": (COMBINATIONS[0], replace(COMBINATIONS[1], coefficients={"sample_tilt_x@b#1": 2.0}))},
            "combinations.1.coefficients: there is no input 'sample_tilt_x@b#1'",
        ),
    ],
)
def test_a_damaged_file_is_refused(whole: AlignmentFile, change: dict[str, object], wrong: str, tmp_path: Path) -> None:
    with pytest.raises(UserError) as caught:
        read(tmp_path, alignment_text(replace(whole, **change)))  # type: ignore[arg-type]  # keys of a table of tests
    assert str(caught.value).startswith(f"{tmp_path / 'rig.toml'}: alignment.file: ")
    assert wrong in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("arc_radius_mm = 300.0", "arc_radius_mm = 350.0"),
        ("mirror_distance_mm = 200.0", "mirror_distance_mm = 190.0"),
        ("gear = 36.0", "gear = 36.0\nzero_offset_deg = 0.1"),
        ("upper_deg = [0, 5,", "upper_deg = [0, 5.1,"),
    ],
)
def test_another_geometry_is_refused(whole: AlignmentFile, old: str, new: str, tmp_path: Path) -> None:
    assert old in RIG
    with pytest.raises(UserError, match=r"alignment.file: is of another geometry: "):
        read(tmp_path, alignment_text(whole), RIG.replace(old, new, 1))


def test_other_changes_of_the_rig_file_are_a_note(whole: AlignmentFile, tmp_path: Path) -> None:
    rig = RIG.replace("radiance_factor = 0.99", "radiance_factor = 0.98") + "\n[uncertainty]\nmirror_tilt_deg = 0.2\n"
    described = read(tmp_path, alignment_text(whole), rig)
    assert described.alignment_notes == [
        "[alignment] first, 2026-11-23: [etalon], [uncertainty] of the rig file changed after it"
    ]
    described = read(tmp_path, alignment_text(replace(whole, geometry_sha256=None, tables_sha256={})))
    (note,) = described.alignment_notes
    assert "was written by an earlier version" in note
