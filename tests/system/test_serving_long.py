"""`goniotwin serve` with several clients that connect, disconnect and are killed: memory does not grow, the end is orderly."""

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
from tests.system.conftest import Serve, control_client
from tests.system.serve_clients import KINDS, TALKING, talk

SECONDS = float(os.environ.get("GONIOTWIN_SERVE_S", "600"))
WARM_UP, TAIL = 0.2, 0.8
"""Shares of the time. In the warm-up object pools fill and numba code is loaded; then memory is compared with the tail."""
KILL_EVERY_S = 3.0
MOST_GROWTH_KB = 2048
"""Fluctuation of the allocators. In ten minutes there are some 10,000 connections and 300,000 exchanges between the two times:
a leak of 0.2 kB in a connection, or of 7 bytes in an exchange, would be larger."""
SETTLED_S = 10.0
needs_proc = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="memory and descriptors are counted in /proc")


class Process:
    """The resources of a process."""

    def __init__(self, pid: int) -> None:
        self._folder = Path(f"/proc/{pid}")

    @property
    def memory_kb(self) -> int:
        """Resident memory, kB."""
        lines = (self._folder / "status").read_text(encoding="utf-8").splitlines()
        return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS"))

    @property
    def descriptors(self) -> int:
        """The number of open file descriptors."""
        return len(list((self._folder / "fd").iterdir()))

    @property
    def threads(self) -> int:
        """The number of threads."""
        return len(list((self._folder / "task").iterdir()))

    def settled(self, control: ControlClient, descriptors: int, threads: int) -> tuple[int, int]:
        """Descriptors and threads, when they are down to these, or after SETTLED_S."""
        clock = RealClock()
        while clock.now() < SETTLED_S and (self.descriptors > descriptors or self.threads > threads):
            control.do("state")
            clock.sleep_until(clock.now() + 0.01)
        return self.descriptors, self.threads


def addresses_of(lines: list[dict[str, Any]]) -> dict[str, list[str]]:
    """The addresses for each kind of client."""

    def of(device: str) -> list[str]:
        found = [line for line in lines if line["device"] == device]
        return [line["path"] if "path" in line else f"{line['host']}:{line['port']}" for line in found]

    def control() -> list[str]:
        token = next(line["token"] for line in lines if line["device"] == "control")
        return [f"{address}/{token}" for address in of("control")]

    converters = [line["device"] for line in lines if line["device"].startswith("adc-")]
    return {
        "tmcl": of("axes"),
        "cornerstone": of("mono"),
        "modbus": [address for name in converters for address in of(name)],
        "control": control(),
    }


def start_client(kind: str, seconds: float, addresses: list[str]) -> subprocess.Popen[str]:
    """Start a client in a process of its own; return when its first exchange is done."""
    process = subprocess.Popen(
        [sys.executable, "-m", "tests.system.serve_clients", kind, str(seconds), *addresses],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        cwd=REPOSITORY,
    )
    assert process.stdout is not None
    assert process.stdout.readline() == f"{TALKING}\n"
    return process


def kill_clients(addresses: dict[str, list[str]], seconds: float) -> Iterator[str]:
    """Start clients one after the other and kill each during an exchange; yield after each."""
    clock = RealClock()
    number = 0
    while clock.now() < seconds:
        kind = list(KINDS)[number % len(KINDS)]
        victim = start_client(kind, seconds, addresses[kind][number // len(KINDS) % len(addresses[kind]) :])
        clock.sleep_until(clock.now() + 0.01 * (number % 7))
        victim.kill()
        victim.communicate()
        number += 1
        yield kind
        clock.sleep_until(min(seconds, clock.now() + KILL_EVERY_S))


@pytest.mark.long
@needs_proc
def test_clients_that_disconnect_leave_no_descriptors_and_threads(serve: Serve) -> None:
    process, lines = serve(RIG)
    addresses = addresses_of(lines)
    served, control = Process(process.pid), control_client(lines)
    control.do("state")
    before = served.descriptors, served.threads
    with ThreadPoolExecutor() as threads:
        done = dict(zip(KINDS, threads.map(lambda kind: talk(kind, 2.0, addresses[kind]), KINDS), strict=True))
    for kind, each in done.items():
        assert each["connections"] > 2 * len(addresses[kind])
        assert each["disturbed"] == 0
    assert served.settled(control, *before) == before
    control.close()


@needs_proc
@pytest.mark.long
def test_memory_does_not_grow_in_ten_minutes_with_clients(serve: Serve, capsys: pytest.CaptureFixture[str]) -> None:
    """Ten minutes, or GONIOTWIN_SERVE_S seconds."""
    process, lines = serve(RIG)
    addresses = addresses_of(lines)
    served, control = Process(process.pid), control_client(lines)
    control.do("state")
    before = served.descriptors, served.threads
    clock = RealClock()
    clients = {kind: start_client(kind, SECONDS, addresses[kind]) for kind in KINDS}
    samples: list[tuple[float, int]] = []
    kills = 0
    for _ in kill_clients(addresses, SECONDS):
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
    for kind in KINDS:  # new clients are served as before
        assert talk(kind, 1.0, addresses[kind])["disturbed"] == 0
    control.close()
    check_orderly_end(process, lines, signal.SIGTERM)


@pytest.mark.long
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_the_end_is_orderly_during_exchanges_of_clients(serve: Serve, number: signal.Signals) -> None:
    process, lines = serve(RIG)
    addresses = addresses_of(lines)
    clients = [start_client(kind, 60.0, addresses[kind]) for kind in KINDS]
    check_orderly_end(process, lines, number)
    for each in clients:
        each.kill()
        each.communicate()


def check_orderly_end(process: subprocess.Popen[str], lines: list[dict[str, Any]], number: signal.Signals) -> None:
    """Check status 0, no traceback, and that ports and names are released."""
    process.send_signal(number)
    _, errors = process.communicate(timeout=30.0)
    assert process.returncode == 0
    assert "Traceback" not in errors
    for line in lines:
        if "port" in line:
            with socket.create_server((line["host"], line["port"])):
                pass
        else:
            assert not Path(line["path"]).is_symlink()
