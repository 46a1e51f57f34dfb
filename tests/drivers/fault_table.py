"""Table of faults by drivers: the outcome of every fault that a wire can have, counted over many cases.

`python -m benchmarks.fault_table` prints it, and a test checks it.

A case is a fresh virtual rig, a task (a move and its read-back, a slew, a group of readings, a mean), and one fault at an
exchange of the task that the case's number selects. Then the wire is free of faults, the driver recovers, and the task must
succeed. Everything is on the virtual clock, so that the same cases give the same table.
"""

import contextlib
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache

from goniotwin.drivers import DeviceError, Forgotten
from goniotwin.mocks.faults import Fault, ScriptedFaults
from tests.drivers.fault_benches import BENCHES, FaultBench, WrongValueError

TRIES = 4
PAUSE_S = 6.0
"""Longer than an unplugged time, and than an axis without requests turns (heartbeat)."""
RIGHT, AGAIN, ERROR, NOTICED, WRONG, STUCK = "right", "again", "error", "reset noticed", "WRONG", "STUCK"
OUTCOMES = (RIGHT, AGAIN, ERROR, NOTICED, WRONG, STUCK)
LEGEND = {
    RIGHT: "the value is right and nothing had to be repeated",
    AGAIN: "a request was repeated, then the value is right",
    ERROR: "an error that names the device, the command and the cause",
    NOTICED: "the device reset, and the driver detected it",
    WRONG: "a wrong value was returned without error",
    STUCK: "the driver did not recover, or its error did not name the device",
}


@dataclass
class Cell:
    """Outcomes of one fault on one wire, and the errors by their class."""

    outcomes: Counter[str] = field(default_factory=Counter)
    errors: Counter[str] = field(default_factory=Counter)

    def __str__(self) -> str:
        return ", ".join(f"{outcome} {self.outcomes[outcome]}" for outcome in OUTCOMES if self.outcomes[outcome])


Table = dict[Fault, dict[type[FaultBench], Cell]]


@cache
def exchanges(kind: type[FaultBench]) -> int:
    """Number of exchanges of the task on a wire without faults."""
    bench, script = kind(), ScriptedFaults(())
    bench.set_faults(script)
    bench.run_task()
    bench.opened.close()
    return script.exchanges


def case(kind: type[FaultBench], fault: Fault, number: int, cell: Cell) -> str:
    """Outcome of one fault."""
    bench = kind()
    try:
        usual = exchanges(kind)
        faults = [fault] * (3 if fault is Fault.HANG else 1)
        misfortune = ScriptedFaults([*[Fault.NONE] * (number % usual), *faults], number)
        bench.set_faults(misfortune)
        try:
            bench.run_task()
            outcome = RIGHT if misfortune.exchanges <= usual else AGAIN
        except WrongValueError:
            outcome = WRONG
        except DeviceError as error:
            cell.errors[type(error).__name__] += 1
            outcome = NOTICED if isinstance(error, Forgotten) else ERROR
            if not error.device.startswith(bench.devices) or not str(error).startswith(f"{error.device}: {error.doing}: "):
                return STUCK
        bench.set_faults(ScriptedFaults(()))
        return _recovered(bench, outcome)
    finally:
        bench.opened.close()


def _recovered(bench: FaultBench, outcome: str) -> str:
    """The outcome; STUCK if the driver does not recover, NOTICED if only the recovery shows a reset."""
    for _ in range(TRIES):
        bench.clock.sleep_until(bench.clock.now() + PAUSE_S)
        if outcome == ERROR and bench.reset_noticed():
            outcome = NOTICED
        with contextlib.suppress(DeviceError, WrongValueError):
            try:
                if outcome not in (RIGHT, AGAIN):
                    bench.recover()
                bench.run_task()
                return outcome
            except Forgotten:
                outcome = NOTICED if outcome != WRONG else WRONG
                raise
    return STUCK


def table(cases: int) -> Table:
    """A number of cases for each fault on each wire that can have it."""
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
    """Forbidden outcomes: a stuck driver, and a wrong value from a fault that can be detected."""
    forbidden_outcomes: list[str] = []
    for fault, row in rows.items():
        for kind, cell in row.items():
            forbidden = (STUCK,) if fault in kind.undetectable else (STUCK, WRONG)
            forbidden_outcomes += [
                f"{kind.name}, {fault}: {each} {cell.outcomes[each]}" for each in forbidden if cell.outcomes[each]
            ]
    return forbidden_outcomes


def as_markdown(rows: Table) -> str:
    """Faults by drivers. A dagger marks a fault that cannot be detected on the wire."""
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
