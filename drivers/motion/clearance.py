"""Clearance of the arc: it must not sweep through the tube of the incoming beam and the mirror unit.

The incoming beam is on the illumination axis, at azimuth 270 deg in the plane of the sample. A photodiode carrier collides
with it within 6 deg of that azimuth and above 87 deg of polar angle (derived from the instrument's geometry: mirrors 200 mm
from the sample, arc radius 300 mm).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Flags, Floats
from goniotwin.drivers.motion.settings import WHOLE_TURN_DEG


@dataclass(frozen=True)
class ArcClearance:
    """Forbidden zone: azimuths within `half_width_deg` of the beam, with a carrier above the polar angle `highest_deg`."""

    top_polar_deg: float
    beam_azimuth_deg: float = 270.0
    half_width_deg: float = 6.0
    highest_deg: float = 87.0

    def collision(self, beta_deg: Sequence[float], shift_deg: Sequence[float]) -> str | None:
        """Collision of a sweep over these beta at any of these shifts, as a message; None for a free path. Degrees."""
        if self.top_polar_deg + max(shift_deg) <= self.highest_deg:  # as on most moves
            return None
        if not self.collides(min(beta_deg), max(beta_deg), max(shift_deg)):
            return None
        top = self.top_polar_deg + max(shift_deg)
        first, last = self.beam_azimuth_deg - self.half_width_deg, self.beam_azimuth_deg + self.half_width_deg
        return (
            f"the arc would collide with the incoming beam: between beta {first:g} and {last:g} deg its highest carrier, at "
            f"{top:g} deg, must not be above {self.highest_deg:g} deg; lower the shift first, or turn in the other direction"
        )

    def collides(self, start_deg: Floats | float, stop_deg: Floats | float, shift_deg: Floats | float) -> Flags:
        """Whether sweeps over beta (not folded to 360 deg) from starts to stops collide, at the greatest shift of each.

        The arrays broadcast.
        """
        above = np.asarray(self.top_polar_deg + shift_deg > self.highest_deg)
        if not above.any():  # as on most moves
            return np.broadcast_to(above, np.broadcast_shapes(np.shape(start_deg), np.shape(stop_deg), above.shape))
        low = np.minimum(start_deg, stop_deg)
        turns = np.floor_divide(low - self.half_width_deg - self.beam_azimuth_deg, WHOLE_TURN_DEG) + 1.0
        # Start of the first forbidden interval that does not end before the sweep begins.
        first = self.beam_azimuth_deg - self.half_width_deg + turns * WHOLE_TURN_DEG
        return np.asarray(above & (first <= np.maximum(start_deg, stop_deg)))
