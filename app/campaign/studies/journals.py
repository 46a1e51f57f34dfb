"""Studies of a journal by its path: alignment, watch, checks, and what it shows of the instrument."""

from pathlib import Path

from goniotwin.app.campaign.journal.chain import Chain
from goniotwin.app.campaign.journal.reading import USE_A_COPY, DamagedJournal
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.reduction import RESUME, Reduction, first_day
from goniotwin.app.campaign.studies.alignment import AlignmentResult, alignment_file
from goniotwin.app.campaign.studies.checks import CheckResults, ConsistencyChecks
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.sample_alignment import align_sample
from goniotwin.app.campaign.studies.watch import WatchResult, watch_samples
from goniotwin.app.errors import UserError
from goniotwin.app.rig.alignment import AlignmentFile


def align_journal(path: Path, sample: str | None = None) -> tuple[AlignmentResult, AlignmentFile]:
    """The alignment by a sample of a journal, and its file; without a name by the one sample that the journal has.

    It begins with what the alignment file that the rig names has. Raises UserError where the journal cannot be reduced, or
    determines nothing.
    """
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        reduction = evaluation.reduction
        samples = reduction.schedule.samples
        _refuse_unknown(reduction, sample)
        if sample is None and len(samples) > 1:
            raise UserError(f"{path}: has several samples; name one with --sample: {', '.join(samples)}")
        result = align_sample(reduction, evaluation.closure, sample or samples[0], evaluation.known_alignment)
        first = first_day(journal)
        return result, alignment_file(result, journal, reduction.rig, "" if first is None else first.isoformat())


def watch_journal(path: Path, sample: str | None = None) -> WatchResult:
    """What the residuals of a journal show of misalignments, as far as it goes; of one sample or of all.

    Raises UserError where the journal cannot be reduced.
    """
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        _refuse_unknown(evaluation.reduction, sample)
        return watch_samples(evaluation, None if sample is None else [sample])


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
            evaluation = evaluate_journal(journal)
            reduction = evaluation.reduction
            file = reduction.schedule
            closure = None if file.open_beam_scan is None else evaluation.closure
            results = CheckResults(
                calibrated=reduction.settings.calibrates, findings=tuple(evaluation.findings), closure=closure
            )
            asked = file.symmetry_check is not None or file.overlap is not None
            for name in file.samples if asked else ():
                checks = ConsistencyChecks(reduction, name)
                for block in reduction.blocks(name):
                    checks.add(block.points)
                results.add(name, checks)
            return results
        except UserError as error:
            return CheckResults(trouble=str(error).removeprefix(f"{path}: "))


def journal_findings(path: Path) -> list[str]:
    """What a journal shows that is wrong with the instrument. Raises UserError where it has too little for a reduction."""
    with Journal.open(path) as journal:
        return evaluate_journal(journal).findings
