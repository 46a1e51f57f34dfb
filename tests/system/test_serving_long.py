"""`goniotwin serve` with several clients at once, that come, go and are killed: nothing grows, and it ends as it should."""

import json
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from goniotwin.mocks.control import ControlClient
from goniotwin.protocols.clock import RealClock
from tests.conftest import REPOSITORY, RIG
from tests.system.conftest import Serve, at
from tests.system.serve_clients import KINDS, TALKING, talk

SECONDS = float(os.environ.get("GONIOTWIN_SERVE_S", "600"))
WARM_UP, TAIL = 0.2, 0.8
"""Parts of the time: before the first the pool of objects fills, numba's code is loaded; the last is compared with it."""
KILL_EVERY_S = 3.0
MOST_GROWTH_KB = 2048
"""What allocators need to breathe. In ten minutes there are some 10,000 connections and 300,000 exchanges between the two
times, so that 0.2 kB left behind by a connection, or 7 bytes by an exchange, would show."""
SETTLED_S = 10.0
needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="memory and descriptors are counted in /proc")


class Process:
    """What a process holds."""

    def __init__(self, pid: int) -> None:
        self._folder = Path(f"/proc/{pid}")

    @property
    def memory_kb(self) -> int:
        """Resident."""
        lines = (self._folder / "status").read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))

    @property
    def descriptors(self) -> int:
        """Open ones."""
        return len(list((self._folder / "fd").iterdir()))

    @property
    def threads(self) -> int:
        """Of its own and of its libraries."""
        return len(list((self._folder / "task").iterdir()))

    def settled(self, control: ControlClient, descriptors: int, threads: int) -> tuple[int, int]:
        """Descriptors and threads, once they are down to these or have had time for it."""
        clock = RealClock()
        while clock.now() < SETTLED_S and (self.descriptors > descriptors or self.threads > threads):
            control.do("state")
            clock.sleep_until(clock.now() + 0.01)
        return self.descriptors, self.threads


def places(lines: list[dict[str, Any]]) -> dict[str, list[str]]:
    """Where each kind of client finds what it talks to."""

    def of(device: str) -> list[str]:
        found = [line for line in lines if line["device"] == device]
        return [line["path"] if "path" in line else f"{line['host']}:{line['port']}" for line in found]

    converters = [line["device"] for line in lines if line["device"].startswith("adc-")]
    return {
        "tmcl": of("axes"),
        "cornerstone": of("mono"),
        "modbus": [place for name in converters for place in of(name)],
        "control": of("control"),
    }


def client(kind: str, seconds: float, where: list[str]) -> subprocess.Popen[str]:
    """In a process of its own, and talking."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.system.serve_clients", kind, str(seconds), *where],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, cwd=REPOSITORY,
    )  # fmt: skip
    assert process.stdout is not None
    assert process.stdout.readline() == f"{TALKING}\n"
    return process


def killed_in_turns(where: dict[str, list[str]], seconds: float) -> Iterator[str]:
    """Clients that die in the midst of an exchange, one after the other; yields after each."""
    clock = RealClock()
    number = 0
    while clock.now() < seconds:
        kind = list(KINDS)[number % len(KINDS)]
        victim = client(kind, seconds, where[kind][number // len(KINDS) % len(where[kind]) :])
        clock.sleep_until(clock.now() + 0.01 * (number % 7))
        victim.kill()
        victim.communicate()
        number += 1
        yield kind
        clock.sleep_until(min(seconds, clock.now() + KILL_EVERY_S))


@needs_proc
def test_clients_that_come_and_go_leave_nothing_behind(serve: Serve) -> None:
    process, lines = serve(RIG)
    where = places(lines)
    served, control = Process(process.pid), ControlClient(at(lines, "control", "port")["port"])
    control.do("state")
    before = served.descriptors, served.threads
    with ThreadPoolExecutor() as threads:
        done = dict(zip(KINDS, threads.map(lambda kind: talk(kind, 2.0, where[kind]), KINDS), strict=True))
    for kind, each in done.items():
        assert each["connections"] > 2 * len(where[kind])
        assert each["disturbed"] == 0
    assert served.settled(control, *before) == before
    control.close()


@needs_proc
@pytest.mark.long
def test_under_three_clients_for_ten_minutes_nothing_grows(serve: Serve, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten minutes, or GONIOTWIN_SERVE_S seconds."""
    process, lines = serve(RIG)
    where = places(lines)
    served, control = Process(process.pid), ControlClient(at(lines, "control", "port")["port"])
    control.do("state")
    before = served.descriptors, served.threads
    clock = RealClock()
    clients = {kind: client(kind, SECONDS, where[kind]) for kind in KINDS}
    samples: list[tuple[float, int]] = []
    kills = 0
    for _ in killed_in_turns(where, SECONDS):
        kills += 1
        samples.append((clock.now() / SECONDS, served.memory_kb))
        assert process.poll() is None
    done = {kind: json.loads(each.communicate(timeout=60.0)[0]) for kind, each in clients.items()}
    share, memory = np.array(samples).T
    early = float(np.median(memory[(share > WARM_UP) & (share < 2.0 * WARM_UP)]))
    late = float(np.median(memory[share > TAIL]))
    after = served.settled(control, *before)
    with capsys.disabled():
        print(f"\nserved for {SECONDS:g} s: {done}, {kills} clients killed")
        print(
            f"memory {early / 1024:.1f} MB after the warm-up, {late / 1024:.1f} MB at the end; "
            f"descriptors and threads {before} before, {after} after"
        )
    assert after == before
    assert late - early < MOST_GROWTH_KB
    for kind in KINDS:  # whoever comes now is served as if nothing had been
        assert talk(kind, 1.0, where[kind])["disturbed"] == 0
    control.close()
    ends_cleanly(process, lines, signal.SIGTERM)


@pytest.mark.parametrize("number", [signal.SIGTERM, pytest.param(signal.SIGINT, marks=pytest.mark.long)])
def test_it_ends_cleanly_in_the_midst_of_what_its_clients_say(serve: Serve, number: signal.Signals) -> None:
    process, lines = serve(RIG)
    where = places(lines)
    clients = [client(kind, 60.0, where[kind]) for kind in KINDS]
    ends_cleanly(process, lines, number)
    for each in clients:
        each.kill()
        each.communicate()


def ends_cleanly(process: subprocess.Popen[str], lines: list[dict[str, Any]], number: signal.Signals) -> None:
    """Status 0, nothing said but that it is over, ports and names free."""
    process.send_signal(number)
    _, said = process.communicate(timeout=30.0)
    assert process.returncode == 0
    assert "Traceback" not in said
    for line in lines:
        if "port" in line:
            with socket.create_server((line["host"], line["port"])):
                pass
        else:
            assert not Path(line["path"]).is_symlink()
