"""Make the golden files anew: `make golden`, or `python -m tests.golden.make [NAME ...]`, from the root of the repository.

They record the behaviour of the program. Make them anew only where a change of it is intended, and state the change in the
commit: what is printed is a summary for it, which file, which columns, how many values and by how much. A value that differs
by less than the tests permit stays as it is, so that the files differ where the program does and not where a processor does.

NAME is a folder in `data`; without a name all are made except the journals. The journals are of an older version on purpose,
the last one whose model hash contained names of classes; `journals` makes them with the version that is checked out.
"""

import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.golden import contents, files, product, wires
from tests.golden.compare import BOUNDS, FILE, SIMULATED, TABLE_3, Bounds, differences, words_table
from tests.golden.files import Table, Tables


def _write(folder: str, tables: Tables, bounds: Bounds = BOUNDS) -> None:
    """Write the tables of a folder, and print what has changed."""
    (files.DATA / folder).mkdir(parents=True, exist_ok=True)
    before = files.read(folder)
    for name in before.keys() - tables.keys():
        print(f"{folder}/{name}.csv: is gone")
        (files.DATA / folder / f"{name}.csv").unlink()
    for name, each in tables.items():
        wanted = kept(each, before[name], f"{folder}/{name}.csv", bounds) if name in before else each
        if name not in before:
            print(f"{folder}/{name}.csv: is new, with {len(each)} rows")
        (files.DATA / folder / f"{name}.csv").write_text(files.as_csv(wanted), encoding="utf-8")


def kept(found: Table, golden: Table, where: str, bounds: Bounds) -> Table:
    """The table that is found, with the golden values where there is no difference; what differs is printed."""
    try:
        changes = differences(found, golden, bounds)
    except AssertionError as other:
        print(f"{where}: {other}")
        return found
    columns = {name: list(column) for name, column in golden.columns.items()}
    for change in changes:
        print(f"{where}: {change}")
        for row, cell in zip(change.rows, change.found, strict=True):
            columns[change.column][row] = cell
    return Table(columns)


def _write_lines(name: str, lines: list[str], bounds: Bounds) -> None:
    """Write the lines of another file, unless they are the golden ones, and print what has changed."""
    path = files.DATA / name
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.exists():
        try:
            changes = differences(words_table(lines), words_table(files.read_lines(name)), bounds)
        except AssertionError as other:
            print(f"{name}: {other}")
        else:
            if not changes:
                return
            print("\n".join(f"{name}: {each}" for each in changes))
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")


def _campaign(name: str, folder: Path) -> None:
    journal = contents.JOURNALS[name](folder)
    rows = contents.rows_record(product.measured_rows(journal)) if name in ("quick", "traced") else {}
    _write(name, rows | contents.points_record(journal))


def _journals(_folder: Path) -> None:
    _write("undisturbed", contents.make_journals(files.DATA))


def _read_journals(folder: Path) -> None:
    finished, interrupted = contents.copied(folder)
    _write_lines("listed.json", json.dumps(contents.listed(folder), indent=1).splitlines(), {})
    _write("finished", contents.points_record(finished))
    for form in contents.EXPORTS:
        _write_lines(f"exported/finished.{form}", contents.exported_lines(finished, form, folder), FILE)
    _write("interrupted", contents.points_record(interrupted))
    _write("resumed", contents.resumed_record(interrupted))


def _plans(_folder: Path) -> None:
    for name in contents.PLANS:
        _write(f"plans/{name}", contents.plans_record(name))


def _simulations(folder: Path) -> None:
    for name in contents.SIMULATIONS:
        _write_lines(f"simulations/{name}", contents.simulation_record(name, folder), SIMULATED)


def _table_3(_folder: Path) -> None:
    _write("table-3", contents.table_3_record(), TABLE_3)


def _wires(folder: Path) -> None:
    _write("wires", {table: each for name in wires.SCHEDULES for table, each in wires.record(name, folder).items()})


MAKERS: dict[str, Callable[[Path], None]] = {
    **{name: lambda folder, name=name: _campaign(name, folder) for name in contents.JOURNALS},  # type: ignore[misc]
    "plans": _plans,
    "simulations": _simulations,
    "table-3": _table_3,
    "read-journals": _read_journals,
    "wires": _wires,
}


def main() -> None:
    """Makes what is named."""
    for name in sys.argv[1:] or list(MAKERS):
        print(name, file=sys.stderr, flush=True)
        with tempfile.TemporaryDirectory() as folder:
            {"journals": _journals, **MAKERS}[name](Path(folder))


if __name__ == "__main__":
    main()
