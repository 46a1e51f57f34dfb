"""The plan: the rows that follow from a schedule on one rig, in order, each with a stable identity.

A row is a commit point. Dark readings and mountings are rows like any other. If the arc would collide with the incoming beam in
every order, the tables that cause it are omitted, or the schedule is refused with the key at fault.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.geometry.collision import crosses_beam
from goniotwin.app.campaign.planning.durations import Timing
from goniotwin.app.campaign.planning.lower_bound import plan_lower_bound_s
from goniotwin.app.campaign.planning.mountings import Pass, mountings
from goniotwin.app.campaign.planning.scan_grid import ScanGrid
from goniotwin.app.campaign.planning.scan_order import PassOrder, ScanOrder, fastest_scan_order
from goniotwin.app.campaign.planning.timeline import MeasurementBlock, PlannedRows, PlanTimeline, RowTemplates
from goniotwin.app.campaign.planning.validation import (
    gain_numbers,
    min_rows,
    refuse_beyond_limits,
    refuse_future_calibration,
    refuse_too_long,
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
from goniotwin.arrays import Floats
from goniotwin.drivers import ArcClearance

CROSS_CHECKS = ("overlap", "symmetry_check")
"""Tables of the schedule that may be omitted."""


@dataclass(frozen=True)
class Plan:
    """Rows with their estimated durations on the rig's clock: a new plan, or that of a journal."""

    schedule: ScheduleDescription
    rig: RigDescription
    rows: Sequence[Row]

    @property
    def seconds(self) -> float:
        """Estimated duration, without the time that the operator takes to mount samples."""
        return sum(row.seconds for row in self.rows)


@dataclass(frozen=True)
class NewPlan(Plan):
    """A plan with what it was made from.

    `templates`: how its rows are read. `mountings`: the passes of each mounting. `orders`: the scan order of each grid.
    `oldest_dark_s`: greatest age of a dark reading. `expected_reading_s`: by sample, the time to read a row in s, where it
    follows from a twin's signal. `omitted`: tables of the schedule that had to be omitted to keep the arc clear of the beam.
    """

    rows: PlannedRows
    templates: RowTemplates
    mountings: list[list[Pass]]
    orders: dict[ScanGrid, ScanOrder]
    oldest_dark_s: float
    expected_reading_s: Mapping[str, float]
    omitted: tuple[str, ...]

    @property
    def seconds(self) -> float:
        """Estimated duration, without the time that the operator takes to mount samples."""
        return self.rows.seconds

    @property
    def of_samples(self) -> Pass:
        """A pass of a sample: all of them have the same poses."""
        return _of_samples(self.schedule.file, self.mountings)

    @property
    def lower_bound_s(self) -> float:
        """Lower bound of the machine time in s: no order of the rows takes less."""
        return plan_lower_bound_s(self.rig.file, self.templates, self.mountings)


def make_plan(schedule: ScheduleDescription, rig: RigDescription) -> NewPlan:
    """Make the plan of a schedule on a rig. Raises UserError, with file and key, for what the rig cannot do.

    If the arc would collide with the beam, cross-checks are omitted before the schedule is refused.
    """
    refuse_too_many_rows(schedule)
    refuse_beyond_limits(schedule, rig)
    gains = gain_numbers(schedule, rig)
    refuse_unknown_samples(schedule, rig)
    refuse_future_calibration(schedule, rig.file)
    clearance = arc_clearance(rig.file)
    reason = None
    for omitted in _omissions(schedule.file):
        plan = _build_plan(schedule, rig, gains, omitted)
        collision = first_collision(plan.rows, clearance)
        if collision is None:
            return plan
        reason = reason or collision
    for remedy, file in _remedies(schedule.file):
        if first_collision(_build_plan(replace(schedule, file=file), rig, gains, ()).rows, clearance) is None:
            raise UserError(f"{schedule.name}: {reason}; {remedy}")
    raise UserError(f"{schedule.name}: {reason}; change beta_deg or shift_deg")


def first_collision(rows: PlannedRows, clearance: ArcClearance) -> str | None:
    """The first row on the way to which the arc would collide with the beam, and the reason; None without a collision."""
    last = None
    for piece in rows.ways:
        if isinstance(piece, MeasurementBlock):
            points = piece.scan_pass.grid.points[piece.points]
        elif piece.pose is not None:
            points = np.array([[*piece.pose, 0.0]])
        else:
            continue
        path = np.concatenate([points[:1] if last is None else last, points])
        hits = np.flatnonzero(crosses_beam(clearance, path))
        if hits.size:
            k = int(hits[0])
            reason = clearance.collision((path[k, 2], path[k + 1, 2]), (path[k, 3], path[k + 1, 3]))
            if isinstance(piece, MeasurementBlock):
                identity = piece.scan_pass.identities(piece.points[k : k + 1])[0]
            else:
                identity = piece.identity
            return f"on the way to {identity}: {reason}"
        last = points[-1:]
    return None


