"""A rehearsal's result as text for a terminal, and as a page for the window."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

from goniotwin.app.campaign.rehearsal.forecast import SpreadSummary
from goniotwin.app.campaign.rehearsal.rehearsal import Rehearsal, RehearsalResult
from goniotwin.app.campaign.studies.decades import LEAST_SHARE_MET, percent, target_texts, uncertainty_texts
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


@dataclass(frozen=True)
class RehearsalPage:
    """The result of the rehearsal of a schedule: `missed` are the reasons to change it first, none where it is fit."""

    name: str
    missed: tuple[str, ...]
    summary: str
    html: str


def rehearsal_page(rehearsal: Rehearsal) -> RehearsalPage:
    """A rehearsal as a line and a page."""
    result, name, target = rehearsal.result, rehearsal.plan.schedule.file.name, rehearsal.plan.schedule.file.target
    others = [each for each in result.warnings if each not in result.missed]
    counted = f", {len(others)} warning{'s' if len(others) > 1 else ''}" if others else ""
    verdict = result.missed[0] if result.missed else f"nothing is missed{counted}"
    longest = "" if target is None or target.longest_h is None else f" of at most {duration_text(3600.0 * target.longest_h)}"
    facts = [
        f"{result.rows} of {result.planned} rows in {duration_text(result.duration_s)}{longest}, and the time to mount",
        *(
            f"{sample}: {each.below_detection} of {each.trusted} values are below the detection limit"
            for sample, each in result.relative_uncertainty.items()
        ),
        f"{result.saturated} values are saturated at every gain",
    ]
    html = [
        *_paragraphs("✗ Start asks first, because", result.missed),
        *_paragraphs("SIMULATED: what the campaign will be", facts),
        *(_table(rehearsal, sample) for sample in result.relative_uncertainty),
        *_paragraphs("⚠ Look at", others),
        *_paragraphs("Assumed", result.assumed),
    ]
    return RehearsalPage(name, tuple(result.missed), f"Rehearsed {name}: {verdict}", "".join(html))


def _paragraphs(heading: str, texts: list[str]) -> Iterator[str]:
    if texts:
        yield f"<p><b>{heading}</b></p><ul>{''.join(f'<li>{escape(each)}</li>' for each in texts)}</ul>"


def _table(rehearsal: Rehearsal, sample: str) -> str:
    """The predicted u of a sample by decade of the peak, against what is asked for."""
    result, target = rehearsal.result, rehearsal.plan.schedule.file.target
    asked = {each.of_peak: each for each in result.target.get(sample, [])}
    limit = ""
    if target is not None and target.relative_u is not None:
        limit = f"u ≤ {percent(target.relative_u)}, met by {percent(LEAST_SHARE_MET)} at least"
    rows = [("share of the peak", "values", "median u (k = 1)", limit)]
    for each in result.relative_uncertainty[sample].decades:
        if each.values:
            of = asked.get(each.of_peak)
            met = "" if of is None else f"{'✓' if of.met else '✗'} {of.within} of {of.values}"
            rows.append((each.of_peak, str(each.values), "" if math.isnan(each.p50) else percent(each.p50), met))
    cells = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    return f"<p><b>{escape(sample)}: predicted uncertainty</b></p><table cellpadding='4'>{cells}</table>"
