"""The comparison of the etalon's scale with that of the open beam."""

from pathlib import Path

import typer

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.closure import closure_text
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.standards import standards_text
from goniotwin.app.cli.output import answer


def compare_scales(journal: Path, as_json: bool, *, without_damaged: bool) -> None:
    """Print the two scales of a journal. Raises UserError, and Exit where they do not agree."""
    with Journal.open(journal) as opened:
        evaluation = evaluate_journal(opened, without_damaged=without_damaged)
        report, standards = evaluation.closure, evaluation.standards
        result = {
            "journal": journal,
            "simulated": opened.simulated,
            **report.as_dict(),
            "standards": standards,
            "chain": opened.chain,
        }
        mark = "SIMULATED, " if opened.simulated else ""
    text = f"{mark}closure of {journal}\n{closure_text(report)}"
    text += "" if standards is None else f"\n{standards_text(standards)}"
    answer(as_json, result, lambda: print(text))
    if report.contradicts_etalon or (standards is not None and standards.apart):
        raise typer.Exit(1)
