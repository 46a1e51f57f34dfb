"""A rehearsal in blocks of rows, this process and others at the same time, then put together in one journal.

A block begins with a dark reading, or the mounting before it, so that nothing of the rows before it is needed: each is a
session of the journal, as in a campaign that was interrupted there. It begins at the time at which the plan expects it, and a
little later: lamp and noise are those of other times than in one process, and the disturbances that a twin draws for each move
are others. The axes come from their reference and the monochromator from its start, which takes some seconds more. With noise,
drift and disturbances off, the values of the rows are the same.

This process rehearses the first block and writes its rows to the journal. It has no start, and so the longest block. The others
send their rows as their journals keep them; they get a place in the chain here, and nothing else is made again.
"""

import base64
import contextlib
import json
import tempfile
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import accumulate, chain
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal, software_versions
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.assumed_references import assume_referenced
from goniotwin.app.campaign.rehearsal.expected_poses import expected_poses
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.running.engine import Engine
from goniotwin.app.campaign.running.events import Event, Listener, RowCommitted, State
from goniotwin.app.campaign.running.operator import VirtualOperator
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import open_rig
from goniotwin.app.rig.embedding import embed_rig, embedded_rig
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.protocols.clock import VirtualClock

VERSION = 2
STARTING_ROWS = 1200
"""Rows that a process rehearses in the time in which another one starts: imports, and the kernels of the optics."""
LATER_S, LATER = 30.0, 0.02
"""By how much a block begins after the time that the plan expects, s, and as a share of it: not before the one before ends."""
NAME = "the schedule"
OTHER_TIMES = "lamp, noise and random positions are those of the times that the plan expects, not of those in one process"


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
    return "" if len(_beginnings(plan.rows)) > 1 else "it has one dark reading"


def divide(plan: Plan, count: int, starting_rows: int = STARTING_ROWS) -> list[Block]:
    """The plan in `count` blocks, or fewer: a single one where the start of a process takes longer than its rows.

    The first block has as many rows more as are rehearsed while the process of another one starts.
    """
    beginnings, rows = _beginnings(plan.rows), len(plan.rows)
    count = min(count, len(beginnings))
    share = (rows - starting_rows) / count
    wanted = [rows - share * k for k in range(1, count)] if share > 0.0 else []
    firsts = sorted({0, *(min(beginnings, key=lambda at: abs(at - row)) for row in wanted)})
    before = list(accumulate((row.seconds for row in plan.rows), initial=0.0))
    starts = [before[first] * (1.0 + LATER) + LATER_S * k for k, first in enumerate(firsts)]
    starts[0] = 0.0
    return [Block(first, last, start) for first, last, start in zip(firsts, [*firsts[1:], rows], starts, strict=True)]


def _beginnings(rows: Sequence[Row]) -> list[int]:
    """The first row, and the dark readings, or in their place the mounting right before."""
    return [0] + [k - (rows[k - 1].kind == "mount") for k, row in enumerate(rows) if row.kind == "dark" and k > 1]


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


def statistics_of(plan: Plan) -> RowStatistics:
    """Statistics of a plan's rows, none counted yet."""
    return RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan))


def rehearse_block(of: Specification, chunk: int) -> Arrays:
    """The journal of one block, as the bytes of its file, and the statistics of its rows.

    Raises UserError where the block does not come to its end.
    """
    with tempfile.TemporaryDirectory(prefix="goniotwin-block-") as name:
        folder = Path(name)
        plan = _plan(of, folder)
        block = Block(**of.data["blocks"][chunk])
        path, statistics = folder / "block.journal", statistics_of(plan)
        with Journal.create(path, plan, software_versions(), durable=False) as journal:
            _run(plan, block, journal, [statistics])
        found = json.dumps(statistics.as_data()).encode()
        return {"journal": np.frombuffer(path.read_bytes(), np.uint8), "statistics": np.frombuffer(found, np.uint8)}


