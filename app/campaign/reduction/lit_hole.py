"""The hole that is dark in part, in transmitted light: its etalon is lit from the other side, where another corner is dark.

In reflected light sample and etalon have one place of the slit's image, and it cancels. Where the open beam is the scale, the
etalon has it twice, with both signs: what is left is that of the direction, less that of the specular one, where the scale is.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Component, Dense, Effects
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.campaign.measurement_model.lit_share import MODES, lit_effects, lit_modes
from goniotwin.app.campaign.measurement_model.pose import LIGHT, rig_inputs, standard_uncertainties
from goniotwin.app.campaign.reduction.angles import views_of_points
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.rig import nominal_instrument
from goniotwin.app.rig.inputs import ILLUMINATION_SHIFT, MIRROR_SHIFT, MIRROR_TILT
from goniotwin.app.rig.uncertainty import UncertaintyTable
from goniotwin.arrays import Flags
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, incidence_deg

SLIT_IMAGE = "slit_image"
"""The component of the light's place, of values and of the closure."""
LEAST_PART = 0.05
"""Of a smaller part in a variance the interval is that of a normal law to 1 %."""
HALF = 0.475
"""Half of the probability of an interval."""
LEAST_EFFECT = 1e-9
"""Less is rounding: the hole is lit everywhere."""


def _modes(settings: ReductionSettings) -> tuple[Instrument, tuple[float, ...]]:
    """What the modes of the place are made from: the nominal instrument, and half widths of the rig's inputs."""
    half_widths = math.sqrt(3.0) * standard_uncertainties(rig_inputs(settings.rig.uncertainty))
    return nominal_instrument(settings.rig), tuple(half_widths.tolist())


def slit_image_effects(points: BsdfPoints, settings: ReductionSettings, by_beam: Flags) -> Effects | None:
    """What the place of the slit's image does to transmitted light; the open beam is the scale of points `by_beam` (n,)."""
    rig, chosen = _modes(settings), points.transmitted
    if not chosen.any() or not any(rig[1][: len(LIGHT)]):
        return None
    views = views_of_points(points)
    effect = np.zeros((points.size, MODES))
    poses = np.stack([points.sigma_deg, points.gamma_deg, views.lower, views.reverse], axis=1)
    for sigma, gamma, lower, reverse in np.unique(poses[chosen], axis=0).tolist():
        here = np.flatnonzero(chosen & (poses == (sigma, gamma, lower, reverse)).all(axis=1))
        pose = sigma, gamma, bool(lower)
        effect[here] = lit_effects(*rig, (*pose, bool(reverse)), np.degrees(views.polar[here]), points.azimuth_deg[here])
        specular = np.array([incidence_deg(sigma)]), np.array([SPECULAR_AZIMUTH_DEG])
        effect[here] -= np.where(by_beam[here, None], lit_effects(*rig, (*pose, False), *specular), 0.0)
    if np.abs(effect).max() < LEAST_EFFECT:
        return None
    modes = [_mode(f"{SLIT_IMAGE}[{k}]", 1.0, settings.rig.uncertainty) for k in range(1, MODES + 1)]
    return Effects(points.bsdf, {}, (), [Dense(modes, effect)])


def interval_by_modes(points: BsdfPoints, effects: Effects, settings: ReductionSettings) -> BsdfPoints:
    """The points with the intervals of the law of the place, where it has a part in u, and of all else, which is normal."""
    total, of_place = points.u_bsdf**2, points.stated[SLIT_IMAGE]
    chosen = np.flatnonzero(points.good & (of_place > LEAST_PART * total))
    value, u = points.bsdf[chosen], points.u_bsdf[chosen]
    rest = np.sqrt(np.maximum(total - of_place, 0.0)[chosen]) / value
    ends = lit_modes(*_modes(settings)).quantiles(effects.dense[0].sensitivity[chosen], rest, (0.5 - HALF, 0.5 + HALF))
    coverage = points.coverage.copy()
    # A value that is too high has its truth below it.
    coverage[chosen] = np.stack([ends[:, 1], -ends[:, 0]], axis=1) * (value / u)[:, None]
    return replace(points, coverage=coverage)


def _mode(name: str, u: float, table: UncertaintyTable) -> InputQuantity:
    inputs = MIRROR_TILT, MIRROR_SHIFT, ILLUMINATION_SHIFT
    source, origin = ", ".join(map(table.source, inputs)), table.origin(*inputs)
    return replace(quantity(MIRROR_TILT, table, name), unit="1", u=u, distribution="normal", source=source, origin=origin)


def in_one_line(components: Sequence[Component], table: UncertaintyTable) -> list[Component]:
    """The components of a value or a sum, with the modes of the image's place as one."""
    of_place = [each for each in components if each.name.startswith(f"{SLIT_IMAGE}[")]
    u = math.hypot(*(each.u for each in of_place))
    if not u:
        return list(components)
    others = [each for each in components if each not in of_place]
    return sorted([*others, Component(SLIT_IMAGE, u, u, _mode(SLIT_IMAGE, 1.0, table))], key=lambda each: -each.u)
