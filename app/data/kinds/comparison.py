"""The picture of a comparison, of two datasets (a kind is of one).

Profiles of both in the plane of incidence, with bands, and below them maps of the deviation.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.data.comparison import DatasetComparison, LightComparison
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.figures.curves import (
    COVERAGE,
    PLANE_AXIS,
    curve_of,
    curve_panel,
    curve_parts,
    plane_angle,
    quantity,
    spread,
)
from goniotwin.app.figures.description import Axis, Bar, Figure, Guide, Panel, Series, Span
from goniotwin.app.figures.hemisphere import disc_panel
from goniotwin.app.figures.scale import Scale, linear_ticks, scale_of
from goniotwin.app.figures.style import CURVE_COLOURS, CURVE_SYMBOLS
from goniotwin.arrays import Flags, Floats, Ints

MOST_COMPARED = 4
LEAST_WIDTH_DEG = 10.0
"""Of a profile's axis."""
LARGEST_Z = 4.0
"""z at the ends of a map's colours."""


def describe(found: DatasetComparison, log: bool | None) -> Figure:
    """The description of a comparison, for some of its lights.

    Where no uncertainty is known, the maps have the relative deviation. Where all directions are in the plane of incidence, the
    deviation is drawn over the angle.
    """
    lights = _pictured(found.lights)
    flat = all(_plane(each).all() for each in lights)
    beside = len(lights) == 1 and not flat
    known = any(np.isfinite(each.z).any() for each in lights)
    bar = _deviation_bar(lights, known)
    isotropic = found.first.only.values.isotropic
    panels = [_profiles(found, each, log) for each in lights]
    for each in lights:
        deviation = each.z if known else _relative_deviation(each)
        if flat:
            panels.append(_deviations(each, deviation, bar.label, known))
        else:
            around, shown = each.azimuth_deg - each.light.psi_deg, np.isfinite(deviation)
            panels.append(disc_panel(each.light.sigma_deg, each.polar_deg, around, deviation, shown, bar, isotropic, ""))
    total = f"{found.relative_rms_percent:.3g} %" if any(each.count for each in found.lights) else "no direction"
    with_u = any(np.isfinite(u).any() for each in found.lights for u in (each.u_first, each.u_second))
    return Figure(
        tuple(panels),
        (1.0 + 3.9 * max(len(lights), 2), 4.4 if beside else 5.6 if flat else 6.6),
        2 if beside else len(lights),
        legend=f"{'bands: U (k = 2)' if with_u else 'no uncertainties'}; formula 5: {total} ({found.range})",
        simulated=found.simulated,
        heights=None if beside else (1.0, 0.6 if flat else 1.1),
        widths=(1.25, 1.0) if beside else None,
    )


def describe_light(found: LightComparison, like: Dataset, cut: Ints, x: Floats) -> tuple[Panel, Panel]:
    """Map and cut of the deviations of one light, at the values (n,) of `like`; the cut has those by `cut` over `x` (m,)."""
    known = bool(np.isfinite(found.z).any())
    bar = _deviation_bar([found], known)
    deviation = np.full(like.size, math.nan)
    deviation[found.index] = found.z if known else _relative_deviation(found)
    around, isotropic = like.azimuth_deg - found.light.psi_deg, like.only.values.isotropic
    sigma, there = found.light.sigma_deg, np.isfinite(deviation)
    drawn = disc_panel(sigma, like.polar_deg, around, deviation, there, bar, isotropic, "")
    return drawn, _cut_of_deviations(x, deviation[cut], np.ones(x.size, dtype=bool), bar.label, known)


