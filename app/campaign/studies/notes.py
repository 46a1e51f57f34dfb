"""Notes for the reader of a campaign's values: what is missing, what they are scaled and corrected by, what is not in u."""

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigmas_deg
from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.reduction.drift_checks import unchecked_note
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.points import PLACE, Tally
from goniotwin.app.campaign.reduction.polarisation import light_words
from goniotwin.app.campaign.reduction.readings import row_places
from goniotwin.app.campaign.reduction.reduction import RESUME, Reduction
from goniotwin.app.campaign.reduction.settings import ASSUMED_YEARS
from goniotwin.app.campaign.reduction.signals import tracing_error
from goniotwin.app.campaign.reduction.spectrum import NO_BAND, NO_SLOPE
from goniotwin.app.campaign.studies.evaluation import Evaluation
from goniotwin.app.rig.inputs import ETALON_AGE, REPEATABILITY


def reduction_notes(evaluation: Evaluation, tallies: Mapping[str, Tally]) -> list[str]:
    """Remarks on the reduction, for the reader of the values, from the tallies of all blocks, by sample."""
    reduction = evaluation.reduction
    without_etalon = {name: rows for name in reduction.schedule.samples if (rows := _rows_without_etalon(reduction, name))}
    notes = list(missing_notes(reduction.journal, without_etalon))
    notes += evaluation.findings
    transmitted = any(tally.transmitted for tally in tallies.values())
    subtracted = any(tally.signature_subtracted for tally in tallies.values())
    u_signature = reduction.rig.file.sample_unit.signature_uncertainty
    scale = transmitted and reduction.signature.meets(reduction.etalon)
    notes += signature_notes(reflected=subtracted, scale=scale, u_signature=u_signature)
    if transmitted:
        notes.append(
            "transmitted light: the scale is the signal of the same photodiode with the etalon lit from the photodiode's side"
        )
        notes += [
            f"transmitted light at {nm:g} nm, sigma {sigma:g} deg on the {'lower' if lower else 'upper'} arc: the scale is "
            f"that of the open beam, {scale.ratio:.4f} of the certificate's scale (u {100.0 * scale.u:.2f} %)"
            for (nm, sigma, lower), scale in reduction.settings.absolute.items()
        ]
    for standard, table in (
        ("etalon", reduction.schedule.certificate),
        ("second standard", reduction.schedule.second_standard),
    ):
        if table is not None and table.accept_expired_by is not None:
            person = table.accept_expired_by
            notes.append(f"the {standard}'s certificate is valid until {table.expires}; {person} accepted its use after that")
    notes += [*_light_notes(evaluation, tallies), *light_lines(reduction, tallies)]
    if (error := tracing_error(reduction.rig.file)) is not None:
        notes.append(
            f"the forward estimator simulated the light. The uncertainty includes its median relative error, {error:.2g}"
        )
    return notes + [unchecked_note(name, photodiodes) for name, photodiodes in reduction.unchecked(tallies).items()]


def _light_notes(evaluation: Evaluation, tallies: Mapping[str, Tally]) -> Iterator[str]:
    """Notes on the etalon's age, on repeats, on the alignment, and on what of the light is not in the uncertainty."""
    reduction = evaluation.reduction
    if reduction.settings.alignment is not None:
        yield f"values are corrected for the rig's misalignments: {reduction.settings.alignment.source}"
    if evaluation.not_aligned:
        yield evaluation.not_aligned
    if reduction.settings.certificate.calibrated is None and reduction.rig.file.uncertainty.u(ETALON_AGE):
        yield f"the etalon's certificate has no date of calibration: the program assumes an age of {ASSUMED_YEARS:g} year"
    if evaluation.standards is not None and not evaluation.standards.alarms:
        yield f"standards: {evaluation.standards.verdict}. Values with a signal and a certificate of both are scaled by both"
    if evaluation.repeats is not None:
        yield evaluation.repeats.sentence(reduction.rig.file.uncertainty.u(REPEATABILITY))
    if any(each.data.flags for each in reduction.journal.rows("warm-up")):
        yield "warm-up: u includes only what the monitor sees, and the lamp was not steady after longest_s of [warm_up]"
    elif reduction.schedule.warm_up is None:
        yield "warm-up: u includes only what the monitor sees, because the schedule has no [warm_up]"
    yield "lobe shape: u does not include how a lobe changes with sigma at fixed angles about the specular direction"
    above = sum(tally.good - tally.under_range for tally in tallies.values())
    for name, missing, reason in (
        ("wavelength", sum(tally.without_slope for tally in tallies.values()), NO_SLOPE),
        ("bandwidth", sum(tally.without_band for tally in tallies.values()), NO_BAND),
    ):
        if missing:
            of = "all values" if missing == above else f"{missing} of {above} values"
            yield f"{name}: u lacks this component for {of} ({reason})"


def light_lines(reduction: Reduction, samples: Iterable[str]) -> list[str]:
    """The polarisation of the light at each sigma, and the samples for which it is not in the uncertainty."""
    sigmas = {
        sigma
        for name in reduction.schedule.samples
        for sigma in np.unique(reduction.measurements.row_table(name)["sigma_deg"]).tolist()
    }
    lines = [light_words(reduction.rig.file.light, np.array(sorted(sigmas)))]
    if unstated := [name for name in samples if name not in reduction.schedule.diattenuation]:
        lines.append(f"polarisation: u of {', '.join(unstated)} does not include it (the schedule states no diattenuation)")
    return lines


def calibration_notes(reduction: Reduction, overlaps: Overlaps) -> list[str]:
    """Notes on the calibration factors of a sample; none for a schedule without an overlap table."""
    return [] if reduction.schedule.overlap is None else list(overlaps.factors.sentences(reduction.settings.calibrates))


def _rows_without_etalon(reduction: Reduction, sample: str) -> int:
    """The number of a sample's rows that have no values on some arc, because the etalon was not measured at their pose."""
    places, missing = row_places(reduction.measurements.row_table(sample)), 0
    for sigma in np.unique(places[:, PLACE.index("sigma_deg")]).tolist():
        here = places[places[:, PLACE.index("sigma_deg")] == sigma]
        known = np.ones(len(here), dtype=bool)
        for at_etalon in etalon_sigmas_deg(reduction.schedule, sigma):
            here[:, PLACE.index("sigma_deg")] = at_etalon
            known &= reduction.etalon.measured(here)
        missing += int((~known).sum())
    return missing


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
        f"the instrument signature (measured without a sample) is subtracted from {' and from '.join(signals)}. "
        f"The reduction assumes that a mounted sample changes it with a standard uncertainty of {100.0 * u_signature:.2g} %"
    ]
