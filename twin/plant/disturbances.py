"""The disturbances of a virtual rig: what it is off by, `[twin.disturbances]` of a rig file, and the values that are drawn.

Each key has the name of one of `[uncertainty]`: what an operator states as the uncertainty of an input is here how far the
input is off. The values are drawn by name from the rig's seed, so that a further input changes none of the others.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Annotated, Any

import numpy as np
from annotated_types import Ge, Le

from goniotwin.arrays import Floats
from goniotwin.keys import LATER, Fraction, NonNegative, check_bounds
from goniotwin.twin.optics import Deviation, Instrument
from goniotwin.twin.optics.geometry.field import scale_field
from goniotwin.twin.plant.noise import mix, normal, process_key

Tilt = Annotated[float, Ge(0.0), Le(5.0)]
Shift = Annotated[float, Ge(0.0), Le(10.0)]
NORMAL: dict[str, Any] = {"distribution": "normal"}
"""Metadata of a key that is a standard deviation. All other keys are half widths of a rectangular distribution."""


@dataclass(frozen=True)
class Disturbances:
    """How far the virtual rig is off, drawn once from its seed; 0 is not at all.

    A key in degrees or mm is the half width of a rectangular distribution. `sample_tilt_deg` (about x and y) and
    `sample_height_mm` are drawn at each mounting of a sample, `etalon_tilt_deg` and `etalon_height_mm` at each of the sample
    called `etalon`. Tilts (`mirror_tilt_deg`, `arc_tilt_deg`, `sensor_tilt_deg`) are about each of two axes, of the arc about
    three; shifts (`mirror_shift_mm`, `arc_shift_mm`, `sensor_shift_mm`, and the exit pupil's `illumination_shift_mm`) along
    each of three. `beam_tilt_deg` turns the illumination unit about the sample's centre, where the light stays, about each of
    the two axes across the beam. All are added to `[twin.deviations]`. The zeros `sigma_zero_deg`, `beta_zero_deg` and
    `shift_zero_deg` are added to the true angles, unseen by switches and encoders. `photodiode_angle_deg` and
    `photodiode_across_deg` are drawn for each photodiode, along the arc and across it. `position_deg` is drawn for an axis at
    each of its moves; `backlash_deg` is not drawn: each axis has so much more play.

    Standard deviations, relative where no unit is named: `field_of_view` of the logarithm of the variance of the directions
    in the field of view, `wavelength_nm` of the true wavelength, `linearity_per_decade` of the photodiodes' current,
    `crosstalk` of the volts of a module's other channels, `monitor_linearity_per_decade` and `monitor_drift_per_hour` (both
    added to those of `[twin.monitor]`), `monochromator_stray` of white light. Of the etalon alone:
    `certificate_level` of its radiance factor against the certificate, `etalon_age_per_year` over `etalon_years`, and
    `etalon_edge`. `uniformity` and `mounting` are drawn at each mounting of a sample, the etalon too, `repeatability`
    after each move of any axis.
    """

    etalon: str = "etalon"
    etalon_years: NonNegative = 0.0
    sample_tilt_deg: Tilt = 0.0
    sample_height_mm: Shift = 0.0
    etalon_tilt_deg: Tilt = 0.0
    etalon_height_mm: Shift = 0.0
    mirror_tilt_deg: Tilt = 0.0
    mirror_shift_mm: Shift = 0.0
    illumination_shift_mm: Shift = 0.0
    beam_tilt_deg: Tilt = field(default=0.0, metadata=LATER)
    arc_tilt_deg: Tilt = 0.0
    arc_shift_mm: Shift = 0.0
    sensor_tilt_deg: Tilt = 0.0
    sensor_shift_mm: Shift = 0.0
    sigma_zero_deg: Tilt = 0.0
    beta_zero_deg: Tilt = 0.0
    shift_zero_deg: Tilt = 0.0
    photodiode_angle_deg: Tilt = 0.0
    photodiode_across_deg: Tilt = 0.0
    position_deg: Tilt = 0.0
    backlash_deg: Tilt = 0.0
    field_of_view: Annotated[float, Ge(0.0), Le(2.0)] = field(default=0.0, metadata=NORMAL)
    wavelength_nm: Annotated[float, Ge(0.0), Le(50.0)] = field(default=0.0, metadata=NORMAL)
    linearity_per_decade: Fraction = field(default=0.0, metadata=NORMAL)
    crosstalk: Fraction = field(default=0.0, metadata=NORMAL)
    monitor_linearity_per_decade: Fraction = field(default=0.0, metadata=NORMAL)
    monitor_drift_per_hour: Fraction = field(default=0.0, metadata=NORMAL)
    certificate_level: Fraction = field(default=0.0, metadata=NORMAL)
    etalon_age_per_year: Fraction = field(default=0.0, metadata=NORMAL)
    etalon_edge: Fraction = field(default=0.0, metadata=NORMAL)
    monochromator_stray: Fraction = field(default=0.0, metadata=NORMAL)
    uniformity: Fraction = field(default=0.0, metadata=NORMAL)
    repeatability: Fraction = field(default=0.0, metadata=NORMAL)
    mounting: Fraction = field(default=0.0, metadata=NORMAL)

    def __post_init__(self) -> None:
        check_bounds(self)


NORMAL_KEYS = frozenset(each.name for each in fields(Disturbances) if each.metadata == NORMAL)
_ELEMENTS: dict[str, tuple[str, str | None, str, str]] = {
    **{f"mirror_{m}": (f"mirror_{m}", "mirror_tilt_deg", "xy", "mirror_shift_mm") for m in (1, 2, 3)},
    "illumination": ("pupil", None, "", "illumination_shift_mm"),
    "arc": ("arc", "arc_tilt_deg", "xyz", "arc_shift_mm"),
    "sensor": ("sensor", "sensor_tilt_deg", "xy", "sensor_shift_mm"),
}
"""Elements with deviations: their names in the instrument, the key and the axes of the tilts, the key of the shifts."""
_KEYS = {
    **{f"{name}_tilt_{axis}": tilt for name, (_, tilt, axes, _) in _ELEMENTS.items() for axis in axes if tilt is not None},
    **{f"{name}_shift_{axis}": shift for name, (_, _, _, shift) in _ELEMENTS.items() for axis in "xyz"},
    **{f"beam_tilt_{axis}": "beam_tilt_deg" for axis in "xz"},
    **{f"{axis}_zero": f"{axis}_zero_deg" for axis in ("sigma", "beta", "shift")},
    "field": "field_of_view",
    "wavelength": "wavelength_nm",
    "linearity": "linearity_per_decade",
    "crosstalk": "crosstalk",
    "monitor_linearity": "monitor_linearity_per_decade",
    "monitor_drift": "monitor_drift_per_hour",
    "certificate[level]": "certificate_level",
    "etalon_age": "etalon_age_per_year",
    "etalon_edge": "etalon_edge",
    "monochromator_stray": "monochromator_stray",
}
"""The key of each input that the rig has once."""
POSE_INPUTS = frozenset(name for name in _KEYS if "_tilt_" in name or "_shift_" in name or name.endswith("_zero"))
"""Inputs of the rig that are a tilt or a shift of an element, or an axis' zero."""
_PHOTODIODE_KEYS = {"photodiode_angle": "photodiode_angle_deg", "photodiode_across": "photodiode_across_deg"}
_REPEATED_KEYS = {
    **{f"{each}_tilt_{axis}": f"{each}_tilt_deg" for each in ("sample", "etalon") for axis in "xy"},
    **{f"{each}_height": f"{each}_height_mm" for each in ("sample", "etalon")},
    "uniformity": "uniformity",
    "mounting": "mounting",
    "position": "position_deg",
    "repeatability": "repeatability",
}
"""The key of each input that is drawn again: its name ends with `@` and what it belongs to."""


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
        self._keys = dict(_KEYS)
        for stem, key in _PHOTODIODE_KEYS.items():
            self._keys |= {f"{stem}[{c}]": key for c in range(photodiodes)}
        self._photodiodes = photodiodes
        self._values: dict[str, float] = {}
        self._mounted: dict[tuple[str | None, int], Deviation] = {}

    def __iter__(self) -> Iterator[str]:
        return iter(self._keys)

    def __len__(self) -> int:
        return len(self._keys)

    def __getitem__(self, name: str) -> float:
        if (known := self._values.get(name)) is not None:
            return known
        stem, again, _ = name.partition("@")
        if again:
            return self._draw(name, _REPEATED_KEYS[stem])
        drawn = self._values[name] = self._draw(name, self._keys[name])
        return drawn

    def _draw(self, name: str, key: str) -> float:
        width: float = getattr(self.table, key)
        if width == 0.0:
            return 0.0
        process = process_key(self._seed, f"disturbance {name}")
        if key in NORMAL_KEYS:
            return width * float(normal(process, np.int64(0)))
        return width * (float(mix(process, np.int64(0))) / 2.0**63 - 1.0)

    def instrument(self, instrument: Instrument) -> Instrument:
        """The instrument with the deviations of its elements, and the field of view, as drawn."""
        deviations = dict(instrument.deviations)
        for element, drawn in element_deviations(self, instrument.pupil_distance_mm).items():
            deviations[element] = add_deviations(instrument.deviation(element), drawn)
        return scale_field(replace(instrument, deviations=deviations), self["field"])

    def photodiode_angles_deg(self) -> tuple[Floats, Floats]:
        """Each photodiode's own angle (photodiodes,) along the arc, towards its end, and across it, towards growing beta."""
        along, across = (np.array([self[f"{stem}[{c}]"] for c in range(self._photodiodes)]) for stem in _PHOTODIODE_KEYS)
        return along, across

    def axis_error_deg(self, axis: str, moves: int) -> float:
        """The difference of an axis' true angle from that of its motor, after so many moves: its zero and its position."""
        zero = self.get(f"{axis}_zero", 0.0)
        return zero + self[f"position@{axis}#{moves}"] if self.table.position_deg else zero

    def mounted(self, sample: str | None, mounting: int) -> Deviation:
        """The deviation of a sample at one of its mountings, from 1; none for an empty sample unit, or a mounting of 0."""
        known = self._mounted.get((sample, mounting))
        if known is None:
            kind, at = self._mounting(sample, mounting)
            known = self._mounted[sample, mounting] = (
                Deviation()
                if not kind
                else Deviation(
                    rx_deg=self[f"{kind}_tilt_x@{at}"], ry_deg=self[f"{kind}_tilt_y@{at}"], z_mm=self[f"{kind}_height@{at}"]
                )
            )
        return known

    def signal_factor(self, sample: str | None, mounting: int, moves: int) -> float:
        """The factor on a sample's light at one of its mountings, after so many moves of all axes together."""
        kind, at = self._mounting(sample, mounting)
        if not kind:
            return 1.0
        result = 1.0 + self[f"repeatability@#{moves}"]
        for each in ("uniformity", "mounting"):
            result *= 1.0 + self[f"{each}@{at}"]
        if kind == "etalon":
            aged = self["etalon_age"] * self.table.etalon_years
            result *= (1.0 + self["certificate[level]"]) * (1.0 + aged) * (1.0 + self["etalon_edge"])
        return result

    def _mounting(self, sample: str | None, mounting: int) -> tuple[str, str]:
        """`sample` or `etalon`, and the end of the names of a mounting; two empty texts for none."""
        if sample is None or mounting == 0:
            return "", ""
        return "etalon" if sample == self.table.etalon else "sample", f"{sample}#{mounting}"


