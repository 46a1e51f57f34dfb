"""Time and memory of the reduction and of the export of a long journal (Linux).

    python -m benchmarks.reduction [--rows 100000] [--rounds 3] [--against FOLDER] [--json]

Two journals of about so many rows, written without a rig, of two sigmas, five betas, ten shifts and many wavelengths: one of 4
photodiodes, where the work for each row counts, and one of 36, where that for each value does. Each is reduced to files and
exported as CSV, each time in a process of its own. The result is the least processor time of some rounds, and the largest
resident memory. `--against` is the folder of another version, with `goniotwin` in it or under `.venv/links`: both versions
then take turns, and the ratio of their times is given.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tests.app.campaign.reduction.long_journal import write_long_journal

HERE = Path(__file__).resolve().parents[1]
SHIFTS, ROWS_AT_EACH = 10, 2 * 2 * 5
"""Shifts; rows at each shift and wavelength: sample and etalon, two sigmas, five betas."""
REDUCE = """
import sys, time
from pathlib import Path
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.reduction import reduce_to_files
from goniotwin.app.data.conversion import Choice, convert_reduced, format_to_write
journal, out = map(Path, sys.argv[1:])
begin = time.process_time()
with Journal.open(journal) as opened, reduce_to_files(opened, out.parent) as reduced:
    between = time.process_time()
    values = convert_reduced(reduced, out, format_to_write(out), Choice()).values
end = time.process_time()
peak = next(line.split()[1] for line in Path("/proc/self/status").read_text().splitlines() if line.startswith("VmHWM:"))
print(between - begin, end - begin, int(peak) * 1024, values)
"""


def measure(version: Path, journal: Path, out: Path) -> dict[str, float]:
    """Reduce and export a journal in a process of its own."""
    links = version / ".venv" / "links"
    environment = {**os.environ, "PYTHONPATH": str(links if links.is_dir() else version)}
    command = [sys.executable, "-c", REDUCE, str(journal), str(out)]
    found = subprocess.run(command, cwd=out.parent, env=environment, capture_output=True, text=True, check=True).stdout
    reduction_s, whole_s, peak, values = (float(each) for each in found.split())
    return {"reduction_s": reduction_s, "with_export_s": whole_s, "peak_mb": peak / 1e6, "values": values}


def compare(versions: dict[str, Path], photodiodes: int, rows: int, rounds: int) -> dict[str, Any]:
    """The least times and the largest memory of each version, on one journal."""
    with tempfile.TemporaryDirectory() as folder:
        journal, out = Path(folder) / "long.journal", Path(folder) / "long.csv"
        written = write_long_journal(journal, max(1, round(rows / SHIFTS / ROWS_AT_EACH)), SHIFTS, photodiodes=photodiodes)
        found: dict[str, list[dict[str, float]]] = {name: [] for name in versions}
        for _ in range(rounds):
            for name, version in versions.items():
                found[name].append(measure(version, journal, out))
    best = {
        name: {key: (max if key == "peak_mb" else min)(each[key] for each in rounds_) for key in rounds_[0]}
        for name, rounds_ in found.items()
    }
    return {"photodiodes": photodiodes, "rows": written, **best}


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time and memory of the reduction of a long journal.")
    parser.add_argument("--rows", type=int, default=100_000, help="number of rows, about")
    parser.add_argument("--rounds", type=int, default=3, help="number of reductions of each version")
    parser.add_argument("--against", type=Path, help="folder of another version")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    versions = {"here": HERE} | ({"against": options.against.resolve()} if options.against else {})
    for photodiodes in (4, 36):
        found = compare(versions, photodiodes, options.rows, options.rounds)
        if options.json:
            print(json.dumps(found))
            continue
        for name in versions:
            each = found[name]
            times = f"reduction {each['reduction_s']:.1f} s, with export {each['with_export_s']:.1f} s"
            print(f"{found['rows']} rows of {photodiodes} photodiodes, {name}: {times}, {each['peak_mb']:.0f} MB")
        if options.against:
            ratios = [found["here"][key] / found["against"][key] for key in ("reduction_s", "with_export_s")]
            print(f"    ratio of the times: reduction {ratios[0]:.2f}, with export {ratios[1]:.2f}")


if __name__ == "__main__":
    main()
