"""Table of faults by drivers: the outcome of every fault that a wire can have, counted.

    python -m benchmarks.fault_table [--cases 200]

The cases are those of the tests: `tests/drivers/fault_table.py`.
"""

import argparse
import logging
import sys

from tests.drivers.fault_table import LEGEND, as_markdown, failures, table


def main(arguments: list[str] | None = None) -> int:
    """Print the table; the status is 1 if it has a forbidden outcome."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fault_table", description=__doc__)
    parser.add_argument("--cases", type=int, default=100, help="cases for each fault on each wire (100)")
    cases = parser.parse_args(arguments).cases
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    rows = table(cases)
    print(as_markdown(rows))
    print(f"\n{cases} cases for each fault on each wire. A dagger marks a fault that cannot be detected on the wire.")
    print("\n".join(f"- {name}: {meaning}" for name, meaning in LEGEND.items()), end="\n\n")
    bad = failures(rows)
    print("\n".join(bad) or "No wrong value from a detectable fault; every driver recovered.")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
