"""The worst combination of deviations without an enumeration: a quadratic model ranks the combinations, exact values decide.

Every deviation is in units of its limit, from -1 to 1. The criterion is the root mean square of residuals: of formula 5 over
the directions, or of the one relative change of a flux. A convex criterion is largest where every deviation is at a limit, a
corner. It is not convex in a deviation that only blurs or attenuates: then zero is as good a level as the limits.
"""

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats, Ints

Residuals = Callable[[Floats], Floats]
"""Residuals (n, m) of combinations (n, k) of k deviations, in units of their limits."""

MOST_LISTED = 13
"""Largest number of deviations whose corners are all ranked by the model: 8,192 corners."""
MODEL_STARTS = 64
"""Number of corners from which the model is climbed."""
RANKED, CLIMBED, RANDOM_STARTS = 48, 12, 4
"""Number of combinations that are evaluated first; of those, and of random corners, from which the search climbs."""
RESTARTS, EXCHANGED = 16, 3
"""Of more deviations than are listed: number of random corners, and of results of which two deviations are exchanged."""


@dataclass(frozen=True, eq=False)
class WorstCombination:
    """The worst combination: `levels` (k,) of -1, 0 or 1 limits, its criterion, and that of a linear model.

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


class _QuadraticModel:
    """Residuals as a quadratic function of levels: exact for each deviation alone, and for each two at plus their limits."""

    def __init__(self, nominal: Floats, plus: Floats, minus: Floats, pairs: Floats) -> None:
        count = len(plus)
        self._rows, self._columns = np.triu_indices(count)
        self.nominal, self.slopes = nominal, 0.5 * (plus - minus)
        products = np.empty((len(self._rows), nominal.size))
        alone = self._rows == self._columns
        products[alone] = 0.5 * (plus + minus) - nominal
        products[~alone] = pairs - plus[self._rows[~alone]] - plus[self._columns[~alone]] + nominal
        # A combination without a value has no part in the model; it fails by its exact value.
        self._terms = np.nan_to_num(np.concatenate([self.slopes, products]))

    def percent(self, levels: Ints) -> Floats:
        """Criterion (n,) of levels (n, k)."""
        terms = np.concatenate([levels, levels[:, self._rows] * levels[:, self._columns]], axis=1).astype(np.float64)
        return rms_percent(np.nan_to_num(self.nominal) + terms @ self._terms)

    def linear_percent(self, levels: Ints) -> float:
        """Criterion of levels (k,), without products and squares."""
        return float(rms_percent(self.nominal + levels @ self.slopes))


def search_worst(residuals: Residuals, count: int, seed: int = 0, start: Ints | None = None) -> WorstCombination:
    """The combination of `count` deviations, each at -1, 0 or 1 limit, with the largest criterion.

    1. Residuals with each deviation alone at both limits, and with each two of them, give a quadratic model.
    2. The first combinations by this model are evaluated. So are random corners: where a criterion is flat about zero, as a
       flux is until the light's edge reaches the square, the model knows nothing.
    3. From the worst of them, single deviations are changed to another level as long as that is worse; then two at a time,
       also with all signs changed, and with the deviations that matter least at zero.

    More than 13 deviations have too many corners to be ranked by the model. The search then begins at more random corners, and
    one deviation after another takes its worst level; of the worst three results two deviations at a time are changed.

    The search begins at `start` (k,), too: a combination that is known to be bad.

    The result is the worst of all that was evaluated; nothing is taken from the model. It is proven to be the worst of all
    combinations only where these are enumerated.
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
    pairs = np.array([units[i] + units[j] for i, j in itertools.combinations(range(count), 2)], dtype=np.int64)
    first = np.concatenate([np.zeros((1, count), dtype=np.int64), units, -units, pairs.reshape(-1, count)])
    found = residuals(first.astype(np.float64))
    known.update(zip((row.tobytes() for row in first.astype(np.int8)), rms_percent(found).tolist(), strict=True))
    model = _QuadraticModel(found[0], found[1 : count + 1], found[count + 1 : 2 * count + 1], found[2 * count + 1 :])
    random = np.random.Generator(np.random.Philox(seed))
    ranked = _rank_combinations(model, count, random)
    listed = count <= MOST_LISTED
    starts = ranked[np.argsort(-percent(ranked), kind="stable")[: CLIMBED if listed else RANDOM_STARTS]]
    starts = np.concatenate([starts, random.choice(np.array([-1, 1]), (RANDOM_STARTS if listed else RESTARTS, count))])
    if start is not None:
        starts = np.concatenate([starts, start[None]])
    worst, value = _climb(percent, starts) if listed else _exchange(percent, starts, random)
    # The criterion hardly changes if all signs do: a search on one side alone could miss the slightly worse one.
    for start in (worst, -worst):
        now, reached = _climb(percent, start[None])
        while True:
            near = _zeroed(percent, now)
            if listed:
                near = np.concatenate([near, _pairs_changed(now[None])[0]])
            values = percent(near)
            if not values.max() > reached:
                break
            now, reached = _climb(percent, near[np.argmax(values)][None])
        if reached > value:
            worst, value = now, reached
    return WorstCombination(worst, value, model.linear_percent(worst), len(known))


