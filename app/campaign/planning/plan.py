"""The plan: the rows that follow from a schedule on one rig, in order, each with a stable identity.

A row is a commit point. Darks and mountings are rows like any other.

Plans whose arc would meet the incoming beam: where, what may be left out of them, and which key is at fault.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Timing
from goniotwin.app.campaign.planning.exposure import expected_reading_s, exposure_twin
from goniotwin.app.campaign.planning.lower_bound import plan_lower_bound_s
from goniotwin.app.campaign.planning.mountings import Pass, mountings
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.app.campaign.planning.scan_order import PassOrder, ScanOrder, fastest_scan_order
from goniotwin.app.campaign.planning.timeline import MeasurementBlock, PlannedRows, PlanTimeline, RowTemplates
from goniotwin.app.campaign.planning.validation import (
    gain_numbers,
    min_rows,
    refuse_beyond_limits,
    refuse_too_many_checks,
    refuse_too_many_poses,
    refuse_too_many_rows,
    refuse_uncertified,
    refuse_unknown_samples,
)
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import ScheduleDescription, ScheduleFile
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, arc_clearance
from goniotwin.drivers import ArcClearance

CROSS_CHECKS = ("overlap", "symmetry_check")


def first_collision(rows: Sequence[Row], clearance: ArcClearance) -> str | None:
    """On the way to which row the arc would meet the beam first, and why; None: it keeps clear."""
    assert isinstance(rows, PlannedRows)
    last = None
    for piece in rows.pieces:
        if isinstance(piece, MeasurementBlock):
            points = piece.scan_pass.grid.points[piece.points]
        elif piece.pose is not None:
            points = np.array([[*piece.pose, 0.0]])
        else:
            continue
        way = np.concatenate([points[:1] if last is None else last, points])
        hits = np.flatnonzero(crosses_beam(clearance, way))
        if hits.size:
            k = int(hits[0])
            reason = clearance.collision((way[k, 2], way[k + 1, 2]), (way[k, 3], way[k + 1, 3]))
            identity = (
                piece.scan_pass.identities(piece.points[k : k + 1])[0]
                if isinstance(piece, MeasurementBlock)
                else piece.identity
            )
            return f"on the way to {identity}: {reason}"
        last = points[-1:]
    return None


def omissions(file: ScheduleFile) -> Iterator[tuple[str, ...]]:
    """Which tables to leave out: none, then one of the cross-checks after the other, then all."""
    there = tuple(name for name in CROSS_CHECKS if getattr(file, name) is not None)
    yield ()
    if len(there) > 1:
        yield from ((name,) for name in there)
    if there:
        yield there


def remedies(file: ScheduleFile) -> Iterator[tuple[str, ScheduleFile]]:
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


@dataclass(frozen=True)
class PlanDetails:
    """How a plan was made: how its rows are read, what is measured of what is mounted, the orders of its grids, how old a
    dark gets, what a row with each sample takes to be read (s, where a twin's light says so), and the schedule's tables that
    had to be left out to keep the arc clear of the beam.
    """

    templates: RowTemplates
    mountings: list[list[Pass]]
    orders: dict[ScanGrid, ScanOrder]
    oldest_dark_s: float
    expected_reading_s: dict[str, float]
    omitted: tuple[str, ...] = ()


@dataclass(frozen=True)
class Plan:
    """Rows with their foretold durations, on the rig's clock; `made` where it was made just now, not read from a journal."""

    schedule: ScheduleDescription
    rig: RigDescription
    rows: Sequence[Row]
    details: PlanDetails | None = None

    @property
    def seconds(self) -> float:
        """The whole duration foretold, without the time that a person takes to mount samples."""
        return self.rows.seconds if isinstance(self.rows, PlannedRows) else sum(row.seconds for row in self.rows)

    @property
    def lower_bound_s(self) -> float:
        """The lower bound of the machine time, s: no order of the rows takes less. Only of a plan that was just made."""
        assert self.details is not None
        return plan_lower_bound_s(self.rig.file, self.details.templates, self.details.mountings)


def make_plan(schedule: ScheduleDescription, rig: RigDescription) -> Plan:
    """The rows of a schedule on a rig. Raises UserError for what the rig cannot do, naming file and key.

    Where the arc would meet the beam, cross-checks are left out rather than the campaign.
    """
    refuse_too_many_rows(schedule)
    refuse_beyond_limits(schedule, rig)
    gains = gain_numbers(schedule, rig)
    refuse_unknown_samples(schedule, rig)
    refusal = None
    for without in omissions(schedule.file):
        plan = _build_plan(schedule, rig, gains, without)
        sweep = first_collision(plan.rows, arc_clearance(rig.file))
        if sweep is None:
            return plan
        refusal = refusal or sweep
    for key, other in remedies(schedule.file):
        if first_collision(_build_plan(replace(schedule, file=other), rig, gains, ()).rows, arc_clearance(rig.file)) is None:
            raise UserError(f"{schedule.name}: {refusal}; change {key}")
    raise UserError(f"{schedule.name}: {refusal}; change beta_deg or shift_deg")


def _build_plan(schedule: ScheduleDescription, rig: RigDescription, gains: tuple[int, ...], without: tuple[str, ...]) -> Plan:
    """A plan `without` some tables of its schedule, whatever its arc meets on its way. Raises UserError."""
    file = schedule.file.model_copy(update=dict.fromkeys(without))
    templates, clearance = RowTemplates(file, gains), arc_clearance(rig.file)
    try:
        mounted = mountings(file, rig.file)
    except ValueError as error:
        raise UserError(f"{schedule.name}: {error}") from None
    refuse_too_many_poses(schedule, mounted)
    refuse_uncertified(schedule, rig.file, mounted[1][0].poses.angles)
    timeline = PlanTimeline(file, templates, Timing(rig.file), clearance)
    refuse_too_many_checks(schedule, min_rows(mounted, templates, timeline.timing), "at least ")
    timeline.timing.expected_reading_s.update(_expected_readings(schedule, rig, mounted, templates, timeline.timing))
    timeline.warm_up(float(np.median(mounted[0][0].grid.wavelengths_nm)))
    moves = timeline.timing.moves
    grids = dict.fromkeys(each.grid for passes in mounted for each in passes)
    found = {grid: fastest_scan_order(grid, file, moves, clearance) for grid in grids}
    orders, sequences = PassOrder(mounted, file, moves, clearance).fastest(found, timeline.timing.here)
    turn = iter(sequences)
    for passes in mounted:
        timeline.mount(passes[0].sample)
        for each in passes:
            timeline.measure(each, next(turn))
        timeline.dismount(passes[-1].sample)
    rows = PlannedRows(timeline.pieces, templates)
    refuse_too_many_checks(schedule, rows.kinds)
    return Plan(
        schedule,
        rig,
        rows,
        PlanDetails(templates, mounted, orders, timeline.oldest_dark_s, timeline.timing.expected_reading_s, without),
    )


def _expected_readings(
    schedule: ScheduleDescription, rig: RigDescription, mounted: list[list[Pass]], templates: RowTemplates, timing: Timing
) -> dict[str, float]:
    """By sample, what a row takes to be read, where the light decides and there is a twin to ask."""
    file = schedule.file
    if file.averaging is None and file.gains_v_per_a != "automatic":
        return {}
    model = exposure_twin(rig, file.etalon, file.samples)
    if model is None:
        return {}
    samples = {passes[0].sample: passes for passes in mounted}
    return {
        name: expected_reading_s(rig, model, passes, templates.measurement(name), timing) for name, passes in samples.items()
    }
