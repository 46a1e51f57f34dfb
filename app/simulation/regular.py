"""The regular component of a sample: where it goes, and what detectors make of it.

It has no BSDF that is finite, so no table can have it as it is: its luminance factor is that of the pupil's image, and
depends on beam, aperture and field. What a file has of it is what its own detectors see.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, Scatterer, arc_direction
from goniotwin.twin.optics.bsdf import REGULAR


@dataclass(frozen=True)
class RegularPeak:
    """At one sigma: the share of the light that goes on regularly, in a direction of the rig's frame, and within which angle
    of it detectors see any; the largest luminance factor that one sees, None where the mirrors hide all of them.
    """

    sigma_deg: float
    share: float
    polar_deg: float
    azimuth_deg: float
    within_deg: float
    largest_factor: float | None

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {
            "sigma": self.sigma_deg,
            "share": self.share,
            "theta": 0.0,
            "polar_deg": self.polar_deg,
            "azimuth_deg": self.azimuth_deg,
            "seen_within_deg": self.within_deg,
            "largest_luminance_factor": self.largest_factor,
            "hidden": self.largest_factor is None,
        }


def regular_share(sample: Scatterer, sigma_deg: float, back: bool, transmitted: bool) -> float:
    """Of the light at incidence `sigma_deg`, what goes on regularly to the side that is looked at; 0 without such a lobe."""
    lobes = [lobe for lobe in sample.lobes if lobe.kind == REGULAR and lobe.transmits == transmitted]
    return sum(lobe.albedo(sigma_deg) for lobe in lobes if lobe.incident == (-1 if back else 1))


def seen_within_deg(instrument: Instrument) -> float:
    """The angle from its direction beyond which no detector sees the regular component, without deviations."""
    beam = instrument.pupil_radius_mm + math.sqrt(0.5) * instrument.spot_side_mm
    return math.degrees(math.atan(beam / instrument.pupil_distance_mm)) + 0.5 * instrument.field_deg


def regular_peak(
    instrument: Instrument, sigma_deg: float, share: float, lower: bool, directions: Floats, factor: Floats
) -> RegularPeak:
    """Of a share above 0, for detectors in `directions` (n, 3) with luminance factors (w, n), NaN where hidden."""
    axis = arc_direction(sigma_deg, 180.0, lower)
    within = seen_within_deg(instrument)
    seen = factor[:, directions @ axis >= math.cos(math.radians(within))]
    largest = float(np.nanmax(seen)) if np.isfinite(seen).any() else None
    return RegularPeak(sigma_deg, share, sigma_deg, 180.0, within, largest)
