"""What the finite field of photodiodes and beam does to a value: a part of its uncertainty, from the measured values about it.

Illuminated spot, exit pupil and a photodiode's acceptance make each value a mean over directions. To second order that adds
half of the directions' variance times the second derivatives, along the arc and across it. Both are taken from the values
nearby: a parabola through their logarithms, which follows a Gaussian lobe exactly, or through themselves where some are lost
in their noise. Across the arc that needs other beta near enough; where there are none the lobe is taken to be rotationally
symmetric about the specular direction (of transmitted light: the direction straight on). The moduli of the two are added,
and taken for a standard uncertainty: nothing is corrected. See docs/decisions/0015-the-fields-uncertainty.md.

First and second derivatives of measured values along a line, each from the parabola through its nearest neighbours.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.schedule.grids import DECIMALS
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics import Instrument

MOST = 24
"""Neighbours on each side."""
NEAR = 1.0 + 1e-9


@dataclass(frozen=True)
class Parabola:
    """At each value the first and second derivative; NaN where there are too few neighbours. `leverage` is the standard
    uncertainty of the second derivative where that of all values is 1.
    """

    first: Floats
    second: Floats
    leverage: Floats


def local_parabola(line: Ints, x: Floats, y: Floats, window: float, longest: float) -> Parabola:
    """The least squares of each value and of those of its line within `window`.

    Where that holds none on one of its sides it is as much wider as one on each side needs, `longest` at most; or two on one
    side, within twice that, at the end of a line. Values are in order of `line` and, in it, of `x`, which are all different;
    where one that takes part is NaN there is no answer.
    """
    half = reach(line, x, window, longest)
    width = np.where(np.isfinite(half), half, 1.0)
    powers, products = np.zeros((5, x.size)), np.zeros((3, x.size))
    powers[0], products[0] = 1.0, y
    for step in range(1, min(MOST, x.size - 1) + 1):
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
    # The normal equations by cofactors: three by three, of every value at once.
    s0, s1, s2, s3, s4 = powers
    t0, t1, t2 = products
    c02, c12, c22 = s1 * s3 - s2 * s2, s1 * s2 - s0 * s3, s0 * s2 - s1 * s1
    c11, c01 = s0 * s4 - s2 * s2, s2 * s3 - s1 * s4
    determinant = s2 * c02 + s3 * c12 + s4 * c22
    one = 1.0 / np.where(np.isfinite(half), determinant, np.nan)
    slope, bend = (c01 * t0 + c11 * t1 + c12 * t2) * one, (c02 * t0 + c12 * t1 + c22 * t2) * one
    return Parabola(slope / width, 2.0 * bend / width**2, 2.0 * np.sqrt(c22 * one) / width**2)


def reach(line: Ints, x: Floats, window: float, longest: float) -> Floats:
    """How far away the values may be that take part in the parabola of each; NaN where there are too few."""
    after = [_apart(line, x, step) for step in (1, 2)]
    before = [_apart(-line[::-1], -x[::-1], step)[::-1] for step in (1, 2)]
    both = np.maximum(after[0], before[0])
    one = np.minimum(after[1], before[1])
    needed = np.where(both <= longest * NEAR, both, np.where(one <= 2.0 * longest * NEAR, one, np.nan))
    return np.maximum(needed, window)


def _apart(line: Ints, x: Floats, step: int) -> Floats:
    """The distance to the value `step` further on along the line; infinite where there is none."""
    apart = np.full(x.size, np.inf)
    if x.size > step:
        same = line[step:] == line[:-step]
        apart[:-step] = np.where(same, x[step:] - x[:-step], np.inf)
    return apart


WINDOW = 5.0
"""Values within so many standard deviations of the field's directions are taken together: less it does not tell apart."""
LONGEST_RAD = math.radians(6.0)
"""Neighbours further away say nothing of the curvature; photodiodes are 5 deg apart."""
DETECTED = 3.0
RADIAL = 0.7
"""An arc goes through the lobe's middle, near enough, where theta changes by so much of the way along it."""
LEAST_SINE = 0.1
"""Circles about the normal that are smaller than this are no neighbourhood across the arc."""
SURE = 3.0
AT_ONCE = 20_000
"""Points, or more where they are of one wavelength and incidence."""


