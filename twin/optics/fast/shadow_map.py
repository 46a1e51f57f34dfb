"""The directions that the mirror unit hides, as a map over the arc's angles: known before a campaign begins."""

from dataclasses import dataclass

import numpy as np

from goniotwin.arrays import Floats
from goniotwin.twin.optics.fast.obstruction import visible_fraction
from goniotwin.twin.optics.geometry.coordinates import arc_direction
from goniotwin.twin.optics.geometry.instrument import Instrument


@dataclass(frozen=True, eq=False)
class ShadowMap:
    """Share `visible` (polar, azimuth) of a detector's rays that no mirror cuts, over angles in deg.

    `obstruction` is the instrument's: without it the shadow is there and is not felt.
    """

    sigma_deg: float
    polar_deg: Floats
    azimuth_deg: Floats
    visible: Floats
    lower: bool
    obstruction: bool


def shadow_map(
    instrument: Instrument, sigma_deg: float, step_deg: float = 1.0, *, lower: bool = False, gamma_deg: float = 0.0
) -> ShadowMap:
    """Polar angles 0 to 90 deg and azimuths 0 to 360 in steps of `step_deg`, of the upper or the lower arc.

    Raises ValueError for a step that does not divide 90 deg or is below 0.1 deg, the smallest of every axis.
    """
    count = round(90.0 / step_deg) if step_deg >= 0.1 else 0
    if count == 0 or abs(count * step_deg - 90.0) > 1e-9:
        raise ValueError(f"step_deg is {step_deg!r}: give one that divides 90 deg, at least 0.1")
    polar, azimuth = np.linspace(0.0, 90.0, count + 1), np.linspace(0.0, 360.0, 4 * count + 1)
    directions = arc_direction(polar[:, None], azimuth[None, :], lower)
    visible = visible_fraction(instrument, sigma_deg, directions.reshape(-1, 3), gamma_deg=gamma_deg)
    return ShadowMap(sigma_deg, polar, azimuth, visible.reshape(directions.shape[:2]), lower, instrument.obstruction)
