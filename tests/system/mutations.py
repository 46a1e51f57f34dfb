"""Wild mutations of every kind of file, by seed, and how the command that reads the file ends."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

import h5py
import numpy as np

from goniotwin.app.campaign.journal import chain
from goniotwin.app.campaign.journal.schema import migrate
from goniotwin.app.formats import BsdfTable, registry, write_rayset, writing
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.hdf5 import BLOCK
from goniotwin.app.formats.rayset import HEADING
from goniotwin.twin.optics.illumination.rayset import record
from goniotwin.twin.optics.illumination.unit import IlluminationUnit
from tests.conftest import REPOSITORY, RIG, SMALL
from tests.system.command import invoke

CPU_S = 10
MEMORY_BYTES = 1_000_000_000
EXTREMES = (
    "0",
    "-1",
    "1e300",
    "1e-300",
    "-1e24",
    "1e20",
    "1e-20",
    "nan",
    "-inf",
    "9e999",
    "9" * 5000,
    "0x" + "f" * 100,
    "2147483648",
    "18446744073709551616",
    "1_0",
    "true",
    '""',
    '"a"',
    "[]",
    "{}",
    "[[1]]",
    "{ start = 0, stop = 1e9, step = 1e-9 }",
    "1979-05-27",
    "[" * 400,
    "a" + ".a" * 9,
    "\x00",
    "\N{ZERO WIDTH SPACE}",
    '"' + "x" * 100_000 + '"',
    "'''",
    "1 2",
    ",",
    "=",
)
HUGE = {
    "lists": ("[", "[],", "[]]"),
    "lists of a key": ('{"gains": [', "[],", "[]]}"),
    "text": ("x", "xyz", "x"),
    "digits": ("1", "111", "1"),
    "after a NUL": ("\x00[", "[],", "[]]"),
}
"""Beginning, repeated part and end of texts of tens of MB; as objects they would take up to a hundred times as much."""
HUGE_PARTS = 16_000_000
JSON_EXTREMES: tuple[Any, ...] = (
    None,
    True,
    -1,
    0,
    10**9,
    10**30,
    1e300,
    float("nan"),
    float("inf"),
    "",
    "x" * 50_000,
    "\x00",
    "\ud800",
    [],
    [[]],
    [None],
    {},
    {"": {}},
    [0] * 20_000,
    ["skipped"] * 10_000,
    {str(key): "" for key in range(10_000)},
)
TEXTS = {"schedule.toml", "rig.toml", "certificate.csv", "table.ddr", "table.bsdf"}
COMMANDS: dict[str, list[str]] = {
    "schedule.toml": ["check", "schedule.toml", "--rig", "rig.toml", "--json"],
    "rig.toml": ["check", "schedule.toml", "--rig", "rig.toml", "--json"],
    "certificate.csv": ["check", "schedule.toml", "--rig", "rig.toml"],
    "table.ddr": ["check", "schedule.toml", "--rig", "ddr.toml"],
    "table.bsdf": ["check", "schedule.toml", "--rig", "bsdf.toml"],
    "finished.journal": ["export", "finished.journal", "--format", "csv", "--out", "points.csv"],
    "interrupted.journal": ["runs", ".", "--json"],
    "chained.journal": ["export", "chained.journal", "--format", "csv", "--out", "points.csv"],
    "left.journal": ["runs", ".", "--json"],
    "rays.h5": [
        "simulate",
        "sample",
        "--sample",
        "lambertian:reflectance=0.5",
        "--sigma",
        "0",
        "--estimator",
        "forward",
        "--paths",
        "1",
        "--source",
        "rays.h5",
        "--wavelength",
        "550",
        "--interval",
        "10",
        "--out",
        "simulated.ddr",
    ],
}
"""By the file that is changed, a command that reads it."""


def make_files(root: Path) -> Path:
    """Make the files before they are changed, in `originals`; return an empty folder for those that are."""
    folder, changed = root / "originals", root / "changed"
    folder.mkdir()
    changed.mkdir()
    certificate = '\n[certificate]\nfile = "certificate.csv"\nexpires = 2999-01-01\n'
    (folder / "schedule.toml").write_text(SMALL + certificate, encoding="utf-8")
    rig = RIG.read_text(encoding="utf-8")
    (folder / "rig.toml").write_text(rig, encoding="utf-8")
    shutil.copy(REPOSITORY / "tests" / "golden" / "certificate.csv", folder)
    grid = (np.array([0.0, 30.0]), np.array([0.0, 90.0, 180.0]), np.array([0.0, 10.0, 90.0]))
    table = BsdfTable(*grid, values=np.full((1, 1, 2, 3, 3), 0.2), transmitted=False, generated=True)
    for suffix in ("ddr", "bsdf"):
        path = folder / f"table.{suffix}"
        writing.write(path, BsdfFile((table,)), registry.format_for(path, {registry.Holds.GRID}))
        sample = f'[twin.samples.table]\nmodel = "table"\nfile = "{path.name}"\n\n[twin.samples.etalon]'
        (folder / f"{suffix}.toml").write_text(rig.replace("[twin.samples.etalon]", sample), encoding="utf-8")
    for name in ("finished.journal", "interrupted.journal"):
        shutil.copy(REPOSITORY / "tests" / "golden" / "data" / name, folder)
    for name, old in (("chained.journal", "finished.journal"), ("left.journal", "interrupted.journal")):
        shutil.copy(folder / old, folder / name)
        with contextlib.closing(sqlite3.connect(folder / name, isolation_level=None)) as db:
            migrate(db)
            compute_chain(db)
    write_rayset(folder / "rays.h5", record(IlluminationUnit(), 20, seed=1))
    return changed


def mutate(name: str, path: Path, numbers: np.random.Generator) -> None:
    """Change a file: its parts, for the half of them, else its bytes."""
    for _ in range(int(numbers.integers(1, 4))):
        if numbers.random() < 0.5:
            path.write_bytes(with_changed_bytes(path.read_bytes(), numbers))
        elif name in TEXTS:
            text = path.read_text(encoding="utf-8", errors="replace")
            path.write_text(with_changed_words(text, numbers), encoding="utf-8", errors="replace")
        elif name.endswith(".journal"):
            with contextlib.suppress(sqlite3.Error, ValueError, RecursionError):
                change_journal(path, numbers)
        else:
            with contextlib.suppress(OSError, KeyError, TypeError, ValueError, RuntimeError):
                _change_dataset(path, numbers)


def with_changed_bytes(before: bytes, numbers: np.random.Generator) -> bytes:
    """A content with some of its bytes changed, removed, added, repeated or zero."""
    content = bytearray(before)
    at, size = (int(each) for each in numbers.integers(0, [len(content) + 1, 200]))
    match int(numbers.integers(6)):
        case 0:
            content[at : at + 1] = bytes([content[at] ^ (1 << int(numbers.integers(8)))] if at < len(content) else [0])
        case 1:
            del content[at : at + size]
        case 2:
            content[at:at] = numbers.bytes(size)
        case 3:
            content[at:at] = content[at : at + size] * int(numbers.integers(1, 500))
        case 4:
            del content[at:]
        case 5:
            content[at : at + size] = b"\0" * size
    return bytes(content)


def with_changed_words(text: str, numbers: np.random.Generator) -> str:
    """A text with a word or a line that is extreme, or with lines in another order or repeated."""
    lines = text.split("\n")
    k, other = (int(each) for each in numbers.integers(len(lines), size=2))
    extreme = EXTREMES[int(numbers.integers(len(EXTREMES)))]
    match int(numbers.integers(6)):
        case 0 | 1 | 2:
            separator = next((each for each in ("=", ",", "\t", " ") if each in lines[k]), None)
            words = lines[k].split(separator) or [""]
            words[int(numbers.integers(len(words)))] = f" {extreme} "
            lines[k] = (separator or " ").join(words)
        case 3:
            lines[k], lines[other] = lines[other], lines[k]
        case 4:
            lines[other:other] = [lines[k]] * int(numbers.integers(1, 100))
        case 5:
            lines[k] = extreme
    return "\n".join(lines)


def compute_chain(db: sqlite3.Connection) -> None:
    """Compute all checksums of a journal anew, those of its first rows too: a stranger can."""
    db.execute("DELETE FROM campaign WHERE key = ?", (chain.ENTRY,))
    chain.begin_chain(db)
    (about,) = db.execute("SELECT value FROM campaign WHERE key = ?", (chain.ENTRY,)).fetchone()
    about = json.dumps(json.loads(about) | {"after_session": 0})
    db.execute("UPDATE campaign SET value = ? WHERE key = ?", (about, chain.ENTRY))
    db.execute("DELETE FROM chain")
    found = chain.Chain(tip=chain.campaign_hash(db))
    for number, attempt in db.execute("SELECT number, attempt FROM attempt ORDER BY session, number, attempt").fetchall():
        found = chain.add_links(db, found, [(number, attempt)])
    db.execute("UPDATE session SET first_link = 1, last_link = ?, tip = ?", (found.length, found.tip))
    for (session,) in db.execute("SELECT id FROM session").fetchall():
        chain.seal_session(db, session)


def change_journal(path: Path, numbers: np.random.Generator) -> None:
    """Change values of a journal; most of those that have a chain get it computed anew, so that the values are read."""
    with contextlib.closing(sqlite3.connect(path)) as db, db:
        db.execute("PRAGMA ignore_check_constraints = ON")
        db.execute("PRAGMA synchronous = OFF")  # tens of megabytes need not reach the disk
        change = (_change_cell, _change_value, _change_value, _change_json, _change_json, _change_readings, _change_huge)
        change[int(numbers.integers(len(change)))](db, numbers)
        if numbers.random() < 0.9 and db.execute("SELECT 1 FROM sqlite_schema WHERE name = 'chain'").fetchone():
            compute_chain(db)


def _change_cell(db: sqlite3.Connection, numbers: np.random.Generator) -> None:
    """Another value in a column, of whatever type."""
    values = (None, -1, 0, 2**63 - 1, 1e300, "x" * 100_000, "", b"\xff" * 7, b"", "{}", "[" * 5000, "nan", 1e-300, *EXTREMES)
    table, column = _column(db, numbers)
    value = values[int(numbers.integers(len(values)))]
    db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid % 3 = ?", (value, int(numbers.integers(3))))


def _change_value(db: sqlite3.Connection, numbers: np.random.Generator) -> None:
    """Another value of the column's type: words of a file, a number of another size."""
    table, column, row, value = _cell(db, numbers)
    numeric = (0, -1, 1, 2, 7, 10**6, 2**31, 2**63 - 1, -(2**63), 1e300, -1e300, 1e-300, 1e20, float("inf"), 0.5)
    extreme = numeric[int(numbers.integers(len(numeric)))]
    if isinstance(value, str):
        value = with_changed_words(value, numbers)
    elif isinstance(value, int):
        value = int(extreme) if abs(extreme) < 2**63 else 3
    else:
        value = float(extreme)
    db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (value, row))


