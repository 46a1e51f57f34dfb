"""A campaign from its files to its journal, in one call, for the command line and for scripts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.campaign.engine import Engine
from app.campaign.events import Listener, State
from app.campaign.journal import Journal
from app.campaign.operator import BackDoor, Operator, Person, ServedBackDoor
from app.campaign.plan import Plan
from app.campaign.provenance import versions
from app.errors import UserError
from app.rig import OpenRig, RigFile, open_rig
from protocols.clock import Clock, RealClock, VirtualClock


@dataclass(frozen=True)
class Outcome:
    """How a campaign ended: the engine's state, rows committed and planned, the rig's time in s."""

    state: State
    rows: int
    of: int
    seconds: float
    faults: tuple[str, ...]


def clock_for(plan: Plan) -> Clock:
    """A virtual clock for a virtual rig in this process, real time for any other, at the speed of one that is served."""
    return clock_of(plan.rig.file)


def clock_of(file: RigFile) -> Clock:
    """The same of a rig file."""
    if file.twin is not None and all(address.startswith("twin://") for address in file.addresses):
        return VirtualClock()
    return RealClock(file.simulated.speed if file.simulated is not None else 1.0)


def run_campaign(
    plan: Plan,
    journal_path: Path,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Callable[[str], None] | None = None,
) -> Outcome:
    """Runs a plan to its end, or to the first fault. Raises UserError before anything is written, where it cannot start."""
    with open_rig(plan.rig, clock_for(plan), transcript) as opened:
        if journal_path.exists():
            Journal.create(journal_path, plan, {})  # says why not
        operator = operator_for(opened, plan.rig.file, ask)
        opened.connect()
        refuse_lost_axes(opened, plan.rig.name)
        with Journal.create(journal_path, plan, versions()) as journal:
            engine = Engine(opened.rig, plan, journal, operator, listeners)
            state = engine.run()
            rows, of = journal.counted()
            trouble = opened.transcript_trouble
            faults = (*engine.faults, trouble) if trouble is not None else tuple(engine.faults)
            return Outcome(state, rows, of, journal.seconds, faults)


def refuse_lost_axes(opened: OpenRig, rig_name: str) -> None:
    """Raises UserError where it is in doubt where an axis of a connected rig is."""
    doubts = {name: axis.doubt for name, axis in opened.rig.axes.items() if axis.doubt}
    if doubts:
        told = "; ".join(f"{name}: {doubt}" for name, doubt in doubts.items())
        raise UserError(
            f"{told}. Home what has a [homing] table: goniotwin home --rig {rig_name}; or say where an axis is: "
            f"goniotwin here --rig {rig_name} {next(iter(doubts))} DEG"
        )


def operator_for(opened: OpenRig, rig: RigFile, ask: Callable[[str], None] | None) -> Operator:
    """The back door of a virtual rig, in this process or another; a person at a real one. Raises UserError without any."""
    if opened.virtual is not None:
        return BackDoor(opened.virtual)
    if rig.simulated is not None and rig.simulated.control_port is not None:
        return ServedBackDoor(rig.simulated.control_port)
    if ask is None:
        raise UserError(f"{rig.name}: somebody has to mount the samples, and nobody can be asked here")
    return Person(ask)
