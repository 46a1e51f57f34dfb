"""Check of a plan before any device is opened: rows, duration, scan order and its reason, blocked directions, warnings."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.arcs import lit_arc, observed_directions
from goniotwin.app.campaign.geometry.directions import Arc
from goniotwin.app.campaign.planning.loop_order import LoopOrder
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.planning.scan_grid import FILTER, WAVELENGTH, ScanGrid
from goniotwin.app.campaign.planning.scan_order import ScanOrder
from goniotwin.app.campaign.planning.timeline import MeasurementBlock
from goniotwin.app.campaign.planning.warnings import duration_range, plan_warnings
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import LOOP_NAMES
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.rig import AXES
from goniotwin.arrays import Floats

COLUMN_NAMES = (*LOOP_NAMES, "filter")
PATH_SEARCH = "path search"
MAX_LISTED = 6
"""Number of sigmas that are listed with blocked directions."""


@dataclass(frozen=True)
class BlockedDirections:
    """Directions of one arc that the mirror unit blocks at one sigma, as zenith and azimuth (n, 2), deg.

    `only_for_etalon`: how many of them at the etalon alone. `specular`: the specular direction, or that straight through, is
    among them.
    """

    sigma: float
    arc: Arc
    only_for_etalon: int
    specular: bool
    zenith_azimuth: Floats


@dataclass(frozen=True)
class PlanCheck:
    """The check of a plan, as `goniotwin check --json` prints it.

    `least_s` is the lower bound of the duration, `order` has the loops, the innermost first, and `why` the reason for it.
    `kinds` are rows by kind, `axes_deg` the range of each axis. `shadowed` is the number of directions that the mirror unit
    blocks, `overlaps` that of directions that two photodiodes measure, `left_out` that of poses omitted by symmetry.
    `unreferenced` axes need a reference after a power-up.
    """

    rows: int
    duration_s: float
    duration_range_s: tuple[float, float]
    least_s: float
    order: list[str]
    why: str
    kinds: dict[str, int]
    axes_deg: dict[str, list[float]]
    directions: int
    shadowed: int
    shadowed_only_for_etalon: int
    shadowed_deg: list[BlockedDirections]
    overlaps: int
    left_out: int
    filter_changes: int
    warnings: list[str]
    mountings: list[str]
    unreferenced: list[str]
    simulated: bool


def check_plan(plan: NewPlan) -> PlanCheck:
    """Check a plan."""
    rows = plan.rows
    arcs = observed_directions(plan.schedule.file, plan.rig.file, plan.of_samples.poses.angles)
    return PlanCheck(
        rows=len(rows),
        duration_s=plan.seconds,
        duration_range_s=duration_range(plan),
        least_s=plan.lower_bound_s,
        order=loop_names(sample_order(plan)[1]),
        why=explain_order(plan),
        kinds=rows.kinds,
        axes_deg=_ranges(plan),
        directions=sum(each.directions for each in arcs),
        shadowed=sum(len(each.blocked_deg) for each in arcs),
        shadowed_only_for_etalon=sum(each.blocked_only_at_etalon for each in arcs),
        shadowed_deg=[
            BlockedDirections(each.sigma_deg, each.arc, each.blocked_only_at_etalon, each.specular_blocked, each.blocked_deg)
            for each in arcs
            if len(each.blocked_deg)
        ],
        overlaps=sum(each.shared for each in arcs),
        left_out=plan.of_samples.poses.left_out,
        filter_changes=filter_changes(plan)[0],
        warnings=plan_warnings(plan, arcs),
        mountings=[passes[0].sample for passes in plan.mountings],
        unreferenced=_unreferenced(plan),
        simulated=plan.rig.simulated,
    )


def sample_order(plan: NewPlan) -> tuple[ScanGrid, ScanOrder]:
    """Grid and scan order of the samples; the etalon and the open beam may have other poses."""
    grid = plan.of_samples.grid
    return grid, plan.orders[grid]


def loop_names(order: ScanOrder) -> list[str]:
    """The loops of a scan order, the innermost first."""
    return [COLUMN_NAMES[column] for column in reversed(order.loop_order.columns)]


def explain_order(plan: NewPlan) -> str:
    """The loop orders that were compared, with the approximate duration of the campaign in each, and the filter changes.

    The one that was taken comes first.
    """
    grid, order = sample_order(plan)
    passes = sum(each.grid is grid for mounted in plan.mountings for each in mounted)
    seconds = {PATH_SEARCH: plan.seconds} if order.improved else {}
    for loop_order in sorted(order.candidates, key=lambda each: (each != order.loop_order, order.candidates[each])):
        if order.candidates[loop_order] < float("inf"):
            duration = plan.seconds + (order.candidates[loop_order] - order.seconds) * passes
            for label in _labels(loop_order, order.loop_order):
                seconds.setdefault(label, duration)
    count, wheel_s = filter_changes(plan)
    filters = f"; filter changes: {count}, {duration_text(wheel_s)}" if count else ""
    comparison = "; ".join(f"{label}: {duration_text(duration)}" for label, duration in seconds.items())
    if plan.schedule.file.order != "fastest":
        return f"set by the schedule. {comparison}{filters}"
    return f"{comparison if len(seconds) > 1 else 'there is only one loop'}{filters}"


def filter_changes(plan: NewPlan) -> tuple[int, float]:
    """Number of filter changes of a plan, and the seconds that the wheel turns for them."""
    wheel, wavelengths = plan.rig.file.monochromator.wheel, [np.array([np.nan])]
    for piece in plan.rows.ways:
        if isinstance(piece, MeasurementBlock):
            of_grid = piece.scan_pass.grid.wavelengths_nm
            wavelengths.append(of_grid[piece.points % len(of_grid)])
        elif piece.wavelength_nm is not None:
            wavelengths.append(np.array([piece.wavelength_nm]))
    sequence = np.concatenate(wavelengths)
    changes = sequence[:-1], sequence[1:]
    return int(np.count_nonzero(wheel.steps(*changes))), float(wheel.seconds(*changes).sum())


def _labels(loop_order: LoopOrder, taken: LoopOrder) -> list[str]:
    """Labels of a loop order. A loop over the filters is only named with the innermost loop of the order that is `taken`."""
    columns = loop_order.columns
    if len(columns) < 2:
        return ["one loop"]
    outside = ["wavelength outside"] if columns[0] == WAVELENGTH else []
    by_filter = ", filter by filter" if FILTER in columns and columns[-1] == taken.columns[-1] else ""
    return [f"{COLUMN_NAMES[columns[-1]]} inside{by_filter}", *outside]


def describe_check(plan: NewPlan, result: PlanCheck) -> str:
    """The result of `check_plan` as text."""
    file = plan.schedule.file
    kinds = ", ".join(f"{count} {kind}" for kind, count in result.kinds.items())
    ranges = ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in result.axes_deg.items())
    lines = [
        f"{file.name} on {plan.rig.file.name}{' (SIMULATED)' if plan.rig.simulated else ''}",
        f"  rows        {result.rows} ({kinds})",
        f"  duration    {duration_text(result.duration_s)}, and the time to mount: {', '.join(result.mountings)}",
        f"              (lower bound for any order: {duration_text(result.least_s)})",
        f"  order       from the innermost loop: {', '.join(result.order) or 'one pose, one wavelength'}",
        f"              {result.why}",
        f"  axes        {ranges} deg",
        f"  blocked     {result.shadowed} of {result.directions} directions of {_light(plan)}, by the mirror unit"
        f"{_only_for_etalon(result)}",
        *_blocked_by_sigma(result),
        f"  overlaps    {result.overlaps} directions are measured by two photodiodes",
    ]
    if result.left_out:
        lines.append(f"  omitted     {result.left_out} poses that are equivalent to others by the symmetry: {file.symmetry}")
    if result.unreferenced:
        lines.append(
            f"  reference   {', '.join(result.unreferenced)}: home it, or set its position, after each power-up of the "
            "controller: goniotwin home, goniotwin here"
        )
    return "\n".join([*lines, *(f"  warning     {each}" for each in result.warnings)])


def _light(plan: NewPlan) -> str:
    return {"reflected": "reflection", "transmitted": "transmission", "both": "reflection and transmission"}[
        plan.schedule.file.light
    ]


def _only_for_etalon(result: PlanCheck) -> str:
    only = result.shadowed_only_for_etalon
    return f". Of {only} the etalon's reading alone is blocked: it is lit from the side of the photodiodes" if only else ""


def _blocked_by_sigma(result: PlanCheck) -> list[str]:
    """Numbers of blocked directions for the first sigmas."""
    counts = [
        f"{len(each.zenith_azimuth)} at sigma {each.sigma:g}{f' with the {_straight(each)}' if each.specular else ''}"
        for each in result.shadowed_deg
    ]
    more = [f"and {len(counts) - MAX_LISTED} more sigmas"] if len(counts) > MAX_LISTED else []
    return [f"              {', '.join([*counts[:MAX_LISTED], *more])}"] if counts else []


def _straight(each: BlockedDirections) -> str:
    return "specular direction" if each.arc == lit_arc(each.sigma) else "direction straight through"


def _ranges(plan: NewPlan) -> dict[str, list[float]]:
    """Lowest and highest angle of each axis."""
    single = [piece.pose for piece in plan.rows.ways if isinstance(piece, Row) and piece.pose is not None]
    blocks = [each.poses.angles for passes in plan.mountings for each in passes]
    poses = np.concatenate([*blocks, np.array(single).reshape(-1, len(AXES))])
    return {axis: [float(column.min()), float(column.max())] for axis, column in zip(AXES, poses.T, strict=True)}


def _unreferenced(plan: NewPlan) -> list[str]:
    """Axes that are unreferenced after a power-up of their controller."""
    tables = {name: getattr(plan.rig.file.axes, name) for name in AXES}
    return [name for name, table in tables.items() if table.homing_required or not table.power_up_at_reference]
