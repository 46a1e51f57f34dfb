"""The rehearsal: a whole campaign through the real drivers against the twin, on the virtual clock.

Nothing of a real rig is opened: no port and no lock. For a real rig's file a twin is built from the file's description;
app.rig.described_twin states what such a twin can detect and what not. A mounting takes no time here; at the rig it takes the
operator some time.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import NewPlan, Plan, make_plan
from goniotwin.app.campaign.planning.warnings import beyond_longest, uncertain_duration
from goniotwin.app.campaign.rehearsal.assumed_references import assume_referenced
from goniotwin.app.campaign.rehearsal.blocks import OTHER_TIMES, divide, run_blocks, statistics_of, why_in_one_process
from goniotwin.app.campaign.rehearsal.expected_poses import expected_poses
from goniotwin.app.campaign.rehearsal.forecast import SpreadSummary, forecast
from goniotwin.app.campaign.rehearsal.row_statistics import MountingBlock, RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import missed_warnings, rehearsal_warnings, unchecked_warnings
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.running.resume import RemainingWork, remaining_work
from goniotwin.app.campaign.schedule.file import ScheduleDescription
from goniotwin.app.campaign.studies.checks import CheckResults
from goniotwin.app.campaign.studies.decades import TargetInDecade
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, open_rig
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.app.sweeps.runners import EndedFromOutside, Processes
from goniotwin.protocols.clock import VirtualClock


@dataclass(frozen=True)
class LargestCounts:
    """The largest count of a rehearsal, and by gain in V/A its share of the converters' range."""

    largest: int | None
    share_of_range: dict[str, float]


@dataclass(frozen=True)
class RehearsalResult:
    """The result of a rehearsal, as `goniotwin rehearse --json` prints it.

    `foretold_s` is the duration of the plan, `duration_s` that of the run; `sessions` are more than one where the schedule's
    [stop] ended it. `saturated` is the number of values that are so at every gain. `checks` and `relative_uncertainty` are of
    the journal, and `target` compares them with the schedule's [target], by sample; it is empty without a target of u.
    `missed` are the warnings for which a window asks before it starts: rows or the target are missed, or most values of a
    setting are below the detection limit. `assumed` states what was assumed of the rig.
    """

    simulated: bool
    state: str
    sessions: int
    faults: list[str]
    rows: int
    planned: int
    duration_s: float
    foretold_s: float
    blocks: list[MountingBlock]
    axes_deg: dict[str, list[float]]
    counts: LargestCounts
    saturated: int
    checks: CheckResults
    relative_uncertainty: dict[str, SpreadSummary]
    target: dict[str, list[TargetInDecade]]
    lamp_hours: float
    journal_bytes: int
    warnings: list[str]
    missed: list[str]
    assumed: list[str]


@dataclass(frozen=True)
class Rehearsal:
    """A rehearsed plan with its `result`, and the `end` of its run."""

    plan: NewPlan
    end: State
    result: RehearsalResult

    @property
    def done(self) -> bool:
        """Whether the campaign was completed."""
        return self.end is State.DONE


@dataclass(frozen=True)
class RehearsalRun:
    """The end of a run on the twin: its state, and the condition of the schedule's [stop] that ended it.

    `rows` is the number of planned rows that were done, in so many `sessions`; `seconds` are simulated time. `faults` are the
    faults of the run, `assumed` the assumptions on the axes.
    """

    state: State
    ended_by_schedule: str
    rows: int
    sessions: int
    seconds: float
    faults: tuple[str, ...]
    assumed: tuple[str, ...]


def plan_rehearsal(
    schedule: ScheduleDescription, rig: RigDescription, samples: Mapping[str, str]
) -> tuple[NewPlan, tuple[str, ...]]:
    """Make the plan on a virtual rig, and list the assumptions on it. Raises UserError.

    The virtual rig is the file's own, or the one that a real rig's file describes. `samples` are models by the sample's name.
    """
    file = schedule.file
    unknown = [name for name in samples if name not in file.mounted]
    if unknown:
        named = ", ".join(file.mounted)
        raise UserError(f"--sample {unknown[0]}: {schedule.name} has no such sample; it has {named}")
    described = described_twin(rig, file.standard_factors, file.samples, samples)
    return make_plan(schedule, described.rig), described.assumptions


