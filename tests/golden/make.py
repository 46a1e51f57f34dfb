"""Make the golden files anew: `python -m tests.golden.make [NAME ...]`, from the root of the repository.

They record the behaviour of the program. Make them anew only where a change of it is intended, and state the change in the
commit. NAME is a file in `data` without its suffix; without a name all are made except the journals. The journals are of an
older version on purpose, the last one whose model hash contained names of classes; `journals` makes them with the version
that is checked out.
"""

import sys
import tempfile
from collections.abc import Callable
from pathlib import Path

from tests.golden import contents, files, product, wires


def _in_a_folder(make: Callable[[Path], object]) -> object:
    with tempfile.TemporaryDirectory() as folder:
        return make(Path(folder))


def _campaign(name: str) -> None:
    def make(folder: Path) -> object:
        journal = contents.JOURNALS[name](folder)
        if name in ("quick", "traced"):
            files.write(f"rows-{name}", contents.rows_record(product.measured_rows(journal)))
        return contents.points_record(journal)

    files.write(f"points-{name}", _in_a_folder(make))


def _journals() -> None:
    files.write("undisturbed", contents.make_journals(files.DATA))


def _read_journals() -> None:
    with tempfile.TemporaryDirectory() as name:
        finished, interrupted = contents.copied(Path(name))
        files.write("listed", contents.listed(Path(name)))
        files.write("finished", contents.finished_record(finished, Path(name)))
        files.write("interrupted", contents.points_record(interrupted))
        files.write("resumed", contents.resumed_record(interrupted))


def _plans() -> None:
    files.write("plans", {name: contents.plans_record(name) for name in contents.PLANS})


def _simulations() -> None:
    def make(folder: Path) -> object:
        return {name: contents.simulation_record(name, folder) for name in contents.SIMULATIONS}

    files.write("simulations", _in_a_folder(make))


def _table3() -> None:
    files.write("table3", product.table3_noise_free().tolist())


def _wires() -> None:
    files.write("wires", _in_a_folder(lambda folder: {name: wires.record(name, folder) for name in wires.SCHEDULES}))


MAKERS: dict[str, Callable[[], None]] = {
    **{f"points-{name}": lambda name=name: _campaign(name) for name in contents.JOURNALS},  # type: ignore[misc]
    "plans": _plans,
    "simulations": _simulations,
    "table3": _table3,
    "read-journals": _read_journals,
    "wires": _wires,
}


def main() -> None:
    """Makes what is named."""
    names = sys.argv[1:] or list(MAKERS)
    for name in names:
        print(name, flush=True)
        {"journals": _journals, **MAKERS}[name]()


if __name__ == "__main__":
    main()
