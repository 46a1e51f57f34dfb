"""Which directions the mirror unit hides from a photodiode, by the geometry that the rig file states."""

import math
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from app.rig import RigFile, believed_instrument
from twin.optics import Instrument, arc_direction, visible_fraction

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]
WHOLE = 1.0 - 1e-9


def shadowed(rig: RigFile, sigma_deg: float, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    """Whether any part of what a photodiode should see is hidden, or would be a `shadow_margin_deg` further on.

    Angles of the directions of observation in degrees, upper side; shape as theirs.
    """
    instrument = believed_instrument(rig)
    margin = rig.geometry.shadow_margin_deg
    return np.array(
        [
            _hidden(instrument, margin, sigma_deg, round(float(zenith), 6), round(float(azimuth), 6))
            for zenith, azimuth in zip(zenith_deg, azimuth_deg, strict=True)
        ],
        dtype=bool,
    )


@lru_cache(maxsize=200_000)
def _hidden(instrument: Instrument, margin_deg: float, sigma_deg: float, zenith_deg: float, azimuth_deg: float) -> bool:
    directions = _around(zenith_deg, azimuth_deg, margin_deg)
    return bool(np.any(visible_fraction(instrument, sigma_deg, directions) < WHOLE))


def _around(zenith_deg: float, azimuth_deg: float, margin_deg: float) -> Floats:
    """The direction and four at `margin_deg` from it."""
    centre = arc_direction(np.array([zenith_deg]), np.array([azimuth_deg]))[0]
    along = arc_direction(np.array([zenith_deg + 90.0]), np.array([azimuth_deg]))[0]
    across = np.cross(centre, along)
    c, s = math.cos(math.radians(margin_deg)), math.sin(math.radians(margin_deg))
    return np.array([centre, *(c * centre + s * side for side in (along, -along, across, -across))])
