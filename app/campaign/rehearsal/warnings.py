"""What a rehearsal warns of beside what `check` does: what would be measured, and be worth little.

By how much the finite field of photodiodes and beam changes a sample's values: warned of before anything is measured.

What a rehearsal finds in its own points: samples that get no value, and why, and photodiodes that nothing watches.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.geometry.arcs import observing_arcs, polar_deg
from goniotwin.app.campaign.geometry.directions import arc_views
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reduction.drift_checks import in_words
from goniotwin.app.campaign.reduction.points import FIRST, Tally
from goniotwin.app.campaign.rehearsal.row_statistics import Watch
from goniotwin.app.campaign.row import NO_SAMPLE, Row
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import Instrument, Scatterer, arc_direction, evaluate, light_direction, luminance_factor
from goniotwin.twin.optics.bsdf.models import REGULAR

NOTICEABLE = 0.01
FAINTEST = 1e-3
"""Values below this share of a sample's greatest are left out: far down a flank the change is large, and of nothing."""
MOST_POSES = 200
"""Looked at of a sigma, picked evenly from all."""


def field_warnings(plan: Plan) -> Iterator[str]:
    """One for each sample of which the field changes a value by 1 % or more. The plan is one for a virtual rig."""
    model = plan.rig.model()
    assert model is not None
    instrument = replace(model.instrument, sensor=None, obstruction=False, deviations={})
    wavelength = float(np.median(grid_values(plan.schedule.file.wavelength_nm)))
    for name in plan.schedule.file.samples:
        sample = model.samples[name]
        if any(lobe.kind == REGULAR for lobe in sample.lobes):
            continue  # which has a warning of its own
        found = [_greatest(plan, sigma, poses, sample, instrument, wavelength) for sigma, poses in _poses(plan, name).items()]
        change, where = max(found, default=(0.0, ""), key=lambda each: abs(each[0]))
        if abs(change) >= NOTICEABLE:
            yield (
                f"the field (photodiodes of {instrument.field_deg:g} deg, a beam of {instrument.divergence_deg:.2g} deg, the "
                f"spot) changes the values of {name} by up to {100.0 * change:+.1f} % ({where}); the uncertainty gets a part "
                "for it where neighbouring values tell how much; a smaller field or spot lessens it"
            )


