"""Runs on a served rig at a high simulation speed beside busy programs: none may be lost because the computer is late.

    python -m benchmarks.busy_runs [--runs 100] [--speed 60] [--busy 4] [--schedule FILE]

Each is a process of its own, with the example's rig and the small schedule of the tests, of eight rows. The status is 1 if a
run was lost, or an axis was stopped by its controller's heartbeat.
"""

import argparse
import sys
import tempfile
from collections import Counter
from pathlib import Path

from goniotwin.protocols.clock import RealClock
from tests.conftest import RIG, SMALL
from tests.system.busy_computer import ServedRun, served_runs


def main(arguments: list[str] | None = None) -> int:
    """Print a line for each run, and the counts."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.busy_runs", description=__doc__)
    parser.add_argument("--runs", type=int, default=100, help="number of runs (100)")
    parser.add_argument("--speed", type=float, default=60.0, help="simulation speed of the served rig (60)")
    parser.add_argument("--busy", type=int, default=4, help="programs that use all the time of a processor (4)")
    parser.add_argument("--schedule", type=Path, help="another schedule")
    given = parser.parse_args(arguments)
    clock = RealClock()

    def report(number: int, run: ServedRun) -> None:
        faults = "".join(f"\n      {each}" for each in run.faults)
        print(f"{number:4d}  {clock.now():7.1f} s  status {run.status}  {len(run.faults)} faults{faults}", flush=True)

    with tempfile.TemporaryDirectory() as folder:
        schedule = given.schedule or Path(folder) / "small.toml"
        if given.schedule is None:
            schedule.write_text(SMALL, encoding="utf-8")
        runs = served_runs(Path(folder), RIG, schedule, given.speed, given.runs, given.busy, report)
    stopped = sum(bool(each.stopped_axes) for each in runs)
    statuses = Counter(each.status for each in runs)
    counts = ", ".join(f"{number} with status {status}" for status, number in sorted(statuses.items()))
    print(f"{len(runs)} runs at {given.speed:g}x beside {given.busy} busy programs: {counts}; {stopped} with an axis stopped")
    return 1 if stopped or statuses[0] < len(runs) else 0


if __name__ == "__main__":
    sys.exit(main())