def _pictured(lights: Sequence[LightComparison]) -> list[LightComparison]:
    """Some lights of the middle wavelength; those with few directions, as of a check of the symmetry, are not drawn."""
    waves = sorted({each.light.wavelength_nm for each in lights if not math.isnan(each.light.wavelength_nm)})
    middle = [each for each in lights if not waves or each.light.wavelength_nm == waves[len(waves) // 2]]
    most = max(each.index.size for each in middle)
    kept = [each for each in middle if 4 * each.index.size >= most]
    return [kept[k] for k in spread(len(kept), MOST_COMPARED)]


def _plane(light: LightComparison) -> Flags:
    """The directions (n,) in the plane of incidence."""
    around = np.radians(light.azimuth_deg - light.light.psi_deg)
    return np.asarray(np.abs(np.sin(np.radians(light.polar_deg)) * np.sin(around)) < 1e-6)


def _signed(light: LightComparison) -> Floats:
    return plane_angle(light.polar_deg, light.azimuth_deg - light.light.psi_deg)


def _relative_deviation(light: LightComparison) -> Floats:
    """Difference over mean (n,), percent; NaN where the mean is not above zero."""
    mean = 0.5 * (light.first + light.second)
    return 100.0 * (light.first - light.second) / np.where(mean > 0.0, mean, np.nan)


def _deviation_bar(lights: Sequence[LightComparison], known: bool) -> Bar:
    """The colours of z, or of relative deviations: white is none, and the ends are so many u or percent."""
    most, label = LARGEST_Z, "z: first less second, in u"
    if not known:
        sizes = np.concatenate([np.abs(_relative_deviation(each)[each.in_range]) for each in lights])
        sizes = sizes[np.isfinite(sizes)]
        most = (float(np.quantile(sizes, 0.98)) if sizes.size else 0.0) or 1.0
        label = "first less second over their mean, %"
    ticks = tuple(linear_ticks(-most, most, 100.0, 24.0))
    return Bar(label, "deviations", Scale("linear", 0.0, most), (-most, most), ticks, "both")


def _profiles(found: DatasetComparison, light: LightComparison, log: bool | None) -> Panel:
    """The values of both over the signed polar angle, where there are any in the plane of incidence; else over theta."""
    plane = _plane(light)
    flat = bool(plane.any())
    here = np.flatnonzero(plane if flat else np.ones(plane.size, dtype=bool))
    x = _signed(light)[here] if flat else light.theta_deg[here]
    both, u_both = (
        np.concatenate([one[here], other[here]])
        for one, other in ((light.first, light.second), (light.u_first, light.u_second))
    )
    scale = scale_of(both, u_both, log)
    pairs = ((found.first, light.first, light.u_first), (found.second, light.second, light.u_second))
    parts = []
    for k, (dataset, values, u) in enumerate(pairs):
        y, margin = values[here], COVERAGE * u[here]
        name = f"{('first', 'second')[k]}: {dataset.name}{f', {dataset.sample}' if dataset.sample else ''}"
        if flat:
            curve = curve_of(x, y, (y - margin, y + margin))
            parts.append(curve_parts(curve, scale, CURVE_COLOURS[k], name, CURVE_SYMBOLS[k], broad=k == 0))
        else:  # at one theta there are values of several phi
            parts.append((Series(x, scale.placed(y), CURVE_COLOURS[k], name, line="none", symbol="dot"), []))
    return curve_panel(
        parts,
        scale,
        _theta_axis(x) if not flat else replace(PLANE_AXIS, label="") if plane.all() else PLANE_AXIS,
        quantity(light.light.transmitted, light.light.back),
        title=f"{light.light}\nformula 5: {light.formula_5}",
    )


def _theta_axis(x: Floats) -> Axis:
    """The axis of angles theta (n,), which has a width."""
    middle, half = 0.5 * float(x.min() + x.max()), 0.5 * max(1.06 * float(np.ptp(x)), LEAST_WIDTH_DEG)
    return Axis("theta, deg", (middle - half, middle + half))


def _deviations(light: LightComparison, deviation: Floats, label: str, known: bool) -> Panel:
    """Deviations over the signed polar angle; those outside the range of formula 5 are paler."""
    return _cut_of_deviations(_signed(light), deviation, light.in_range, label, known)


def _cut_of_deviations(x: Floats, deviation: Floats, chosen: Flags, label: str, known: bool) -> Panel:
    series = tuple(
        Series(x[here], deviation[here], colour, line="none", symbol="dot")
        for here, colour in ((~chosen, "blocked"), (chosen, CURVE_COLOURS[0]))
    )
    spans = (Span(-COVERAGE, COVERAGE, upright=False),) if known else ()
    return Panel(PLANE_AXIS, title=label, series=series, guides=(Guide(0.0, "dim", False, "solid"),), spans=spans)
