"""Resuming a campaign: its rows, refusals, and journals of older schemas."""

import itertools
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import clock_for, operator_for, resume_campaign, run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.running.resume import check_same_rig, remaining_work
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, open_rig, parse_rig, read_rig
from goniotwin.app.rig.lock import lock_journal
from tests.app.campaign.campaign_bench import QUIET, THREE_SHIFTS, convert_to_schema_1, planned_values, run_until
from tests.conftest import ONE_WAY, Writer, changed
from tests.golden import contents


@pytest.fixture
def steady(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule(THREE_SHIFTS)), read_rig(write_rig(*QUIET)))


@pytest.fixture
def journals(tmp_path: Path) -> tuple[Path, Path]:
    """Copies of the golden journals, with the first version of the model's hash: a finished and an interrupted one."""
    return contents.copied(tmp_path)


@pytest.mark.parametrize(
    "shares",
    [pytest.param((0.02, 0.5, 0.98), id="three"), pytest.param((0.3, 0.45, 0.8), id="further", marks=pytest.mark.long)],
)
def test_a_campaign_stopped_at_any_time_has_the_planned_rows_of_an_undisturbed_run(
    shares: tuple[float, ...], steady: Plan, tmp_path: Path
) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    whole = planned_values(tmp_path / "whole.journal")
    for k, share in enumerate(shares):
        path = tmp_path / f"{k}.journal"
        run_until(steady, path, share * steady.seconds)
        assert campaign_summary(path).state == "stopped"
        assert len(planned_values(path)) < len(whole)
        outcome = resume_campaign(path)
        assert (outcome.state, outcome.rows, outcome.planned) == (State.DONE, len(steady.rows), len(steady.rows))
        assert planned_values(path) == whole
        assert campaign_summary(path).state == "done"


def test_a_campaign_may_be_interrupted_many_times(steady: Plan, tmp_path: Path) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    path = tmp_path / "a.journal"
    run_until(steady, path, 10.0)
    before = -1
    for _ in range(30):
        with Journal.open(path) as journal:
            done, of = journal.row_counts()
            start = journal.sessions()[-1].ended_s
        if done == of:
            break
        assert done >= before
        before = done
        _resume_until(path, start + 14.0)
    assert done == of
    assert planned_values(path) == planned_values(tmp_path / "whole.journal")
    with Journal.open(path) as journal:
        sessions = journal.sessions()
        assert len(sessions) > 3
        assert all(first.ended_s <= second.started_s for first, second in itertools.pairwise(sessions))
        starts = [each.data.started_s for each in journal.rows()]
        assert starts == sorted(starts)
        assert reduce_journal(journal).samples["gaussian-5"].good.any()


def _resume_until(path: Path, t: float) -> None:
    with Journal.reopen(path) as journal:
        rest = remaining_work(journal, None)
        with open_rig(rest.plan.rig, clock_for(rest.plan.rig.file, rest.start_s)) as opened:
            opened.connect()
            operator = operator_for(opened, rest.plan.rig.file, None)
            engine = Engine(opened.rig, rest.plan, journal, operator, work=rest.work)
            opened.rig.clock.at(t, engine.stop)
            engine.run()


def test_a_resume_starts_with_a_mount_a_dark_reading_and_a_drift_check(steady: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    run_until(steady, path, 0.9 * steady.seconds)
    done, planned = planned_values(path), len(steady.rows)
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


def test_a_finished_campaign_is_not_resumed(plan: Plan, tmp_path: Path) -> None:
    run_campaign(plan, tmp_path / "a.journal")
    before = (tmp_path / "a.journal").read_bytes()
    with pytest.raises(UserError, match=r"a\.journal: all of its 10 rows are measured"):
        resume_campaign(tmp_path / "a.journal")
    assert (tmp_path / "a.journal").read_bytes() == before


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("gear = 36.0", "gear = 35.0"), r"axes\.sigma\.gear"),
        (("gain_uncertainty = 0.001", "gain_uncertainty = 0.002"), r"photodiodes\.gain_uncertainty"),
        (("width_deg = 5.0", "width_deg = 5.5"), "virtual rig is not the one"),
        (("seed = 1", "seed = 2"), "simulated"),
    ],
)
def test_a_changed_rig_is_refused_and_the_journal_is_not_changed(
    plan: Plan, tmp_path: Path, write_rig: Writer, change: tuple[str, str], message: str
) -> None:
    path = tmp_path / "a.journal"
    run_until(plan, path, 10.0)
    before = path.read_bytes()
    with pytest.raises(UserError, match=message):
        resume_campaign(path, read_rig(write_rig(change, name="changed.toml")))
    assert path.read_bytes() == before


