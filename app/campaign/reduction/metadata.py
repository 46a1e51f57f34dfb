"""The metadata of a campaign's values: from its schedule, its rig file, its journal and the figures of the reduction."""

import contextlib
import itertools
import math
from collections.abc import Iterable, Sequence
from datetime import datetime
from importlib.metadata import version

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.journal.samples import sample_record_of
from goniotwin.app.campaign.reduction.points import Tally
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.formats.metadata import (
    InstrumentMetadata,
    Metadata,
    QualityMetadata,
    ReceiverMetadata,
    ReferenceMetadata,
    SampleMetadata,
    SourceMetadata,
)
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.twin.optics.geometry.coordinates import round_deg

MOST_LISTED = 8
"""Values of a grid that are listed one by one."""
METHOD = (
    "ratio to the reference standard by the same photodiodes at the same angles, both over the monitor's current; standard "
    "uncertainties by the GUM, with all effects that values share"
)


def journal_metadata(
    journal: JournalReader,
    settings: ReductionSettings,
    sample: str,
    tally: Tally,
    *,
    polarisation: str,
    drift: Sequence[str],
    findings: Iterable[str],
) -> Metadata:
    """The metadata of one sample's values, which `tally` has counted.

    `polarisation` of the light, times of excessive `drift` and `findings` are in words. What a person states in the schedule
    comes first; a key that is not stated has what rig file and journal know, or nothing.
    """
    schedule, rig = settings.schedule, settings.rig
    stated = schedule.metadata
    of_sample = sample_record_of(journal, schedule, sample)
    instrument = nominal_instrument(rig)
    certificate = settings.certificate
    return Metadata(
        title=stated.title or schedule.name,
        date=_begun(journal),
        operator=stated.operator,
        laboratory=stated.laboratory,
        environment=stated.environment,
        licence=stated.licence,
        geometry=_geometry(schedule, tally),
        method=METHOD,
        raw_data=journal.chain.statement,
        sample=SampleMetadata(**{"identifier": sample, "side": schedule.side, **of_sample.stated}),
        instrument=InstrumentMetadata(
            f"{stated.instrument} ({rig.name})" if stated.instrument else rig.name,
            f"goniotwin {version('goniotwin')}",
            rig.geometry.arc_radius_mm,
            instrument.pupil_distance_mm,
        ),
        source=SourceMetadata(
            stated.source,
            tuple(sorted(grid_values(schedule.wavelength_nm))),
            rig.light.bandwidth_nm,
            polarisation,
            rig.geometry.spot_side_mm,
            instrument.divergence_deg,
        ),
        receiver=ReceiverMetadata(
            stated.receiver,
            solid_angle_sr(rig),
            rig.geometry.field_deg,
            tuple(rig.photodiodes.gains_v_per_a[k] for k in sorted(tally.gains)),
        ),
        reference=ReferenceMetadata(
            stated.reference or ", ".join(schedule.standards),
            stated.certificate or _certificate(schedule),
            "" if certificate.calibrated is None else certificate.calibrated.isoformat(),
            float(certificate.relative_uncertainty.max()),
        ),
        quality=QualityMetadata(
            _signature(schedule, tally, rig), tally.noise_floor, _drift(schedule, drift), schedule.repeats, tuple(findings)
        ),
    )


def solid_angle_sr(rig: RigFile) -> float:
    """The solid angle of a photodiode's disc, seen from the sample."""
    return math.pi * (0.5 * rig.geometry.detector_diameter_mm / rig.geometry.arc_radius_mm) ** 2


def _begun(journal: JournalReader) -> str:
    """When the first session began, ISO 8601; empty where the journal does not have it."""
    for session in journal.sessions():
        with contextlib.suppress(ValueError):
            datetime.fromisoformat(session.wall_started)
            return session.wall_started
    return ""


def _geometry(schedule: ScheduleFile, tally: Tally) -> str:
    grids = ", ".join(
        f"{name} {listed_values(grid_values(getattr(schedule, f'{name}_deg')))}" for name in ("sigma", "gamma", "beta", "shift")
    )
    side = "both sides" if schedule.side == "both" else f"the {schedule.side}"
    light = "reflected and transmitted" if schedule.light == "both" else schedule.light
    return (
        f"light on {side}, {light} light, sample stated as {schedule.symmetry}; {grids} deg; {tally.directions} values, "
        f"{tally.good} of them trusted"
    )


def listed_values(values: Sequence[float]) -> str:
    """Values in ascending order, those of an even grid as a range with its step, others one by one if they are few."""
    ordered = sorted(values)
    if len(ordered) <= 3:
        return ", ".join(f"{each:g}" for each in ordered)
    steps = {float(round_deg(b - a)) for a, b in itertools.pairwise(ordered)}
    if len(steps) == 1:
        return f"{ordered[0]:g} to {ordered[-1]:g} by {steps.pop():g}"
    if len(ordered) <= MOST_LISTED:
        return ", ".join(f"{each:g}" for each in ordered)
    return f"{len(ordered)} values from {ordered[0]:g} to {ordered[-1]:g}"


def _certificate(schedule: ScheduleFile) -> str:
    certificate, second = schedule.certificate, schedule.second_standard
    stated = "[etalon] of the rig file"
    if certificate is not None:
        stated = f"{certificate.file}, valid until {certificate.expires.isoformat()}"
    return stated if second is None or second.turned else f"{stated}; [second_standard] of the schedule"


def _signature(schedule: ScheduleFile, tally: Tally, rig: RigFile) -> str:
    if not tally.signature_subtracted:
        return "not measured, not corrected" if not schedule.signature else "measured; no value has it subtracted"
    u = 100.0 * rig.sample_unit.signature_uncertainty
    return f"measured without a sample and subtracted; taken as the same to {u:.2g} % with a sample"


def _drift(schedule: ScheduleFile, intervals: Sequence[str]) -> str:
    if schedule.drift is None:
        return "; ".join(["no drift checks", *intervals])
    limit = f"limit {100.0 * schedule.drift.limit:g} %"
    checks = f"checked every {schedule.drift.every_s:g} s at sigma {schedule.drift.sigma_deg:g} deg, {limit}"
    return "; ".join([checks, *(intervals or ["no check is beyond it"])])
