"""Time and memory of what follows a campaign, and of the check before it: reduction, export, files of a million values (Linux).

    python -m benchmarks.export [CASE ...] [--rows 100000] [--rounds 3] [--against FOLDER] [--json]

`rows_4` and `rows_36`: a journal of about so many rows, written without a rig, of two sigmas, five betas, ten shifts and many
wavelengths, with 4 photodiodes, where the work for each row counts, or 36, where that for each value does. It is reduced to
files and exported as CSV, the budget of each value included. `million`: the same with 4 photodiodes and ten times the rows;
only where it is named, for its journal alone takes minutes. `one_wavelength`: such a journal of 4 photodiodes with a pose for
each row, a tenth as long. `report`: the report of the journal of 36 photodiodes. `check`: the plan and the check of 108,900
rows with a dark reading every second. `csv` and `astm`: a million values written and read, as `python -m benchmarks.formats`
does.

Each run has a process of its own. A figure is the least of some rounds: processor time (`_s`) and time that passed (`_wall_s`);
of the memory, `peak_mb`, it is the largest. `load` is the machine's load before and after. `--against` is the folder of another
version: both versions take turns, and `ratio` is that of this one to the other.
"""

import argparse
import json
import os
import platform
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.versions import HERE, add_options, positive, run_version, versions_of
from tests.app.campaign.reduction.long_journal import write_long_journal

SHIFTS, ROWS_AT_EACH = 10, 2 * 2 * 5
"""Shifts; rows at each shift and wavelength: sample and etalon, two sigmas, five betas."""
POSES_SHARE = 10
"""A journal with a pose for each row is shorter by this factor."""
MILLION = 1_000_000
END = """
peak = next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM:"))
print(json.dumps({**found, "peak_mb": int(peak) * 1024 / 1e6}))
"""
TIMES = """
import json, sys, time
from pathlib import Path
def now():
    return time.process_time(), time.perf_counter()
def spent(name, begin, end):
    return {f"{name}_s": end[0] - begin[0], f"{name}_wall_s": end[1] - begin[1]}
"""
REDUCE = f"""{TIMES}
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_to_files
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
journal, out = map(Path, sys.argv[1:])
begin = now()
with Journal.open(journal) as opened, reduce_to_files(opened, out.parent) as reduced:
    between = now()
    values = convert_reduced(reduced, out, format_to_write(out), Choice()).values
found = {{**spent("reduction", begin, between), **spent("with_export", begin, now()), "values": values}}
{END}"""
REPORT = f"""{TIMES}
from goniotwin.app.data.report.report import write_report
journal, out = map(Path, sys.argv[1:])
begin = now()
write_report(journal, out)
found = spent("report", begin, now())
{END}"""
CHECK = f"""{TIMES}
from goniotwin.app.campaign.planning.check import check_plan
from goniotwin.app.campaign.planning.plan import make_plan
from goniotwin.app.campaign.schedule.file import read_schedule
from goniotwin.app.rig import read_rig
schedule, rig = map(Path, sys.argv[1:])
begin = now()
rows = check_plan(make_plan(read_schedule(schedule), read_rig(rig))).rows
found = {{**spent("check", begin, now()), "rows": rows}}
{END}"""
FORMAT = f"""{TIMES}
from tests.app.formats.million import measure
found = measure(sys.argv[1], int(sys.argv[2]))
{END}"""
SCHEDULE = """
name = "dark"
samples = ["gaussian-5"]
etalon = "etalon"
sigma_deg = [15, 30, 45]
beta_deg = { start = 0, stop = 180, step = 20 }
shift_deg = { start = 0, stop = 4.5, step = 0.5 }
wavelength_nm = { start = 400, stop = 490, step = 1 }
gains_v_per_a = [1e10]
readings = 1
dark_readings = 4
dark_every_s = 1
"""
CASES = ("rows_4", "rows_36", "one_wavelength", "report", "check", "csv", "astm")
LONG = "million"
MORE_ROWS = 10
"""Times the rows of the others."""


def prepared(case: str, rows: int, folder: Path) -> Callable[[Path], dict[str, float]]:
    """Make what a case needs in a folder; the function that runs it in a version."""
    if case == "check":
        schedule = folder / "dark.toml"
        schedule.write_text(SCHEDULE, encoding="utf-8")
        rig = HERE / "examples" / "rigs" / "virtual.toml"
        return lambda version: run_version(version, CHECK, str(schedule), str(rig), folder=folder)
    if case in ("csv", "astm"):
        return lambda version: run_version(version, FORMAT, case, str(MILLION), folder=folder)
    journal, out = folder / "long.journal", folder / ("long.html" if case == "report" else "long.csv")
    each = ROWS_AT_EACH * SHIFTS
    if case == "one_wavelength":
        write_long_journal(journal, 1, max(1, round(rows / POSES_SHARE / ROWS_AT_EACH)), step_deg=4.0 / rows)
    else:
        # With dark readings a journal has a little more than these rows, and the most that a campaign may have is a million.
        wavelengths = round(rows / each) if case != LONG else round(MORE_ROWS * rows / each * 0.9984)
        write_long_journal(journal, max(1, wavelengths), SHIFTS, photodiodes=4 if case in ("rows_4", LONG) else 36)
    program = REPORT if case == "report" else REDUCE
    return lambda version: run_version(version, program, str(journal), str(out), folder=folder)


def compare(case: str, versions: Mapping[str, Path], rows: int, rounds: int) -> dict[str, Any]:
    """The figures of each version, and the ratios of their times."""
    found: dict[str, list[dict[str, float]]] = {name: [] for name in versions}
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        run_case = prepared(case, rows, Path(folder))
        for _ in range(rounds):
            for name, version in versions.items():
                found[name].append(run_case(version))
    best: dict[str, Any] = {
        name: {key: (max if key == "peak_mb" else min)(each[key] for each in runs) for key in runs[0]}
        for name, runs in found.items()
    }
    if "against" in best:
        times = [key for key in best["here"] if key.endswith("_s")]
        best["ratio"] = {key: best["here"][key] / best["against"][key] for key in times}
    return {"case": case, "load": [before, os.getloadavg()[0]], **best}


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(
        description="Time and memory of the reduction, the export and the check of long campaigns."
    )
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"{', '.join(CASES)}; {LONG} if it is named")
    parser.add_argument("--rows", type=positive, default=100_000, help="number of rows, about")
    add_options(parser, rounds=3)
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    if unknown := set(options.cases) - {*CASES, LONG}:
        parser.error(f"no case {', '.join(sorted(unknown))}; they are {', '.join((*CASES, LONG))}")
    versions = versions_of(options.against)
    machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
    results = []
    for case in options.cases or CASES:
        results.append(found := compare(case, versions, options.rows, options.rounds))
        if not options.json:
            print(f"{case}: load {found['load'][0]:.1f} to {found['load'][1]:.1f}")
            for name in (*versions, *(["ratio"] if options.against else [])):
                figures = (f"{key} {value:.2f}" for key, value in found[name].items())
                print(f"    {name:8} {', '.join(figures)}", flush=True)
    if options.json:
        print(json.dumps({**machine, "rounds": options.rounds, "cases": results}, indent=2))


if __name__ == "__main__":
    main()
