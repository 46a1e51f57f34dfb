"""kill -9 of a campaign over served endpoints, at any moment: what it has told is there, nothing is there twice, and it goes
on to what it would have come to undisturbed."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from goniotwin.app.campaign.campaign import resume_campaign, run_campaign
from goniotwin.app.campaign.journal.summary import campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.reduction.reduction import BsdfPoints, reduce_journal
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
from goniotwin.mocks.control import Control
from tests.app.campaign.test_resume import MORE, STEADY, as_of_schema_1, stopped_at, values
from tests.conftest import Writer
from tests.system.conftest import Serve, at
from tests.system.killable import FORKED, Fate, Killable, check_told

pytestmark = FORKED
SPEED = 10
START_S = 0.5
"""About what a process needs until it measures, so that some are killed before."""
MOST_TRIES = 8
"""On a machine that is busy elsewhere a device's answer may come too late; whoever measures then tries again."""
SAMPLE = "gaussian-5"
BLACK = (("width_deg = 5.0", "width_deg = 40.0"), ("reflectance = 0.9\n", "reflectance = 0.0009\n"))
STEPS = 2000
"""Of SQLite's machine: the journal has its name after some 1050, its first row after 1250, and a further one every 150."""
STEPS_OF_AN_OLDER_ONE = 4200
"""A copy of it is brought up to date first, in 2000 steps, then the file itself; then there is the first row."""


@dataclass
class Bench:
    """A served rig, a campaign for it with an undisturbed run on the same rig in process, and an operator."""

    folder: Path
    schedule: Path
    rig: Path
    control: Control
    plan: Plan
    lots: np.random.Generator
    complaints: list[str] = field(default_factory=list)

    def command(self, path: Path) -> Killable:
        """Goes on with a campaign; begins it where it has not come to a journal yet."""
        if path.exists():
            return Killable(self.folder, "run", "--resume", path)
        return Killable(self.folder, "run", self.schedule, "--rig", self.rig, "--out", path)

    def carry_through(self, path: Path, kills: int) -> None:
        """Begins a campaign, kills it so often, and finishes it, each time looking at what is left."""
        told: dict[int, str] = {}
        for _ in range(kills):
            process = self.command(path)
            process.killed_at(float(self.lots.uniform(0.0, START_S + self.plan.seconds / SPEED)))
            told |= process.told
            check_told(path, told)
            if path.exists() and campaign_summary(path).state == "done":  # the moment was after its end
                break
            assert not path.exists() or campaign_summary(path).state in ("killed", "empty") or self._gave_up(process)
        else:
            self._finish(path, told)
        with Journal.open(path) as journal:
            assert journal.row_counts() == (len(self.plan.rows), len(self.plan.rows))

    def _gave_up(self, process: Killable) -> bool:
        """Before it was killed, for an answer that came too late on a busy machine."""
        self.complaints += process.complaints
        return "not responding" in process.errors

    def _finish(self, path: Path, told: dict[int, str]) -> None:
        """As an operator would, who does what the messages say."""
        for _ in range(MOST_TRIES):
            process = self.command(path)
            status = process.ended()
            check_told(path, told | process.told)
            if status == 0:
                return
            assert status in (1, 2)
            assert process.complaints, process.errors
            self.complaints += process.complaints
            if "goniotwin here" in process.errors:
                for axis, angle in self.control.do("state")["angles_deg"].items():
                    assert Killable(self.folder, "here", "--rig", self.rig, axis, angle).ended() == 0
        raise AssertionError(process.errors)

    def run_undisturbed(self, rig: Path, name: str) -> Path:
        """The same campaign on a rig in this process; its journal."""
        path = self.folder / f"{name}.journal"
        run_campaign(make_plan(read_schedule(self.schedule), read_rig(rig)), path)
        return path

    def reduced(self, path: Path) -> BsdfPoints:
        """What has come of the sample."""
        with Journal.open(path) as journal:
            return reduce_journal(journal).samples[SAMPLE]


MakeBench = Callable[..., Bench]


