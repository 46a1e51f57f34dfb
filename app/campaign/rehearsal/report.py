"""A rehearsal's result as text for a terminal."""

import math
from collections.abc import Iterator

from goniotwin.app.campaign.rehearsal.forecast import SpreadSummary
from goniotwin.app.campaign.rehearsal.rehearsal import Rehearsal, RehearsalResult
from goniotwin.app.campaign.studies.decades import percent, target_texts, uncertainty_texts
from goniotwin.app.campaign.wording import duration_text

UNITS = ("bytes", "kB", "MB", "GB")


def report_text(rehearsal: Rehearsal) -> str:
    """The result, one line for each quantity."""
    result = rehearsal.result
    plan = rehearsal.plan
    lines = [
        f"SIMULATED: {plan.schedule.file.name} rehearsed on {plan.rig.file.name}: {result.rows} of {result.planned} rows",
        f"  duration    {duration_text(result.duration_s)}, and the time to mount",
        *(f"    {block.name:14}{duration_text(block.duration_s)}, {block.rows} rows" for block in result.blocks),
        f"  axes        {_ranges(result.axes_deg)}",
        f"  counts      {_counts(result)}",
        *(
            f"  {'uncertainty' if first else '':12}{each}"
            for name, spread in result.relative_uncertainty.items()
            for first, each in _spread(name, spread)
        ),
        *_target(rehearsal),
        *(f"  check       {each}" for each in result.checks.lines),
        f"  lamp        {result.lamp_hours:.2f} h",
        f"  journal     {_size(result.journal_bytes)}",
        *(f"  assumed     {each}" for each in result.assumed),
        *(f"  WARNING     {each}" for each in result.warnings),
    ]
    return "\n".join(lines)


def _ranges(axes: dict[str, list[float]]) -> str:
    return ", ".join(f"{axis} {low:g} to {high:g}" for axis, (low, high) in axes.items()) + " deg" if axes else "no axis moved"


def _counts(result: RehearsalResult) -> str:
    shares = ", ".join(f"{share:.1%} of the range at {gain} V/A" for gain, share in result.counts.share_of_range.items())
    return f"at most {shares}; {result.saturated} values saturated at every gain" if shares else "none"


def _spread(name: str, spread: SpreadSummary) -> Iterator[tuple[bool, str]]:
    """The lines about a sample, and whether each is the first."""
    texts = uncertainty_texts(spread)
    if not texts:
        yield True, f"{name}: none of {spread.directions} directions has a value"
        return
    yield True, f"{name}: {texts[0]}"
    for each in texts[1:]:
        yield False, f"  {each}"
    yield (
        False,
        (
            f"  {spread.directions} directions measured, {spread.trusted} trusted, {spread.above_zero} above 0, "
            f"{spread.below_detection} below the detection limit, {spread.to_a_tenth} with u below 10 %{_distance(spread)}"
        ),
    )


def _target(rehearsal: Rehearsal) -> Iterator[str]:
    """The lines about the schedule's target of u: by sample, its values in each decade of the peak that is asked about."""
    target = rehearsal.plan.schedule.file.target
    if target is not None and target.relative_u is not None:
        for name, found in rehearsal.result.target.items():
            texts = "; ".join(target_texts(found)) or "no value"
            yield f"  target      {name}: u (k = 1) of at most {percent(target.relative_u)}: {texts}"


def _distance(spread: SpreadSummary) -> str:
    """How far the values were from the model of the sample."""
    if math.isnan(spread.coverage):
        return ""
    return f"; {spread.coverage:.1%} within their 95 % interval of the truth, the worst {spread.worst_u:.1f} u off"


def _size(size: float) -> str:
    for unit in UNITS[:-1]:
        if size < 1000.0:
            return f"{size:.3g} {unit}"
        size /= 1000.0
    return f"{size:.3g} {UNITS[-1]}"
