"""Every fault that a wire can have, met by the driver at the end of that wire: what came of it, counted.

    python -m benchmarks.fault_table [--cases 200]

The cases are those of the tests: `tests/drivers/fault_table.py`.
"""

import argparse
import logging
import sys

from tests.drivers.fault_table import LEGEND, as_markdown, failures, table


def main(arguments: list[str] | None = None) -> int:
    """Prints the table; the status is 1 where something is in it that must not be."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.fault_table", description=__doc__)
    parser.add_argument("--cases", type=int, default=100, help="for each fault on each wire (100)")
    cases = parser.parse_args(arguments).cases
    logging.getLogger("pymodbus").setLevel(logging.CRITICAL)
    rows = table(cases)
    print(as_markdown(rows))
    print(f"\n{cases} cases for each fault on each wire. A dagger: this wire cannot show the fault.")
    print("\n".join(f"- {name}: {meaning}" for name, meaning in LEGEND.items()), end="\n\n")
    bad = failures(rows)
    print("\n".join(bad) or "No wrong value under a fault that the wire lets one detect; every driver works again.")
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
