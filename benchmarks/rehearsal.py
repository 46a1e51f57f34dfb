"""Time per row of a rehearsal, through all the wires; and the memory of a long rehearsal.

    python -m benchmarks.rehearsal [--rounds 5] [--against FOLDER] [--json]
    python -m benchmarks.rehearsal --memory 10000 100000 [--json]

Time: the rows of `quick.toml`, with 36 photodiodes, four axes and two gains of four readings. The first rehearsal is a warm-up
and does not count. `row_ms` is the median of the rows that measure, from commit to commit; `photodiodes_us` what the light on
the photodiodes takes for each pose, within the rehearsal, the poses that are computed ahead included. Both are processor time.
`row_ms_two_processes` is time that passes: what a row more costs in a rehearsal of some thousand rows with `--processes 2`,
without the start of the processes, and `row_ms_one_process` that with one. Each run has a process of its own; a figure is the
least of the rounds. `load` is the machine's load before and after. `--against` is the folder of another version, with
`goniotwin` under `.venv/links`: both versions take turns, and `ratio` is that of this one to the other, which has one process
where it knows no others.

Memory (`--memory`, Linux): a schedule of so many rows (shifts and wavelengths, one gain, one reading) is rehearsed, each in a
process of its own, as the command does it, with the forecast of every direction as CSV. The result is the largest increase of
the resident memory after row 1000, up to the end of the process. The plan exists from the beginning, so it is not counted.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.versions import HERE, add_options, in_turns, positive, versions_of
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.rehearsal import rehearsal
from goniotwin.app.campaign.rehearsal.rehearsal import plan_rehearsal, rehearse, run_on_twin
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.rehearsal.warnings import relevant_photodiodes
from goniotwin.app.campaign.running.events import Event, RowCommitted
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.rig import read_rig
from goniotwin.twin.plant.view import Aspect, View

EXAMPLES = HERE / "examples"
RIG = EXAMPLES / "rigs" / "virtual.toml"
QUICK = EXAMPLES / "schedules" / "quick.toml"
STATM, STATUS, CLEAR_REFS = (Path("/proc/self") / name for name in ("statm", "status", "clear_refs"))
SHORT, LONG_DEG, LONGER_DEG = 0.5, 0.03, 0.015
"""Steps of the arc's shift, deg: of `quick.toml`, and of two rehearsals of some thousand rows."""
FROM_ROW = 1000
LONG = """
name = "long"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [30]
beta_deg = [180]
shift_deg = {{ start = 0.0, stop = 4.0, step = 1.0 }}
wavelength_nm = {{ start = 400.0, stop = 700.0, step = {step} }}
gains_v_per_a = [1e8]
readings = 1
dark_readings = 4
dark_every_s = 600
"""
WAVELENGTHS_NM, MEASURED = 300.0, 2 * 5
"""Range of the wavelengths in nm; rows at each wavelength: two samples, five shifts."""


class RowTimes:
    """A listener that records the processor time of each row that measures, s."""

    def __init__(self) -> None:
        self.seconds: list[float] = []
        self._last = time.process_time()

    def __call__(self, event: Event) -> None:
        """Take the commits; other events are ignored."""
        if isinstance(event, RowCommitted):
            now = time.process_time()
            if event.row.kind == "measure":
                self.seconds.append(now - self._last)
            self._last = now


class LightTimes:
    """Processor time of the throughputs of poses, s, and the number of poses, since it was made."""

    def __init__(self) -> None:
        self.seconds, self._poses = 0.0, set[Aspect]()
        compute = View.throughputs_m2sr

        def timed(view: View, aspect: Aspect) -> Any:
            begin = time.process_time()
            found = compute(view, aspect)
            self.seconds += time.process_time() - begin
            self._poses.add(aspect)
            return found

        View.throughputs_m2sr = timed  # type: ignore[method-assign, assignment]  # measures, then does the same

    @property
    def of_a_pose(self) -> float:
        """Of a pose, s."""
        return self.seconds / len(self._poses)


def statistics_of(plan: Plan) -> RowStatistics:
    """As a rehearsal has them."""
    return RowStatistics(plan.rig.file.photodiodes, partial(relevant_photodiodes, plan))


def row_seconds(plan: Plan) -> list[float]:
    """Run one rehearsal; the processor times of its rows, s."""
    rows = RowTimes()
    with tempfile.TemporaryDirectory() as folder:
        run_on_twin(plan, Path(folder) / "rehearsal.journal", statistics_of(plan), [rows])
    return rows.seconds


def quick_plan(step_deg: float = SHORT) -> Plan:
    """The plan of `quick.toml` with another step of the shift."""
    text = QUICK.read_text(encoding="utf-8").replace(f"step = {SHORT}", f"step = {step_deg}")
    return plan_rehearsal(parse_schedule(text, QUICK.name), read_rig(RIG), {})[0]


