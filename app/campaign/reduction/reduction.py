"""The reduction of a journal: its rows, in blocks, through the steps of pipeline.py."""

import contextlib
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.reading import DamagedJournal, JournalReader
from goniotwin.app.campaign.reduction.arc_geometry import MOST_POSES
from goniotwin.app.campaign.reduction.arc_rows import POSE, arcs_of_rows, etalon_places
from goniotwin.app.campaign.reduction.drift_checks import unchecked_photodiodes
from goniotwin.app.campaign.reduction.etalon import ReferenceSignals
from goniotwin.app.campaign.reduction.overlaps import Overlaps, overlap_check
from goniotwin.app.campaign.reduction.pipeline import finish_points, reduce_rows
from goniotwin.app.campaign.reduction.point_file import PointFile
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally
from goniotwin.app.campaign.reduction.readings import (
    Measurements,
    ReferenceMeasurements,
    RowTable,
    order_by_pose,
    order_by_setting,
    row_places,
)
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.reduction.settings import ReductionSettings, reduction_settings
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigDescription, parse_rig
from goniotwin.arrays import Ints

RESUME = "goniotwin run --resume measures them"


@dataclass(frozen=True)
class PointBlock:
    """Some of a sample's `points`: all points of one or more sets of wavelength, sigma and gamma.

    `rank` (n,) is the place of each point's row in order of time.
    """

    rank: Ints
    points: BsdfPoints


