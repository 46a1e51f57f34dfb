"""Slopes of what was measured: the derivatives of ln y at each direction, from the values around it.

Along the arc: a local parabola through the logarithms, which follows a Gaussian lobe exactly, however far apart its values are.
Across it: the same on a circle about the normal, where other beta near enough were measured, with the derivative of the arcs'
slopes along the circle as the mixed one. Elsewhere a lobe that is stated to be round depends on theta alone (the angle from the
specular direction; for transmitted light, from that of regular transmission), and of another one the slope across has a bound.
What a parabola does not resolve shows in the slopes of the two sides, which have neighbours of their own.

Axes. A direction d is on an arc at the signed polar angle p, from the arc's own pole, in the half plane at the azimuth A, its
`plane`: d = (sin p cos A, sin p sin A, up cos p), up = 1 on the upper arc and -1 on the lower. `along` is the unit tangent of
growing p, `across` is d x along: of growing azimuth where p is positive and the arc is the upper one. Angles are in rad.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, Self

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
LEAST_COSINES = 0.01
"""Least product of the cosines of incidence and observation by which a lobe is narrower across the plane of incidence."""
LEAST_THETA = 1e-9
"""Closer to the lobe's centre no direction leads towards it."""
FURTHEST_RAD = math.radians(45.0)
"""Values of the own arc further away have no information on the slope over theta."""
ANGLE_RAD = math.radians(0.1)
"""An error of an angle, by which the noise of a slope counts."""
NOISE_SHARE = 0.1
"""Share of a value's noise that the noise of its slope over theta may add, by that angle and by the field of view."""
LEAST_VARIANCE = 1e-8
"""Added to the variance of values that are fitted by their weight."""
SINGULAR = 1e-9
"""A smaller determinant, relative, has fewer than three places."""
LEAST_FITTED = 5
"""Least number of values in a fit over theta."""
LEVEL = 1.0
"""Values whose logarithm is so much less count for the largest slope at a value."""
UNKNOWN = math.sqrt(2.0) / math.sqrt(3.0)
"""Standard uncertainty of an unknown slope across, in the largest slope that was measured: an interval as wide as that along
arc and across it together, in any direction.
"""
SQUARE = math.sqrt(9.0 / 5.0)
"""Root mean square of the square of a rectangular error, in its mean square."""
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
    value and two neighbours on that side, and `departure` of their mean from the slope, with variances. Where one side has too
    few neighbours they are the difference of the other one from the slope, and 0; where both have, 0. `step` is the largest
    modulus of the difference from a nearest neighbour. `third` is the slope's error by a third derivative over the departure
    that it makes, `fourth` that of the second derivative by a fourth one over the half difference.
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


class NormalSums(NamedTuple):
    """Sums of a parabola's normal equations: of the weights times powers of the place, 0 to 4, and of these, 0 to 2, times the
    value.
    """

    s0: float
    s1: float
    s2: float
    s3: float
    s4: float
    t0: float
    t1: float
    t2: float


class Cofactors(NamedTuple):
    """Cofactors of the normal equations of a parabola, by row and column."""

    c00: float
    c01: float
    c02: float
    c11: float
    c12: float
    c22: float


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


NO_SUMS = NormalSums(*(0.0,) * 8)


@kernel(forceinline=True)
def _with_value(sums: NormalSums, place: float, weight: float, value: float) -> NormalSums:
    """The sums with one value more."""
    square, one = place * place, weight * place
    two = weight * square
    return NormalSums(
        sums.s0 + weight,
        sums.s1 + one,
        sums.s2 + two,
        sums.s3 + two * place,
        sums.s4 + two * square,
        sums.t0 + weight * value,
        sums.t1 + one * value,
        sums.t2 + two * value,
    )


