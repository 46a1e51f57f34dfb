"""`goniotwin align`: which files it writes and replaces, and what it refuses before it computes."""

from pathlib import Path

import pytest

from goniotwin.app.campaign.rehearsal.alignment_design import FIRST_LINE
from goniotwin.app.cli.data import align
from goniotwin.app.cli.work import alignment, alignment_plan
from goniotwin.app.errors import UserError
from tests.conftest import REPOSITORY

PROOF = REPOSITORY / "examples" / "proof"


@pytest.fixture
def computed(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The computations that were begun; each ends with an error."""
    begun: list[str] = []

    def begin(*_: object) -> None:
        begun.append("computation")
        raise UserError("computed")

    monkeypatch.setattr(alignment, "align_journal", begin)
    monkeypatch.setattr(alignment_plan, "design_alignment", begin)
    return begun


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("none/al.toml", "there is no folder"),
        pytest.param(
            "/proc/x.toml", "cannot be written to", marks=pytest.mark.skipif(not Path("/proc").exists(), reason="of Linux")
        ),
        (".", "is a folder or a device"),
        ("first.journal", "is a data file"),
        ("rig.toml", "exists, is not an alignment file, and is not overwritten; choose another name"),
        ("schedule.toml", "exists, is not an alignment file, and is not overwritten; choose another name"),
    ],
)
def test_a_file_that_must_not_be_written_is_refused_before_the_computation(
    name: str, wrong: str, computed: list[str], tmp_path: Path
) -> None:
    (tmp_path / "first.journal").write_bytes(b"SQLite format 3\0")
    (tmp_path / "rig.toml").write_text((PROOF / "rig.toml").read_text(encoding="utf-8") + '[alignment]\nfile = "a"\n')
    (tmp_path / "schedule.toml").write_bytes((PROOF / "alignment.toml").read_bytes())
    before = {each: each.read_bytes() for each in tmp_path.iterdir()}
    with pytest.raises(UserError) as caught:
        align(tmp_path / "first.journal", output=tmp_path / name)
    assert wrong in str(caught.value)
    assert caught.value.status == 2
    assert not computed
    assert {each: each.read_bytes() for each in tmp_path.iterdir()} == before


def test_an_alignment_file_and_a_new_name_are_written(computed: list[str], tmp_path: Path) -> None:
    (tmp_path / "al.toml").write_text("# an alignment\nalignment = 1\n", encoding="utf-8")
    for name in ("al.toml", "new.toml"):
        with pytest.raises(UserError, match=r"^computed$"):
            align(tmp_path / "first.journal", output=tmp_path / name)
    assert len(computed) == 2


def test_a_plan_replaces_only_a_planned_schedule(computed: list[str], tmp_path: Path) -> None:
    schedule = tmp_path / "alignment.toml"
    schedule.write_bytes((PROOF / "alignment.toml").read_bytes())
    for other in (schedule, PROOF / "rig.toml"):
        with pytest.raises(UserError, match=r"exists, is not a schedule that align --plan has written, and is not overwritten"):
            align(schedule, output=other, plan=True, minutes=10.0, rig=PROOF / "rig.toml")
    assert not computed
    (tmp_path / "planned.toml").write_text(f"{FIRST_LINE}\n", encoding="utf-8")
    for name in ("planned.toml", "new.toml"):
        with pytest.raises(UserError, match=r"^computed$"):
            align(schedule, output=tmp_path / name, plan=True, minutes=10.0, rig=PROOF / "rig.toml")
