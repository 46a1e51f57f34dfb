"""What a rehearsal warns of beside what `check` does: what would be measured, and be worth little."""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.planning.sides import looking_arcs, polar_deg
from goniotwin.app.campaign.rehearsing.field_warning import field_warnings
from goniotwin.app.campaign.rehearsing.watch import Watch
from goniotwin.app.campaign.row import NOTHING, Row
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.arrays import Flags
from goniotwin.twin.optics import Scatterer, arc_direction, evaluate
from goniotwin.twin.optics.bsdf import REGULAR

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
    if row.sample == NOTHING and row.pose is not None and not row.identity.startswith(f"{NOTHING}/open beam/"):
        arcs = tuple(looking_arcs(plan.schedule.file, row.pose[1]))
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
