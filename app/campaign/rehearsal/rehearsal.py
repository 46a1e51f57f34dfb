"""The rehearsal: a whole campaign through the real drivers against the twin, on the virtual clock, before anyone measures.

Nothing of a real rig is opened: no port, and no lock. For its file a twin is built that the file describes; what that can find
and what not is said in app.rig.described_twin. A mounting takes no time here; at the rig a person takes some.
"""

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.check import checked_plan
from goniotwin.app.campaign.planning.plan import Plan, make_plan
from goniotwin.app.campaign.rehearsal.forecast import forecast
from goniotwin.app.campaign.rehearsal.row_statistics import Watch
from goniotwin.app.campaign.rehearsal.warnings import heeded, warnings_of, worthless
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.running.resume import RemainingWork, remaining_work
from goniotwin.app.campaign.schedule.file import ScheduleDescription
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, open_rig, photodiode_settings
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.protocols.clock import VirtualClock


@dataclass(frozen=True)
class Rehearsal:
    """What it has shown. `result` is what `goniotwin rehearse --json` prints."""

    plan: Plan
    result: dict[str, Any]

    @property
    def done(self) -> bool:
        """Whether it came to its end."""
        return bool(self.result["state"] == State.DONE)


@dataclass(frozen=True)
class Run:
    """How it ended, and by which words of the schedule; the planned rows that were done, in how many sessions and of the rig's
    seconds; what went wrong, and what was assumed of the axes.
    """

    state: State
    ended_by_schedule: str
    rows: int
    sessions: int
    seconds: float
    faults: tuple[str, ...]
    assumed: tuple[str, ...]


def prepared(schedule: ScheduleDescription, rig: RigDescription, samples: Mapping[str, str]) -> tuple[Plan, tuple[str, ...]]:
    """The plan on a virtual rig, the one that the file is or describes, and what was assumed. Raises UserError."""
    file = schedule.file
    unknown = [name for name in samples if name not in (file.etalon, *file.samples)]
    if unknown:
        named = ", ".join((file.etalon, *file.samples))
        raise UserError(f"--sample {unknown[0]}: {schedule.name} has no such sample; it has {named}")
    described = described_twin(rig, file.etalon, file.samples, samples)
    return make_plan(schedule, described.rig), described.assumed


def rehearse(
    plan: Plan,
    assumed: tuple[str, ...] = (),
    *,
    out: Path | None = None,
    points: Path | None = None,
    listeners: list[Listener] | None = None,
) -> Rehearsal:
    """Runs a plan of `prepared`; its journal is thrown away, or `out`. `points` is a CSV for the uncertainty foretold for each
    direction. Raises UserError, KeyboardInterrupt for a Ctrl-C.
    """
    watch = Watch(photodiode_settings(plan.rig.file), partial(heeded, plan))
    with tempfile.TemporaryDirectory(prefix="goniotwin-rehearsal-") as folder:
        path = out if out is not None else Path(folder) / "rehearsal.journal"
        run = performed(plan, path, watch, listeners or [])
        warnings = [*checked_plan(plan)["warnings"], *warnings_of(plan, watch)]
        said = f"SIMULATED: {plan.schedule.file.name} rehearsed on {plan.rig.file.name}; nothing here is real"
        foretold = forecast(path, points, [said, *(f"assumed: {each}" for each in (*assumed, *run.assumed))])
        if foretold.trouble:
            warnings.append(f"nothing can be foretold of the uncertainty: {foretold.trouble}")
        if run.state is State.IDLE:
            warnings.append(f"it ends before all rows are measured: {run.ended_by_schedule}")
        elif run.sessions > 1:
            warnings.append(f"the schedule's [stop] ends it {run.sessions - 1} times; each time goniotwin run --resume goes on")
        warnings += foretold.verdicts.alarming
        warnings += worthless(plan.schedule.file, foretold.tallies, foretold.unwatched) if not foretold.trouble else []
        result = {
            "simulated": True,
            "state": "stopped" if run.state is State.IDLE else str(run.state),
            "sessions": run.sessions,
            "faults": list(run.faults),
            "rows": run.rows,
            "planned": len(plan.rows),
            "duration_s": run.seconds,
            "foretold_s": plan.seconds,
            "blocks": [vars(block) for block in watch.blocks],
            "axes_deg": watch.axes_deg,
            "counts": {
                "largest": max(watch.largest.values(), default=None),
                "share_of_range": {f"{gain:g}": share for gain, share in watch.share_of_range.items()},
            },
            "saturated": watch.saturated,
            "checks": foretold.verdicts.as_dict(),
            "relative_uncertainty": foretold.spread,
            "lamp_hours": run.seconds / 3600.0,
            "journal_bytes": path.stat().st_size,
            "warnings": warnings,
            "assumed": [*assumed, *run.assumed],
        }
    return Rehearsal(plan, result)


def performed(plan: Plan, path: Path, watch: Watch, listeners: list[Listener]) -> Run:
    """The plan on its virtual rig, with `watch` and others listening; the journal is there afterwards. Raises as `rehearse`.

    Where the schedule ends a session, another one goes on, as long as that comes any further.
    """
    faults: list[str] = []
    with Journal.create(path, plan, software_versions(), durable=False) as journal:
        rest: RemainingWork | None = None
        done = -1
        while True:
            with open_rig(plan.rig, VirtualClock(rest.start_s if rest else 0.0)) as opened:
                opened.connect()
                referenced = _referenced(opened)
                assert opened.virtual is not None
                work = rest.work if rest else None
                engine = Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), [watch, *listeners], work=work)
                state = engine.run()
            faults += engine.faults
            if state is State.IDLE and not engine.ended_by_schedule:
                raise KeyboardInterrupt
            before, (done, _) = done, journal.row_counts()
            if state is not State.IDLE or done <= before:
                sessions = len(journal.sessions())
                return Run(state, engine.ended_by_schedule, done, sessions, journal.seconds, tuple(faults), tuple(referenced))
            rest = remaining_work(journal, plan.rig)


def _referenced(opened: OpenRig) -> list[str]:
    """Axes of which nobody would know where they are after a power-up stand where the twin has them."""
    doubtful = [name for name, axis in opened.rig.axes.items() if axis.unreferenced_reason]
    for name in doubtful:
        opened.rig.axes[name].set_position()
    return [f"{name} has been referenced before the campaign begins (goniotwin home, goniotwin here)" for name in doubtful]
