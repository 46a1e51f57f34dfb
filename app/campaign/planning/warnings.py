"""What a plan should be looked at again for: warnings, a sentence each.

Samples of a virtual rig that give no light at all where they are measured: an etalon with a bare back, an opaque sheet.

Photodiodes that the drift checks cannot watch, as far as geometry tells: hidden at their pose, or away from its light.

How much light a sample sends to each at that pose only a rehearsal knows: see app.campaign.reduction.drift_checks.
"""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.geometry.arcs import (
    HALF_TURN_DEG,
    Arc,
    ArcDirections,
    etalon_sigma_deg,
    far_arc,
    incidence_deg,
    lit_arc,
    polar_deg,
)
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.planning.durations import Timing, shortest_warm_up_s
from goniotwin.app.campaign.planning.exposure import SAMPLED_ROWS
from goniotwin.app.campaign.planning.plan import Plan, PlanDetails
from goniotwin.app.campaign.planning.poses import overlapping_step_deg
from goniotwin.app.campaign.planning.timeline import MeasurementBlock, PlannedRows
from goniotwin.app.campaign.planning.validation import certified_directions
from goniotwin.app.campaign.schedule.certificate import parse_certificate
from goniotwin.app.campaign.schedule.file import DriftTable, ScheduleDescription
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.wording import duration_text, number_list
from goniotwin.app.rig import RigFile, monochromator_settings
from goniotwin.arrays import Ints
from goniotwin.twin.optics import Scatterer


def _no_signal(plan: Plan, seen: list[ArcDirections]) -> Iterator[str]:
    """A warning for each; what a real rig's samples do nobody knows."""
    if not any(each.transmitted for each in seen) and plan.schedule.file.side == "front":
        return  # what reflects nothing from its front nobody measures
    model = plan.rig.model()
    if model is None:
        return
    file = plan.schedule.file
    bare = sorted({_side(etalon_sigma_deg(each.sigma_deg, each.arc)) for each in seen})
    for side in bare:
        if not _scatters(model.samples[file.etalon], side, transmitted=False):
            light = _kinds(each for each in seen if _side(etalon_sigma_deg(each.sigma_deg, each.arc)) == side)
            yield (
                f"{file.etalon} reflects nothing when its {side} is lit, so that {light} has no scale and no value: "
                "take an etalon that scatters on both sides"
            )
    for sample in file.samples:
        for side, transmitted in sorted({(_side(each.sigma_deg), each.transmitted) for each in seen}):
            if not _scatters(model.samples[sample], side, transmitted=transmitted):
                does = "lets nothing through" if transmitted else "reflects nothing"
                yield (
                    f"{sample} {does} when its {side} is lit: what is measured there is noise; "
                    "is it the right sample, side or light?"
                )


def _side(sigma_deg: float) -> str:
    return "front" if lit_arc(sigma_deg) == "upper" else "back"


def _kinds(seen: Iterator[ArcDirections]) -> str:
    kinds = sorted({"transmitted" if each.transmitted else "reflected" for each in seen})
    return f"{' and '.join(kinds)} light"


def _scatters(sample: Scatterer, side: str, *, transmitted: bool) -> bool:
    incident = 1 if side == "front" else -1
    return any(lobe.incident == incident and lobe.transmits == transmitted for lobe in sample.lobes)


def _unmonitored(plan: Plan, seen: list[ArcDirections]) -> Iterator[str]:
    """A warning for each reason."""
    table = plan.schedule.file.drift
    if table is None:
        return
    rig, arcs = plan.rig.file, {each.arc for each in seen}
    dark = far_arc(table.sigma_deg)
    if dark in arcs:
        other = (
            f"a [drift] sigma_deg of {HALF_TURN_DEG - table.sigma_deg:g} lights them"
            if len(arcs) == 1
            else "measure transmitted light in a schedule of its own, with drift checks from that side"
        )
        yield (
            f"the drift checks at sigma {table.sigma_deg:g} deg do not light the side of the etalon that photodiodes "
            f"{number_list(_channels(rig, dark))} look at: a fault of theirs while the etalon is measured would pass; {other}"
        )
    hidden = np.concatenate([_blocked_photodiodes(rig, table, arc) for arc in sorted(arcs)])
    if hidden.size:
        yield (
            f"at the pose of the drift checks the mirror unit hides photodiodes {number_list(hidden)}: a fault of theirs would "
            "pass; take a [drift] pose that is free"
        )


