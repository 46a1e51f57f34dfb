"""All components of points as effects of named inputs: which values share which error.

What came in with the readings, points carry (points.py). The effects of what the files state (angles.py, scale.py) follow from
pose and slopes, and are computed for some points at a time when they are needed: points have their variances alone. Budgets,
covariances and integrals follow.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.measurement_model.effects import Dense, Effects, Group
from goniotwin.app.campaign.measurement_model.quantity import NONE
from goniotwin.app.campaign.reduction.angles import angles
from goniotwin.app.campaign.reduction.components import input_of
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.scale import EffectsOf, shared_families
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.arrays import Floats


def effects_of(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The effects of all inputs on points with values; NaN for others. Memory: some hundred inputs a point."""
    value = _scale(points)
    groups, dense = [], []
    for name, effect in points.common.items():
        source = input_of(name, 0, settings.rig)
        dense.append(Dense([source], (effect / (source.u * value))[:, None]))
    for name, terms in points.grouped.items():
        numbers, which = np.unique(terms.member, return_inverse=True)
        inputs = {k: input_of(name, k, settings.rig) for k in numbers.tolist() if k != NONE}
        u = np.array([inputs[k].u if k != NONE else 1.0 for k in numbers.tolist()])[which.reshape(terms.member.shape)]
        relative = np.divide(terms.effect, u * value[:, None], out=np.zeros(u.shape), where=u != 0.0)
        groups.append(Group(name, inputs, terms.member.astype(np.int64), relative))
    families = {**FAMILIES, **shared_families()}
    for family in dict.fromkeys(families[name] for name in points.stated):  # one function may have several components
        if (found := family(points, settings)) is not None:
            # A relative change leaves a value of 0 as it is.
            unit = (found.value / value)[:, None]
            groups += [replace(each, sensitivity=each.sensitivity * unit) for each in found.groups]
            dense += [replace(each, sensitivity=each.sensitivity * unit) for each in found.dense]
    independent = {name: np.maximum(each, 0.0) / value**2 for name, each in points.own.items()}
    return Effects(value, independent, groups, dense)


def _scale(points: BsdfPoints) -> Floats:
    """The values (n,); 1 in place of 0, which has no relative uncertainty."""
    return np.where(points.bsdf == 0.0, 1.0, points.bsdf)


FAMILIES: Mapping[str, EffectsOf] = {"pose": angles, "position": angles, "photodiode_angle": angles}
"""The families of inputs of angles by the names of their components: each gives the effects of its inputs on points."""
