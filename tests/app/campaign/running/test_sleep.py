"""A computer that sleeps during a run: it is kept awake, and what it sleeps through all the same is measured again."""

import stat
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.running.events import Event, RowCommitted, RowStarted, State
from goniotwin.app.campaign.running.recovery import FaultPolicies
from goniotwin.app.campaign.running.sleep import SLEPT_S, SleepWatch, StayAwake
from goniotwin.app.campaign.schedule.file import FaultsTable, read_schedule
from goniotwin.app.campaign.studies.reduced_journal import reduce_journal
from goniotwin.app.rig import OpenRig, RigFile, read_rig
from goniotwin.drivers import NoAnswer
from goniotwin.drivers.errors import Interrupted
from tests.app.campaign.campaign_bench import QUIET, RunResult, planned_values, run_plan
from tests.conftest import Writer

HOUR_S = 3600.0
INHIBITOR = """#!/bin/sh
echo "$@" >> {log}
while [ "${{1#--}}" != "$1" ]; do shift; done
"$@"
echo ended >> {log}
"""


@pytest.fixture
def plan(write_rig: Writer, write_schedule: Writer) -> Plan:
    return make_plan(read_schedule(write_schedule()), read_rig(write_rig(*QUIET)))


class Sleeper:
    """A computer that sleeps for an hour in the middle of one row, each time that the row is tried, `times` times."""

    def __init__(self, row: int, times: int = 1) -> None:
        self._row, self._left = row, times
        self._asleep_s = 0.0
        self._opened: OpenRig | None = None

    def watch(self, opened: OpenRig) -> SleepWatch:
        self._opened, clock = opened, opened.rig.clock
        return SleepWatch(lambda: 1.7e9 + clock.now() + self._asleep_s, clock.now)

    def listen(self, event: Event) -> None:
        if isinstance(event, RowStarted) and event.row.number == self._row and self._left:
            self._left -= 1
            assert self._opened is not None
            clock = self._opened.rig.clock
            clock.at(clock.now() + 0.1, self._sleep)

    def _sleep(self) -> None:
        self._asleep_s += HOUR_S


def run_with_sleep(plan: Plan, path: Path, sleeper: Sleeper, *more: Callable[[Event], None]) -> RunResult:
    return run_plan(plan, path, listeners=[sleeper.listen, *more], watch_sleep=sleeper.watch)


def test_after_a_sleep_the_row_and_the_dark_reading_are_taken_again(plan: Plan, tmp_path: Path) -> None:
    run_plan(plan, tmp_path / "whole.journal")
    slept_in = next(row.number for row in plan.rows if row.kind == "measure")
    events: list[Event] = []
    run = run_with_sleep(plan, tmp_path / "a.journal", Sleeper(slept_in), events.append)
    assert run.state is State.DONE
    assert [each.row for each in events if isinstance(each, RowCommitted)] == [each.row for each in run.rows]
    assert (
        len([text for kind, text in run.events if kind == "sleep" and text.startswith("this computer slept for 60.0 min")]) == 1
    )
    assert [each.row.number for each in run.rows] == [*range(slept_in), len(plan.rows), *range(slept_in, len(plan.rows))]
    renewed = run.rows[slept_in]
    assert (renewed.row.kind, renewed.row.unplanned) == ("dark", True)
    assert renewed.data.readings
    assert planned_values(tmp_path / "a.journal") == planned_values(tmp_path / "whole.journal")
    with Journal.open(tmp_path / "a.journal") as journal:
        assert reduce_journal(journal).samples


def test_a_dark_reading_in_which_the_computer_slept_is_repeated(plan: Plan, tmp_path: Path) -> None:
    slept_in = next(row.number for row in plan.rows if row.kind == "dark")
    run = run_with_sleep(plan, tmp_path / "a.journal", Sleeper(slept_in))
    assert [each.row for each in run.rows] == list(plan.rows)
    undisturbed = run_plan(plan, tmp_path / "whole.journal").rows[slept_in]
    assert run.rows[slept_in].data.started_s >= undisturbed.data.ended_s


