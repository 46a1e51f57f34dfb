"""Files from strangers, damaged at random or far too long: refused in one line, within a gigabyte."""

import contextlib
import json
import multiprocessing
import shutil
import sqlite3
import sys
from pathlib import Path

import pytest

from tests import used
from tests.system.mutations import (
    COMMANDS,
    CPU_S,
    HUGE,
    MEMORY_BYTES,
    attempt,
    attempt_many,
    compute_chain,
    make_files,
    write_huge,
)

MUTATIONS = 10_000


PER_PROCESS = 500
"""Mutations of one child process: a new one for each would take longer than they do."""


def test_a_few_wild_mutations_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(changed := make_files(tmp_path))
    assert [wrong for number in range(24) if (wrong := attempt(number, tmp_path / "originals", changed))] == []


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system has no such limits of a process")
@pytest.mark.parametrize("first", range(0, MUTATIONS, PER_PROCESS))
def test_wild_mutations_are_refused_in_one_line(first: int, tmp_path: Path) -> None:
    """Under 1 GB and within 10 s of the processor; in a child process, which these limits may end."""
    changed = make_files(tmp_path)
    numbers, report = range(first, first + PER_PROCESS), tmp_path / "report"
    arguments = (numbers, tmp_path / "originals", changed, report)
    child = multiprocessing.get_context("spawn").Process(target=attempt_many, args=arguments)
    child.start()
    child.join(3600.0)
    child.kill()
    child.join()
    found = dict(json.loads(line) for line in report.read_text(encoding="utf-8").splitlines())
    assert [wrong for wrong in found.values() if wrong] == []
    assert list(found) == list(numbers)


@pytest.mark.long
@pytest.mark.skipif(sys.platform == "win32", reason="this system does not report the memory of a process")
@pytest.mark.parametrize("what", HUGE)
@pytest.mark.parametrize(
    ("name", "place"),
    [("chained.journal", "attempt.flags"), ("chained.journal", "plan.detail"), ("left.journal", "session.versions")],
)
def test_a_wild_text_of_tens_of_megabytes_is_refused_within_a_gigabyte(
    name: str, place: str, what: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(make_files(tmp_path))
    shutil.copy(tmp_path / "originals" / name, name)
    with contextlib.closing(sqlite3.connect(name)) as database, database:
        table, column = place.split(".")
        write_huge(database, table, column, 1, what)
        compute_chain(database)
    done = used.run(sys.executable, "-m", "goniotwin", *COMMANDS[name])
    assert done.peak_bytes < MEMORY_BYTES
    assert done.cpu_s < CPU_S
    assert done.status == (1 if name == "chained.journal" else 0)
    lines = done.stderr.splitlines()
    assert len(lines) == 1
    assert f"{name}: is damaged: " in lines[0]
