"""Warnings about a plan, one sentence each.

They follow from schedule, rig file and plan. How much light a sample sends to each photodiode at the pose of the drift checks
is known only to a rehearsal: see app.campaign.reduction.drift_checks.
"""

import itertools
from collections import Counter
from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcDirections, arc_channels, arc_view, etalon_sigma_deg, far_arc, lit_side
from goniotwin.app.campaign.geometry.directions import Arc
from goniotwin.app.campaign.geometry.open_beam import scan_notes
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.planning.durations import SAMPLED_ROWS, Timing, shortest_warm_up_s
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.planning.poses import overlapping_step_deg
from goniotwin.app.campaign.planning.timeline import MeasurementBlock, PlannedRows
from goniotwin.app.campaign.planning.validation import certified_directions
from goniotwin.app.campaign.row import Row
from goniotwin.app.campaign.schedule.certificate import parse_certificate
from goniotwin.app.campaign.schedule.file import DriftTable, ScheduleDescription, ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.wording import duration_text, number_list
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Ints
from goniotwin.twin.optics import Scatterer
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, opposite_sigma_deg

SECOND_ORDER_NM = 710.0
"""Above this wavelength the second order of the grating passes light of half the wavelength that the lamp's bulb transmits."""


def plan_warnings(plan: NewPlan, arcs: list[ArcDirections]) -> list[str]:
    """All warnings; `arcs` are the observed directions of the samples."""
    return [
        *_omitted(plan),
        *_blocked(arcs),
        *_uncertified(plan.schedule, arcs),
        *_no_signal(plan, arcs),
        *_unmonitored(plan, arcs),
        *_no_overlap(plan, arcs),
        *_old_dark_reading(plan),
        *_saturated_open_beam(plan),
        *scan_notes(plan.schedule.file, plan.rig.file),
        *_second_order(plan),
        *uncertain_duration(plan),
        *beyond_longest(plan.schedule.file, plan.seconds),
        *plan.rig.alignment_notes,
    ]


def _omitted(plan: NewPlan) -> Iterator[str]:
    for name in plan.omitted:
        points = getattr(plan.schedule.file, name).points
        yield (
            f"[{name}] points = {points} is omitted: in any order the arc would collide with the incoming beam on the way to "
            "its poses. Choose betas on one side of the beam, or remove the table"
        )


def _blocked(arcs: list[ArcDirections]) -> Iterator[str]:
    for each in arcs:
        if each.specular_blocked and not each.transmitted:
            yield (
                f"at sigma {each.sigma_deg:g} deg the mirror unit blocks the specular direction, "
                f"{incidence_deg(each.sigma_deg):g} deg from the normal. There is no valid value in that direction. "
                "Choose a sigma at which it is free, if you need it"
            )
        elif each.specular_blocked:
            yield (
                f"at sigma {each.sigma_deg:g} deg the mirror unit blocks the direction straight through, "
                f"{incidence_deg(each.sigma_deg):g} deg from the normal, when the light meets the etalon from that side. The "
                "reading there has no scale. Choose a sigma at which this direction is free"
            )


def _uncertified(schedule: ScheduleDescription, arcs: list[ArcDirections]) -> Iterator[str]:
    """A warning if the certificate does not cover all wavelengths and directions."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    wavelengths = np.array(grid_values(file.wavelength_nm))
    within = certificate.covers("wavelength_nm", wavelengths)
    directions, total = certified_directions(certificate, arcs), sum(each.directions for each in arcs)
    outside = [
        *([f"{(~within).sum()} of {within.size} wavelengths"] if not within.all() else []),
        *([f"{total - directions} of {total} directions"] if directions < total else []),
    ]
    if outside:
        yield (
            f"the etalon's certificate {file.certificate.file} does not cover {' and '.join(outside)}. They get no value "
            f"(flag uncertified). The certificate is valid for {certificate}. Use one that covers all of them, or measure less"
        )


def _no_signal(plan: NewPlan, arcs: list[ArcDirections]) -> Iterator[str]:
    """Samples of a virtual rig without light where they are measured; of a real rig's samples this is not known."""
    if not any(each.transmitted for each in arcs) and plan.schedule.file.side == "front":
        return  # reflection from the front: a sample without it would not be measured
    model = plan.rig.model()
    if model is None:
        return
    file = plan.schedule.file
    sides = sorted({lit_side(etalon_sigma_deg(each.sigma_deg, each.arc)) for each in arcs})
    for side, standard in itertools.product(sides, file.standards):
        if not _scatters(model.samples[standard], side, transmitted=False):
            light = _light_kinds(each for each in arcs if lit_side(etalon_sigma_deg(each.sigma_deg, each.arc)) == side)
            yield (
                f"{standard} reflects nothing when its {side} is lit, so that {light} has no scale and no value. "
                "Use an etalon that scatters on both sides"
            )
    for sample in file.samples:
        for side, transmitted in sorted({(lit_side(each.sigma_deg), each.transmitted) for each in arcs}):
            if not _scatters(model.samples[sample], side, transmitted=transmitted):
                verb = "transmits" if transmitted else "reflects"
                yield (
                    f"{sample} {verb} nothing when its {side} is lit. The readings there are noise. "
                    "Check the sample, side and light of the schedule"
                )


