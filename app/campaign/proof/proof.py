"""A proof: rig after rig on all cores, each result in a small file of its own, so that a proof that was stopped continues."""

import contextlib
import hashlib
import json
import multiprocessing
import os
import signal
import tempfile
import threading
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing.connection import wait as wait_for
from pathlib import Path
from types import FrameType

from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.proof.judgement import RigResult, judge
from goniotwin.app.campaign.proof.totals import Totals
from goniotwin.app.campaign.proof.virtual_rigs import DrawnRigs, run_with_wires
from goniotwin.app.campaign.reduction.reduction import reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.errors import UserError, room_on_disk
from goniotwin.app.formats import FormatError
from goniotwin.app.formats.file import write_file
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.app.rig.lock import LockFile
from goniotwin.app.rig.model_hash import model_hash

ABOUT, LOCK = "proof.json", "proof.lock"
RESULTS = 2
"""Version of the results: files of another one are not counted together."""
MOST_RIGS = 100_000


@dataclass(frozen=True)
class Proof:
    """What a proof runs: a schedule on virtual rigs of a rig file, with or without wires, with its results in a folder."""

    schedule: ScheduleDescription
    rig: RigDescription
    rigs: int
    folder: Path
    wires: bool

    def __post_init__(self) -> None:
        if not 1 <= self.rigs <= MOST_RIGS:
            raise UserError(f"--rigs: {self.rigs} is not possible; give 1 to {MOST_RIGS}")

    @property
    def seeds(self) -> list[int]:
        """The seeds of the rigs: that of the file, and those that follow."""
        first = self.rig.seed or 0
        return list(range(first, first + self.rigs))

    @cached_property
    def drawn(self) -> DrawnRigs:
        """The virtual rigs. Raises UserError where the file describes no twin."""
        file = self.schedule.file
        described = described_twin(self.rig, file.etalon, file.samples, {}).rig
        settings = reduction_settings(described.file, file, self.schedule.certificate, self.schedule.name)
        level = settings.certificate.level
        return DrawnRigs(described, file.etalon, level=level, years=settings.etalon_years)

    @cached_property
    def plan(self) -> NewPlan:
        """The plan of all rigs. Raises UserError for what the rig cannot do."""
        return make_plan(self.schedule, self.drawn.rig(self.seeds[0]))

    def result(self, seed: int) -> RigResult:
        """The result of one rig: a whole campaign, its reduction, and the comparison with the truth."""
        try:
            own = replace(self.plan, rig=self.drawn.rig(seed))
            with tempfile.TemporaryDirectory(prefix="rig-", dir=self.folder) as folder:
                path = Path(folder) / "rig.journal"
                (run_with_wires if self.wires else run_without_wires)(own, path)
                return judge(path, own)
        except UserError as error:
            return RigResult(seed, failed=str(error))

    def prepare(self) -> None:
        """Make the folder, or check that it is of this proof. Raises UserError."""
        about = {"results": RESULTS, "wires": self.wires, "of": self._digest()}
        path = self.folder / ABOUT
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            if not path.exists():
                if any(self.folder.iterdir()):
                    raise UserError(f"{self.folder}: is not empty, and no folder of a proof; choose another one with --out")
                write_file(path, json.dumps(about).encode())
            elif json.loads(path.read_bytes()) != about:
                wrong = f"{self.folder}: has results of another schedule, rig file or kind of proof"
                raise UserError(f"{wrong}; choose another folder with --out, or delete this one")
        except (OSError, FormatError) as error:
            remedy = room_on_disk(error) if isinstance(error, OSError) else ""
            reason = "is a file" if isinstance(error, FileExistsError) else f"cannot be used: {error}"
            raise UserError(f"{self.folder}: {reason}; {remedy or 'choose another folder with --out'}") from None
        except ValueError:
            raise UserError(f"{path}: is damaged; delete the folder, or choose another one with --out") from None

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """The folder, which is prepared, is locked. Raises UserError where another program runs a proof in it."""
        try:
            lock = LockFile(self.folder / LOCK, str(self.folder), "proof", 0o644)
        except OSError as error:
            raise UserError(f"{self.folder}: cannot be used: {error.strerror}; choose another folder with --out") from None
        try:
            yield
        finally:
            lock.release(remove=True)

    def _digest(self) -> str:
        model = self.drawn.rig(self.seeds[0]).model()  # with the tables of its samples
        assert model is not None
        texts = (
            self.schedule.text,
            self.schedule.certificate or "",
            self.rig.text,
            self.rig.alignment or "",
            model_hash(model),
        )
        return hashlib.sha256("\0".join(texts).encode()).hexdigest()

    def file(self, seed: int) -> Path:
        """The file of a rig's result."""
        return self.folder / f"rig-{seed:06d}.json"

    def read(self, seed: int) -> RigResult | None:
        """The result of a rig that is done; None for one that is not, that failed, or whose file is not whole."""
        try:
            result = RigResult.from_dict(json.loads(self.file(seed).read_bytes()))
        except (OSError, ValueError, TypeError, KeyError, AttributeError):
            return None
        return None if result.failed else result

    def keep(self, result: RigResult) -> None:
        """Write a result: under another name first, so that a file under its own name is whole. Raises UserError."""
        path = self.file(result.seed)
        spare = path.with_suffix(".part")
        try:
            spare.write_text(json.dumps(result.as_dict()), encoding="utf-8")
            spare.replace(path)
        except OSError as error:
            raise UserError(
                f"{path}: cannot be written: {error.strerror}; {room_on_disk(error) or 'check the folder'}"
            ) from None


