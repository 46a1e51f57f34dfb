"""A million rows: the memory of an export does not grow with them."""

import re
import subprocess
import sys
import tracemalloc
from pathlib import Path
from typing import Any

import pytest

from goniotwin.app.campaign.journal.block_sizes import BlockSizes
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction import readings
from goniotwin.app.campaign.reduction.pipeline import reduce_readings
from goniotwin.app.campaign.studies import reduced_journal
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
from tests.app.campaign.reduction.long_journal import write_long_journal
from tests.conftest import REPOSITORY


@pytest.mark.long
def test_the_memory_of_an_export_grows_by_less_than_a_kilobyte_per_row_and_each_row_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With small blocks a short journal shows what a long one takes."""
    small = BlockSizes(checked=16, recorded=16, rows=16, block=16, points=64)
    reduced = 0

    def counted(table: Any, *arguments: Any) -> Any:
        nonlocal reduced
        reduced += table.rows
        return reduce_readings(table, *arguments)

    monkeypatch.setattr(readings, "reduce_readings", counted)
    memory: list[int] = []
    rows: list[int] = []
    reads: list[int] = []
    for wavelengths in (1, 1, 6):  # the first time imports what it needs
        path = tmp_path / f"{len(rows)}.journal"
        rows.append(write_long_journal(path, wavelengths, 1, "repeats = 2\n"))
        reduced = 0
        tracemalloc.start()
        form = format_to_write(tmp_path / "a.csv")
        with Journal.open(path, small) as journal, reduced_journal.reduce_to_files(journal, tmp_path) as found:
            convert_reduced(found, tmp_path / "a.csv", form, Choice())
        memory.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        reads.append(reduced)
    assert (memory[2] - memory[1]) / (
        rows[2] - rows[1]
    ) < 1000.0  # all points in memory take 4 kB per row, with 36 photodiodes 40
    assert all(read < row for read, row in zip(reads, rows, strict=True))  # also where poses are repeated


WRITE_LONG = """
import os, sys
os.nice(19)  # a quarter of an hour of one core, beside tests in real time
from pathlib import Path
from tests.app.campaign.reduction.long_journal import write_long_journal
print(write_long_journal(Path(sys.argv[1]), 4992, 10))  # with dark readings as many as a campaign may have
"""


EXPORT_LONG = """
import os, sys
os.nice(19)
from goniotwin.app.cli.main import app
status = app(["export", sys.argv[1], "--format", "csv", "--out", sys.argv[2]], standalone_mode=False)
print(open("/proc/self/status").read())  # a child's rusage begins with the memory of its parent
sys.exit(status)
"""


@pytest.mark.long
@pytest.mark.early
@pytest.mark.skipif(sys.platform != "linux", reason="this system has no /proc")
def test_a_million_rows_are_exported_within_a_gigabyte(tmp_path: Path) -> None:
    path, out = tmp_path / "long.journal", tmp_path / "long.csv"

    def run(script: str) -> str:
        words = [sys.executable, "-c", script, str(path), str(out)]
        return subprocess.run(words, cwd=REPOSITORY, capture_output=True, text=True, check=True).stdout

    assert int(run(WRITE_LONG)) > 999_000
    found = re.search(r"VmHWM:\s+(\d+) kB", run(EXPORT_LONG))
    assert found is not None
    with out.open(encoding="utf-8") as file:
        assert sum(not line.startswith("#") for line in file) == 1 + 998_400
    print(f"\n{int(found[1]) / 1024:.0f} MiB")
    assert int(found[1]) * 1024 < 1e9