@kernel(forceinline=True)
def _cofactors(sums: NormalSums) -> Cofactors:
    s0, s1, s2, s3, s4 = sums[:5]
    return Cofactors(
        s2 * s4 - s3 * s3,
        s2 * s3 - s1 * s4,
        s1 * s3 - s2 * s2,
        s0 * s4 - s2 * s2,
        s1 * s2 - s0 * s3,
        s0 * s2 - s1 * s1,
    )


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
        sums = NO_SUMS
        for j in range(begin, end):
            sums = _with_value(sums, (x[j] - x[i]) / width, 1.0, y[j])
        t0, t1, t2 = sums[5:]
        c01, c02, c11, c12, c22 = _cofactors(sums)[1:]
        determinant = sums.s2 * c02 + sums.s3 * c12 + sums.s4 * c22
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
    n, sides = x.size, 0
    step, others, cubic, quartic = 0.0, 0.0, 0.0, 0.0
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
    if sides < 2:
        found[7:11, i], found[12:, i] = 0.0, 0.0
        if sides == 1:  # the other has too few neighbours; the parabola is between the two
            found[7, i] = after - found[0, i]
            found[8, i] = others + found[4, i] + (own_after - found[2, i]) ** 2 * variance[i]
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

    `light` numbers the sets of wavelength, sigma, side and light, `setting` those of each gamma, `plane` the planes of the arc
    in each of these. `polar` is signed, `azimuth` that of the plane, `up` 1 or -1. `middle` is the cosine of the angle to the
    lobe's centre; `along` and `across` are its derivatives.
    """

    light: Ints
    setting: Ints
    plane: Ints
    polar: Floats
    azimuth: Floats
    up: Floats
    middle: Floats
    along: Floats
    across: Floats

    @property
    def radial(self) -> Flags:
        """Where the arc leads close enough towards the lobe's centre or away from it."""
        sine = np.sqrt(np.maximum(1.0 - self.middle**2, 0.0))
        return np.asarray(np.abs(self.along) > RADIAL * np.maximum(sine, LEAST_THETA))

    @property
    def narrowing(self) -> Floats:
        """By how much (n,) a second derivative across the plane of incidence may be larger than that of a round lobe, relative.

        A rough surface's light depends on the half vector, a thin diffuser's on direction cosines. Across the plane both change
        with a direction faster than along it, by one over the cosine of the angle to the normal.
        """
        light = np.abs(self.middle * np.cos(self.polar) - self.along * np.sin(self.polar))
        return np.asarray(1.0 / np.maximum(light * np.cos(self.polar), LEAST_COSINES) - 1.0)

    def beside_gap(self, window: float) -> Flags:
        """Where the lobe's centre is near, in a gap of the arc's directions, and no other arc is nearer by `window` or more."""
        apart = np.where(np.diff(self.plane) == 0, np.diff(self.polar), np.inf)
        far = apart > MAX_DISTANCE_RAD * NEAR
        towards = np.where(self.along > 0.0, np.append(far, True), np.insert(far, 0, True))
        theta = np.arccos(np.clip(self.middle, -1.0, 1.0))
        nearest = np.full(int(self.light.max(initial=-1)) + 1, np.inf)
        np.minimum.at(nearest, self.light, theta)
        return np.asarray(towards & (theta > window) & (theta < MAX_DISTANCE_RAD) & (theta <= nearest[self.light] + window))

    def where(self, chosen: Flags) -> "Directions":
        """Some of the directions."""
        return Directions(*(each[chosen] for each in vars(self).values()))


