"""Every fault that a wire can have, met by the driver at the end of that wire: what came of it, counted.

`python -m benchmarks.fault_table` prints it, and a test holds it.

A case is a fresh virtual rig, a piece of work (a move and its read-back, a slew, a group of readings, a mean), and one fault
at an exchange of it that the case's number chooses. Then the wire is well, the driver does what it can, and the piece of
work has to come out right. Everything is on the virtual clock, so the same cases give the same table.
"""

import contextlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

from goniotwin.drivers import DeviceError, Forgotten
from goniotwin.mocks.faults import Fault, Script
from tests.drivers.failing_drivers import BENCHES, Bench, WrongValueError

TRIES = 4
PAUSE_S = 6.0
"""Longer than a plug is out, and than an axis that nobody asks any more turns."""
RIGHT, AGAIN, ERROR, NOTICED, WRONG, STUCK = "right", "again", "error", "reset noticed", "WRONG", "STUCK"
OUTCOMES = (RIGHT, AGAIN, ERROR, NOTICED, WRONG, STUCK)
LEGEND = {
    RIGHT: "the value is right and nothing had to be repeated",
    AGAIN: "asked again, then right",
    ERROR: "an error that names the device, the command and what happened",
    NOTICED: "the device has reset itself, and the driver reports it",
    WRONG: "a wrong value was returned as good",
    STUCK: "the driver did not work again, or its error did not name it",
}


@dataclass
class Cell:
    """What happened under one fault on one wire: outcomes, and the errors by their kind."""

    outcomes: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        return ", ".join(f"{outcome} {self.outcomes[outcome]}" for outcome in OUTCOMES if self.outcomes[outcome])


Table = dict[Fault, dict[type[Bench], Cell]]


@cache
def exchanges(kind: type[Bench]) -> int:
    """How many a piece of work takes on a wire that is well."""
    bench, well = kind(), Script(())
    bench.suffer(well)
    bench.work()
    bench.opened.close()
    return well.exchanges


def case(kind: type[Bench], fault: Fault, number: int, cell: Cell) -> str:
    """One fault, and what came of it."""
    bench = kind()
    try:
        usual = exchanges(kind)
        faults = [fault] * (3 if fault is Fault.HANG else 1)
        misfortune = Script([*[Fault.NONE] * (number % usual), *faults], number)
        bench.suffer(misfortune)
        try:
            bench.work()
            outcome = RIGHT if misfortune.exchanges <= usual else AGAIN
        except WrongValueError:
            outcome = WRONG
        except DeviceError as error:
            cell.errors[type(error).__name__] += 1
            outcome = NOTICED if isinstance(error, Forgotten) else ERROR
            if not error.device.startswith(bench.devices) or not str(error).startswith(f"{error.device}: {error.doing}: "):
                return STUCK
        bench.suffer(Script(()))
        return _recovered(bench, outcome)
    finally:
        bench.opened.close()


def _recovered(bench: Bench, outcome: str) -> str:
    """The outcome; or STUCK where the driver does not work again, or NOTICED where only that shows a reset."""
    for _ in range(TRIES):
        bench.clock.sleep_until(bench.clock.now() + PAUSE_S)
        if outcome == ERROR and bench.noticed():
            outcome = NOTICED
        with contextlib.suppress(DeviceError, WrongValueError):
            try:
                if outcome not in (RIGHT, AGAIN):
                    bench.mend()
                bench.work()
                return outcome
            except Forgotten:
                outcome = NOTICED if outcome != WRONG else WRONG
                raise
    return STUCK


def table(cases: int) -> Table:
    """So many cases for each fault on each wire that can have it."""
    rows: Table = {}
    for fault in Fault:
        row = {kind: Cell() for kind in BENCHES if fault in kind.faults}
        for kind, cell in row.items():
            for number in range(cases):
                cell.outcomes[case(kind, fault, number, cell)] += 1
        if row:
            rows[fault] = row
    return rows


def failures(rows: Table) -> list[str]:
    """What must not have happened: a driver that is stuck, and a wrong value where the wire lets one detect the fault."""
    found: list[str] = []
    for fault, row in rows.items():
        for kind, cell in row.items():
            forbidden = (STUCK,) if fault in kind.undetectable else (STUCK, WRONG)
            found += [f"{kind.name}, {fault}: {each} {cell.outcomes[each]}" for each in forbidden if cell.outcomes[each]]
    return found


def as_markdown(rows: Table) -> str:
    """Faults by drivers. A dagger stands where the wire does not let one detect the fault."""
    kinds = list(dict.fromkeys(kind for row in rows.values() for kind in row))
    lines = [["fault", *(kind.name for kind in kinds)], ["---"] * (len(kinds) + 1)]
    for fault, row in rows.items():
        cells = [f"{row[kind]}{' †' if fault in kind.undetectable else ''}" if kind in row else "" for kind in kinds]
        lines.append([str(fault), *cells])
    lines.append(["errors"] + [_errors(row[kind] for row in rows.values() if kind in row) for kind in kinds])
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _errors(cells: Iterable[Cell]) -> str:
    total: Counter[str] = sum((cell.errors for cell in cells), Counter())
    return ", ".join(f"{name} {count}" for name, count in total.most_common())
