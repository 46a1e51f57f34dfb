"""What a virtual rig is off by: properties of its parts, how widely values are drawn for them, and the drawn values.

Which inputs a rig can be off by is declared where its file is read (`Disturbances` has a key for each). The values are drawn by
name from the rig's seed, so that a further input changes none of the others.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from enum import StrEnum
from typing import Final, NamedTuple, Protocol

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.keys import LATER, NonNegative, check_bounds
from goniotwin.twin import plant
from goniotwin.twin.optics import Deviation, Instrument
from goniotwin.twin.optics.geometry.field import scale_field
from goniotwin.twin.optics.geometry.instrument import COMPONENTS
from goniotwin.twin.plant.process_key import process_key


class SharedBy(StrEnum):
    """What has one value of an input in common, and with it one draw."""

    ALL = "all values"
    MOUNTING = "all values of this mounting"
    PHOTODIODE = "all values of this photodiode"
    AXIS_MOVE = "all rows until its next move"
    MOVE = "all rows until the next move of any axis"
    SCAN = "this scan"


class Target(NamedTuple):
    """A property of a part of the virtual rig, to which drawn values are added; of an element those of `Deviation`."""

    part: str
    property: str


SAMPLE: Final = "sample"
ETALON: Final = "etalon"
SECOND: Final = "second standard"
LIGHT = {path: Target(path, "factor") for path in (SAMPLE, ETALON, SECOND)}
"""The light of a path over what it would be, less 1."""
ANGLE = {axis: Target(axis, "angle_deg") for axis in ("gamma", "sigma", "beta", "shift")}
"""The true angle of an axis, less that of its motor."""
PLAY = Target("axes", "play_deg")
"""Further play of every axis. It is not drawn: the width itself is added."""
ALONG, ACROSS = (Target("photodiode", each) for each in ("along the arc", "across it"))
FIELD = Target("photodiodes", "logarithm of the variance of directions")
LINEARITY = Target("photodiodes", "change for a decade of current")
CROSSTALK = Target("converters", "share of other channels")
MONITOR_LINEARITY, MONITOR_DRIFT = (Target("monitor", f"change for {each}") for each in ("a decade of current", "an hour"))
WAVELENGTH, STRAY_LIGHT = (Target("monochromator", each) for each in ("wavelength in nm", "share of white light"))


class Disturbance(Protocol):
    """Values that are drawn: by the name of each the targets that it is added to; what has one in common; and their law.

    What is `per_year` counts once for each year since the etalon's calibration.
    """

    targets: Mapping[str, tuple[Target, ...]]
    shared_by: SharedBy
    distribution: str
    per_year: bool


@dataclass(frozen=True)
class Disturbances:
    """How far the virtual rig is off; 0 is not at all. The values are drawn once from its seed.

    `etalon`: name of the sample that is the etalon. `etalon_years`: years since the calibration of the etalon.
    `second_standard`: name of the sample that is a second standard, which is off by values of its own. `second_years`: years
    since the second standard's calibration. `turned`: name under which the etalon itself is mounted once more. All three are
    mounted as an etalon is.
    """

    etalon: str = "etalon"
    etalon_years: NonNegative = 0.0
    second_standard: str = field(default="", metadata=LATER)
    second_years: NonNegative = field(default=0.0, metadata=LATER)
    turned: str = field(default="", metadata=LATER)

    def __post_init__(self) -> None:
        check_bounds(self)

    @property
    def widths(self) -> dict[str, tuple[Disturbance, float]]:
        """The disturbances with their half widths or standard deviations, by key: a field has its own as metadata."""
        known = {each.name: each.metadata.get("disturbance") for each in fields(self)}
        return {key: (each, getattr(self, key)) for key, each in known.items() if each is not None}

    def width(self, target: Target) -> float:
        """The widths of what is added to a target, in all."""
        return math.fsum(width for each, width in self.widths.values() if any(target in at for at in each.targets.values()))


class Drawn(Mapping[str, float]):
    """The drawn values of a rig's inputs by name, in the units of their keys: a function of table, seed and name alone.

    As a mapping it has the inputs of the whole rig: `mirror_2_tilt_x`, `arc_shift_z`, `sigma_zero`, `photodiode_angle[7]`,
    `field` and so on. It also gives those that are drawn again: `sample_tilt_x@paint#1` (the first mounting of the sample
    paint), `etalon_height@etalon#2`, `mounting@paint#1`, `position@beta#12` (after the twelfth move of beta, 0 before the
    first), and `repeatability@#40` (after 40 moves of all axes together). KeyError for any other name.
    """

    def __init__(self, table: Disturbances, seed: int, photodiodes: int) -> None:
        self.table = table
        self._seed = seed
        self._photodiodes = photodiodes
        self._once: dict[str, tuple[Disturbance, float]] = {}
        self._again: dict[str, tuple[Disturbance, float]] = {}
        self._added: dict[Target, list[tuple[str, SharedBy, float]]] = {}
        for each, width in table.widths.values():
            known = self._once if each.shared_by in (SharedBy.ALL, SharedBy.PHOTODIODE) else self._again
            for name, targets in each.targets.items():
                own = [f"{name}[{c}]" for c in range(photodiodes)] if each.shared_by is SharedBy.PHOTODIODE else [name]
                known.update(dict.fromkeys(own, (each, width)))
                for target in targets if width else ():
                    years = table.second_years if target == LIGHT[SECOND] else table.etalon_years
                    times = years if each.per_year else 1.0
                    self._added.setdefault(target, []).append((name, each.shared_by, times))
        self.counts_moves = any(
            shared_by is SharedBy.AXIS_MOVE for each in ANGLE.values() for _, shared_by, _ in self._added.get(each, ())
        )
        """Whether the angle of an axis depends on the number of its moves."""
        self._values: dict[str, float] = {}
        self._sums: dict[Target, float] = {}
        self._mounted: dict[tuple[str | None, int], Deviation] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._once)

    def __len__(self) -> int:
        return len(self._once)

    def __getitem__(self, name: str) -> float:
        if (known := self._values.get(name)) is not None:
            return known
        stem, again, _ = name.partition("@")
        if again:
            return self._draw(name, *self._again[stem])
        drawn = self._values[name] = self._draw(name, *self._once[name])
        return drawn

    def _draw(self, name: str, disturbance: Disturbance, width: float) -> float:
        if width == 0.0:
            return 0.0
        process = process_key(self._seed, f"disturbance {name}")
        if disturbance.distribution == "normal":
            return width * float(plant.normal(process, np.int64(0)))
        return width * (float(plant.mix(process, np.int64(0))) / 2.0**63 - 1.0)

    def _drawn_at(self, target: Target, ends: Mapping[SharedBy, str]) -> list[float]:
        """The values that are added to a target, by the ends of their names."""
        added = self._added.get(target, ())
        return [self[name + ends[shared_by]] * times for name, shared_by, times in added if shared_by in ends]

    def of(self, target: Target) -> float:
        """The sum of what the whole rig has added to a target."""
        if (known := self._sums.get(target)) is None:
            known = self._sums[target] = sum(self._drawn_at(target, {SharedBy.ALL: ""}), 0.0)
        return known

    def instrument(self, instrument: Instrument) -> Instrument:
        """The instrument with the deviations of its elements, and the field of view, as drawn."""
        deviations = dict(instrument.deviations)
        amounts = {target: self.of(target) for target in self._added if target.part not in LIGHT}
        for element, drawn in element_deviations(amounts, instrument.pupil_distance_mm).items():
            deviations[element] = add_deviations(instrument.deviation(element), drawn)
        return scale_field(replace(instrument, deviations=deviations), self.of(FIELD))

    def photodiode_angles_deg(self) -> tuple[Floats, Floats]:
        """Each photodiode's own angle (photodiodes,) along the arc, towards its end, and across it, towards growing beta."""
        ends = [{SharedBy.ALL: "", SharedBy.PHOTODIODE: f"[{c}]"} for c in range(self._photodiodes)]
        along, across = (np.array([sum(self._drawn_at(each, end), 0.0) for end in ends]) for each in (ALONG, ACROSS))
        return along, across

    def axis_error_deg(self, axis: str, moves: int) -> float:
        """The difference of an axis' true angle from that of its motor, after so many moves: its zero and its position."""
        return sum(self._drawn_at(ANGLE[axis], {SharedBy.ALL: "", SharedBy.AXIS_MOVE: f"@{axis}#{moves}"}), 0.0)

    def mounted(self, sample: str | None, mounting: int) -> Deviation:
        """The deviation of a sample at one of its mountings, from 1; none for an empty sample unit, or a mounting of 0."""
        known = self._mounted.get((sample, mounting))
        if known is None:
            kind, at = self._mounting(sample, mounting)
            ends = {SharedBy.ALL: "", SharedBy.MOUNTING: at}
            off = {name: sum(self._drawn_at(Target(kind, name), ends), 0.0) for name in COMPONENTS}
            known = self._mounted[sample, mounting] = Deviation(**off)
        return known

    def signal_factor(self, sample: str | None, mounting: int, moves: int) -> float:
        """The factor on a sample's light at one of its mountings, after so many moves of all axes together."""
        kind, at = self._mounting(sample, mounting)
        if not kind:
            return 1.0
        piece = SECOND if sample == self.table.second_standard else kind
        parts = (kind, {SharedBy.MOUNTING: at, SharedBy.MOVE: f"@#{moves}"}), (piece, {SharedBy.ALL: ""})
        again, once = (math.prod([1.0 + each for each in self._drawn_at(LIGHT[of], ends)], start=1.0) for of, ends in parts)
        return again * once

    def _mounting(self, sample: str | None, mounting: int) -> tuple[str, str]:
        """SAMPLE or ETALON, and the end of the names of a mounting; two empty texts for none."""
        if sample is None or mounting == 0:
            return "", ""
        standards = self.table.etalon, self.table.second_standard, self.table.turned
        return ETALON if sample in standards else SAMPLE, f"@{sample}#{mounting}"


def element_deviations(amounts: Mapping[Target, float], pupil_distance_mm: float) -> dict[str, Deviation]:
    """The deviations of the instrument's elements by what is added to them; those that are 0 not.

    `pupil_distance_mm` is the length of the beam from the exit pupil to the sample: a `beam` tilts about the sample's centre.
    """
    own: dict[str, dict[str, float]] = {}
    for (part, name), amount in amounts.items():
        if amount and name in COMPONENTS:
            own.setdefault(part, {})[name] = amount
    beam = Deviation(**own.pop("beam", {}))
    found = {part: Deviation(**each) for part, each in own.items()}
    if beam.rx_deg or beam.rz_deg:
        sideways, upwards = (pupil_distance_mm * math.sin(math.radians(each)) for each in (beam.rz_deg, -beam.rx_deg))
        found["pupil"] = add_deviations(found.get("pupil", Deviation()), replace(beam, x_mm=sideways, z_mm=upwards))
    return found


def add_deviations(one: Deviation, other: Deviation) -> Deviation:
    """The deviation with the angles and shifts of both."""
    return Deviation(*(getattr(one, each.name) + getattr(other, each.name) for each in fields(Deviation)))
