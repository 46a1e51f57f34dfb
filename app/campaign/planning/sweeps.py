"""Plans whose arc would meet the incoming beam: where, what may be left out of them, and which key is at fault."""

from collections.abc import Iterator, Sequence

import numpy as np

from goniotwin.app.campaign.planning.nesting import swept
from goniotwin.app.campaign.planning.planned_rows import PlannedRows
from goniotwin.app.campaign.planning.timeline import Run
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.drivers import ArcClearance

CROSS_CHECKS = ("overlap", "symmetry_check")


def first_sweep(rows: Sequence[Row], clearance: ArcClearance) -> str | None:
    """On the way to which row the arc would meet the beam first, and why; None: it keeps clear."""
    assert isinstance(rows, PlannedRows)
    last = None
    for piece in rows.pieces:
        if isinstance(piece, Run):
            points = piece.of.lattice.points[piece.points]
        elif piece.pose is not None:
            points = np.array([[*piece.pose, 0.0]])
        else:
            continue
        way = np.concatenate([points[:1] if last is None else last, points])
        hits = np.flatnonzero(swept(clearance, way))
        if hits.size:
            k = int(hits[0])
            reason = clearance.veto((way[k, 2], way[k + 1, 2]), (way[k, 3], way[k + 1, 3]))
            identity = piece.of.identities(piece.points[k : k + 1])[0] if isinstance(piece, Run) else piece.identity
            return f"on the way to {identity}: {reason}"
        last = points[-1:]
    return None


def spared(file: ScheduleFile) -> Iterator[tuple[str, ...]]:
    """Which tables to leave out: none, then one of the cross-checks after the other, then all."""
    there = tuple(name for name in CROSS_CHECKS if getattr(file, name) is not None)
    yield ()
    if len(there) > 1:
        yield from ((name,) for name in there)
    if there:
        yield there


def other_schedules(file: ScheduleFile) -> Iterator[tuple[str, ScheduleFile]]:
    """The same schedule without what may be at fault beside the grids, its cross-checks left out; and which keys that are."""
    plain = file.model_copy(update=dict.fromkeys(CROSS_CHECKS))
    if file.order != "fastest" or not file.back_and_forth:
        yield (
            'order and back_and_forth: "fastest" and true find a way',
            plain.model_copy(update={"order": "fastest", "back_and_forth": True}),
        )
    if file.near_specular is not None:
        yield "near_specular.shift_deg or beta_deg", plain.model_copy(update={"near_specular": None})
    if file.drift is not None:
        yield "drift.beta_deg or drift.shift_deg", plain.model_copy(update={"drift": None})
