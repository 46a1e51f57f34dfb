"""Slopes of what was measured: the derivatives of ln y at each direction, from the values around it.

Along the arc: a local parabola through the logarithms, which follows a Gaussian lobe exactly, however far apart its values are.
Across it: the same on a circle about the normal, where other beta near enough were measured; elsewhere the lobe is taken to be
rotationally symmetric about the specular direction (for transmitted light: about the direction of regular transmission). What a
parabola does not resolve shows in the slopes of the two sides, which have neighbours of their own.

Axes. A direction d is on an arc at the signed polar angle p, from the arc's own pole, in the half plane at the azimuth A, its
`plane`: d = (sin p cos A, sin p sin A, up cos p), up = 1 on the upper arc and -1 on the lower. `along` is the unit tangent of
growing p, `across` is d x along: of growing azimuth where p is positive and the arc is the upper one. Angles are in rad.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.kernel import kernel

MAX_NEIGHBOURS = 24
"""Largest number of neighbours on each side."""
NEAR = 1.0 + 1e-9
WINDOW = 5.0
"""Values within so many standard deviations of the field's directions are fitted together: the field does not resolve less."""
MAX_DISTANCE_RAD = math.radians(6.0)
"""Neighbours further away have no information on the curvature; photodiodes are 5 deg apart."""
RADIAL = 0.7
"""An arc passes close enough to the lobe's centre where theta changes by this share of the way along it."""
MIDDLE = 0.25
"""A direction is at the lobe's centre within this share of the window; beyond the whole window it is not."""
MIN_SINE = 0.1
"""Smaller circles about the normal are no neighbourhood across the arc."""
CIRCLE_DECIMALS = 8
"""Decimals of a radian to which the values of one circle about the normal have the same polar angle."""
NOISE_MARGIN = 3.0
"""Standard uncertainties by which a number is reduced before it counts as more than noise."""


@dataclass(frozen=True)
class Parabola:
    """Derivatives at each value (n,) of its local parabola; NaN where there are too few neighbours.

    `own_first` and `own_second` are the derivatives' weights of the value itself; `variance_first`, `variance_second` and
    `covariance` follow from the values' noise. `half_difference` of the slopes of the two sides, each a parabola through the
    value and two neighbours on that side, and `departure` of their mean from the slope, with variances; 0 where a side has
    too few neighbours. `step` is the largest modulus of the difference from a nearest neighbour.
    """

    first: Floats
    second: Floats
    own_first: Floats
    own_second: Floats
    variance_first: Floats
    variance_second: Floats
    covariance: Floats
    half_difference: Floats
    variance_half: Floats
    departure: Floats
    variance_departure: Floats
    step: Floats


PARABOLA_COLUMNS = 12


def local_parabola(line: Ints, x: Floats, y: Floats, variance: Floats, window: float, longest: float) -> Parabola:
    """Fit a parabola to each value and the values of its line within `window`, by least squares.

    If the window has no value on one side, it is widened until there is one on each side, to `longest` at most; or, at the end
    of a line, to two values on one side, within twice `longest`. The values, with the `variance` of their noise, are sorted by
    `line`, and within it by `x`, whose values are all different. The result is NaN where one of the fitted values is NaN.
    """
    half = reach(line, x, window, longest)
    found = np.empty((PARABOLA_COLUMNS, x.size))
    _fit(np.ascontiguousarray(line), x, y, variance, half, window, 2.0 * longest * NEAR, found)
    return Parabola(*found)


