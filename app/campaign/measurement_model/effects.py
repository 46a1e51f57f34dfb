"""The effects of all inputs on some values, and what follows from them: budgets, covariances, integrals (JCGM 102).

    y_i = f_i (1 + sum_k J_ik e_k + sum_g s_ig e_g + e_i)

The parts of a value's relative uncertainty: `independent`, by name; `groups`: many inputs of one kind, each common to a few
values (the reading of the etalon, a row's lamp, a photodiode's angle); `dense`: few inputs, each common to nearly all values.
All inputs are uncorrelated, and relative or in a unit of their own. Sensitivities are computed from pose and slopes when they
are needed, for some values at a time, and not kept.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.arrays import Floats, Ints


@dataclass(frozen=True)
class Group:
    """Inputs of one kind. `member` (n, m) has the numbers of the inputs that a value depends on, -1 for none.

    `sensitivity` (n, m) is the relative change of the value for a change of the input by one unit, and `inputs` names them by
    their numbers. Where a value has one input twice (the gain of sample and etalon), its sensitivities add.
    """

    name: str
    inputs: Mapping[int, InputQuantity]
    member: Ints
    sensitivity: Floats


@dataclass(frozen=True)
class Dense:
    """Inputs of nearly all values: `sensitivity` (n, inputs), the relative change of a value for a change by one unit."""

    inputs: Sequence[InputQuantity]
    sensitivity: Floats


@dataclass(frozen=True)
class Component:
    """One line of a budget: an input (or an independent part, without one), and its standard uncertainty in the value's unit.

    `sensitivity` is in the value's unit over the input's; 1 of an independent part.
    """

    name: str
    u: float
    sensitivity: float
    input: InputQuantity | None


@dataclass(frozen=True)
class Effects:
    """Values (n,) with the effects of all inputs; `independent` are relative variances (n,) by name."""

    value: Floats
    independent: Mapping[str, Floats]
    groups: Sequence[Group]
    dense: Sequence[Dense]

    def variances(self) -> dict[str, Floats]:
        """Variance (n,) in the value's unit squared, by the name of the independent part, of the group or of the input."""
        found = {name: variance * self.value**2 for name, variance in self.independent.items()}
        for group in self.groups:
            found[group.name] = found.get(group.name, 0.0) + group_variance(group) * self.value**2
        for part in self.dense:
            for k, each in enumerate(part.inputs):
                found[each.name] = (part.sensitivity[:, k] * each.u * self.value) ** 2
        return found

    def budget(self, index: int) -> list[Component]:
        """The components of one value, the largest first; their squares sum to the square of its uncertainty."""
        weight = np.zeros(self.value.size)
        weight[index] = 1.0
        return self.of_sum(weight)

    def covariance(self, one: Ints, other: Ints) -> Floats:
        """Covariance matrix of the values `one` with the values `other`, in the unit squared."""
        relative = np.zeros((one.size, other.size))
        same = one[:, None] == other[None, :]
        for variance in self.independent.values():
            relative += np.where(same, variance[one][:, None], 0.0)
        for group in self.groups:
            u_squared = _group_u_squared(group)
            for a in range(group.member.shape[1]):
                for b in range(group.member.shape[1]):
                    together = group.member[one, a][:, None] == group.member[other, b][None, :]
                    product = (group.sensitivity[one, a] * u_squared[one, a])[:, None] * group.sensitivity[other, b][None, :]
                    relative += np.where(together, product, 0.0)
        for part in self.dense:
            weighted = part.sensitivity * np.array([each.u for each in part.inputs])
            relative += weighted[one] @ weighted[other].T
        return relative * self.value[one][:, None] * self.value[other][None, :]

    def paired_covariance(self, one: Ints, other: Ints) -> Floats:
        """Covariance (m,) of the value `one[k]` with the value `other[k]`, in the unit squared; for many pairs."""
        relative = np.zeros(one.size)
        for variance in self.independent.values():
            relative += np.where(one == other, variance[one], 0.0)
        for group in self.groups:
            u_squared = _group_u_squared(group)
            for a in range(group.member.shape[1]):
                for b in range(group.member.shape[1]):
                    product = group.sensitivity[one, a] * u_squared[one, a] * group.sensitivity[other, b]
                    relative += np.where(group.member[one, a] == group.member[other, b], product, 0.0)
        for part in self.dense:
            weighted = part.sensitivity * np.array([each.u for each in part.inputs])
            relative += np.sum(weighted[one] * weighted[other], axis=1)
        return relative * self.value[one] * self.value[other]

    def of_sum(self, weight: Floats) -> list[Component]:
        """Components of sum(weight * value), the largest first: of a mean, of a reflectance, of one value.

        The sensitivity of an input is d(sum) / d(input); of an independent part it is 1.
        """
        used = np.flatnonzero(weight != 0.0)
        scale = weight[used] * self.value[used]
        found = [
            Component(name, float(np.sqrt(np.sum(scale**2 * variance[used]))), 1.0, None)
            for name, variance in self.independent.items()
        ]
        for group in self.groups:
            member, product = group.member[used], group.sensitivity[used] * scale[:, None]
            numbers, place = np.unique(member, return_inverse=True)
            total = np.bincount(place.ravel(), weights=product.ravel(), minlength=numbers.size)
            found += [
                _component(group.inputs[number], each)
                for number, each in zip(numbers.tolist(), total.tolist(), strict=True)
                if number >= 0
            ]
        for part in self.dense:
            sums = (scale @ part.sensitivity[used]).tolist()
            found += [_component(each, at) for each, at in zip(part.inputs, sums, strict=True)]
        return sorted(found, key=lambda each: -each.u)


