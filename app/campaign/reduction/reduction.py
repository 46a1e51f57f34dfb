"""The reduction: from a journal's counts to the BSDF at each direction, with its standard uncertainty.

Reflected light (the paper's formula 1): each photodiode's signal, a photocurrent over the monitor's current, is divided by the
signal of the same photodiode at the etalon, and multiplied by the certificate's BSDF, in 1/sr. Where the instrument signature
was measured in the same pose, without a sample, it is subtracted from both signals first. The uncertainty has six components:
dark readings and noise, monitor, gain, signature, etalon, field of view; and for a virtual rig with ray-traced light a seventh,
the Monte Carlo error.

Transmitted light: formula 1 has no etalon for it. The signal is divided by that of the same photodiode at the etalon lit from
the photodiode's own side, at 180 deg - sigma. Without such a measurement there is no scale, and there are no points. The
signature is not subtracted from transmitted light: without a sample it is the direct beam.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.geometry.arcs import arc_views, etalon_sigmas_deg
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.checks import CheckResults, ConsistencyChecks
from goniotwin.app.campaign.reduction.drift_checks import unchecked_note, unchecked_photodiodes
from goniotwin.app.campaign.reduction.field_of_view import add_field_uncertainty
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints as BsdfPoints
from goniotwin.app.campaign.reduction.points import Tally, join_points
from goniotwin.app.campaign.reduction.readings import (
    Measurements,
    PoseKey,
    ReferenceMeasurements,
    RowSignal,
    RowTable,
    order_by_setting,
    pose_key,
)
from goniotwin.app.campaign.reduction.row_points import row_points
from goniotwin.app.campaign.reduction.signals import tracing_error
from goniotwin.app.campaign.reduction.symmetry import SymmetryResult
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.certificate import Certificate, constant_certificate, parse_certificate
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.arrays import Ints

BLOCK_ROWS = 256
"""Rows in a block: their points take some megabytes."""
RESUME = "goniotwin run --resume measures them"


@dataclass(frozen=True)
class BsdfDataset:
    """The result of a reduction: points by sample, and whether they are simulated.

    By sample: `overlaps` is the agreement of photodiodes that measured the same direction, `symmetry` the test of the stated
    symmetry, for schedules that ask for it. `notes` are remarks on the reduction, for the reader of the values. `unchecked`
    are, by the mounted sample, the photodiodes that its drift checks do not cover.
    """

    name: str
    rig: RigDescription
    simulated: bool
    samples: dict[str, BsdfPoints]
    overlaps: dict[str, Overlaps]
    notes: tuple[str, ...]
    symmetry: dict[str, SymmetryResult] = field(default_factory=dict)
    unchecked: dict[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class PointBlock:
    """Some of a sample's `points`: all points of one or more sets of wavelength, sigma and gamma.

    `rank` (n,) is the place of each point's row in order of time.
    """

    rank: Ints
    points: BsdfPoints


class Reduction:
    """A journal during its reduction: what is common to all of it, and its points in blocks, which are not kept in memory.

    Raises UserError for a journal without readings of the etalon.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)")
        self.schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
        self.certificate = _certificate(journal, self.schedule, self.rig)
        self._measurements = Measurements(journal, self.schedule, self.rig)
        self._etalon = ReferenceMeasurements(self._measurements, self.schedule.etalon)
        if not len(self._etalon):
            raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
        self._signature = ReferenceMeasurements(self._measurements, NO_SAMPLE)
        self.tallies: dict[str, Tally] = {}
        self._without_etalon: dict[str, int] = {}

    def blocks(self, sample: str, rows: int = BLOCK_ROWS) -> Iterator[PointBlock]:
        """The points of a sample in the order of wavelength, sigma, gamma, half planes and time.

        A block has about `rows` rows; their number changes no value. Raises UserError.
        """
        table = self._measurements.row_table(sample)
        order, edges = order_by_setting(table)
        self.tallies.pop(sample, None)
        self._without_etalon.pop(sample, None)
        begin = 0
        for end in edges[1:].tolist():
            if end > begin and (end - begin >= rows or end == len(order)):
                if (block := self._block(sample, table, order[begin:end])) is not None:
                    self.tallies.setdefault(sample, Tally()).add(block.points)
                    yield block
                begin = end

    def checks(self, sample: str) -> ConsistencyChecks:
        """The consistency checks of a sample, before any of its points is added."""
        common = float(np.min(self.certificate.relative_uncertainty))
        return ConsistencyChecks(self.schedule, self.rig.file, self._measurements.row_table(sample), common)

    @property
    def calibrates(self) -> bool:
        """Whether the values are multiplied by the calibration factors of the overlaps."""
        return self.schedule.overlap is not None and self.schedule.overlap.calibrate

    def finish(self, points: BsdfPoints, overlaps: Overlaps | None) -> BsdfPoints:
        """Calibrate the points of whole blocks by their sample's overlaps, where asked for, and add the field's uncertainty."""
        calibrated = overlaps.factors.apply(points) if self.calibrates and overlaps is not None else points
        # After the calibration: the field has the same effect on all photodiodes that look in a direction.
        return add_field_uncertainty(calibrated, self.rig.file)

    def overlaps(self, sample: str, rows: int = BLOCK_ROWS) -> Overlaps | None:
        """The overlaps of a sample; None where its points are not calibrated by them.

        It reads all blocks once more. Raises UserError.
        """
        if not self.calibrates:
            return None
        checks = self.checks(sample)
        for block in self.blocks(sample, rows):
            checks.add(block.points)
        return checks.overlaps()

    def calibration_notes(self, overlaps: Overlaps) -> list[str]:
        """Notes on the calibration factors of a sample; none for a schedule without an overlap table."""
        return [] if self.schedule.overlap is None else list(overlaps.factors.sentences(self.calibrates))

    def notes(self) -> list[str]:
        """Remarks on the reduction, for the reader of the values; complete after the last block of the last sample."""
        notes = list(missing_notes(self.journal, self._without_etalon))
        notes += [str(interval) for interval in self._measurements.drift_intervals]
        transmitted = any(tally.transmitted for tally in self.tallies.values())
        subtracted = any(tally.signature_subtracted for tally in self.tallies.values())
        u_signature = self.rig.file.sample_unit.signature_uncertainty
        scale = transmitted and self._signature.meets(self._etalon)
        notes += signature_notes(reflected=subtracted, scale=scale, u_signature=u_signature)
        if transmitted:
            notes.append("transmitted light is scaled by the same photodiode's signal of the etalon, lit from its own side")
        certificate = self.schedule.certificate
        if certificate is not None and certificate.accept_expired_by is not None:
            person = certificate.accept_expired_by
            notes.append(f"the etalon's certificate is valid until {certificate.expires}; {person} accepted its use after that")
        if (error := tracing_error(self.rig.file)) is not None:
            notes.append(
                f"the light was traced by the forward estimator; median relative error {error:.2g}, included in the uncertainty"
            )
        return notes + [unchecked_note(name, photodiodes) for name, photodiodes in self.unchecked().items()]

    def unchecked(self) -> dict[str, tuple[int, ...]]:
        """By the mounted sample, the photodiodes that its drift checks do not cover; complete after the last block."""
        trusted = {name: tally.trusted for name, tally in self.tallies.items()}
        return unchecked_photodiodes(self._measurements.insensitive, trusted, self.schedule.etalon)

    def _block(self, sample: str, table: RowTable, places: Ints) -> PointBlock | None:
        rows = list(self._measurements.row_signals(table["number"][places].tolist()))
        at_sample, at_etalon = _keys(self.rig, rows)
        etalon, signature = self._etalon.at(at_etalon), self._signature.at(at_sample + at_etalon)
        ranks, parts = [], []
        for rank, each in zip(places.tolist(), rows, strict=True):
            for points in row_points(self.rig, each, etalon, signature, self.certificate):
                ranks.append(np.full(points.bsdf.size, rank))
                parts.append(points)
            if not self._etalon_keys(each.row) <= etalon.keys():
                self._without_etalon[sample] = self._without_etalon.get(sample, 0) + 1
        return PointBlock(np.concatenate(ranks), join_points(parts)) if parts else None

    def _etalon_keys(self, row: Row) -> set[PoseKey]:
        """Where the etalon has to be measured for a row."""
        assert row.pose is not None
        gamma, sigma, beta, shift = row.pose
        return {pose_key(row, (gamma, etalon, beta, shift)) for etalon in etalon_sigmas_deg(self.schedule, sigma)}


