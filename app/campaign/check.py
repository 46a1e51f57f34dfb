"""What a plan would be, before anything is opened: rows, duration, ranges, hidden directions."""

from collections import Counter
from typing import Any

import numpy as np

from app.campaign.plan import Plan
from app.campaign.shadow import shadowed
from app.rig import AXES, photodiode_settings


def checked_plan(plan: Plan) -> dict[str, Any]:
    """rows, duration_s, rows by kind, the range of each axis, how many directions of the front side are hidden, and which
    axes have to be referenced after a power-up."""
    poses = [row.pose for row in plan.rows if row.pose is not None]
    columns = np.array(poses)
    hidden, directions = _hidden(plan)
    return {
        "rows": len(plan.rows),
        "duration_s": plan.seconds,
        "kinds": dict(Counter(row.kind for row in plan.rows)),
        "axes_deg": {axis: [float(column.min()), float(column.max())] for axis, column in zip(AXES, columns.T, strict=True)},
        "directions": directions,
        "shadowed": hidden,
        "mountings": [row.sample for row in plan.rows if row.kind == "mount"],
        "unreferenced": _to_be_referenced(plan),
        "simulated": plan.rig.simulated,
    }


def in_words(plan: Plan, result: dict[str, Any]) -> str:
    """The same for a person."""
    kinds = ", ".join(f"{count} {kind}" for kind, count in result["kinds"].items())
    ranges = ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in result["axes_deg"].items())
    lines = [
        f"{plan.schedule.file.name} on {plan.rig.file.name}{' (SIMULATED)' if plan.rig.simulated else ''}",
        f"  rows        {result['rows']} ({kinds})",
        f"  duration    {_clock_time(result['duration_s'])}, and the time to mount: {', '.join(result['mountings'])}",
        f"  axes        {ranges} deg",
        f"  hidden      {result['shadowed']} of {result['directions']} directions of reflection, by the mirror unit",
    ]
    if result["unreferenced"]:
        lines.append(
            f"  reference   {', '.join(result['unreferenced'])}: after each power-up of the controller to be homed, or to be "
            "told where they are: goniotwin home, goniotwin here"
        )
    return "\n".join(lines)


def _to_be_referenced(plan: Plan) -> list[str]:
    """Axes that go to no angle after a power-up of their controller, until somebody has referenced them."""
    tables = {name: getattr(plan.rig.file.axes, name) for name in AXES}
    return [name for name, table in tables.items() if table.homing_required or not table.power_up_at_reference]


def _hidden(plan: Plan) -> tuple[int, int]:
    """Hidden directions and all directions, of the upper arc, each incidence's counted once."""
    upper = np.array(photodiode_settings(plan.rig.file).upper_deg)
    poses = {row.pose for row in plan.rows if row.pose is not None}
    seen: dict[float, set[tuple[float, float]]] = {}
    for _, sigma, beta, shift in poses:
        for zenith in np.round(upper + shift, 6):
            pole = abs(zenith) < 1e-6
            azimuth = 0.0 if pole else (beta if zenith > 0.0 else beta + 180.0) % 360.0
            seen.setdefault(sigma, set()).add((float(abs(zenith)), azimuth))
    hidden = 0
    for sigma, directions in seen.items():
        zenith, azimuth = np.array(sorted(directions)).T
        hidden += int(shadowed(plan.rig.file, sigma, zenith, azimuth).sum())
    return hidden, sum(len(directions) for directions in seen.values())


def _clock_time(seconds: float) -> str:
    whole = round(seconds)
    hours, minutes = whole // 3600, whole // 60 % 60
    return f"{hours} h {minutes:02d} min {whole % 60:02d} s" if hours else f"{minutes} min {whole % 60:02d} s"
