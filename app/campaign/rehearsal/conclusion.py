"""The conclusion of a measured campaign in words, by the rules of a rehearsal: what of it can be used, and what to add."""

from dataclasses import dataclass
from pathlib import Path

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.rehearsal.forecast import forecast_of
from goniotwin.app.campaign.rehearsal.warnings import largest_text, missed_warnings, saturation_text
from goniotwin.app.campaign.studies.decades import percent
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import NOTHING, verdicts_text, verify_journal


@dataclass(frozen=True)
class Conclusion:
    """The lines about a journal, and the text of its schedule."""

    journal: Path
    schedule: str
    lines: tuple[str, ...]


def conclude(path: Path) -> Conclusion:
    """Conclude a journal, with the verdicts of `verify`. Raises UserError without values."""
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        found, verdicts = forecast_of(evaluation), verify_journal(evaluation)
        schedule, file, rig = journal.value("schedule"), evaluation.reduction.schedule, evaluation.reduction.rig.file
    lines = [
        f"{name}: {each.trusted - each.below_detection} of {each.directions} values are above the detection limit. "
        f"{largest_text(each)}".strip()
        for name, each in found.spread.items()
    ]
    for name, decades in found.target.items():
        values, within = sum(each.values for each in decades), sum(each.within for each in decades)
        assert file.target is not None
        assert file.target.relative_u is not None
        if values:
            lines.append(f"{name}: {within} of {values} values reach the target, u ≤ {percent(file.target.relative_u)}")
    for name, tally in found.tallies.items():
        if saturated := tally.missing.get("clipped", 0):
            lines.append(f"{name}: {saturation_text(saturated, file, rig)}")
    lines += [verdicts_text(verdicts)] if any(each.verdict != NOTHING for each in verdicts) else []
    lines += [f"{each.name} {each.verdict}: {each.remedy}" for each in verdicts if each.remedy]
    return Conclusion(path, schedule, (*lines, *missed_warnings(file, rig, found)))
