"""Going on with a campaign: what is measured then, what is refused, and what a killed program leaves."""

import itertools
import sqlite3
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import clock_for, operator_for, resume_campaign, run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.reduction import reduce_journal
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.resume import check_same_rig, recorded_rig
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, open_rig, parse_rig, read_rig
from goniotwin.app.rig.lock import RigLock
from tests.conftest import Writer
from tests.golden import contents

STEADY = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))
MORE = ("shift_deg = [0, 1]", "shift_deg = [0, 1, 2]")
VALUES = """
SELECT plan.identity, plan.kind, attempt.positions, attempt.flags, gain_v_per_a, monitor_a, readings, channels, counts
FROM plan JOIN attempt USING (number) LEFT JOIN reading USING (number, attempt)
WHERE plan.session IS NULL AND attempt.attempt = (SELECT MAX(attempt) FROM attempt latest WHERE latest.number = plan.number)
ORDER BY plan.number, gain_v_per_a
"""


def values(journal: Path) -> list[tuple[Any, ...]]:
    connection = sqlite3.connect(journal)
    try:
        return connection.execute(VALUES).fetchall()
    finally:
        connection.close()


def stopped_at(plan: Plan, path: Path, t: float) -> None:
    """A run that somebody stops at a time of the rig's clock."""
    with open_rig(plan.rig, clock_for(plan.rig.file)) as opened:
        opened.connect()
        with Journal.create(path, plan, {}) as journal:
            engine = Engine(opened.rig, plan, journal, operator_for(opened, plan.rig.file, None))
            opened.rig.clock.at(t, engine.stop)
            assert engine.run() is State.IDLE


@pytest.fixture
def steady(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule(MORE)), read_rig(write_rig(*STEADY)))


@pytest.fixture
def journals(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the golden ones, which have the first version of the model's hash: a finished and an interrupted one."""
    return contents.copied(tmp_path)


def test_wherever_it_was_stopped_the_planned_rows_are_those_of_an_undisturbed_run(steady: Plan, tmp_path: Path) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    whole = values(tmp_path / "whole.journal")
    for k, share in enumerate((0.02, 0.3, 0.45, 0.5, 0.8, 0.98)):
        path = tmp_path / f"{k}.journal"
        stopped_at(steady, path, share * steady.seconds)
        assert campaign_summary(path).state == "stopped"
        assert len(values(path)) < len(whole)
        outcome = resume_campaign(path)
        assert (outcome.state, outcome.rows, outcome.planned) == (State.DONE, len(steady.rows), len(steady.rows))
        assert values(path) == whole
        assert campaign_summary(path).state == "done"


def test_a_campaign_may_be_interrupted_many_times(steady: Plan, tmp_path: Path) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    path = tmp_path / "a.journal"
    stopped_at(steady, path, 10.0)
    before = -1
    for _ in range(30):
        with Journal.open(path) as journal:
            done, of = journal.row_counts()
            start = journal.sessions()[-1].ended_s
        if done == of:
            break
        assert done >= before
        before = done
        _resumed_and_stopped(path, start + 14.0)
    assert done == of
    assert values(path) == values(tmp_path / "whole.journal")
    with Journal.open(path) as journal:
        sessions = journal.sessions()
        assert len(sessions) > 3
        assert all(first.ended_s <= second.started_s for first, second in itertools.pairwise(sessions))
        starts = [each.data.started_s for each in journal.rows()]
        assert starts == sorted(starts)
        assert reduce_journal(journal).samples["gaussian-5"].good.any()


def _resumed_and_stopped(path: Path, t: float) -> None:
    from goniotwin.app.campaign.running.resume import remaining_work

    with Journal.reopen(path) as journal:
        rest = remaining_work(journal, None)
        with open_rig(rest.plan.rig, clock_for(rest.plan.rig.file, rest.start_s)) as opened:
            opened.connect()
            operator = operator_for(opened, rest.plan.rig.file, None)
            engine = Engine(opened.rig, rest.plan, journal, operator, work=rest.work)
            opened.rig.clock.at(t, engine.stop)
            engine.run()


def test_before_it_goes_on_the_sample_is_mounted_a_dark_taken_and_the_light_compared(steady: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    stopped_at(steady, path, 0.9 * steady.seconds)
    done, planned = values(path), len(steady.rows)
    resume_campaign(path)
    database = sqlite3.connect(path)
    added = database.execute(
        "SELECT identity, kind, sample, session FROM plan WHERE session IS NOT NULL ORDER BY number"
    ).fetchall()
    order = [number for (number,) in database.execute("SELECT number FROM attempt ORDER BY started_s")]
    database.close()
    sample = done[-1][0].split("/")[0]
    assert added == [(f"resumed 2/{sample}/{kind}", kind, sample, 2) for kind in ("mount", "dark", "drift")]
    first = order.index(planned)
    assert order[:first] == list(range(first))
    assert order[first : first + 4] == [planned, planned + 1, planned + 2, first]


def test_a_finished_campaign_has_nothing_to_go_on_with(plan: Plan, tmp_path: Path) -> None:
    run_campaign(plan, tmp_path / "a.journal")
    before = (tmp_path / "a.journal").read_bytes()
    with pytest.raises(UserError, match=r"a\.journal: all of its 10 rows are measured"):
        resume_campaign(tmp_path / "a.journal")
    assert (tmp_path / "a.journal").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (("gear = 36.0", "gear = 35.0"), r"axes\.sigma\.gear"),
        (("gain_uncertainty = 0.001", "gain_uncertainty = 0.002"), r"photodiodes\.gain_uncertainty"),
        (("width_deg = 5.0", "width_deg = 5.5"), "virtual rig is not the one"),
        (("seed = 1", "seed = 2"), "simulated"),
    ],
)
def test_a_rig_that_has_changed_is_refused_and_nothing_is_lost(
    plan: Plan, tmp_path: Path, write_rig: Writer, change: tuple[str, str], told: str
) -> None:
    path = tmp_path / "a.journal"
    stopped_at(plan, path, 10.0)
    before = path.read_bytes()
    with pytest.raises(UserError, match=told):
        resume_campaign(path, read_rig(write_rig(change, name="changed.toml")))
    assert path.read_bytes() == before


