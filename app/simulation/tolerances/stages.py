"""The stages of a tolerance study (paper, section 3.3), over any response of the instrument.

The paper finds the limits of each deviation alone, then evaluates all combinations within them, and reduces the limits until no
combination fails. Values are in degrees or mm, as the deviations; the criterion is in percent.
"""

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from goniotwin.app.simulation.corner_search import WorstCombination, rms_percent, search_worst
from goniotwin.arrays import Flags, Floats, Ints

CHUNK = 8192
"""Number of combinations that are evaluated at a time."""
CONFIRMED, WORST_CONFIRMED = 50, 20
"""Random combinations, and the worst ones by a surrogate, that are evaluated exactly."""
SCANNED, HALVINGS = 36, 30
"""Amounts at which a deviation alone is evaluated, and halvings of the interval in which it fails first."""
ReportShare = Callable[[float, str], None]
"""Receives the share that is done, and the current step."""


class Response(Protocol):
    """The residuals of the instrument: their root mean square is the criterion."""

    def residuals(self, values: Floats) -> Floats:
        """Residuals (n, m) of combinations (n, k) of the deviations' values."""
        ...


class Surrogate(Protocol):
    """A second evaluator of the criterion, faster and not exact."""

    def percents(self, blocks: Iterable[Floats]) -> Iterator[Floats]:
        """The criterion (n,) of each block of combinations (n, k) of the deviations' values."""
        ...


@dataclass(frozen=True, eq=False)
class LimitsAlone:
    """Each of k deviations alone, all others zero: the criterion (k, 2) at minus and plus its limit, in percent.

    `permitted` (k, limits of the criterion) are the largest amounts up to which neither sign exceeds each limit of the
    criterion; infinite for one that does not exceed it up to `largest` (k,).
    """

    percent: Floats
    permitted: Floats
    largest: Floats


@dataclass(frozen=True, eq=False)
class Combinations:
    """The criterion of many combinations: `percent` (n,). Every combination of the levels if `complete`, else random ones.

    `within` are the limits of the criterion. Shares and their standard errors are by these; the errors are zero if `complete`.
    `surviving` (k, 2): the least and the greatest value of each deviation among the combinations that pass the first limit.
    `worst` (k,) are the values of the worst combination. If a surrogate has computed `percent`, `surrogate_error_percent` is
    its largest error, in percentage points, at random combinations and at its worst ones; these are exact.
    """

    percent: Floats
    complete: bool
    within: tuple[float, ...]
    surviving: Floats
    worst: Floats
    surrogate_error_percent: float | None = None

    @property
    def shares(self) -> tuple[tuple[float, float], ...]:
        """Share of the combinations within each limit, and its standard error."""
        counted = [counted_share(self.percent <= limit) for limit in self.within]
        return tuple((share, 0.0 if self.complete else error) for share, error in counted)

    @property
    def worst_percent(self) -> float:
        """The largest criterion."""
        return float(self.percent.max())


@dataclass(frozen=True, eq=False)
class ReducedLimits:
    """Limits (k,) within which no combination fails, and the worst of them; `factor` relative to the limits given."""

    limits: Floats
    factor: float
    worst: WorstCombination


def counted_share(passed: Flags) -> tuple[float, float]:
    """Share of True, and its standard error; with n of n it is that of one failure among n + 2 (Laplace's rule)."""
    count, number = passed.size, int(np.count_nonzero(passed))
    share = (number + 1) / (count + 2)
    return number / count, math.sqrt(share * (1.0 - share) / count)


def limits_alone(response: Response, limits: Floats, largest: Floats, within: Sequence[float]) -> LimitsAlone:
    """Stage 1: each deviation alone, at its limits (k,), and the amount up to `largest` (k,) at which it fails first.

    The amounts are scanned in 36 geometric steps, so that the first of several failures is found, and the step is then halved.
    """
    count = limits.size
    at_limits = _alone(response, np.repeat(limits[:, None], 1, axis=1))[:, 0]
    percent = np.stack([at_limits[:count], at_limits[count:]], axis=1)
    amounts = largest[:, None] * np.geomspace(1e-3, 1.0, SCANNED)[None]
    scanned = _alone(response, amounts).reshape(2, count, SCANNED).max(axis=0)
    permitted = np.empty((count, len(within)))
    for column, limit in enumerate(within):
        failing = scanned > limit
        first = np.argmax(failing, axis=1)
        high = amounts[np.arange(count), first]
        low = np.where(first > 0, amounts[np.arange(count), np.maximum(first - 1, 0)], 0.0)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            fails = _alone(response, middle[:, None]).reshape(2, count).max(axis=0) > limit
            low, high = np.where(fails, low, middle), np.where(fails, middle, high)
        permitted[:, column] = np.where(failing.any(axis=1), low, np.inf)
    return LimitsAlone(percent, permitted, largest)


def _alone(response: Response, amounts: Floats) -> Floats:
    """Criterion (2 k, a) of k deviations alone at minus, then at plus, each of the amounts (k, a)."""
    count, steps = amounts.shape
    values = np.zeros((2, count, steps, count))
    for k in range(count):
        values[0, k, :, k], values[1, k, :, k] = -amounts[k], amounts[k]
    rows = values.reshape(-1, count)
    pieces = [rms_percent(response.residuals(rows[first : first + CHUNK])) for first in range(0, len(rows), CHUNK)]
    return np.concatenate(pieces).reshape(2 * count, steps)