def test_a_run_that_does_not_sleep_has_the_planned_rows_only(plan: Plan, tmp_path: Path) -> None:
    run = run_with_sleep(plan, tmp_path / "a.journal", Sleeper(3, times=0))
    assert [each.row for each in run.rows] == list(plan.rows)
    assert not [text for kind, text in run.events if "slept" in text]


def test_a_fault_of_an_attempt_in_which_the_computer_slept_does_not_count() -> None:
    policies = FaultPolicies(FaultsTable(attempts=1))
    fault = NoAnswer("monitor", "read", "no reply")
    assert [policies.policy_for(fault, slept=True) for _ in range(3)] == ["reconnect"] * 3
    assert policies.policy_for(fault) == "stop"
    assert policies.policy_for(Interrupted("beta", "go", "a stop was requested"), slept=True) == "stop"


def test_only_a_leap_of_the_calendar_is_a_sleep() -> None:
    now = {"calendar": 1e9, "awake": 5.0}
    watch = SleepWatch(lambda: now["calendar"], lambda: now["awake"])

    def pass_s(calendar_s: float, awake_s: float) -> float:
        now["calendar"] += calendar_s
        now["awake"] += awake_s
        return watch.slept_s()

    assert pass_s(1e5, 1e5) == 0.0
    assert [pass_s(60.0 + 0.5 * SLEPT_S, 60.0) for _ in range(10)] == [0.0] * 10  # the calendar is corrected
    assert pass_s(-HOUR_S, 60.0) == 0.0
    assert pass_s(HOUR_S + 60.0, 60.0) == pytest.approx(HOUR_S)
    assert pass_s(60.0, 60.0) == 0.0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have other programs")
def test_the_computer_is_kept_awake_while_a_run_goes_on(plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    log = tmp_path / "log"
    program = tmp_path / "bin" / "systemd-inhibit"
    program.parent.mkdir()
    program.write_text(INHIBITOR.format(log=log), encoding="ascii")
    program.chmod(program.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PATH", f"{program.parent}:/usr/bin:/bin")
    seen: list[list[str]] = []

    def look(event: Event) -> None:
        if isinstance(event, RowStarted):
            seen.append(log.read_text(encoding="ascii").splitlines())

    run = run_with_sleep(plan, tmp_path / "a.journal", Sleeper(0, times=0), look)
    assert run.state is State.DONE
    assert len(seen) == len(plan.rows)
    assert all(each == seen[0] for each in seen)
    assert len(seen[0]) == 1
    assert "--what=sleep:idle" in seen[0][0]
    assert log.read_text(encoding="ascii").splitlines()[1:] == ["ended"]


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="Windows has a way of its own")
def test_a_way_to_stay_awake_that_hangs_with_its_children_holds_up_no_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program, late = tmp_path / ("caffeinate" if sys.platform == "darwin" else "systemd-inhibit"), tmp_path / "late"
    program.write_text(f"#!/bin/sh\n/bin/sh -c '/bin/sleep 15; echo > {late}'\n", encoding="ascii")
    program.chmod(0o700)
    monkeypatch.setenv("PATH", str(tmp_path))
    assert StayAwake(0.1).begin("nothing") == f"{program.name} does not grant it"
    assert not late.exists()


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="other systems have other programs")
@pytest.mark.parametrize("program", [None, "#!/bin/sh\nexit 1\n"])
def test_a_computer_that_cannot_be_kept_awake_is_named_in_the_journal(
    plan: Plan, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str | None
) -> None:
    folder = tmp_path / "bin"
    folder.mkdir()
    if program is not None:
        (folder / "systemd-inhibit").write_text(program, encoding="ascii")
        (folder / "systemd-inhibit").chmod(0o700)
    monkeypatch.setenv("PATH", str(folder))
    virtual = run_with_sleep(plan, tmp_path / "virtual.journal", Sleeper(0, times=0))
    assert not [text for kind, text in virtual.events if kind == "sleep"]
    monkeypatch.setattr(RigFile, "in_process", False)
    run = run_with_sleep(plan, tmp_path / "a.journal", Sleeper(0, times=0))
    assert run.state is State.DONE
    (text,) = [text for kind, text in run.events if kind == "sleep"]
    assert text.startswith("this computer may go to sleep during the run: systemd-inhibit")
    awake = StayAwake()
    assert awake.begin("nothing")
    awake.end()
