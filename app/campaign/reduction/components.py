"""Components of the uncertainty of a value: their names, which of them are alike, and the rules of u and its interval.

A component is the *variance* by one family of inputs, or by what a value has alone, in the square of the value's unit and in an
array of the values' shape. For tables a component is wholly shared between neighbouring directions or, if it is independent,
not at all. `Quantity` has the effects that they come from.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Self

import numpy as np

from goniotwin.app.campaign.measurement_model.alignment import ALIGNMENT
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.measurement_model.quantity import Components, Quantity
from goniotwin.app.campaign.reduction.reading_inputs import (
    Describe,
    band_shape_input,
    calibration_input,
    dark_input,
    declared_input,
    etalon_input,
    gain_input,
    lamp_input,
    monitor_input,
    signature_common,
    signature_input,
)
from goniotwin.app.columns import IntegerColumn
from goniotwin.app.rig import RigFile
from goniotwin.app.rig import inputs as declared
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.plant.disturbances import SharedBy

DETECTED = 3.0
"""A value below so many of its standard uncertainties is below the detection limit."""


@dataclass(frozen=True)
class Kind:
    """What the errors of a component are like. All is False of inputs that values of any direction have in common.

    `words` name it for a reader; empty of one of files that is not named here.
    `inputs` describes an input of the readings by its number (any, of one that all values have); None of what each value has
    alone, and of inputs that follow from files and poses (scale.py, angles.py).
    `independent`: they differ between neighbouring directions, each of which has readings of its own at the sample and at the
    etalon. Not so of what is shared in part: that its errors average out would be a claim, so u is at most too large.
    `added`: they are added to a value whatever its size. All others are shares of it.
    `of_quotient`: they count where two signals are divided: no light is lost in them.
    `unlit`: they are there without light from the sample: the noise floor.
    `of_angles`: they state the effect of unknown angles, where slopes are too little of it.
    `of_row`: all photodiodes of a row have them in common, at the sample and at the etalon.
    `of_direction`: they are the same for two values of one direction, or of a direction and its mirror image.
    """

    words: str = ""
    inputs: Describe | None = None
    independent: bool = False
    added: bool = False
    of_quotient: bool = False
    unlit: bool = False
    of_angles: bool = False
    of_row: bool = False
    of_direction: bool = False


OTHER = Kind()
"""Of a component of files that is not named here."""
KINDS: Mapping[str, Kind] = {
    "noise": Kind("noise of the readings", independent=True, added=True, unlit=True),
    "resolution": Kind("step of the converter", independent=True, added=True, unlit=True),
    "ray_tracing": Kind("scatter of traced rays", independent=True, added=True),
    "dark": Kind("dark readings", dark_input, added=True, unlit=True),
    "lamp": Kind("light that the monitor does not correct", lamp_input, of_row=True),
    "monitor": Kind("noise of the monitor", monitor_input, of_quotient=True, of_row=True),
    "gain": Kind("ratio of the gains", gain_input, of_quotient=True),
    declared.LINEARITY.name: Kind("linearity of the photodiode", declared_input(declared.LINEARITY), of_quotient=True),
    declared.MONITOR_DRIFT.name: Kind("drift of the monitor", declared_input(declared.MONITOR_DRIFT), of_quotient=True),
    declared.MONITOR_LINEARITY.name: Kind(
        "linearity of the monitor", declared_input(declared.MONITOR_LINEARITY), of_quotient=True
    ),
    declared.CROSSTALK.name: Kind("cross-talk of other channels", declared_input(declared.CROSSTALK), added=True, unlit=True),
    "signature": Kind("change of the instrument signature by the sample", signature_common, added=True),
    "signature_reading": Kind("noise of the reading without a sample", signature_input, independent=True, added=True),
    "etalon_reading": Kind("noise of the reading of the etalon", etalon_input, independent=True),
    "calibration": Kind("factor of the photodiode by overlaps", calibration_input),
    declared.FIELD_OF_VIEW.name: Kind("size of the field of view", declared_input(declared.FIELD_OF_VIEW)),
    "field_noise": Kind("noise of the slopes in the correction of the field of view", independent=True, added=True),
    "field_unresolved": Kind("field of view, not resolved by the directions", independent=True, added=True),
    "second_order": Kind("angles, second order", of_angles=True),
    "slope_unresolved": Kind("slope that the directions do not resolve", of_angles=True),
    "pose": Kind("tilts, zeros and shifts of the rig and of mountings"),
    "position": Kind("position of the axes after a move"),
    "photodiode_angle": Kind("place of the photodiode on its arc"),
    "certificate": Kind("certificate of the etalon", of_direction=True),
    "standards": Kind("disagreement of the two standards", of_direction=True),
    "open_beam": Kind("scale by the open beam", of_direction=True),
    "slit_image": Kind("hole lit in part"),
    declared.WAVELENGTH.name: Kind("wavelength", of_direction=True),
    "bandwidth": Kind("bandwidth of the light", of_direction=True),
    "band_shape": Kind("shape of the spectrum within the band", band_shape_input, of_direction=True),
    declared.MONOCHROMATOR_STRAY.name: Kind("light of other wavelengths", of_direction=True),
    "polarisation": Kind("polarisation of the light", of_direction=True),
}
"""All components by name, but for the declared factors on the light of sample and etalon."""


def kinds() -> dict[str, Kind]:
    """All components by name. A factor that is another after each move is common to the photodiodes of a row.

    Raises ValueError for a factor of the name of another component.
    """
    of_row = {each.name: each.shared_by is SharedBy.MOVE for each in declared.factors()}
    if same := of_row.keys() & KINDS.keys():
        raise ValueError(f"a declared factor has the name of a component: {', '.join(sorted(same))}")
    texts = {each.name: each.text.partition(";")[0] for each in declared.factors()}
    return {**KINDS, **{name: Kind(texts[name], of_row=each, of_direction=not each) for name, each in of_row.items()}}


NAME = re.compile(r"([^\[@*]+)(?:\*([^\[@]+))?(?:\[([^\]]*)\])?(?:@(.*))?", re.DOTALL)
"""A component or an input as budgets name it: what it is, what it is multiplied by, its element, and its row or mounting."""


def words_of(name: str) -> str:
    """A component or an input of a budget in words for a reader, with its element, and its row, move or mounting."""
    found = NAME.fullmatch(name)
    if found is None:
        return name
    first, second, element, place = found.groups(default="")
    moved = first == declared.POSITION.name or place.startswith("#")
    element = element if first == ALIGNMENT else re.sub(r"^\d+(?=,|$)", r"photodiode \g<0>", element)
    place = re.sub(r"^dark (?=\d)", "dark reading ", place)
    place = re.sub(r",?#(?=\d+$)", ", move " if moved else ", mounting ", place).removeprefix(", ")
    details = ", ".join(filter(None, (element, place)))
    return f"{' times '.join(_words_of_kind(each) for each in (first, second) if each)}{f' ({details})' if details else ''}"


def _words_of_kind(name: str) -> str:
    named = [each.text.partition(";")[0] for each in declared.inputs() if each.name == name]
    turned = re.sub("tilt_(?=[xyz]$)", "tilt about ", re.sub("shift_(?=[xyz]$)", "shift along ", name))
    return kinds().get(name, OTHER).words or (named[0] if named else turned.replace("_", " "))


def input_of(component: str, number: int, rig: RigFile) -> InputQuantity:
    """An input of the readings; `number` is any of one that all values have in common."""
    describe = KINDS[component].inputs
    assert describe is not None
    return describe(number, rig)


INDEPENDENT = frozenset(name for name, each in KINDS.items() if each.independent)
ADDED = frozenset(name for name, each in KINDS.items() if each.added)
UNLIT = frozenset(name for name, each in KINDS.items() if each.unlit)
COVERAGE = 1.96
"""Standard uncertainties from a value to the ends of its interval of 95 %."""
LOGARITHMIC = 0.15
"""Relative standard uncertainty above which an interval is one of the logarithm."""
LINEAR_LAW, LOGARITHMIC_LAW, DRAWN_LAW = "linear", "logarithmic", "drawn"
"""The intervals that a value may have, as files name them; a drawn one is by the law of an input that is not normal."""
MOST_LOGARITHMIC = 100.0
"""A larger relative uncertainty has the interval of this one: the ends of its own are no numbers."""


def interval_rule(added: str) -> str:
    """The rule of `interval` in words, with the components `added`."""
    return (
        f"an interval of k u is value +- k u; where u is above {100.0 * LOGARITHMIC:g} % of the value and at least half of its "
        f"variance is of shares of the value (all components but {added}), it is value exp(+-k u / value)"
    )


def mostly_added(components: Components) -> Flags:
    """Whether more than half of a variance is of ADDED components: then a deviation is one of the value at any u."""
    added = total_variance({name: each for name, each in components.items() if name in ADDED})
    return np.asarray(added > 0.5 * total_variance(components))


def logarithmic(value: Floats, u: Floats, added: Flags) -> Flags:
    """Whether the interval of a value is one of the logarithm: u is above 15 % of it, and not for the most part `added`.

    On a lobe's flank an error of an angle moves a value by a factor; noise does not know how large the value is.
    """
    return np.asarray((value > 0.0) & (u > LOGARITHMIC * value) & ~added)


def interval(
    value: Floats, u: Floats, added: Flags, down: Floats | float = COVERAGE, up: Floats | float = COVERAGE
) -> tuple[Floats, Floats]:
    """Lower and upper ends of the values' intervals, so many standard uncertainties `u` away; `added` of `mostly_added`."""
    chosen = logarithmic(value, u, added)
    share = np.minimum(np.where(chosen, u, 0.0) / np.where(chosen, value, 1.0), MOST_LOGARITHMIC)
    low, high = (
        np.where(chosen, value * np.exp(-down * share), value - down * u),
        np.where(chosen, value * np.exp(up * share), value + up * u),
    )
    return low, high