def _poses(plan: Plan, sample: str) -> dict[float, list[tuple[float, float, float, float]]]:
    """Those that are measured, by sigma."""
    found: dict[float, set[tuple[float, float, float, float]]] = {}
    for row in plan.rows:
        if row.kind == "measure" and row.sample == sample and row.pose is not None:
            found.setdefault(row.pose[1], set()).add(row.pose)
    return {sigma: sorted(poses)[:: max(1, len(poses) // MOST_POSES)] for sigma, poses in found.items()}


def _greatest(
    plan: Plan,
    sigma: float,
    poses: list[tuple[float, float, float, float]],
    sample: Scatterer,
    instrument: Instrument,
    wavelength_nm: float,
) -> tuple[float, str]:
    """The greatest relative change at one sigma, and where that is."""
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


FEW_STEPS = 1000.0
"""Of a converter, of 32767 over zero: its own noise of about a step is then a thousandth of the largest signal."""
HALF = 0.5


def warnings_of(plan: Plan, watch: Watch) -> Iterator[str]:
    """In words, each with what to do."""
    yield from _narrow_lobes(plan)
    yield from field_warnings(plan)
    yield from _coarse_gains(plan, watch)
    if watch.saturated:
        yield (
            f"{watch.saturated} values are over the range at every gain of the schedule: too much light for the photodiode; "
            "add a lower gain to gains_v_per_a"
        )
    for flag, rows in sorted(watch.flagged.items()):
        yield f"{rows} rows have the flag {flag!r}"


def heeded(plan: Plan, row: Row) -> Flags:
    """Which photodiodes (n,), the upper arc's first, may not be over their range in a row.

    With nothing mounted the light goes straight on: the arc that it meets need not see it, unless the campaign is about it.
    """
    upper, lower = (np.full(len(polar_deg(plan.rig.file, arc)), True) for arc in ("upper", "lower"))
    if row.sample == NO_SAMPLE and row.pose is not None and not row.identity.startswith(f"{NO_SAMPLE}/open beam/"):
        arcs = tuple(observing_arcs(plan.schedule.file, row.pose[1]))
        upper &= "upper" in arcs
        lower &= "lower" in arcs
    return np.concatenate([upper, lower])


def _narrow_lobes(plan: Plan) -> Iterator[str]:
    model = plan.rig.model()
    assert model is not None
    field_deg = model.instrument.field_deg
    wavelength = float(np.median(grid_values(plan.schedule.file.wavelength_nm)))
    for name in plan.schedule.file.samples:
        sample = model.samples[name]
        if any(lobe.kind == REGULAR for lobe in sample.lobes):
            yield (
                f"{name} has a regular reflection, which no photodiode's field of {field_deg:g} deg resolves: where it is "
                "seen, its value is the field's and not the sample's"
            )
        sigmas = [sigma for sigma in grid_values(plan.schedule.file.sigma_deg) if _narrow(sample, sigma, field_deg, wavelength)]
        if sigmas:
            yield (
                f"{name} has a lobe narrower than the photodiodes' field of {field_deg:g} deg (at sigma {_listed(sigmas)} "
                "deg): its peak is averaged down and its width is the field's; narrow the field, or do not trust the peak"
            )


def _narrow(sample: Scatterer, sigma_deg: float, field_deg: float, wavelength_nm: float) -> bool:
    """Whether the lobe has fallen below half of its peak at both edges of a field that looks at it."""
    polar = sigma_deg + np.array([-0.5, 0.0, 0.5]) * field_deg
    light, observer = arc_direction(sigma_deg, 0.0), arc_direction(polar, 180.0)
    before, peak, after = evaluate(sample, light, observer, wavelength_nm)
    return bool(max(before, after) < HALF * peak)


def _coarse_gains(plan: Plan, watch: Watch) -> Iterator[str]:
    """Samples whose brightest photodiode stays within few steps of the converter, where the rig has a higher gain for it."""
    known = plan.rig.file.photodiodes.gains_v_per_a
    for name in (plan.schedule.file.etalon, *plan.schedule.file.samples):
        steps = {gain: float(found.max()) for (sample, gain), found in watch.steps.items() if sample == name}
        if not steps or max(steps) == known[-1] or max(steps.values()) >= FEW_STEPS:
            continue
        highest = max(steps)
        better = [gain for gain in known if gain > highest and steps[highest] * gain / highest < watch.span]
        if better:
            yield (
                f"{name} is dark for the gain of {highest:g} V/A: its brightest photodiode gets {steps[highest]:.0f} of "
                f"{watch.span} steps of the converter; add {better[-1]:g} to gains_v_per_a"
            )


def _listed(values: list[float]) -> str:
    return ", ".join(f"{value:g}" for value in values)


REASONS = {
    "shadowed": ("hidden by the mirror unit", "take other angles"),
    "uncertified": ("not in the etalon's certificate", "take one that holds for them"),
    "no-etalon": ("without a signal of the etalon", "take one that scatters on the side that the photodiodes look at"),
    "clipped": ("over the range at every gain", "add a lower gain"),
    "dead": ("of dead photodiodes", "mend them"),
    "drift": ("flagged for drift", "see the drift checks"),
}
"""By the flags of points, in words, with what to do."""


def worthless(file: ScheduleFile, tallies: Mapping[str, Tally], unwatched: Mapping[str, tuple[int, ...]]) -> Iterator[str]:
    """A warning for each."""
    for name in file.samples:
        tally = tallies.get(name)
        if tally is None:
            yield f"{name} gets no value at all: there is no row of the etalon that it could be compared with"
        elif not tally.good:
            yield f"{name} gets no value at all: of {tally.directions} directions {_why(tally)}"
        elif tally.under_range == tally.good:
            yield (
                f"{name} gets no value that is more than its noise in any of {tally.good} directions: it sends too "
                "little light there; take a higher gain or more readings, or see that sample, side and light are right"
            )
    for name, photodiodes in unwatched.items():
        yield (
            f"{in_words(name, photodiodes)}; take a [drift] pose at which more of them have light, or end with the etalon once "
            "more as a last sample under another name, whose values have to be the certificate's"
        )


def _why(tally: Tally) -> str:
    found = {flag: tally.flagged[flag] for flag in FIRST if tally.flagged[flag]}
    told = [f"{count} are {REASONS[flag][0]}" for flag, count in found.items()]
    left = tally.directions - sum(found.values())
    if left:
        told.append(f"{left} have none for another reason")
    return f"{', '.join(told)}; {', '.join(REASONS[flag][1] for flag in found) or 'look at the journal'}"