def prove(proof: Proof, processes: int | None = None, report: Callable[[int], None] = lambda _: None) -> Totals:
    """Run all rigs that are not done yet, and give the totals; `report` receives the number of rigs that are done.

    `processes`: how many at once, all cores by default; 1 is this process itself. Raises UserError, and KeyboardInterrupt after
    a Ctrl-C, when no process is left and every finished rig is kept.
    """
    _ = proof.plan  # refused before anything is written
    proof.prepare()
    with proof.locked():
        return _prove(proof, processes, report)


def _prove(proof: Proof, processes: int | None, report: Callable[[int], None]) -> Totals:
    results = {seed: result for seed in proof.seeds if (result := proof.read(seed)) is not None}
    left = [seed for seed in proof.seeds if seed not in results]
    report(len(results))
    count = min(processes or os.cpu_count() or 1, len(left))
    found = _here(proof, left) if count <= 1 else _in_processes(proof, left, count)
    with contextlib.closing(found):
        for result in found:
            proof.keep(result)
            results[result.seed] = result
            report(len(results))
    return Totals([results[seed] for seed in proof.seeds])


def _here(proof: Proof, seeds: list[int]) -> Generator[RigResult]:
    for seed in seeds:
        yield proof.result(seed)


def _in_processes(proof: Proof, seeds: list[int], count: int) -> Generator[RigResult]:
    """The results as they are done. At the end, and at a Ctrl-C, the processes are ended: a rig takes some seconds."""
    context = multiprocessing.get_context("spawn")  # a fork would copy the locks of other threads
    schedule, rig = proof.schedule, proof.rig
    texts = (schedule.text, schedule.name, schedule.certificate), (rig.text, rig.folder, rig.name, rig.alignment)
    arguments = (*texts, proof.rigs, proof.folder, proof.wires)
    pool = ProcessPoolExecutor(count, mp_context=context, initializer=_begin, initargs=arguments)
    waiting, running = iter(seeds), set[Future[RigResult]]()
    try:
        while True:
            for seed in waiting:
                running.add(pool.submit(_result, seed))
                if len(running) >= 2 * count:
                    break
            if not running:
                return
            done, running = wait(running, return_when=FIRST_COMPLETED)
            for each in done:
                yield each.result()
    except BrokenProcessPool:
        raise UserError("a process of the proof was ended from outside, for want of memory perhaps; run it again") from None
    finally:
        pool.shutdown(wait=False, cancel_futures=True)
        if running:
            for process in multiprocessing.active_children():
                process.terminate()  # an interrupt there: see `_Worker`
        pool.shutdown(wait=True)


class _Worker:
    """The proof of a process. An end signal stops the campaign that runs, in order, and all that would follow."""

    proof: Proof
    stopped = False
    busy = False

    @classmethod
    def stop(cls, _signal: int, _frame: FrameType | None) -> None:
        """Handle the end signal: no exception in the midst of the pool's own work."""
        cls.stopped = True
        if cls.busy:
            raise KeyboardInterrupt


def _begin(
    schedule: tuple[str, str, str | None], rig: tuple[str, Path, str, str | None], rigs: int, folder: Path, wires: bool
) -> None:
    """Prepare a process: texts, because the classes of a rig's tables are made while the program runs.

    A Ctrl-C is the parent's business; after its death the process ends at once.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, _Worker.stop)
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_end_with, args=(parent.sentinel,), daemon=True).start()
    parsed = replace(parse_schedule(*schedule[:2]), certificate=schedule[2])
    _Worker.proof = Proof(parsed, parse_rig(*rig), rigs, folder, wires)


def _end_with(sentinel: int) -> None:
    wait_for([sentinel])
    os._exit(1)


def _result(seed: int) -> RigResult:
    _Worker.busy = True
    try:
        if _Worker.stopped:
            raise KeyboardInterrupt
        return _Worker.proof.result(seed)
    finally:
        _Worker.busy = False
