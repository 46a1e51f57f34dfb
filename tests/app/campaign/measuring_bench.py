"""Campaigns of a few rows on virtual rigs without noise, whose rows a test changes as a planner would."""

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.campaign import operator_for
from goniotwin.app.campaign.journal.record import CommittedRow
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, State
from goniotwin.app.campaign.running.operator import Operator
from goniotwin.app.rig import OpenRig, open_rig
from goniotwin.protocols.clock import VirtualClock

QUIET = (("noise = true", "noise = false"), ("drift_per_hour = 0.02", "drift_per_hour = 0.0"))


def with_rows(plan: Plan, change: Callable[[Row], Row | list[Row]]) -> Plan:
    """The plan with each row changed, or followed by others; numbered anew."""
    rows: list[Row] = []
    for row in plan.rows:
        found = change(row)
        rows += found if isinstance(found, list) else [found]
    return replace(plan, rows=tuple(replace(row, number=k) for k, row in enumerate(rows)))


@dataclass
class Run:
    """What a run came to."""

    state: State
    rows: list[CommittedRow]
    events: list[tuple[str, str]]
    faults: list[str]
    seconds: float

    def of(self, kind: str, sample: str = "") -> list[CommittedRow]:
        """The rows of a kind."""
        return [each for each in self.rows if each.row.kind == kind and sample in ("", each.row.sample)]


def carried_out(
    plan: Plan,
    path: Path,
    prepare: Callable[[OpenRig], Any] = lambda _: None,
    operator: Operator | None = None,
    listeners: list[Listener] | None = None,
    made: Callable[[Engine], Any] = lambda _: None,
) -> Run:
    """Runs a plan on its virtual rig, which `prepare` may do something to before; `made` is told of the engine."""
    with contextlib.ExitStack() as stack:
        opened = stack.enter_context(open_rig(plan.rig, VirtualClock()))
        opened.connect()
        prepare(opened)
        journal = stack.enter_context(Journal.create(path, plan, {}))
        who = operator or operator_for(opened, plan.rig.file, None)
        engine = Engine(opened.rig, plan, journal, who, listeners)
        made(engine)
        state = engine.run()
        found = [(str(kind), str(text)) for kind, text in journal._db.execute("SELECT kind, text FROM event ORDER BY id")]
        return Run(state, list(journal.rows()), found, engine.faults, journal.seconds)