def _plan(of: Specification, folder: Path) -> Plan:
    data = of.data
    tables = folder / "tables"
    tables.mkdir()
    schedule = replace(parse_schedule(data["schedule"]["text"], NAME), certificate=data["schedule"]["certificate"])
    path = folder / "plan.journal"
    path.write_bytes(base64.b64decode(data["plan"]))
    with Journal.open(path) as journal:
        return Plan(schedule, embedded_rig(data["rig"], tables), journal.planned_rows())


def _run(plan: Plan, block: Block, journal: Journal, listeners: list[Listener]) -> None:
    """Rehearse a block. Raises UserError where it does not come to its end, KeyboardInterrupt after a Ctrl-C."""
    rows = plan.rows[block.first : block.last]
    mounted = next((k for k in range(block.first, -1, -1) if plan.rows[k].kind == "mount"), None)
    mountings = _mountings(plan.rows[: block.first if mounted is None else mounted])
    with open_rig(plan.rig, VirtualClock(block.start_s)) as opened:
        opened.connect()
        assume_referenced(opened)
        assert opened.virtual is not None
        operator, coming = VirtualOperator(opened.virtual), rows
        opened.virtual.plant.count_mountings(mountings)
        if mounted is not None and mounted != block.first:
            operator.mount(plan.rows[mounted].sample)
            coming = (plan.rows[mounted], *rows)
        opened.virtual.plant.expect(expected_poses(coming, opened.rig, mountings))
        engine = Engine(opened.rig, plan, journal, operator, listeners, work=rows)
        state = engine.run()
    if state is State.IDLE and not engine.faults:
        raise KeyboardInterrupt
    if state is not State.DONE or engine.faults:
        raise UserError("; ".join(engine.faults) or f"the rows from {rows[0].identity} on end as {state}")


def _mountings(rows: Sequence[Row]) -> Counter[str]:
    """How often each sample was mounted in rows."""
    mounts = [row.sample for row in rows if row.kind == "mount"]
    return Counter(sample for before, sample in zip(["", *mounts], mounts, strict=False) if sample not in (before, NO_SAMPLE))


def run_blocks(
    plan: Plan, blocks: Sequence[Block], path: Path, runner: Runner, statistics: RowStatistics, listeners: Sequence[Listener]
) -> float:
    """Rehearse the first block here and the others by a runner; their simulated time together, s.

    Their rows are in a new journal, in the order of the plan. Listeners get the committed rows. Raises UserError for a block
    that fails, and for two that overlap: the plan then has to be rehearsed in one process.
    """
    left = list(accumulate((row.seconds for row in reversed(plan.rows)), initial=0.0))[::-1]

    def notify(event: Event) -> None:
        """An event of the first block, counted as one of the whole."""
        if isinstance(event, RowCommitted):
            done = event.row.number + 1
            event = RowCommitted(event.row, event.data, done, len(plan.rows), left[done])
        for listener in listeners:
            listener(event)

    with (
        tempfile.TemporaryDirectory(prefix="goniotwin-blocks-") as name,
        Journal.create(path, plan, software_versions(), durable=False) as journal,
    ):
        folder = Path(name)
        of, waiting, joined = specification(plan, blocks, folder), dict[int, Arrays](), 1
        with contextlib.closing(runner.run(rehearse_block, of, range(1, len(blocks)))) as computed:
            begun = next(computed, None)  # from now on they are being computed
            _run(plan, blocks[0], journal, [statistics, notify])
            for each in chain([begun], computed):
                if each is None:
                    continue
                if each.failure:
                    raise UserError(each.failure)
                waiting[each.chunk] = each.arrays
                while joined in waiting:
                    arrays, part = waiting.pop(joined), folder / f"{joined}.journal"
                    part.write_bytes(arrays["journal"].tobytes())
                    own = plan.rows[blocks[joined].first : blocks[joined].last]
                    journal.append_session(part, plan.rig.text, own)
                    journal.event(blocks[joined].start_s, "block", f"from {own[0].identity} on: {OTHER_TIMES}")
                    statistics.add(json.loads(arrays["statistics"].tobytes()))
                    for row in journal.rows_of([row.number for row in own] if listeners else []):
                        notify(RowCommitted(row.row, row.data, 0, 0, 0.0))
                    joined += 1
        return journal.seconds