def wall_ms_of_a_row(processes: int) -> float:
    """Time that passes for each row by which one rehearsal is longer than another, ms."""
    run = getattr(rehearsal, "run_in_processes", None)
    taken, rows = [], []
    for plan in (quick_plan(LONG_DEG), quick_plan(LONGER_DEG)):
        with tempfile.TemporaryDirectory() as folder:
            begin, path = time.perf_counter(), Path(folder) / "rehearsal.journal"
            if run is None:
                run_on_twin(plan, path, statistics_of(plan), [])
            else:
                run(plan, path, statistics_of(plan), [], processes)
            taken.append(time.perf_counter() - begin)
            rows.append(len(plan.rows))
    return 1e3 * (taken[1] - taken[0]) / (rows[1] - rows[0])


def measure() -> dict[str, float]:
    """The figures of the version that is imported."""
    plan = quick_plan()
    row_seconds(plan)
    row_ms = 1e3 * statistics.median(row_seconds(plan))
    one, two = wall_ms_of_a_row(1), wall_ms_of_a_row(2)
    light = LightTimes()
    row_seconds(plan)
    return {
        "row_ms": row_ms,
        "row_ms_one_process": one,
        "row_ms_two_processes": two,
        "photodiodes_us": 1e6 * light.of_a_pose,
    }


def compare(versions: dict[str, Path], rounds: int) -> dict[str, Any]:
    """The figures of each version, and their ratios."""
    before = os.getloadavg()[0]
    found = in_turns(versions, rounds, "import json\nfrom benchmarks.rehearsal import measure\nprint(json.dumps(measure()))")
    best: dict[str, Any] = {name: {key: min(each[key] for each in runs) for key in runs[0]} for name, runs in found.items()}
    if "against" in best:
        best["ratio"] = {key: best["here"][key] / best["against"][key] for key in best["here"]}
    return {"rounds": rounds, "load": [before, os.getloadavg()[0]], **best}


def resident_bytes() -> int:
    """Resident memory of this process now. Linux only: other systems report only the largest value so far."""
    return int(STATM.read_text(encoding="ascii").split()[1]) * resource.getpagesize()


def peak_bytes() -> int:
    """Largest resident memory of this process since `reset_peak`. Linux only."""
    line = next(each for each in STATUS.read_text(encoding="ascii").splitlines() if each.startswith("VmHWM:"))
    return 1024 * int(line.split()[1])


def reset_peak() -> None:
    """Start a new search for the largest resident memory."""
    CLEAR_REFS.write_text("5", encoding="ascii")


def memory(rows: int) -> dict[str, float]:
    """Rehearse a schedule of about so many rows in this process, as the command does it; the memory it takes."""
    step = WAVELENGTHS_NM / max(1, round(rows / MEASURED) - 1)
    plan, _ = plan_rehearsal(parse_schedule(LONG.format(step=step), "long.toml"), read_rig(RIG), {})
    at: dict[int, int] = {}

    def record_memory(event: Event) -> None:
        if isinstance(event, RowCommitted) and event.done in (FROM_ROW, event.total):
            at[event.done] = resident_bytes()
            if event.done == FROM_ROW:
                reset_peak()

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        rehearse(plan, points=Path(folder) / "points.csv", listeners=[record_memory])
    seconds = time.perf_counter() - start
    last, most = len(plan.rows), peak_bytes()
    return {
        "rows": last,
        "seconds": seconds,
        "most_mb": most / 1e6,
        "grown_in_rows_mb": (at[last] - at[FROM_ROW]) / 1e6,
        "grown_mb": (most - at[FROM_ROW]) / 1e6,
        "bytes_a_row": (most - at[FROM_ROW]) / (last - FROM_ROW),
    }


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time per row and memory of a rehearsal.")
    add_options(parser, rounds=5)
    parser.add_argument("--memory", type=positive, nargs="+", metavar="ROWS", help="rehearse so many rows and print the memory")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    if options.memory and min(options.memory) <= FROM_ROW:
        parser.error(f"--memory: more than {FROM_ROW} rows, from which on the memory is compared")
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    if options.memory and len(options.memory) > 1:
        for rows in options.memory:
            command = [sys.executable, "-m", "benchmarks.rehearsal", "--memory", str(rows)]
            subprocess.run(command + ["--json"] * options.json, check=True)
        return
    if options.memory:
        found = memory(options.memory[0])
        if options.json:
            print(json.dumps({**machine, **found}))
        else:
            peak = f"peak {found['most_mb']:.0f} MB, {found['grown_mb']:.1f} MB more than at row {FROM_ROW}"
            each = f"{found['bytes_a_row']:.0f} bytes per row; {found['grown_in_rows_mb']:.1f} MB more at the last row"
            print(f"{found['rows']:.0f} rows in {found['seconds']:.0f} s: {peak}, {each}")
        return
    versions = versions_of(options.against)
    results = compare(versions, options.rounds)
    if options.json:
        print(json.dumps({**machine, **results}, indent=2))
        return
    print(f"Python {machine['python']}, {machine['machine']}; load {results['load'][0]:.1f} to {results['load'][1]:.1f}")
    for name in (*versions, *(["ratio"] if options.against else [])):
        print(f"    {name:8} {', '.join(f'{key} {value:.3f}' for key, value in results[name].items())}")


if __name__ == "__main__":
    main()
