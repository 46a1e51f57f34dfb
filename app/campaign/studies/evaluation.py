"""The evaluation of a journal on one page: what it shows of its own inputs, in order, and its reduction by all of that."""

import math
from dataclasses import dataclass, replace

from goniotwin.app.campaign.journal.reading import DamagedJournal, JournalReader
from goniotwin.app.campaign.measurement_model.alignment import Alignment
from goniotwin.app.campaign.reduction.reading_inputs import monitor_variance
from goniotwin.app.campaign.reduction.readings import Repeats, repeats
from goniotwin.app.campaign.reduction.reduction import Reduction, begin_reduction
from goniotwin.app.campaign.reduction.settings import ReductionSettings, why_not_aligned
from goniotwin.app.campaign.studies.alignment import AlignmentResult
from goniotwin.app.campaign.studies.closure import ClosureReport, journal_closure
from goniotwin.app.campaign.studies.pose_evidence import PoseEvidence, pose_evidence
from goniotwin.app.campaign.studies.sample_alignment import align_sample
from goniotwin.app.campaign.studies.standards import StandardsReport, compare_standards
from goniotwin.app.errors import UserError
from goniotwin.app.rig.inputs import CROSSTALK, REPEATABILITY, Input


@dataclass(frozen=True)
class Evaluation:
    """A journal's `reduction` by all that the campaign shows of its own inputs, and what the studies have found.

    `repeats` are those of poses, None where there are too few; `closure` is that of the etalon's scale with the open beam's;
    `standards` compares the etalon with a second standard, None without one.
    `pose` is what the scans of the open beam show of the inputs of pose, None without one; the values are corrected by it where
    no sample aligns, and it is no contradiction.
    `known_alignment` is what the alignment file that the rig names has of the rig, `aligned` the alignment by one of the
    campaign's own samples; None without. `not_aligned` is the reason why the values are not corrected by one, or empty.
    """

    reduction: Reduction
    repeats: Repeats | None
    closure: ClosureReport
    pose: PoseEvidence | None
    known_alignment: Alignment | None
    aligned: AlignmentResult | None
    not_aligned: str
    standards: StandardsReport | None = None

    @property
    def findings(self) -> list[str]:
        """What the campaign shows that is wrong with modules, gains, light or scale, in words."""
        measurements = self.reduction.measurements
        found = [*measurements.evidence.findings, *(str(interval) for interval in measurements.drift_intervals)]
        found += [] if self.known_alignment is None else self.reduction.rig.alignment_notes
        found += [] if self.aligned is None else self.aligned.findings
        found += [] if self.standards is None else self.standards.alarms
        found += [self.pose.text] if self.pose is not None and self.pose.verdict == "fails" else []
        return found + self.closure.alarms


def evaluate_journal(journal: JournalReader, *, without_damaged: bool = False) -> Evaluation:
    """Study a journal as its schedule asks for: repeats, the scan of the open beam, the alignment on one of its samples.

    Each study goes by the settings that those before it have found. Raises UserError as begin_reduction does.
    """
    reduction = begin_reduction(journal, without_damaged=without_damaged)
    noise, lamp = reduction.measurements.noise_freedom, reduction.measurements.evidence.lamp_freedom
    reduction = replace(reduction, settings=replace(reduction.settings, noise_freedom=noise, lamp_freedom=lamp))
    known, not_aligned = reduction.settings.alignment, why_not_aligned(journal.optional_value("alignment"))
    repeated = repeats(reduction.measurements, reduction.schedule.samples, 0.5 * monitor_variance(reduction.rig.file))
    table = reduction.rig.file.uncertainty
    if repeated is not None and repeated.excess > table.u(REPEATABILITY):
        reduction = _measured(reduction, REPEATABILITY, repeated.excess, "the repeats of this campaign", repeated.freedom)
    closure = _closure(reduction)
    share = float(reduction.measurements.evidence.crosstalk.max())
    if share > table.u(CROSSTALK):  # after the closure, which compares what the scans show with what is stated
        reduction = _measured(reduction, CROSSTALK, share, "the rows of this campaign at two gains")
    reduction = replace(reduction, settings=scan_settings(reduction.settings, closure))
    standards = compare_standards(reduction)
    if standards is not None and (second := reduction.settings.second) is not None:
        second = replace(second, difference=standards.difference)
        reduction = replace(reduction, settings=replace(reduction.settings, second=second))
    pose = pose_evidence(closure.beams, reduction.settings)
    aligned: AlignmentResult | None = None
    if (sample := reduction.schedule.align) is not None:
        try:
            aligned = align_sample(reduction, closure, sample, known)
        except DamagedJournal:
            raise
        except UserError as error:
            not_aligned = f"not aligned: {str(error).removeprefix(f'{journal.path}: ')}"
        else:
            reduction = replace(reduction, settings=replace(reduction.settings, alignment=aligned.with_photodiodes))
    if pose is not None and aligned is None:
        if pose.verdict == "fails":
            reason = "not corrected by the scans of the open beam, which contradict the inputs of pose"
            not_aligned = "; ".join(filter(None, (not_aligned, reason)))
        else:
            reduction = replace(reduction, settings=replace(reduction.settings, alignment=pose.alignment))
    return Evaluation(reduction, repeated, closure, pose, known, aligned, not_aligned, standards)


def _measured(reduction: Reduction, each: Input, width: float, by: str, freedom: float = math.inf) -> Reduction:
    """The reduction with the uncertainty of an input that the campaign shows, where that is more than is stated."""
    rig = reduction.settings.rig
    known = replace(rig, uncertainty=rig.uncertainty.measured(each, width, by, freedom))
    return replace(reduction, settings=replace(reduction.settings, rig=known))


def _closure(reduction: Reduction) -> ClosureReport:
    """The closure of the etalon's scale with that of the open beam. Raises UserError."""
    try:
        return journal_closure(reduction)
    except ValueError as error:  # the schedule and the rig file in the journal were not planned together
        raise UserError(f"{reduction.journal.path} (schedule): {error}") from None


def scan_settings(settings: ReductionSettings, found: ClosureReport) -> ReductionSettings:
    """The settings with what the scan of the open beam shows: scale, field of view, and whether the etalon can be right."""
    scan, field_of_view = settings.schedule.open_beam_scan, found.field
    if scan is not None and scan.scale == "open beam":
        settings = replace(settings, absolute=found.scale)
    if field_of_view is not None and field_of_view.applied and field_of_view.field_deg is not None:
        geometry = replace(settings.rig.geometry, field_deg=field_of_view.field_deg)
        settings = replace(settings, rig=replace(settings.rig, geometry=geometry))
    return replace(settings, doubted=found.contradicts_etalon)