def _group_u_squared(group: Group) -> Floats:
    """The squared u (n, m) of the inputs that each value depends on; 0 for none."""
    numbers, place = np.unique(group.member, return_inverse=True)
    u_squared = np.array([group.inputs[k].u ** 2 if k >= 0 else 0.0 for k in numbers.tolist()])
    return u_squared[place.reshape(group.member.shape)]


def _component(each: InputQuantity, sensitivity: float) -> Component:
    return Component(each.name, abs(sensitivity) * each.u, sensitivity, each)


def group_variance(group: Group) -> Floats:
    """Relative variance (n,) of each value from a group: where it has one input twice, the sensitivities add first."""
    n, m = group.member.shape
    u_squared = _group_u_squared(group)
    total = np.zeros(n)
    for a in range(m):
        for b in range(m):
            same = group.member[:, a] == group.member[:, b]
            total += np.where(same, group.sensitivity[:, a] * group.sensitivity[:, b] * u_squared[:, a], 0.0)
    return total


def dense_of(group: Group) -> Dense:
    """A group of few inputs as inputs of all values."""
    numbers = list(group.inputs)
    sums = [np.where(group.member == k, group.sensitivity, 0.0).sum(axis=1) for k in numbers]
    return Dense([group.inputs[k] for k in numbers], np.stack(sums, axis=1))


def merged(parts: Iterable[list[Component]]) -> list[Component]:
    """Components of a sum over several parts of the values (blocks): what has one name in several is one input.

    A part may state an input in another unit: what adds up is the effect of one standard uncertainty.
    """
    shared: dict[str, Component] = {}
    for part in parts:
        for each in part:
            before = shared.get(each.name)
            if before is None:
                shared[each.name] = each
            elif each.input is None:
                shared[each.name] = Component(each.name, float(np.hypot(before.u, each.u)), 1.0, None)
            else:
                effect = (
                    before.sensitivity * (0.0 if before.input is None else before.input.u) + each.sensitivity * each.input.u
                )
                of_unit = effect / each.input.u if each.input.u else before.sensitivity + each.sensitivity
                shared[each.name] = Component(each.name, abs(effect), of_unit, each.input)
    return sorted(shared.values(), key=lambda each: -each.u)
