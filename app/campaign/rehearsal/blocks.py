"""A rehearsal in blocks of rows, each in a process of its own, then put together in one journal.

A block begins with a mounting that a dark reading follows, so that nothing of the rows before it is needed: each is a session
of the journal, as in a campaign that was interrupted there. It begins at the time at which the plan expects it, and a little
later: lamp and noise are those of other times than in one process. The axes come from their reference and the monochromator
from its start, which takes some seconds more. With noise and drift off, the values of the rows are the same.
"""

import base64
import contextlib
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.assumed_references import assume_referenced
from goniotwin.app.campaign.rehearsal.expected_poses import expected_poses
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Listener, RowCommitted, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig
from goniotwin.app.rig.embedding import embed_rig, embedded_rig
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.protocols.clock import VirtualClock

VERSION = 1
LATER_S, LATER = 5.0, 0.02
"""By how much a block begins after the time that the plan expects, s, and as a share of it: not before the one before ends."""
NAME = "the schedule"


@dataclass(frozen=True)
class Block:
    """The rows `first` to `last` (exclusive) of a plan, from the time `start_s` on the rig's clock on."""

    first: int
    last: int
    start_s: float


def why_in_one_process(plan: Plan) -> str:
    """Why a rehearsal cannot be divided; empty if it can."""
    file = plan.schedule.file
    if file.stop is not None or file.drift is not None:
        return "its stop conditions and drift checks compare rows with earlier ones"
    return "" if len(_beginnings(plan.rows)) > 1 else "it mounts one sample"


def divide(plan: Plan, count: int) -> list[Block]:
    """The plan in `count` blocks of about as many rows each, or fewer."""
    beginnings, rows = _beginnings(plan.rows), len(plan.rows)
    firsts = sorted({0, *(min(beginnings, key=lambda at: abs(at - rows * k / count)) for k in range(1, count))})
    before = list(accumulate((row.seconds for row in plan.rows), initial=0.0))
    starts = [before[first] * (1.0 + LATER) + LATER_S * k for k, first in enumerate(firsts)]
    starts[0] = 0.0
    return [Block(first, last, start) for first, last, start in zip(firsts, [*firsts[1:], rows], starts, strict=True)]


def _beginnings(rows: Sequence[Row]) -> list[int]:
    """The first row, and the mountings after which a dark reading comes before anything is measured."""
    after = [*rows[1:], None]
    dark = [
        row.kind == "mount" and next_row is not None and next_row.kind == "dark"
        for row, next_row in zip(rows, after, strict=True)
    ]
    return [k for k, begins in enumerate(dark) if begins or k == 0]


def specification(plan: Plan, blocks: Sequence[Block], folder: Path) -> Specification:
    """The blocks as a sweep, chunk k is the k-th. The plan is that of an empty journal in a folder."""
    path = folder / "plan.journal"
    with Journal.create(path, plan, software_versions(), durable=False):
        pass
    content = {
        "schedule": {"text": plan.schedule.text, "certificate": plan.schedule.certificate},
        "rig": embed_rig(plan.rig),
        "plan": base64.b64encode(path.read_bytes()).decode(),
        "blocks": [vars(block) for block in blocks],
    }
    return Specification.of("rehearsal", VERSION, 1, plan.rig.seed or 0, content)


def rehearse_block(of: Specification, chunk: int) -> Arrays:
    """The journal of one block, as the bytes of its file. Raises UserError where the block does not come to its end."""
    with tempfile.TemporaryDirectory(prefix="goniotwin-block-") as name:
        folder = Path(name)
        plan = _plan(of, folder)
        block = Block(**of.data["blocks"][chunk])
        path = folder / "block.journal"
        with Journal.create(path, plan, software_versions(), durable=False) as journal:
            _run(plan, block, journal)
        return {"journal": np.frombuffer(path.read_bytes(), np.uint8)}


def _plan(of: Specification, folder: Path) -> Plan:
    data = of.data
    tables = folder / "tables"
    tables.mkdir()
    schedule = replace(parse_schedule(data["schedule"]["text"], NAME), certificate=data["schedule"]["certificate"])
    path = folder / "plan.journal"
    path.write_bytes(base64.b64decode(data["plan"]))
    with Journal.open(path) as journal:
        return Plan(schedule, embedded_rig(data["rig"], tables), journal.planned_rows())


def _run(plan: Plan, block: Block, journal: Journal) -> None:
    rows = plan.rows[block.first : block.last]
    mountings = _mountings(plan.rows[: block.first])
    with open_rig(plan.rig, VirtualClock(block.start_s)) as opened:
        opened.connect()
        assume_referenced(opened)
        assert opened.virtual is not None
        opened.virtual.plant.count_mountings(mountings)
        opened.virtual.plant.expect(expected_poses(rows, opened.rig, mountings))
        engine = Engine(opened.rig, plan, journal, VirtualOperator(opened.virtual), work=rows)
        state = engine.run()
    if state is not State.DONE or engine.faults:
        raise UserError("; ".join(engine.faults) or f"the rows from {rows[0].identity} on end as {state}")


def _mountings(rows: Sequence[Row]) -> Counter[str]:
    """How often each sample was mounted in rows."""
    mounts = [row.sample for row in rows if row.kind == "mount"]
    return Counter(sample for before, sample in zip(["", *mounts], mounts, strict=False) if sample not in (before, NO_SAMPLE))


def run_blocks(plan: Plan, blocks: Sequence[Block], path: Path, runner: Runner, listeners: Sequence[Listener]) -> float:
    """Rehearse the blocks, and write their rows to a new journal, in the order of the plan; their simulated time together, s.

    Listeners get the committed rows. Raises UserError for a block that fails, and for two that overlap: the plan then has to be
    rehearsed in one process.
    """
    left = list(accumulate((row.seconds for row in reversed(plan.rows)), initial=0.0))[::-1]
    with (
        tempfile.TemporaryDirectory(prefix="goniotwin-blocks-") as name,
        Journal.create(path, plan, software_versions(), durable=False) as journal,
    ):
        folder = Path(name)
        of = specification(plan, blocks, folder)
        waiting: dict[int, Path] = {}
        done, ended, joined = 0, 0.0, 0
        with contextlib.closing(runner.run(rehearse_block, of, range(len(blocks)))) as computed:
            for each in computed:
                if each is None:
                    continue
                if each.failure:
                    raise UserError(each.failure)
                waiting[each.chunk] = folder / f"{each.chunk}.journal"
                waiting[each.chunk].write_bytes(each.arrays["journal"].tobytes())
                while joined in waiting:
                    with Journal.open(waiting.pop(joined)) as part:
                        (session,) = part.sessions()
                        if session.started_s < ended:
                            raise UserError("its blocks overlap in time")
                        ended = session.ended_s
                        number = journal.begin_session(session.started_s, plan.rig.text, software_versions())
                        for row in part.rows():
                            journal.commit(row.row, row.data)
                            done += 1
                            for listener in listeners:
                                listener(RowCommitted(row.row, row.data, done, len(plan.rows), left[done]))
                        for t, kind, text in part.events():
                            journal.event(t, kind, text)
                        journal.end_session(number, ended, "done")
                    joined += 1
        return journal.seconds