def _channels(rig: RigFile, arc: Arc) -> Ints:
    first = 0 if arc == "upper" else len(rig.photodiodes.upper_deg)
    return first + np.arange(len(polar_deg(rig, arc)))


def _blocked_photodiodes(rig: RigFile, table: DriftTable, arc: Arc) -> Ints:
    signed = np.array(polar_deg(rig, arc), dtype=float) + table.shift_deg
    azimuth = table.beta_deg + np.where(signed < 0.0, HALF_TURN_DEG, 0.0)
    zenith = np.abs(signed) if arc == "upper" else HALF_TURN_DEG - np.abs(signed)
    return _channels(rig, arc)[blocked_by_mirrors(rig, table.sigma_deg, zenith, azimuth, table.gamma_deg)]


def _uncertified(schedule: ScheduleDescription, seen: list[ArcDirections]) -> Iterator[str]:
    """A warning where some of the directions, at some of the wavelengths, will have no value for want of a certificate."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    wavelengths = np.array(grid_values(file.wavelength_nm))
    within = certificate.covers("wavelength_nm", wavelengths)
    directions, total = certified_directions(certificate, seen), sum(each.directions for each in seen)
    outside = [
        *([f"{(~within).sum()} of {within.size} wavelengths"] if not within.all() else []),
        *([f"{total - directions} of {total} directions"] if directions < total else []),
    ]
    if outside:
        yield (
            f"the etalon's certificate {file.certificate.file} says nothing of {' and '.join(outside)}, which will have no "
            f"value (uncertified): it holds for {certificate}; take one that holds for all, or measure less"
        )


SECOND_ORDER_NM = 710.0
"""Beyond this the grating's second order lets light of half the wavelength through that the lamp's bulb does not absorb."""


def plan_warnings(plan: Plan, details: PlanDetails, seen: list[ArcDirections]) -> list[str]:
    """All of them."""
    return [
        *_omitted(plan, details),
        *_blocked(seen),
        *_uncertified(plan.schedule, seen),
        *_no_signal(plan, seen),
        *_unmonitored(plan, seen),
        *_overlaps(plan, seen),
        *_darks(plan, details),
        *_light(plan),
        *_estimated(plan),
    ]


def _omitted(plan: Plan, details: PlanDetails) -> Iterator[str]:
    for name in details.omitted:
        points = getattr(plan.schedule.file, name).points
        yield (
            f"[{name}] points = {points} is left out: the arc would meet the incoming beam on its way to its poses, whatever "
            "the order; take betas on one side of the beam, or remove it"
        )


def _blocked(seen: list[ArcDirections]) -> Iterator[str]:
    for each in seen:
        if each.specular_blocked and not each.transmitted:
            yield (
                f"at sigma {each.sigma_deg:g} deg the mirror unit hides the specular direction, "
                f"{incidence_deg(each.sigma_deg):g} deg from the normal: what is measured there is no value of the sample"
            )
        elif each.specular_blocked:
            yield (
                f"at sigma {each.sigma_deg:g} deg the mirror unit hides the direction straight through, "
                f"{incidence_deg(each.sigma_deg):g} deg from the normal, when the etalon is lit from that side: what is "
                "measured there has no scale; take a sigma at which it is free"
            )


def _overlaps(plan: Plan, seen: list[ArcDirections]) -> Iterator[str]:
    if any(each.shared for each in seen):
        return
    base = grid_values(plan.schedule.file.shift_deg)[0]
    step = overlapping_step_deg(plan.rig.file, base)
    if step is not None:
        yield (
            f"no direction is seen by two photodiodes, so that nothing holds them against each other; "
            f"[overlap] points = 1 adds poses at shift {base + step:g} deg where they are"
        )


def _darks(plan: Plan, details: PlanDetails) -> Iterator[str]:
    every = plan.schedule.file.dark_every_s
    if details.oldest_dark_s > every:
        yield (
            f"a dark gets {details.oldest_dark_s:.0f} s old, more than dark_every_s = {every:g}: a single row takes longer, "
            "with its move and its readings; allow older darks, or take fewer readings"
        )


def _light(plan: Plan) -> Iterator[str]:
    file, gains = plan.schedule.file, plan.rig.file.photodiodes.gains_v_per_a
    if file.open_beam and file.gains_v_per_a != "automatic" and min(file.gains_v_per_a) > min(gains):
        yield (
            f"the open beam is the strongest light that there is, and gains_v_per_a leaves out the rig's lowest, "
            f"{min(gains):g} V/A: it may be clipped"
        )
    yield from _second_order(plan)


def _second_order(plan: Plan) -> Iterator[str]:
    """Where no filter of the rig is known to hold it back."""
    wheel = monochromator_settings(plan.rig.file).wheel
    beyond = [each for each in grid_values(plan.schedule.file.wavelength_nm) if each > SECOND_ORDER_NM]
    open_to_it = [each for each in beyond if (there := wheel.at(each)) is None or not there.blocks(0.5 * each)]
    if not open_to_it:
        return
    begin = f"above {SECOND_ORDER_NM:g} nm ({len(open_to_it)} wavelengths) light of half the wavelength passes, too"
    if not wheel:
        yield (
            f"{begin}: put order-sorting filters into the wheel, and say in the rig file, in [[monochromator.filters]], which "
            "stands where and for what: position, name, from_nm, to_nm, cut_on_nm"
        )
        return
    names = dict.fromkeys(f"{there.name!r}" for each in open_to_it if (there := wheel.at(each)) is not None)
    yield (
        f"{begin}, for the rig file does not say that {' or '.join(names)} holds it back: in [[monochromator.filters]] give "
        f"cut_on_nm, above {0.5 * max(open_to_it):g}, or put another filter in for these"
    )


def _estimated(plan: Plan) -> Iterator[str]:
    """Where the duration depends on the sample or the lamp."""
    file = plan.schedule.file
    unknown = [
        *(["how many gains a row needs"] if file.gains_v_per_a == "automatic" else []),
        *(["how long each has to be averaged"] if file.averaging is not None else []),
        *(["when the lamp is steady"] if file.warm_up is not None else []),
    ]
    if unknown:
        least, most = duration_range(plan)
        yield (
            f"the duration is a guess, for {' and '.join(unknown)} is known afterwards: it may be from about "
            f"{duration_text(least)} to {duration_text(most)}; {_basis(plan)}a rehearsal knows better"
        )


def _basis(plan: Plan) -> str:
    """What the guess is taken from."""
    if plan.details is None or not plan.details.expected_reading_s:
        return ""
    whose = "the twin" if plan.rig.file.twin is not None else "the twin that the rig's file describes, its samples assumed,"
    return f"it stands on the light of {whose} in up to {SAMPLED_ROWS} poses and wavelengths of each sample; "


def duration_range(plan: Plan) -> tuple[float, float]:
    """The least and the most that the foretold duration could turn out to be, by what sample and lamp need; about, in s."""
    assert plan.details is not None
    assert isinstance(plan.rows, PlannedRows)
    timing = Timing(plan.rig.file)
    timing.expected_reading_s.update(plan.details.expected_reading_s)
    warm_up = plan.schedule.file.warm_up
    waiting = 0.0 if warm_up is None else warm_up.longest_s - shortest_warm_up_s(warm_up.longest_s)
    least = most = plan.seconds
    for sample, rows in _rows_by_sample(plan.rows).items():
        row = plan.details.templates.measurement(sample)
        likely = timing.typical_reading_s(row)
        fewest, highest = timing.reading_range_s(row)
        least, most = least + rows * (fewest - likely), most + rows * (highest - likely)
    return min(least, plan.seconds), max(most, plan.seconds) + waiting


def _rows_by_sample(rows: PlannedRows) -> Counter[str]:
    """Measurements and drift checks."""
    counted: Counter[str] = Counter()
    for piece in rows.pieces:
        if isinstance(piece, MeasurementBlock):
            counted[piece.scan_pass.sample] += len(piece.points)
        elif piece.kind == "drift":
            counted[piece.sample] += 1
    return counted
