"""A proof: a sweep whose chunks are rigs. Each is a whole campaign, its reduction, and the comparison with the truth."""

import json
import shutil
import tempfile
import weakref
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.planning.plan import NewPlan, make_plan
from goniotwin.app.campaign.proof.judgement import RigResult, judge
from goniotwin.app.campaign.proof.totals import Totals
from goniotwin.app.campaign.proof.virtual_rigs import DrawnRigs, run_with_wires
from goniotwin.app.campaign.reduction.settings import reduction_settings
from goniotwin.app.campaign.rehearsal.without_wires import run_without_wires
from goniotwin.app.campaign.schedule.file import ScheduleDescription, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription
from goniotwin.app.rig.described_twin import described_twin
from goniotwin.app.rig.embedding import embed_rig, embedded_rig
from goniotwin.app.sweeps.chunk_files import ChunkFiles, Note
from goniotwin.app.sweeps.runners import Runner
from goniotwin.app.sweeps.specification import Arrays, Specification
from goniotwin.app.sweeps.sweep import Report, run_sweep

RESULTS = 4
"""Version of the results: files of another one are not counted together."""
MOST_RIGS = 100_000
NAME = "the schedule"
"""Its name in the messages of another computer."""


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
        described = described_twin(self.rig, file.standard_factors, file.samples, {}).rig
        settings = reduction_settings(described.file, file, self.schedule.certificate, self.schedule.name)
        level = settings.certificate.level
        return DrawnRigs(described, file.etalon, level=level, years=settings.etalon_years, second=settings.second)

    @cached_property
    def plan(self) -> NewPlan:
        """The plan of all rigs. Raises UserError for what the rig cannot do."""
        return make_plan(self.schedule, self.drawn.rig(self.seeds[0]))

    def result(self, seed: int) -> RigResult:
        """The result of one rig: a whole campaign, its reduction, and the comparison with the truth. Raises UserError."""
        own = replace(self.plan, rig=self.drawn.rig(seed))
        with tempfile.TemporaryDirectory(prefix="goniotwin-proof-") as folder:
            path = Path(folder) / "rig.journal"
            (run_with_wires if self.wires else run_without_wires)(own, path)
            return judge(path, own)

    @cached_property
    def specification(self) -> Specification:
        """The sweep: chunk k is the rig with the k-th seed. Raises UserError for a sample's table that cannot be read."""
        schedule = {"text": self.schedule.text, "certificate": self.schedule.certificate}
        content = {"schedule": schedule, "rig": embed_rig(self.rig), "wires": self.wires}
        return Specification.of("proof", RESULTS, 1, self.seeds[0], content)

    def files(self, note: Note = lambda _: None) -> ChunkFiles:
        """The files of the results."""
        return ChunkFiles(
            self.folder, self.specification, "--out", "schedule, rig file, kind of proof or version of the results", note
        )

    def totals(self, files: ChunkFiles, failures: dict[int, str]) -> Totals:
        """The totals of all rigs, in the order of their seeds."""
        return Totals(list(self._results(files, failures)))

    def _results(self, files: ChunkFiles, failures: dict[int, str]) -> Iterable[RigResult]:
        for chunk, seed in enumerate(self.seeds):
            if chunk in failures:
                yield RigResult(seed, failed=failures[chunk])
            elif (computed := files.read(chunk)) is not None:
                yield unpacked(computed.arrays)


def prove(proof: Proof, runner: Runner, report: Report = lambda _done, _now: None, note: Note = lambda _: None) -> Totals:
    """Run all rigs that are not done yet, and give the totals; `report` receives the number of rigs that are done.

    Raises UserError, and KeyboardInterrupt after a Ctrl-C; every finished rig is kept.
    """
    _ = proof.plan  # refused before anything is written
    files = proof.files(note)
    failures = run_sweep(rig_of_chunk, files, proof.rigs, runner, report)
    return proof.totals(files, failures)


def rig_of_chunk(specification: Specification, chunk: int) -> Arrays:
    """The result of one rig of a proof, as the text of its JSON. Raises UserError where its campaign comes to no end."""
    return packed(_proof_of(specification).proof.result(specification.seed + chunk))


def unpacked(arrays: Arrays) -> RigResult:
    """The result of a rig of a chunk."""
    return RigResult.from_dict(json.loads(arrays["result"].tobytes()))


def packed(result: RigResult) -> Arrays:
    return {"result": np.frombuffer(json.dumps(result.as_dict()).encode(), np.uint8)}


class _EmbeddedProof:
    """The proof of a specification, with the folder of the tables of its samples, which ends with it."""

    def __init__(self, specification: Specification) -> None:
        data = specification.data
        folder = ""
        if data["rig"]["files"]:
            folder = tempfile.mkdtemp(prefix="goniotwin-tables-")
            weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        rig = embedded_rig(data["rig"], Path(folder))
        schedule = replace(parse_schedule(data["schedule"]["text"], NAME), certificate=data["schedule"]["certificate"])
        self.proof = Proof(schedule, rig, 1, Path(), data["wires"])


@lru_cache(maxsize=1)
def _proof_of(specification: Specification) -> _EmbeddedProof:
    """The proof whose rigs this process computes: plan and tables are made once."""
    return _EmbeddedProof(specification)
