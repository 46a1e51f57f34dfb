"""Runs on a fast served rig, on a computer that is late."""

from pathlib import Path

import pytest

from tests.conftest import Writer
from tests.system.busy_computer import served_runs
from tests.system.command_process import FORKED

pytestmark = [*FORKED, pytest.mark.endpoint, pytest.mark.long]


def test_no_run_at_60x_is_lost_beside_four_busy_programs(tmp_path: Path, write_rig: Writer, write_schedule: Writer) -> None:
    """Ten runs; `python -m benchmarks.busy_runs` makes a hundred."""
    runs = served_runs(tmp_path, write_rig(), write_schedule(), 60.0, 10, 4)
    assert [(each.status, each.errors) for each in runs if each.status != 0] == []
    assert [each.stopped_axes for each in runs] == [[]] * 10
