"""The reduction of a journal: its rows, in blocks, through the steps of pipeline.py; and notes for the reader of the values."""

import contextlib
import math
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import date
from functools import partial
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigmas_deg
from goniotwin.app.campaign.geometry.open_beam import scan_wavelength_nm
from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.reading import USE_A_COPY, DamagedJournal, JournalReader
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.measurement_model.pose import mounting_inputs, rig_inputs
from goniotwin.app.campaign.reduction.alignment import (
    TERMS,
    AlignmentResult,
    LobeFit,
    alignment_file,
    estimate_alignment,
    fit_lobe,
    lobe_points,
)
from goniotwin.app.campaign.reduction.checks import CheckResults, ConsistencyChecks
from goniotwin.app.campaign.reduction.closure import ClosureReport, ScannedBeam, journal_closure
from goniotwin.app.campaign.reduction.drift_checks import DriftInterval, unchecked_note, unchecked_photodiodes
from goniotwin.app.campaign.reduction.etalon import (
    MOST_POSES,
    POSE,
    ArcGeometry,
    ReductionSettings,
    ReferenceSignals,
    arcs_of_rows,
    etalon_places,
)
from goniotwin.app.campaign.reduction.evidence import SignalEvidence
from goniotwin.app.campaign.reduction.light_search import LightSeen, Shares
from goniotwin.app.campaign.reduction.metadata import journal_metadata
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.pipeline import finish_points, reduce_rows
from goniotwin.app.campaign.reduction.point_file import PointFile
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints, PointSource, Tally, join_points
from goniotwin.app.campaign.reduction.polarisation import light_words
from goniotwin.app.campaign.reduction.reading_inputs import monitor_variance
from goniotwin.app.campaign.reduction.readings import (
    Measurements,
    ReferenceMeasurements,
    RowTable,
    order_by_pose,
    order_by_setting,
    repeats,
    row_places,
)
from goniotwin.app.campaign.reduction.row_history import RowHistory
from goniotwin.app.campaign.reduction.signals import tracing_error
from goniotwin.app.campaign.reduction.spectrum import NO_BAND, NO_SLOPE
from goniotwin.app.campaign.reduction.symmetry import SymmetryResult
from goniotwin.app.campaign.reduction.watch import Misalignment, WatchResult, find_misalignment
from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.certificate import constant_certificate, parse_certificate
from goniotwin.app.campaign.schedule.file import ScheduleFile, parse_schedule
from goniotwin.app.errors import UserError
from goniotwin.app.formats.metadata import Metadata
from goniotwin.app.rig import RigDescription, RigFile, nominal_instrument, parse_rig
from goniotwin.app.rig.alignment import (
    REFUSED_CHI_SQUARE,
    AlignmentFile,
    parse_alignment,
    refused_residuals,
)
from goniotwin.app.rig.inputs import ETALON_AGE, REPEATABILITY
from goniotwin.arrays import Floats, Ints
from goniotwin.protocols.clock import calendar_stamp
from goniotwin.twin.optics.geometry.coordinates import round_deg
from goniotwin.twin.optics.geometry.field import scale_field

BLOCK_ROWS = 256
"""Rows in a block, and rows whose signals are in memory together: they take some megabytes."""
MOST_ROWS = 4096
"""Rows of one pose that are reduced together, each at another wavelength."""
ASSUMED_YEARS = 1.0
"""Age of an etalon whose calibration has no date."""
RESUME = "goniotwin run --resume measures them"


@dataclass(frozen=True)
class ReducedJournal:
    """The result of a reduction: points by sample, and whether they are simulated.

    By sample: `overlaps` is the agreement of photodiodes that measured the same direction, `symmetry` the test of the stated
    symmetry, for schedules that ask for it. `notes` are remarks on the reduction, for the reader of the values; `findings` are
    those of them that state what is wrong with the instrument. `unchecked` are, by the mounted sample, the photodiodes that its
    drift checks do not cover. `chain` states the journal's checksums, `light` the polarisation of the light: these notes belong
    to every file of values. `metadata` are those of each sample, for archives and reports. `isotropic`: the schedule states so;
    this alone decides, however many gammas were measured.
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


@dataclass(frozen=True)
class BsdfDataset(ReducedJournal):
    """The result of a reduction with all points in memory, by sample."""

    samples: dict[str, BsdfPoints]


Keep = Callable[[str, Ints, BsdfPoints], None]
"""Takes points of a sample, with the place of each point's row in order of time."""


