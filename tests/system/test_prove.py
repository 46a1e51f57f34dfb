"""A proof on several processes, or on a Dask cluster: Ctrl-C ends it in good order, kill -9 and a lost worker lose nothing.

The same command continues, and the files are those of a proof in one process that was never interrupted.
"""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.app.sweeps.clusters import Cluster, started_cluster
from tests.conftest import Writer
from tests.system.conftest import MAIN, until

psutil = pytest.importorskip("psutil")

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(sys.platform == "win32", reason="this system has no signal for one process alone"),
]


def test_an_interrupted_proof_continues(write_rig: Writer, write_schedule: Writer, tmp_path: Path) -> None:
    folder = tmp_path / "proof"
    options = ["--rigs", "12", "--without-wires", "--processes", "2", "--out", str(folder), "--json"]
    command = [*MAIN, "prove", str(write_schedule()), "--rig", str(write_rig()), *options]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    until(lambda: process.poll() is not None or any(folder.glob("chunk-*.npz")))
    process.send_signal(signal.SIGINT)
    out, errors = process.communicate(timeout=120)
    assert process.returncode == 130, errors
    assert out == ""
    assert f"to continue: the same command; finished rigs are in {folder}" in " ".join(errors.split())
    assert "Traceback" not in errors
    assert [each for each in folder.iterdir() if each.is_dir()] == []
    finished = {path: path.read_bytes() for path in folder.glob("chunk-*.npz")}
    assert 1 <= len(finished) < 12
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["rigs"] == 12
    assert result["failed"] == {}
    assert all(path.read_bytes() == content for path, content in finished.items())


RIGS = 8


def proof_command(schedule: Path, rig: Path, folder: Path, *options: str) -> list[str]:
    return [
        *MAIN,
        "prove",
        str(schedule),
        "--rig",
        str(rig),
        "--rigs",
        str(RIGS),
        "--without-wires",
        "--out",
        str(folder),
        "--json",
        *options,
    ]


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def run(command: list[str], **environment: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env={**os.environ, **environment}, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_a_proof_that_is_killed_again_and_again_has_the_files_of_one_run(
    write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """kill -9 of the whole session after each new file; whatever is left behind is removed by the next run."""
    schedule, rig, folder = write_schedule(), write_rig(), tmp_path / "killed"

    def finished() -> int:
        return len(list(folder.glob("chunk-*.npz")))

    def run_until_more(processes: int) -> None:
        before = finished()
        command = proof_command(schedule, rig, folder, "--processes", str(processes))
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        until(lambda: process.poll() is not None or finished() > before)
        assert process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    for processes in (1, 2, 1):
        run_until_more(processes)
    assert 3 <= finished() < RIGS
    result = run(proof_command(schedule, rig, folder))
    assert result == run(proof_command(schedule, rig, tmp_path / "one", "--processes", "1"))
    assert contents(folder) == contents(tmp_path / "one")


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with started_cluster(tmp_path / "dask") as cluster:
        yield cluster


def test_a_proof_on_two_workers_one_of_them_killed_is_the_serial_one(
    cluster: Cluster, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """The killed worker computes a rig at that moment; then Ctrl-C, and the rest without Dask."""
    schedule, rig, folder = write_schedule(), write_rig(), tmp_path / "dask-proof"
    workers = [cluster.add_worker() for _ in range(2)]
    command = proof_command(schedule, rig, folder, "--dask", cluster.address)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)

    def finished() -> int:
        return len(list(folder.glob("chunk-*.npz")))

    until(lambda: process.poll() is not None or finished() >= 2)
    workers[0].kill()
    out, errors = process.communicate(timeout=600)
    assert process.returncode == 0, errors
    assert workers[1].poll() is None
    assert "Traceback" not in errors
    one = run(proof_command(schedule, rig, tmp_path / "one", "--processes", "1"))
    assert out == one
    assert contents(folder) == contents(tmp_path / "one")

    folder = tmp_path / "interrupted"
    command = proof_command(schedule, rig, folder, "--dask", cluster.address)
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    until(lambda: process.poll() is not None or finished() >= 2)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=600)
    assert process.returncode == 130, errors
    assert f"to continue: the same command; finished rigs are in {folder}" in " ".join(errors.split())
    assert "Traceback" not in errors
    assert 2 <= finished() < RIGS
    assert run(proof_command(schedule, rig, folder, "--processes", "2")) == one
    assert contents(folder) == contents(tmp_path / "one")

    for name, options, environment in (
        ("local", ("--dask", "local", "--processes", "2"), {}),
        ("one thread", ("--processes", "1"), {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}),
    ):
        assert run(proof_command(schedule, rig, tmp_path / name, *options), **environment) == one
        assert contents(tmp_path / name) == contents(tmp_path / "one")


@pytest.mark.parametrize("name", ["SIGINT", "SIGKILL"])
def test_workers_of_this_computer_end_with_the_command(
    name: str, write_rig: Writer, write_schedule: Writer, tmp_path: Path
) -> None:
    """Ctrl-C reaches all processes of a terminal, and its only lines are those of the command."""
    folder, number = tmp_path / "proof", signal.Signals[name]
    command = proof_command(write_schedule(), write_rig(), folder, "--dask", "local", "--processes", "2")
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True)
    until(lambda: process.poll() is not None or any(folder.glob("chunk-*.npz")))
    workers = psutil.Process(process.pid).children(recursive=True)
    assert len(workers) >= 2
    if number == signal.SIGINT:
        os.killpg(process.pid, number)
    else:
        process.kill()
    _, errors = process.communicate(timeout=60)
    assert process.returncode == (130 if number == signal.SIGINT else -number)
    assert "Traceback" not in errors
    until(lambda: not any(each.is_running() and each.status() != psutil.STATUS_ZOMBIE for each in workers))
