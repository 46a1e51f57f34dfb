"""The conclusion of a measured campaign in words, computed in a worker: what of it can be used, and what to add. No Qt."""

from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.rehearsal.forecast import forecast
from goniotwin.app.campaign.rehearsal.warnings import largest_text, missed_warnings
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import NOTHING, verify_journal
from goniotwin.app.desktop.model.results import Checked
from goniotwin.app.desktop.model.worker import OneAtATime, answer_of


@dataclass(frozen=True)
class Conclusion:
    """The lines about a journal, and the text of its schedule."""

    journal: Path
    schedule: str
    lines: tuple[str, ...]


@dataclass(frozen=True)
class NoConclusion:
    """The reason in one line why there is no conclusion."""

    reason: str


class Conclusions(OneAtATime[Conclusion | NoConclusion]):
    """Concludes one journal at a time in a worker. `deliver` is called in a thread, with the number of a journal and it."""

    def __init__(self, deliver: Callable[[tuple[int, Conclusion | NoConclusion]], None], *, process: bool = True) -> None:
        super().__init__("conclusion", serve_conclusion, deliver, type(None), NoConclusion, process=process)


def serve_conclusion(connection: "Connection[Any, Any]") -> None:
    """Conclude one journal, whose path is the first request."""
    path: Path = connection.recv()
    connection.send(answer_of(lambda: conclude(path), NoConclusion))


def conclude(path: Path) -> Conclusion:
    """Conclude a journal, by the rules of a rehearsal and the verdicts of `verify`. Raises UserError without values."""
    found = forecast(path)
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        verdicts = tuple(verify_journal(evaluation))
        schedule, file, rig = journal.value("schedule"), evaluation.reduction.schedule, evaluation.reduction.rig.file
    lines = [
        f"{name}: {each.trusted - each.below_detection} of {each.directions} values are above the detection limit. "
        f"{largest_text(each)}".strip()
        for name, each in found.spread.items()
    ]
    lines += [Checked(0, verdicts).summary] if any(each.verdict != NOTHING for each in verdicts) else []
    lines += [f"{each.name} {each.verdict}: {each.remedy}" for each in verdicts if each.remedy]
    return Conclusion(path, schedule, (*lines, *missed_warnings(file, rig, found)))