@kernel()
def _fit(
    line: Ints, x: Floats, y: Floats, variance: Floats, half: Floats, window: float, furthest: float, found: Floats
) -> None:
    n = x.size
    for i in range(n):
        width = half[i]
        if not math.isfinite(width):
            found[:, i] = math.nan
            continue
        begin, end = i, i + 1
        while begin > 0 and i - begin < MAX_NEIGHBOURS and line[begin - 1] == line[i] and x[i] - x[begin - 1] <= width * NEAR:
            begin -= 1
        while end < n and end - i <= MAX_NEIGHBOURS and line[end] == line[i] and x[end] - x[i] <= width * NEAR:
            end += 1
        s1, s2, s3, s4, t0, t1, t2 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(begin, end):
            place, value = (x[j] - x[i]) / width, y[j]
            square = place * place
            s1 += place
            s2 += square
            s3 += square * place
            s4 += square * square
            t0 += value
            t1 += value * place
            t2 += value * square
        # Normal equations of three unknowns, solved by cofactors.
        s0 = float(end - begin)
        c02, c12, c22 = s1 * s3 - s2 * s2, s1 * s2 - s0 * s3, s0 * s2 - s1 * s1
        c11, c01 = s0 * s4 - s2 * s2, s2 * s3 - s1 * s4
        determinant = s2 * c02 + s3 * c12 + s4 * c22
        one, two = 1.0 / (determinant * width), 2.0 / (determinant * width * width)
        found[0, i] = (c01 * t0 + c11 * t1 + c12 * t2) * one
        found[1, i] = (c02 * t0 + c12 * t1 + c22 * t2) * two
        found[2, i], found[3, i] = c01 * one, c02 * two
        v11, v22, v12 = 0.0, 0.0, 0.0
        for j in range(begin, end):
            place = (x[j] - x[i]) / width
            slope, bend = (c01 + (c11 + c12 * place) * place) * one, (c02 + (c12 + c22 * place) * place) * two
            v11 += slope * slope * variance[j]
            v22 += bend * bend * variance[j]
            v12 += slope * bend * variance[j]
        found[4, i], found[5, i], found[6, i] = v11, v22, v12
        _compare_sides(i, line, x, y, variance, window, furthest, found)


@kernel()
def _compare_sides(
    i: int, line: Ints, x: Floats, y: Floats, variance: Floats, window: float, furthest: float, found: Floats
) -> None:
    """Slopes at a value from two neighbours on one side each: the nearest beyond half a window, and one twice as far."""
    n, step = x.size, 0.0
    slopes, own, others, sides = np.zeros(2), np.zeros(2), 0.0, 0
    for side in range(2):
        sign = 1 - 2 * side
        j = i + sign
        if 0 <= j < n and line[j] == line[i]:
            step = max(step, abs(y[j] - y[i]))
        while 0 <= j < n and line[j] == line[i] and abs(x[j] - x[i]) * NEAR < 0.5 * window:
            j += sign
        if not (0 <= j < n and line[j] == line[i]):
            continue
        near, k = x[j] - x[i], j + sign
        while 0 <= k < n and line[k] == line[i] and abs(x[k] - x[i]) * NEAR < 2.0 * abs(near):
            k += sign
        if not (0 <= k < n and line[k] == line[i] and abs(x[k] - x[i]) <= furthest):
            continue
        far = x[k] - x[i]
        to_near, to_far = far / (near * (far - near)), -near / (far * (far - near))
        own[side] = -(to_near + to_far)
        slopes[side] = to_near * y[j] + to_far * y[k] + own[side] * y[i]
        others += to_near * to_near * variance[j] + to_far * to_far * variance[k]
        sides += 1
    found[11, i] = step
    if sides < 2:  # noqa: PLR2004  (one of the sides has too few neighbours)
        found[7:11, i] = 0.0
        return
    found[7, i] = 0.5 * (slopes[0] - slopes[1])
    found[8, i] = 0.25 * (others + (own[0] - own[1]) ** 2 * variance[i])
    found[9, i] = 0.5 * (slopes[0] + slopes[1]) - found[0, i]
    found[10, i] = 0.25 * (others + (own[0] + own[1]) ** 2 * variance[i])


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


@dataclass(frozen=True)
class Directions:
    """Directions (n,), in order along the arcs: by `plane`, and within it by `polar`.

    `setting` numbers the sets of wavelength, sigma, gamma, side and light; `plane` numbers the planes of the arc in each of
    them. `polar` is signed, `azimuth` that of the plane, `up` 1 or -1. `middle` is the cosine of the angle to the lobe's
    centre; `along` and `across` are its derivatives.
    """

    setting: Ints
    plane: Ints
    polar: Floats
    azimuth: Floats
    up: Floats
    middle: Floats
    along: Floats
    across: Floats

    def where(self, chosen: Flags) -> "Directions":
        """Some of the directions."""
        return Directions(*(each[chosen] for each in vars(self).values()))


