"""What people wait for: the commands from their start to their end, each in a process of its own.

    python -m benchmarks.start [--json] [--rounds 5] [--against FOLDER] [--without-first-use]

help: `goniotwin --help`. check, rehearse: of quick.toml on the virtual rig. simulate: a Gaussian sample of 5 deg, three angles
of incidence. prove_rig: a rig of a proof of quick.toml through all wires, without the start (three rigs minus one, over two, in
one process). All of these are warm: a first run, which does not count, has compiled the kernels. first_use: `goniotwin demo`
with an empty folder of compiled code, once.

cpu_s is the CPU time of the process and of those that it starts, in user and system mode, wall_s the time until its end, both
in the median of the rounds; load is the machine's load average (1 min) before the runs, in the median. With `--against` the
same is measured of another checkout with its links (see the README), in turns with this one, work by work; cpu_ratio and
wall_ratio are the medians of the rounds' ratios, before over now.
"""

import argparse
import json
import os
import platform
import resource
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from benchmarks.versions import LINKS, add_options
from goniotwin import examples

CHECK = (str(examples.SCHEDULE), "--rig", str(examples.RIG))
WARM = {
    "help": ["--help"],
    "check": ["check", *CHECK],
    "rehearse": ["rehearse", *CHECK],
    "simulate": ["simulate", "--sample", "gaussian:width_deg=5", "--out", "simulated.ddr"],
}
PROVE = ["prove", *CHECK, "--processes", "1", "--out", "proof", "--rigs"]
PROVED = (3, 1)
FIRST_USE = "first_use"


@dataclass(frozen=True)
class Cost:
    """CPU and wall time of a command in s, and the load of the machine before it."""

    cpu_s: float
    wall_s: float
    load: float


def run_command(arguments: list[str], sources: Path | None, **environment: str) -> Cost:
    """The cost of a command, of other sources than these if there are any; in a new folder that is also its home."""
    with TemporaryDirectory() as folder:
        own = {**os.environ, **environment, "HOME": folder, "XDG_STATE_HOME": folder}
        if sources is not None:
            own["PYTHONPATH"] = str(sources)
        load = os.getloadavg()[0]
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        command = [sys.executable, "-m", "goniotwin", *arguments]
        done = subprocess.run(command, cwd=folder, env=own, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        wall_s, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
    if done.returncode:
        sys.exit(f"goniotwin {' '.join(arguments)}: status {done.returncode}: {done.stderr.strip()}")
    return Cost(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime, wall_s, load)


def run_work(name: str, sources: Path | None) -> Cost:
    """The cost of one of the works."""
    if name in WARM:
        return run_command(WARM[name], sources)
    if name == FIRST_USE:
        with TemporaryDirectory() as compiled:
            return run_command(["demo", "--out", "demo"], sources, NUMBA_CACHE_DIR=compiled)
    many, one = (run_command([*PROVE, str(rigs)], sources) for rigs in PROVED)
    between = PROVED[0] - PROVED[1]
    return Cost((many.cpu_s - one.cpu_s) / between, (many.wall_s - one.wall_s) / between, many.load)


def measure(rounds: int, first_use: bool, against: Path | None) -> Iterator[tuple[str, dict[str, float]]]:
    """The figures of each work."""
    checkouts = [None, against] if against is not None else [None]
    for name in (*WARM, "prove_rig", *([FIRST_USE] if first_use else [])):
        costs: list[list[Cost]] = []
        if name != FIRST_USE:
            for each in checkouts:
                run_command(WARM.get(name, [*PROVE, "1"]), each)
        for _ in range(1 if name == FIRST_USE else rounds):
            costs.append([run_work(name, each) for each in checkouts])
        figures = {}
        for prefix, column in zip(("", "before_"), zip(*costs, strict=True), strict=False):
            for key in ("cpu_s", "wall_s"):
                figures[prefix + key] = statistics.median(getattr(each, key) for each in column)
        figures["load"] = statistics.median(each.load for column in costs for each in column)
        if against is not None:
            figures["cpu_ratio"] = statistics.median(old.cpu_s / new.cpu_s for new, old in costs)
            figures["wall_ratio"] = statistics.median(old.wall_s / new.wall_s for new, old in costs)
        yield name, figures


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    add_options(parser, rounds=5)
    parser.add_argument("--without-first-use", action="store_true", help="without the compilation, the longest")
    options = parser.parse_args()
    against = None if options.against is None else options.against / LINKS
    works = {}
    with TemporaryDirectory() as compiled:
        os.environ["NUMBA_CACHE_DIR"] = compiled
        for name, figures in measure(options.rounds, not options.without_first_use, against):
            works[name] = figures
            if not options.json:
                print(f"{name:10}", "  ".join(f"{key} {value:.2f}" for key, value in figures.items()), flush=True)
    if options.json:
        machine = {"python": platform.python_version(), "machine": platform.machine(), "cores": os.cpu_count()}
        print(json.dumps({**machine, "rounds": options.rounds, "works": works}, indent=2))


if __name__ == "__main__":
    main()
