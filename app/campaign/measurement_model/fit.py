"""Fit of the shared inputs to residuals of known truth: what is left has to be the independent part (proof of the model).

Values r = J e + s g + e_i, with the dense inputs e and those of the groups g of variance u^2, and the independent errors e_i of
variance v: generalised least squares, weighted by the u of the inputs (a Kalman filter's first step). With C the covariance of
all values, the fitted inputs are U^2 J' C^-1 r, and what is left is V C^-1 r, of covariance V C^-1 V. So both have a known law
without any count of free parameters:

    chi2/n = sum(left^2 / v) / sum(v (C^-1)_ii),        var(fitted) = u^2 - (their variance after the fit)

The group with the most inputs (the readings of the etalon) is eliminated block by block; all other inputs stand in one matrix.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Effects, Group
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.arrays import Flags, Floats, Ints

LEAST_VARIANCE = 1e-18
"""Smallest relative variance of a value's independent part: the weights stay finite."""
REFINED = 3
"""Times that a solution is improved: inputs that are all but free make the matrix of the inputs ill-conditioned."""
ALONE = 2
"""An input that fewer values have than this is part of their independent part."""


@dataclass(frozen=True)
class Fit:
    """Shared inputs fitted to n residuals.

    `chi_square` (n,) are the squares of what is left over their independent variances, and `expected` (n,) their expectations.
    By input: its `estimate` in its unit, and the variance `expected_variance` that the estimate has where the model holds, at
    most u^2: less where the residuals do not determine the input. `covariance` (inputs, inputs) is that of the inputs after the
    fit, each in its unit.
    """

    chi_square: Floats
    expected: Floats
    inputs: tuple[InputQuantity, ...]
    estimate: Floats
    expected_variance: Floats
    covariance: Floats

    def of(self, name: str) -> float:
        """The estimate of an input; 0 where no residual depends on it."""
        found = [value for each, value in zip(self.inputs, self.estimate.tolist(), strict=True) if each.name == name]
        return float(found[0]) if found else 0.0

    def variance_of(self, name: str) -> float:
        """The variance of an input after the fit; 0 where no residual depends on it."""
        found = [float(self.covariance[k, k]) for k, each in enumerate(self.inputs) if each.name == name]
        return found[0] if found else 0.0


class ValuesCovariance:
    """The relative covariance C of values with their effects: its inverse times columns, without C itself."""

    def __init__(self, effects: Effects) -> None:
        independent = np.zeros(effects.value.size)
        for variance in effects.independent.values():
            independent += variance
        groups = [_known(group) for group in effects.groups]
        for group in groups:
            independent += _alone_variance(group)
        self._v = np.maximum(independent, LEAST_VARIANCE)
        eliminated = _largest(groups)
        self._blocks = _Blocks(self._v, eliminated)
        self._inputs, matrix = _matrix(effects, [each for each in groups if each is not eliminated])
        self._u = np.array([each.u for each in self._inputs])
        self._scaled = matrix * self._u
        self._weighted = self._blocks.solve(self._scaled)
        self._inverse = np.linalg.inv(np.eye(self._u.size) + self._scaled.T @ self._weighted)

    def solve(self, columns: Floats) -> Floats:
        """C^-1 times columns (n, m)."""
        fitted = np.zeros((self._u.size, columns.shape[1]))
        left = columns
        for _ in range(REFINED):
            fitted += self._inverse @ (self._weighted.T @ left - fitted)
            left = columns - self._scaled @ fitted
        return self._blocks.solve(left)

    def fit(self, residual: Floats) -> Fit:
        """Fit the shared inputs to relative residuals (n,)."""
        v, u, inverse, weighted = self._v, self._u, self._inverse, self._weighted
        solved = self._blocks.solve(residual[:, None])[:, 0]
        fitted = inverse @ (self._scaled.T @ solved)
        # C^-1 r and the diagonal of C^-1, with C = W^-1 + scaled scaled'.
        whole = solved - weighted @ fitted
        return Fit(
            chi_square=v * whole**2,
            expected=self._expected,
            inputs=tuple(self._inputs),
            estimate=u * fitted,
            expected_variance=u**2 * np.maximum(1.0 - np.diag(inverse), 0.0),
            covariance=u[:, None] * inverse * u,
        )

    @cached_property
    def _expected(self) -> Floats:
        """The expected squares (n,) of what a fit leaves, over the independent variances."""
        weighted = self._weighted
        diagonal = self._blocks.diagonal - np.sum((weighted @ self._inverse) * weighted, axis=1)
        return np.asarray(self._v * diagonal)


