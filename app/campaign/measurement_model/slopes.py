"""Slopes of what was measured: the derivatives of ln y at each direction, from the values around it.

Along the arc: a local parabola through the logarithms, which follows a Gaussian lobe exactly, however far apart its values are.
Across it: the same on a circle about the normal, where other beta near enough were measured; elsewhere the lobe is taken to be
rotationally symmetric about the specular direction (for transmitted light: about the direction of regular transmission). Where
the schedule does not state it that is an estimate, and the mixed derivative that of the arcs' slopes along the circle. What a
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
BESIDE = math.radians(60.0)
"""Largest theta of which an arc beside the lobe's centre takes the cotangent."""
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
    too few neighbours. `step` is the largest modulus of the difference from a nearest neighbour. `third` is the slope's error
    by a third derivative over the departure that it makes, `fourth` that of the second derivative by a fourth one over the
    half difference.
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
    third: Floats
    fourth: Floats


PARABOLA_COLUMNS = 14


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
        v11, v22, v12, third, fourth = 0.0, 0.0, 0.0, 0.0, 0.0
        for j in range(begin, end):
            place = (x[j] - x[i]) / width
            slope, bend = (c01 + (c11 + c12 * place) * place) * one, (c02 + (c12 + c22 * place) * place) * two
            v11 += slope * slope * variance[j]
            v22 += bend * bend * variance[j]
            v12 += slope * bend * variance[j]
            third += slope * (x[j] - x[i]) ** 3
            fourth += bend * (x[j] - x[i]) ** 4
        found[4, i], found[5, i], found[6, i] = v11, v22, v12
        found[12, i], found[13, i] = third, fourth
        _compare_sides(i, line, x, y, variance, window, furthest, found)


