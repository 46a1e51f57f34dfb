"""The sensor unit as built: ideal lens, frame, diaphragm, detector (paper, figure 5a).

The lens in its frame takes the place of the simplified detector's disc; rays that meet the frame are stopped. Behind the lens,
at `diaphragm_mm`, is the diaphragm, and behind that, at `detector_mm`, the detector. An ideal lens turns a ray that crosses it
at x with the slope p into one of slope p - x / f. With the diaphragm in the focal plane the ray arrives there at f p, wherever
it crossed the lens: the unit is then exactly the simplified detector, a disc with an acceptance cone. With the diaphragm
elsewhere, or a detector too small for the cone, it is not; the forward estimator, which traces it, is then the only one.
"""

import math
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.keys import Positive, check_bounds


@dataclass(frozen=True)
class RealSensor:
    """A real detector: lens, diaphragm and detector. All dimensions are assumed except the lens' diameter, which is that of the
    paper's virtual detectors.

    `lens_diameter_mm`: diameter of the lens. `focal_length_mm`: focal length of the lens. `aperture_mm`: diameter of the
    variable diaphragm. `diaphragm_mm`: distance of the diaphragm behind the lens. `detector_mm`: distance of the detector
    behind the lens. `detector_side_mm`: side of the square detector; its sides lie along the arc and across it.

    Raises ValueError, naming the field, for dimensions that cannot be built.
    """

    lens_diameter_mm: Positive = 5.0
    focal_length_mm: Positive = 20.0
    aperture_mm: Positive = 2.0 * 20.0 * math.tan(math.radians(0.25))
    diaphragm_mm: Positive = 20.0
    detector_mm: Positive = 21.0
    detector_side_mm: Positive = 3.6

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.detector_mm < self.diaphragm_mm:
            raise ValueError(f"detector_mm is {self.detector_mm:g}, before the diaphragm at {self.diaphragm_mm:g} mm")

    @property
    def field_deg(self) -> float:
        """Full angle of view: the diaphragm's limit for parallel light at an angle."""
        return 2.0 * math.degrees(math.atan(0.5 * self.aperture_mm / self.focal_length_mm))

    @property
    def departure(self) -> str | None:
        """Difference from a disc with an acceptance cone, in words; None where there is none."""
        if not math.isclose(self.diaphragm_mm, self.focal_length_mm, rel_tol=1e-12):
            return f"its diaphragm is at {self.diaphragm_mm:g} mm and its focal plane at {self.focal_length_mm:g} mm"
        behind = self.detector_mm - self.diaphragm_mm
        width = self.aperture_mm + behind * (self.lens_diameter_mm + self.aperture_mm) / self.focal_length_mm
        if width > self.detector_side_mm:
            return f"its detector of {self.detector_side_mm:g} mm cuts the light, which is {width:.4g} mm wide there"
        return None

    @property
    def simple(self) -> bool:
        """Whether it is equivalent to a disc with an acceptance cone: diaphragm in the focal plane, detector large enough."""
        return self.departure is None

    @property
    def widest_deg(self) -> float:
        """Full angle of a cone about the axis that contains every ray that can pass, wherever it crosses the lens.

        At the distance d behind the lens a ray is at x (1 - d/f) + p d, at most a from the axis. With x at most R the slope p
        is at most (a + R |1 - d/f|) / d. This holds for the diaphragm and for the detector's corners; the smaller limit counts.
        """
        slope = math.inf
        for behind, reach in (
            (self.diaphragm_mm, 0.5 * self.aperture_mm),
            (self.detector_mm, math.sqrt(0.5) * self.detector_side_mm),
        ):
            aside = 0.5 * self.lens_diameter_mm * abs(1.0 - behind / self.focal_length_mm)
            slope = min(slope, (reach + aside) / behind)
        return 2.0 * math.degrees(math.atan(slope))

    @property
    def constants(self) -> Floats:
        """Argument of `passes_sensor`: squared radii of lens and aperture, 1/f, diaphragm, detector, half its side."""
        return np.array(
            [
                0.25 * self.lens_diameter_mm**2,
                0.25 * self.aperture_mm**2,
                1.0 / self.focal_length_mm,
                self.diaphragm_mm,
                self.detector_mm,
                0.5 * self.detector_side_mm,
            ]
        )
