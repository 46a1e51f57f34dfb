"""What a plan would be, before anything is opened: rows, duration, order, ranges, hidden directions, warnings.

Why a plan measures in the order that it does, in words.
"""

from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.arcs import lit_arc, observed_directions
from goniotwin.app.campaign.planning.durations import Moves
from goniotwin.app.campaign.planning.loop_order import LoopOrder
from goniotwin.app.campaign.planning.plan import Plan, PlanDetails
from goniotwin.app.campaign.planning.scan_grid import FILTER, WAVELENGTH, ScanGrid
from goniotwin.app.campaign.planning.scan_order import ScanOrder
from goniotwin.app.campaign.planning.timeline import MeasurementBlock, PlannedRows
from goniotwin.app.campaign.planning.warnings import duration_range, plan_warnings
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.file import LOOP_NAMES
from goniotwin.app.campaign.wording import duration_text
from goniotwin.app.rig import AXES

COLUMN_NAMES = (*LOOP_NAMES, "filter")
PATH_SEARCH = "rearranged where steps are uneven"


def sample_order(details: PlanDetails) -> tuple[ScanGrid, ScanOrder]:
    """Of the samples' own poses: the etalon's may be others, and those of the open beam are few."""
    grid = details.mountings[1][0].grid
    return grid, details.orders[grid]


def loop_names(order: ScanOrder) -> list[str]:
    """The loops, the innermost first."""
    return [COLUMN_NAMES[column] for column in reversed(order.loop_order.columns)]


def explain_order(plan: Plan, details: PlanDetails) -> str:
    """The nestings that were compared, the one taken first, with about how long the whole campaign takes in each; and how often
    the filter changes.
    """
    grid, order = sample_order(details)
    passes = sum(each.grid is grid for mounted in details.mountings for each in mounted)
    seconds = {PATH_SEARCH: plan.seconds} if order.improved else {}
    for nest in sorted(order.candidates, key=lambda nest: (nest != order.loop_order, order.candidates[nest])):
        if order.candidates[nest] < float("inf"):
            whole = plan.seconds + (order.candidates[nest] - order.seconds) * passes
            for words in _labels(nest, order.loop_order):
                seconds.setdefault(words, whole)
    count, wheel_s = filter_changes(plan)
    filters = f"; filter changes: {count}, {duration_text(wheel_s)}" if count else ""
    told = "; ".join(f"{words}: {duration_text(whole)}" for words, whole in seconds.items())
    if plan.schedule.file.order != "fastest":
        return f"as the schedule says. {told}{filters}"
    return f"{told if len(seconds) > 1 else 'there is one loop only'}{filters}"


def filter_changes(plan: Plan) -> tuple[int, float]:
    """How often a plan that was just made changes the filter, and how many seconds the wheel turns for it."""
    assert isinstance(plan.rows, PlannedRows)
    moves, wavelengths = Moves(plan.rig.file), []
    for piece in plan.rows.pieces:
        if isinstance(piece, MeasurementBlock):
            known = piece.scan_pass.grid.wavelengths_nm
            wavelengths.append(known[piece.points % len(known)])
        elif piece.wavelength_nm is not None:
            wavelengths.append(np.array([piece.wavelength_nm]))
    return moves.filter_changes(np.concatenate(wavelengths))


def _labels(nest: LoopOrder, taken: LoopOrder) -> list[str]:
    """What tells a nest from the others; only of one with the innermost loop of the `taken` also whether it goes by filters."""
    if len(nest.columns) < 2:
        return ["one loop"]
    outside = ["wavelength outside"] if nest.columns[0] == WAVELENGTH else []
    by_filter = ", filter by filter" if FILTER in nest.columns and nest.columns[-1] == taken.columns[-1] else ""
    return [f"{COLUMN_NAMES[nest.columns[-1]]} inside{by_filter}", *outside]


MAX_LISTED = 6
__all__ = ["check_plan", "describe_check"]