def _omissions(file: ScheduleFile) -> Iterator[tuple[str, ...]]:
    """Sets of tables to omit, in the order of trial: none, one of the cross-checks, all."""
    present = tuple(name for name in CROSS_CHECKS if getattr(file, name) is not None)
    yield ()
    if len(present) > 1:
        yield from ((name,) for name in present)
    if present:
        yield present


def _remedies(file: ScheduleFile) -> Iterator[tuple[str, ScheduleFile]]:
    """Changes that may avoid a collision, and the schedule with each of them, without cross-checks."""
    plain = file.model_copy(update=dict.fromkeys(CROSS_CHECKS))
    if file.order != "fastest" or not file.back_and_forth:
        yield (
            'set order = "fastest" and back_and_forth = true',
            plain.model_copy(update={"order": "fastest", "back_and_forth": True}),
        )
    if file.near_specular is not None:
        yield "change near_specular.shift_deg or beta_deg", plain.model_copy(update={"near_specular": None})
    if file.drift is not None:
        yield "change drift.beta_deg or drift.shift_deg", plain.model_copy(update={"drift": None})


def _build_plan(
    schedule: ScheduleDescription, rig: RigDescription, gains: tuple[int, ...], omitted: tuple[str, ...]
) -> NewPlan:
    """The plan without the `omitted` tables; it may have collisions. Raises UserError."""
    file = schedule.file.model_copy(update=dict.fromkeys(omitted))
    templates, clearance = RowTemplates(file, gains), arc_clearance(rig.file)
    try:
        mounted = mountings(file, rig.file)
    except ValueError as error:
        raise UserError(f"{schedule.name}: {error}") from None
    refuse_too_many_poses(schedule, mounted)
    refuse_uncertified(schedule, rig.file, _of_samples(file, mounted).poses.angles)
    timing = Timing(rig.file)
    refuse_too_many_checks(schedule, min_rows(mounted, templates, timing), "at least ")
    timing = Timing(rig.file, _expected_readings(schedule, rig, mounted, templates, timing))
    timeline = PlanTimeline(file, templates, timing, clearance)
    timeline.warm_up(_median(mounted[0][0].grid.wavelengths_nm))
    grids = dict.fromkeys(each.grid for passes in mounted for each in passes)
    candidates = {grid: fastest_scan_order(grid, file, timing.moves, clearance) for grid in grids}
    orders, sequences = PassOrder(mounted, file, timing.moves, clearance).fastest(candidates, timeline.state.point)
    remaining = iter(sequences)
    for passes in mounted:
        timeline.mount(passes[0].sample)
        for each in passes:
            timeline.measure(each, next(remaining))
        timeline.dismount(passes[-1].sample)
    rows = PlannedRows(timeline.pieces, templates)
    refuse_too_many_checks(schedule, rows.kinds)
    refuse_too_long(schedule, rig, rows.seconds)
    return NewPlan(schedule, rig, rows, templates, mounted, orders, timeline.oldest_dark_s, timing.expected_reading_s, omitted)


def _of_samples(file: ScheduleFile, mounted: list[list[Pass]]) -> Pass:
    """The first pass of the first sample, which is mounted after the standards."""
    return mounted[len(file.standards)][0]


def _median(values: Floats) -> float:
    """The median; numpy's own loads its masked arrays first."""
    ordered, middle = np.sort(values), len(values) // 2
    return float(0.5 * (ordered[(len(values) - 1) // 2] + ordered[middle]))


def _expected_readings(
    schedule: ScheduleDescription, rig: RigDescription, mounted: list[list[Pass]], templates: RowTemplates, timing: Timing
) -> dict[str, float]:
    """By sample, the time to read a row in s; empty where it does not depend on the light, or there is no twin."""
    file = schedule.file
    if file.averaging is None and file.gains_v_per_a != "automatic":
        return {}
    from goniotwin.app.campaign.planning.exposure import expected_reading_s, exposure_twin  # loads the twin's optics

    model = exposure_twin(rig, file)
    if model is None:
        return {}
    samples = {passes[0].sample: passes for passes in mounted}
    return {
        name: expected_reading_s(rig, model, passes, templates.measurement(name), timing) for name, passes in samples.items()
    }