def _change_json(db: sqlite3.Connection, numbers: np.random.Generator) -> None:
    """Another part of a JSON text."""
    columns = ("attempt.flags", "attempt.positions", "plan.detail", "session.versions", "campaign.value")
    table, column = columns[int(numbers.integers(len(columns)))].split(".")
    rows = db.execute(f"SELECT rowid, {column} FROM {table} WHERE json_valid({column}) OR {column} IS NULL").fetchall()
    if not rows:
        return
    row, text = rows[int(numbers.integers(len(rows)))]
    found = {"beta": 0.0} if text is None else json.loads(text)
    extreme = JSON_EXTREMES[int(numbers.integers(len(JSON_EXTREMES)))]
    if isinstance(found, dict) and found and numbers.random() < 0.8:
        found[list(found)[int(numbers.integers(len(found)))]] = extreme
    elif isinstance(found, list) and numbers.random() < 0.5:
        found.append(extreme)
    else:
        found = extreme
    db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (json.dumps(found), row))


def _change_readings(db: sqlite3.Connection, numbers: np.random.Generator) -> None:
    """Counts of another size, which fits the numbers of readings and of channels, or does not."""
    rows = db.execute("SELECT rowid, readings, channels FROM reading").fetchall()
    if not rows:
        return
    row, readings, channels = rows[int(numbers.integers(len(rows)))]
    shapes = (
        (readings * 100, channels),
        (readings, channels + 1),
        (readings, 1),
        (1, channels),
        (0, channels),
        (readings, 0),
        (-1, channels),
        (-1, -1),
        (15_000_000, 1),
        (400_000, 36),
        (1, 15_000_000),
        (2**40, 2**40),
    )
    shape = shapes[int(numbers.integers(len(shapes)))]
    size = 2 * abs(shape[0] * shape[1])
    counts = bytes(size) if numbers.random() < 0.5 and size < 1000 else b"\x05\x02" * (min(size, 30_000_000) // 2)
    db.execute("UPDATE reading SET readings = ?, channels = ?, counts = ? WHERE rowid = ?", (*shape, counts, row))


def _change_huge(db: sqlite3.Connection, numbers: np.random.Generator) -> None:
    """A text of tens of MB."""
    texts = [name for name in HUGE if numbers.random() < 0.5] or ["lists"]
    table, column, row, _ = _cell(db, numbers, only_texts=True)
    write_huge(db, table, column, row, texts[0])


def write_huge(db: sqlite3.Connection, table: str, column: str, row: int, what: str) -> None:
    """Write a text of HUGE in a cell."""
    begin, part, end = HUGE[what]
    db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid = ?", (f"{begin}{part * HUGE_PARTS}{end}", row))


def _column(db: sqlite3.Connection, numbers: np.random.Generator, *, only_texts: bool = False) -> tuple[str, str]:
    tables = [name for (name,) in db.execute("SELECT name FROM sqlite_schema WHERE type = 'table' ORDER BY name")]
    table = tables[int(numbers.integers(len(tables)))]
    columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})") if row[2] == "TEXT" or not only_texts]
    return (table, columns[int(numbers.integers(len(columns)))]) if columns else ("campaign", "value")


