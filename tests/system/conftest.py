"""A rig that another process serves."""

import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from goniotwin.mocks.control import ControlClient
from goniotwin.protocols.clock import RealClock
from tests.system.command_process import CommandProcess

MAIN = [sys.executable, "-m", "goniotwin"]
Served = tuple[subprocess.Popen[str], list[dict[str, Any]]]
Serve = Callable[..., Served]
"""Function that serves a rig file with further options; returns the process and the lines with its addresses."""
ForkedServe = Callable[..., list[dict[str, Any]]]
"""The same, and returns the lines alone."""


@pytest.fixture
def serve(tmp_path: Path) -> Iterator[Serve]:
    processes: list[subprocess.Popen[str]] = []

    def start(rig: Path, *options: object) -> Served:
        process = subprocess.Popen(
            [*MAIN, "serve", "--rig", str(rig), "--ptys", str(tmp_path / "ptys"), *map(str, options)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        processes.append(process)
        assert process.stdout is not None
        lines: list[dict[str, Any]] = []
        while not lines or lines[-1]["device"] != "control":
            lines.append(json.loads(process.stdout.readline()))
        return process, lines

    yield start
    for process in processes:
        process.kill()
        process.communicate()


@pytest.fixture
def forked_serve(tmp_path: Path) -> Iterator[ForkedServe]:
    """Serves from a process that has loaded the libraries already: where the subject is not the server."""
    processes: list[CommandProcess] = []

    def start(rig: Path, *options: object) -> list[dict[str, Any]]:
        process = CommandProcess(tmp_path, "serve", "--rig", rig, "--ptys", tmp_path / "ptys", *options)
        processes.append(process)
        until(lambda: not process.alive or '"control"' in "".join(process.output_lines[-1:]))
        assert process.alive, process.errors
        return [json.loads(line) for line in process.output_lines]

    yield start
    for process in processes:
        process.kill()


def until(condition: Callable[[], bool], period_s: float = 0.01) -> None:
    """Wait for a condition that another process fulfils, and leave the processor to that process."""
    clock = RealClock()
    while not condition():
        clock.sleep_until(clock.now() + period_s)


def at(lines: list[dict[str, Any]], device: str, key: str) -> dict[str, Any]:
    """The address line of a device that has `key`."""
    return next(line for line in lines if line["device"] == device and key in line)


def control_client(lines: list[dict[str, Any]]) -> ControlClient:
    """A client of the simulation control port."""
    line = at(lines, "control", "port")
    return ControlClient(line["port"], line["token"])
