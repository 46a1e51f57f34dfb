"""Sweeps on the workers of a Dask cluster: the bytes of this process, whatever workers are lost or added."""

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from goniotwin.app.errors import UserError
from goniotwin.app.sweeps.dask_cluster import DaskCluster
from goniotwin.app.sweeps.runners import Here
from goniotwin.app.sweeps.specification import Specification
from goniotwin.app.sweeps.sweep import run_sweep
from tests.app.sweeps.clusters import Cluster, started_cluster
from tests.app.sweeps.test_sweep import contents, files_of
from tests.app.sweeps.works import numbers, specification
from tests.system.conftest import until

psutil = pytest.importorskip("psutil")

pytestmark = [pytest.mark.long, pytest.mark.skipif(sys.platform == "win32", reason="this system kills no single process")]
CHUNKS = 12


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[Cluster]:
    with started_cluster(tmp_path / "dask") as cluster:
        yield cluster


def serial(folder: Path, of: Specification, chunks: int = CHUNKS) -> dict[str, bytes]:
    run_sweep(numbers, files_of(folder, of), chunks, Here())
    return contents(folder)


def test_a_worker_that_is_killed_changes_no_byte(cluster: Cluster, tmp_path: Path) -> None:
    """Two workers; the one that computes chunk 5 is killed by it, and the other one computes that chunk."""
    killing = specification(kills=5, once=str(tmp_path / "once"))
    for _ in range(2):
        cluster.add_worker()
    with DaskCluster(cluster.address) as runner:
        until(lambda: len(runner.environments()) == 2)
        assert run_sweep(numbers, files_of(tmp_path / "dask-files", killing), CHUNKS, runner) == {}
        assert len(runner.environments()) == 1
    assert [process.poll() for process in cluster.processes].count(None) == 2  # the scheduler and a worker
    assert contents(tmp_path / "dask-files") == serial(tmp_path / "serial", killing)


def test_a_sweep_that_was_begun_on_a_cluster_is_continued_without_dask(cluster: Cluster, tmp_path: Path) -> None:
    cluster.add_worker()
    files = files_of(tmp_path / "sweep")

    def interrupt(done: int, _now: str) -> None:
        if done == 4:
            raise KeyboardInterrupt

    with DaskCluster(cluster.address) as runner, pytest.raises(KeyboardInterrupt):
        run_sweep(numbers, files, CHUNKS, runner, interrupt)
    assert 4 <= len(list(files.folder.glob("chunk-*.npz"))) < CHUNKS
    run_sweep(numbers, files, CHUNKS, Here())
    assert contents(tmp_path / "sweep") == serial(tmp_path / "serial", specification())


def test_workers_of_other_versions_are_refused(cluster: Cluster, tmp_path: Path) -> None:
    """One compiles its kernels for another kind of processor."""
    cluster.add_worker()
    cluster.add_worker(NUMBA_CPU_NAME="generic")
    with DaskCluster(cluster.address) as runner:
        until(lambda: runner.title == "2 workers")
        with pytest.raises(UserError, match=r"worker tcp://.* and worker tcp://.* differ, .*: processor .*generic.*; install"):
            run_sweep(numbers, files_of(tmp_path / "sweep"), CHUNKS, runner)
    assert sorted(contents(tmp_path / "sweep")) == ["sweep.json"]


def test_a_worker_that_comes_later_has_a_part_of_the_chunks(cluster: Cluster, tmp_path: Path) -> None:
    cluster.add_worker()

    def add(done: int, _now: str) -> None:
        if done == 2:
            cluster.add_worker()

    with DaskCluster(cluster.address) as runner:
        run_sweep(numbers, files_of(tmp_path / "sweep"), CHUNKS, runner, add)
        until(lambda: len(runner.environments()) == 2)
    assert contents(tmp_path / "sweep") == serial(tmp_path / "serial", specification())


def test_a_chunk_that_ends_all_workers_and_a_lost_scheduler_are_one_line(cluster: Cluster, tmp_path: Path) -> None:
    cluster.add_worker()

    def end(done: int, _now: str) -> None:
        if done == 3:
            cluster.scheduler.kill()

    with DaskCluster(cluster.address) as runner:
        with pytest.raises(
            UserError, match=r"--dask tcp://127\.0\.0\.1:\d+: .*; check the address, .* finished chunks are kept"
        ):
            run_sweep(numbers, files_of(tmp_path / "sweep"), CHUNKS, runner, end)
        address = cluster.address
    assert len(list((tmp_path / "sweep").glob("chunk-*.npz"))) >= 3
    with pytest.raises(UserError, match=r"--dask tcp://127\.0\.0\.1:\d+: .*; check the address"):
        DaskCluster(address).__enter__()


def test_a_local_cluster_gives_the_same_bytes_and_listens_on_the_loopback_interface_alone(tmp_path: Path) -> None:
    with DaskCluster("local", 2) as runner:
        until(lambda: len(runner.environments()) == 2)
        own = psutil.Process()
        listening = [
            each.laddr.ip
            for process in [own, *own.children(recursive=True)]
            for each in process.net_connections(kind="inet")
            if each.status == psutil.CONN_LISTEN
        ]
        assert len(listening) >= 3
        assert set(listening) == {"127.0.0.1"}
        run_sweep(numbers, files_of(tmp_path / "sweep"), CHUNKS, runner)
    assert contents(tmp_path / "sweep") == serial(tmp_path / "serial", specification())
    assert not [each for each in own.children(recursive=True) if "dask" in " ".join(each.cmdline())]


@pytest.mark.parametrize("address", ["nonsense", "", "tcp://[::1", "tcp://127.0.0.1"])
def test_an_address_that_is_none_is_refused_at_once(address: str) -> None:
    with pytest.raises(UserError, match=r"^--dask .*check the address, such as tcp://HOST:8786"), DaskCluster(address):
        pytest.fail("opened")


def test_processes_are_for_a_local_cluster_alone() -> None:
    with pytest.raises(UserError, match=r"--processes: is the number of workers of --dask local; leave it out"):
        DaskCluster("tcp://127.0.0.1:8786", 2)


def test_a_worker_without_goniotwin_is_refused_and_computes_nothing_if_it_comes_later(cluster: Cluster, tmp_path: Path) -> None:
    program = "import sys; sys.modules['goniotwin'] = None; from distributed.cli.dask_worker import main; main()"
    cluster.add_worker()

    def add(done: int, _now: str) -> None:
        if done == 2:
            cluster.add_worker(program)
            until(lambda: runner.title == "2 workers")

    with DaskCluster(cluster.address) as runner:
        run_sweep(numbers, files_of(tmp_path / "sweep"), 2 * CHUNKS, runner, add)
        assert contents(tmp_path / "sweep") == serial(tmp_path / "serial", specification(), 2 * CHUNKS)
        cluster.add_worker(program)  # Dask ends a worker that cannot load its task
        until(lambda: runner.title in ("2 workers", "3 workers"))
        wrong = r"worker tcp://.*: .*No module named 'goniotwin.*; install the same version of goniotwin on all workers"
        with pytest.raises(UserError, match=wrong):
            run_sweep(numbers, files_of(tmp_path / "refused"), CHUNKS, runner)
