"""Warnings of a rehearsal, in addition to those of `check`: values that would be wrong, missing or of little use.

They concern the finite field of view, lobes narrower than the field, gains that are too low or too high, samples without
values, and photodiodes that the drift checks do not cover.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.geometry.arcs import arc_views, observing_arcs, polar_deg
from goniotwin.app.campaign.geometry.directions import ARCS
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.components import INDEPENDENT, words_of
from goniotwin.app.campaign.reduction.drift_checks import unchecked_note
from goniotwin.app.campaign.reduction.points import FLAGS, Tally
from goniotwin.app.campaign.rehearsal.forecast import Forecast, SpreadSummary
from goniotwin.app.campaign.rehearsal.row_statistics import RowStatistics
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.editing import literal
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.campaign.studies.decades import percent
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, Scatterer, arc_direction, evaluate, light_direction, luminance_factor
from goniotwin.twin.optics.bsdf.kinds import REGULAR
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG

NOTICEABLE = 0.01
"""Relative change of a value by the field of view, from which on there is a warning."""
FAINTEST = 1e-3
"""Values below this share of a sample's largest are omitted: far down a flank the relative change is large but irrelevant."""
MAX_POSES = 200
"""Poses examined at each sigma, picked evenly from all."""
FEW_STEPS = 1000.0
"""Steps of the converter: its noise of about one step is a thousandth of such a signal."""
HALF = 0.5


def rehearsal_warnings(plan: Plan, statistics: RowStatistics) -> Iterator[str]:
    """The warnings on the planned measurements, each with a remedy. The plan is one for a virtual rig."""
    yield from _narrow_lobes(plan)
    yield from field_warnings(plan)
    yield from _low_gains(plan, statistics)
    if statistics.saturated:
        yield saturation_text(statistics.saturated, plan.schedule.file, plan.rig.file)
    for flag, rows in sorted(statistics.flagged.items()):
        remedy = FLAGS[flag].remedy if flag in FLAGS else ""
        yield f"{rows} rows have the flag {flag!r}: {remedy or 'see the events of the data file'}"


def field_warnings(plan: Plan) -> Iterator[str]:
    """A warning for each sample with a value that the field of view changes by 1 % or more. The plan is for a virtual rig."""
    model = plan.rig.model()
    assert model is not None
    instrument = replace(model.instrument, sensor=None, obstruction=False, deviations={})
    wavelength = float(np.median(grid_values(plan.schedule.file.wavelength_nm)))
    for name in plan.schedule.file.samples:
        sample = model.samples[name]
        if any(lobe.kind == REGULAR for lobe in sample.lobes):
            continue  # A regular reflection has a warning of its own.
        changes = [
            _largest_change(plan, sigma, poses, sample, instrument, wavelength) for sigma, poses in _poses(plan, name).items()
        ]
        change, where = max(changes, default=(0.0, ""), key=lambda each: abs(each[0]))
        if abs(change) >= NOTICEABLE:
            yield (
                f"the field of view (photodiodes {instrument.field_deg:g} deg, beam {instrument.divergence_deg:.2g} deg, "
                f"illuminated spot) changes the values of {name} by up to {100.0 * change:+.1f} % ({where}). The reduction "
                "corrects this where neighbouring values are close enough. A smaller field or spot reduces the remaining error"
            )


