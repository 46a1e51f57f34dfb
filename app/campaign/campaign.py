"""Run or resume a campaign, from its files to its journal, in one call: for the command line and for scripts."""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.writing import READERS_END_S, Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, Listener, State
from goniotwin.app.campaign.running.operator import HumanOperator, Operator, ServedOperator, VirtualOperator
from goniotwin.app.campaign.running.question import Ask
from goniotwin.app.campaign.running.resume import remaining_work
from goniotwin.app.errors import UserError, one_line
from goniotwin.app.rig import OpenRig, RigDescription, RigFile, open_rig
from goniotwin.app.rig.last_rig import is_last_rig
from goniotwin.app.rig.left import left_unsafe
from goniotwin.app.rig.lock import RigInUse, journal_holder
from goniotwin.drivers import DeviceError
from goniotwin.protocols.clock import Clock, RealClock, VirtualClock


@dataclass(frozen=True)
class Outcome:
    """Result of a campaign: the final `state` of the engine, and the reason where a stop condition of the schedule ended it.

    `rows` counts the measured planned rows, `skipped` those that were skipped because of faults, `planned` all planned rows;
    `seconds` is the duration on the rig's clock; `chain` the journal's chain of hashes. `journal` is the file with all rows;
    `journal_note` states why it is another than the one to be written, or not one file.
    """

    state: State
    ended_by_schedule: str
    rows: int
    skipped: int
    planned: int
    seconds: float
    faults: tuple[str, ...]
    simulated: bool
    chain: Chain
    journal: Path
    journal_note: str = ""


class RunHost(Protocol):
    """What shows a run to others and takes their commands: it gives the clock, and gets rig, engine and events."""

    @property
    def positions_every_s(self) -> float:
        """Time between two reports of the positions, s."""

    def clock_for(self, rig: RigDescription, start_s: float) -> Clock:
        """The clock on which the rig is opened."""

    def adopt(self, opened: OpenRig, rig: RigDescription) -> None:
        """The rig is open."""

    def report_connected(self) -> None:
        """All devices are connected, and the run is about to begin."""

    def run_begun(self, engine: Engine, plan: Plan, journal: Journal, work: Sequence[Row]) -> None:
        """The engine is about to run."""

    def listen(self, event: Event) -> None:
        """An event of the engine."""

    def wait_for_stops(self) -> None:
        """The engine has ended: return when no stop is in progress."""


def clock_for(file: RigFile, start_s: float = 0.0) -> Clock:
    """The clock of a rig: virtual for a virtual rig in this process, else real; at the simulation speed of a served rig."""
    if file.in_process:
        return VirtualClock(start_s)
    return RealClock(file.speed, start_s)


def run_campaign(
    plan: Plan,
    journal_path: Path,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Ask | None = None,
    host: RunHost | None = None,
    readers_end_s: float = READERS_END_S,
) -> Outcome:
    """Run a plan until it is done, stopped, or ended by a fault. With a `host` others can watch and stop it.

    At the end the reading of the journal by other programs is waited for, at most `readers_end_s`.

    Raises UserError, before anything is written, where it cannot start.
    """
    _refuse_used(journal_path)
    with open_rig(plan.rig, _clock(plan.rig, 0.0, host), transcript) as opened:
        if journal_path.exists():
            Journal.create(journal_path, plan, {})  # raises the error before the rig is connected
        operator = _connect(opened, plan, ask, host)
        with Journal.create(journal_path, plan, software_versions(), readers_end_s=readers_end_s) as journal:
            outcome = _run_engine(opened, plan, journal, operator, listeners, plan.rows, host)
    return replace(outcome, journal=journal.place.kept_at, journal_note=journal.place.note)


def resume_campaign(
    journal_path: Path,
    rig: RigDescription | None = None,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Ask | None = None,
    accept_rig: Callable[[str], bool] | None = None,
    remind: Callable[[str], None] | None = None,
    host: RunHost | None = None,
) -> Outcome:
    """Resume a campaign at the first planned row that is not in its journal; home unreferenced axes first.

    A journal may come of unknown origin, with a rig that is none of this computer: `accept_rig` is asked first whether to use
    a rig that is not the one that was used last here. Naming the `rig` is an answer too. `remind` is called, before anything
    moves, with each safety order of the last session that is not acknowledged. Raises UserError, without a change of the
    journal, where the campaign cannot be resumed: see `remaining_work`.
    """
    _refuse_used(journal_path)  # what another program writes under another name cannot be read
    with Journal.open(journal_path) as unlocked:
        plan = remaining_work(unlocked, rig).plan  # raises the error before the journal is changed
        orders = [*unlocked.open_orders(), *(each.text for each in left_unsafe(journal_path))]
    if remind is not None:
        for order in orders:
            remind(order)
    if rig is None and not is_last_rig(plan.rig.file):
        devices = ", ".join(f"{device.name} at {device.address}" for device in plan.rig.file.devices)
        name = one_line(plan.rig.file.name)
        other = f"{journal_path}: its rig ({name}) is not the one that this computer used last: {devices}"
        if accept_rig is None:
            raise UserError(f"{other}; if these are your devices, add --accept-rig, or name the rig's file with --rig")
        if not accept_rig(other):
            raise UserError(f"{other}; not resumed: name the rig's file with --rig")
    with Journal.reopen(journal_path) as journal:
        remaining = remaining_work(journal, rig)  # again, now that no other program can change the journal
        with open_rig(remaining.plan.rig, _clock(remaining.plan.rig, remaining.start_s, host), transcript) as opened:
            operator = _connect(opened, remaining.plan, ask, host, homing=True, moves=bool(remaining.work))
            outcome = _run_engine(opened, remaining.plan, journal, operator, listeners, remaining.work, host)
    return replace(outcome, journal=journal.place.kept_at, journal_note=journal.place.note)


