"""A journal that is renamed, replaced or removed while it is written: no second program writes it, and no row is lost."""

import contextlib
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Callable
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.running.events import Event, EventLogged, RowCommitted, State
from goniotwin.app.cli.main import app
from goniotwin.app.rig.lock import RigInUse

pytestmark = pytest.mark.skipif(os.name == "nt", reason="Windows renames no open database")
AFTER = 2
"""Rows before the journal is moved."""


def rename(path: Path) -> None:
    path.rename(path.with_name("moved.journal"))


def replace(path: Path) -> None:
    path.with_name("other").write_bytes(b"other")
    path.with_name("other").replace(path)


def remove(path: Path) -> None:
    path.unlink()


@pytest.mark.parametrize("move", [rename, replace, remove])
def test_a_run_ends_when_its_journal_is_moved_and_keeps_its_rows(
    plan: Plan, tmp_path: Path, move: Callable[[Path], None]
) -> None:
    path, moved, rescued = (tmp_path / f"{name}.journal" for name in ("a", "moved", "a-rescued"))
    faults: list[str] = []

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == AFTER:
            move(path)
            if moved.exists():
                with pytest.raises(RigInUse, match=f"is in use by process {os.getpid()} "):
                    resume_campaign(moved)
                with pytest.raises(RigInUse, match=f"is in use by process {os.getpid()} "):
                    Journal.reopen(moved)
        if isinstance(event, EventLogged) and event.kind == "fault":
            faults.append(event.what)

    outcome = run_campaign(plan, path, listeners=[listen])
    assert (outcome.state, outcome.journal) == (State.FAILED, rescued)
    assert f"{rescued} has all its rows: use that" in outcome.journal_note
    now = "another file" if move is replace else "no file"
    assert faults == [*outcome.faults] != []
    assert f"a.journal: was moved, renamed or removed during the run, and {now} has its name now" in faults[0]
    for each in (rescued, moved) if move is rename else (rescued,):
        with Journal.open(each) as journal:
            assert (len([*journal.rows()]), journal.chain.damage) == (AFTER + 1, "")
            assert journal.event_texts("fault") == faults
            assert journal.sessions()[-1].outcome == "failed"
    assert resume_campaign(rescued).state is State.DONE
    assert not path.exists() or path.read_bytes() == b"other"
    expected = {rescued, *([moved] if move is rename else []), *([path] if move is replace else [])}
    assert {each for each in tmp_path.iterdir() if "journal" in each.name} == expected


def remove_folder(folder: Path) -> None:
    shutil.rmtree(folder)


def move_folder(folder: Path) -> None:
    folder.rename(folder.with_name("elsewhere"))


@pytest.mark.parametrize("lose", [remove_folder, move_folder])
def test_a_run_keeps_its_rows_though_the_folder_of_its_journal_is_gone(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, lose: Callable[[Path], None]
) -> None:
    folder = tmp_path / "november"
    folder.mkdir()

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == AFTER:
            lose(folder)

    monkeypatch.chdir(tmp_path)
    outcome = run_campaign(plan, Path("november/a.journal"), listeners=[listen])
    assert (outcome.state, outcome.journal) == (State.FAILED, tmp_path / "a-rescued.journal")
    with Journal.open(outcome.journal) as journal:
        assert (len([*journal.rows()]), journal.chain.damage) == (AFTER + 1, "")
    assert not folder.exists()


def test_a_run_keeps_its_rows_though_the_folder_that_it_works_in_is_gone(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, temporary = tmp_path / "november", tmp_path / "temporary"
    folder.mkdir()
    temporary.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(temporary))
    monkeypatch.chdir(folder)

    def listen(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done == AFTER:
            remove_folder(folder)

    outcome = run_campaign(plan, Path("a.journal"), listeners=[listen])
    assert (outcome.state, outcome.journal) == (State.FAILED, temporary / "a-rescued.journal")
    with Journal.open(outcome.journal) as journal:
        assert len([*journal.rows()]) == AFTER + 1


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def lose_readings(path: Path) -> None:
    with contextlib.closing(sqlite3.connect(path)) as database, database:
        database.execute("DELETE FROM reading WHERE number = 1")


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        (cut, "a.journal: is damaged: database disk image is malformed; use a copy"),
        (lose_readings, "a.journal: differs from what was measured: row 1 ("),
    ],
)
def test_a_run_whose_journal_cannot_be_read_back_has_not_status_0(
    plan: Plan,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    damage: Callable[[Path], None],
    named: str,
) -> None:
    path, schedule, rig = (tmp_path / name for name in ("a.journal", "schedule.toml", "rig.toml"))
    schedule.write_text(plan.schedule.text, encoding="utf-8")
    rig.write_text(plan.rig.text, encoding="utf-8")
    close = Journal.close

    def close_and_damage(journal: Journal) -> None:
        close(journal)
        if journal.path == path and journal.place.kept_at.exists():
            damage(path)

    monkeypatch.setattr(Journal, "close", close_and_damage)
    words = ["run", str(schedule), "--rig", str(rig), "--out", str(path)]
    assert app(words, standalone_mode=False) == 1
    assert named in capsys.readouterr().err
