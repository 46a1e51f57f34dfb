"""A reduced journal: the values of all samples, in memory or in files, with all that has to be known of them."""

import contextlib
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.block_sizes import DEFAULT_SIZES, BlockSizes
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.reduction.metadata import journal_metadata
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.point_file import PointFile
from goniotwin.app.campaign.reduction.points import BsdfPoints, PointSource, Tally
from goniotwin.app.campaign.reduction.polarisation import light_words
from goniotwin.app.campaign.studies.checks import ConsistencyChecks
from goniotwin.app.campaign.studies.evaluation import Evaluation, evaluate_journal
from goniotwin.app.campaign.studies.notes import calibration_notes, light_lines, reduction_notes
from goniotwin.app.campaign.studies.symmetry import SymmetryResult
from goniotwin.app.formats.metadata import Metadata
from goniotwin.app.rig import RigDescription
from goniotwin.arrays import Ints

Keep = Callable[[str, Ints, BsdfPoints], None]
"""Takes points of a sample, with the place of each point's row in order of time."""


@dataclass(frozen=True)
class ReducedJournal:
    """The result of a reduction: points by sample, and whether they are simulated.

    By sample: `overlaps` is the agreement of photodiodes that measured the same direction, `symmetry` the test of the stated
    symmetry, for schedules that ask for it. `notes` are remarks on the reduction, for the reader of the values; `findings` are
    those of them that state what is wrong with the instrument. `unchecked` are, by the mounted sample, the photodiodes that its
    drift checks do not cover. `chain` states the journal's checksums, `light` the polarisation of the light: these notes belong
    to every file of values. `metadata` are those of each sample, for archives and reports. `isotropic`: the schedule states so;
    this alone decides, however many gammas were measured. `sizes` are those of parts in which the points are read.
    """

    name: str
    rig: RigDescription
    simulated: bool
    samples: Mapping[str, PointSource]
    overlaps: dict[str, Overlaps]
    notes: tuple[str, ...]
    symmetry: dict[str, SymmetryResult] = field(default_factory=dict)
    unchecked: dict[str, tuple[int, ...]] = field(default_factory=dict)
    chain: str = ""
    light: tuple[str, ...] = ()
    findings: tuple[str, ...] = ()
    metadata: Mapping[str, Metadata] = field(default_factory=dict)
    isotropic: bool = True
    sizes: BlockSizes = DEFAULT_SIZES


@dataclass(frozen=True)
class BsdfDataset(ReducedJournal):
    """The result of a reduction with all points in memory, by sample."""

    samples: dict[str, BsdfPoints]


def reduce_journal(journal: JournalReader, *, without_damaged: bool = False) -> BsdfDataset:
    """Reduce all samples of a journal; the campaign may be unfinished. Raises UserError as evaluate_journal does."""
    return reduce_to_memory(evaluate_journal(journal, without_damaged=without_damaged))


def reduce_to_memory(evaluation: Evaluation) -> BsdfDataset:
    """Reduce all samples of a journal that is already known. Raises UserError.

    The points are in temporary files meanwhile: joined in memory, the blocks of a long journal would take twice as much.
    """
    with _files(Path(tempfile.gettempdir())) as (files, keep):
        reduced = _reduce(evaluation, keep)
        samples = {}
        for name in list(files):
            with files.pop(name) as file:
                samples[name] = file.everything()
    return BsdfDataset(**{**vars(reduced), "samples": samples})


@contextlib.contextmanager
def reduce_to_files(journal: JournalReader, folder: Path, *, without_damaged: bool = False) -> Iterator[ReducedJournal]:
    """Reduce all samples of a journal of any length: the points are in temporary files in a folder, not in memory.

    Raises UserError as `reduce_journal`, and where the folder cannot hold the files.
    """
    with _files(folder) as (files, keep):
        reduced = _reduce(evaluate_journal(journal, without_damaged=without_damaged), keep)
        yield replace(reduced, samples=files)


@contextlib.contextmanager
def _files(folder: Path) -> Iterator[tuple[dict[str, PointFile], Keep]]:
    """Temporary files in a folder, by sample, and what adds points to them."""
    with contextlib.ExitStack() as stack:
        files: dict[str, PointFile] = {}

        def keep(name: str, rank: Ints, points: BsdfPoints) -> None:
            if name not in files:
                files[name] = stack.enter_context(PointFile(folder))
            files[name].add(rank, points)

        yield files, keep


def _reduce(evaluation: Evaluation, keep: Keep) -> ReducedJournal:
    """Reduce all samples of a journal block by block; `keep` takes the points, so that the result has none."""
    reduction = evaluation.reduction
    journal = reduction.journal
    overlaps, symmetry = {}, {}
    tallies: dict[str, Tally] = {}
    for name in reduction.schedule.samples:
        checks, of_sample = ConsistencyChecks(reduction, name), reduction.overlaps(name)
        for block in reduction.blocks(name):
            checks.add(block.points)
            points = reduction.finish(name, block.points, of_sample)
            tallies.setdefault(name, Tally()).add(points)
            keep(name, block.rank, points)
        if name in tallies:
            overlaps[name] = checks.overlaps()
            if (result := checks.symmetry()) is not None:
                symmetry[name] = result
    notes = reduction_notes(evaluation, tallies)
    notes += [f"symmetry of {name}: {result}" for name, result in symmetry.items()]
    notes += [f"overlaps of {name}: {note}" for name, each in overlaps.items() for note in calibration_notes(reduction, each)]
    return ReducedJournal(
        journal.value("name"),
        reduction.rig,
        journal.simulated,
        {},
        overlaps,
        tuple(notes),
        symmetry,
        reduction.unchecked(tallies),
        journal.chain.statement,
        tuple(light_lines(reduction, tallies)),
        tuple(evaluation.findings),
        {name: _metadata(evaluation, name, tally) for name, tally in tallies.items()},
        reduction.schedule.symmetry == "isotropic",
        journal.sizes,
    )


def _metadata(evaluation: Evaluation, sample: str, tally: Tally) -> Metadata:
    """The metadata of a sample's values, from the tally of all of its blocks."""
    reduction = evaluation.reduction
    sigmas = np.unique(reduction.measurements.row_table(sample)["sigma_deg"])
    return journal_metadata(
        reduction.journal,
        reduction.settings,
        sample,
        tally,
        polarisation=light_words(reduction.rig.file.light, sigmas),
        drift=[str(each) for each in reduction.measurements.drift_intervals],
        findings=evaluation.findings,
    )
