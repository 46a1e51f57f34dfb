"""Wild mutations of every kind of file, by seed, and how the command that reads the file ends."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import sqlite3
from pathlib import Path
from types import FrameType
from typing import Any

import h5py
import numpy as np

from goniotwin.app.formats import BsdfTable, registry, write_rayset
from goniotwin.app.formats.rayset import BLOCK, HEADING
from goniotwin.twin.optics.illumination.rayset import record
from goniotwin.twin.optics.illumination.unit import IlluminationUnit
from tests.conftest import REPOSITORY, RIG, SMALL
from tests.system.command import invoke

CPU_S = 10
MEMORY_BYTES = 1_000_000_000
EXTREMES = (
    "0", "-1", "1e300", "1e-300", "-1e24", "1e20", "1e-20", "nan", "-inf", "9e999", "9" * 5000, "0x" + "f" * 100, "2147483648",
    "18446744073709551616", "1_0", "true", '""', '"a"', "[]", "{}", "[[1]]", "{ start = 0, stop = 1e9, step = 1e-9 }",
    "1979-05-27", "[" * 400, "a" + ".a" * 9, "\x00", "\N{ZERO WIDTH SPACE}", '"' + "x" * 100_000 + '"', "'''", "1 2", ",", "=",
)  # fmt: skip
TEXTS = {"schedule.toml", "rig.toml", "certificate.csv", "table.ddr", "table.bsdf"}
COMMANDS: dict[str, list[str]] = {
    "schedule.toml": ["check", "schedule.toml", "--rig", "rig.toml", "--json"],
    "rig.toml": ["check", "schedule.toml", "--rig", "rig.toml", "--json"],
    "certificate.csv": ["check", "schedule.toml", "--rig", "rig.toml"],
    "table.ddr": ["check", "schedule.toml", "--rig", "ddr.toml"],
    "table.bsdf": ["check", "schedule.toml", "--rig", "bsdf.toml"],
    "finished.journal": ["export", "finished.journal", "--format", "csv", "--out", "points.csv"],
    "interrupted.journal": ["runs", ".", "--json"],
    "rays.h5": ["simulate", "--sample", "lambertian:reflectance=0.5", "--sigma", "0", "--estimator", "forward", "--paths", "1",
                "--source", "rays.h5", "--wavelength", "550", "--interval", "10", "--out", "simulated.ddr"],
}  # fmt: skip
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
        registry.write_table(path, table, registry.format_for(path, {registry.Holds.GRID}))
        sample = f'[twin.samples.table]\nmodel = "table"\nfile = "{path.name}"\n\n[twin.samples.etalon]'
        (folder / f"{suffix}.toml").write_text(rig.replace("[twin.samples.etalon]", sample), encoding="utf-8")
    for name in ("finished.journal", "interrupted.journal"):
        shutil.copy(REPOSITORY / "tests" / "golden" / "data" / name, folder)
    write_rayset(folder / "rays.h5", record(IlluminationUnit(), 20, seed=1))
    return changed


def mutate(name: str, path: Path, numbers: np.random.Generator) -> None:
    """Change a file: its parts, for the half of them, else its bytes."""
    for _ in range(int(numbers.integers(1, 4))):
        if numbers.random() < 0.5:
            _change_bytes(path, numbers)
        elif name in TEXTS:
            _change_words(path, numbers)
        elif name.endswith(".journal"):
            with contextlib.suppress(sqlite3.Error):
                _change_cell(path, numbers)
        else:
            with contextlib.suppress(OSError, KeyError, TypeError, ValueError, RuntimeError):
                _change_dataset(path, numbers)


def _change_bytes(path: Path, numbers: np.random.Generator) -> None:
    content = bytearray(path.read_bytes())
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
    path.write_bytes(content)


def _change_words(path: Path, numbers: np.random.Generator) -> None:
    lines = path.read_text(encoding="utf-8", errors="replace").split("\n")
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
    path.write_text("\n".join(lines), encoding="utf-8", errors="replace")


def _change_cell(path: Path, numbers: np.random.Generator) -> None:
    with contextlib.closing(sqlite3.connect(path)) as db, db:
        tables = [name for (name,) in db.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        table = tables[int(numbers.integers(len(tables)))]
        columns = [row[1] for row in db.execute(f"PRAGMA table_info({table})")]
        column = columns[int(numbers.integers(len(columns)))]
        values = (
            None,
            -1,
            0,
            2**63 - 1,
            1e300,
            "x" * 100_000,
            "",
            b"\xff" * 7,
            b"",
            "{}",
            "[" * 5000,
            "nan",
            1e-300,
            *EXTREMES,
        )
        value = values[int(numbers.integers(len(values)))]
        db.execute("PRAGMA ignore_check_constraints = ON")
        db.execute(f"UPDATE {table} SET {column} = ? WHERE rowid % 3 = ?", (value, int(numbers.integers(3))))


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


def attempt(number: int, originals: Path, folder: Path) -> str | None:
    """Run the command of one mutation in `folder`, which is the current one; return what is wrong with how it ends."""
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


def attempt_many(numbers: range, originals: Path, folder: Path, report: Path) -> None:
    """In a child process: attempt mutations, and write the number of each, with what is wrong, before the next."""
    import resource

    os.chdir(folder)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY_BYTES, MEMORY_BYTES))
    with report.open("w", encoding="utf-8") as file:
        for number in numbers:
            print(json.dumps([number, "did not end"]), file=file, flush=True)
            print(json.dumps([number, attempt(number, originals, folder)]), file=file, flush=True)