@dataclass(frozen=True)
class Slopes:
    """Derivatives of y at each direction (n,): along, across, and mixed; NaN where there are too few neighbours.

    They are linear in the derivatives of the parabolas: `arc`; `across`, on the circle where other beta were `measured` near
    enough, over theta where the arc passes beside a round lobe's centre; and `crossed`, that of the arcs' slopes on the circle.
    `mixing` (n, 5, 5) is the derivative of (first_along, first_across, second_along, second_across, mixed) by (arc.first,
    arc.second, across.first, across.second, crossed.first). `bound` is the standard uncertainty of first_across where it is not
    known but for its size, and taken as 0: nothing was measured across, and the lobe need not be round or theta does not
    change along the arc. `narrower` is that of second_across, by which the lobe may be narrower there than a round one.
    `beside` is the largest slope to a value beside it at other beta, and `step` the largest change to one that is near.
    """

    first_along: Floats
    first_across: Floats
    second_along: Floats
    second_across: Floats
    mixed: Floats
    arc: Parabola
    across: Parabola
    crossed: Parabola
    mixing: Floats
    measured: Flags
    bound: Floats
    narrower: Floats
    beside: Floats
    step: Floats

    def noise(self, sensitivity: Floats, own_variance: Floats) -> Floats:
        """Variance (n,) that the values' noise adds to y minus a function of the slopes.

        `sensitivity` (n, 5) is the function's, in the order of the derivatives above; `own_variance` the variance of y. The
        value's own noise, which is in its slopes too, counts once; a negative sum counts as none.
        """
        by = np.einsum("nk,nkl->nl", sensitivity, self.mixing)
        total, own = np.zeros(own_variance.size), np.zeros(own_variance.size)
        for first, fit in ((0, self.arc), (2, self.across)):
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
        total = np.zeros(len(by))
        for first, fit in ((0, self.arc), (2, self.across), (4, self.crossed)):
            half = np.maximum(fit.half_difference**2 - NOISE_MARGIN * fit.variance_half, 0.0)
            departure = np.maximum(fit.departure**2 - NOISE_MARGIN * fit.variance_departure, 0.0)
            total += np.nan_to_num(by[:, first] ** 2 * (half + fit.third**2 * departure))
            if first < 4:
                total += np.nan_to_num(by[:, first + 1] ** 2 * fit.fourth**2 * half)
        return np.sqrt(total)

    def limits(self, sensitivity: Floats) -> Floats:
        """Standard uncertainty (n,) of a function of the slopes by what was not measured across; `sensitivity` as above.

        The square of an unknown slope counts in the field of view's correction as a second derivative does.
        """
        first, second = sensitivity[:, 1] * self.bound, sensitivity[:, 3] * np.hypot(self.narrower, SQUARE * self.bound**2)
        return np.hypot(first, second)

    def undecided(self) -> Flags:
        """Where the slopes of two sides differ by more than the larger of them, and by more than noise and UNDECIDED."""
        result = np.zeros(self.first_along.size, dtype=bool)
        for fit in (self.arc, self.across):
            half = np.abs(fit.half_difference) - NOISE_MARGIN * np.sqrt(fit.variance_half)
            mean = np.abs(fit.first + fit.departure)
            with np.errstate(invalid="ignore"):
                # The larger of |m + h| and |m - h| is |m| + |h|; their difference is 2 |h|.
                result |= (half > UNDECIDED) & (np.abs(fit.half_difference) > mean)
        return result

    def unknown_across(self) -> Flags:
        """Where the slope across is as uncertain as an unknown one of a lobe whose largest slope is UNDECIDED, or more."""
        return np.asarray(self.bound > UNKNOWN * UNDECIDED)


UNDECIDED = math.degrees(0.05)
"""Half differences of two slopes below this, 5 % a degree, are of no account."""


