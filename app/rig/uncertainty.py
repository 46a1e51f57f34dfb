"""The uncertainty of what the rig is: half widths and standard uncertainties of its inputs, `[uncertainty]` in the rig file.

Each key is an input of the measurement model (app/campaign/measurement_model), or a family of them, one for each element. The
defaults are those of an ordinary laboratory that has aligned its instrument once, and are assumed (docs/uncertainty.md). The
virtual rig can have each of them as a disturbance: the keys of `[twin.disturbances]` have the same names.
"""

from dataclasses import dataclass, field, fields
from functools import cache
from typing import Annotated, Any, Literal

from annotated_types import Ge, Le

from goniotwin.keys import Fraction

Tilt = Annotated[float, Ge(0.0), Le(5.0)]
Shift = Annotated[float, Ge(0.0), Le(10.0)]
Distribution = Literal["rectangular", "normal"]
NORMAL: dict[str, Any] = {"distribution": "normal"}
"""Metadata of a key that is a standard uncertainty. All other keys are half widths of a rectangular distribution."""


@dataclass(frozen=True)
class UncertaintyTable:
    """Uncertainties of the rig's inputs. A key in degrees or mm is the half width of a rectangular distribution.

    `sample_tilt_deg` and `sample_height_mm` are those of each mounting of a sample, `etalon_tilt_deg` and `etalon_height_mm` of
    the etalon. Tilts (`mirror_tilt_deg`, `arc_tilt_deg`, `sensor_tilt_deg`) count about each of two axes, of the arc three;
    shifts (`mirror_shift_mm`, `arc_shift_mm`, `sensor_shift_mm`) along each of three. `illumination_shift_mm` is that of the
    exit pupil, `beam_tilt_deg` that of the whole illumination unit about the sample's centre, about each of two axes.
    `sigma_zero_deg`, `beta_zero_deg` and `shift_zero_deg` are those of the axes' zeros. `photodiode_angle_deg` and
    `photodiode_across_deg` are each photodiode's own angle, along the arc and across it. `position_deg` is that of an axis
    after each of its moves, and `backlash_deg` the play of an axis whose backlash is not taken up.

    Standard uncertainties, relative where no unit is named: `field_of_view` of the variance of the directions in the field of
    view, `wavelength_nm`, `linearity_per_decade` of the photodiodes' current, `monitor_linearity_per_decade` of the monitor's,
    `monitor_drift_per_hour` of its responsivity, `crosstalk` of a channel's volts in its module's others,
    `etalon_age_per_year`, `etalon_edge` (light that a diffuser loses at the frames' edges), `monochromator_stray` (share of
    light of other wavelengths), `scan` of the open beam (of its sum, for steps of 0.2 deg), `beam_hole` (light of the open
    beam that a hole of one frame cuts off), `uniformity` of the sample's surface, `repeatability` between repeats, and
    `mounting` between mountings.
    """

    sample_tilt_deg: Tilt = 0.05
    sample_height_mm: Shift = 0.1
    etalon_tilt_deg: Tilt = 0.05
    etalon_height_mm: Shift = 0.1
    mirror_tilt_deg: Tilt = 0.05
    mirror_shift_mm: Shift = 0.1
    illumination_shift_mm: Shift = 0.1
    beam_tilt_deg: Tilt = 0.0
    arc_tilt_deg: Tilt = 0.05
    arc_shift_mm: Shift = 0.1
    sensor_tilt_deg: Tilt = 0.05
    sensor_shift_mm: Shift = 0.1
    sigma_zero_deg: Tilt = 0.05
    beta_zero_deg: Tilt = 0.05
    shift_zero_deg: Tilt = 0.05
    photodiode_angle_deg: Tilt = 0.05
    photodiode_across_deg: Tilt = 0.05
    position_deg: Tilt = 0.01
    backlash_deg: Tilt = 0.0
    field_of_view: Annotated[float, Ge(0.0), Le(2.0)] = field(default=0.12, metadata=NORMAL)
    wavelength_nm: Annotated[float, Ge(0.0), Le(50.0)] = field(default=0.35, metadata=NORMAL)
    linearity_per_decade: Fraction = field(default=1e-3, metadata=NORMAL)
    crosstalk: Fraction = field(default=1e-5, metadata=NORMAL)
    monitor_linearity_per_decade: Fraction = field(default=1e-3, metadata=NORMAL)
    monitor_drift_per_hour: Fraction = field(default=2e-4, metadata=NORMAL)
    etalon_age_per_year: Fraction = field(default=1e-3, metadata=NORMAL)
    etalon_edge: Fraction = field(default=2e-3, metadata=NORMAL)
    monochromator_stray: Fraction = field(default=1e-4, metadata=NORMAL)
    scan: Fraction = field(default=1e-3, metadata=NORMAL)
    beam_hole: Fraction = field(default=4e-3, metadata=NORMAL)
    uniformity: Fraction = field(default=0.0, metadata=NORMAL)
    repeatability: Fraction = field(default=0.0, metadata=NORMAL)
    mounting: Fraction = field(default=0.0, metadata=NORMAL)

    def standard(self, key: str) -> float:
        """The standard uncertainty of a key: of a rectangular distribution the half width over the root of 3."""
        value: float = getattr(self, key)
        return value if self.distribution(key) == "normal" else value / 3.0**0.5

    @staticmethod
    @cache
    def distribution(key: str) -> Distribution:
        """The distribution of a key's input."""
        (entry,) = [each for each in fields(UncertaintyTable) if each.name == key]
        normal: Distribution = "normal"
        return normal if entry.metadata.get("distribution") == "normal" else "rectangular"
