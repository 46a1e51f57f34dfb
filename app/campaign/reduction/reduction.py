"""The reduction: from a journal's counts to the BSDF at each direction, with its standard uncertainty.

f = (sample over monitor) / (etalon over monitor) * f of the etalon's certificate (the paper's formula 1, in 1/sr), each
photodiode against itself. Where the instrument without a sample was measured in the same pose (its signature), that is
subtracted from both first. The uncertainty is from six parts: dark and noise, monitor, gain, signature, etalon, field; and of
a virtual rig whose light was traced, from the paths.

Formula 1 has no etalon for transmitted light. There the same photodiode is compared with what it sees of the etalon when
that is lit from the photodiode's own side, at 180 deg - sigma; where that was not measured, transmission has no scale and no
points. Nothing is subtracted from transmitted light: without a sample there is the beam itself.

What a campaign was to measure and has no values of, and angles that are in doubt, for whoever reads the rest.

What is said of the instrument's own light, its signature: what it has been subtracted from.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigmas_deg
from goniotwin.app.campaign.geometry.directions import arc_views
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.checks import Checks
from goniotwin.app.campaign.reduction.drift_checks import in_words, unwatched
from goniotwin.app.campaign.reduction.field_of_view import with_field
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints as BsdfPoints
from goniotwin.app.campaign.reduction.points import Tally, joined
from goniotwin.app.campaign.reduction.readings import Key, Listed, Measured, Measurements, References, in_settings, key_of
from goniotwin.app.campaign.reduction.row_points import row_points
from goniotwin.app.campaign.reduction.signals import tracing_error
from goniotwin.app.campaign.reduction.symmetry import Symmetrical
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.certificate import Certificate, constant, parse_certificate
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.arrays import Ints

GO_ON = "goniotwin run --resume measures them"


def missing(journal: JournalReader, without_etalon: Mapping[str, int]) -> Iterator[str]:
    """Notes: whether it is finished, rows that were skipped, axes whose encoders stood off, and rows `without_etalon`, by
    sample, that nothing scales.
    """
    done, of = journal.row_counts()
    skipped = journal.skipped_numbers()
    if done + len(skipped) < of:
        yield f"the campaign is not finished: {done} of {of} rows are done"
    if skipped:
        samples = Counter(row.sample for row in journal.planned_rows() if row.number in skipped)
        told = ", ".join(f"{count} of {sample}" for sample, count in samples.items())
        yield f"rows that were skipped for faults and have no values: {told}; {GO_ON}"
    yield from journal.event_texts("encoder")
    for sample, rows in without_etalon.items():
        yield f"{sample}: no values, or not all, in rows at whose poses the etalon was not measured: {rows}"


def subtracted(*, reflected: bool, scale: bool, known: float) -> list[str]:
    """A note, where it has been subtracted from anything: from reflected light, or from the etalon's that transmitted light is
    scaled by. Transmitted light itself is never freed of it: without a sample there is the beam. `known` is its relative
    uncertainty where a sample is.
    """
    light = [
        *(["reflected light"] if reflected else []),
        *(["the etalon's light that transmitted light is scaled by"] if scale else []),
    ]
    told = "the instrument's own light was measured without a sample and has been subtracted from"
    same = f"with a sample it is taken to be the same to {100.0 * known:.2g} %"
    return [f"{told} {' and from '.join(light)}; {same}"] if light else []


ROWS_AT_ONCE = 256
"""So many rows have some megabytes of points."""


@dataclass(frozen=True)
class Reduced:
    """What a journal comes to: points by sample, and whether they are simulated. `overlaps` say by sample how well photodiodes
    agree that saw the same direction, `symmetry` whether it has the one that is stated, where that is checked; `notes` what a
    reader has to know about how it was reduced; `unwatched`, by what was mounted, the photodiodes of which its drift checks
    could tell nothing.
    """

    name: str
    rig: RigDescription
    simulated: bool
    samples: dict[str, BsdfPoints]
    overlaps: dict[str, Overlaps]
    notes: tuple[str, ...]
    symmetry: dict[str, Symmetrical] = field(default_factory=dict)
    unwatched: dict[str, tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Block:
    """Some of a sample's `points`, all that there are of a wavelength, sigma and gamma; `rank` (n,) is the place of each one's
    row in time.
    """

    rank: Ints
    points: BsdfPoints


class Reduction:
    """A journal while it is reduced, as far as it goes: what belongs to all of it, and its points in blocks, of which nothing
    is kept. Raises UserError for one that has too little in it.
    """

    def __init__(self, journal: Journal) -> None:
        self.journal = journal
        self.rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)")
        self.schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
        self.certificate = _certificate(journal, self.schedule, self.rig)
        self._measurements = Measurements(journal, self.schedule, self.rig)
        self._etalon = References(self._measurements, self.schedule.etalon)
        if not len(self._etalon):
            raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
        self._signature = References(self._measurements, NO_SAMPLE)
        self.tallies: dict[str, Tally] = {}
        self._without_etalon: dict[str, int] = {}

    def blocks(self, sample: str, rows: int = ROWS_AT_ONCE) -> Iterator[Block]:
        """The points of a sample in the order of wavelength, sigma, gamma, half planes and time; of about so many rows at once,
        which changes no value. Raises UserError.
        """
        listed = self._measurements.listed(sample)
        order, edges = in_settings(listed)
        self.tallies.pop(sample, None)
        self._without_etalon.pop(sample, None)
        begin = 0
        for end in edges[1:].tolist():
            if end > begin and (end - begin >= rows or end == len(order)):
                if (block := self._block(sample, listed, order[begin:end])) is not None:
                    self.tallies.setdefault(sample, Tally()).add(block.points)
                    yield block
                begin = end

    def checks(self, sample: str) -> Checks:
        """What is to be given the blocks of a sample, and then knows whether it agrees with itself."""
        common = float(np.min(self.certificate.relative_uncertainty))
        return Checks(self.schedule, self.rig.file, self._measurements.listed(sample), common)

    @property
    def calibrates(self) -> bool:
        """Whether values are multiplied by what overlaps say of their photodiodes."""
        return self.schedule.overlap is not None and self.schedule.overlap.calibrate

    def finished(self, points: BsdfPoints, found: Overlaps | None) -> BsdfPoints:
        """Points of whole blocks as they are to be used, by what their sample's overlaps have come to."""
        calibrated = found.factors.applied(points) if self.calibrates and found is not None else points
        # After the overlaps: what the field does to a value it does to all photodiodes that see the direction.
        return with_field(calibrated, self.rig.file)

    def overlaps(self, sample: str, rows: int = ROWS_AT_ONCE) -> Overlaps | None:
        """Of a sample, if they are needed to finish its points: that takes all blocks once more. Raises UserError."""
        if not self.calibrates:
            return None
        checks = self.checks(sample)
        for block in self.blocks(sample, rows):
            checks.add(block.points)
        return checks.overlaps()

    def calibration_told(self, found: Overlaps) -> list[str]:
        """What is to be said of the factors that a sample's overlaps come to, where the schedule has overlaps on purpose."""
        return [] if self.schedule.overlap is None else list(found.factors.told(self.calibrates))

    def notes(self) -> list[str]:
        """What a reader has to know about how it was reduced; once all blocks have been made."""
        told = [*missing(self.journal, self._without_etalon), *(str(drift) for drift in self._measurements.drifts)]
        transmitted = any(tally.transmitted for tally in self.tallies.values())
        freed = any(tally.freed for tally in self.tallies.values())
        known = self.rig.file.sample_unit.signature_uncertainty
        told += subtracted(reflected=freed, scale=transmitted and self._signature.meets(self._etalon), known=known)
        if transmitted:
            told.append("transmitted light is scaled by what the same photodiode sees of the etalon lit from its own side")
        certificate = self.schedule.certificate
        if certificate is not None and certificate.accept_expired_by is not None:
            who = certificate.accept_expired_by
            told.append(f"the etalon's certificate holds until {certificate.expires}; {who} answers for it after that")
        if (traced := tracing_error(self.rig.file)) is not None:
            told.append(
                f"the light was traced by the forward estimator, to {traced:.2g} in the median, which the uncertainty has"
            )
        return told + [in_words(name, photodiodes) for name, photodiodes in self.unwatched().items()]

    def unwatched(self) -> dict[str, tuple[int, ...]]:
        """By what was mounted, the photodiodes of which its drift checks could tell nothing; once all blocks have been made."""
        trusted = {name: tally.trusted for name, tally in self.tallies.items()}
        return unwatched(self._measurements.unseen, trusted, self.schedule.etalon)

    def _block(self, sample: str, listed: Listed, places: Ints) -> Block | None:
        rows = list(self._measurements.of(listed["number"][places].tolist()))
        at_sample, at_etalon = _keys(self.rig, rows)
        etalon, signature = self._etalon.of(at_etalon), self._signature.of(at_sample + at_etalon)
        ranks, found = [], []
        for rank, each in zip(places.tolist(), rows, strict=True):
            arcs = row_points(self.rig, each, etalon, signature, self.certificate)
            for points in arcs:
                ranks.append(np.full(points.bsdf.size, rank))
                found.append(points)
            if not self._scales(each.row) <= etalon.keys():
                self._without_etalon[sample] = self._without_etalon.get(sample, 0) + 1
        return Block(np.concatenate(ranks), joined(found)) if found else None

    def _scales(self, row: Row) -> set[Key]:
        """Where the etalon was to be measured for a row."""
        assert row.pose is not None
        gamma, sigma, beta, shift = row.pose
        return {key_of(row, (gamma, there, beta, shift)) for there in etalon_sigmas_deg(self.schedule, sigma)}