def reduce_journal(journal: Journal) -> BsdfDataset:
    """Reduce all samples of a journal; the campaign may be unfinished. Raises UserError if the etalon has not been measured."""
    reduction = Reduction(journal)
    samples, overlaps, symmetry = {}, {}, {}
    for name in reduction.schedule.samples:
        checks = reduction.checks(name)
        blocks = []
        for block in reduction.blocks(name):
            checks.add(block.points)
            blocks.append(block)
        if blocks:
            in_time = np.argsort(np.concatenate([block.rank for block in blocks]), kind="stable")
            overlaps[name] = checks.overlaps()
            samples[name] = reduction.finish(join_points([block.points for block in blocks]), overlaps[name]).where(in_time)
            if (result := checks.symmetry()) is not None:
                symmetry[name] = result
    notes = reduction.notes()
    notes += [f"symmetry of {name}: {result}" for name, result in symmetry.items()]
    notes += [f"overlaps of {name}: {note}" for name, each in overlaps.items() for note in reduction.calibration_notes(each)]
    return BsdfDataset(
        journal.value("name"), reduction.rig, journal.simulated, samples, overlaps, tuple(notes), symmetry,
        reduction.unchecked(),
    )  # fmt: skip


def check_journal(path: Path) -> CheckResults | None:
    """Evaluate the consistency checks of a journal, as far as it goes; None where its schedule asks for none."""
    try:
        with Journal.open(path) as journal:
            file = parse_schedule(journal.value("schedule"), f"{path} (schedule)").file
            if file.symmetry_check is None and file.overlap is None:
                return None
            reduction = Reduction(journal)
            results = CheckResults({}, {}, calibrated=reduction.calibrates)
            for name in file.samples:
                checks = reduction.checks(name)
                for block in reduction.blocks(name):
                    checks.add(block.points)
                results.add(name, checks)
            return results
    except UserError as error:
        return CheckResults({}, {}, str(error).removeprefix(f"{path}: "))