def _light_kinds(arcs: Iterator[ArcDirections]) -> str:
    kinds = sorted({"transmitted" if each.transmitted else "reflected" for each in arcs})
    return f"{' and '.join(kinds)} light"


def _scatters(sample: Scatterer, side: str, *, transmitted: bool) -> bool:
    incident = 1 if side == "front" else -1
    return any(lobe.incident == incident and lobe.transmits == transmitted for lobe in sample.lobes)


def _unmonitored(plan: NewPlan, arcs: list[ArcDirections]) -> Iterator[str]:
    """Photodiodes without light at the pose of the drift checks, as far as the geometry shows."""
    table = plan.schedule.file.drift
    if table is None:
        return
    rig, observing = plan.rig.file, {each.arc for each in arcs}
    unlit = far_arc(table.sigma_deg)
    if unlit in observing:
        remedy = (
            f"Set [drift] sigma_deg = {opposite_sigma_deg(table.sigma_deg):g}, which gives them light"
            if len(observing) == 1
            else "Measure transmitted light in a separate schedule, with drift checks from that side"
        )
        yield (
            f"at sigma {table.sigma_deg:g} deg, photodiodes {number_list(arc_channels(rig, unlit))} have no light in the drift "
            "checks: the etalon is lit from its other side. The checks do not detect a fault of these photodiodes while the "
            f"etalon is measured. {remedy}"
        )
    blocked = np.concatenate([_blocked_photodiodes(rig, table, arc) for arc in sorted(observing)])
    if blocked.size:
        yield (
            f"at the pose of the drift checks the mirror unit blocks photodiodes {number_list(blocked)}. The checks do not "
            "detect a fault of these. Choose a [drift] pose at which they are free"
        )


def _blocked_photodiodes(rig: RigFile, table: DriftTable, arc: Arc) -> Ints:
    view = arc_view(rig, (table.gamma_deg, table.sigma_deg, table.beta_deg, table.shift_deg), arc)
    return view.channels[blocked_by_mirrors(rig, table.sigma_deg, view.zenith, view.azimuth, table.gamma_deg)]


def _no_overlap(plan: NewPlan, arcs: list[ArcDirections]) -> Iterator[str]:
    if any(each.shared for each in arcs):
        return
    base = grid_values(plan.schedule.file.shift_deg)[0]
    step = overlapping_step_deg(plan.rig.file, base)
    if step is not None:
        yield (
            "no two photodiodes measure the same direction, so that the program cannot compare them. "
            f"[overlap] points = 1 adds poses at shift {base + step:g} deg where they overlap"
        )


def _old_dark_reading(plan: NewPlan) -> Iterator[str]:
    every = plan.schedule.file.dark_every_s
    if plan.oldest_dark_s > every:
        yield (
            f"a dark reading gets {plan.oldest_dark_s:.0f} s old, more than dark_every_s = {every:g}, because a single row "
            "takes longer. Increase dark_every_s, or take fewer readings"
        )


def _saturated_open_beam(plan: NewPlan) -> Iterator[str]:
    file, gains = plan.schedule.file, plan.rig.file.photodiodes.gains_v_per_a
    if file.open_beam and file.gains_v_per_a != "automatic" and min(file.gains_v_per_a) > min(gains):
        yield (
            "the open beam is the strongest signal, and may be saturated. "
            f"Add the rig's lowest gain, {min(gains):g} V/A, to gains_v_per_a"
        )