def slopes_of(directions: Directions, y: Floats, variance: Floats, window: float, *, round_lobe: bool = True) -> Slopes:
    """Slopes of `y`, with the `variance` of its noise, over all directions; the parabolas' smallest half width is `window`.

    `round_lobe`: the lobe is stated to be rotationally symmetric, so that where its slope across was measured, the mixed
    derivative is that of a lobe with equal curvatures, 0; where it was not, y depends on theta alone. Of another lobe the slope
    across is there unknown, within `bound`.
    """
    arc = local_parabola(directions.plane, directions.polar, y, variance, window, MAX_DISTANCE_RAD)
    circles = _Circles.of(directions, window)
    circle = circles.parabola(y, variance, window)
    measured = np.isfinite(circle.second)
    beside = _over_theta(directions, y, variance, window, np.isfinite(arc.second) & ~measured & ~directions.radial)
    across = Parabola(*(np.where(measured, a, b) for a, b in zip(vars(circle).values(), vars(beside).values(), strict=True)))
    mixing = np.zeros((y.size, 5, 5))
    _mix(
        directions.polar,
        directions.up,
        directions.middle,
        directions.along,
        directions.across,
        measured,
        np.isfinite(across.second),
        directions.radial,
        window,
        mixing,
    )
    unknown = ~measured & ~((directions.radial | np.isfinite(across.second)) & round_lobe)
    mixing[unknown, 1] = 0.0
    beside_it, brighter, step = circles.steepest(y, variance)
    bound = np.where(unknown, UNKNOWN * _largest_slope(directions, y, arc, brighter), 0.0)
    if round_lobe or not measured.any():
        crossed = Parabola(*np.full((PARABOLA_COLUMNS, y.size), np.nan))
    else:
        # From the derivative along the circle of that by the polar angle, less what the circle's curvature makes of the slope.
        outward = np.where(directions.polar < 0.0, -1.0, 1.0)
        crossed = circles.parabola(outward * arc.first, arc.variance_first, window)
        turned = np.isfinite(crossed.first) & measured
        up, polar = directions.up[turned], np.abs(directions.polar[turned])
        mixing[turned, 4, 2], mixing[turned, 4, 4] = -up / np.tan(polar), up
    firsts = [np.nan_to_num(each) for each in (across.first, across.second, crossed.first)]
    derivatives = np.einsum("nkl,nl->kn", mixing, np.stack([arc.first, arc.second, *firsts], axis=1))
    first_along, first_across, second_along, second_across, mixed = derivatives
    if round_lobe:
        bound = np.where(measured, 0.0, np.hypot(bound, circles.departure(directions, y, variance, first_along, first_across)))
    # The lobe's middle need not be the specular direction, and beside it one of the two may be 0.
    curved = np.maximum(np.abs(second_along), np.abs(second_across)) - NOISE_MARGIN * np.sqrt(arc.variance_second)
    narrower = np.where(measured, 0.0, np.maximum(curved, 0.0) * directions.narrowing / math.sqrt(3.0))
    return Slopes(
        first_along,
        first_across,
        second_along,
        second_across,
        mixed,
        arc,
        across,
        crossed,
        mixing,
        measured,
        bound,
        narrower,
        beside_it,
        step,
    )


def _over_theta(directions: Directions, y: Floats, variance: Floats, window: float, chosen: Flags) -> Parabola:
    """Derivatives over theta from the values of the own arc, where it passes beside the lobe's centre; elsewhere NaN.

    There theta hardly changes along the arc. y is fitted as a parabola in 1 - cos(theta), in which a Gaussian lobe is straight
    and every lobe smooth at its centre, to the fewest values around by which the slope is known well enough.
    """
    height = 1.0 - np.clip(directions.middle, -1.0, 1.0)
    found = np.full((PARABOLA_COLUMNS, y.size), np.nan)
    _fit_over_theta(directions.plane, directions.polar, height, y, variance, chosen, window, found)
    return Parabola(*found)


@kernel()
def _fit_over_theta(
    line: Ints, polar: Floats, height: Floats, y: Floats, variance: Floats, chosen: Flags, window: float, found: Floats
) -> None:
    n = y.size
    for i in range(n):
        if not chosen[i]:
            continue
        own = 1.0 / (variance[i] + LEAST_VARIANCE)
        cosine, sine2 = 1.0 - height[i], height[i] * (2.0 - height[i])
        sine = math.sqrt(sine2)
        sums = _with_value(NO_SUMS, 0.0, own, y[i])
        begin, end, enough = i, i + 1, 0
        while True:
            before = polar[i] - polar[begin - 1] if begin > 0 and line[begin - 1] == line[i] else math.inf
            after = polar[end] - polar[i] if end < n and line[end] == line[i] else math.inf
            nearest = min(before, after) * NEAR
            if not nearest <= FURTHEST_RAD:
                break
            # Both neighbours, if they are equally far away.
            first, last = begin - 1 if before <= nearest else begin, end + 1 if after <= nearest else end
            for j in range(first, last):
                if begin <= j < end:
                    continue
                weight = 1.0 / (variance[j] + LEAST_VARIANCE)
                sums = _with_value(sums, (height[j] - height[i]) / window, weight, y[j])
            begin, end = first, last
            if nearest < window:
                continue
            # With weights, the inverse is the covariance.
            s0, s1, s2 = sums[:3]
            t0, t1, t2 = sums[5:]
            inverse = _cofactors(sums)
            determinant = s0 * inverse.c00 + s1 * inverse.c01 + s2 * inverse.c02
            c01, c02, c11, c12, c22 = inverse[1:]
            if not determinant > SINGULAR * s0 * s2 * sums.s4:  # two places: a straight line
                determinant = c22
                c01, c02, c11, c12, c22 = -s1, 0.0, s0, 0.0, 0.0
                if not determinant > SINGULAR * s0 * s2:
                    continue
            one, two = 1.0 / (determinant * window), 2.0 / (determinant * window * window)
            slope, bend = (c01 * t0 + c11 * t1 + c12 * t2) * one, (c02 * t0 + c12 * t1 + c22 * t2) * two
            v11, v12, v22 = c11 * one / window, c12 * two / window, 2.0 * c22 * two / (window * window)
            if enough == 0:
                v_first, v_second = sine2 * v11, cosine * cosine * v11 + 2.0 * cosine * sine2 * v12 + sine2 * sine2 * v22
                found[:, i] = 0.0
                found[0, i], found[1, i] = sine * slope, cosine * slope + sine2 * bend
                found[2, i] = sine * own * c01 * one
                found[3, i] = cosine * own * c01 * one + sine2 * own * c02 * two
                found[4, i], found[5, i], found[6, i] = v_first, v_second, sine * (cosine * v11 + sine2 * v12)
                noise = ANGLE_RAD**2 * v_first + 0.25 * (window / WINDOW) ** 4 * v_second
                if noise * own < NOISE_SHARE**2 and end - begin >= LEAST_FITTED:
                    enough = end - begin
            elif end - begin >= 2 * enough:
                # By so many more values a third derivative makes some four times the error.
                found[9, i], found[10, i], found[12, i] = sine * slope - found[0, i], sine2 * v11, 1.0 / 3.0
                break


