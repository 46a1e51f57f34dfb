"""The rehearsal of a plan in a worker: its progress, and its result in words. No Qt."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from html import escape
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import Rehearsal, plan_rehearsal, rehearse
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.studies.decades import percent
from goniotwin.app.campaign.wording import duration_text, rounded_duration_text
from goniotwin.app.desktop.model.values import PlanTexts
from goniotwin.app.desktop.model.worker import NotWanted, OneAtATime, answer_of
from goniotwin.protocols.clock import RealClock

PACE_PERCENT = 3
"""From so many percent on the pace of the rows is known."""
REPORT_S = 0.2
"""Least time between two reports of the progress."""


@dataclass(frozen=True)
class RehearsalProgress:
    """So many rows are done after `elapsed_s` of waiting."""

    done: int
    of: int
    elapsed_s: float

    def __str__(self) -> str:
        if not self.done:
            return "Rehearsal: loading the optics …"
        percent_done = 100 * self.done // self.of
        left = rounded_duration_text(max(self.elapsed_s * (self.of - self.done) / self.done, 1.0))
        return f"Rehearsal: {percent_done} %" + (f", {left} left" if percent_done >= PACE_PERCENT else "")


@dataclass(frozen=True)
class Rehearsed:
    """The result of a rehearsal in words: `missed` are the reasons for which Start asks first; empty where nothing is."""

    name: str
    missed: tuple[str, ...]
    summary: str
    html: str


@dataclass(frozen=True)
class RehearsalFailed:
    """A rehearsal without a result, and the reason in one line."""

    reason: str


RehearsalAnswer = RehearsalProgress | Rehearsed | RehearsalFailed


class Rehearsals(OneAtATime[RehearsalAnswer]):
    """Rehearses one plan at a time in a worker. `deliver` is called in a thread, with the number of a plan and an answer.

    `of` is the plan of the last one, by what is equal for plans with the same rows.
    """

    def __init__(self, deliver: Callable[[tuple[int, RehearsalAnswer]], None], *, process: bool = True) -> None:
        super().__init__("rehearsal", serve_rehearsal, deliver, RehearsalProgress, RehearsalFailed, process=process)
        self.of: tuple[str | None, ...] = ()
        self._folder: TemporaryDirectory[str] | None = None

    def rehearse(self, plan: Plan) -> None:
        """Begin a rehearsal, in place of one that is in progress; at once."""
        texts = PlanTexts.of(plan)
        self.end()
        self.of = texts.same
        self._folder = TemporaryDirectory(prefix="goniotwin-rehearsal-")  # a worker that is ended cannot clear its own
        self.begin((texts, Path(self._folder.name)))

    def is_of(self, plan: Plan | None) -> bool:
        """Whether a plan has the rows of the last rehearsal."""
        return plan is not None and PlanTexts.of(plan).same == self.of

    def end(self) -> None:
        """End the rehearsal, and delete what it has written."""
        super().end()
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


def serve_rehearsal(connection: "Connection[Any, Any]") -> None:
    """Rehearse one plan; the answers are `RehearsalAnswer`."""
    request: tuple[PlanTexts, Path] = connection.recv()
    texts, folder = request
    clock = RealClock()
    begun = last = clock.now()

    def report(event: Event) -> None:
        nonlocal last, begun
        if isinstance(event, RowCommitted) and (now := clock.now()) >= last + REPORT_S:
            last = now
            connection.send(RehearsalProgress(event.done, event.total, now - begun))
            if connection.poll():
                raise NotWanted

    def compute() -> Rehearsed:
        nonlocal begun
        schedule, rig = texts.files()
        plan, assumed = plan_rehearsal(schedule, rig, {})
        connection.send(RehearsalProgress(0, len(plan.rows), 0.0))
        begun = clock.now()
        return in_words(rehearse(plan, assumed, out=folder / "rehearsal.journal", listeners=[report]))

    connection.send(answer_of(compute, RehearsalFailed))


def in_words(rehearsal: Rehearsal) -> Rehearsed:
    """A rehearsal in words: one line, and a page."""
    result, name = rehearsal.result, rehearsal.plan.schedule.file.name
    others = [each for each in result.warnings if each not in result.missed]
    counted = f", {len(others)} warning{'s' if len(others) > 1 else ''}" if others else ""
    verdict = result.missed[0] if result.missed else f"nothing is missed{counted}"
    target = rehearsal.plan.schedule.file.target
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
    return Rehearsed(name, tuple(result.missed), f"Rehearsed {name}: {verdict}", "".join(html))


def _paragraphs(heading: str, texts: "list[str]") -> Iterator[str]:
    if texts:
        yield f"<p><b>{heading}</b></p><ul>{''.join(f'<li>{escape(each)}</li>' for each in texts)}</ul>"


def _table(rehearsal: Rehearsal, sample: str) -> str:
    """The predicted u of a sample by decade of the peak, against what is asked for."""
    result, target = rehearsal.result, rehearsal.plan.schedule.file.target
    asked = {each.of_peak: each for each in result.target.get(sample, [])}
    limit = "" if target is None or target.relative_u is None else f"u ≤ {percent(target.relative_u)} asked for"
    rows = [("share of the peak", "values", "median u (k = 1)", limit)]
    for each in result.relative_uncertainty[sample].decades:
        if each.values:
            of = asked.get(each.of_peak)
            met = "" if of is None else f"{'✓' if of.met else '✗'} {of.within} of {of.values}"
            rows.append((each.of_peak, str(each.values), "" if math.isnan(each.p50) else percent(each.p50), met))
    cells = "".join(f"<tr>{''.join(f'<td>{escape(text)}</td>' for text in row)}</tr>" for row in rows)
    return f"<p><b>{escape(sample)}: predicted uncertainty</b></p><table cellpadding='4'>{cells}</table>"
