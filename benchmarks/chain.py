"""Cost of a journal's chain of hashes: in a rehearsed row, and when a long journal is opened.

    python -m benchmarks.chain [--rounds 5] [--rows 1000000] [--json]

Row: rehearsals of `quick.toml` with and without the chain, in turn, in one process; the medians of a row's share of each.
Opening: a journal of so many rows of 36 photodiodes at one gain, with the check of structure and chain. All times are of the
processor, so that other programs do not matter.
"""

import argparse
import json
import statistics
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np

from benchmarks.rehearsal import QUICK, RIG, row_seconds
from benchmarks.versions import positive
from goniotwin.app.campaign.journal import writing
from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal
from goniotwin.app.campaign.row import Reading, RowData
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig

PHOTODIODES = 36


def no_links(_db: object, chain: Chain, _attempts: object) -> Chain:
    """In the place of `add_links`."""
    return chain


def rehearsal_row_seconds(plan: Plan) -> float:
    """Time of a rehearsal over the number of its rows that measure, s."""
    begin = time.process_time()
    rows = len(row_seconds(plan))
    return (time.process_time() - begin) / rows


def row_ratio(plan: Plan, rounds: int) -> tuple[float, float]:
    """Medians of the time of a row with and without the chain, s."""
    row_seconds(plan)
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(rounds):
        times[0].append(rehearsal_row_seconds(plan))
        with mock.patch.object(writing, "add_links", no_links):
            times[1].append(rehearsal_row_seconds(plan))
    return statistics.median(times[0]), statistics.median(times[1])


def opening_seconds(plan: Plan, rows: int, folder: Path) -> float:
    """Time of opening a journal of so many rows, s."""
    measured = next(row for row in plan.rows if row.kind == "measure")
    long = Plan(plan.schedule, plan.rig, tuple(replace(measured, number=k, identity=f"{k}") for k in range(rows)))
    counts = np.random.default_rng(1).integers(0, 65535, size=(1, PHOTODIODES), dtype=np.uint16)
    path = folder / "long.journal"
    with Journal.create(path, long, {}, durable=False) as journal:
        journal.begin_session(0.0, plan.rig.text, {})
        for row in long.rows:
            t = float(row.number)
            journal.commit(row, RowData(t, t + 1.0, {"sigma": 30.0}, (Reading(1e8, t, 0.1, 1e-6, counts),)))
        journal.end_session(1, float(rows), "done")
    begin = time.process_time()
    with Journal.open(path) as journal:
        assert journal.chain.length == rows
        assert not journal.chain.damage
        return time.process_time() - begin


def main() -> None:
    """Print the costs, as text or JSON."""
    parser = argparse.ArgumentParser(description="Cost of a journal's chain of hashes.")
    parser.add_argument("--rounds", type=positive, default=5, help="number of rehearsals with and without the chain")
    parser.add_argument("--rows", type=int, default=1_000_000, help="rows of the journal that is opened")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    plan, _ = plan_rehearsal(read_schedule(QUICK), read_rig(RIG), {})
    chained, bare = row_ratio(plan, options.rounds)
    with tempfile.TemporaryDirectory() as folder:
        opening = opening_seconds(plan, options.rows, Path(folder))
    if options.json:
        found = {"row_s": chained, "row_without_chain_s": bare, "rows": options.rows, "opening_s": opening}
        print(json.dumps(found, indent=2))
        return
    print(f"a rehearsed row         {1e3 * chained:.2f} ms, {chained / bare:.3f} of one without the chain")
    print(f"opening {options.rows} rows    {opening:.1f} s, {1e6 * opening / max(1, options.rows):.1f} us a row")


if __name__ == "__main__":
    main()
