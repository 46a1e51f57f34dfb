"""A campaign over served endpoints that is killed (SIGKILL) at any moment and resumed.

Each committed row is in the journal, no row is there twice, and the resumed campaign gives the values of an undisturbed one.
"""

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
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.running.events import State
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import read_rig
from goniotwin.mocks.control import ControlClient
from tests.app.campaign.campaign_bench import QUIET, THREE_SHIFTS, convert_to_schema_1, planned_values, run_until
from tests.conftest import Writer
from tests.system.command_process import FORKED, CommandProcess, Limits, check_committed
from tests.system.conftest import ForkedServe, control_client

pytestmark = FORKED
SPEED = 10
START_S = 0.2
"""Approximate time until a process measures, so that some are killed before."""
MAX_TRIES = 8
"""Number of attempts: on a busy machine the answer of a device may come too late."""
SAMPLE = "gaussian-5"
BLACK = (("width_deg = 5.0", "width_deg = 40.0"), ("reflectance = 0.9\n", "reflectance = 0.0009\n"))
STEPS = 3000
"""Steps of SQLite's virtual machine: the journal gets its name after about 1450, its first row after 1850, and a further row
every 300.
"""
MIGRATION_STEPS = 9000
"""Steps for a journal of schema 1: first a copy is migrated and checked, then the file; then the first row follows."""


@dataclass
class Bench:
    """A served rig and a campaign for it, with an undisturbed run on the same rig in this process."""

    folder: Path
    schedule: Path
    rig: Path
    control: ControlClient
    plan: Plan
    rng: np.random.Generator
    error_lines: list[str] = field(default_factory=list)

    def command(self, path: Path) -> CommandProcess:
        """Resume the campaign of a journal; start it where there is no journal yet."""
        if path.exists():
            return CommandProcess(self.folder, "run", "--resume", path)
        return CommandProcess(self.folder, "run", self.schedule, "--rig", self.rig, "--out", path)

    def run_with_kills(self, path: Path, kills: int) -> None:
        """Start a campaign, kill it `kills` times, and finish it; check the journal each time."""
        committed: dict[int, str] = {}
        for _ in range(kills):
            process = self.command(path)
            process.kill_at(float(self.rng.uniform(0.0, START_S + self.plan.seconds / SPEED)))
            committed |= process.committed
            check_committed(path, committed)
            if path.exists() and campaign_summary(path).state == "done":  # killed after its end
                break
            assert not path.exists() or campaign_summary(path).state in ("killed", "empty") or self._failed(process)
        else:
            self._finish(path, committed)
        with Journal.open(path) as journal:
            assert journal.row_counts() == (len(self.plan.rows), len(self.plan.rows))

    def _failed(self, process: CommandProcess) -> bool:
        """Whether it failed before it was killed, because an answer came too late on a busy machine."""
        self.error_lines += process.error_lines
        return "not responding" in process.errors

    def _finish(self, path: Path, committed: dict[int, str]) -> None:
        """Resume until the campaign is done, and follow the instructions of the error messages."""
        for _ in range(MAX_TRIES):
            process = self.command(path)
            status = process.wait()
            check_committed(path, committed | process.committed)
            if status == 0:
                return
            assert status in (1, 2)
            assert process.error_lines, process.errors
            self.error_lines += process.error_lines
            if "goniotwin here" in process.errors:
                for axis, angle in self.control.do("state")["angles_deg"].items():
                    assert CommandProcess(self.folder, "here", "--rig", self.rig, axis, angle).wait() == 0
        raise AssertionError(process.errors)

    def run_undisturbed(self, rig: Path, name: str) -> Path:
        """Run the same campaign on a rig in this process; return its journal."""
        path = self.folder / f"{name}.journal"
        run_campaign(make_plan(read_schedule(self.schedule), read_rig(rig)), path)
        return path

    def points(self, path: Path) -> BsdfPoints:
        """The reduced points of the sample."""
        with Journal.open(path) as journal:
            return reduce_journal(journal).samples[SAMPLE]


MakeBench = Callable[..., Bench]


@pytest.fixture
def bench(write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path) -> Iterator[MakeBench]:
    made: list[Bench] = []

    def make(seed: int, *changes: tuple[str, str]) -> Bench:
        here, there = write_rig(*changes), tmp_path / "served.toml"
        schedule = write_schedule(THREE_SHIFTS, ("[1e8, 1e10]", "[1e8, 1e11]"), ("dark_readings = 4", "dark_readings = 8"))
        lines = forked_serve(here, "--speed", SPEED, "--write-rig", there)
        plan = make_plan(read_schedule(schedule), read_rig(here))
        control = control_client(lines)
        made.append(Bench(tmp_path, schedule, there, control, plan, np.random.default_rng(seed)))
        return made[-1]

    yield make
    for each in made:
        each.control.close()