def rehearse(
    plan: NewPlan,
    assumed: tuple[str, ...] = (),
    *,
    out: Path | None = None,
    points: Path | None = None,
    listeners: list[Listener] | None = None,
    processes: int = 1,
) -> Rehearsal:
    """Run a plan of `plan_rehearsal` on the twin, and evaluate its journal.

    The journal is written to `out`, or deleted. `points` is a CSV for the predicted uncertainty of each direction. With more
    than one of `processes` the rows are rehearsed in blocks (see `rehearsal.blocks`), where that is possible; the result
    states it. Raises UserError, and KeyboardInterrupt for a Ctrl-C.
    """
    statistics = statistics_of(plan)
    with tempfile.TemporaryDirectory(prefix="goniotwin-rehearsal-") as folder:
        path = out if out is not None else Path(folder) / "rehearsal.journal"
        run = run_in_processes(plan, path, statistics, listeners or [], processes)
        file, rig = plan.schedule.file, plan.rig.file
        # Their place is taken by the duration of the run.
        estimate = {*beyond_longest(file, plan.seconds), *uncertain_duration(plan)}
        planned = [each for each in check_plan(plan).warnings if each not in estimate]
        warnings, missed = [*planned, *rehearsal_warnings(plan, statistics)], list[str]()
        heading = f"SIMULATED: {plan.schedule.file.name} rehearsed on {plan.rig.file.name}; nothing here is real"
        about = [heading, *(f"assumed: {each}" for each in (*assumed, *run.assumed))]
        model = plan.rig.model()
        assert model is not None
        predicted = forecast(path, points, about, truth=model.samples)
        if predicted.trouble:
            warnings.append(f"the uncertainty cannot be predicted: {predicted.trouble}")
        if run.state is not State.DONE:
            missed = [f"the campaign ends before all rows are measured: {run.ended_by_schedule or run.faults[-1]}"]
        elif run.sessions > 1:
            warnings.append(
                f"the schedule's [stop] ends the run {run.sessions - 1} times; continue each time with goniotwin run --resume"
            )
        warnings += predicted.check_results.alarms
        warnings += unchecked_warnings(predicted.unchecked)
        missed += [
            *([] if predicted.trouble else missed_warnings(file, rig, predicted)),
            *beyond_longest(file, run.seconds),
        ]
        result = RehearsalResult(
            simulated=True,
            state="stopped" if run.state is State.IDLE else str(run.state),
            sessions=run.sessions,
            faults=list(run.faults),
            rows=run.rows,
            planned=len(plan.rows),
            duration_s=run.seconds,
            foretold_s=plan.seconds,
            blocks=statistics.blocks,
            axes_deg=statistics.axes_deg,
            counts=LargestCounts(
                largest=max(statistics.largest.values(), default=None),
                share_of_range={f"{gain:g}": share for gain, share in statistics.share_of_range.items()},
            ),
            saturated=statistics.saturated,
            checks=predicted.check_results,
            relative_uncertainty=predicted.spread,
            target=predicted.target,
            lamp_hours=run.seconds / 3600.0,
            journal_bytes=path.stat().st_size,
            warnings=[*missed, *warnings],
            missed=missed,
            assumed=[*assumed, *run.assumed],
        )
    return Rehearsal(plan, run.state, result)


def run_in_processes(
    plan: Plan, path: Path, statistics: RowStatistics, listeners: list[Listener], processes: int
) -> RehearsalRun:
    """`run_on_twin`, in blocks of rows where there are several processes and the plan can be divided. Raises as `rehearse`."""
    if processes < 2:
        return run_on_twin(plan, path, statistics, listeners)
    reason = why_in_one_process(plan)
    blocks = divide(plan, processes)
    if len(blocks) == 1:
        reason = reason or "its rows take less time than the start of a process"
    if not reason:
        counted = statistics_of(plan)
        try:
            seconds = run_blocks(plan, blocks, path, Processes(len(blocks) - 1, beside=1), counted, listeners)
        except UserError as error:
            path.unlink(missing_ok=True)
            reason = "one of several was ended from outside" if isinstance(error, EndedFromOutside) else str(error)
        else:
            statistics.add(counted.as_data())
            first = plan.rows[blocks[1].first]
            assumed = (f"{len(blocks)} blocks of rows, each in a process of its own: from {first.identity} on, {OTHER_TIMES}",)
            return RehearsalRun(State.DONE, "", len(plan.rows), 1, seconds, (), assumed)
    run = run_on_twin(plan, path, statistics, listeners)
    return replace(run, assumed=(*run.assumed, f"rehearsed in one process, because {reason}"))


def run_on_twin(plan: Plan, path: Path, statistics: RowStatistics, listeners: list[Listener]) -> RehearsalRun:
    """Run the plan on its virtual rig, with `statistics` and other listeners; the journal is left at `path`.

    Where the schedule's [stop] ends a session, the next one continues, as long as that measures further rows. Raises as
    `rehearse`.
    """
    faults: list[str] = []
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        rest: RemainingWork | None = None
        done = -1
        while True:
            with open_rig(plan.rig, VirtualClock(rest.start_s if rest else 0.0)) as opened:
                opened.connect()
                assumed = assume_referenced(opened)
                assert opened.virtual is not None
                work = rest.work if rest else None
                opened.virtual.plant.expect(expected_poses(plan.rows if work is None else work, opened.rig))
                engine = Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [statistics, *listeners], work=work)
                state = engine.run()
            faults += engine.faults
            if state is State.IDLE and not engine.ended_by_schedule:
                raise KeyboardInterrupt
            before, (done, _) = done, journal.row_counts()
            if state is not State.IDLE or done <= before:
                sessions = len(journal.sessions())
                return RehearsalRun(
                    state, engine.ended_by_schedule, done, sessions, journal.seconds, tuple(faults), tuple(assumed)
                )
            rest = remaining_work(journal, plan.rig)