@kernel()
def _compare_sides(
    i: int, line: Ints, x: Floats, y: Floats, variance: Floats, window: float, furthest: float, found: Floats
) -> None:
    """Slopes at a value from two neighbours on one side each: the nearest beyond half a window, and one twice as far.

    Rows 12 and 13 have what x^3 and x^4 add to the derivatives of the parabola; to a side with neighbours at a and b they add
    - a b, and - a b (a + b) with the sign of the side.
    """
    n, step, sides, others, cubic, quartic = x.size, 0.0, 0, 0.0, 0.0, 0.0
    after, own_after, before, own_before = 0.0, 0.0, 0.0, 0.0
    for sign in (1, -1):
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
        before, own_before = after, own_after
        own_after = -(to_near + to_far)
        after = to_near * y[j] + to_far * y[k] + own_after * y[i]
        others += to_near * to_near * variance[j] + to_far * to_far * variance[k]
        cubic += 0.5 * near * far
        quartic += 0.5 * abs(near * far * (near + far))
        sides += 1
    found[11, i] = step
    if sides < 2:  # one of them has too few neighbours
        found[7:11, i], found[12:, i] = 0.0, 0.0
        return
    found[7, i] = 0.5 * (after - before)
    found[8, i] = 0.25 * (others + (own_after - own_before) ** 2 * variance[i])
    found[9, i] = 0.5 * (after + before) - found[0, i]
    found[10, i] = 0.25 * (others + (own_after + own_before) ** 2 * variance[i])
    found[12, i] /= found[12, i] + cubic
    found[13, i] /= quartic


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

    They are linear in the derivatives of the parabolas, `arc` and, where it was measured across, `circle` and `crossed`, that
    of the arcs' slopes on the circle: `mixing` (n, 5, 5) is the derivative of (first_along, first_across, second_along,
    second_across, mixed) by (arc.first, arc.second, circle.first, circle.second, crossed.first).
    """

    first_along: Floats
    first_across: Floats
    second_along: Floats
    second_across: Floats
    mixed: Floats
    arc: Parabola
    circle: Parabola
    crossed: Parabola
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
        # The arcs' slopes at the neighbours have readings of their own, and the value's own slope nearly cancels.
        total += np.where(by[:, 4] != 0.0, by[:, 4] ** 2 * self.crossed.variance_first, 0.0)
        return np.maximum(total - 2.0 * own * own_variance, 0.0)

    def unresolved(self, sensitivity: Floats) -> Floats:
        """Standard uncertainty (n,) of a function of the slopes by what the parabolas do not resolve; 0 where unknown.

        `sensitivity` (n, 5) is the function's, as in `noise`. Of a first derivative: half the difference of the slopes of the
        two sides, and what a third derivative adds to it, by the departure of their mean. Of a second derivative: what a
        fourth one adds, by that half difference. Both without their noise.
        """
        by = np.einsum("nk,nkl->nl", sensitivity, self.mixing)
        total = np.zeros(by.shape[0])
        for first, fit in ((0, self.arc), (2, self.circle), (4, self.crossed)):
            half = np.maximum(fit.half_difference**2 - NOISE_MARGIN * fit.variance_half, 0.0)
            departure = np.maximum(fit.departure**2 - NOISE_MARGIN * fit.variance_departure, 0.0)
            total += np.nan_to_num(by[:, first] ** 2 * (half + fit.third**2 * departure))
            if first < 4:
                total += np.nan_to_num(by[:, first + 1] ** 2 * fit.fourth**2 * half)
        return np.sqrt(total)

    def undecided(self) -> Flags:
        """Where the slopes of two sides differ by more than the larger of them, and by more than noise and UNDECIDED."""
        result = np.zeros(self.first_along.size, dtype=bool)
        for fit in (self.arc, self.circle):
            half = np.abs(fit.half_difference) - NOISE_MARGIN * np.sqrt(fit.variance_half)
            mean = np.abs(fit.first + fit.departure)
            with np.errstate(invalid="ignore"):
                # The larger of |m + h| and |m - h| is |m| + |h|; their difference is 2 |h|.
                result |= (half > UNDECIDED) & (np.abs(fit.half_difference) > mean)
        return result

    def unknown_across(self) -> Flags:
        """Where there is a lobe by what was measured along the arc, and nothing was measured across it.

        A lobe has a slope of more than UNDECIDED, beyond its noise, or one so far away as a neighbour may be.
        """
        slope = np.abs(self.arc.first) - NOISE_MARGIN * np.sqrt(self.arc.variance_first)
        bend = np.abs(self.arc.second) - NOISE_MARGIN * np.sqrt(self.arc.variance_second)
        with np.errstate(invalid="ignore"):
            lobe = (slope > UNDECIDED) | (MAX_DISTANCE_RAD * bend > UNDECIDED)
        return np.asarray(lobe & ~np.isfinite(self.circle.second))


UNDECIDED = math.degrees(0.05)
"""Half differences of two slopes below this, 5 % a degree, are of no account."""


def slopes_of(directions: Directions, y: Floats, variance: Floats, window: float, *, round_lobe: bool = True) -> Slopes:
    """Slopes of `y`, with the `variance` of its noise, over all directions; the parabolas' smallest half width is `window`.

    `round_lobe`: the lobe is stated to be rotationally symmetric, so that where its slope across was measured, the mixed
    derivative is that of a lobe with equal curvatures, 0.
    """
    arc = local_parabola(directions.plane, directions.polar, y, variance, window, MAX_DISTANCE_RAD)
    circle = _circles(directions, y, variance, window)
    mixing = np.zeros((y.size, 5, 5))
    _mix(
        directions.polar, directions.up, directions.middle, directions.along, directions.across, arc.second,
        arc.variance_second, circle.second, window, mixing,
    )  # fmt: skip
    if round_lobe or not np.isfinite(circle.second).any():
        crossed = Parabola(*np.full((PARABOLA_COLUMNS, y.size), np.nan))
    else:
        # From the derivative along the circle of that by the polar angle, less what the circle's curvature makes of the slope.
        outward = np.where(directions.polar < 0.0, -1.0, 1.0)
        crossed = _circles(directions, outward * arc.first, arc.variance_first, window)
        turned = np.isfinite(crossed.first) & np.isfinite(circle.second)
        up, polar = directions.up[turned], np.abs(directions.polar[turned])
        mixing[turned, 4, 2], mixing[turned, 4, 4] = -up / np.tan(polar), up
    firsts = [np.nan_to_num(each) for each in (circle.first, circle.second, crossed.first)]
    along, across, second_along, second_across, mixed = np.einsum(
        "nkl,nl->kn", mixing, np.stack([arc.first, arc.second, *firsts], axis=1)
    )
    return Slopes(along, across, second_along, second_across, mixed, arc, circle, crossed, mixing)


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


@kernel()
def _mix(
    polar: Floats, up: Floats, middle: Floats, along: Floats, across: Floats, bend: Floats, variance: Floats, circle: Floats,
    window: float, mixing: Floats,
) -> None:  # fmt: skip
    """`mixing` of `Slopes`. `bend`, with its `variance`, is the second derivative along the arc, `circle` that on the circle.

    Where there is a circle, the derivative along it is that across, but for its curvature against a great circle. Where there
    is none, y depends on theta alone. With y' and y'' its derivatives along theta, t and w the change of theta along the arc
    and across it: first = y' t and y' w, second = y'' t^2 + y' cot(theta) (1 - t^2), the sum of both second derivatives is
    y'' + y' cot(theta), and the mixed one is (y'' - y' cot(theta)) t w.
    """
    for i in range(polar.size):
        mixing[i, 0, 0] = mixing[i, 2, 1] = 1.0
        if math.isfinite(circle[i]):
            mixing[i, 1, 2] = math.copysign(up[i], up[i] * polar[i])  # growing azimuth, seen from the other half plane
            mixing[i, 3, 3], mixing[i, 3, 0] = 1.0, 1.0 / math.tan(polar[i])
            continue
        theta = max(math.acos(min(max(middle[i], -1.0), 1.0)), 1e-9)
        sine, cot = math.sin(theta), 1.0 / math.tan(theta)
        t = min(max(-along[i] / sine, -1.0), 1.0)
        w = math.copysign(math.sqrt(1.0 - t * t), -across[i])
        # y' and y'' as linear functions of both derivatives along the arc.
        if abs(t) >= RADIAL:
            first_1, first_2 = 1.0 / t, 0.0
            second_1, second_2 = -cot * (1.0 - t * t) / (t * t * t), 1.0 / (t * t)
        else:
            # An arc that passes beside the centre: y' follows from the second derivative, if y is a parabola in theta. A
            # second derivative within its noise is not used.
            noise = NOISE_MARGIN * math.sqrt(variance[i])
            certain = 1.0 - noise / abs(bend[i]) if abs(bend[i]) > noise else 0.0
            level = t * t + (1.0 - t * t) * theta / math.tan(min(theta, BESIDE))
            first_1, first_2, second_1, second_2 = 0.0, certain * theta / level, 0.0, certain / level
        # At the lobe's centre all directions are equal: close to it the first derivative over theta is not reliable.
        centre = min(max((window - theta) / ((1.0 - MIDDLE) * window), 0.0), 1.0)
        mixing[i, 1, 0], mixing[i, 1, 1] = first_1 * w, first_2 * w
        mixing[i, 3, 0] = (1.0 - centre) * (second_1 + first_1 * cot)
        mixing[i, 3, 1] = (1.0 - centre) * (second_2 + first_2 * cot - 1.0) + centre
        mixing[i, 4, 0] = (1.0 - centre) * (second_1 - first_1 * cot) * t * w
        mixing[i, 4, 1] = (1.0 - centre) * (second_2 - first_2 * cot) * t * w
