"""Rigs without a fault have no verdict: the example schedules on smaller grids, on virtual rigs of twenty seeds, without wires.

Noise, drift of the lamp and gains within their certificate are those of the example rig. Chance makes a verdict on a module in
one of a million campaigns, and a closure beyond 4 u, of which angles and holes have no part here, in less than one of 10,000.
"""

from pathlib import Path

import pytest

from goniotwin import examples
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.journals import check_journal
from goniotwin.app.rig import parse_rig
from tests.conftest import RIG, Change, changed

SEEDS = 20
SMALLER: dict[str, tuple[Change, ...]] = {
    "quick": (("step = 0.5", "step = 1.5"),),
    "anisotropic": (("stop = 345, step = 15", "stop = 90, step = 90"), ("stop = 355, step = 5", "stop = 300, step = 60")),
    "dense-lobe-spectral": (
        ("[15, 30, 45, 60]", "[30]"),
        ("stop = 180, step = 5", "stop = 180, step = 60"),
        ("{ start = 400, stop = 700, step = 20 }", "[450, 550]"),
        ("stop = 4.5, step = 0.5", "stop = 4, step = 2"),
        ("beta_step_deg = 1", "beta_step_deg = 4"),
    ),
    "diffuse-spectral": (("stop = 180, step = 5", "stop = 180, step = 60"), ("step = 10 }", "step = 110 }")),
    "paper-order": (("stop = 180, step = 30", "stop = 180, step = 90"), ("stop = 4, step = 1", "stop = 4, step = 2")),
    "transmission": (
        ("[0, 20, 40, 60]", "[20, 40]"),
        ("stop = 180, step = 10", "stop = 180, step = 60"),
        ("stop = 650, step = 50", "stop = 650, step = 200"),
        ("stop = 4.5, step = 0.5", "stop = 4, step = 2"),
    ),
    "closure": (
        ("[17, 42, 67]", "[42]"),
        ("[450, 550, 650]", "[550]"),
        ("poses = 13\nstep_deg = 0.2", "poses = 9\nstep_deg = 0.25"),
    ),
}


def found_on(name: str, seed: int, folder: Path) -> list[str]:
    """What a campaign on the rig of a seed finds fault with."""
    text = changed((examples.SCHEDULE.parent / f"{name}.toml").read_text(encoding="utf-8"), SMALLER[name])
    rig = changed(RIG.read_text(encoding="utf-8"), (("seed = 1\n", f"seed = {seed}\n"),))
    path = folder / f"{name}-{seed}.journal"
    run_without_wires(make_plan(parse_schedule(text, name), parse_rig(rig, RIG.parent, "rig")), path)
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        verdicts = [*evaluation.reduction.measurements.evidence.findings, *evaluation.closure.alarms]
    return [*verdicts, *check_journal(path).alarms]


@pytest.mark.long
@pytest.mark.parametrize("name", SMALLER)
def test_a_rig_without_a_fault_has_no_verdict(name: str, tmp_path: Path) -> None:
    found = {seed: wrong for seed in range(SEEDS) if (wrong := found_on(name, seed, tmp_path))}
    assert found == {}