def field_variance(instrument: Instrument) -> float:
    """Of the directions that one value is a mean of, about the specular direction, along either axis: rad^2.

    Of discs a quarter of the radius squared, of squares a twelfth of the side squared: cone, or disc and spot seen from each
    other where these are narrower; the exit pupil; and the spot, from which the light's direction differs.
    """
    pupil = (instrument.pupil_radius_mm / instrument.pupil_distance_mm) ** 2 / 4.0
    cone = math.tan(math.radians(0.5 * instrument.field_deg)) ** 2 / 4.0
    disc = (0.5 * instrument.detector_diameter_mm / instrument.arc_radius_mm) ** 2 / 4.0
    side = instrument.spot_side_mm**2 / 12.0
    near, far = 1.0 / instrument.arc_radius_mm, 1.0 / instrument.pupil_distance_mm
    return pupil + min(cone + side * far**2, disc + side * (near + far) ** 2)


def add_field_uncertainty(points: BsdfPoints, rig: RigFile) -> BsdfPoints:
    """The points with the field's part, `u_field`, in their uncertainty `u_bsdf`; NaN and not in it where nobody can tell."""
    u_field = field_uncertainty(points, field_variance(nominal_instrument(rig)))
    return replace(points, u_field=u_field, u_bsdf=np.hypot(points.u_bsdf, np.nan_to_num(u_field)))


def field_uncertainty(points: BsdfPoints, variance: float) -> Floats:
    """Of a sample's points, for a field whose directions have this `variance` (rad^2): 1/sr, NaN where it cannot be told."""
    result = np.full(points.bsdf.size, np.nan)
    chosen = np.flatnonzero(points.good)
    # Light of one wavelength and incidence says nothing of another's; by and by, for a campaign may be long.
    lights = np.stack([points.wavelength_nm[chosen], points.sigma_deg[chosen]])
    order = chosen[np.lexsort(lights)]
    changes = np.any(np.diff(lights[:, np.lexsort(lights)], axis=1) != 0.0, axis=0)
    begin = 0
    for end in [*(np.flatnonzero(changes) + 1).tolist(), order.size]:
        if end - begin >= AT_ONCE or end == order.size > begin:
            part = order[begin:end]
            values, which = merge_directions(points.where(part))
            result[part] = _uncertainty(values, variance)[which]
            begin = end
    return result