def _cell(db: sqlite3.Connection, numbers: np.random.Generator, *, only_texts: bool = False) -> tuple[str, str, int, Any]:
    """Table, column, number and value of a cell; of tables without rows that of the campaign."""
    table, column = _column(db, numbers, only_texts=only_texts)
    rows = db.execute(f"SELECT rowid, {column} FROM {table}").fetchall()
    if not rows:
        table, column = "campaign", "value"
        rows = db.execute("SELECT rowid, value FROM campaign").fetchall()
    row, value = rows[int(numbers.integers(len(rows)))]
    return table, column, row, value


def _change_dataset(path: Path, numbers: np.random.Generator) -> None:
    """With a right checksum: a stranger can compute it too."""
    values: list[Any] = ["x" * 60_000, -1, 2**63, 1e300, np.nan, b"\xff", np.zeros(5), np.zeros((0, 3)), True, h5py.Empty("f")]
    value = values[int(numbers.integers(len(values)))]
    with h5py.File(path, "r+") as file:
        place = file if numbers.random() < 0.5 else file[list(file)[int(numbers.integers(len(file)))]]
        if numbers.random() < 0.5 and len(place.attrs):
            place.attrs[list(place.attrs)[int(numbers.integers(len(place.attrs)))]] = value
        else:
            name = list(file)[int(numbers.integers(len(file)))]
            shape, dtype = file[name].shape, file[name].dtype
            del file[name]
            if numbers.random() < 0.3:  # of which nothing is stored
                file.create_dataset(name, shape=(10**12, *shape[1:]), dtype=dtype, chunks=(1000, *shape[1:]))
            else:
                file.create_dataset(name, data=value)
    content = path.read_bytes()
    heading = f"{HEADING}{hashlib.sha256(content[BLOCK:]).hexdigest()}\n".encode()
    path.write_bytes(heading.ljust(BLOCK - 1) + b"\n" + content[BLOCK:])


