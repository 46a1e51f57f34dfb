"""The chain of hashes: what differs from what was committed is named; its row has no values and is measured again."""

import contextlib
import json
import shutil
import sqlite3
from pathlib import Path

import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.reading import DamagedJournal
from goniotwin.app.campaign.journal.summary import campaign_summaries
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.cli.main import app
from goniotwin.app.rig import parse_rig
from tests.app.campaign.campaign_bench import QUIET, planned_values
from tests.conftest import ONE_WAY, RIG, SMALL, changed
from tests.golden import files

pytestmark = pytest.mark.xdist_group("chain")

LAST = "(SELECT MAX(number) FROM attempt)"
SAMPLE_ROW = "(SELECT number FROM plan WHERE sample = 'gaussian-5' AND kind = 'measure' LIMIT 1)"


@pytest.fixture(scope="module")
def steady() -> Plan:
    rig = parse_rig(changed(RIG.read_text(encoding="utf-8"), QUIET), RIG.parent, "rig.toml")
    return make_plan(parse_schedule(SMALL, "schedule.toml"), rig)


@pytest.fixture(scope="module")
def whole(steady: Plan, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("whole") / "a.journal"
    assert run_campaign(steady, path).state is State.DONE
    return path


@pytest.fixture
def copy(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copyfile(whole, tmp_path / "a.journal"))


def change(path: Path, *statements: str) -> None:
    """Change a journal by SQL, past its chain."""
    with contextlib.closing(sqlite3.connect(path)) as db, db:
        for statement in statements:
            assert db.execute(statement).rowcount, statement


def test_repeats_of_a_campaign_have_the_same_tip(steady: Plan, whole: Path, tmp_path: Path) -> None:
    again = run_campaign(steady, tmp_path / "again.journal").chain
    with Journal.open(whole) as journal, contextlib.closing(sqlite3.connect(whole)) as db:
        assert journal.chain == again
        assert not journal.chain.damage
        assert len(steady.rows) == again.length
        assert db.execute("SELECT last_link, tip FROM session").fetchall() == [(again.length, again.tip)]
        assert [again.tip] == [tip for (tip,) in db.execute("SELECT sha256 FROM chain ORDER BY link DESC LIMIT 1")]


ROW_DAMAGES = {
    "counts": f"UPDATE reading SET counts = zeroblob(length(counts)) WHERE number = {SAMPLE_ROW}",
    "monitor": f"UPDATE reading SET monitor_a = 1.0001 * monitor_a WHERE number = {SAMPLE_ROW}",
    "gain": f"UPDATE reading SET gain_v_per_a = 1e9 WHERE number = {SAMPLE_ROW} AND gain_v_per_a = 1e10",
    "a reading fewer": f"DELETE FROM reading WHERE number = {SAMPLE_ROW} AND gain_v_per_a = 1e8",
    "time": f"UPDATE attempt SET started_s = started_s + 1.0 WHERE number = {SAMPLE_ROW}",
    "positions": f"UPDATE attempt SET positions = replace(positions, '1', '2') WHERE number = {SAMPLE_ROW}",
    "flags": f"""UPDATE attempt SET flags = '["drift"]' WHERE number = {SAMPLE_ROW}""",
    "skipped": f"""UPDATE attempt SET flags = '["skipped"]' WHERE number = {SAMPLE_ROW}""",
    "pose": f"UPDATE plan SET beta_deg = beta_deg + 1.0 WHERE number = {SAMPLE_ROW}",
    "kind": f"UPDATE plan SET kind = 'drift' WHERE number = {SAMPLE_ROW}",
    "not UTF-8": f"UPDATE attempt SET flags = CAST(x'5bff5d' AS TEXT) WHERE number = {SAMPLE_ROW}",
    "attempt": f"UPDATE attempt SET attempt = 2 WHERE number = {SAMPLE_ROW}",
    "lost": f"DELETE FROM attempt WHERE number = {SAMPLE_ROW}",
    "link": f"DELETE FROM chain WHERE number = {LAST}",
    "hash": f"UPDATE chain SET sha256 = replace(sha256, '0', '1') WHERE number = {SAMPLE_ROW}",
    "last row": f"DELETE FROM attempt WHERE number = {LAST}",
}


@pytest.mark.parametrize("damage", ROW_DAMAGES)
def test_a_damaged_row_is_named_and_has_no_values(whole: Path, copy: Path, damage: str) -> None:
    change(copy, ROW_DAMAGES[damage])
    with Journal.open(copy) as journal, Journal.open(whole) as undamaged:
        (number,) = journal.chain.damaged
        assert journal.committed_numbers() == undamaged.committed_numbers() - {number}
        with pytest.raises(DamagedJournal, match=rf"a\.journal: differs from what was measured: row {number} \("):
            reduce_journal(journal)
        sound = [each.row.number for each in undamaged.rows() if each.row.number != number]
        assert [each.row.number for each in journal.rows()] == sound
        assert number not in journal.row_index()[0]["number"]
        assert list(journal.rows_of([number])) == []


def test_an_altered_hash_blames_no_other_row(whole: Path, copy: Path) -> None:
    for link in (1, 5, 10):
        shutil.copyfile(whole, copy)
        change(copy, f"UPDATE chain SET sha256 = 'f' || sha256 WHERE link = {link}")
        with Journal.open(copy) as journal:
            assert len(journal.chain.damaged) == 1


DELETE_ROW = [f"DELETE FROM {table} WHERE number = {{}}" for table in ("chain", "reading", "attempt")]
OTHER_DAMAGES = {
    "the last row": [each.format(8) for each in DELETE_ROW],
    "a row in the middle": [each.format(4) for each in DELETE_ROW],
    "session 1": ["UPDATE session SET rig = replace(rig, '1', '2')"],
    "tip": ["UPDATE session SET tip = 'f' || tip"],
    "plan": ["UPDATE plan SET seconds = seconds + 1.0"],
    "no session": ["DELETE FROM session"],
}


@pytest.mark.parametrize("damage", OTHER_DAMAGES)
def test_what_else_is_damaged_is_named(copy: Path, damage: str) -> None:
    change(copy, *OTHER_DAMAGES[damage])
    with Journal.open(copy) as journal:
        assert journal.chain.parts
        with pytest.raises(DamagedJournal, match=r"a\.journal: differs from what was measured: "):
            reduce_journal(journal)
    with pytest.raises(DamagedJournal, match=r"a\.journal: is damaged: "):
        resume_campaign(copy)


@pytest.mark.parametrize("entry", ["schedule", "rig", "name", "simulated", "seed", "model", "versions", "rig_folder", "chain"])
def test_a_journal_with_a_damaged_entry_is_not_read(copy: Path, entry: str) -> None:
    change(copy, f"UPDATE campaign SET value = value || ' ' || value WHERE key = '{entry}'")
    with pytest.raises(DamagedJournal, match=rf"is damaged: its entry '{entry}' "):
        Journal.open(copy)


def export(journal: Path, out: Path, *options: str) -> int:
    """Export a journal as the command does; return its status."""
    try:
        return int(app(["export", str(journal), "--format", "csv", "--out", str(out), *options], standalone_mode=False) or 0)
    except DamagedJournal as error:
        return error.status


def test_an_export_of_a_damaged_journal_writes_nothing_unless_asked_for(
    whole: Path, copy: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, sound = tmp_path / "damaged.csv", tmp_path / "sound.csv"
    assert export(whole, sound, "--json") == 0
    stated = json.loads(capsys.readouterr().out)["chain"]
    change(copy, ROW_DAMAGES["monitor"])
    (listed,), (error,) = campaign_summaries(copy.parent)
    assert error.startswith(f"{copy}: differs from what was measured: row ")
    assert listed.rows == listed.planned - 1
    assert export(copy, out) == 1
    assert not out.exists()
    assert export(copy, out, "--without-damaged", "--json") == 0
    answer = json.loads(capsys.readouterr().out)
    (number,) = answer["damaged"]
    before, after = (file.read_text(encoding="utf-8").splitlines() for file in (sound, out))
    assert f"# journal: {stated['length']} rows in the chain of checksums, tip {stated['tip']}" in before
    assert any(f"damaged rows, without values: {number};" in line for line in after)
    places, left = ([line.split(",")[:7] for line in lines if not line.startswith("#")] for lines in (before, after))
    assert 1 < len(left) < len(places)
    assert all(place in places for place in left)


@pytest.mark.parametrize("damage", ["counts", "hash", "lost"])
def test_a_resume_measures_a_damaged_row_again(whole: Path, copy: Path, tmp_path: Path, damage: str) -> None:
    change(copy, ROW_DAMAGES[damage])
    outcome = resume_campaign(copy)
    assert outcome.state is State.DONE
    assert not outcome.chain.damage
    assert planned_values(copy) == planned_values(whole)
    with Journal.open(copy) as journal:
        assert not journal.chain.damage
        assert journal.chain == outcome.chain
        reduce_journal(journal)


def test_a_journal_without_a_chain_states_it_and_its_chain_begins_with_the_resume(tmp_path: Path) -> None:
    path = Path(shutil.copyfile(files.DATA / "interrupted.journal", tmp_path / "a.journal"))
    with Journal.open(path) as journal:
        before, rig = len(journal.committed_numbers()), changed(journal.value("rig"), (ONE_WAY,))
        assert journal.chain.statement == "no checksums: an earlier version of the program wrote this journal"
    chain = resume_campaign(path, parse_rig(rig, tmp_path, "rig.toml")).chain
    assert (chain.unchecked, chain.damage) == (before, "")
    assert (
        chain.statement
        == f"{chain.length} rows in the chain of checksums, tip {chain.tip}; {before} rows before it have no checksums"
    )
    change(
        path,
        "UPDATE reading SET monitor_a = 2.0 * monitor_a WHERE number = (SELECT MAX(number) FROM plan WHERE session IS NULL)",
    )
    with Journal.open(path) as journal:
        assert len(journal.chain.damaged) == 1


def test_a_changed_entry_that_looks_like_two_is_found(copy: Path) -> None:
    """Some rows are encoded together, as lists one after the other."""
    change(copy, "UPDATE chain SET sha256 = '], [' WHERE link = 3")
    with Journal.open(copy) as journal:
        assert len(journal.chain.damaged) == 1
        assert journal.chain.length == len(journal.planned_rows())
