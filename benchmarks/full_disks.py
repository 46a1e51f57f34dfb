"""Files on full disks: for each format and each other file, the disks' sizes and what became of the command.

    python -m benchmarks.full_disks [--sizes 50]

The disks are small tmpfs, which root alone may mount. The cases are those of the tests: `tests/system/full_disks.py`.
"""

import argparse
import sys
import tempfile
from pathlib import Path

from tests.system.full_disks import HEADING, as_row, bytes_needed, on_a_disk, sizes_of_disks, small_disks, writings


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the status is 1 if it has anything but whole files and lines with status 2."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.full_disks", description=__doc__)
    parser.add_argument("--sizes", type=int, default=50, help="sizes of each file's disk (50)")
    parser.add_argument("--only", default="", help="only the files whose name contains this")
    given = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as name:
        logs, place, free = Path(name), Path(name) / "disk", Path(name) / "free"
        place.mkdir()
        free.mkdir()
        with small_disks(place) as disk:
            if disk is None:
                print("mounting a disk is not permitted here: run it as root")
                return 1
            print(HEADING)
            faults = 0
            for writing in writings(logs):
                if given.only in writing.name:
                    sizes = sizes_of_disks(bytes_needed(writing, free, logs), given.sizes)
                    outcomes = [on_a_disk(writing, size, disk, logs) for size in sizes]
                    print(as_row(outcomes), flush=True)
                    faults += sum(bool(each.fault) for each in outcomes)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