@pytest.mark.parametrize("campaigns", [pytest.param(1, id="1"), pytest.param(60, id="60", marks=pytest.mark.long)])
def test_without_noise_a_killed_campaign_gives_the_same_values(
    bench: MakeBench, write_rig: Writer, campaigns: int, tmp_path: Path
) -> None:
    """Counts, gains, flags, positions and monitor of every planned row are equal. Every third campaign is killed twice."""
    killed = bench(campaigns, *QUIET)
    undisturbed = planned_values(killed.run_undisturbed(write_rig(*QUIET), "undisturbed"))
    for k in range(campaigns):
        path = tmp_path / f"{k}.journal"
        killed.run_with_kills(path, 2 if k % 3 == 2 else 1)
        assert planned_values(path) == undisturbed
    print(f"\n{campaigns} campaigns; errors while they were finished:", *killed.error_lines, sep="\n  ")


@pytest.mark.long
@pytest.mark.parametrize("campaigns", [30])
def test_with_noise_a_killed_campaign_differs_within_its_uncertainty(
    bench: MakeBench, write_rig: Writer, campaigns: int, tmp_path: Path
) -> None:
    """Each campaign is compared with an undisturbed run with other noise.

    The sample is dark, so that noise dominates the contributions that both runs share (etalon, gains). The mean square of
    difference over uncertainty is 1 within five times its own standard deviation, or within 0.2: few dark readings give the
    noise only roughly, and the uncertainty is widened for that. All differences are below 5 uncertainties.

    The resumed campaign repeats the last row. Now and then one of the many photodiodes is beyond 4 uncertainties there by
    chance, and its values are flagged as drifted: about one in ten runs of 30 campaigns has such a photodiode.
    """
    killed = bench(campaigns, *BLACK)
    found, flagged = [], 0
    for k in range(campaigns):
        killed.run_with_kills(tmp_path / f"{k}.journal", 1)
        killed.run_undisturbed(write_rig(*BLACK, ("seed = 1", f"seed = {k + 2}"), name="other.toml"), f"undisturbed-{k}")
        first, second = killed.points(tmp_path / f"undisturbed-{k}.journal"), killed.points(tmp_path / f"{k}.journal")
        assert np.array_equal(first.good, second.good | second.flag("drift"))
        good = second.good
        flagged += int(second.flag("drift").sum())
        found.append((first.bsdf - second.bsdf)[good] / np.hypot(first.u_bsdf, second.u_bsdf)[good])
    standard = np.concatenate(found)
    assert flagged <= max(6, 0.02 * standard.size)  # a photodiode has at most six values in a campaign
    square, largest = float(np.mean(standard**2)), float(np.abs(standard).max())
    print(f"\n{standard.size} values, {flagged} flagged: mean square {square:.3f}, largest {largest:.2f}")
    assert abs(square - 1.0) < max(0.2, 5.0 * np.sqrt(2.0 / standard.size))
    assert largest < 5.0


