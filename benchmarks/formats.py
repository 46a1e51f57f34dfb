"""Time and memory of writing and of reading a million values, by each format (Linux).

    python -m benchmarks.formats [FORMAT ...] [--values 1000000] [--json]

Each format has a process of its own. It writes what `goniotwin convert` would of the same content: a grid of ten incidences
(for `rgl_4d` of three, at 24 azimuths of the light), a list of scattered values, or regular factors. The times are processor
time and, with `wall`, time that passed; the memory is the largest that was resident, the content and all libraries included.
"""

import argparse
import json

from tests.app.formats.million import FORMATS, VALUES, measure_apart


def main() -> None:
    """Print a table, or JSON."""
    parser = argparse.ArgumentParser(description="Time and memory of writing and of reading a million values.")
    parser.add_argument("formats", nargs="*", choices=[[], *FORMATS], help="formats; all of them by default")
    parser.add_argument("--values", type=int, default=VALUES, help="number of values, about")
    parser.add_argument("--json", action="store_true", help="print JSON")
    options = parser.parse_args()
    if not options.json:
        print("format   values  write s (wall)   read s (wall)   file MB  peak MB")
    found = {}
    for name in options.formats or FORMATS:
        found[name] = each = measure_apart(name, options.values)
        if not options.json:
            times = "  ".join(f"{each[f'{what}_s']:6.2f} ({each[f'{what}_wall_s']:5.2f})" for what in ("write", "read"))
            print(f"{name:8} {each['values']:8.0f}  {times}  {each['file_mb']:7.1f}  {each['peak_mb']:7.0f}", flush=True)
    if options.json:
        print(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
