"""The finite field of view: a component of each value's uncertainty, estimated from the measured values around it.

Illuminated spot, exit pupil and a photodiode's acceptance make each value a mean over directions. To second order the mean
differs from the value at its centre by half the variance of the directions times the second derivatives, along the arc and
across it. Both are taken from the values nearby: a parabola through their logarithms, which follows a Gaussian lobe exactly,
or, where some are lost in their noise, through the values themselves. Across the arc this needs measurements at other beta,
near enough. Without them the lobe is assumed to be rotationally symmetric about the specular direction (for transmitted light:
about the direction of regular transmission). The sum of the moduli of both derivatives is taken as the standard uncertainty;
nothing is corrected. See docs/decisions/0015-the-fields-uncertainty.md.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.geometry.directions import is_lower, polar_from_zenith, scan_plane_deg
from goniotwin.app.campaign.reduction.components import DETECTED
from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.rig import nominal_instrument
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import Instrument
from goniotwin.twin.optics.geometry.coordinates import round_deg, signed_polar

MAX_NEIGHBOURS = 24
"""Largest number of neighbours on each side."""
NEAR = 1.0 + 1e-9
WINDOW = 5.0
"""Values within so many standard deviations of the field's directions are fitted together: the field does not resolve less."""
MAX_DISTANCE_RAD = math.radians(6.0)
"""Neighbours further away have no information on the curvature; photodiodes are 5 deg apart."""
RADIAL = 0.7
"""An arc passes close enough to the lobe's centre where theta changes by this share of the way along it."""
MIN_SINE = 0.1
"""Smaller circles about the normal are no neighbourhood across the arc."""
CIRCLE_DECIMALS = 8
"""Decimals of a radian to which the values of one circle about the normal have the same polar angle."""
NOISE_MARGIN = 3.0
"""Standard uncertainties by which a second derivative is reduced before a first derivative is taken from it."""
CHUNK_POINTS = 20_000
"""Points processed together; more if they are of one wavelength and incidence."""


@dataclass(frozen=True)
class Parabola:
    """First and second derivatives at each value (n,); NaN where there are too few neighbours.

    `leverage` is the standard uncertainty of the second derivative if that of all values is 1.
    """

    first: Floats
    second: Floats
    leverage: Floats


def local_parabola(line: Ints, x: Floats, y: Floats, window: float, longest: float) -> Parabola:
    """Fit a parabola to each value and the values of its line within `window`, by least squares.

    If the window has no value on one side, it is widened until there is one on each side, to `longest` at most; or, at the end
    of a line, to two values on one side, within twice `longest`. The values are sorted by `line`, and within it by `x`, whose
    values are all different. The result is NaN where one of the fitted values is NaN.
    """
    half = reach(line, x, window, longest)
    width = np.where(np.isfinite(half), half, 1.0)
    powers, products = np.zeros((5, x.size)), np.zeros((3, x.size))
    powers[0], products[0] = 1.0, y
    for step in range(1, min(MAX_NEIGHBOURS, x.size - 1) + 1):
        together = line[step:] == line[:-step]
        apart = x[step:] - x[:-step]
        reached = False
        for here, there, sign in ((slice(None, -step), slice(step, None), 1.0), (slice(step, None), slice(None, -step), -1.0)):
            place = sign * apart / width[here]
            taken = together & (np.abs(place) <= NEAR)
            if not taken.any():
                continue
            reached = True
            place, value, power = np.where(taken, place, 0.0), np.where(taken, y[there], 0.0), taken.astype(float)
            for k in range(5):
                powers[k, here] += power
                if k < 3:
                    products[k, here] += value * power
                power = power * place
        if not reached:
            break
    # Normal equations of three unknowns, solved by cofactors for all values at once.
    s0, s1, s2, s3, s4 = powers
    t0, t1, t2 = products
    c02, c12, c22 = s1 * s3 - s2 * s2, s1 * s2 - s0 * s3, s0 * s2 - s1 * s1
    c11, c01 = s0 * s4 - s2 * s2, s2 * s3 - s1 * s4
    determinant = s2 * c02 + s3 * c12 + s4 * c22
    one = 1.0 / np.where(np.isfinite(half), determinant, np.nan)
    slope, bend = (c01 * t0 + c11 * t1 + c12 * t2) * one, (c02 * t0 + c12 * t1 + c22 * t2) * one
    return Parabola(slope / width, 2.0 * bend / width**2, 2.0 * np.sqrt(c22 * one) / width**2)


def reach(line: Ints, x: Floats, window: float, longest: float) -> Floats:
    """Half width (n,) of the window of each value's parabola; NaN where there are too few neighbours."""
    after = [_apart(line, x, step) for step in (1, 2)]
    before = [_apart(-line[::-1], -x[::-1], step)[::-1] for step in (1, 2)]
    both = np.maximum(after[0], before[0])
    one = np.minimum(after[1], before[1])
    needed = np.where(both <= longest * NEAR, both, np.where(one <= 2.0 * longest * NEAR, one, np.nan))
    return np.maximum(needed, window)


