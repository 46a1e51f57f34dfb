"""A rehearsal sends, receives and writes what it did before: byte for byte, at the same times."""

from functools import partial
from pathlib import Path

import pytest

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.expected_poses import expected_poses
from goniotwin.app.campaign.rehearsal.rehearsal import run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.rig import OpenRig
from tests.golden import files, wires
from tests.golden.compare import check_table


@pytest.mark.parametrize("name", wires.SCHEDULES)
def test_the_wires_and_the_journal_of_a_rehearsal_are_the_golden_ones(name: str, tmp_path: Path) -> None:
    golden = files.read("wires")
    for table, found in wires.record(name, tmp_path, expect).items():
        check_table(found, golden[table], f"wires/{table}.csv")


def test_the_journal_of_a_rehearsal_without_transcripts_is_the_golden_one(tmp_path: Path) -> None:
    plan, path = wires.plan_of("spectral"), tmp_path / "rehearsal.journal"
    run_on_twin(plan, path, RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan)), [])
    check_table(wires.journal_digests(path), files.read("wires")["spectral-journal"], "wires/spectral-journal.csv")


def expect(opened: OpenRig, plan: Plan) -> None:
    """As a rehearsal does: the poses of the plan are known to the twin."""
    assert opened.virtual is not None
    opened.virtual.plant.expect(expected_poses(plan.rows, opened.rig))
