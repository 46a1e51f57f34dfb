"""By how much the finite field of photodiodes and beam changes a sample's values: warned of before anything is measured."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.reducing.arcs import arc_views
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, Scatterer, arc_direction, evaluate, light_direction, luminance_factor
from goniotwin.twin.optics.bsdf import REGULAR

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
