"""Journals as they are written: copies during a run, a flipped bit, the end of a campaign, a folder of journals of any kind."""

import contextlib
import io
import os
import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import run_campaign
from goniotwin.app.campaign.journal.copies import copy_journal
from goniotwin.app.campaign.journal.reading import DamagedJournal
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import CHECKPOINT_ROWS, Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.cli.main import app
from goniotwin.app.errors import UserError
from goniotwin.app.rig import read_rig
from tests.conftest import ONE_WAY, Writer, changed
from tests.system.command import invoke
from tests.system.command_process import FORKED, CommandProcess, row_digest
from tests.system.strange_journals import OLD_JOURNAL, STRANGE_SCHEMAS, changed_journal


def export_csv(journal: Path, out: Path) -> bytes | None:
    """What `goniotwin export` writes with status 0; None where it refuses the journal in one line and writes nothing."""
    out.unlink(missing_ok=True)
    try:
        with contextlib.redirect_stdout(io.StringIO()):
            status = app(["export", str(journal), "--format", "csv", "--out", str(out)], standalone_mode=False)
    except UserError as error:
        return None if error.status and "\n" not in str(error) and not out.exists() else b"other"
    return None if status else out.read_bytes()


@pytest.mark.parametrize("flips", [pytest.param(20, id="20"), pytest.param(10_000, id="10000", marks=pytest.mark.long)])
def test_no_flipped_bit_of_a_journal_gives_other_values(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, flips: int
) -> None:
    """Of all bytes, and where there are few flips of those that are not zero: most others are unused, and change nothing."""
    plan = make_plan(read_schedule(write_schedule(("shift_deg = [0, 1]", "shift_deg = [0]"))), read_rig(write_rig()))
    path, out = tmp_path / "a.journal", tmp_path / "a.csv"
    run_campaign(plan, path)
    whole, sound = path.read_bytes(), export_csv(path, out)
    assert sound is not None
    places = np.arange(len(whole)) if flips > 1000 else np.flatnonzero(np.frombuffer(whole, dtype=np.uint8))
    outcomes: Counter[str] = Counter()
    for k in np.random.default_rng(flips).choice(8 * len(places), flips, replace=False).tolist():
        bit = 8 * int(places[k // 8]) + k % 8
        content = bytearray(whole)
        content[bit // 8] ^= 1 << bit % 8
        path.write_bytes(content)
        found = export_csv(path, out)
        outcomes["refused" if found is None else "same" if found == sound else "other"] += 1
        assert found in (None, sound), f"bit {bit}"
    print(f"\n{dict(outcomes)}")
    assert outcomes["refused"] > flips // 5


@pytest.mark.long
@pytest.mark.parametrize("runs", [10])
@FORKED[0]
def test_copies_of_a_journal_during_a_run_are_whole(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, runs: int
) -> None:
    """By `goniotwin copy` with every row that was reported before; plain ones without at most ten rows, or refused as torn."""
    rig = write_rig()
    schedule = write_schedule(("wavelength_nm = [550]", "wavelength_nm = [500, 550, 600, 650, 700]"))
    plain, exact = tmp_path / "plain.journal", tmp_path / "exact.journal"
    copies: Counter[str] = Counter()
    for k in range(runs):
        copied: set[tuple[int, str]] = set()  # with the latest row, which need not be reported yet
        path = tmp_path / f"{k}.journal"
        process = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", path)
        process.wait_for_rows(1)
        while process.alive:
            before = process.committed
            if k % 2:
                exact.unlink(missing_ok=True)
                copy_journal(path, exact)
                assert before.items() <= committed_rows(exact).items()
                copies["exact"] += 1
                continue
            shutil.copyfile(path, plain)
            try:
                found = committed_rows(plain)
                copied |= found.items()
                assert len(found) > len(before) - CHECKPOINT_ROWS
                copies["plain"] += 1
            except DamagedJournal:
                copies["torn"] += 1
        assert process.wait() == 0, process.errors
        assert copied <= process.committed.items()
        shutil.copyfile(path, plain)
        assert committed_rows(plain) == process.committed
    print(f"\n{dict(copies)}")
    assert min(copies["exact"], copies["plain"]) > runs


def committed_rows(path: Path) -> dict[int, str]:
    """The rows of a journal, by number, with the digests of their data. Raises DamagedJournal."""
    with Journal.open(path) as journal:
        if journal.chain.damage:
            raise DamagedJournal(journal.chain.damage)
        return {each.row.number: row_digest(each.data) for each in journal.rows()}


def test_runs_lists_the_sound_journals_and_names_the_odd_ones(tmp_path: Path) -> None:
    folder = tmp_path / "journals"
    folder.mkdir()
    changed_journal(folder / "[red]sound.journal", "UPDATE campaign SET value = '[/]\x1b[2J' WHERE key = 'name'")
    odd: dict[str, Callable[[Path], object]] = {
        "folder": lambda path: path.mkdir(),
        "text": lambda path: path.write_text("x"),
        "empty": lambda path: path.touch(),
        "loop": lambda path: path.symlink_to(path),
        "nowhere": lambda path: path.symlink_to(tmp_path / "nothing"),
        "endless": lambda path: path.symlink_to("/dev/zero"),
        "torn": lambda path: path.write_bytes(OLD_JOURNAL.read_bytes()[:20_000]),
        "outcome": lambda path: changed_journal(path, "UPDATE session SET outcome = 'strange'"),
        "versions": lambda path: changed_journal(path, f"UPDATE session SET versions = '{'[' * 100_000}'"),
        "duration": lambda path: changed_journal(path, "UPDATE session SET started_s = -9e999"),
        "plan": lambda path: changed_journal(path, "DELETE FROM reading; DELETE FROM attempt; UPDATE plan SET seconds = 9e999"),
        "flags": lambda path: changed_journal(path, "UPDATE attempt SET flags = 'skipped'"),
        "view": lambda path: changed_journal(path, STRANGE_SCHEMAS["view"]),
    }
    if hasattr(os, "mkfifo"):
        odd["fifo"] = os.mkfifo
    for name, make in odd.items():
        make(folder / f"{name}.journal")
    assert invoke("runs", folder, "--json").returncode == 0
    done = invoke("runs", folder)
    assert done.returncode == 0
    assert "[red]sound.journal" in done.stdout
    assert "[/]?[2J" in done.stdout
    named = done.stderr.splitlines()
    assert len(named) == len(odd), done.stderr
    assert all(any(f"{name}.journal" in line for line in named) for name in odd)


@pytest.mark.parametrize("outcome", ["NULL", "'failed'"])
def test_a_campaign_that_ended_after_its_last_row_becomes_done(tmp_path: Path, outcome: str) -> None:
    path = changed_journal(tmp_path / "a.journal", f"UPDATE session SET outcome = {outcome}, ended_s = NULL, wall_ended = NULL")
    assert campaign_summary(path).state == ("done" if outcome == "NULL" else "failed")
    assert campaign_summary(path).seconds_left == 0.0
    with Journal.open(path) as journal:
        (rig := tmp_path / "rig.toml").write_text(changed(journal.value("rig"), (ONE_WAY,)), encoding="utf-8")
    done = invoke("run", "--resume", path, "--rig", rig)  # closes the shutter
    assert done.returncode == 0, done.stderr
    assert campaign_summary(path).state == "done"
    assert "nothing to resume" in invoke("run", "--resume", path, "--rig", rig).stderr