def reduce_journal(journal: Journal) -> Reduced:
    """All samples of a journal, as far as it goes. Raises UserError for one that has too little in it."""
    reduction = Reduction(journal)
    samples, seen, verdicts = {}, {}, {}
    for name in reduction.schedule.samples:
        checks = reduction.checks(name)
        blocks = []
        for block in reduction.blocks(name):
            checks.add(block.points)
            blocks.append(block)
        if blocks:
            in_time = np.argsort(np.concatenate([block.rank for block in blocks]), kind="stable")
            seen[name] = checks.overlaps()
            samples[name] = reduction.finished(joined([block.points for block in blocks]), seen[name]).where(in_time)
            if (verdict := checks.symmetry()) is not None:
                verdicts[name] = verdict
    notes = reduction.notes()
    notes += [f"symmetry of {name}: {verdict}" for name, verdict in verdicts.items()]
    notes += [f"overlaps of {name}: {each}" for name, found in seen.items() for each in reduction.calibration_told(found)]
    told = (tuple(notes), verdicts, reduction.unwatched())
    return Reduced(journal.value("name"), reduction.rig, journal.simulated, samples, seen, *told)


def _certificate(journal: Journal, schedule: ScheduleFile, rig: RigDescription) -> Certificate:
    if schedule.certificate is not None:
        return parse_certificate(journal.value("certificate"), f"{journal.path} (certificate)")
    return constant(rig.file.etalon.radiance_factor, rig.file.etalon.relative_uncertainty)


def _keys(rig: RigDescription, rows: list[Measured]) -> tuple[list[Key], list[Key]]:
    """Where the rows were measured, and where their photodiodes have to have seen the etalon."""
    own, etalon = [], []
    for each in rows:
        assert each.row.pose is not None
        own.append(key_of(each.row, each.row.pose))
        etalon += [key_of(each.row, view.etalon_pose(each.row.pose)) for view in arc_views(rig.file, each.row.pose)]
    return own, etalon
