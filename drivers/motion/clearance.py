"""What one axis forbids another: the arc must not sweep through the incoming beam's tube and the mirror unit.

The beam comes along the illumination axis, at azimuth 270 deg in the plane of the sample. A photodiode carrier near the
horizon meets it there: with a carrier tube within 6 deg of that azimuth and above 87 deg of polar angle (derived from
the instrument's geometry: mirrors 200 mm from the sample, arc radius 300 mm).
"""

from collections.abc import Sequence
from dataclasses import dataclass

WHOLE_TURN_DEG = 360.0


@dataclass(frozen=True)
class ArcClearance:
    """Where the arc may not be: azimuths within `half_width_deg` of the beam's, with a carrier above `highest_deg`."""

    top_polar_deg: float
    beam_azimuth_deg: float = 270.0
    half_width_deg: float = 6.0
    highest_deg: float = 87.0

    def veto(self, beta_deg: Sequence[float], shift_deg: Sequence[float]) -> str | None:
        """Why the arc may not sweep over these beta while its shift takes any of those; None if it may. Degrees."""
        top = self.top_polar_deg + max(shift_deg)
        if top <= self.highest_deg or not self._meets(min(beta_deg), max(beta_deg)):
            return None
        first, last = self.beam_azimuth_deg - self.half_width_deg, self.beam_azimuth_deg + self.half_width_deg
        return (
            f"the arc would meet the incoming beam: between beta {first:g} and {last:g} deg its highest carrier, at "
            f"{top:g} deg, must not be above {self.highest_deg:g} deg; lower the shift first, or go round the other way"
        )

    def _meets(self, low: float, high: float) -> bool:
        """Whether an interval of azimuths, turns counted, touches the forbidden one."""
        turn = (low - self.half_width_deg - self.beam_azimuth_deg) // WHOLE_TURN_DEG
        # The first forbidden interval that does not end before `low`.
        begin = self.beam_azimuth_deg - self.half_width_deg + (turn + 1) * WHOLE_TURN_DEG
        return begin <= high