def _refuse_used(journal_path: Path) -> None:
    if (holder := journal_holder(journal_path)) is not None:
        raise RigInUse(str(journal_path), holder)


def _clock(rig: RigDescription, start_s: float, host: RunHost | None) -> Clock:
    return clock_for(rig.file, start_s) if host is None else host.clock_for(rig, start_s)


def _connect(
    opened: OpenRig, plan: Plan, ask: Ask | None, host: RunHost | None, *, homing: bool = False, moves: bool = True
) -> Operator:
    """Connect the rig, check its axes if any `moves` (`homing` as in `check_referenced`), and return its operator."""
    operator = operator_for(opened, plan.rig.file, ask, samples=plan.schedule.file.samples)
    if host is not None:
        host.adopt(opened, plan.rig)
    opened.connect()
    if host is not None:
        host.report_connected()
    if moves:
        check_referenced(opened, plan.rig.name, homing=homing)
    return operator


def _run_engine(
    opened: OpenRig,
    plan: Plan,
    journal: Journal,
    operator: Operator,
    listeners: list[Listener] | None,
    work: Sequence[Row],
    host: RunHost | None,
) -> Outcome:
    opened.guard.journal = str(journal.path.resolve())
    if host is None:
        engine = Engine(opened.rig, plan, journal, operator, listeners, work=work)
        state = engine.run()
    else:
        engine = Engine(
            opened.rig, plan, journal, operator, [*(listeners or []), host.listen], host.positions_every_s, work=work
        )
        host.run_begun(engine, plan, journal, work)
        try:
            state = engine.run()
        finally:
            host.wait_for_stops()
    (rows, planned), skipped = journal.row_counts(), sum(journal.skipped_by_sample().values())
    failures = filter(None, (opened.transcript_failure, opened.guard.failure))
    faults = (*engine.faults, *failures)
    return Outcome(
        state,
        engine.ended_by_schedule,
        rows,
        skipped,
        planned,
        journal.seconds,
        faults,
        plan.rig.simulated,
        journal.chain,
        journal.path,
    )


def check_referenced(opened: OpenRig, rig_name: str, *, homing: bool = False) -> None:
    """Raise UserError if an axis of a connected rig is unreferenced; with `homing`, only if it cannot home."""
    unreferenced = {
        name: axis.unreferenced_reason
        for name, axis in opened.rig.axes.items()
        if axis.unreferenced_reason and not (homing and axis.settings.homing is not None)
    }
    if unreferenced:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in unreferenced.items())
        raise UserError(
            f"{reasons}. Home an axis that has a [homing] table: goniotwin home --rig {rig_name}; or set the current position "
            f"of an axis: goniotwin here --rig {rig_name} {next(iter(unreferenced))} DEG"
        )


def check_way(opened: OpenRig, work: Sequence[Row]) -> None:
    """Raise UserError if the arc of a connected rig would collide with the beam on the way to the first pose of a run.

    Where a position is unknown nothing is raised: the run homes the axis, or deals with its fault.
    """
    rig, pose = opened.rig, next((row.pose for row in work if row.pose is not None), None)
    if pose is None or rig.clearance is None or any(rig.axes[name].unreferenced_reason for name in ("beta", "shift")):
        return
    try:
        beta, shift = rig.axes["beta"].position_deg(), rig.axes["shift"].position_deg()
    except DeviceError:
        return
    if (collision := rig.clearance.collision((beta, pose[2]), (shift, pose[3]))) is not None:
        raise UserError(f"on the way from beta {beta:.1f} deg, shift {shift:.1f} deg to the first row {collision}")


def operator_for(
    opened: OpenRig, rig: RigFile, ask: Ask | None, *, person: bool = False, samples: Collection[str] = ()
) -> Operator:
    """The operator of a rig: the program at a virtual rig, unless `person`; else a person, asked through `ask`.

    The person may state a record of each of the `samples`. Raises UserError for a person without `ask`.
    """
    program: Operator | None = None
    if opened.virtual is not None:
        program = VirtualOperator(opened.virtual)
    elif (served := rig.simulated) is not None and served.control_port is not None and served.control_token:
        program = ServedOperator(served.control_port, served.control_token, served.server)
    if program is not None and not person:
        return program
    if ask is None:
        raise UserError(f"{rig.name}: a person has to mount the samples, and this program has no way to ask one")
    return HumanOperator(ask, program, samples)
