"""First and second derivatives of measured values along a line, each from the parabola through its nearest neighbours."""

from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats, Ints

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