def _apart(line: Ints, x: Floats, step: int) -> Floats:
    """Distance to the value `step` places further along the line; infinite where there is none."""
    apart = np.full(x.size, np.inf)
    if x.size > step:
        same = line[step:] == line[:-step]
        apart[:-step] = np.where(same, x[step:] - x[:-step], np.inf)
    return apart


def field_variance(instrument: Instrument) -> float:
    """Variance of the directions that one value averages over, along either axis about the specular direction, in rad^2.

    A disc contributes a quarter of its radius squared, a square a twelfth of its side squared. The contributions: the exit
    pupil; the photodiode's cone, or its disc and the spot where these are narrower; and the spot, over which the direction of
    the light differs.
    """
    pupil = (instrument.pupil_radius_mm / instrument.pupil_distance_mm) ** 2 / 4.0
    cone = math.tan(math.radians(0.5 * instrument.field_deg)) ** 2 / 4.0
    disc = (0.5 * instrument.detector_diameter_mm / instrument.arc_radius_mm) ** 2 / 4.0
    side = instrument.spot_side_mm**2 / 12.0
    near, far = 1.0 / instrument.arc_radius_mm, 1.0 / instrument.pupil_distance_mm
    return pupil + min(cone + side * far**2, disc + side * (near + far) ** 2)


