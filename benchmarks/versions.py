"""What benchmarks of two versions share: their options, and the versions' turns.

The other version is the folder of a checkout with `goniotwin` under `.venv/links`, which `make` makes there.
"""

import argparse
import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parents[1]
LINKS = Path(".venv", "links")


def positive(text: str) -> int:
    """A number from 1 on, for argparse."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return number


def other_version(text: str) -> Path:
    """The folder of another version, for argparse."""
    folder = Path(text).resolve()
    if not (folder / LINKS / "goniotwin" / "__init__.py").exists():
        raise argparse.ArgumentTypeError(f"{folder / LINKS} has no goniotwin: run make in that folder first")
    return folder


def add_options(parser: argparse.ArgumentParser, rounds: int) -> None:
    """Add `--rounds` and `--against`."""
    parser.add_argument("--rounds", type=positive, default=rounds, help="number of runs of each version")
    parser.add_argument("--against", type=other_version, metavar="FOLDER", help="another version, in turns with this one")


def versions_of(against: Path | None) -> dict[str, Path]:
    """The folders of the versions, by `here` and `against`."""
    return {"here": HERE} | ({} if against is None else {"against": against})


def run_version(
    version: Path, program: str, *arguments: str, folder: Path | None = None, own: bool = False
) -> dict[str, float]:
    """Run a program with a version in a process of its own; the JSON of its last line.

    Benchmarks and tests are those here, or with `own` the version's.
    """
    links = version / LINKS
    paths = (str(links if links.is_dir() else version), str(version if own else HERE))
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(paths)}
    command = [sys.executable, "-P", "-c", program, *arguments]  # not the sources of this folder
    done = subprocess.run(command, cwd=folder, env=environment, stdout=subprocess.PIPE, text=True)
    if done.returncode:
        sys.exit(f"{version}: status {done.returncode}")  # its error is on standard error
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    return found


def in_turns(versions: dict[str, Path], rounds: int, program: str, *, own: bool = False) -> dict[str, list[dict[str, Any]]]:
    """The figures of a program in each round, by version; as in `run_version`."""
    found: dict[str, list[dict[str, Any]]] = {name: [] for name in versions}
    for _ in range(rounds):
        for name, version in versions.items():
            found[name].append(run_version(version, program, own=own))
    return found
