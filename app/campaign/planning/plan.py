"""The plan: the rows that follow from a schedule on one rig, in order, each with a stable identity.

A row is a commit point. Darks and mountings are rows like any other.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from app.campaign.planning.chaining import Chain
from app.campaign.planning.lattice import Lattice
from app.campaign.planning.limits import gain_numbers, refuse_beyond_limits, refuse_unknown_samples
from app.campaign.planning.nesting import swept
from app.campaign.planning.order import Order, fastest_order
from app.campaign.planning.passes import Pass, mountings
from app.campaign.planning.planned_rows import PlannedRows
from app.campaign.planning.row_limit import fewest_rows, refuse_too_many, refuse_too_many_beside, refuse_too_many_poses
from app.campaign.planning.timeline import Measuring, Run, Timeline
from app.campaign.planning.timing import Timing
from app.campaign.row import Row
from app.campaign.schedule.file import ScheduleDescription
from app.errors import UserError
from app.rig import RigDescription, arc_clearance


@dataclass(frozen=True)
class Made:
    """How a plan was made: how its rows are read, what is measured of what is mounted, the orders of its lattices, and how
    old a dark gets.
    """

    measuring: Measuring
    mountings: list[list[Pass]]
    orders: dict[Lattice, Order]
    oldest_dark_s: float


@dataclass(frozen=True)
class Plan:
    """Rows with their foretold durations, on the rig's clock; `made` where it was made just now, not read from a journal."""

    schedule: ScheduleDescription
    rig: RigDescription
    rows: Sequence[Row]
    made: Made | None = None

    @property
    def seconds(self) -> float:
        """The whole duration foretold, without the time that a person takes to mount samples."""
        return self.rows.seconds if isinstance(self.rows, PlannedRows) else sum(row.seconds for row in self.rows)


def make_plan(schedule: ScheduleDescription, rig: RigDescription) -> Plan:
    """The rows of a schedule on a rig. Raises UserError for what the rig cannot do, naming file and key."""
    file = schedule.file
    refuse_too_many(schedule)
    refuse_beyond_limits(schedule, rig)
    measuring = Measuring(file, gain_numbers(schedule, rig))
    refuse_unknown_samples(schedule, rig)
    try:
        mounted = mountings(file, rig.file)
    except ValueError as error:
        raise UserError(f"{schedule.name}: {error}") from None
    refuse_too_many_poses(schedule, mounted)
    timeline = Timeline(file, measuring, Timing(rig.file))
    refuse_too_many_beside(schedule, fewest_rows(mounted, measuring, timeline.timing), "at least ")
    timeline.warm_up(float(np.median(mounted[0][0].lattice.wavelengths_nm)))
    clearance, moves = arc_clearance(rig.file), timeline.timing.moves
    lattices = dict.fromkeys(each.lattice for passes in mounted for each in passes)
    found = {lattice: fastest_order(lattice, file, moves, clearance) for lattice in lattices}
    orders, sequences = Chain(mounted, file, moves, clearance).fastest(found, timeline.timing.here)
    turn = iter(sequences)
    for passes in mounted:
        timeline.mount(passes[0].sample)
        for each in passes:
            timeline.measure(each, next(turn))
        timeline.dismount(passes[-1].sample)
    rows = PlannedRows(timeline.pieces, measuring)
    refuse_too_many_beside(schedule, rows.kinds)
    plan = Plan(schedule, rig, rows, Made(measuring, mounted, orders, timeline.oldest_dark_s))
    _refuse_sweeps(plan)
    return plan


def _refuse_sweeps(plan: Plan) -> None:
    """No row may have the arc sweep through what it must keep clear of, on its way from the row before."""
    clearance = arc_clearance(plan.rig.file)
    assert isinstance(plan.rows, PlannedRows)
    last = None
    for piece in plan.rows.pieces:
        if isinstance(piece, Run):
            points = piece.of.lattice.points[piece.points]
        elif piece.pose is not None:
            points = np.array([[*piece.pose, 0.0]])
        else:
            continue
        way = points if last is None else np.concatenate([last, points])
        hits = np.flatnonzero(swept(clearance, way[:1].repeat(2, axis=0) if len(way) == 1 else way))
        if hits.size:
            k = int(hits[0])
            first, then = way[k], way[min(k + 1, len(way) - 1)]
            reason = clearance.veto((first[2], then[2]), (first[3], then[3]))
            place = k if last is not None else k + 1
            identity = piece.of.identities(piece.points[place : place + 1])[0] if isinstance(piece, Run) else piece.identity
            raise UserError(f"{plan.schedule.name}: on the way to {identity}: {reason}; change beta_deg or shift_deg")
        last = points[-1:]
