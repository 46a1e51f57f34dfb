"""The rehearsal of a plan in a worker: its progress, and its result as a page. No Qt."""

from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse
from goniotwin.app.campaign.rehearsal.report import RehearsalPage, rehearsal_page
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.wording import rounded_duration_text
from goniotwin.app.desktop.model.values import PlanTexts
from goniotwin.app.desktop.model.worker import NotWanted, OneAtATime, WorkFailed, answer_of
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


RehearsalAnswer = RehearsalProgress | RehearsalPage | WorkFailed


class Rehearsals(OneAtATime[RehearsalAnswer]):
    """Rehearses one plan at a time in a worker. `deliver` is called in a thread, with the number of a plan and an answer.

    `of` is the plan of the last one, by what is equal for plans with the same rows.
    """

    def __init__(self, deliver: Callable[[tuple[int, RehearsalAnswer]], None], *, process: bool = True) -> None:
        super().__init__("rehearsal", serve_rehearsal, deliver, RehearsalProgress, process=process)
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

    def compute() -> RehearsalPage:
        nonlocal begun
        schedule, rig = texts.files()
        plan, assumed = plan_rehearsal(schedule, rig, {})
        connection.send(RehearsalProgress(0, len(plan.rows), 0.0))
        begun = clock.now()
        return rehearsal_page(rehearse(plan, assumed, out=folder / "rehearsal.journal", listeners=[report]))

    connection.send(answer_of(compute, WorkFailed))