@pytest.fixture
def bench(write_rig: Writer, write_schedule: Writer, serve: Serve, tmp_path: Path) -> Iterator[MakeBench]:
    made: list[Bench] = []

    def make(seed: int, *changes: tuple[str, str]) -> Bench:
        here, there = write_rig(*changes), tmp_path / "served.toml"
        schedule = write_schedule(MORE, ("[1e8, 1e10]", "[1e8, 1e11]"), ("dark_readings = 4", "dark_readings = 8"))
        _, lines = serve(here, "--speed", SPEED, "--write-rig", there)
        plan = make_plan(read_schedule(schedule), read_rig(here))
        control = Control(at(lines, "control", "port")["port"])
        made.append(Bench(tmp_path, schedule, there, control, plan, np.random.default_rng(seed)))
        return made[-1]

    yield make
    for each in made:
        each.control.close()


@pytest.mark.parametrize("campaigns", [pytest.param(1, id="1"), pytest.param(60, id="60", marks=pytest.mark.long)])
def test_without_noise_a_killed_campaign_comes_to_the_very_same(
    bench: MakeBench, write_rig: Writer, campaigns: int, tmp_path: Path
) -> None:
    """Counts, gains, flags, positions and the monitor of every planned row. Every third campaign is killed twice."""
    killed = bench(campaigns, *STEADY)
    undisturbed = values(killed.run_undisturbed(write_rig(*STEADY), "undisturbed"))
    for k in range(campaigns):
        path = tmp_path / f"{k}.journal"
        killed.carry_through(path, 2 if k % 3 == 2 else 1)
        assert values(path) == undisturbed
    print(f"\n{campaigns} campaigns, in the way when they were to be finished:", *killed.complaints, sep="\n  ")


@pytest.mark.parametrize("campaigns", [pytest.param(1, id="1"), pytest.param(30, id="30", marks=pytest.mark.long)])
def test_with_noise_a_killed_campaign_differs_by_its_uncertainty(
    bench: MakeBench, write_rig: Writer, campaigns: int, tmp_path: Path
) -> None:
    """A dark sample, where noise decides and not what both runs share (etalon, gains). Each campaign is held against an
    undisturbed run with noise of its own. The mean square of difference over uncertainty is 1 but for five times its own
    scatter, or for 0.2 (few darks know the noise only about, and the uncertainty is widened for that); all are within 5."""
    killed = bench(campaigns, *BLACK)
    found = []
    for k in range(campaigns):
        killed.carry_through(tmp_path / f"{k}.journal", 1)
        killed.run_undisturbed(write_rig(*BLACK, ("seed = 1", f"seed = {k + 2}"), name="other.toml"), f"undisturbed-{k}")
        first, second = killed.reduced(tmp_path / f"undisturbed-{k}.journal"), killed.reduced(tmp_path / f"{k}.journal")
        assert np.array_equal(first.good, second.good)
        good = first.good
        found.append((first.bsdf - second.bsdf)[good] / np.hypot(first.u_bsdf, second.u_bsdf)[good])
    standard = np.concatenate(found)
    print(f"\n{standard.size} values: mean square {np.mean(standard**2):.3f}, largest {np.abs(standard).max():.2f}")
    assert abs(np.mean(standard**2) - 1.0) < max(0.2, 5.0 * np.sqrt(2.0 / standard.size))
    assert np.abs(standard).max() < 5.0