def deviation_in_u(value: Floats, u: Floats, added: Flags, expected: Floats) -> Floats:
    """Deviations (n,) of values from what is expected, in their u: within `interval` where they are within its coverage."""
    u = np.maximum(u, np.finfo(float).tiny)
    chosen = logarithmic(value, u, added) & (expected > 0.0)
    ratio = np.where(chosen, value, 1.0) / np.where(chosen, expected, 1.0)
    return np.where(chosen, np.log(ratio) * value / u, (value - expected) / u)


def total_variance(components: Components) -> Floats:
    """The variance of values from all of their components."""
    return np.asarray(sum(components.values()), dtype=float)


def standard_uncertainty(components: Components) -> Floats:
    """The combined standard uncertainty u of values, in their unit."""
    return np.sqrt(total_variance(components))


def shared_variance(components: Components) -> Floats:
    """The part of the variance whose errors have one sign in neighbouring directions, so that no interpolation reduces them."""
    none = np.zeros_like(total_variance(components))
    return none + total_variance({name: each for name, each in components.items() if name not in INDEPENDENT})


@dataclass(frozen=True)
class Signal(Quantity):
    """Photocurrents over the monitor's current, one element for each photodiode, or (rows, photodiodes).

    `gain` is the index of the gain that is used, -1 where all gains are saturated.
    """

    gain: IntegerColumn = field(kw_only=True)

    @classmethod
    def of(cls, quantity: Quantity, gain: Ints) -> Self:
        """The signals of a quantity, read at these gains."""
        return cls(quantity.value, quantity.own, quantity.common, quantity.grouped, gain=gain)

    @property
    def reading_variance(self) -> Floats:
        """The variance by what light is lost in: all components but those `of_quotient`."""
        alone = [each for name, each in self.components.items() if not KINDS[name].of_quotient]
        return np.zeros(self.value.shape) + sum(alone)

    @property
    def lost_in_noise(self) -> Flags:
        """Whether values are below the detection limit."""
        return np.isfinite(self.value) & (self.value < DETECTED * np.sqrt(self.reading_variance))

    def of_photodiodes(self, channels: Ints) -> "Signal":
        """The signals (rows, photodiodes) of some photodiodes."""
        return self.each(lambda array: np.take(array, channels, axis=1))
