"""The worst combination of deviations without an enumeration: a linear model ranks the corners, and exact values decide.

Every deviation is in units of its limit, from -1 to 1. The criterion is the root mean square of residuals: of formula 5 over
the directions, or of the one relative change of a flux. A convex criterion is largest where every deviation is at a limit, a
corner.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats, Ints

Residuals = Callable[[Floats], Floats]
"""Residuals (n, m) of combinations (n, k) of k deviations, in units of their limits."""

MOST_LISTED = 14
"""Largest number of deviations whose corners are all ranked by the linear model: 16,384 corners."""
RANKED, CLIMBED, RANDOM_STARTS = 32, 8, 4
"""Number of corners that are evaluated first; of those, and of random ones, from which the search climbs."""
MODEL_STARTS = 256
MOST_PAIRED = 16
"""Largest number of deviations of which two at a time are changed at the end."""


@dataclass(frozen=True, eq=False)
class WorstCombination:
    """The worst combination: `levels` (k,) of -1, 0 or 1 limits, its criterion, and that of the linear model.

    `evaluated` is the number of combinations that were evaluated to find it.
    """

    levels: Ints
    percent: float
    linear_percent: float
    evaluated: int


def rms_percent(residuals: Floats) -> Floats:
    """Root mean square over the last axis, in percent (...,); infinite where a residual is not a number."""
    square = np.mean(np.square(residuals), axis=-1)
    return np.asarray(100.0 * np.sqrt(np.where(np.isnan(square), np.inf, square)))


def search_worst(residuals: Residuals, count: int, seed: int = 0) -> WorstCombination:
    """The combination of `count` deviations, each at -1, 0 or 1 limit, with the largest criterion.

    1. Residuals with each deviation alone at both limits give a linear model at the corners.
    2. The first corners by this model are evaluated. So are random ones: where a criterion is flat about zero, as a flux is
       until the light's edge reaches the square, the model knows nothing.
    3. From the worst of them, single deviations are changed to another level as long as that is worse; then two at a time.

    The result is the worst of all that was evaluated; nothing is taken from the model.
    """
    known: dict[bytes, float] = {}

    def percent(levels: Ints) -> Floats:
        """Criterion (n,) of levels (n, k), each evaluated once."""
        keys = [row.tobytes() for row in levels.astype(np.int8)]
        new = {key: row for key, row in zip(keys, levels, strict=True) if key not in known}
        if new:
            known.update(zip(new, rms_percent(residuals(np.array(list(new.values()), dtype=np.float64))).tolist(), strict=True))
        return np.array([known[key] for key in keys])

    units = np.eye(count, dtype=np.int64)
    alone = np.concatenate([np.zeros((1, count), dtype=np.int64), units, -units])
    found = residuals(alone.astype(np.float64))
    known.update(zip((row.tobytes() for row in alone.astype(np.int8)), rms_percent(found).tolist(), strict=True))
    nominal, plus, minus = found[0], found[1 : count + 1], found[count + 1 :]
    slopes = np.nan_to_num(0.5 * (plus - minus))
    # At a corner every square is 1, so that the quadratic terms of single deviations are a constant.
    constant = np.nan_to_num(nominal + np.sum(0.5 * (plus + minus) - nominal, axis=0))
    random = np.random.Generator(np.random.Philox(seed))
    ranked = _rank_corners(slopes, constant, random)
    starts = ranked[np.argsort(-percent(ranked), kind="stable")[:CLIMBED]]
    starts = np.concatenate([starts, random.choice(np.array([-1, 1]), (RANDOM_STARTS, count))])
    worst, value = _climb(percent, starts)
    while count <= MOST_PAIRED:
        pairs = _pairs_changed(worst)
        values = percent(pairs)
        if not values.size or not values.max() > value:
            break
        worst, value = _climb(percent, pairs[np.argmax(values)][None])
    linear = float(rms_percent(nominal + worst @ slopes + (worst != 0) @ (0.5 * (plus + minus) - nominal)))
    return WorstCombination(worst, value, linear, len(known))


def _rank_corners(slopes: Floats, constant: Floats, random: np.random.Generator) -> Ints:
    """The corners (at most RANKED, k) with the largest root mean square of the linear model."""
    count = slopes.shape[0]
    if count <= MOST_LISTED:
        corners = np.array(list(itertools.product((-1, 1), repeat=count)), dtype=np.int64)
    else:
        # The model's square is x G x + 2 h x: from many starts, each sign is changed as long as that increases it.
        matrix, vector = slopes @ slopes.T, slopes @ constant
        axes = np.linalg.eigh(matrix)[1][:, -4:].T
        starts = np.concatenate([vector[None], axes, -axes, random.standard_normal((MODEL_STARTS, count))])
        corners = np.where(starts >= 0.0, 1, -1)
        for _ in range(10 * count):
            gain = -corners * (corners @ matrix + vector) + np.diag(matrix)
            best = np.argmax(gain, axis=1)
            rising = gain[np.arange(len(corners)), best] > 1e-12 * np.abs(np.diag(matrix)).sum()
            if not rising.any():
                break
            corners[rising, best[rising]] *= -1
        corners = np.unique(corners, axis=0)
    size = rms_percent(constant + corners @ slopes)
    return np.asarray(corners[np.argsort(-size, kind="stable")[:RANKED]])


def _climb(percent: Callable[[Ints], Floats], starts: Ints) -> tuple[Ints, float]:
    """From every start (s, k) to a combination that no change of one level makes worse; the worst of these."""
    now, value = starts.copy(), percent(starts)
    moving = np.ones(len(now), dtype=bool)
    count = starts.shape[1]
    while moving.any():
        places = np.flatnonzero(moving)
        near = np.concatenate([_singles_changed(now[place]) for place in places])
        values = percent(near).reshape(len(places), 2 * count)
        best = np.argmax(values, axis=1)
        reached = values[np.arange(len(places)), best]
        rising = reached > value[places]
        near = near.reshape(len(places), 2 * count, count)
        now[places[rising]] = near[np.arange(len(places)), best][rising]
        value[places[rising]] = reached[rising]
        moving[places[~rising]] = False
    first = int(np.argmax(value))
    return now[first], float(value[first])


def _singles_changed(levels: Ints) -> Ints:
    """The combinations (2 k, k) that differ from one in one level."""
    near = np.repeat(levels[None], 2 * levels.size, axis=0)
    for k, level in enumerate(levels):
        near[2 * k, k], near[2 * k + 1, k] = (each for each in (1, -1, 0) if each != level)
    return near


def _pairs_changed(levels: Ints) -> Ints:
    """The combinations (2 k (k - 1), k) that differ from one in two levels."""
    others = [[each for each in (1, -1, 0) if each != level] for level in levels]
    pairs = [(i, a, j, b) for i, j in itertools.combinations(range(levels.size), 2) for a in others[i] for b in others[j]]
    near = np.repeat(levels[None], len(pairs), axis=0)
    for row, (i, a, j, b) in zip(near, pairs, strict=True):
        row[i], row[j] = a, b
    return near