@dataclass(frozen=True)
class PointBlock:
    """Some of a sample's `points`: all points of one or more sets of wavelength, sigma and gamma.

    `rank` (n,) is the place of each point's row in order of time.
    """

    rank: Ints
    points: BsdfPoints


class Reduction:
    """A journal during its reduction: what is common to all of it, and its points in blocks, which are not kept in memory.

    Nothing of it changes while blocks are read: what depends on the points is computed from the tallies of all blocks. Raises
    UserError for a journal without readings of the etalon, and DamagedJournal for a damaged one, unless `without_damaged`: its
    damaged rows then have no values.
    """

    def __init__(self, journal: JournalReader, *, without_damaged: bool = False) -> None:
        if journal.chain.damage and not without_damaged:
            raise DamagedJournal(
                f"{journal.path}: differs from what was measured: {journal.chain.damage}; {RESUME}; or use a copy of it, or "
                "export the rest with --without-damaged"
            )
        self.journal = journal
        alignment = journal.optional_value("alignment")
        self.rig = parse_rig(journal.value("rig"), Path(), f"{journal.path} (rig)", alignment)
        self.schedule = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file
        text = None if self.schedule.certificate is None else journal.value("certificate")
        name = f"{journal.path} (certificate)"
        settings = reduction_settings(self.rig.file, self.schedule, text, name, _first_day(journal), alignment)
        self.settings = replace(settings, history=RowHistory(journal))
        self._measurements = Measurements(journal, self.schedule, self.rig.file)
        self._etalon = ReferenceMeasurements(self._measurements, self.schedule.etalon)
        if not len(self._etalon):
            raise UserError(f"{journal.path}: the etalon has not been measured yet, so there is nothing to compare with")
        self._signature = ReferenceMeasurements(self._measurements, NO_SAMPLE)
        self._repeats = repeats(self._measurements, self.schedule.samples, 0.5 * monitor_variance(self.rig.file))
        table = self.rig.file.uncertainty
        if self._repeats is not None and self._repeats.excess > table.u(REPEATABILITY):
            measured = table.measured(REPEATABILITY, self._repeats.excess, "the repeats of this campaign")
            self.settings = replace(self.settings, rig=replace(self.settings.rig, uncertainty=measured))
        self._closure: ClosureReport | None = None
        if self.schedule.open_beam_scan is not None:
            self.settings = scan_settings(self.settings, self.closure())
        self._of_file = self.settings.alignment
        self._aligned: AlignmentResult | None = None
        self._not_aligned = _why_not_aligned(alignment)
        if self.schedule.align is not None:
            self._align_itself(self.schedule.align)

    def _align_itself(self, sample: str) -> None:
        """Align the campaign on one of its samples, as far as that was measured."""
        try:
            self._aligned = self.align(sample, self.settings.alignment)
        except DamagedJournal:
            raise
        except UserError as error:
            self._not_aligned = f"not aligned: {str(error).removeprefix(f'{self.journal.path}: ')}"
        else:
            self.settings = replace(self.settings, alignment=self._aligned.with_photodiodes)

    def closure(self) -> ClosureReport:
        """The closure of the etalon's scale with that of the open beam. Raises UserError."""
        if self._closure is None:
            try:
                self._closure = journal_closure(self.settings, self._measurements, self._etalon, self._signature)
            except ValueError as error:  # the schedule and the rig file in the journal were not planned together
                raise UserError(f"{self.journal.path} (schedule): {error}") from None
        return self._closure

    def blocks(self, sample: str, rows: int = BLOCK_ROWS) -> Iterator[PointBlock]:
        """The points of a sample in the order of sigma, gamma, wavelength, half planes and time; not finished yet.

        A block has about `rows` rows; their number changes no value. Raises UserError.
        """
        table = self._measurements.row_table(sample)
        order, settings, lights = order_by_setting(table)
        for begin, end in _together(lights, BLOCK_ROWS):
            edges = settings[(settings >= begin) & (settings <= end)] - begin
            places = order[begin:end]
            if np.unique(table["wavelength_nm"][places]).size > 1:
                yield from self._spectral_blocks(sample, table, places, edges, rows)
            else:
                for first, last in _together(edges, rows):
                    cut = np.split(np.arange(first, last), range(BLOCK_ROWS, last - first, BLOCK_ROWS))
                    if found := list(self._reduced(sample, table, places, cut)):
                        at, points = zip(*found, strict=True)
                        yield PointBlock(places[np.concatenate(at)], join_points(list(points)))

    def _spectral_blocks(self, sample: str, table: RowTable, places: Ints, edges: Ints, rows: int) -> Iterator[PointBlock]:
        """The blocks of rows at several wavelengths: reduced pose by pose, and put in a file until all of them are known."""
        by_pose, poses = order_by_pose(table[places])
        of_poses = row_places(table[places[by_pose[poses[:-1]]]])[:, POSE]
        if len(of_poses) <= MOST_POSES:  # together, and not a few for each part of the rows
            self.settings.geometry.views_at([tuple(each) for each in of_poses.tolist()])
        parts = (
            by_pose[k : min(k + MOST_ROWS, end)]
            for begin, end in _together(poses, BLOCK_ROWS // 2)
            for k in range(begin, end, MOST_ROWS)
        )
        with PointFile(Path(tempfile.gettempdir())) as file:
            for at, points in self._reduced(sample, table, places, parts):
                file.add(at, points)
            for first, last in _together(edges, rows):
                if (found := file.between(first, last)) is not None:
                    yield PointBlock(places[found[0]], found[1])

    def align(self, sample: str, before: Alignment | None = None) -> AlignmentResult:
        """The alignment by a narrow lobe, at the wavelength of the scans of the open beam, and by these scans.

        `before` is what is known without them; None for what the rig file states. It is not used where the values contradict
        it. Raises UserError where the sample's values determine nothing.
        """
        wavelength = scan_wavelength_nm(self.schedule)
        try:
            points = self.lobe(sample)
            if points is None:
                raise UserError(f"{sample}: has no lobe of reflected light at {wavelength:g} nm that an alignment could use")
            anew = self._estimated(points, sample, None)
            if before is None:
                return anew
            if anew.alignment.agrees_with(before):
                return self._estimated(points, sample, before)
            return replace(anew, findings=(*anew.findings, self._moved(anew, before)))
        except UserError as error:
            raise UserError(f"{self.journal.path}: {error}") from None

    def _estimated(self, points: BsdfPoints, sample: str, before: Alignment | None) -> AlignmentResult:
        settings = replace(self.settings, sample=sample, alignment=before)
        source = f"alignment on {sample} of {self.schedule.name}"
        return estimate_alignment(points, settings, self.beams, source, self.light_seen())

    def _moved(self, anew: AlignmentResult, before: Alignment) -> str:
        """That the rig is not where an alignment has it, and what the one that begins anew does not determine."""
        instrument = nominal_instrument(self.rig.file)
        names = [each.name for each in before.inputs]
        counts = [len(each.combinations(instrument)[0]) for each in (anew.alignment.only(names), before)]
        fewer = f"; it determines {counts[0]} combinations of the rig, that one {counts[1]}" if counts[0] < counts[1] else ""
        return f"the rig is not where {before.source} has it, and has moved since: this alignment begins anew{fewer}"

    def watch(self, names: Sequence[str] | None = None) -> WatchResult:
        """What the residuals show of misalignments that no alignment or uncertainty of the rig states, by each sample's lobe.

        The rows so far are enough. Raises UserError.
        """
        found: list[Misalignment] = []
        clear: list[str] = []
        without: list[str] = []
        for sample in names or self.schedule.samples:
            points = self.lobe(sample)
            if points is None or points.size < TERMS:
                without.append(sample)
                continue
            settings = replace(self.settings, sample=sample, alignment=self._of_file)
            seen = self.light_seen()
            lobe = fit_lobe(points, settings, self.beams, seen=seen)
            refit = partial(fit_lobe, points, settings, self.beams, "", seen=seen)
            misalignment = find_misalignment(lobe, refit, sample, len(self.schedule.samples))
            beside = lobe.chi_square if misalignment is None else misalignment.chi_square
            if beside > REFUSED_CHI_SQUARE or not self._determines(lobe, settings):
                without.append(sample)
            elif misalignment is None:
                clear.append(sample)
            else:
                found.append(misalignment)
        return WatchResult(tuple(found), tuple(clear), tuple(without), self.journal.simulated)

    @property
    def known_alignment(self) -> Alignment | None:
        """What the alignment file that the rig names has of the rig; None without one."""
        return self._of_file

    def _determines(self, lobe: LobeFit, settings: ReductionSettings) -> bool:
        """Whether the values of a lobe determine a misalignment by themselves, beside what is known and without the scans."""
        if settings.alignment is not None or lobe.scans:
            lobe = fit_lobe(lobe.points, replace(settings, alignment=None))
        return bool(lobe.alignment.combinations(nominal_instrument(self.rig.file))[0])

    def light_seen(self) -> LightSeen:
        """What etalon and scans of the open beam show of the light on the sample."""
        instrument = nominal_instrument(self.rig.file)
        field = None if self.schedule.open_beam_scan is None else self.closure().field
        if field is not None:
            instrument = scale_field(instrument, round(math.log(field.ratio), 3))
        return LightSeen(self._shares(), instrument)

    def _shares(self) -> Shares:
        places = self._etalon.places[self._etalon.places[:, 0] == scan_wavelength_nm(self.schedule)]
        signals = self._etalon.at((float(each[0]), tuple(each[1:])) for each in round_deg(places).tolist())
        by_pose: dict[tuple[float, float, float], dict[float, Floats]] = {}
        for (_, (gamma, sigma, beta, shift)), each in signals.items():
            by_pose.setdefault((sigma, beta, shift), {})[gamma] = each.signal.value
        found: dict[tuple[float, float, float], list[float]] = {}
        for (sigma, _, _), turned in by_pose.items():
            first = min(turned)
            for gamma, light in turned.items():
                both = np.isfinite(light) & np.isfinite(turned[first])
                here, there = float(light[both].sum()), float(turned[first][both].sum())
                if gamma != first and min(here, there) > 0.0:
                    found.setdefault((sigma, gamma, first), []).append(math.log(here / there))
        return {(sigma, gamma): (float(np.mean(each)), first) for (sigma, gamma, first), each in found.items()}

    def lobe(self, sample: str) -> BsdfPoints | None:
        """The points of a sample that an alignment can use; None without any."""
        wavelength = scan_wavelength_nm(self.schedule)
        found = [lobe_points(each.points.where(each.points.wavelength_nm == wavelength)) for each in self.blocks(sample)]
        return join_points(found) if any(each.size for each in found) else None

    @property
    def beams(self) -> Sequence[ScannedBeam]:
        """The scans of the open beam; none for a schedule without them."""
        return () if self.schedule.open_beam_scan is None else self.closure().beams

    def checks(self, sample: str) -> ConsistencyChecks:
        """The consistency checks of a sample, before any of its points is added."""
        return ConsistencyChecks(self.settings, self._measurements.row_table(sample))

    @property
    def calibrates(self) -> bool:
        """Whether the values are multiplied by the calibration factors of the overlaps."""
        return self.settings.calibrates

    def finish(self, points: BsdfPoints, overlaps: Overlaps | None) -> BsdfPoints:
        """The BSDF of whole blocks, calibrated by the overlaps of their sample where asked for."""
        factors = overlaps.factors if self.calibrates and overlaps is not None else None
        return finish_points(points, replace(self.settings, calibration=factors))

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

    def notes(self, tallies: Mapping[str, Tally]) -> list[str]:
        """Remarks on the reduction, for the reader of the values, from the tallies of all blocks, by sample."""
        without_etalon = {name: rows for name in self.schedule.samples if (rows := self._without_etalon(name))}
        notes = list(missing_notes(self.journal, without_etalon))
        notes += self.findings
        transmitted = any(tally.transmitted for tally in tallies.values())
        subtracted = any(tally.signature_subtracted for tally in tallies.values())
        u_signature = self.rig.file.sample_unit.signature_uncertainty
        scale = transmitted and self._signature.meets(self._etalon)
        notes += signature_notes(reflected=subtracted, scale=scale, u_signature=u_signature)
        if transmitted:
            notes.append("transmitted light is scaled by the same photodiode's signal of the etalon, lit from its own side")
            notes += [
                f"the etalon's scale for it at {nm:g} nm, sigma {sigma:g} deg is that of the open beam, {ratio:.4f} of the "
                f"certificate's (u {100.0 * u:.2f} %), for photodiodes of the {'lower' if lower else 'upper'} arc"
                for (nm, sigma, lower), (ratio, u) in self.settings.absolute.items()
            ]
        certificate = self.schedule.certificate
        if certificate is not None and certificate.accept_expired_by is not None:
            person = certificate.accept_expired_by
            notes.append(f"the etalon's certificate is valid until {certificate.expires}; {person} accepted its use after that")
        notes += [*self._light_notes(tallies), *self.light(tallies)]
        if (error := tracing_error(self.rig.file)) is not None:
            notes.append(
                f"the light was traced by the forward estimator; median relative error {error:.2g}, included in the uncertainty"
            )
        return notes + [unchecked_note(name, photodiodes) for name, photodiodes in self.unchecked(tallies).items()]

    @property
    def evidence(self) -> SignalEvidence:
        """What the rows show of noise, gains and modules."""
        return self._measurements.evidence

    @property
    def findings(self) -> list[str]:
        """What the campaign shows that is wrong with modules, gains, light or scale, in words."""
        found = [*self.evidence.findings, *(str(interval) for interval in self.drift_intervals)]
        found += [] if self._of_file is None else self.rig.alignment_notes
        found += [] if self._aligned is None else self._aligned.findings
        return found + ([] if self.schedule.open_beam_scan is None else self.closure().alarms)

    @property
    def drift_intervals(self) -> list[DriftInterval]:
        """The times between drift checks of which one is beyond the limit."""
        return self._measurements.drift_intervals

    def _light_notes(self, tallies: Mapping[str, Tally]) -> Iterator[str]:
        """Notes on the etalon's age, on repeats, on the alignment, and on what of the light is not in the uncertainty."""
        if self.settings.alignment is not None:
            yield f"values are corrected for the rig's misalignments: {self.settings.alignment.source}"
        if self._not_aligned:
            yield self._not_aligned
        if self.settings.certificate.calibrated is None and self.rig.file.uncertainty.u(ETALON_AGE):
            yield f"the etalon's certificate has no date of calibration: {ASSUMED_YEARS:g} year is taken as its age"
        if self._repeats is not None:
            yield self._repeats.sentence(self.rig.file.uncertainty.u(REPEATABILITY))
        if any(each.data.flags for each in self.journal.rows("warm-up")):
            yield "the lamp's warm-up: not in u beyond its power (the lamp was not steady after longest_s of [warm_up])"
        elif self.schedule.warm_up is None:
            yield "the lamp's warm-up: not in u beyond its power (the schedule has no [warm_up])"
        yield "slow_sigma: not in u (what a lobe changes with sigma at fixed angles about the specular direction)"
        above = sum(tally.good - tally.under_range for tally in tallies.values())
        for name, missing, reason in (
            ("wavelength", sum(tally.without_slope for tally in tallies.values()), NO_SLOPE),
            ("bandwidth", sum(tally.without_band for tally in tallies.values()), NO_BAND),
        ):
            if missing:
                of = "any value" if missing == above else f"{missing} of {above} values"
                yield f"{name}: not in u of {of} ({reason})"

    def light(self, samples: Iterable[str]) -> list[str]:
        """The polarisation of the light at each sigma, and the samples for which it is not in the uncertainty."""
        sigmas = {
            sigma
            for name in self.schedule.samples
            for sigma in np.unique(self._measurements.row_table(name)["sigma_deg"]).tolist()
        }
        lines = [light_words(self.rig.file.light, np.array(sorted(sigmas)))]
        if unstated := [name for name in samples if name not in self.schedule.diattenuation]:
            lines.append(f"polarisation: not in u of {', '.join(unstated)} (the schedule states no diattenuation)")
        return lines

    def metadata(self, sample: str, tally: Tally) -> Metadata:
        """The metadata of a sample's values, from the tally of all of its blocks."""
        sigmas = np.unique(self._measurements.row_table(sample)["sigma_deg"])
        return journal_metadata(
            self.journal, self.settings, sample, tally, polarisation=light_words(self.rig.file.light, sigmas),
            drift=[str(each) for each in self.drift_intervals], findings=self.findings,
        )  # fmt: skip

    def unchecked(self, tallies: Mapping[str, Tally]) -> dict[str, tuple[int, ...]]:
        """By the mounted sample, the photodiodes that its drift checks do not cover, from the tallies of all blocks."""
        trusted = {name: tally.trusted for name, tally in tallies.items()}
        return unchecked_photodiodes(self._measurements.insensitive, trusted, self.schedule.etalon)

    def _reduced(self, sample: str, table: RowTable, places: Ints, parts: Iterable[Ints]) -> Iterator[tuple[Ints, BsdfPoints]]:
        """The points of some rows at a time, each part a list of indices of `places`, and the index of each point's row."""
        settings = replace(self.settings, sample=sample)
        for here in parts:
            rows = self._measurements.rows_in_columns(table["number"][places[here]].tolist())
            if rows is None:
                continue
            views = arcs_of_rows(rows.places, self.settings.geometry)
            at_etalon = [etalon_places(rows.places[index], each) for index, each in views]
            etalon = self._etalon.at_places(np.concatenate(at_etalon))
            signature = self._signature.at_places(np.concatenate([rows.places, *at_etalon]))
            reduced = reduce_rows(rows, ReferenceSignals(etalon, signature), settings)
            if reduced is not None:
                yield here[reduced[0]], reduced[1]

    def _without_etalon(self, sample: str) -> int:
        """The number of a sample's rows that have no values on some arc, because the etalon was not measured at their pose."""
        places, missing = row_places(self._measurements.row_table(sample)), 0
        for sigma in np.unique(places[:, PLACE.index("sigma_deg")]).tolist():
            here = places[places[:, PLACE.index("sigma_deg")] == sigma]
            known = np.ones(len(here), dtype=bool)
            for at_etalon in etalon_sigmas_deg(self.schedule, sigma):
                here[:, PLACE.index("sigma_deg")] = at_etalon
                known &= self._etalon.measured(here)
            missing += int((~known).sum())
        return missing


def _together(edges: Ints, rows: int) -> Iterator[tuple[int, int]]:
    """Begin and end of ranges between edges, each of so many rows or, the last one, fewer."""
    begin = 0
    for end in edges[1:].tolist():
        if end > begin and (end - begin >= rows or end == edges[-1]):
            yield begin, end
            begin = end


def reduction_settings(
    rig: RigFile, schedule: ScheduleFile, certificate: str | None, name: str, measured: date | None = None,
    alignment: str | None = None,
) -> ReductionSettings:  # fmt: skip
    """The settings of a reduction; `certificate` is the text of the schedule's certificate, `name` its name in an error.

    `alignment` is the text of the rig's alignment file. Without a certificate it is the rig file's. `measured` is the day of
    the measurement, today if it is missing; where a certificate has no date of calibration, this was a year before. Raises
    UserError.
    """
    parsed = constant_certificate(rig.etalon) if certificate is None else parse_certificate(certificate, name)
    years = parsed.years(measured or date.fromisoformat(calendar_stamp()[:10]))
    return ReductionSettings(
        rig, ArcGeometry(rig), schedule, parsed, etalon_years=ASSUMED_YEARS if years is None else years,
        alignment=None if alignment is None or _why_not_aligned(alignment) else rig_alignment(alignment, rig),
    )  # fmt: skip


def _why_not_aligned(text: str | None) -> str:
    """Why the values of a journal are not corrected by the alignment file in it; empty where they are, or without one.

    A rig file that names such a file is refused; journals of earlier versions have them.
    """
    file = None if text is None else parse_alignment(text, "alignment")
    if file is None or (reason := refused_residuals(file)) is None:
        return ""
    return f"not corrected by {file.source}: {reason}"


def rig_alignment(text: str, rig: RigFile) -> Alignment:
    """What an alignment file has of a rig; the tilt of the sample that it was measured on is not carried on.

    Raises UserError.
    """
    file = parse_alignment(text, "alignment")
    table = rig.uncertainty
    of_rig = rig_inputs(table)
    of_sample = [each for name in file.mountings for each in mounting_inputs(table, "sample", name)]
    return Alignment.of_file(file, [*of_rig, *of_sample], file.source).only([each.name for each in of_rig])


def reduce_journal(journal: JournalReader, *, without_damaged: bool = False) -> BsdfDataset:
    """Reduce all samples of a journal; the campaign may be unfinished. Raises UserError as Reduction does."""
    return reduce_to_memory(Reduction(journal, without_damaged=without_damaged))


def reduce_to_memory(reduction: Reduction) -> BsdfDataset:
    """Reduce all samples of a journal that is already known. Raises UserError.

    The points are in temporary files meanwhile: joined in memory, the blocks of a long journal would take twice as much.
    """
    with _files(Path(tempfile.gettempdir())) as (files, keep):
        reduced = _reduce(reduction, keep)
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
        reduced = _reduce(Reduction(journal, without_damaged=without_damaged), keep)
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


def _reduce(reduction: Reduction, keep: Keep) -> ReducedJournal:
    """Reduce all samples of a journal block by block; `keep` takes the points, so that the result has none."""
    journal = reduction.journal
    overlaps, symmetry = {}, {}
    tallies: dict[str, Tally] = {}
    for name in reduction.schedule.samples:
        checks, of_sample = reduction.checks(name), reduction.overlaps(name, BLOCK_ROWS)
        for block in reduction.blocks(name, BLOCK_ROWS):
            checks.add(block.points)
            points = reduction.finish(block.points, of_sample)
            tallies.setdefault(name, Tally()).add(points)
            keep(name, block.rank, points)
        if name in tallies:
            overlaps[name] = checks.overlaps()
            if (result := checks.symmetry()) is not None:
                symmetry[name] = result
    notes = reduction.notes(tallies)
    notes += [f"symmetry of {name}: {result}" for name, result in symmetry.items()]
    notes += [f"overlaps of {name}: {note}" for name, each in overlaps.items() for note in reduction.calibration_notes(each)]
    return ReducedJournal(
        journal.value("name"), reduction.rig, journal.simulated, {}, overlaps, tuple(notes), symmetry,
        reduction.unchecked(tallies), journal.chain.statement, tuple(reduction.light(tallies)), tuple(reduction.findings),
        {name: reduction.metadata(name, tally) for name, tally in tallies.items()},
        reduction.schedule.symmetry == "isotropic",
    )  # fmt: skip


def align_journal(path: Path, sample: str | None = None) -> tuple[AlignmentResult, AlignmentFile]:
    """The alignment by a sample of a journal, and its file; without a name by the one sample that the journal has.

    It begins with what the alignment file that the rig names has. Raises UserError where the journal cannot be reduced, or
    determines nothing.
    """
    with Journal.open(path) as journal:
        reduction = Reduction(journal)
        samples = reduction.schedule.samples
        _refuse_unknown(reduction, sample)
        if sample is None and len(samples) > 1:
            raise UserError(f"{path}: has several samples; name one with --sample: {', '.join(samples)}")
        result = reduction.align(sample or samples[0], reduction.known_alignment)
        first = _first_day(journal)
        return result, alignment_file(result, journal, reduction.rig, "" if first is None else first.isoformat())


def watch_journal(path: Path, sample: str | None = None) -> WatchResult:
    """What the residuals of a journal show of misalignments, as far as it goes; of one sample or of all.

    Raises UserError where the journal cannot be reduced.
    """
    with Journal.open(path) as journal:
        reduction = Reduction(journal)
        _refuse_unknown(reduction, sample)
        return reduction.watch(None if sample is None else [sample])


def _refuse_unknown(reduction: Reduction, sample: str | None) -> None:
    if sample is not None and sample not in reduction.schedule.samples:
        known = ", ".join(reduction.schedule.samples)
        raise UserError(f"{reduction.journal.path}: has no sample {sample!r}; choose with --sample: {known}")


def check_journal(path: Path, chain: Chain | None = None) -> CheckResults:
    """Evaluate the consistency checks of a journal, as far as it goes, and what it shows of the instrument.

    Raises UserError where the journal cannot be read, or is not whole with the `chain` with which it was written.
    """
    with Journal.open(path) as journal:
        if chain is not None and (journal.chain.length, journal.chain.tip) != (chain.length, chain.tip):
            raise DamagedJournal(f"{path}: has other rows than were written; {USE_A_COPY}")
        if chain is not None and journal.chain.damage:
            raise DamagedJournal(f"{path}: differs from what was measured: {journal.chain.damage}; {RESUME}, or {USE_A_COPY}")
        try:
            reduction = Reduction(journal)
            file = reduction.schedule
            closure = None if file.open_beam_scan is None else reduction.closure()
            results = CheckResults(calibrated=reduction.calibrates, findings=tuple(reduction.findings), closure=closure)
            asked = file.symmetry_check is not None or file.overlap is not None
            for name in file.samples if asked else ():
                checks = reduction.checks(name)
                for block in reduction.blocks(name):
                    checks.add(block.points)
                results.add(name, checks)
            return results
        except UserError as error:
            return CheckResults(trouble=str(error).removeprefix(f"{path}: "))


def journal_findings(path: Path) -> list[str]:
    """What a journal shows that is wrong with the instrument. Raises UserError where it has too little for a reduction."""
    with Journal.open(path) as journal:
        return Reduction(journal).findings


def scan_settings(settings: ReductionSettings, found: ClosureReport) -> ReductionSettings:
    """The settings with what the scan of the open beam shows: scale, field of view, and whether the etalon can be right."""
    scan, field_of_view = settings.schedule.open_beam_scan, found.field
    if scan is not None and scan.scale == "open beam":
        settings = replace(settings, absolute=found.scale)
    if field_of_view is not None and field_of_view.applied and field_of_view.field_deg is not None:
        geometry = replace(settings.rig.geometry, field_deg=field_of_view.field_deg)
        settings = replace(settings, rig=replace(settings.rig, geometry=geometry))
    return replace(settings, doubted=found.contradicts_etalon)


def _first_day(journal: JournalReader) -> date | None:
    """The day on which a campaign began; None where the journal does not have it."""
    for session in journal.sessions():
        with contextlib.suppress(ValueError):
            return date.fromisoformat(session.wall_started[:10])
    return None


def missing_notes(journal: JournalReader, without_etalon: Mapping[str, int]) -> Iterator[str]:
    """Notes on what is missing: rows not yet measured, skipped rows, encoder deviations, and values without a scale.

    `without_etalon` is by sample the number of rows at whose poses the etalon was not measured.
    """
    done, of = journal.row_counts()
    skipped = journal.skipped_by_sample()
    if lost := journal.chain.without_values:
        yield f"damaged rows, without values: {', '.join(map(str, sorted(lost)))}; {RESUME}"
    if done + sum(skipped.values()) < of:
        yield f"the campaign is not finished: {done} of {of} rows are done"
    if skipped:
        counts = ", ".join(f"{count} of {sample}" for sample, count in skipped.items())
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
