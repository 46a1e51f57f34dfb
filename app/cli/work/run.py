"""The measurement of a campaign: a new one, or one that is resumed."""

import contextlib
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import typer

from goniotwin.app.campaign.campaign import Outcome, resume_campaign, run_campaign
from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.summary import SUFFIX
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.running.events import EventLogged, State
from goniotwin.app.campaign.running.question import Ask
from goniotwin.app.campaign.running.resume import recorded_rig
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.campaign.studies.checks import CheckResults
from goniotwin.app.campaign.studies.journals import check_journal
from goniotwin.app.cli.output import answer, error_console, print_error, print_order, print_warning
from goniotwin.app.cli.work.row_progress import RowProgress
from goniotwin.app.cli.work.terminal import TerminalAsk, ask_operator
from goniotwin.app.errors import UserError
from goniotwin.app.json_document import OPTIONAL_KEY
from goniotwin.app.rig import RigDescription, read_rig
from goniotwin.app.station.hosting import HostedRun, hosted_run


@dataclass(frozen=True)
class RunResult:
    """What `goniotwin run --json` prints; `checks` are absent where the data file cannot be read back."""

    journal: Path
    state: str
    reason: str
    rows: int
    skipped: int
    planned: int
    duration_s: float
    simulated: bool
    faults: Sequence[str]
    orders: list[str]
    chain: Chain
    checks: CheckResults | None = field(default=None, metadata=OPTIONAL_KEY)


def run_schedule(schedule: Path, rig: Path, journal: Path, transcript: Path | None, speed: float | None, as_json: bool) -> None:
    """Measure a campaign and print the result. Raises UserError, and Exit where rows are missing."""
    if journal.suffix != SUFFIX:
        raise UserError(f"--out {journal}: `runs` and the window find data files by {SUFFIX}; write --out {journal}{SUFFIX}")
    plan = make_plan(read_schedule(schedule), read_rig(rig))
    with (
        RowProgress(error_console(), plan.schedule.file.name, len(plan.rows)) as progress,
        _hosted(speed, plan.rig) as (host, ask),
    ):
        outcome = run_campaign(plan, journal, listeners=[progress], transcript=transcript, ask=ask, host=host)
        _report_end(host, outcome)
    _print_outcome(outcome, journal, progress.orders, as_json)


def resume_journal(
    journal: Path, rig: Path | None, accept_rig: bool, transcript: Path | None, speed: float | None, as_json: bool
) -> None:
    """Measure the missing rows of a campaign and print the result. Raises UserError, and Exit where rows are missing."""
    rig_now = read_rig(rig) if rig is not None else None
    with RowProgress(error_console(), str(journal), None) as progress, _hosted(speed, _rig_of(journal, rig_now)) as (host, ask):
        outcome = resume_campaign(
            journal,
            rig_now,
            listeners=[progress],
            transcript=transcript,
            ask=ask,
            host=host,
            accept_rig=(lambda _: True) if accept_rig else _ask_rig if sys.stdin.isatty() else None,
            remind=lambda order: print_order(f"of the last session, not acknowledged: {order}"),
        )
        _report_end(host, outcome)
    _print_outcome(outcome, journal, progress.orders, as_json)


def _print_outcome(outcome: Outcome, journal: Path, orders: list[str], as_json: bool) -> None:
    """Print the result of a run with the checks of its data file. Raises Exit where it is not complete."""
    moved, journal = outcome.journal != journal, outcome.journal
    checks, unread = None, ""
    try:
        checks = check_journal(journal, outcome.chain)
    except UserError as error:
        unread = str(error)
    result = RunResult(
        journal=journal,
        state="stopped" if outcome.state is State.IDLE else str(outcome.state),
        reason=outcome.ended_by_schedule,
        rows=outcome.rows,
        skipped=outcome.skipped,
        planned=outcome.planned,
        duration_s=outcome.seconds,
        simulated=outcome.simulated,
        faults=outcome.faults,
        orders=orders,
        chain=outcome.chain,
        checks=checks,
    )
    for fault in outcome.faults:
        print_error(fault)
    for each in filter(None, (outcome.journal_note, unread)):
        print_error(each)
    mark = "SIMULATED, " if outcome.simulated else ""
    skipped = f" ({outcome.skipped} skipped)" if outcome.skipped else ""
    rows = f"{outcome.rows} of {outcome.planned} rows{skipped} in {outcome.seconds:.1f} s of instrument time"
    text = f"{mark}{result.state}: {rows}: {journal}"
    answer(
        as_json,
        result,
        lambda: print("\n".join([text, outcome.chain.statement, *(checks.lines if checks is not None else [])])),
    )
    for finding in checks.findings if checks is not None else ():
        print_warning(finding)
    if outcome.ended_by_schedule:
        print_warning(f"ended by the schedule: {outcome.ended_by_schedule}")
    if outcome.rows < outcome.planned:
        error_console().print(f"to continue: goniotwin run --resume {journal}", markup=False)
    for order in orders:
        print_order(order)
    if outcome.state is State.DONE and (moved or unread):
        raise typer.Exit(1)
    if outcome.state is not State.DONE or outcome.skipped:
        raise typer.Exit((3 if outcome.ended_by_schedule else 130) if outcome.state is State.IDLE else 1)


def _rig_of(journal: Path, rig: RigDescription | None) -> RigDescription:
    """The rig of a campaign that is resumed. Raises UserError."""
    if rig is not None:
        return rig
    with Journal.open(journal) as opened:
        return recorded_rig(opened)


@contextlib.contextmanager
def _hosted(speed: float | None, rig: RigDescription) -> Iterator[tuple[HostedRun | None, Ask]]:
    """The host of a run that others can attach to, and what asks the operator; no host on the virtual clock."""
    if speed is not None and not rig.file.in_process:
        raise UserError(f"{rig.name}: --speed: the rig is not virtual in this process; leave --speed out")
    if speed is None and rig.file.in_process:
        yield None, ask_operator
        return

    def print_guardian(_number: int, message: object) -> None:
        if isinstance(message, EventLogged) and message.kind == "guardian":  # orders are printed with the run's progress
            print_warning(message.what)

    with hosted_run(speed or 1.0, print_warning) as host:
        host.station.board.subscribe(print_guardian)
        yield host, TerminalAsk(host)


def _report_end(host: HostedRun | None, outcome: Outcome) -> None:
    if host is not None:
        host.station.release()
        host.station.runs.end(outcome.state, outcome.ended_by_schedule, outcome.journal, outcome.journal_note)


def _ask_rig(text: str) -> bool:
    """Ask whether to resume on another rig than the last one; only an explicit yes is one."""
    return typer.confirm(f"{text}. Use these devices?", default=False, err=True)