def _poses(plan: Plan, sample: str) -> dict[float, list[tuple[float, float, float, float]]]:
    """The measured poses of a sample, by sigma."""
    poses: dict[float, set[tuple[float, float, float, float]]] = {}
    for row in plan.rows:
        if row.kind == "measure" and row.sample == sample and row.pose is not None:
            poses.setdefault(row.pose[1], set()).add(row.pose)
    return {sigma: sorted(each)[:: max(1, len(each) // MAX_POSES)] for sigma, each in poses.items()}


def _largest_change(
    plan: Plan,
    sigma: float,
    poses: list[tuple[float, float, float, float]],
    sample: Scatterer,
    instrument: Instrument,
    wavelength_nm: float,
) -> tuple[float, str]:
    """The largest relative change of a value by the field at one sigma, and its direction in words."""
    views = [view for pose in poses for view in arc_views(plan.rig.file, pose)]
    zenith, azimuth, theta = (
        np.concatenate([getattr(view, each) for view in views]) for each in ("zenith", "azimuth", "theta")
    )
    directions = arc_direction(zenith, azimuth)
    expected: Floats = evaluate(sample, light_direction(sigma), directions, wavelength_nm)
    seen: Floats = luminance_factor(instrument, sigma, directions, sample, wavelength_nm=wavelength_nm) / np.pi
    bright = (expected > FAINTEST * expected.max(initial=0.0)) & np.isfinite(seen)
    if not bright.any():
        return 0.0, ""
    change = np.where(bright, seen / np.where(bright, expected, 1.0) - 1.0, 0.0)
    worst = int(np.argmax(np.abs(change)))
    return float(change[worst]), f"at sigma {sigma:g} deg, theta {theta[worst]:.1f} deg"


def _narrow_lobes(plan: Plan) -> Iterator[str]:
    model = plan.rig.model()
    assert model is not None
    field_deg = model.instrument.field_deg
    wavelength = float(np.median(grid_values(plan.schedule.file.wavelength_nm)))
    for name in plan.schedule.file.samples:
        sample = model.samples[name]
        if any(lobe.kind == REGULAR for lobe in sample.lobes):
            yield (
                f"{name} has a regular reflection, which a photodiode's field of {field_deg:g} deg does not resolve. Values "
                "that contain it depend on the field, and are not properties of the sample"
            )
        sigmas = [sigma for sigma in grid_values(plan.schedule.file.sigma_deg) if _narrow(sample, sigma, field_deg, wavelength)]
        if sigmas:
            listed = ", ".join(f"{sigma:g}" for sigma in sigmas)
            yield (
                f"{name} has a lobe narrower than the photodiodes' field of {field_deg:g} deg (at sigma {listed} deg). The "
                "measured peak is too low, and the measured width is that of the field. Use a narrower field, or do not trust "
                "the peak"
            )


def _narrow(sample: Scatterer, sigma_deg: float, field_deg: float, wavelength_nm: float) -> bool:
    """Whether the lobe is below half of its peak at both edges of a field centred on it."""
    polar = sigma_deg + np.array([-0.5, 0.0, 0.5]) * field_deg
    light, observer = arc_direction(sigma_deg, 0.0), arc_direction(polar, SPECULAR_AZIMUTH_DEG)
    before, peak, after = evaluate(sample, light, observer, wavelength_nm)
    return bool(max(before, after) < HALF * peak)


def _low_gains(plan: Plan, statistics: RowStatistics) -> Iterator[str]:
    """A warning for each sample whose largest signal is few steps of the converter, if the rig has a higher gain for it."""
    known = plan.rig.file.photodiodes.gains_v_per_a
    for name in plan.schedule.file.mounted:
        steps = {gain: float(each.max()) for (sample, gain), each in statistics.steps.items() if sample == name}
        if not steps or max(steps) == known[-1] or max(steps.values()) >= FEW_STEPS:
            continue
        highest = max(steps)
        better = [gain for gain in known if gain > highest and steps[highest] * gain / highest < statistics.span]
        if better:
            yield (
                f"signal of {name} too low at {highest:g} V/A: its brightest photodiode uses {steps[highest]:.0f} of "
                f"{statistics.span} steps of the converter. Add {literal(better[-1])} V/A to gains_v_per_a"
            )


def saturation_text(values: int, file: ScheduleFile, rig: RigFile) -> str:
    """A warning of saturated values, with what to change in the schedule."""
    used = file.gains_v_per_a
    lower = [each for each in rig.photodiodes.gains_v_per_a if used != "automatic" and each < min(used)]
    remedy = f"Add {literal(lower[-1])} V/A to gains_v_per_a" if lower else "The rig has no lower gain: attenuate the light"
    return f"{values} values are saturated at every gain of the schedule. {remedy}"


def noise_remedy(file: ScheduleFile, rig: RigFile) -> str:
    """What to change in a schedule against noise: a higher gain where the rig has one, else more readings."""
    highest = max(rig.photodiodes.gains_v_per_a)
    if file.gains_v_per_a != "automatic" and highest > max(file.gains_v_per_a):
        return f"Add {literal(highest)} V/A to gains_v_per_a"
    if (table := file.averaging) is not None:
        below = f"relative_uncertainty below {table.relative_uncertainty:g}"
        return f"In [averaging] set longest_s above {table.longest_s:g}, or {below}"
    return f"Set readings above {file.readings}, or add [averaging] for faint light"


def missed_warnings(file: ScheduleFile, rig: RigFile, found: Forecast) -> list[str]:
    """Warnings on the points of a journal that has values: samples without a useful value, and those that miss the target."""
    return [
        *_target_warnings(file, rig, found),
        *(each for name in file.samples for each in _lost_warnings(name, file, rig, found)),
    ]


def unchecked_warnings(unchecked: Mapping[str, tuple[int, ...]]) -> Iterator[str]:
    """Warnings on the photodiodes that drift checks do not cover, by the sample."""
    for name, photodiodes in unchecked.items():
        yield (
            f"{unchecked_note(name, photodiodes)}. Choose a [drift] pose at which more of them have light, or measure the "
            "etalon once more as the last sample, under another name. Its values must be those of the certificate"
        )


def _lost_warnings(name: str, file: ScheduleFile, rig: RigFile, found: Forecast) -> Iterator[str]:
    """A warning for a sample without values, or with settings of which most values are below the detection limit."""
    tally = found.tallies.get(name)
    if tally is None:
        yield f"{name} has no values: no row of the etalon scales its rows"
    elif not tally.good:
        yield f"{name} has no values: of {tally.directions} directions {_reasons(tally)}"
    elif tally.under_range == tally.good:
        yield (
            f"{name} has no value above its noise in any of {tally.good} directions: too little light reaches the "
            f"photodiodes. {noise_remedy(file, rig)}, or check the sample, side and light of the schedule"
        )
    elif below := found.spread[name].mostly_below:
        worst = max(below, key=lambda each: each.below / each.values)
        more = f", and more than half in {len(below) - 1} other settings" if len(below) > 1 else ""
        yield (
            f"{name}: {worst.below} of {worst.values} directions are below the detection limit at {worst.setting}{more}. "
            f"{noise_remedy(file, rig)}, or measure fewer directions away from the lobe"
        )


def _target_warnings(file: ScheduleFile, rig: RigFile, found: Forecast) -> Iterator[str]:
    """A warning for each sample that misses the schedule's target of u in a decade of the peak."""
    for name, decades in found.target.items():
        if all(each.met for each in decades):
            continue
        assert file.target is not None
        assert file.target.relative_u is not None
        values, within = sum(each.values for each in decades), sum(each.within for each in decades)
        largest = found.spread[name].largest
        remedy = (
            noise_remedy(file, rig)
            if largest in (*INDEPENDENT, "dark", "")
            else "More readings do not reduce it: if its u is known to be smaller, state that in the rig file, or ask for less"
        )
        yield (
            f"{name} misses [target] relative_u = {file.target.relative_u:g}: {within} of {values} values from "
            f"{percent(file.target.above_peak_share)} of the peak on reach it. {largest_text(found.spread[name])}{remedy}"
        )


def largest_text(found: SpreadSummary) -> str:
    """The largest component of u near the peak as a sentence; empty without a value."""
    return f"The largest component is {words_of(found.largest)}, {percent(found.share)} of u squared. " if found.largest else ""


def _reasons(tally: Tally) -> str:
    remedies = [FLAGS[flag].remedy for flag in tally.missing if flag]
    return f"{tally.missing_in_words}; {', '.join(remedies) or 'see the events of the journal'}"


def relevant_photodiodes(plan: Plan, row: Row) -> Flags:
    """The photodiodes (n,), the upper arc's first, that may not be saturated in a row.

    Without a sample the beam goes straight on. The arc that it meets may be saturated, unless the campaign measures there.
    """
    arcs = ARCS
    if row.sample == NO_SAMPLE and row.pose is not None and not row.identity.startswith(f"{NO_SAMPLE}/open beam/"):
        arcs = tuple(observing_arcs(plan.schedule.file, row.pose[1]))
    return np.concatenate([np.full(len(polar_deg(plan.rig.file, arc)), arc in arcs) for arc in ARCS])
