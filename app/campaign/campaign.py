"""A campaign from its files to its journal, in one call, for the command line and for scripts."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from app.campaign.engine import Engine
from app.campaign.events import Listener, State
from app.campaign.journal import Journal
from app.campaign.operator import BackDoor, Operator, Person
from app.campaign.plan import Plan
from app.campaign.provenance import versions
from app.rig import OpenRig, open_rig
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
    """A virtual clock for a virtual rig, real time for a real one."""
    return VirtualClock() if plan.rig.file.twin is not None and _all_virtual(plan) else RealClock()


def run_campaign(
    plan: Plan,
    journal_path: Path,
    *,
    listeners: list[Listener] | None = None,
    transcript: Path | None = None,
    ask: Callable[[str], None] = print,
) -> Outcome:
    """Runs a plan to its end, or to the first fault. Raises UserError before anything is written, where it cannot start."""
    with open_rig(plan.rig, clock_for(plan), transcript) as opened:
        if journal_path.exists():
            Journal.create(journal_path, plan, {})  # says why not
        opened.connect()
        with Journal.create(journal_path, plan, versions()) as journal:
            engine = Engine(opened.rig, plan, journal, operator_for(opened, ask), listeners)
            state = engine.run()
            rows, of = journal.counted()
            return Outcome(state, rows, of, journal.seconds, tuple(engine.faults))


def operator_for(opened: OpenRig, ask: Callable[[str], None]) -> Operator:
    """The back door of a virtual rig, a person at a real one."""
    return BackDoor(opened.virtual) if opened.virtual is not None else Person(ask)


def _all_virtual(plan: Plan) -> bool:
    return all(address.startswith("twin://") for address in plan.rig.file.addresses)
