"""The hole that is dark in part, in transmitted light: its etalon is lit from the other side, where another corner is dark.

In reflected light sample and etalon have one place of the slit's image, and it cancels but for their heights (angles.py). Where
the open beam is the scale, the etalon has it twice, with both signs: what is left is that of the direction, less that of the
specular one, where the scale is. An alignment knows the image's place: its mean effect is corrected, and u is what is left.
"""

import math
import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Component, Dense, Effects
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity, quantity
from goniotwin.app.campaign.measurement_model.lit_share import MODES, SLIT_IMAGE, RigLaw, lit_effects, lit_modes
from goniotwin.app.campaign.measurement_model.pose import LIGHT, Views
from goniotwin.app.campaign.reduction.angles import views_of_points
from goniotwin.app.campaign.reduction.optical_paths import incidence_deg
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.rig.inputs import ILLUMINATION_SHIFT, MIRROR_SHIFT, MIRROR_TILT
from goniotwin.arrays import Flags, Floats
from goniotwin.keys import MEASURED
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, SPECULAR_AZIMUTH_DEG

OF_MODE = re.compile(rf"(?<={SLIT_IMAGE})\[\d+\]")
"""The number of a mode, in an input's name."""
LEAST_PART = 0.05
"""Of a smaller part in a variance the interval is that of a normal law to 1 %."""
HALF = 0.475
"""Half of the probability of an interval."""
LEAST_EFFECT = 1e-9
"""Less is rounding: the hole is lit everywhere."""


def slit_image_effects(points: BsdfPoints, settings: ReductionSettings, by_beam: Flags) -> Effects | None:
    """What the place of the slit's image does to transmitted light; the open beam is the scale of points `by_beam` (n,)."""
    effect = _by_place(points, settings, by_beam)
    if _law(settings).found:
        effect[:, 0] = 0.0  # the mean: it is corrected
    if not effect.any() or np.abs(effect).max() < LEAST_EFFECT:
        return None
    modes = [_mode(k, settings) for k in range(1, MODES + 1)]
    return Effects(points.bsdf, {}, (), [Dense(modes, effect)])


def correct_slit_image(points: BsdfPoints, settings: ReductionSettings, by_beam: Flags) -> BsdfPoints:
    """Correct transmitted light for what the place of the slit's image does to it on average, where an alignment knows it."""
    if not (points.transmitted.any() and _law(settings).found):
        return points
    return points.scaled(np.exp(-_by_place(points, settings, by_beam)[:, 0]))


def _law(settings: ReductionSettings) -> RigLaw:
    return RigLaw.of(settings.rig, settings.alignment)


def _by_place(points: BsdfPoints, settings: ReductionSettings, by_beam: Flags) -> Floats:
    """The effects (n, modes) on the logarithms of points."""
    rig, chosen = _law(settings), np.flatnonzero(points.transmitted)
    effect = np.zeros((points.size, MODES))
    if not chosen.size or not any(rig.half_widths[: len(LIGHT)]):
        return effect
    views = views_of_points(points.where(chosen))
    effect[chosen] = _over_opposite(rig, views)
    if (scaled := by_beam[chosen]).any():
        specular = np.radians(incidence_deg(points.where(chosen)))
        azimuth, reverse = np.full(chosen.size, math.radians(SPECULAR_AZIMUTH_DEG)), np.zeros(chosen.size, dtype=bool)
        there = replace(views, polar=specular, azimuth=azimuth, reverse=reverse)
        effect[chosen] -= np.where(scaled[:, None], _over_opposite(rig, there), 0.0)
    return effect


def _over_opposite(rig: RigLaw, views: Views) -> Floats:
    """The effects (n, modes) on the light at sigma over that at 180 deg - sigma."""
    return lit_effects(rig, views, views.sigma_deg) - lit_effects(rig, views, HALF_TURN_DEG - views.sigma_deg)


def interval_by_modes(points: BsdfPoints, effects: Effects, settings: ReductionSettings) -> BsdfPoints:
    """The points with the intervals of the law of the place, where it has a part in u, and of all else, which is normal."""
    total, of_place = points.u_bsdf**2, points.stated[SLIT_IMAGE]
    chosen = np.flatnonzero(points.good & (of_place > LEAST_PART * total))
    value, u = points.bsdf[chosen], points.u_bsdf[chosen]
    rest = np.sqrt(np.maximum(total - of_place, 0.0)[chosen]) / value
    modes = lit_modes(_law(settings))
    ends = modes.quantiles(effects.dense[0].sensitivity[chosen], rest, (0.5 - HALF, 0.5 + HALF))
    coverage = points.coverage.copy()
    # A value that is too high has its truth below it.
    coverage[chosen] = np.stack([ends[:, 1], -ends[:, 0]], axis=1) * (value / u)[:, None]
    return replace(points, coverage=coverage)


def deviate_by_modes(effects: Effects, weight: Floats, u: float, error: float, settings: ReductionSettings) -> float:
    """The normal deviate of `deviate_of_sum`, by the effects of the place on the values."""
    of_sum = (weight * effects.value) @ effects.dense[0].sensitivity
    rest = math.sqrt(max(u**2 - float(of_sum @ of_sum), 0.0))
    return lit_modes(_law(settings)).deviate(of_sum, rest, error)


def _mode(number: int, settings: ReductionSettings) -> InputQuantity:
    table, inputs = settings.rig.uncertainty, (MIRROR_TILT, MIRROR_SHIFT, ILLUMINATION_SHIFT)
    source, origin = ", ".join(map(table.source, inputs)), table.origin(*inputs)
    if settings.alignment is not None and (found := settings.alignment.of_place) is not None:
        source, origin = found.source, MEASURED
    known = quantity(MIRROR_TILT, table, f"{SLIT_IMAGE}[{number}]")
    return replace(known, unit="1", u=1.0, distribution="normal", source=source, origin=origin)


def in_one_line(components: Sequence[Component]) -> list[Component]:
    """The components of a value or a sum, with the modes of the image's place as one, by itself and with each height."""
    lines: dict[str, list[Component]] = {}
    for each in components:
        lines.setdefault(OF_MODE.sub("", each.name), []).append(each)
    found = [parts[0] if len(parts) == 1 else _together(name, parts) for name, parts in lines.items()]
    return sorted(found, key=lambda each: -each.u)


def _together(name: str, parts: Sequence[Component]) -> Component:
    u, one = math.hypot(*(each.u for each in parts)), parts[0].input
    assert one is not None
    return Component(name, u, u / one.u if one.u else 0.0, replace(one, name=name))