def correct_field_of_view(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Add the component `field` of the uncertainty; 0, and a flag, where it is unknown. The values are not corrected yet."""
    u_field = field_uncertainty(points, field_variance(nominal_instrument(settings.rig)))
    components = {**points.components, "field": np.nan_to_num(u_field) ** 2}
    return replace(points, components=components).flagged({"field": points.good & np.isnan(u_field)})


def field_uncertainty(points: BsdfPoints, variance: float) -> Floats:
    """Field component (n,) of the uncertainty in 1/sr, for directions of this `variance` in rad^2; NaN where unknown."""
    result = np.full(points.bsdf.size, np.nan)
    chosen = np.flatnonzero(points.good)
    # Process per wavelength and incidence, in chunks, to bound memory.
    lights = np.stack([points.wavelength_nm[chosen], points.sigma_deg[chosen]])
    order = chosen[np.lexsort(lights)]
    changes = np.any(np.diff(lights[:, np.lexsort(lights)], axis=1) != 0.0, axis=0)
    begin = 0
    for end in [*(np.flatnonzero(changes) + 1).tolist(), order.size]:
        if end - begin >= CHUNK_POINTS or end == order.size > begin:
            part = order[begin:end]
            values, which = merge_directions(points.where(part))
            result[part] = _uncertainty(values, variance)[which]
            begin = end
    return result


@dataclass(frozen=True)
class Directions:
    """Mean values by direction and setting, in order along the arcs.

    `setting` numbers the sets of wavelength, sigma, gamma, side and light; `plane` numbers the planes of the arc in each of
    them. `polar`, in rad, is positive on one side of the normal and negative on the other. `middle` is the cosine of the angle
    to the lobe's centre, and `slope` its derivative along the arc.
    """

    setting: Ints
    plane: Ints
    polar: Floats
    azimuth: Floats
    middle: Floats
    slope: Floats
    bsdf: Floats
    u_bsdf: Floats


def merge_directions(points: BsdfPoints) -> tuple[Directions, Ints]:
    """Average good points of the same direction; gives the means, and for each point the index of its mean."""
    plane = scan_plane_deg(points.azimuth_deg)
    signed = round_deg(signed_polar(polar_from_zenith(points.zenith_deg), points.azimuth_deg, plane))
    setting = (points.back, points.transmitted, points.gamma_deg, points.sigma_deg, points.wavelength_nm)
    keys = [signed, plane, *(round_deg(each) for each in setting)]
    order = np.lexsort(keys)
    changes = np.array([np.diff(each[order], prepend=np.nan) != 0.0 for each in keys])
    first = np.any(changes, axis=0)
    number = np.cumsum(first) - 1
    which = np.empty(order.size, dtype=np.int64)
    which[order] = number
    counts = np.bincount(number)
    start = order[first]
    p, a = np.radians(signed[start]), np.radians(plane[start])
    up = np.where(is_lower(points.zenith_deg[start]), -1.0, 1.0)
    sigma = np.radians(points.sigma_deg[start])
    # Specular direction or regular transmission: both have -sin sigma along x.
    x, z = -np.sin(sigma), np.where(points.transmitted[start], -1.0, 1.0) * np.cos(sigma)
    values = Directions(
        setting=np.cumsum(np.any(changes[2:], axis=0))[first],
        plane=np.cumsum(np.any(changes[1:], axis=0))[first],
        polar=p,
        azimuth=a,
        middle=x * np.sin(p) * np.cos(a) + z * up * np.cos(p),
        slope=x * np.cos(p) * np.cos(a) - z * up * np.sin(p),
        bsdf=np.bincount(which, weights=points.bsdf) / counts,
        u_bsdf=np.sqrt(np.bincount(which, weights=points.u_bsdf**2) / counts),
    )
    return values, which


def _uncertainty(values: Directions, variance: float) -> Floats:
    """Half the variance times the moduli of the second derivatives along and across, 1/sr."""
    light = values.bsdf > DETECTED * values.u_bsdf
    relative = np.where(light, values.u_bsdf / np.where(light, values.bsdf, 1.0), 0.0)
    logarithm = np.where(light, np.log(np.where(light, values.bsdf, 1.0)), np.nan)
    window = WINDOW * math.sqrt(variance)
    curved = _second_derivatives(values, logarithm, relative, window, square=True) * values.bsdf
    if np.isfinite(curved).all():
        return 0.5 * variance * curved
    plain = _second_derivatives(values, values.bsdf, values.u_bsdf, window, square=False)
    # A value with light next to one without, further apart than the field is wide: the shape of the lobe is unknown.
    plain[light & ~(reach(values.plane, values.polar, window, MAX_DISTANCE_RAD) <= window)] = np.nan
    return 0.5 * variance * np.where(np.isfinite(curved), curved, plain)


def _second_derivatives(values: Directions, y: Floats, u: Floats, window: float, *, square: bool) -> Floats:
    """Sum of the moduli of both second derivatives; `y` is the BSDF, or, with `square`, its logarithm: then over the BSDF."""
    along = local_parabola(values.plane, values.polar, y, window, MAX_DISTANCE_RAD)
    own = along.second + (along.first**2 if square else 0.0)
    across = _measured_across(values, y, window, along, square=square)
    return np.abs(own) + np.abs(
        np.where(np.isfinite(across), across, _by_symmetry(values, along, own, u, window, square=square))
    )


def _measured_across(values: Directions, y: Floats, window: float, along: Parabola, *, square: bool) -> Floats:
    """Second derivative across the arc from measurements at other beta, along a circle about the normal.

    It is corrected for the curvature of that circle against a great circle.
    """
    polar = np.round(np.abs(values.polar), CIRCLE_DECIMALS)
    azimuth = np.where(values.polar < 0.0, values.azimuth + math.pi, values.azimuth)
    order = np.lexsort((azimuth, polar, values.setting))
    order = order[np.sin(polar[order]) > max(MIN_SINE, 2.0 * window)]
    circle = np.cumsum((np.diff(polar[order], prepend=-1.0) != 0.0) | (np.diff(values.setting[order], prepend=-1) != 0))
    circles = local_parabola(circle, (azimuth * np.sin(polar))[order], y[order], window, MAX_DISTANCE_RAD)
    result = np.full(polar.size, np.nan)
    bent = along.first[order] / np.tan(values.polar[order])
    result[order] = circles.second + bent + (circles.first**2 if square else 0.0)
    return result


def _by_symmetry(values: Directions, along: Parabola, own: Floats, u: Floats, window: float, *, square: bool) -> Floats:
    """Second derivative across the arc for a lobe that depends on theta alone.

    With y' and y'' the derivatives along theta, and t the change of theta along the arc: first = y' t,
    second = y'' t^2 + y' cot(theta) (1 - t^2), and the sum of the two second derivatives is y'' + y' cot(theta).
    """
    theta = np.arccos(np.clip(values.middle, -1.0, 1.0))
    sine = np.maximum(np.sin(theta), 1e-9)
    cot = np.cos(theta) / sine
    t = np.clip(-values.slope / sine, -1.0, 1.0)
    radial = np.abs(t) >= RADIAL
    turned = np.where(radial, t, 1.0)
    first = along.first / turned
    second = (along.second - first * cot * (1.0 - t**2)) / turned**2
    # For an arc that passes beside the centre y' follows from the second derivative, if y is a parabola in theta. A second
    # derivative within its noise is not used.
    level = t**2 / np.maximum(theta, window) + (1.0 - t**2) / np.tan(np.clip(theta, window, math.radians(60.0)))
    certain = np.sign(along.second) * np.maximum(np.abs(along.second) - NOISE_MARGIN * along.leverage * u, 0.0)
    first = np.where(radial, first, certain / level)
    second = np.where(radial, second, first / np.maximum(theta, window))
    across = second + first * cot + (first**2 if square else 0.0) - own
    # At the lobe's centre all directions are equal. Close to it the first derivative over theta alone is not reliable.
    larger = np.where(np.abs(own) > np.abs(across), own, across)
    return np.where(theta <= 0.25 * window, own, np.where(theta <= window, larger, across))
