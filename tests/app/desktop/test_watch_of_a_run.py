"""The window's watch of a run in progress: its worker names a misalignment once, while rows still come."""

import queue
from pathlib import Path

import pytest

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.running.events import RowCommitted
from goniotwin.app.desktop.model.values import MisalignmentFound, PlanTexts, WatchRun, serve_predictions
from goniotwin.app.desktop.model.watch import RunWatch
from goniotwin.app.desktop.model.worker import Worker
from tests.app.campaign.studies.test_watch import TILT_DEG, rows_of_sample, small_plan, tilted


@pytest.mark.long
def test_a_worker_names_a_misalignment_once_while_rows_come(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = small_plan(207)
    row = rows_of_sample(plan)[8]
    with Journal.open(tilted(plan, tmp_path / "tilted.journal", row, TILT_DEG, monkeypatch)) as journal:
        rows = [RowCommitted(each.row, each.data, 0, 1_000_000, 0.0) for each in journal.rows_between(0, len(plan.rows))]
    assert len(rows) == len(plan.rows)
    watch, found, last = RunWatch(plan), [], 0
    for each in rows:
        watch.add_row(each)
        if watch.due and (new := watch.look()):
            found += new
            last = each.row.number
    (misalignment,) = found
    assert misalignment.earliest <= row <= misalignment.latest
    assert row < last < len(plan.rows)
    answers: queue.SimpleQueue[object] = queue.SimpleQueue()
    worker = Worker("predictions", serve_predictions, answers.put, process=False)
    worker.put(WatchRun(7, PlanTexts.of(plan)))
    for each in rows:
        worker.put(each)
    answer = answers.get(timeout=60.0)
    worker.close()
    assert isinstance(answer, MisalignmentFound)
    assert answer.number == 7
    assert answer.where == "two-sided-5"
    assert answer.text.startswith("Misalignment: ")
    assert "light against arc in the plane of incidence" in answer.text
