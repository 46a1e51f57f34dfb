"""The instrument's dimensions: from the exit pupil over the mirror unit and the sample's frame to a detector."""

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class Instrument:
    """Dimensions in mm, angles in degrees (paper, sections 3.1 and 3.2).

    Given by the paper: the distances of 200 mm, the mirrors' reflectance, the spot of 5 x 5 mm, detectors of 5 mm
    diameter with an acceptance of 0.5 to 2.5 deg. The rest is assumed: a pupil of 5 mm radius at 800 mm makes a beam of
    0.7 deg (the paper has 0.5 to 1 deg), and an arc of 300 mm clears mirror 2, whose centre is at 283 mm.

    `field_deg` is the full width of a detector's acceptance cone. `obstruction` says whether the mirrors hide
    directions from the detectors. Raises ValueError, naming the field, for a value that no instrument can have.
    """

    pupil_radius_mm: float = 5.0
    pupil_to_mirror_mm: float = 200.0
    mirror_distance_mm: float = 200.0
    mirror_side_mm: float = 20.0
    mirror_reflectance: float = 0.95
    spot_side_mm: float = 5.0
    arc_radius_mm: float = 300.0
    detector_diameter_mm: float = 5.0
    field_deg: float = 0.5
    obstruction: bool = True

    def __post_init__(self) -> None:
        for entry in fields(self):
            if entry.name == "obstruction":
                continue
            value = getattr(self, entry.name)
            if not (math.isfinite(value) and value > 0.0):
                raise ValueError(f"{entry.name} is {value!r}: give a positive, finite number")
        if self.mirror_reflectance > 1.0:
            raise ValueError(f"mirror_reflectance is {self.mirror_reflectance!r}: give a share of at most 1")
        if self.field_deg >= 180.0:
            raise ValueError(f"field_deg is {self.field_deg!r}: give the cone's full width, less than 180 deg")

    @property
    def pupil_distance_mm(self) -> float:
        """Length of the beam's axis from the exit pupil over the three mirrors to the sample."""
        return self.pupil_to_mirror_mm + 3.0 * self.mirror_distance_mm

    @property
    def divergence_deg(self) -> float:
        """Full angle of the beam at the sample's centre."""
        return 2.0 * math.degrees(math.atan(self.pupil_radius_mm / self.pupil_distance_mm))