def _second_order(plan: NewPlan) -> Iterator[str]:
    """Wavelengths at which no filter is known to block the second order."""
    wheel = plan.rig.file.monochromator.wheel
    beyond = [each for each in grid_values(plan.schedule.file.wavelength_nm) if each > SECOND_ORDER_NM]
    unblocked = [each for each in beyond if (glass := wheel.at(each)) is None or not glass.blocks(0.5 * each)]
    if not unblocked:
        return
    finding = f"above {SECOND_ORDER_NM:g} nm ({len(unblocked)} wavelengths) light of half the wavelength passes as well"
    if not wheel:
        yield (
            f"{finding}. Put order-sorting filters into the wheel, and describe each in [[monochromator.filters]] of the rig "
            "file with position, name, from_nm, to_nm and cut_on_nm"
        )
        return
    names = dict.fromkeys(f"{glass.name!r}" for each in unblocked if (glass := wheel.at(each)) is not None)
    yield (
        f"{finding}, because the rig file has no sufficient cut_on_nm for {' or '.join(names)}. In [[monochromator.filters]] "
        f"give a cut_on_nm above {0.5 * max(unblocked):g}, or use another filter for these wavelengths"
    )


def uncertain_duration(plan: NewPlan) -> Iterator[str]:
    """A warning if the duration depends on the sample or the lamp."""
    file = plan.schedule.file
    unknown = [
        *(["the gains of each row"] if file.gains_v_per_a == "automatic" else []),
        *(["the averaging time of each row"] if file.averaging is not None else []),
        *(["the warm-up time of the lamp"] if file.warm_up is not None else []),
    ]
    if unknown:
        shortest, longest = duration_range(plan)
        yield (
            f"the duration is an estimate, about {duration_text(shortest)} to {duration_text(longest)}: it depends on "
            f"{' and '.join(unknown)}. {_basis(plan)}A rehearsal is more accurate"
        )


def beyond_longest(file: ScheduleFile, seconds: float) -> Iterator[str]:
    """A warning if the expected duration is longer than the machine time that `[target]` allows."""
    target = file.target
    if target is not None and target.longest_h is not None and seconds > (longest_s := 3600.0 * target.longest_h):
        yield (
            f"the expected duration of {duration_text(seconds)} is {duration_text(seconds - longest_s)} more than "
            f"[target] longest_h = {target.longest_h:g}. Take coarser grids, or fewer readings"
        )


def _basis(plan: NewPlan) -> str:
    """The signal that the estimate of the duration is based on."""
    if not plan.expected_reading_s:
        return ""
    twin = "the twin" if plan.rig.file.twin is not None else "the twin that the rig file describes, with assumed samples,"
    return f"It uses the expected signal of {twin} at up to {SAMPLED_ROWS} poses and wavelengths of each sample. "


def duration_range(plan: NewPlan) -> tuple[float, float]:
    """Approximate range of the duration in s: as short and as long as sample and lamp could make it."""
    timing = Timing(plan.rig.file, plan.expected_reading_s)
    warm_up = plan.schedule.file.warm_up
    waiting = 0.0 if warm_up is None else warm_up.longest_s - shortest_warm_up_s(warm_up.longest_s)
    shortest = longest = plan.seconds
    for sample, rows in _rows_by_sample(plan.rows).items():
        row = plan.templates.measurement(sample)
        typical = timing.similar_reading_s(row)
        fastest, slowest = timing.reading_range_s(row)
        shortest, longest = shortest + rows * (fastest - typical), longest + rows * (slowest - typical)
    return min(shortest, plan.seconds), max(longest, plan.seconds) + waiting


def _rows_by_sample(rows: PlannedRows) -> Counter[str]:
    """Number of measurements and drift checks of each sample."""
    counts: Counter[str] = Counter()
    for piece in rows.pieces:
        if isinstance(piece, MeasurementBlock):
            counts[piece.scan_pass.sample] += len(piece.points)
        elif isinstance(piece, Row) and piece.kind == "drift":
            counts[piece.sample] += 1
    return counts
