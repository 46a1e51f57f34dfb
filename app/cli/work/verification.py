"""The checks of a data file against physics."""

from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.verification import Verdict, evidence_text, verify_journal
from goniotwin.app.cli.output import answer

FAILS_STYLE = {"fails": "red", "warns": "yellow", "holds": "green", "nothing to judge": "dim"}


def print_verification(journal: Path, as_json: bool) -> None:
    """Print the verdicts on a journal. Raises UserError, and Exit where one is "fails"."""
    with Journal.open(journal) as opened:
        simulated = opened.simulated
        verdicts = verify_journal(evaluate_journal(opened))
    holds = all(each.verdict != "fails" for each in verdicts)
    result = {"simulated": simulated, "holds": holds, "verdicts": verdicts}

    answer(as_json, result, lambda: _print_verdicts(verdicts, evidence_text(verdicts), simulated))
    if not holds:
        raise typer.Exit(1)


def _print_verdicts(verdicts: list[Verdict], evidence: str, simulated: bool) -> None:
    """Print each verdict with its reason, and the table of the evidence."""
    console = Console(highlight=False)
    if simulated:
        console.print("SIMULATED")
    for each in verdicts:
        line = Text(f"{each.name}: ").append(each.verdict, style=FAILS_STYLE[each.verdict]).append(f": {each.text}")
        console.print(line, soft_wrap=True)
        if each.remedy:
            console.print(f"  {each.remedy}", soft_wrap=True, markup=False)
    if evidence:
        console.print(evidence, soft_wrap=True)