@dataclass(frozen=True)
class Directions:
    """One for each direction and light, in order along the arcs: `setting` numbers what was the same, `plane` the arc's plane
    too. `polar` is positive on one side of the normal and negative on the other, rad; `middle` the cosine of the angle to the
    lobe's middle, and `slope` its derivative along the arc.
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
    """Of points that are good, and for each point the number of its value: the mean of those in one direction."""
    polar = np.where(points.zenith_deg > 90.0, 180.0 - points.zenith_deg, points.zenith_deg)
    azimuth = np.mod(np.round(points.azimuth_deg, DECIMALS), 360.0)
    signed = np.round(np.where(azimuth >= 180.0, -polar, polar), DECIMALS)
    setting = (points.back, points.transmitted, points.gamma_deg, points.sigma_deg, points.wavelength_nm)
    keys = [signed, np.mod(azimuth, 180.0), *(np.round(np.asarray(each, dtype=float), DECIMALS) for each in setting)]
    order = np.lexsort(keys)
    changes = np.array([np.diff(each[order], prepend=np.nan) != 0.0 for each in keys])
    first = np.any(changes, axis=0)
    number = np.cumsum(first) - 1
    which = np.empty(order.size, dtype=np.int64)
    which[order] = number
    counts = np.bincount(number)
    start = order[first]
    p, a = np.radians(signed[start]), np.radians(np.mod(azimuth[start], 180.0))
    up = np.where(points.zenith_deg[start] > 90.0, -1.0, 1.0)
    sigma = np.radians(points.sigma_deg[start])
    # Mirrored, or straight on: towards -sin sigma along x either way.
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
    # A value with light beside one without, further away than the field is wide, may be of any lobe.
    plain[light & ~(reach(values.plane, values.polar, window, LONGEST_RAD) <= window)] = np.nan
    return 0.5 * variance * np.where(np.isfinite(curved), curved, plain)


def _second_derivatives(values: Directions, y: Floats, u: Floats, window: float, *, square: bool) -> Floats:
    """The sum of their moduli, where `y` is the BSDF, or where it is its logarithm (`square`), over the BSDF."""
    along = local_parabola(values.plane, values.polar, y, window, LONGEST_RAD)
    own = along.second + (along.first**2 if square else 0.0)
    across = _measured_across(values, y, window, along, square=square)
    return np.abs(own) + np.abs(
        np.where(np.isfinite(across), across, _by_symmetry(values, along, own, u, window, square=square))
    )


def _measured_across(values: Directions, y: Floats, window: float, along: Parabola, *, square: bool) -> Floats:
    """From what was measured at other beta: along a circle about the normal, with what this bends away from a great one."""
    polar = np.round(np.abs(values.polar), 2 + DECIMALS)
    azimuth = np.where(values.polar < 0.0, values.azimuth + math.pi, values.azimuth)
    order = np.lexsort((azimuth, polar, values.setting))
    order = order[np.sin(polar[order]) > max(LEAST_SINE, 2.0 * window)]
    circle = np.cumsum((np.diff(polar[order], prepend=-1.0) != 0.0) | (np.diff(values.setting[order], prepend=-1) != 0))
    found = local_parabola(circle, (azimuth * np.sin(polar))[order], y[order], window, LONGEST_RAD)
    result = np.full(polar.size, np.nan)
    bent = along.first[order] / np.tan(values.polar[order])
    result[order] = found.second + bent + (found.first**2 if square else 0.0)
    return result


def _by_symmetry(values: Directions, along: Parabola, own: Floats, u: Floats, window: float, *, square: bool) -> Floats:
    """That of a lobe that depends on theta alone. With dashes for derivatives along theta, which changes by t along the arc:
    first = y' t, second = y'' t^2 + y' cot(theta) (1 - t^2), and the two second derivatives have the sum y'' + y' cot(theta).
    """
    theta = np.arccos(np.clip(values.middle, -1.0, 1.0))
    sine = np.maximum(np.sin(theta), 1e-9)
    cot = np.cos(theta) / sine
    t = np.clip(-values.slope / sine, -1.0, 1.0)
    radial = np.abs(t) >= RADIAL
    turned = np.where(radial, t, 1.0)
    first = along.first / turned
    second = (along.second - first * cot * (1.0 - t**2)) / turned**2
    # An arc that passes the middle by tells y' by its second derivative, if y is a parabola in theta; noise tells nothing.
    level = t**2 / np.maximum(theta, window) + (1.0 - t**2) / np.tan(np.clip(theta, window, math.radians(60.0)))
    certain = np.sign(along.second) * np.maximum(np.abs(along.second) - SURE * along.leverage * u, 0.0)
    first = np.where(radial, first, certain / level)
    second = np.where(radial, second, first / np.maximum(theta, window))
    across = second + first * cot + (first**2 if square else 0.0) - own
    # In the lobe's middle all directions are alike, and beside it the first derivative over theta is not to be relied on alone.
    larger = np.where(np.abs(own) > np.abs(across), own, across)
    return np.where(theta <= 0.25 * window, own, np.where(theta <= window, larger, across))