def test_of_a_killed_campaign_its_list_says_so_and_what_was_measured_is_exported(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The -wal file that the program has left is read with it, and all is left as it was."""
    path = tmp_path / "a.journal"
    fate = Fate(rows=9)
    killed = Killable(tmp_path, "run", write_schedule(MORE), "--rig", write_rig(), "--out", path, fate=fate)
    assert killed.ended() < 0
    before = {file: file.read_bytes() for file in (path, Path(f"{path}-wal"))}
    listed = Killable(tmp_path, "runs", tmp_path, "--json")
    exported = Killable(tmp_path, "export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert (listed.ended(), exported.ended()) == (0, 0), listed.errors + exported.errors
    (campaign,) = json.loads(listed.output)["campaigns"]
    assert (campaign["state"], campaign["rows"], campaign["planned"]) == ("killed", 9, 12)
    assert campaign["seconds_left"] > 0.0
    assert "\ngaussian-5,550," in (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert {file: file.read_bytes() for file in before} == before


def test_what_a_killed_program_has_left_is_never_taken_for_that_of_another_journal(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Somebody moves the journal and forgets the rows in the file beside it: they may still be joined."""
    path, schedule, rig = tmp_path / "a.journal", write_schedule(), write_rig()
    command = ("run", schedule, "--rig", rig, "--out", path)
    assert Killable(tmp_path, *command, fate=Fate(rows=4)).ended() < 0
    path.rename(tmp_path / "b.journal")
    again = Killable(tmp_path, *command)
    assert again.ended() == 2
    assert again.complaints[0].startswith(
        f"goniotwin: {path}-wal: belongs to another journal of that name; move it to that journal"
    )
    Path(f"{path}-wal").rename(tmp_path / "b.journal-wal")
    assert campaign_summary(tmp_path / "b.journal").rows == 4


@pytest.mark.parametrize("times", [pytest.param(2, id="2"), pytest.param(40, id="40", marks=pytest.mark.long)])
def test_killed_while_its_journal_is_made_it_leaves_none_or_one_to_go_on_with(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, times: int
) -> None:
    """At steps of SQLite's machine, one drawn by lot from each stretch between its first statement and the first rows."""
    rig, schedule = write_rig(*STEADY), write_schedule()
    plan = make_plan(read_schedule(schedule), read_rig(rig))
    run_campaign(plan, tmp_path / "undisturbed.journal")
    outcomes = []
    for k, part in enumerate(np.random.default_rng(times).uniform(size=times)):
        path = tmp_path / f"{k}.journal"
        command = ("run", schedule, "--rig", rig, "--out", path)
        killed = Killable(tmp_path, *command, fate=Fate(steps=1 + int((k + part) / times * STEPS)))
        assert killed.ended() < 0
        check_told(path, killed.told)
        outcomes.append(path.exists())
        if path.exists():
            assert campaign_summary(path).state in ("empty", "killed")
            assert resume_campaign(path).state is State.DONE
        else:
            again = Killable(tmp_path, *command)
            assert again.ended() == 0, again.errors
        assert values(path) == values(tmp_path / "undisturbed.journal")
    assert (outcomes[0], outcomes[-1]) == (False, True)
    assert not list(tmp_path.glob(".*.new*"))


@pytest.mark.parametrize("times", [pytest.param(1, id="1"), pytest.param(30, id="30", marks=pytest.mark.long)])
def test_killed_while_a_journal_of_an_older_schema_is_brought_up_to_date_it_has_lost_nothing(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, times: int
) -> None:
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(*STEADY)))
    run_campaign(plan, tmp_path / "undisturbed.journal")
    for k, part in enumerate(np.random.default_rng(times).uniform(size=times)):
        path = tmp_path / f"{k}.journal"
        stopped_at(plan, path, 0.6 * plan.seconds)
        done = campaign_summary(path).rows
        as_of_schema_1(path)
        fate = Fate(steps=1 + int((k + part) / times * STEPS_OF_AN_OLDER_ONE))
        assert Killable(tmp_path, "run", "--resume", path, "--rig", plan.rig.name, fate=fate).ended() < 0
        assert campaign_summary(path).rows >= done
        assert resume_campaign(path, plan.rig).state is State.DONE
        assert values(path) == values(tmp_path / "undisturbed.journal")


@pytest.mark.parametrize("resumed", [False, True])
def test_of_two_processes_on_one_journal_the_second_is_told_who_has_it(
    write_rig: Writer, write_schedule: Writer, serve: Serve, tmp_path: Path, resumed: bool
) -> None:
    """One that runs or resumes it, and one that would resume it; and one that would begin it anew."""
    rig, path, schedule = tmp_path / "served.toml", tmp_path / "a.journal", write_schedule()
    serve(write_rig(*STEADY), "--write-rig", rig)  # in real time it takes long enough
    first = Killable(tmp_path, "run", schedule, "--rig", rig, "--out", path)
    first.has_told(1)
    if resumed:
        first.killed()
        first = Killable(tmp_path, "run", "--resume", path)
        first.has_told(1)
    told = f"{path}: is in use by process {first.pid} of "
    for second in (
        Killable(tmp_path, "run", "--resume", path),
        Killable(tmp_path, "run", schedule, "--rig", rig, "--out", path),
    ):
        assert second.ended() == 2
        (line,) = second.complaints
        assert line.startswith(f"goniotwin: {told}")
        assert line.endswith("; wait for it, or end it")
    listed = Killable(tmp_path, "runs", tmp_path, "--json")
    assert listed.ended() == 0, listed.errors
    assert json.loads(listed.output)["campaigns"][0]["state"] == "running"
    first.killed()
    assert campaign_summary(path).state == "killed"
