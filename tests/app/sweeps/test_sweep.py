"""Sweeps on this computer: the same bytes by any runner and after any interruption; files that are whole or not there."""

import json
import multiprocessing.spawn
import os
import shutil
import sys
from dataclasses import fields, replace
from multiprocessing import resource_tracker
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info

from goniotwin.app.cli.work.sweeps import runner_of
from goniotwin.app.errors import MissingPackage, UserError
from goniotwin.app.sweeps.chunk_files import ChunkFiles, pack
from goniotwin.app.sweeps.environment import Environment, check_alike, environment
from goniotwin.app.sweeps.runners import Here, Processes, on_this_computer
from goniotwin.app.sweeps.specification import Arrays, Specification, compute
from goniotwin.app.sweeps.sweep import run_sweep
from tests.app.sweeps.works import numbers, specification

CHUNKS = 5


def files_of(folder: Path, of: Specification | None = None, notes: list[str] | None = None) -> ChunkFiles:
    listed: list[str] = [] if notes is None else notes
    return ChunkFiles(folder, specification() if of is None else of, "--out", "schedule", listed.append)


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


def test_the_digest_changes_with_each_field() -> None:
    known = specification(a=1)
    others = {"work": "others", "version": 2, "size": 4, "seed": 8, "content": '{"a":2}'}
    assert set(others) == {each.name for each in fields(known)}
    digests = {replace(known, **{name: value}).digest for name, value in others.items()}  # type: ignore[arg-type]
    assert len({known.digest, *digests}) == 1 + len(others)
    assert specification(a=1).digest == known.digest
    assert Specification.of("numbers", 1, 3, 7, {"b": 1, "a": 2}) == Specification.of("numbers", 1, 3, 7, {"a": 2, "b": 1})


def test_chunks_have_so_many_items() -> None:
    known = specification(size=4)
    assert [*known.items(0), *known.items(1)] == list(range(8))
    assert [known.chunks(items) for items in (1, 4, 5, 8)] == [1, 1, 2, 2]


