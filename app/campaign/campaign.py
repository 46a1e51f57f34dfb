"""A campaign from its files to its journal, in one call, for the command line and for scripts."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, State
from goniotwin.app.campaign.running.operator import HumanOperator, Operator, ServedOperator, VirtualOperator
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.errors import UserError
from goniotwin.app.rig import OpenRig, RigDescription, RigFile, open_rig
from goniotwin.app.rig.lock import Held, RigLock
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock


@dataclass(frozen=True)
class Outcome:
    """How a campaign ended: the engine's state, and by which words of the schedule, where it was that; planned rows that are
    done, those left out for faults, and all of them; the rig's time in s.
    """

    state: State
    ended_by_schedule: str
    rows: int
    skipped: int
    of: int
    seconds: float
    faults: tuple[str, ...]
    simulated: bool


def clock_for(file: RigFile, start_s: float = 0.0) -> Clock:
    """A virtual clock for a virtual rig in this process, real time for any other, at the speed of one that is served."""
    if file.twin is not None and all(address.startswith("twin://") for address in file.addresses):
        return VirtualClock(start_s)
    return RealClock(file.simulated.speed if file.simulated is not None else 1.0, start_s)


def run_campaign(
    plan: Plan,
    journal_path: Path,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Callable[[str], None] | None = None,
) -> Outcome:
    """Runs a plan to its end, or to the first fault. Raises UserError before anything is written, where it cannot start."""
    with _alone(journal_path, plan), open_rig(plan.rig, clock_for(plan.rig.file), transcript) as opened:
        if journal_path.exists():
            Journal.create(journal_path, plan, {})  # says why not
        operator = _ready(opened, plan, ask)
        with Journal.create(journal_path, plan, software_versions()) as journal, _alone(journal_path, plan, file=True):
            return _carried_out(opened, plan, journal, operator, listeners, plan.rows)


def resume_campaign(
    journal_path: Path,
    rig: RigDescription | None = None,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Callable[[str], None] | None = None,
) -> Outcome:
    """Goes on at the first row that a journal does not have. Raises UserError, and leaves the journal as it is, where that
    cannot be: see `remaining_work`.
    """
    with Journal.open(journal_path) as looked_at:
        begun = remaining_work(looked_at, rig)
    plan = begun.plan
    with _alone(journal_path, plan), _alone(journal_path, plan, file=True), Journal.reopen(journal_path) as journal:
        rest = remaining_work(journal, rig)
        with open_rig(rest.plan.rig, clock_for(rest.plan.rig.file, rest.start_s), transcript) as opened:
            operator = _ready(opened, rest.plan, ask, homing=True)
            return _carried_out(opened, rest.plan, journal, operator, listeners, rest.work)


@contextlib.contextmanager
def _alone(journal_path: Path, plan: Plan, *, file: bool = False) -> Iterator[None]:
    """No other program works on the journal meanwhile, under this name or, as a `file` that is there, under any other.

    Raises UserError that says who does.
    """
    place = str(journal_path.absolute())
    if file:
        about = journal_path.stat()
        place = f"/goniotwin-journal/{about.st_dev}/{about.st_ino}"
    try:
        lock = RigLock([place], f"{plan.schedule.file.name} ({journal_path})")
    except Held as held:
        raise Held(str(journal_path), held.holder) from None
    try:
        yield
    finally:
        lock.release()


def _ready(opened: OpenRig, plan: Plan, ask: Callable[[str], None] | None, *, homing: bool = False) -> Operator:
    """Connects the rig, and finds who mounts; with `homing`, axes that can look for their reference will."""
    operator = operator_for(opened, plan.rig.file, ask)
    opened.connect()
    check_referenced(opened, plan.rig.name, homing=homing)
    return operator


def _carried_out(
    opened: OpenRig, plan: Plan, journal: Journal, operator: Operator, listeners: list[Listener] | None, work: Sequence[Row]
) -> Outcome:
    engine = Engine(opened.rig, plan, journal, operator, listeners, work=work)
    state = engine.run()
    (rows, of), skipped = journal.counted(), len(journal.skipped())
    trouble = opened.transcript_trouble
    faults = (*engine.faults, trouble) if trouble is not None else tuple(engine.faults)
    return Outcome(state, engine.ended_by_schedule, rows, skipped, of, journal.seconds, faults, plan.rig.simulated)


def check_referenced(opened: OpenRig, rig_name: str, *, homing: bool = False) -> None:
    """Raises UserError where it is in doubt where an axis of a connected rig is; with `homing`, only of one that cannot."""
    doubts = {
        name: axis.unreferenced_reason
        for name, axis in opened.rig.axes.items()
        if axis.unreferenced_reason and not (homing and axis.settings.homing is not None)
    }
    if doubts:
        told = "; ".join(f"{name}: {doubt}" for name, doubt in doubts.items())
        raise UserError(
            f"{told}. Home what has a [homing] table: goniotwin home --rig {rig_name}; or say where an axis is: "
            f"goniotwin here --rig {rig_name} {next(iter(doubts))} DEG"
        )


def operator_for(opened: OpenRig, rig: RigFile, ask: Callable[[str], None] | None) -> Operator:
    """The back door of a virtual rig, in this process or another; a person at a real one. Raises UserError without any."""
    if opened.virtual is not None:
        return VirtualOperator(opened.virtual)
    if rig.simulated is not None and rig.simulated.control_port is not None:
        return ServedOperator(rig.simulated.control_port)
    if ask is None:
        raise UserError(f"{rig.name}: somebody has to mount the samples, and nobody can be asked here")
    return HumanOperator(ask)