class TooLong(BaseException):
    """A command takes more than CPU_S of the processor; no command catches this."""


def _interrupt(number: int, frame: FrameType | None) -> None:
    raise TooLong


@contextlib.contextmanager
def memory_limit(size: int | None) -> Iterator[None]:
    """Limit the memory of this process, bytes; what makes the files is not limited."""
    if size is None:
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def attempt(number: int, originals: Path, folder: Path, memory: int | None = None) -> str | None:
    """Run the command of one mutation in `folder`, which is the current one; return what is wrong with how it ends.

    `memory` is the limit of the command, bytes.
    """
    numbers = np.random.default_rng(number)
    name = list(COMMANDS)[number % len(COMMANDS)]
    for path in folder.iterdir():
        path.unlink()
    for path in originals.iterdir():
        shutil.copy(path, folder)
    mutate(name, folder / name, numbers)
    before = signal.signal(signal.SIGPROF, _interrupt)
    signal.setitimer(signal.ITIMER_PROF, CPU_S)
    try:
        with memory_limit(memory):
            done = invoke(*COMMANDS[name])
    except TooLong:
        return f"{number}: {name}: takes more than {CPU_S} s"
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)
    lines = done.stderr.splitlines()
    if "Traceback" in done.stderr or "unexpected error" in done.stderr:
        return f"{number}: {name}: {done.stderr}"
    refused = done.returncode == 2 and len(lines) == 1 and lines[0].startswith("goniotwin: ")
    return None if done.returncode in (0, 1) or refused else f"{number}: {name}: status {done.returncode}: {done.stderr}"


def attempt_many(numbers: Sequence[int], originals: Path, folder: Path, report: Path) -> None:
    """In a child process: attempt mutations, and write the number of each, with what is wrong, before the next."""
    os.chdir(folder)
    with report.open("w", encoding="utf-8") as file:
        for number in numbers:
            print(json.dumps([number, "did not end"]), file=file, flush=True)
            print(json.dumps([number, attempt(number, originals, folder, MEMORY_BYTES)]), file=file, flush=True)