def test_an_item_has_its_random_numbers_in_any_chunk() -> None:
    one, three = (np.concatenate([numbers(specification(size=size), k)["values"] for k in range(6 // size)]) for size in (1, 3))
    assert np.array_equal(one, three)


@pytest.mark.long
@pytest.mark.parametrize("count", [2, 3], ids=lambda n: f"{n} processes")
def test_any_number_of_processes_gives_the_bytes_of_this_process(count: int, tmp_path: Path) -> None:
    for name, runner in (("here", Here()), ("there", Processes(count))):
        assert run_sweep(numbers, files_of(tmp_path / name), CHUNKS, runner) == {}
    assert contents(tmp_path / "here") == contents(tmp_path / "there")
    assert len(contents(tmp_path / "here")) == CHUNKS + 1


def test_an_interrupted_sweep_continues_and_has_the_bytes_of_one_run(tmp_path: Path) -> None:
    once = str(tmp_path / "once")
    interrupted = specification(interrupts=3, once=once)
    done: list[int] = []
    with pytest.raises(KeyboardInterrupt):
        run_sweep(numbers, files_of(tmp_path / "sweep", interrupted), CHUNKS, Here(), lambda count, _: done.append(count))
    assert done == [0, 1, 2, 3]
    assert sorted(contents(tmp_path / "sweep")) == [f"chunk-00000{k}.npz" for k in range(3)] + ["sweep.json"]
    run_sweep(numbers, files_of(tmp_path / "sweep", interrupted), CHUNKS, Here(), lambda count, _: done.append(count))
    assert done == [0, 1, 2, 3, 3, 4, 5]
    run_sweep(numbers, files_of(tmp_path / "one", interrupted), CHUNKS, Here())
    assert contents(tmp_path / "sweep") == contents(tmp_path / "one")


def test_a_sweep_is_extended(tmp_path: Path) -> None:
    files = files_of(tmp_path / "sweep")
    run_sweep(numbers, files, 2, Here())
    before = contents(tmp_path / "sweep")
    done: list[int] = []
    run_sweep(numbers, files, 4, Here(), lambda count, _: done.append(count))
    assert done == [2, 3, 4]
    assert before.items() < contents(tmp_path / "sweep").items()


def test_a_damaged_file_is_noted_and_its_chunk_computed_again(tmp_path: Path) -> None:
    notes: list[str] = []
    files = files_of(tmp_path / "sweep", notes=notes)
    run_sweep(numbers, files, 2, Here())
    whole = contents(tmp_path / "sweep")
    path = files.path(1)
    for place in (0, 40, 200, -1):
        changed = bytearray(whole[path.name])
        changed[place] ^= 1
        path.write_bytes(changed)
        assert files.read(1) is None
    for length in (0, 10, len(whole[path.name]) - 1):
        path.write_bytes(whole[path.name][:length])
        assert files.read(1) is None
    assert set(notes) == {f"{path}: is damaged; chunk 1 is computed again"}
    notes.clear()
    path.write_bytes(pack(compute(numbers, specification(), 0), specification().digest))
    assert files.read(1) is None
    path.write_bytes(pack(compute(numbers, specification(), 1), specification(seed=8).digest))
    run_sweep(numbers, files, 2, Here())
    assert notes == [f"{path}: is of another sweep, or another chunk; chunk 1 is computed again"] * 2
    assert contents(tmp_path / "sweep") == whole


def test_what_a_killed_program_has_left_is_removed(tmp_path: Path) -> None:
    files = files_of(tmp_path / "sweep")
    run_sweep(numbers, files, 1, Here())
    (tmp_path / "sweep" / ".123-456.tmp").write_bytes(b"half of a chunk")
    run_sweep(numbers, files, 1, Here())
    assert sorted(contents(tmp_path / "sweep")) == ["chunk-000000.npz", "sweep.json"]


def test_the_folder_of_another_sweep_and_of_other_files_is_refused(tmp_path: Path) -> None:
    run_sweep(numbers, files_of(tmp_path / "sweep"), 1, Here())
    with pytest.raises(UserError, match=r"sweep: has results of another schedule; choose another folder with --out, or delete"):
        run_sweep(numbers, files_of(tmp_path / "sweep", specification(seed=8)), 1, Here())
    (tmp_path / "sweep" / "sweep.json").write_text("{", encoding="utf-8")
    with pytest.raises(UserError, match=r"sweep\.json: is damaged; delete the folder"):
        run_sweep(numbers, files_of(tmp_path / "sweep"), 1, Here())
    with pytest.raises(UserError, match="is not empty, and no folder of a numbers; choose another one with --out"):
        run_sweep(numbers, files_of(tmp_path), 1, Here())
    (tmp_path / "file").touch()
    with pytest.raises(UserError, match="file: is a file; choose another folder with --out"):
        run_sweep(numbers, files_of(tmp_path / "file"), 1, Here())


def test_the_specification_is_in_the_folder_and_numpy_reads_the_chunks(tmp_path: Path) -> None:
    run_sweep(numbers, files_of(tmp_path), 1, Here())
    about = json.loads((tmp_path / "sweep.json").read_text(encoding="utf-8"))
    digest = about.pop("digest")
    assert digest == Specification(**{each.name: about[each.name] for each in fields(Specification)}).digest
    with np.load(tmp_path / "chunk-000000.npz") as archive:
        assert np.array_equal(archive["values"], numbers(specification(), 0)["values"])
        made = json.loads(str(archive["about"]))
    assert made == {"chunk": 0, "specification": digest, "computed with": environment().as_dict()}


def test_a_chunk_without_a_result_does_not_end_the_others(tmp_path: Path) -> None:
    failing = specification(fails=1)
    assert run_sweep(numbers, files_of(tmp_path, failing), 3, Here()) == {1: "the arc is in the beam"}
    assert sorted(contents(tmp_path)) == ["chunk-000000.npz", "chunk-000002.npz", "sweep.json"]


def test_other_versions_are_refused_in_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a folder's chunks, and of a worker that came later."""
    known = environment()
    for each in fields(Environment):
        other = replace(known, **{each.name: "9"})
        with pytest.raises(UserError) as refused:
            check_alike({"worker a": known, "worker b": known, "worker c": other}, "install the same versions")
        own = getattr(known, each.name)
        wrong = "worker a and worker c differ, and their results are not mixed"
        assert str(refused.value) == f"{wrong}: {each.name} {own} against 9; install the same versions"
    files = files_of(tmp_path)
    run_sweep(numbers, files, 1, Here())
    other = replace(known, numpy="9")
    monkeypatch.setattr("goniotwin.app.sweeps.runners.environment", lambda: other)
    with pytest.raises(UserError, match=r"this computer differ, .*: numpy .* against 9; .*another folder with --out"):
        run_sweep(numbers, files, 2, Here())

    class Late(Here):
        def environments(self) -> dict[str, Environment]:
            return {"worker a": known}

    monkeypatch.setattr("goniotwin.app.sweeps.specification.environment", lambda: other)
    with pytest.raises(UserError, match=r"chunk 1 differ, and their results are not mixed: numpy"):
        run_sweep(numbers, files, 2, Late())
    assert not files.path(1).exists()


def test_no_more_processes_than_chunks() -> None:
    assert [on_this_computer(given, chunks).title for given, chunks in ((1, 9), (4, 1), (4, 3), (4, 9))] == [
        "this process",
        "this process",
        "3 processes",
        "4 processes",
    ]


def test_the_environment_is_that_of_the_sources_and_the_processor() -> None:
    known = environment()
    assert known.goniotwin.count("(") == 1
    assert known.numpy == np.__version__
    own = known.processor.partition(" compiled for")[0]
    other = environment(compiled_for=("generic",))
    assert other.difference(known) == f"processor {own} compiled for generic against {known.processor}"
    assert environment(parts=("protocols",)).goniotwin != known.goniotwin


def test_linear_algebra_has_one_thread_in_a_chunk() -> None:
    """The number of threads decides in which order it adds; after the chunk it is what it was."""

    def threads(_specification: Specification, _chunk: int) -> Arrays:
        found = [each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas"]
        return {"threads": np.array(found)}

    before = threads(specification(), 0)["threads"]
    assert before.size
    assert set(compute(threads, specification(), 0).arrays["threads"].tolist()) == {1}
    assert np.array_equal(threads(specification(), 0)["threads"], before)


@pytest.mark.long
def test_a_process_that_is_killed_is_one_line_and_the_sweep_continues(tmp_path: Path) -> None:
    killing = specification(kills=3, once=str(tmp_path / "once"))
    files = files_of(tmp_path / "sweep", killing)
    with pytest.raises(UserError, match=r"a process of the numbers was ended from outside, .*; run the same command again"):
        run_sweep(numbers, files, 8, Processes(2))
    assert not files.path(3).exists()
    run_sweep(numbers, files, 8, Processes(2))
    run_sweep(numbers, files_of(tmp_path / "one", killing), 8, Here())
    assert contents(tmp_path / "sweep") == contents(tmp_path / "one")


@pytest.mark.skipif(os.name == "nt", reason="there is no program that ends at once")
def test_a_process_that_ends_while_it_starts_is_one_line() -> None:
    """With a specification that is longer than what a pipe holds, of which no process would read anything."""
    resource_tracker.ensure_running()  # a process of multiprocessing's own
    own = multiprocessing.spawn.get_executable()
    multiprocessing.set_executable(shutil.which("false") or "")
    try:
        with pytest.raises(UserError, match="was ended from outside"):
            list(Processes(1).run(numbers, specification(text="x" * 1_000_000), [0]))
    finally:
        multiprocessing.set_executable(own)


def test_without_dask_one_line_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.delitem(sys.modules, "goniotwin.app.sweeps.dask_cluster", raising=False)
    with pytest.raises(MissingPackage) as missing, runner_of((None, "tcp://127.0.0.1:8786"), 1):
        pass
    assert str(missing.value) == "--dask: dask is not installed; run pip install 'goniotwin[dask]'"
