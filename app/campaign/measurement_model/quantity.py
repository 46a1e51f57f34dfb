"""A value that carries the effects of its inputs through sums, differences and quotients (GUM 5.1; JCGM 102, 6.2).

    y = value + sum_i e_i + sum_k c_k x_k + sum_g s_g x_g

x are the errors of inputs in their standard uncertainties: uncorrelated, of mean 0 and variance 1. So a coefficient is the
change of the value, in its unit, for one standard uncertainty of the input. e are errors that no other value has. Coefficients
keep their signs: what two quantities have in common cancels by itself, and nothing is squared before the end.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from operator import itemgetter
from typing import Self

import numpy as np

from goniotwin.app.columns import ColumnTable, MemberColumn, NumberColumn
from goniotwin.arrays import Floats, Indices

Components = Mapping[str, NumberColumn]
"""Variances by the names of components, each in the shape of the values and in the square of their unit."""
NONE = -1
"""Number of no input."""


@dataclass(frozen=True)
class Terms(ColumnTable):
    """Effects of a family of inputs: `member` (..., m) are the numbers of the inputs that a value has, NONE for none.

    `effect` (..., m) are the changes of the value for one standard uncertainty of each. A value has each input once.
    """

    member: MemberColumn
    effect: NumberColumn

    @property
    def variance(self) -> Floats:
        """The variance (...) of the values by these inputs, summed in their order: places without an input change no bit."""
        total = np.zeros(self.effect.shape[:-1])
        for k in range(self.effect.shape[-1]):
            total += self.effect[..., k] ** 2
        return total

    def scaled(self, factor: Floats | float) -> "Terms":
        """The effects on the values times a factor (...)."""
        return Terms(self.member, self.effect * np.asarray(factor)[..., None])

    def plus(self, other: "Terms") -> "Terms":
        """The effects on the sums of values: of an input that both have they add."""
        shape = np.broadcast_shapes(self.member.shape[:-1], other.member.shape[:-1])
        mine, others = self._broadcast(shape), other._broadcast(shape)
        effect, member, left = mine.effect.copy(), others.member, others.effect
        for b in range(member.shape[-1]):
            for a in range(effect.shape[-1]):
                same = (mine.member[..., a] == member[..., b]) & (member[..., b] != NONE)
                if same.any():
                    effect[..., a] += np.where(same, left[..., b], 0.0)
                    if member is others.member:
                        member, left = member.copy(), left.copy()
                    member[..., b] = np.where(same, NONE, member[..., b])
                    left[..., b] = np.where(same, 0.0, left[..., b])
        further = [b for b in range(member.shape[-1]) if (member[..., b] != NONE).any()]
        return Terms(
            np.concatenate([mine.member, member[..., further]], axis=-1), np.concatenate([effect, left[..., further]], axis=-1)
        )

    def _broadcast(self, shape: tuple[int, ...]) -> "Terms":
        m = self.member.shape[-1]
        return self.each(lambda array: np.broadcast_to(array, (*shape, m)))


@dataclass(frozen=True)
class Quantity(ColumnTable):
    """Values with the effects of their inputs. All arrays have the shape of `value`; those of `grouped` one axis more.

    By name: `own` are variances of what each value has alone; `common` the effects of one input that all values have;
    `grouped` those of families of inputs, each of which some values have.
    """

    value: NumberColumn
    own: Components = field(default_factory=dict)
    common: Mapping[str, NumberColumn] = field(default_factory=dict)
    grouped: Mapping[str, Terms] = field(default_factory=dict)

    @property
    def components(self) -> dict[str, Floats]:
        """The variances by name, in the order of the names: their sum is the same in whatever order they came in."""
        of_common = {name: effect**2 for name, effect in self.common.items()}
        of_grouped = {name: terms.variance for name, terms in self.grouped.items()}
        return dict(sorted({**self.own, **of_common, **of_grouped}.items()))

    @property
    def variance(self) -> Floats:
        """The variances of the values."""
        return np.zeros(self.value.shape) + sum(self.components.values())

    def scaled(self, factor: Floats | float) -> Self:
        """The values times an exactly known factor."""
        squared = np.square(factor)
        return replace(
            self,
            value=self.value * factor,
            own={name: each * squared for name, each in self.own.items()},
            common={name: each * factor for name, each in self.common.items()},
            grouped={name: each.scaled(factor) for name, each in self.grouped.items()},
        )

    def __sub__(self, other: "Quantity") -> "Quantity":
        return self._plus(other.scaled(-1.0))

    def __truediv__(self, other: "Quantity") -> "Quantity":
        value = self.value / other.value
        return replace(self.scaled(1.0 / other.value)._plus(other.scaled(-value / other.value)), value=value)

    def _plus(self, other: "Quantity") -> "Quantity":
        own, common, grouped = dict(self.own), dict(self.common), dict(self.grouped)
        for name, each in other.own.items():
            own[name] = own[name] + each if name in own else each
        for name, each in other.common.items():
            common[name] = common[name] + each if name in common else each
        for name, terms in other.grouped.items():
            grouped[name] = grouped[name].plus(terms) if name in grouped else terms
        return Quantity(self.value + other.value, own, common, grouped)

    def with_own(self, name: str, variance: Floats | float) -> Self:
        """With a further variance that each value has alone; it is added to one of the same name."""
        added = np.broadcast_to(variance, self.value.shape)
        return replace(self, own={**self.own, name: self.own[name] + added if name in self.own else added})

    def with_common(self, name: str, effect: Floats | float) -> Self:
        """With the effect of one input that all values have."""
        return replace(self, common={**self.common, name: np.broadcast_to(effect, self.value.shape)})

    def with_grouped(self, name: str, member: Indices, effect: Floats) -> Self:
        """With the effects (..., m) of a family of inputs, by their numbers; without a family of none."""
        if not member.shape[-1]:
            return self
        shape = (*self.value.shape, np.broadcast_shapes(member.shape, effect.shape)[-1])
        terms = Terms(np.broadcast_to(member, shape), np.broadcast_to(effect, shape))
        return replace(self, grouped={**self.grouped, name: terms})

    def own_as(self, name: str, member: Indices) -> Self:
        """With one input of a family in place of all that each value has alone: other values will have it too."""
        effect = np.sqrt(np.zeros(self.value.shape) + sum(self.own.values()))
        return replace(self, own={}).with_grouped(name, member[..., None], effect[..., None])

    def summed(self) -> "Quantity":
        """The sum of the values along the first axis."""
        total = Quantity(
            self.value.sum(axis=0),
            {name: each.sum(axis=0) for name, each in self.own.items()},
            {name: each.sum(axis=0) for name, each in self.common.items()},
        )
        return replace(total, grouped={name: _summed(each) for name, each in self.grouped.items()})


def _summed(terms: Terms) -> Terms:
    """The effects on the sums along the first axis."""
    numbers = np.unique(terms.member)
    numbers = numbers[numbers != NONE]
    if terms.member.ndim == 2:  # of values in a row: their inputs may be many
        place = np.searchsorted(numbers, terms.member)
        known = terms.member != NONE
        sums = np.bincount(place[known], weights=terms.effect[known], minlength=numbers.size)
        return Terms(numbers, np.asarray(sums, dtype=np.float64))
    total = terms.each(itemgetter(0))
    for k in range(1, len(terms.member)):
        total = total.plus(terms.each(itemgetter(k)))
    return total