def missing_notes(journal: JournalReader, without_etalon: Mapping[str, int]) -> Iterator[str]:
    """Notes on what is missing: rows not yet measured, skipped rows, encoder deviations, and values without a scale.

    `without_etalon` is by sample the number of rows at whose poses the etalon was not measured.
    """
    done, of = journal.row_counts()
    skipped = journal.skipped_numbers()
    if done + len(skipped) < of:
        yield f"the campaign is not finished: {done} of {of} rows are done"
    if skipped:
        samples = Counter(row.sample for row in journal.planned_rows() if row.number in skipped)
        counts = ", ".join(f"{count} of {sample}" for sample, count in samples.items())
        yield f"rows skipped after faults, without values: {counts}; {RESUME}"
    yield from journal.event_texts("encoder")
    for sample, rows in without_etalon.items():
        yield f"{sample}: rows without all values, because the etalon was not measured at their poses: {rows}"


def signature_notes(*, reflected: bool, scale: bool, u_signature: float) -> list[str]:
    """A note on the subtraction of the instrument signature; none where it was not subtracted.

    It is subtracted from `reflected` light, and from the etalon's signal that is the `scale` of transmitted light. Transmitted
    light itself keeps it: without a sample there is the direct beam. `u_signature` is the relative standard uncertainty of the
    signature while a sample is mounted.
    """
    signals = [
        *(["reflected light"] if reflected else []),
        *(["the etalon's signal that scales transmitted light"] if scale else []),
    ]
    if not signals:
        return []
    return [
        f"the instrument signature (measured without a sample) has been subtracted from {' and from '.join(signals)}; "
        f"with a sample mounted it is taken as the same to {100.0 * u_signature:.2g} %"
    ]


def _certificate(journal: Journal, schedule: ScheduleFile, rig: RigDescription) -> Certificate:
    if schedule.certificate is not None:
        return parse_certificate(journal.value("certificate"), f"{journal.path} (certificate)")
    return constant_certificate(rig.file.etalon.radiance_factor, rig.file.etalon.relative_uncertainty)


def _keys(rig: RigDescription, rows: list[RowSignal]) -> tuple[list[PoseKey], list[PoseKey]]:
    """Where the rows were measured, and where their photodiodes need a signal of the etalon."""
    own, etalon = [], []
    for each in rows:
        assert each.row.pose is not None
        own.append(pose_key(each.row, each.row.pose))
        etalon += [pose_key(each.row, view.etalon_pose(each.row.pose)) for view in arc_views(rig.file, each.row.pose)]
    return own, etalon
