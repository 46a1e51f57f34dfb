"""Clearance of the arc: it must not sweep through the tube of the incoming beam and the mirror unit.

The incoming beam is on the illumination axis, at azimuth 270 deg in the plane of the sample. A photodiode carrier collides
with it within 6 deg of that azimuth and above 87 deg of polar angle (derived from the instrument's geometry: mirrors 200 mm
from the sample, arc radius 300 mm).
"""

from collections.abc import Sequence
from dataclasses import dataclass

WHOLE_TURN_DEG = 360.0


@dataclass(frozen=True)
class ArcClearance:
    """Forbidden zone: azimuths within `half_width_deg` of the beam, with a carrier above the polar angle `highest_deg`."""

    top_polar_deg: float
    beam_azimuth_deg: float = 270.0
    half_width_deg: float = 6.0
    highest_deg: float = 87.0

    def collision(self, beta_deg: Sequence[float], shift_deg: Sequence[float]) -> str | None:
        """Collision of a sweep over these beta at any of these shifts, as a message; None for a free path. Degrees."""
        top = self.top_polar_deg + max(shift_deg)
        if top <= self.highest_deg or not self._overlaps(min(beta_deg), max(beta_deg)):
            return None
        first, last = self.beam_azimuth_deg - self.half_width_deg, self.beam_azimuth_deg + self.half_width_deg
        return (
            f"the arc would collide with the incoming beam: between beta {first:g} and {last:g} deg its highest carrier, at "
            f"{top:g} deg, must not be above {self.highest_deg:g} deg; lower the shift first, or turn in the other direction"
        )

    def _overlaps(self, low: float, high: float) -> bool:
        """True if an interval of azimuths (not folded to 360 deg) touches the forbidden zone."""
        turn = (low - self.half_width_deg - self.beam_azimuth_deg) // WHOLE_TURN_DEG
        # Start of the first forbidden interval that does not end before `low`.
        start = self.beam_azimuth_deg - self.half_width_deg + (turn + 1) * WHOLE_TURN_DEG
        return start <= high