def element_deviations(values: Mapping[str, float], pupil_distance_mm: float) -> dict[str, Deviation]:
    """The deviations of the instrument's elements by the values of inputs, such as `mirror_2_tilt_x`; those that are 0 not.

    `pupil_distance_mm` is the length of the beam from the exit pupil to the sample: the beam tilts about the sample's centre.
    """
    found = {}
    for name, (element, _, axes, _) in _ELEMENTS.items():
        own = {f"r{axis}_deg": values.get(f"{name}_tilt_{axis}", 0.0) for axis in axes}
        own |= {f"{axis}_mm": values.get(f"{name}_shift_{axis}", 0.0) for axis in "xyz"}
        if any(own.values()):
            found[element] = Deviation(**own)
    about_x, about_z = (values.get(f"beam_tilt_{axis}", 0.0) for axis in "xz")
    if about_x or about_z:
        sideways, upwards = (pupil_distance_mm * math.sin(math.radians(each)) for each in (about_z, -about_x))
        tilted = Deviation(rx_deg=about_x, rz_deg=about_z, x_mm=sideways, z_mm=upwards)
        found["pupil"] = add_deviations(found.get("pupil", Deviation()), tilted)
    return found


def add_deviations(one: Deviation, other: Deviation) -> Deviation:
    """The deviation with the angles and shifts of both."""
    return Deviation(*(getattr(one, each.name) + getattr(other, each.name) for each in fields(Deviation)))
