"""The components by errors of angles, and all components of points as effects of named inputs: which values share which error.

A component of a point (components.py) is a variance by the name of a family of inputs. `effects_of` divides it among the inputs
of that family, from pose, slopes and kept columns, for some points at a time: budgets, covariances and integrals follow. The
parts of a family sum to its variance. A component that is no family is one input that all values share, or, if it is in
INDEPENDENT, none.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from goniotwin.app.campaign.reduction.components import INDEPENDENT
from goniotwin.app.campaign.reduction.etalon import ReductionSettings
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.uncertainty.effects import Dense, Effects, Group
from goniotwin.app.campaign.uncertainty.inputs import Input
from goniotwin.app.campaign.uncertainty.pose import (
    POSITIONS,
    Displacement,
    PoseEffects,
    Views,
    mounting_inputs,
    photodiode_inputs,
    pose_effects,
    position_input,
    rig_inputs,
    variance,
)
from goniotwin.app.rig import nominal_instrument
from goniotwin.arrays import Floats, Ints

ANGLES = tuple(PLACE.index(f"{axis}_deg") for axis in POSITIONS)
JOURNAL = "the journal's readings"


def add_pose(points: BsdfPoints, settings: ReductionSettings) -> BsdfPoints:
    """Add the components `pose`, `position` and `photodiode_angle`; without slopes they have their diffuse part alone.

    `pose` is that of all inputs that the rig or a mounting has once, `position` that of the axes' positions after each move.
    """
    poses = [tuple(each) for each in points.places[:, ANGLES].tolist()]
    sums = settings.geometry.pose_sums(poses)[points.place, points.photodiode]
    along, across = slopes(points)
    table = settings.rig.uncertainty
    u_along, u_across = table.standard("photodiode_angle_deg"), table.standard("photodiode_across_deg")
    squared = points.bsdf**2
    added = {
        "pose": variance(sums[:, 0], along, across) * squared,
        "position": variance(sums[:, 1], along, across) * squared,
        "photodiode_angle": ((along * u_along) ** 2 + (across * u_across) ** 2) * squared,
    }
    return replace(points, components={**points.components, **added})


def slopes(points: BsdfPoints) -> tuple[Floats, Floats]:
    """The slopes (n,) along the arc and across it, per degree; 0 where they are unknown: the noise is larger."""
    return np.nan_to_num(points.slope_along), np.nan_to_num(points.slope_across)


def effects_of(points: BsdfPoints, settings: ReductionSettings) -> Effects:
    """The effects of all inputs on points with values; NaN for others. Memory: some hundred inputs a point."""
    # A value of 0 has no relative uncertainty: it is scaled to 1.
    value = np.where(points.bsdf == 0.0, 1.0, points.bsdf)
    independent: dict[str, Floats] = {}
    groups: list[Group] = []
    dense: list[Dense] = []
    effects = _PointEffects(points, settings, points.bsdf / value)
    for name, component in points.components.items():
        relative = np.sqrt(np.maximum(component, 0.0)) / np.abs(value)
        if name in FAMILIES:
            for part in FAMILIES[name](effects, relative):
                (dense if isinstance(part, Dense) else groups).append(part)
        elif name in INDEPENDENT:
            independent[name] = relative**2
        else:
            dense.append(_shared(name, relative))
    return Effects(value, independent, groups, dense)


def _shared(name: str, relative: Floats, shared_by: str = "all values") -> Dense:
    """One input of all values; its sensitivity has the size of the component."""
    return Dense([Input(name, "1", 1.0, "normal", shared_by, JOURNAL, "")], relative[:, None])


class _PointEffects:
    """The parts of each family; `relative` (n,) is the square root of its component's relative variance.

    `present` is 1, and 0 for a value of 0, which a relative change leaves as it is.
    """

    def __init__(self, points: BsdfPoints, settings: ReductionSettings, present: Floats) -> None:
        self.points = points
        self.settings = settings
        self._present = present
        self._table = settings.rig.uncertainty
        self._along, self._across = slopes(points)
        self._kept: PoseEffects | None = None

    def pose(self, relative: Floats) -> Iterator[Dense]:
        """All inputs that the rig or a mounting has once."""
        del relative
        effects = self._pose
        yield Dense(rig_inputs(self._table), self._relative(effects.common))
        for kind, rows, part in (
            ("sample", self.points.row, effects.sample),
            ("etalon", self.points.etalon_row, effects.etalon),
        ):
            names = self._mountings(kind, rows)
            sensitivity = self._relative(part)
            for name in dict.fromkeys(names):
                here = np.array([each == name for each in names])
                yield Dense(mounting_inputs(self._table, kind, name), np.where(here[:, None], sensitivity, 0.0))

    def position(self, relative: Floats) -> Iterator[Group]:
        """The axes' positions at the row and at the etalon's row, each common to all rows until the axis' next move."""
        del relative
        points, effects = self.points, self._pose
        moves = np.concatenate([self._moves(points.row), self._moves(points.etalon_row)], axis=1)
        axis = np.tile(np.arange(len(POSITIONS)), 2)
        numbers = moves * len(POSITIONS) + axis
        inputs = {
            number: position_input(self._table, POSITIONS[number % len(POSITIONS)], number // len(POSITIONS))
            for number in np.unique(numbers).tolist()
        }
        sensitivity = np.concatenate([self._relative(effects.position), self._relative(effects.etalon_position)], axis=1)
        yield Group("position", inputs, numbers, sensitivity)

    def photodiode_angle(self, relative: Floats) -> Iterator[Group]:
        """Each photodiode's own angles."""
        del relative
        photodiode = self.points.photodiode.astype(np.int64)
        inputs = {
            2 * c + k: each for c in np.unique(photodiode).tolist() for k, each in enumerate(photodiode_inputs(self._table, c))
        }
        numbers = 2 * photodiode[:, None] + np.arange(2)
        yield Group("photodiode_angle", inputs, numbers, self._relative(self._pose.photodiode))

    def etalon_reading(self, relative: Floats) -> Iterator[Group]:
        """The etalon's reading: common to all values that were divided by it."""
        points = self.points
        keys = np.stack([points.etalon_row, points.photodiode], axis=1)
        shared = "all values that divide by it"
        yield _grouped("etalon_reading", keys, relative, lambda key: f"[{key[1]}]@row {key[0]}", shared, sign=-1.0)

    def dark(self, relative: Floats) -> Iterator[Group]:
        """The dark readings of a photodiode and a gain before and after a row."""
        points = self.points
        history = self.settings.history
        interval = points.row if history is None else history.darks(points.row)
        keys = np.stack([points.photodiode, points.gain, interval], axis=1)
        # Its volts are one share of a bright value and another of a dark one.
        yield _grouped(
            "dark", keys, relative, lambda key: f"[{key[0]}, {self._gain(key[1])}]@dark {key[2]}",
            "rows of this photodiode and gain until the next dark reading", sign=-1.0, scaled=True,
        )  # fmt: skip

    def monitor(self, relative: Floats) -> Iterator[Group]:
        """The monitor's reading at the row, and at the etalon's row."""
        u = self.settings.rig.monitor.relative_uncertainty
        numbers = np.stack([self.points.row, self.points.etalon_row], axis=1)
        each = {
            number: Input(
                f"monitor@row {number}", "1", u, "normal", "all photodiodes of the row", "rig file, monitor", "monitor.noise"
            )
            for number in np.unique(numbers).tolist()
        }
        yield Group("monitor", each, numbers, _pair(relative, u))

    def lamp(self, relative: Floats) -> Iterator[Group]:
        """What the photodiodes of the row have in common, and those of the etalon's row, in equal parts."""
        numbers = np.stack([self.points.row, self.points.etalon_row], axis=1)
        largest = float(np.nan_to_num(relative).max(initial=0.0)) / np.sqrt(2.0)
        each = {
            number: Input(f"lamp@row {number}", "1", largest, "normal", "all photodiodes of the row", JOURNAL, "light.flicker")
            for number in np.unique(numbers).tolist()
        }
        yield Group("lamp", each, numbers, _pair(relative, largest))

    def linearity(self, relative: Floats) -> Iterator[Dense]:
        """The photodiodes' linearity: it raises what is brighter than the etalon, and lowers what is darker."""
        u = self._table.linearity_per_decade
        each = Input("linearity", "1 per decade", u, "normal", "all values", "rig file, uncertainty", "linearity_per_decade")
        brighter = np.where(self.points.bsdf * np.pi < self.settings.certificate.factor.mean(), -1.0, 1.0)
        yield Dense([each], (brighter * relative / u if u > 0.0 else np.zeros(relative.size))[:, None])

    def crosstalk(self, relative: Floats) -> Iterator[Group]:
        """The share of a channel's volts that its module's others see: one for each module."""
        modules = self.points.photodiode // self.settings.rig.photodiodes.module_channels
        yield _grouped(
            "crosstalk", modules[:, None], relative, lambda key: f"[module {key[0]}]", "values of the module's channels",
            scaled=True,
        )  # fmt: skip

    def gain(self, relative: Floats) -> Iterator[Group]:
        """The gains of a photodiode at the row and at the etalon's row: one and the same gain cancels."""
        u, points = self.settings.rig.photodiodes.gain_uncertainty, self.points
        count = len(self.settings.rig.photodiodes.gains_v_per_a) + 1
        gains = np.stack([points.gain, points.etalon_gain], axis=1) % count  # none, -1, is the last one
        numbers = points.photodiode[:, None] * count + gains
        inputs = {
            number: Input(
                f"gain_ratio[{number // count}, {self._gain(number % count)}]", "1", u, "normal",
                "all values of this photodiode at this gain", "rig file, photodiodes.gain_uncertainty", "",
            )
            for number in np.unique(numbers).tolist()
        }  # fmt: skip
        yield Group("gain", inputs, numbers, _pair(relative, u))

    def calibration(self, relative: Floats) -> Iterator[Group]:
        """The factors of the photodiodes from their overlaps."""
        keys = self.points.photodiode[:, None]
        yield _grouped("calibration", keys, relative, lambda key: f"[{key[0]}]", "all values of this photodiode")

    def certificate(self, relative: Floats) -> Iterator[Dense]:
        """The certificate: what all of it has in common, and what its entries have beyond that, taken as common too."""
        common = float(self.settings.certificate.relative_uncertainty.min())
        level = np.minimum(common, relative)
        source = "the etalon's certificate"
        rest = np.sqrt(np.maximum((relative - level) * (relative + level), 0.0))
        inputs = [Input(f"certificate[{name}]", "1", 1.0, "normal", "all values", source, "") for name in ("level", "entries")]
        yield Dense(inputs, np.stack([level, rest], axis=1))

    def signature(self, relative: Floats) -> Iterator[Dense]:
        """The instrument signature, which was subtracted."""
        yield _shared("signature", -relative)

    def field(self, relative: Floats) -> Iterator[Dense]:
        """The variance of the directions in the field of view, by what its correction has added."""
        yield _shared("field", np.where(self.points.field_correction < 0.0, -1.0, 1.0) * relative)

    @property
    def _pose(self) -> PoseEffects:
        if self._kept is None:
            points = self.points
            lower = points.transmitted != points.back
            views = Views(
                sigma_deg=points.sigma_deg,
                gamma_deg=points.gamma_deg,
                polar=np.radians(np.where(lower, 180.0 - points.zenith_deg, points.zenith_deg)),
                azimuth=np.radians(points.azimuth_deg),
                lower=lower,
                transmitted=points.transmitted,
                reverse=np.cos(np.radians(points.azimuth_deg - points.beta_deg)) < 0.0,
            )
            self._kept = pose_effects(nominal_instrument(self.settings.rig), views)
        return self._kept

    def _relative(self, part: Displacement) -> Floats:
        return part.relative(self._along, self._across) * self._present[:, None]

    def _mountings(self, kind: str, rows: Ints) -> list[str]:
        history = self.settings.history
        return [f"{kind}#1"] * rows.size if history is None else history.mountings(rows)

    def _moves(self, rows: Ints) -> Ints:
        history = self.settings.history
        return np.repeat(rows[:, None], len(POSITIONS), axis=1) if history is None else history.moves(rows)

    def _gain(self, index: int) -> str:
        gains = self.settings.rig.photodiodes.gains_v_per_a
        return f"{gains[index]:g} V/A" if 0 <= index < len(gains) else "no gain"


def _pair(relative: Floats, u: float) -> Floats:
    """Sensitivities (n, 2) to two inputs of one uncertainty, of which the value is the quotient."""
    size = relative / (np.sqrt(2.0) * u) if u > 0.0 else np.zeros(relative.size)
    return np.stack([-size, size], axis=1)


def _grouped(
    name: str, keys: Ints, relative: Floats, label: Callable[[Sequence[int]], str], shared_by: str,
    *, sign: float = 1.0, scaled: bool = False,
) -> Group:  # fmt: skip
    """A group with one input for each of `keys` (n, k); with `scaled` its uncertainty is 1, else that of its largest value."""
    distinct, which = np.unique(keys, axis=0, return_inverse=True)
    which = which.ravel()
    u = np.ones(len(distinct))
    if not scaled:
        u = np.zeros(len(distinct))
        np.maximum.at(u, which, np.nan_to_num(relative))
    inputs = {
        k: Input(f"{name}{label(key)}", "1", float(u[k]), "normal", shared_by, JOURNAL, "")
        for k, key in enumerate(distinct.tolist())
    }
    sensitivity = sign * relative / np.where(u > 0.0, u, 1.0)[which]
    return Group(name, inputs, which[:, None], sensitivity[:, None])


FAMILIES: Mapping[str, Callable[[_PointEffects, Floats], Iterator[Group | Dense]]] = {
    name: getattr(_PointEffects, name)
    for name in (
        "pose", "position", "photodiode_angle", "etalon_reading", "dark", "monitor", "lamp", "gain", "linearity",
        "crosstalk", "calibration", "certificate",
        "signature", "field",
    )
}  # fmt: skip
"""The families of inputs by the names of their components."""
