"""The frames that hold the sample: two sheets with square holes, which say how much of it is lit, and scatter a little."""

import math
from dataclasses import dataclass, fields

LEAST_GAP_MM = 1e-3


@dataclass(frozen=True)
class SampleFrames:
    """A frame above and one below the sample's sheet (paper, section 3.1, which gives no numbers: these are assumed).

    Each is a square sheet of `side_mm`, without thickness, `gap_mm` from the sample, whose hole is the instrument's
    `spot_side_mm`. With no gap the hole is the illuminated spot at every incidence, as the fast estimator has it; a gap makes
    the spot wander with sigma, and light is caught between sample and frame. They scatter `reflectance` of the light by
    Lambert's law from either side and absorb the rest (black anodised metal). The uniform exit pupil lights a square `lit`
    times as wide as the hole; a rayset lights what it lights. Raises ValueError, naming the field, for what no frame can have.
    """

    gap_mm: float = 0.0
    side_mm: float = 60.0
    reflectance: float = 0.05
    lit: float = 1.1

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not math.isfinite(value):
                raise ValueError(f"{entry.name} is {value!r}: give a finite number")
        if self.gap_mm != 0.0 and self.gap_mm < LEAST_GAP_MM:
            raise ValueError(f"gap_mm is {self.gap_mm!r}: give 0, or at least {LEAST_GAP_MM:g} mm")
        if self.side_mm <= 0.0:
            raise ValueError(f"side_mm is {self.side_mm!r}: give a positive number")
        if not 0.0 <= self.reflectance <= 1.0:
            raise ValueError(f"reflectance is {self.reflectance!r}: give a share from 0 to 1")
        if self.lit < 1.0:
            raise ValueError(f"lit is {self.lit!r}: the beam lights the whole hole, so give at least 1")