@pytest.mark.long
def test_a_killed_campaign_is_listed_as_killed_and_can_be_exported(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The -wal file left by the program is read too, and no file is changed."""
    path = tmp_path / "a.journal"
    limits = Limits(rows=9)
    killed = CommandProcess(tmp_path, "run", write_schedule(THREE_SHIFTS), "--rig", write_rig(), "--out", path, limits=limits)
    assert killed.wait() < 0
    before = {file: file.read_bytes() for file in (path, Path(f"{path}-wal"))}
    listed = CommandProcess(tmp_path, "runs", tmp_path, "--json")
    exported = CommandProcess(tmp_path, "export", path, "--format", "csv", "--out", tmp_path / "a.csv")
    assert (listed.wait(), exported.wait()) == (0, 0), listed.errors + exported.errors
    (campaign,) = json.loads(listed.output)["campaigns"]
    assert (campaign["state"], campaign["rows"], campaign["planned"]) == ("killed", 9, 12)
    assert campaign["seconds_left"] > 0.0
    assert "\ngaussian-5,550," in (tmp_path / "a.csv").read_text(encoding="utf-8")
    assert {file: file.read_bytes() for file in before} == before


@pytest.mark.long
def test_the_wal_file_of_a_killed_program_is_not_applied_to_another_journal(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The journal is moved without its -wal file, which has rows: both can be joined again."""
    path, schedule, rig = tmp_path / "a.journal", write_schedule(), write_rig()
    command = ("run", schedule, "--rig", rig, "--out", path)
    assert CommandProcess(tmp_path, *command, limits=Limits(rows=4)).wait() < 0
    path.rename(tmp_path / "b.journal")
    again = CommandProcess(tmp_path, *command)
    assert again.wait() == 2
    assert again.error_lines[0].startswith(
        f"goniotwin: {path}-wal: belongs to another journal of that name; move it to that journal"
    )
    Path(f"{path}-wal").rename(tmp_path / "b.journal-wal")
    assert campaign_summary(tmp_path / "b.journal").rows == 4


@pytest.mark.parametrize(
    "times", [pytest.param(2, id="2", marks=pytest.mark.long), pytest.param(40, id="40", marks=pytest.mark.long)]
)
def test_a_program_killed_while_it_creates_its_journal_leaves_none_or_a_resumable_one(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, times: int
) -> None:
    """At random steps of SQLite's virtual machine, one in each interval between its first statement and the first rows."""
    rig, schedule = write_rig(*QUIET), write_schedule()
    plan = make_plan(read_schedule(schedule), read_rig(rig))
    run_campaign(plan, tmp_path / "undisturbed.journal")
    outcomes = []
    for k, part in enumerate(np.random.default_rng(times).uniform(size=times)):
        path = tmp_path / f"{k}.journal"
        command = ("run", schedule, "--rig", rig, "--out", path)
        killed = CommandProcess(tmp_path, *command, limits=Limits(steps=1 + int((k + part) / times * STEPS)))
        assert killed.wait() < 0
        check_committed(path, killed.committed)
        outcomes.append(path.exists())
        if path.exists():
            assert campaign_summary(path).state in ("empty", "killed")
            assert resume_campaign(path).state is State.DONE
        else:
            again = CommandProcess(tmp_path, *command)
            assert again.wait() == 0, again.errors
        assert planned_values(path) == planned_values(tmp_path / "undisturbed.journal")
    assert (outcomes[0], outcomes[-1]) == (False, True)
    assert not list(tmp_path.glob(".*new*"))


@pytest.mark.parametrize("times", [pytest.param(1, id="1"), pytest.param(30, id="30", marks=pytest.mark.long)])
def test_a_program_killed_while_it_migrates_a_journal_loses_no_row(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path, times: int
) -> None:
    plan = make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET)))
    run_campaign(plan, tmp_path / "undisturbed.journal")
    for k, part in enumerate(np.random.default_rng(times).uniform(size=times)):
        path = tmp_path / f"{k}.journal"
        run_until(plan, path, 0.6 * plan.seconds)
        done = campaign_summary(path).rows
        convert_to_schema_1(path)
        limits = Limits(steps=1 + int((k + part) / times * MIGRATION_STEPS))
        assert CommandProcess(tmp_path, "run", "--resume", path, "--rig", plan.rig.name, limits=limits).wait() < 0
        assert campaign_summary(path).rows >= done
        assert resume_campaign(path, plan.rig).state is State.DONE
        assert planned_values(path) == planned_values(tmp_path / "undisturbed.journal")


@pytest.mark.long
@pytest.mark.parametrize("resumed", [False, True])
def test_a_second_process_on_a_journal_is_refused_with_the_number_of_the_first(
    write_rig: Writer, write_schedule: Writer, forked_serve: ForkedServe, tmp_path: Path, resumed: bool
) -> None:
    """The first runs or resumes the journal; the second resumes it, or starts a campaign with the same name."""
    rig, path, schedule = tmp_path / "served.toml", tmp_path / "a.journal", write_schedule()
    forked_serve(write_rig(*QUIET), "--write-rig", rig)  # real time, so that the campaign lasts long enough
    first = CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", path)
    first.wait_for_rows(1)
    if resumed:
        first.kill()
        first = CommandProcess(tmp_path, "run", "--resume", path)
        first.wait_for_rows(1)
    message = f"{path}: is in use by process {first.pid} of "
    for second in (
        CommandProcess(tmp_path, "run", "--resume", path),
        CommandProcess(tmp_path, "run", schedule, "--rig", rig, "--out", path),
    ):
        assert second.wait() == 2
        (line,) = second.error_lines
        assert line.startswith(f"goniotwin: {message}")
        assert line.endswith("; wait for it, or end it")
    listed = CommandProcess(tmp_path, "runs", tmp_path, "--json")
    assert listed.wait() == 0, listed.errors
    assert json.loads(listed.output)["campaigns"][0]["state"] == "running"
    first.kill()
    assert campaign_summary(path).state == "killed"