@dataclass(frozen=True)
class _Circles:
    """Values at other beta, on circles about the normal: in the `order` of growing azimuth, with the `line` of each one's
    circle and its `place` on it, in rad.
    """

    order: Ints
    line: Ints
    place: Floats

    @classmethod
    def of(cls, directions: Directions, window: float) -> Self:
        """Of directions that are far enough from the normal."""
        polar = np.round(np.abs(directions.polar), CIRCLE_DECIMALS)
        azimuth = np.where(directions.polar < 0.0, directions.azimuth + math.pi, directions.azimuth)
        order = np.lexsort((azimuth, polar, directions.setting))
        order = order[np.sin(polar[order]) > max(MIN_SINE, 2.0 * window)]
        setting, radius = directions.setting[order], polar[order]
        line = np.cumsum((np.diff(radius, prepend=-1.0) != 0.0) | (np.diff(setting, prepend=-1) != 0))
        return cls(order, line, azimuth[order] * np.sin(radius))

    def parabola(self, y: Floats, variance: Floats, window: float) -> Parabola:
        """Parabolas along the circles; NaN where no other beta was measured near enough."""
        fit = local_parabola(self.line, self.place, y[self.order], variance[self.order], window, MAX_DISTANCE_RAD)
        columns = np.full((PARABOLA_COLUMNS, y.size), np.nan)
        columns[:, self.order] = list(vars(fit).values())
        return Parabola(*columns)

    def steepest(self, y: Floats, variance: Floats) -> tuple[Floats, Floats, Floats]:
        """The largest slope (n,) from each value to one beside it, at any distance, and that to a brighter one, both beyond
        their noise; and the largest change to one within MAX_DISTANCE_RAD. 0 where there is none.
        """
        same = np.flatnonzero(np.diff(self.line) == 0)
        one, other = self.order[same], self.order[same + 1]
        noise = NOISE_MARGIN * np.sqrt(variance[one] + variance[other])
        apart, change = self.place[same + 1] - self.place[same], np.abs(y[other] - y[one])
        slope = (change - noise) / apart
        largest, brighter, step = np.zeros((3, y.size))
        near = np.where(apart <= MAX_DISTANCE_RAD * NEAR, change, 0.0)
        for each in (one, other):
            np.maximum.at(largest, each, slope)
            np.maximum.at(step, each, near)
        np.maximum.at(brighter, np.where(y[other] < y[one], other, one), slope)
        return largest, brighter, step

    def departure(self, directions: Directions, y: Floats, variance: Floats, along: Floats, across: Floats) -> Floats:
        """By how much the slopes (n,) to values at other beta not far away differ, beyond their noise, from those of a lobe
        that is straight over 1 - cos(theta) and has the slopes `along` and `across` at each value.
        """
        height = 1.0 - directions.middle
        gradient = directions.along**2 + directions.across**2
        per_height = np.nan_to_num(
            -(directions.along * along + directions.across * across) / np.maximum(gradient, LEAST_THETA**2)
        )
        same = np.flatnonzero((np.diff(self.line) == 0) & (np.diff(self.place) <= 2.0 * MAX_DISTANCE_RAD * NEAR))
        found = np.zeros(y.size)
        for one, other in ((self.order[same], self.order[same + 1]), (self.order[same + 1], self.order[same])):
            left = np.abs(y[other] - y[one] - per_height[one] * (height[other] - height[one]))
            noise = NOISE_MARGIN * np.sqrt(variance[one] + variance[other])
            np.maximum.at(found, one, (left - noise) / (self.place[same + 1] - self.place[same]))
        return found