def test_ports_may_change(plan: Plan, tmp_path: Path, write_rig: Writer) -> None:
    path = tmp_path / "a.journal"
    stopped_at(plan, path, 10.0)
    other = read_rig(write_rig(("twin://virtual/", "twin://elsewhere/"), name="other.toml"))
    assert resume_campaign(path, other).state is State.DONE


def test_a_journal_that_another_program_works_on_is_refused_with_who_has_it(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    stopped_at(plan, path, 10.0)
    held = RigLock([str(path.absolute())], "measuring paint")
    try:
        assert campaign_summary(path).state == "running"
        with pytest.raises(UserError, match=r"a\.journal: is in use by process \d+ .*measuring paint"):
            resume_campaign(path)
    finally:
        held.release()


def test_a_journal_of_the_first_schema_is_read_and_gone_on_with(steady: Plan, tmp_path: Path) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    path = tmp_path / "old.journal"
    stopped_at(steady, path, 0.6 * steady.seconds)
    as_of_schema_1(path)
    before = path.read_bytes()
    with Journal.open(path) as journal:
        done, of = journal.row_counts()
        assert 0 < done < of
        assert next(row.readings for row in journal.planned_rows() if row.kind == "dark") == 4
        assert len(list(journal.rows())) == done
    assert path.read_bytes() == before  # to be looked at it is not changed
    assert resume_campaign(path, steady.rig).state is State.DONE
    assert values(path) == values(tmp_path / "whole.journal")


SCHEMA_1 = """
CREATE TABLE campaign (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE plan (
    number INTEGER PRIMARY KEY, identity TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, sample TEXT NOT NULL,
    wavelength_nm REAL, gamma_deg REAL, sigma_deg REAL, beta_deg REAL, shift_deg REAL, seconds REAL NOT NULL
) STRICT;
CREATE TABLE attempt (
    number INTEGER NOT NULL REFERENCES plan, attempt INTEGER NOT NULL, started_s REAL NOT NULL, ended_s REAL NOT NULL,
    positions TEXT, flags TEXT NOT NULL, PRIMARY KEY (number, attempt)
) STRICT;
CREATE TABLE reading (
    number INTEGER NOT NULL, attempt INTEGER NOT NULL, gain_v_per_a REAL NOT NULL, first_s REAL NOT NULL,
    period_s REAL NOT NULL, monitor_a REAL NOT NULL, readings INTEGER NOT NULL, channels INTEGER NOT NULL,
    counts BLOB NOT NULL, PRIMARY KEY (number, attempt, gain_v_per_a),
    FOREIGN KEY (number, attempt) REFERENCES attempt
) STRICT;
CREATE TABLE event (id INTEGER PRIMARY KEY, t_s REAL NOT NULL, kind TEXT NOT NULL, text TEXT NOT NULL) STRICT;
CREATE TABLE session (
    id INTEGER PRIMARY KEY, started_s REAL NOT NULL, ended_s REAL, outcome TEXT, wall_started TEXT NOT NULL, wall_ended TEXT
) STRICT;
"""


def as_of_schema_1(path: Path) -> None:
    """The same as an older goniotwin wrote it."""
    now = path.rename(path.with_suffix(".now"))
    database = sqlite3.connect(path)
    database.executescript(SCHEMA_1)
    database.execute("ATTACH ? AS now", (str(now),))
    for table in ("campaign", "plan", "attempt", "reading", "event", "session"):
        columns = ", ".join(name for _, name, *_ in database.execute(f"PRAGMA main.table_info({table})"))
        database.execute(f"INSERT INTO main.{table} SELECT {columns} FROM now.{table}")
    database.execute("DELETE FROM campaign WHERE key = 'rig_folder'")
    database.commit()
    database.execute("PRAGMA application_id = 0x474F4E49")
    database.execute("PRAGMA user_version = 1")
    database.close()


def test_with_noise_the_differences_to_an_undisturbed_run_are_standard_normal(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = make_plan(read_schedule(write_schedule(MORE, ("readings = 2", "readings = 8"))), read_rig(write_rig()))
    run_campaign(plan, tmp_path / "whole.journal")
    stopped_at(plan, tmp_path / "a.journal", 0.7 * plan.seconds)
    with Journal.open(tmp_path / "a.journal") as journal:
        before = journal.row_counts()[0]
    resume_campaign(tmp_path / "a.journal")
    assert before < len(plan.rows) - 2
    found = []
    for name in ("whole", "a"):
        with Journal.open(tmp_path / f"{name}.journal") as journal:
            found.append(reduce_journal(journal).samples["gaussian-5"])
    first, second = found
    good = first.good & second.good
    assert np.array_equal(first.good, second.good)
    standard = (first.bsdf - second.bsdf)[good] / np.hypot(first.u_bsdf, second.u_bsdf)[good]
    assert np.any(standard != 0.0)  # the rows after the break are other draws
    assert np.mean(standard**2) < 1.5
    assert np.abs(standard).max() < 4.5


def stating(recorded: RigDescription, simulated: str) -> RigDescription:
    """The rig's file without its [twin], as where another process serves it, with other entries of [simulated]."""
    text = recorded.text.partition("[twin]\n")[0].replace("twin://virtual/", "served-")
    text = text.replace("[simulated]\nseed = 1\n", f"[simulated]\nseed = 1\n{simulated}\n")
    return parse_rig(text.replace('usb = "served-monitor"', 'usb = "1313:8078:TWIN0001"'), Path(), "served.toml")


def test_a_served_rig_is_known_by_either_version_of_its_models_hash(journals: tuple[Path, Path]) -> None:
    with Journal.open(journals[1]) as journal:
        recorded = recorded_rig(journal)
        new, old = map(str, recorded.model_hashes())
        assert journal.value("model") == f'"{old}"'
        for stated in (f'model = "{new}"\nold_model = "{old}"', f'model = "{new}"', f'model = "{old}"'):
            check_same_rig(journal, recorded, stating(recorded, stated))
        for stated in ("", 'model = "0123456789abcdef"', f'model = "{old[::-1]}"\nold_model = "2:{old}"'):
            with pytest.raises(UserError, match="the model's hash differs"):
                check_same_rig(journal, recorded, stating(recorded, stated))


def test_a_campaign_of_a_served_rig_is_resumed_where_the_hash_that_it_has_is_stated(journals: tuple[Path, Path]) -> None:
    """Its own rig file has no [twin] of which another version could be computed."""
    with Journal.open(journals[1]) as journal:
        new, old = recorded_rig(journal).model_hashes()
        recorded = stating(recorded_rig(journal), f'model = "{old}"')
        for stated in (f'model = "{new}"\nold_model = "{old}"', f'model = "{old}"'):
            check_same_rig(journal, recorded, stating(recorded_rig(journal), stated))
        with pytest.raises(UserError, match="the model's hash differs"):
            check_same_rig(journal, recorded, stating(recorded_rig(journal), f'model = "{new}"'))