def _rank_combinations(model: _QuadraticModel, count: int, random: np.random.Generator) -> Ints:
    """The combinations (at most RANKED, k) with the largest criterion of the model."""
    if count <= MOST_LISTED:
        corners = np.array(list(itertools.product((-1, 1), repeat=count)), dtype=np.int64)
        starts = corners[np.argsort(-model.percent(corners), kind="stable")[:MODEL_STARTS]]
    else:
        # The signs of the linear terms against the residuals, and of the directions in which these are largest.
        slopes = np.nan_to_num(model.slopes)  # a combination without light has no slope
        axes = np.linalg.eigh(slopes @ slopes.T)[1][:, -4:].T
        first = np.concatenate([(slopes @ model.nominal)[None], axes, -axes])
        drawn = random.standard_normal((MODEL_STARTS - len(first), count))
        starts = np.where(np.concatenate([first, drawn]) >= 0.0, 1, -1)
    climbed = _climb_all(model.percent, starts)[0]
    if count <= MOST_LISTED:
        near = _pairs_changed(climbed).reshape(-1, count)
        climbed = np.concatenate([climbed, near]) if near.size else climbed
    candidates = np.concatenate([starts, climbed])
    numbers = (candidates + 1).astype(np.uint64) @ np.uint64(3) ** np.arange(count, dtype=np.uint64)
    candidates = candidates[np.unique(numbers, return_index=True)[1]]
    return np.asarray(candidates[np.argsort(-model.percent(candidates), kind="stable")[:RANKED]])


def _climb(percent: Callable[[Ints], Floats], starts: Ints) -> tuple[Ints, float]:
    """From every start (s, k) to a combination that no change of one level makes worse; the worst of these."""
    reached, values = _climb_all(percent, starts)
    best = int(np.argmax(values))
    return reached[best], float(values[best])


def _climb_all(percent: Callable[[Ints], Floats], starts: Ints) -> tuple[Ints, Floats]:
    """From every start (s, k) to a combination that no change of one level makes worse, and its criterion (s,)."""
    now, value = starts.copy(), percent(starts)
    moving = np.ones(len(now), dtype=bool)
    count = starts.shape[1]
    while moving.any():
        places = np.flatnonzero(moving)
        near = np.stack([_singles_changed(now[place]) for place in places])
        values = percent(near.reshape(-1, count)).reshape(len(places), 2 * count)
        best = np.argmax(values, axis=1)
        reached = values[np.arange(len(places)), best]
        rising = reached > value[places]
        now[places[rising]] = near[np.arange(len(places)), best][rising]
        value[places[rising]] = reached[rising]
        moving[places[~rising]] = False
    return now, value


def _exchange(percent: Callable[[Ints], Floats], starts: Ints, random: np.random.Generator) -> tuple[Ints, float]:
    """The worst combination from any start (s, k) by changes of single deviations, and of the worst ones two at a time."""
    reached, values = _sweep_all(percent, starts, random)
    _, first = np.unique(reached, axis=0, return_index=True)
    chosen = first[np.argsort(-values[first], kind="stable")[:EXCHANGED]]
    best = int(chosen[0])
    worst, value = reached[best], float(values[best])
    for place in chosen:
        now, current = reached[place], float(values[place])
        while True:
            near = _pairs_changed(now[None])[0]
            found = percent(near)
            if not found.max() > current:
                break
            swept, risen = _sweep_all(percent, near[np.argmax(found)][None], random)
            now, current = swept[0], float(risen[0])
        if current > value:
            worst, value = now, current
    return worst, value


def _sweep_all(percent: Callable[[Ints], Floats], starts: Ints, random: np.random.Generator) -> tuple[Ints, Floats]:
    """From every start (s, k) one deviation after another to its worst level, in random order, until none changes.

    A step costs two evaluations, where a climb by the best of all changes takes two for each deviation.
    """
    now, value = starts.copy(), percent(starts)
    moving = np.ones(len(now), dtype=bool)
    while moving.any():
        changed = np.zeros(len(now), dtype=bool)
        places = np.flatnonzero(moving)
        for k in random.permutation(starts.shape[1]):
            near = np.repeat(now[places], 2, axis=0)
            near[0::2, k], near[1::2, k] = (now[places, k] + 2) % 3 - 1, (now[places, k] + 3) % 3 - 1
            values = percent(near).reshape(-1, 2)
            best = np.argmax(values, axis=1)
            risen = values[np.arange(len(places)), best]
            rising = risen > value[places]
            now[places[rising]] = near.reshape(len(places), 2, -1)[np.arange(len(places)), best][rising]
            value[places[rising]] = risen[rising]
            changed[places[rising]] = True
        moving = changed
    return now, value


def _zeroed(percent: Callable[[Ints], Floats], levels: Ints) -> Ints:
    """The combinations (k, k) in which the one, two, and so on, deviations are zero that change the criterion least."""
    single = np.where(np.eye(levels.size, dtype=bool), 0, levels)
    order = np.argsort(-percent(single), kind="stable")  # none of them is worse
    near = np.repeat(levels[None], levels.size, axis=0)
    for count in range(1, levels.size + 1):
        near[count - 1, order[:count]] = 0
    return near


def _singles_changed(levels: Ints) -> Ints:
    """The combinations (2 k, k) that differ from one in one level."""
    near = np.repeat(levels[None], 2 * levels.size, axis=0)
    for k, level in enumerate(levels):
        near[2 * k, k], near[2 * k + 1, k] = (each for each in (1, -1, 0) if each != level)
    return near


def _pairs_changed(levels: Ints) -> Ints:
    """The combinations (n, 2 k (k - 1), k) that differ from each of (n, k) in two levels."""
    count = levels.shape[1]
    steps = [(i, a, j, b) for i, j in itertools.combinations(range(count), 2) for a in (1, 2) for b in (1, 2)]
    near = np.repeat(levels[:, None], len(steps), axis=1)
    for place, (i, a, j, b) in enumerate(steps):
        near[:, place, i] = (levels[:, i] + 1 + a) % 3 - 1
        near[:, place, j] = (levels[:, j] + 1 + b) % 3 - 1
    return near