def check_plan(plan: Plan) -> dict[str, Any]:
    """rows, duration_s, from what to what it may turn out and what no order could beat, the order and why, rows by kind, the
    range of each axis, how many directions there are, how many of them are hidden, only at the etalon, and which, how many
    two photodiodes share, how many poses the symmetry leaves out, how often the filter changes, warnings, and which axes have
    to be referenced after a power-up. Of a plan that was just made.
    """
    details, rows = plan.details, plan.rows
    assert details is not None
    assert isinstance(rows, PlannedRows)
    seen = observed_directions(plan.schedule.file, plan.rig.file, details.mountings[1][0].poses.angles)
    return {
        "rows": len(rows),
        "duration_s": plan.seconds,
        "duration_range_s": list(duration_range(plan)),
        "least_s": plan.lower_bound_s,
        "order": loop_names(sample_order(details)[1]),
        "why": explain_order(plan, details),
        "kinds": rows.kinds,
        "axes_deg": _ranges(details, rows),
        "directions": sum(each.directions for each in seen),
        "shadowed": sum(len(each.blocked_deg) for each in seen),
        "shadowed_only_for_etalon": sum(each.blocked_only_at_etalon for each in seen),
        "shadowed_deg": [
            {
                "sigma": each.sigma_deg,
                "arc": each.arc,
                "only_for_etalon": each.blocked_only_at_etalon,
                "specular": each.specular_blocked,
                "zenith_azimuth": each.blocked_deg.tolist(),
            }
            for each in seen
            if len(each.blocked_deg)
        ],
        "overlaps": sum(each.shared for each in seen),
        "left_out": details.mountings[1][0].poses.left_out,
        "filter_changes": filter_changes(plan)[0],
        "warnings": plan_warnings(plan, details, seen),
        "mountings": [passes[0].sample for passes in details.mountings],
        "unreferenced": _to_be_referenced(plan),
        "simulated": plan.rig.simulated,
    }


def describe_check(plan: Plan, result: dict[str, Any]) -> str:
    """The same for a person."""
    file = plan.schedule.file
    kinds = ", ".join(f"{count} {kind}" for kind, count in result["kinds"].items())
    ranges = ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in result["axes_deg"].items())
    lines = [
        f"{file.name} on {plan.rig.file.name}{' (SIMULATED)' if plan.rig.simulated else ''}",
        f"  rows        {result['rows']} ({kinds})",
        f"  duration    {duration_text(result['duration_s'])}, and the time to mount: {', '.join(result['mountings'])}",
        f"              (no order could take less than {duration_text(result['least_s'])})",
        f"  order       from the inside: {', '.join(result['order']) or 'one pose, one wavelength'}",
        f"              {result['why']}",
        f"  axes        {ranges} deg",
        f"  hidden      {result['shadowed']} of {result['directions']} directions of {_light(plan)}, by the mirror unit"
        f"{_only_for_etalon(result)}",
        *_hidden_where(result),
        f"  overlaps    {result['overlaps']} directions are seen by two photodiodes",
    ]
    if result["left_out"]:
        lines.append(
            f"  left out    {result['left_out']} poses that see the same as others do by the symmetry: {file.symmetry}"
        )
    if result["unreferenced"]:
        lines.append(
            f"  reference   {', '.join(result['unreferenced'])}: after each power-up of the controller to be homed, or to be "
            "told where they are: goniotwin home, goniotwin here"
        )
    return "\n".join([*lines, *(f"  warning     {each}" for each in result["warnings"])])


def _light(plan: Plan) -> str:
    return {"reflected": "reflection", "transmitted": "transmission", "both": "reflection and transmission"}[
        plan.schedule.file.light
    ]


def _only_for_etalon(result: dict[str, Any]) -> str:
    only = result["shadowed_only_for_etalon"]
    return f", {only} of them only for the etalon, which is lit from the photodiodes' own side" if only else ""


def _hidden_where(result: dict[str, Any]) -> list[str]:
    """By sigma, the first few."""
    told = [
        f"{len(each['zenith_azimuth'])} at sigma {each['sigma']:g}{f' with the {_straight(each)}' if each['specular'] else ''}"
        for each in result["shadowed_deg"]
    ]
    more = [f"and {len(told) - MAX_LISTED} sigmas more"] if len(told) > MAX_LISTED else []
    return [f"              {', '.join([*told[:MAX_LISTED], *more])}"] if told else []


def _of_arc(each: dict[str, Any]) -> str:
    return f" of the {each['arc']} arc"


def _straight(each: dict[str, Any]) -> str:
    return "specular one" if each["arc"] == lit_arc(each["sigma"]) else "one straight through"


def _ranges(details: PlanDetails, rows: PlannedRows) -> dict[str, list[float]]:
    """How far each axis goes."""
    single = [piece.pose for piece in rows.pieces if isinstance(piece, Row) and piece.pose is not None]
    blocks = [each.poses.angles for passes in details.mountings for each in passes]
    poses = np.concatenate([*blocks, np.array(single).reshape(-1, len(AXES))])
    return {axis: [float(column.min()), float(column.max())] for axis, column in zip(AXES, poses.T, strict=True)}


def _to_be_referenced(plan: Plan) -> list[str]:
    """Axes that go to no angle after a power-up of their controller, until somebody has referenced them."""
    tables = {name: getattr(plan.rig.file.axes, name) for name in AXES}
    return [name for name, table in tables.items() if table.homing_required or not table.power_up_at_reference]