@dataclass(frozen=True)
class Slopes:
    """Derivatives of y at each direction (n,): along, across, and mixed; NaN where there are too few neighbours.

    They are linear in the derivatives of the parabolas, `arc` and, where it was measured across, `circle`: `mixing` (n, 5, 4)
    is the derivative of (first_along, first_across, second_along, second_across, mixed) by (arc.first, arc.second,
    circle.first, circle.second).
    """

    first_along: Floats
    first_across: Floats
    second_along: Floats
    second_across: Floats
    mixed: Floats
    arc: Parabola
    circle: Parabola
    mixing: Floats

    def noise(self, sensitivity: Floats, own_variance: Floats) -> Floats:
        """Variance (n,) that the values' noise adds to y minus a function of the slopes.

        `sensitivity` (n, 5) is the function's, in the order of the derivatives above; `own_variance` the variance of y. The
        value's own noise, which is in its slopes too, counts once; a negative sum counts as none.
        """
        by = np.einsum("nk,nkl->nl", sensitivity, self.mixing)
        total, own = np.zeros(own_variance.size), np.zeros(own_variance.size)
        for first, fit in ((0, self.arc), (2, self.circle)):
            a, b = by[:, first], by[:, first + 1]
            used = (a != 0.0) | (b != 0.0)
            part = a**2 * fit.variance_first + b**2 * fit.variance_second + 2.0 * a * b * fit.covariance
            total += np.where(used, part, 0.0)
            own += np.where(used, a * fit.own_first + b * fit.own_second, 0.0)
        return np.maximum(total - 2.0 * own * own_variance, 0.0)

    def unresolved(self, *, across: bool) -> Floats:
        """Standard uncertainty (n,) of a slope by what its parabola does not resolve; 0 where that is not known.

        Half the difference of the slopes of the two sides, and a third of the departure of their mean, which is what a third
        derivative adds to the slope of a parabola through neighbours on both sides. Both without their noise.
        """
        fit = self.circle if across else self.arc
        half = np.maximum(fit.half_difference**2 - NOISE_MARGIN * fit.variance_half, 0.0)
        third = np.maximum(fit.departure**2 - NOISE_MARGIN * fit.variance_departure, 0.0)
        return np.nan_to_num(np.sqrt(half + third / 9.0))

    def undecided(self) -> Flags:
        """Where the slopes of the two sides of an arc or a circle differ by more than the larger of them, and by more than noise."""
        result = np.zeros(self.first_along.size, dtype=bool)
        for fit in (self.arc, self.circle):
            half = np.abs(fit.half_difference) - NOISE_MARGIN * np.sqrt(fit.variance_half)
            mean = np.abs(fit.first + fit.departure)
            with np.errstate(invalid="ignore"):
                # The larger of |m + h| and |m - h| is |m| + |h|; their difference is 2 |h|.
                result |= (half > UNDECIDED) & (np.abs(fit.half_difference) > mean)
        return result


UNDECIDED = math.degrees(0.05)
"""Half differences of two slopes below this, 5 % a degree, are of no account."""


def slopes_of(directions: Directions, y: Floats, variance: Floats, window: float) -> Slopes:
    """Slopes of `y`, with the `variance` of its noise, over all directions; the parabolas' smallest half width is `window`."""
    arc = local_parabola(directions.plane, directions.polar, y, variance, window, MAX_DISTANCE_RAD)
    circle = _circles(directions, y, variance, window)
    mixing = _by_symmetry(directions, arc, window)
    measured = np.isfinite(circle.second)
    if measured.any():
        # Along a circle about the normal, whose curvature against a great circle is corrected for.
        across = np.zeros((int(measured.sum()), 5, 4))
        across[:, 0, 0] = across[:, 2, 1] = across[:, 3, 3] = 1.0
        across[:, 1, 2] = directions.up[measured]
        across[:, 3, 0] = 1.0 / np.tan(directions.polar[measured])
        mixing[measured] = across
    base = np.stack([arc.first, arc.second, np.nan_to_num(circle.first), np.nan_to_num(circle.second)], axis=1)
    return Slopes(*np.einsum("nkl,nl->kn", mixing, base), arc, circle, mixing)