def _largest_slope(directions: Directions, y: Floats, arc: Parabola, brighter: Floats) -> Floats:
    """The largest slope (n,) that was measured at the wavelength, sigma and side of each value, beyond its noise.

    Along all arcs, of any beta and of any gamma, which turns the sample's axes under the arc, and between other beta; of values
    that are as bright as the value, or by LEVEL less: a lobe is steeper further down.
    """
    slope = np.fmax(np.abs(arc.first) - NOISE_MARGIN * np.sqrt(arc.variance_first), brighter)
    largest = np.zeros(y.size)
    for number in np.unique(directions.light).tolist():
        here = np.flatnonzero(directions.light == number)
        order = here[np.argsort(-y[here])]
        as_bright = np.searchsorted(-y[order], LEVEL - y[here], side="right")
        largest[here] = np.maximum.accumulate(slope[order])[as_bright - 1]
    return largest


@kernel()
def _mix(
    polar: Floats,
    up: Floats,
    middle: Floats,
    along: Floats,
    across: Floats,
    measured: Flags,
    beside: Flags,
    radial: Flags,
    window: float,
    mixing: Floats,
) -> None:
    """`mixing` of `Slopes`, whose third and fourth source are derivatives along the circle where it was `measured`.

    The derivative along the circle is that across, but for its curvature against a great circle. Where there is no circle, y
    depends on theta alone. With y' and y'' its derivatives along theta, t and w the change of theta along the arc and across
    it: first = y' t and y' w, second = y'' t^2 + y' cot(theta) (1 - t^2), the sum of both second derivatives is
    y'' + y' cot(theta), and the mixed one is (y'' - y' cot(theta)) t w. `beside`: the third and fourth source are y' and y'';
    elsewhere they follow from the derivatives along the arc.
    """
    first, second = np.empty(4), np.empty(4)  # of y' and y'' by the sources
    for i in range(polar.size):
        mixing[i, 0, 0] = mixing[i, 2, 1] = 1.0
        if measured[i]:
            mixing[i, 1, 2] = math.copysign(up[i], up[i] * polar[i])  # growing azimuth, seen from the other half plane
            mixing[i, 3, 3], mixing[i, 3, 0] = 1.0, 1.0 / math.tan(polar[i])
            continue
        theta = max(math.acos(min(max(middle[i], -1.0), 1.0)), LEAST_THETA)
        sine, cot = math.sin(theta), 1.0 / math.tan(theta)
        t = min(max(-along[i] / sine, -1.0), 1.0)
        w = math.copysign(math.sqrt(1.0 - t * t), -across[i])
        first[:], second[:] = 0.0, 0.0
        if beside[i]:
            first[2] = second[3] = 1.0
        elif radial[i]:
            first[0] = 1.0 / t
            second[0], second[1] = -cot * (1.0 - t * t) / (t * t * t), 1.0 / (t * t)
        # At the lobe's centre all directions are equal: close to it the first derivative over theta is not reliable.
        centre = min(max((window - theta) / ((1.0 - MIDDLE) * window), 0.0), 1.0)
        for k in range(4):
            mixing[i, 1, k] = first[k] * w
            mixing[i, 3, k] = (1.0 - centre) * (second[k] + first[k] * cot)
            mixing[i, 4, k] = (1.0 - centre) * (second[k] - first[k] * cot) * t * w
        mixing[i, 3, 1] += centre - (1.0 - centre)
