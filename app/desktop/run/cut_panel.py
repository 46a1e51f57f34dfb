"""The description of the cut of a run, over its prediction, and of its residuals. No Qt."""

from dataclasses import replace
from functools import lru_cache

import numpy as np

from goniotwin.app.campaign.reduction.components import DETECTED, interval
from goniotwin.app.desktop.model.live_scan import ScanPoints
from goniotwin.app.desktop.model.run_points import ALARM_U, Cut
from goniotwin.app.figures.curves import COVERAGE, curve_of, curve_panel, curve_parts
from goniotwin.app.figures.description import Axis, Guide, Marks, Panel, Series, Span
from goniotwin.app.figures.scale import Scale, ScaleKind, scale_of
from goniotwin.app.figures.style import MarkKind
from goniotwin.arrays import Flags

LEAST_RESIDUAL, MOST_RESIDUAL = 5.0, 12.0
"""Half the least and half the largest range of the residuals, in u."""


def kinds(points: ScanPoints) -> dict[MarkKind, Flags]:
    """The points (n,) by their mark: those below the detection limit, those not to be trusted, and the others."""
    with np.errstate(invalid="ignore"):
        low, _ = interval(points.values, points.u_values, points.added, COVERAGE, COVERAGE)
        lost = points.lost | (low <= 0.0)
    finite = np.isfinite(points.values)
    good = finite & ~points.blocked & ~points.untrusted
    return {
        "blocked": finite & points.blocked,
        "untrusted": finite & points.untrusted & ~points.blocked,
        "lost": good & lost,
        "measured": good & ~lost,
    }


def cut_panel(cut: Cut, of: dict[MarkKind, Flags], kind: ScaleKind) -> Panel:
    """Points, by their `kinds`, with their intervals over the line and the band of the prediction."""
    scan, points = cut.scan, cut.scan.points
    good = of["measured"] | of["lost"]
    values, u = points.values[good], points.u_values[good]
    parts: list[tuple[Series, list[Marks]]] = []
    line = None if cut.line is None else _prediction(cut.line)
    if line is not None:
        values, u = np.concatenate([values, line.values]), np.concatenate([u, line.u_values])
    scale = _scale(values, u, kind)
    if line is not None:
        parts.append((_predicted_series(line, scale), []))
    with np.errstate(invalid="ignore"):
        ends = interval(points.values, points.u_values, points.added, COVERAGE, COVERAGE)
    shown = good | of["blocked"] | of["untrusted"]
    curve = curve_of(
        points.x_deg[shown],
        points.values[shown],
        (ends[0][shown], ends[1][shown]),
        good=good[shown],
        lost=of["lost"][shown],
        blocked=points.blocked[shown],
    )
    bars, marks = curve_parts(curve, scale, "points", line="none", bars=True)
    on_scale = of["measured"] & ~scale.below(points.values)
    steep = on_scale & points.steep
    chosen: dict[MarkKind, Flags] = {
        "measured": on_scale & ~points.steep & ~points.transmitted,
        "transmitted": on_scale & ~steep & points.transmitted,
        "steep": steep,
        "alarm": on_scale & cut.alarms,
    }
    marks += [Marks(each, points.x_deg[which], points.values[which]) for each, which in chosen.items() if which.any()]
    parts.append((bars, marks))
    spans = tuple(Span(low, high) for low, high in scan.blocked_deg)
    guides = tuple(Guide(each, "points") for each in scan.specular_deg)
    return curve_panel(
        parts, scale, Axis(scan.x_label, scan.range_deg), scan.y_label, title=scan.title, guides=guides, spans=spans
    )


def residual_panel(cut: Cut) -> Panel:
    """The residuals in u, with the limits of the alarm; one beyond the range is an arrow at its edge."""
    x, residual, alarms = cut.scan.points.x_deg, cut.residual, cut.alarms
    known = np.isfinite(residual)
    span = float(np.clip(1.1 * np.max(np.abs(residual[known]), initial=0.0), LEAST_RESIDUAL, MOST_RESIDUAL))
    held = np.clip(residual, -0.9 * span, 0.9 * span)
    with np.errstate(invalid="ignore"):
        above, below = alarms & (residual > span), alarms & (residual < -span)
    groups: dict[MarkKind, Flags] = {
        "measured": known & ~alarms,
        "alarm": alarms & ~above & ~below,
        "alarm above": above,
        "alarm below": below,
    }
    return Panel(
        Axis(cut.scan.x_label, cut.scan.range_deg),
        Axis("residual / u", (-span, span)),
        marks=tuple(Marks(kind, x[chosen], held[chosen]) for kind, chosen in groups.items() if chosen.any()),
        guides=tuple(Guide(each, "bad", upright=False) for each in (-ALARM_U, ALARM_U)),
        spans=(Span(-COVERAGE, COVERAGE, upright=False, colour="predicted"),),
    )


@lru_cache(8)
def _predicted_series(line: ScanPoints, scale: Scale) -> Series:
    """The line, which is the same at each update."""
    ends = interval(line.values, np.nan_to_num(line.u_values), line.added, COVERAGE, COVERAGE)
    curve = curve_of(line.x_deg, line.values, ends)
    return curve_parts(replace(curve, lost=np.zeros(curve.x.size, dtype=bool)), scale, "predicted")[0]


@lru_cache(8)
def _prediction(line: ScanPoints) -> ScanPoints | None:
    """The predicted points that are shown: of reflected light where there are any."""
    chosen = np.isfinite(line.values) & ~line.blocked
    if (chosen & ~line.transmitted).any():
        chosen &= ~line.transmitted
    return line.where(chosen) if chosen.any() else None


def _scale(values: np.ndarray, u: np.ndarray, kind: ScaleKind) -> Scale:
    found = scale_of(values, u, kind == "log")
    return found if kind != "symlog" else replace(found, kind=kind, threshold=_threshold(u))


def _threshold(u: np.ndarray) -> float:
    """Where a symmetric logarithmic scale becomes linear: the detection limit of the faint points."""
    known = u[np.isfinite(u) & (u > 0.0)]
    if not known.size:
        return 1e-6
    return float(10.0 ** np.floor(np.log10(max(DETECTED * float(np.percentile(known, 10)), 1e-12))))