def all_combinations(
    response: Response,
    levels: Sequence[Floats],
    within: tuple[float, ...],
    report: ReportShare = lambda _share, _step: None,
    surrogate: Surrogate | None = None,
) -> Combinations:
    """Stage 2: every combination of the levels of each deviation, in chunks; `report` is called after each.

    The last deviation changes first. With a surrogate that evaluates them; its worst combinations, and random ones for its
    error, are then evaluated exactly.
    """
    shape = tuple(each.size for each in levels)
    number = math.prod(shape)

    def combinations(numbers: Ints) -> Floats:
        places = np.unravel_index(numbers, shape)
        return np.stack([values[place] for values, place in zip(levels, places, strict=True)], axis=1)

    def chunks() -> Iterator[Floats]:
        return (combinations(np.arange(first, min(first + CHUNK, number))) for first in range(0, number, CHUNK))

    if surrogate is None:
        return _evaluate(_with_percents(response, chunks()), number, len(levels), True, within, report)
    pairs = zip(chunks(), surrogate.percents(chunks()), strict=True)
    found = _evaluate(pairs, number, len(levels), True, within, report)
    worst = np.argsort(-found.percent, kind="stable")[:WORST_CONFIRMED]
    chosen = np.concatenate([worst, np.random.Generator(np.random.Philox(number)).integers(0, number, CONFIRMED)])
    exact = rms_percent(response.residuals(combinations(chosen)))
    error = float(np.abs(found.percent[chosen] - exact).max())
    percent = found.percent.copy()
    percent[chosen] = exact
    place = worst[int(np.argmax(exact[: worst.size]))]
    return replace(found, percent=percent, worst=combinations(np.array([place]))[0], surrogate_error_percent=error)


def evaluate_draws(
    response: Response, draws: Floats, within: tuple[float, ...], report: ReportShare = lambda _share, _step: None
) -> Combinations:
    """The criterion of random combinations (n, k), in chunks."""
    chunks = (draws[first : first + CHUNK] for first in range(0, len(draws), CHUNK))
    return _evaluate(_with_percents(response, chunks), len(draws), draws.shape[1], False, within, report)


def _with_percents(response: Response, chunks: Iterable[Floats]) -> Iterator[tuple[Floats, Floats]]:
    return ((values, rms_percent(response.residuals(values))) for values in chunks)


def _evaluate(
    chunks: Iterable[tuple[Floats, Floats]],
    number: int,
    count: int,
    complete: bool,
    within: tuple[float, ...],
    report: ReportShare,
) -> Combinations:
    percent = np.empty(number)
    surviving = np.stack([np.full(count, np.inf), np.full(count, -np.inf)], axis=1)
    worst, largest, done = np.zeros(count), -math.inf, 0
    for values, found in chunks:
        percent[done : done + len(values)] = found
        passed = values[found <= within[0]]
        if len(passed):
            surviving[:, 0] = np.minimum(surviving[:, 0], passed.min(axis=0))
            surviving[:, 1] = np.maximum(surviving[:, 1], passed.max(axis=0))
        place = int(np.argmax(found))
        if found[place] > largest:
            worst, largest = values[place].copy(), float(found[place])
        done += len(values)
        report(done / number, f"{done} of {number} combinations")
    return Combinations(percent, complete, within, surviving, worst)


def worst_combination(response: Response, limits: Floats, start: Ints | None = None) -> WorstCombination:
    """The worst combination of deviations at their limits (k,), without an enumeration (see `search_worst`)."""
    return search_worst(lambda levels: response.residuals(levels * limits), limits.size, start=start)


def reduce_limits(response: Response, limits: Floats, within: float, worst: WorstCombination | None = None) -> ReducedLimits:
    """Stage 3: all limits (k,) reduced by one factor, the largest with which no combination fails; 0 if none is small enough.

    The factor is halved at the worst corner; the worst corner of the reduced limits is searched anew, until it is the same. A
    factor above 1 is not searched for: limits that pass are returned as they are.
    """
    worst = worst_combination(response, limits) if worst is None else worst
    factor = 1.0
    while worst.percent > within * (1.0 + 1e-9):
        low, high = 0.0, factor
        corner = worst.levels * limits
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            fails = rms_percent(response.residuals((middle * corner)[None]))[0] > within
            low, high = (low, middle) if fails else (middle, high)
        factor = low
        if factor < 1e-9:
            factor = 0.0
            worst = worst_combination(response, 0.0 * limits)
            break
        worst = worst_combination(response, factor * limits)
    return ReducedLimits(factor * limits, factor, worst)


def levels_of(limit: float, step: float) -> Floats:
    """Values from minus to plus `limit` in steps of `step`, zero among them; the limits always are."""
    count = math.floor(limit / step + 1e-9)
    inner = step * np.arange(-count, count + 1)
    ends = [] if math.isclose(count * step, limit, rel_tol=1e-9) else [limit]
    return np.concatenate([-np.array(ends), inner, np.array(ends)])


def random_corners(limits: Floats, number: int, seed: int) -> Floats:
    """Random corners (number, k) of the limits (k,)."""
    signs: Ints = np.random.Generator(np.random.Philox(seed)).choice(np.array([-1, 1]), (number, limits.size))
    return np.asarray(signs * limits)
