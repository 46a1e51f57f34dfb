"""A sweep: the chunks that are not finished yet, by a runner, each written to its file as soon as it is done."""

import contextlib
from collections.abc import Callable

from goniotwin.app.sweeps.chunk_files import ChunkFiles
from goniotwin.app.sweeps.environment import Environment, check_alike
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Work

Report = Callable[[int, str], None]
"""Receives the number of finished chunks, and what computes, in words."""


def run_sweep(
    work: Work,
    files: ChunkFiles,
    chunks: int,
    runner: Runner,
    report: Report = lambda _done, _now: None,
) -> dict[int, str]:
    """Compute the first `chunks` chunks of a sweep that have no file yet; the reasons of those that have no result, by chunk.

    The results are then in `files`, to be read in the order of the chunks. All have the same versions and processor. Raises
    UserError, and KeyboardInterrupt after a Ctrl-C; every finished chunk is kept.
    """
    with files.opened():
        known: dict[str, Environment] = {}
        left = []
        for chunk in range(chunks):
            found = files.read(chunk)
            if found is None:
                left.append(chunk)
            else:
                _check(files, {**known, f"chunk {chunk}": found.environment})
                known = known or {f"the chunks in {files.folder}": found.environment}
        report(chunks - len(left), "")
        failures: dict[int, str] = {}
        if not left:
            return failures
        _check(files, {**known, **runner.environments()})
        done = chunks - len(left)
        with contextlib.closing(runner.run(work, files.specification, left)) as computed:
            for each in computed:
                if each is None:
                    report(done, runner.title)
                    continue
                # Of a worker that came later than the others, too.
                _check(files, {**known, f"chunk {each.chunk}": each.environment})
                known = known or {f"chunk {each.chunk}": each.environment}
                if each.failure:
                    failures[each.chunk] = each.failure
                else:
                    files.write(each)
                done += 1
                report(done, runner.title)
        return dict(sorted(failures.items()))


def _check(files: ChunkFiles, environments: dict[str, Environment]) -> None:
    remedy = f"use the same version and kind of computer, or another folder with {files.option}"
    check_alike(environments, remedy)