def _circles(directions: Directions, y: Floats, variance: Floats, window: float) -> Parabola:
    """Parabolas over the values at other beta, along a circle about the normal, in the order of growing azimuth."""
    polar = np.round(np.abs(directions.polar), CIRCLE_DECIMALS)
    azimuth = np.where(directions.polar < 0.0, directions.azimuth + math.pi, directions.azimuth)
    order = np.lexsort((azimuth, polar, directions.setting))
    order = order[np.sin(polar[order]) > max(MIN_SINE, 2.0 * window)]
    circle = np.cumsum((np.diff(polar[order], prepend=-1.0) != 0.0) | (np.diff(directions.setting[order], prepend=-1) != 0))
    fit = local_parabola(circle, (azimuth * np.sin(polar))[order], y[order], variance[order], window, MAX_DISTANCE_RAD)
    columns = []
    for each in vars(fit).values():
        column = np.full(polar.size, np.nan)
        column[order] = each
        columns.append(column)
    return Parabola(*columns)


def _by_symmetry(directions: Directions, arc: Parabola, window: float) -> Floats:
    """How the derivatives follow from those along the arc for a lobe that depends on theta alone: `mixing` of `Slopes`.

    With y' and y'' the derivatives along theta, t and w the change of theta along the arc and across it: first = y' t and y' w,
    second = y'' t^2 + y' cot(theta) (1 - t^2), the sum of both second derivatives is y'' + y' cot(theta), and the mixed one is
    (y'' - y' cot(theta)) t w.
    """
    theta = np.arccos(np.clip(directions.middle, -1.0, 1.0))
    sine = np.maximum(np.sin(theta), 1e-9)
    cot = np.cos(theta) / sine
    t = np.clip(-directions.along / sine, -1.0, 1.0)
    w = np.copysign(np.sqrt(1.0 - t**2), -directions.across)
    radial = np.abs(t) >= RADIAL
    turned = np.where(radial, t, 1.0)
    # y' and y'' as linear functions (n, 2) of the derivatives along the arc.
    first = np.stack([1.0 / turned, np.zeros_like(t)], axis=1)
    second = np.stack([np.zeros_like(t), np.ones_like(t)], axis=1)
    second = (second - first * (cot * (1.0 - t**2))[:, None]) / (turned**2)[:, None]
    # For an arc that passes beside the centre y' follows from the second derivative, if y is a parabola in theta. A second
    # derivative within its noise is not used.
    beside = np.clip(theta, 1e-9, math.radians(60.0))
    noise = NOISE_MARGIN * np.sqrt(arc.variance_second)
    with np.errstate(invalid="ignore", divide="ignore"):
        certain = np.nan_to_num(np.maximum(1.0 - noise / np.abs(arc.second), 0.0))
    level = certain * theta / (t**2 + (1.0 - t**2) * np.maximum(theta, 1e-9) / np.tan(beside))
    aside = np.stack([np.zeros_like(t), level], axis=1)
    first = np.where(radial[:, None], first, aside)
    second = np.where(radial[:, None], second, aside / np.maximum(theta, 1e-9)[:, None])
    bend = first * cot[:, None]
    across = second + bend - np.array([0.0, 1.0])
    # At the lobe's centre all directions are equal: close to it the first derivative over theta is not reliable.
    centre = np.clip((window - theta) / ((1.0 - MIDDLE) * window), 0.0, 1.0)[:, None]
    mixing = np.zeros((t.size, 5, 4))
    mixing[:, 0, 0] = mixing[:, 2, 1] = 1.0
    mixing[:, 1, :2] = first * w[:, None]
    mixing[:, 3, :2] = centre * np.array([0.0, 1.0]) + (1.0 - centre) * across
    mixing[:, 4, :2] = (1.0 - centre) * (second - bend) * (t * w)[:, None]
    return mixing