@dataclass(frozen=True)
class Reduction:
    """A journal during its reduction: what is common to all of it, and its points in blocks, which are not kept in memory.

    `etalon`, `second` and `signature` are the measurements of the etalon, of the second standard, if there is one, and of the
    instrument signature. Nothing of it changes while
    blocks are read: what depends on the points is computed from the tallies of all blocks.
    """

    journal: JournalReader
    rig: RigDescription
    schedule: ScheduleFile
    settings: ReductionSettings
    measurements: Measurements
    etalon: ReferenceMeasurements
    signature: ReferenceMeasurements
    second: ReferenceMeasurements | None = None

    def blocks(self, sample: str) -> Iterator[PointBlock]:
        """The points of a sample in the order of sigma, gamma, wavelength, half planes and time; not finished yet.

        A block has about as many rows as the journal's `sizes` state; that number changes no value. Raises UserError.
        """
        rows = self.journal.sizes.rows
        table = self.measurements.row_table(sample)
        order, settings, lights = order_by_setting(table)
        for begin, end in _together(lights, rows):
            edges = settings[(settings >= begin) & (settings <= end)] - begin
            places = order[begin:end]
            if np.unique(table["wavelength_nm"][places]).size > 1:
                yield from self._spectral_blocks(sample, table, places, edges)
            else:
                for first, last in _together(edges, self.journal.sizes.block):
                    cut = np.split(np.arange(first, last), range(rows, last - first, rows))
                    if found := list(self._reduced(sample, table, places, cut)):
                        at, points = zip(*found, strict=True)
                        yield PointBlock(places[np.concatenate(at)], BsdfPoints.join(list(points)))

    def _spectral_blocks(self, sample: str, table: RowTable, places: Ints, edges: Ints) -> Iterator[PointBlock]:
        """The blocks of rows at several wavelengths: reduced pose by pose, and put in a file until all of them are known."""
        sizes = self.journal.sizes
        by_pose, poses = order_by_pose(table[places])
        of_poses = row_places(table[places[by_pose[poses[:-1]]]])[:, POSE]
        if len(of_poses) <= MOST_POSES:  # together, and not a few for each part of the rows
            self.settings.geometry.views_at([tuple(each) for each in of_poses.tolist()])
        parts = (
            by_pose[k : min(k + sizes.of_pose, end)]
            for begin, end in _together(poses, sizes.rows // 2)
            for k in range(begin, end, sizes.of_pose)
        )
        with PointFile(Path(tempfile.gettempdir())) as file:
            for at, points in self._reduced(sample, table, places, parts):
                file.add(at, points)
            for first, last in _together(edges, sizes.block):
                if (found := file.between(first, last)) is not None:
                    yield PointBlock(places[found[0]], found[1])

    def points_of_rows(self, sample: str, places: Ints) -> BsdfPoints | None:
        """The points of some rows of a sample, by their indices in its table, not finished yet; None for none."""
        rows = self.journal.sizes.rows
        cut = np.split(np.arange(len(places)), range(rows, len(places), rows))
        found = [points for _, points in self._reduced(sample, self.measurements.row_table(sample), places, cut)]
        return BsdfPoints.join(found) if found else None

    def finish(self, sample: str, points: BsdfPoints, overlaps: Overlaps | None) -> BsdfPoints:
        """The BSDF of whole blocks of a sample, calibrated by its overlaps where asked for."""
        factors = overlaps.factors if self.settings.calibrates and overlaps is not None else None
        return finish_points(points, replace(self.settings, sample=sample, calibration=factors))

    def overlaps(self, sample: str) -> Overlaps | None:
        """The overlaps of a sample; None where its points are not calibrated by them.

        It reads all blocks once more. Raises UserError.
        """
        if not self.settings.calibrates:
            return None
        check = overlap_check(self.settings)
        for block in self.blocks(sample):
            check.add(block.points)
        return check.result()

    def unchecked(self, tallies: Mapping[str, Tally]) -> dict[str, tuple[int, ...]]:
        """By the mounted sample, the photodiodes that its drift checks do not cover, from the tallies of all blocks."""
        trusted = {name: tally.trusted for name, tally in tallies.items()}
        return unchecked_photodiodes(self.measurements.insensitive, trusted, self.schedule.standards)

    def _reduced(self, sample: str, table: RowTable, places: Ints, parts: Iterable[Ints]) -> Iterator[tuple[Ints, BsdfPoints]]:
        """The points of some rows at a time, each part a list of indices of `places`, and the index of each point's row."""
        settings = replace(self.settings, sample=sample)
        for here in parts:
            rows = self.measurements.rows_in_columns(table["number"][places[here]].tolist())
            if rows is None:
                continue
            views = arcs_of_rows(rows.places, self.settings.geometry)
            at_etalon = [etalon_places(rows.places[index], each) for index, each in views]
            etalon = self.etalon.at_places(np.concatenate(at_etalon))
            signature = self.signature.at_places(np.concatenate([rows.places, *at_etalon]))
            second = None if self.second is None else self.second.at_places(np.concatenate(at_etalon))
            reduced = reduce_rows(rows, ReferenceSignals(etalon, signature, second), settings)
            if reduced is not None:
                yield here[reduced[0]], reduced[1]


def begin_reduction(journal: JournalReader, *, without_damaged: bool = False) -> Reduction:
    """The reduction of a journal, by the settings that its files state.

    Raises UserError for a journal without readings of the etalon, and DamagedJournal for a damaged one, unless
    `without_damaged`: its damaged rows then have no values.
    """
    if journal.chain.damage and not without_damaged:
        raise DamagedJournal(
            f"{journal.path}: differs from what was measured: {journal.chain.damage}; {RESUME}; or use a copy of it, or "
            "export the rest with --without-damaged"
        )
    alignment = journal.optional_value("alignment")
    rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)", alignment)
    schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
    text = None if schedule.certificate is None else journal.value("certificate")
    name = f"{journal.path} (certificate)"
    settings = reduction_settings(rig.file, schedule, text, name, first_day(journal), alignment)
    settings = replace(settings, history=RowHistory(journal))
    measurements = Measurements(journal, schedule, rig.file)
    etalon = ReferenceMeasurements(measurements, schedule.etalon)
    if not len(etalon):
        raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
    signature = ReferenceMeasurements(measurements, NO_SAMPLE)
    second = None if settings.second is None else ReferenceMeasurements(measurements, settings.second.name)
    return Reduction(journal, rig, schedule, settings, measurements, etalon, signature, second)


def _together(edges: Ints, rows: int) -> Iterator[tuple[int, int]]:
    """Begin and end of ranges between edges, each of so many rows or, the last one, fewer."""
    begin = 0
    for end in edges[1:].tolist():
        if end > begin and (end - begin >= rows or end == edges[-1]):
            yield begin, end
            begin = end


def first_day(journal: JournalReader) -> date | None:
    """The day on which a campaign began; None where the journal does not have it."""
    for session in journal.sessions():
        with contextlib.suppress(ValueError):
            return date.fromisoformat(session.wall_started[:10])
    return None