@dataclass(frozen=True)
class _Shared:
    """A group without what has no u: `member` (n, m) as in Group, -1 for none; `u` (n, m); `count` of values of each input."""

    inputs: dict[int, InputQuantity]
    member: Ints
    effect: Floats
    count: dict[int, int]


def _known(group: Group) -> _Shared:
    u = {number: each.u for number, each in group.inputs.items()}
    member = group.member.copy()
    of_each = _of_members(member, u, 0.0)
    member[(of_each == 0.0) | (group.sensitivity == 0.0)] = -1
    # An input that a value has twice counts once, with the sum of its sensitivities.
    effect = np.where(member >= 0, group.sensitivity * of_each, 0.0)
    for a in range(member.shape[1]):
        for b in range(a):
            same = (member[:, a] >= 0) & (member[:, a] == member[:, b])
            effect[same, b] += effect[same, a]
            effect[same, a], member[same, a] = 0.0, -1
    numbers, counts = np.unique(member[member >= 0], return_counts=True)
    return _Shared(dict(group.inputs), member, effect, dict(zip(numbers.tolist(), counts.tolist(), strict=True)))


def _of_members(member: Ints, numbers: Mapping[int, Any], none: Any) -> Any:
    """What `numbers` has for each member, `none` for the others: an array of the shape of `member`."""
    distinct, place = np.unique(member, return_inverse=True)
    return np.array([numbers.get(k, none) for k in distinct.tolist()])[place].reshape(member.shape)


def _alone(group: _Shared) -> Flags:
    return np.asarray(_of_members(group.member, group.count, 0) < ALONE)


def _alone_variance(group: _Shared) -> Floats:
    return np.asarray(np.sum(np.where(_alone(group), group.effect**2, 0.0), axis=1))


def _largest(groups: list[_Shared]) -> _Shared | None:
    """The group with the most shared inputs of which each value has one at most."""
    one_each = [each for each in groups if np.all((each.member >= 0).sum(axis=1) <= 1)]
    largest = max(one_each, key=lambda each: len(each.count), default=None)
    return largest if largest is not None and largest.count else None


class _Blocks:
    """The inverse of V + s s' in blocks of values that have one input of a group."""

    def __init__(self, v: Floats, group: _Shared | None) -> None:
        self._v = v
        shared = np.zeros(v.size) if group is None else np.where(_alone(group), 0.0, group.effect).sum(axis=1)
        number = np.full(v.size, -1) if group is None else group.member.max(axis=1)
        _, self._block = np.unique(number, return_inverse=True)
        self._s = np.where(number >= 0, shared, 0.0)
        q = np.bincount(self._block, weights=self._s**2 / v)
        self._factor = 1.0 / (1.0 + q)
        self._order = np.argsort(self._block, kind="stable")
        self._begin = np.flatnonzero(np.diff(self._block[self._order], prepend=-1))
        self.diagonal = 1.0 / v - (self._s / v) ** 2 * self._factor[self._block]

    def solve(self, columns: Floats) -> Floats:
        """The inverse times columns (n, m)."""
        over = columns / self._v[:, None]
        along = np.add.reduceat((self._s[:, None] * over)[self._order], self._begin, axis=0)
        return np.asarray(over - (self._s / self._v)[:, None] * (self._factor[:, None] * along)[self._block])


def _matrix(effects: Effects, groups: list[_Shared]) -> tuple[list[InputQuantity], Floats]:
    """All other inputs with an effect, and the sensitivities (n, inputs) to them."""
    inputs: list[InputQuantity] = []
    columns: list[Floats] = [np.zeros((effects.value.size, 0))]
    for part in effects.dense:
        acting = [k for k, each in enumerate(part.inputs) if each.u > 0.0 and np.any(part.sensitivity[:, k] != 0.0)]
        inputs += [part.inputs[k] for k in acting]
        columns.append(part.sensitivity[:, acting])
    for group in groups:
        numbers = sorted(number for number, count in group.count.items() if count >= ALONE)
        at = {number: k for k, number in enumerate(numbers)}
        place = _of_members(group.member, at, -1)
        block = np.zeros((effects.value.size, len(numbers)))
        u = np.array([group.inputs[number].u for number in numbers])
        row, column = np.nonzero(place >= 0)
        np.add.at(block, (row, place[row, column]), group.effect[row, column])
        inputs += [group.inputs[number] for number in numbers]
        columns.append(block / u if numbers else block)
    return inputs, np.concatenate(columns, axis=1)