def test_ports_may_change(plan: Plan, tmp_path: Path, write_rig: Writer) -> None:
    path = tmp_path / "a.journal"
    run_until(plan, path, 10.0)
    other = read_rig(write_rig(("twin://virtual/", "twin://elsewhere/"), name="other.toml"))
    assert resume_campaign(path, other).state is State.DONE


def test_a_journal_in_use_is_refused_with_the_number_of_the_process(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "a.journal"
    run_until(plan, path, 10.0)
    held = lock_journal(path, "measuring paint")
    try:
        assert campaign_summary(path).state == "running"
        with pytest.raises(UserError, match=r"a\.journal: is in use by process \d+ .*measuring paint"):
            resume_campaign(path)
    finally:
        held.release()


def test_a_journal_of_schema_1_is_read_and_resumed(steady: Plan, tmp_path: Path) -> None:
    run_campaign(steady, tmp_path / "whole.journal")
    path = tmp_path / "old.journal"
    run_until(steady, path, 0.6 * steady.seconds)
    convert_to_schema_1(path)
    before = path.read_bytes()
    with Journal.open(path) as journal:
        done, of = journal.row_counts()
        assert 0 < done < of
        assert next(row.readings for row in journal.planned_rows() if row.kind == "dark") == 4
        assert len(list(journal.rows())) == done
    assert path.read_bytes() == before  # reading does not change it
    assert resume_campaign(path, steady.rig).state is State.DONE
    assert planned_values(path) == planned_values(tmp_path / "whole.journal")


def test_with_noise_the_differences_to_an_undisturbed_run_are_standard_normal(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    plan = make_plan(read_schedule(write_schedule(THREE_SHIFTS, ("readings = 2", "readings = 8"))), read_rig(write_rig()))
    run_campaign(plan, tmp_path / "whole.journal")
    run_until(plan, tmp_path / "a.journal", 0.7 * plan.seconds)
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
    assert np.any(standard != 0.0)  # the rows after the interruption have other noise
    assert np.mean(standard**2) < 1.5
    assert np.abs(standard).max() < 4.5


def golden_rig(journal: Journal) -> RigDescription:
    """The recorded rig of a golden journal, whose opal has the side that was the default then."""
    return parse_rig(changed(journal.value("rig"), (ONE_WAY,)), Path(), "rig.toml")


def rig_with_entries(recorded: RigDescription, simulated: str) -> RigDescription:
    """The rig file without its [twin], as a served rig has it, with other entries of [simulated]."""
    text = recorded.text.partition("[twin]\n")[0].replace("twin://virtual/", "served-")
    text = text.replace("[simulated]\nseed = 1\n", f"[simulated]\nseed = 1\n{simulated}\n")
    return parse_rig(text.replace('usb = "served-monitor"', 'usb = "1313:8078:TWIN0001"'), Path(), "served.toml")


def test_a_served_rig_is_recognised_by_either_version_of_its_models_hash(journals: tuple[Path, Path]) -> None:
    with Journal.open(journals[1]) as journal:
        recorded = golden_rig(journal)
        new, old = map(str, recorded.model_hashes())
        assert journal.value("model") == f'"{old}"'
        for stated in (f'model = "{new}"\nold_model = "{old}"', f'model = "{new}"', f'model = "{old}"'):
            check_same_rig(journal, recorded, rig_with_entries(recorded, stated))
        for stated in ("", 'model = "0123456789abcdef"', f'model = "{old[::-1]}"\nold_model = "2:{old}"'):
            with pytest.raises(UserError, match="the model's hash differs"):
                check_same_rig(journal, recorded, rig_with_entries(recorded, stated))


def test_a_campaign_of_a_served_rig_is_resumed_if_the_rig_states_the_recorded_hash(journals: tuple[Path, Path]) -> None:
    """The recorded rig has no [twin] from which another version of the hash could be computed."""
    with Journal.open(journals[1]) as journal:
        golden = golden_rig(journal)
        new, old = golden.model_hashes()
        recorded = rig_with_entries(golden, f'model = "{old}"')
        for stated in (f'model = "{new}"\nold_model = "{old}"', f'model = "{old}"'):
            check_same_rig(journal, recorded, rig_with_entries(golden, stated))
        with pytest.raises(UserError, match="the model's hash differs"):
            check_same_rig(journal, recorded, rig_with_entries(golden, f'model = "{new}"'))
