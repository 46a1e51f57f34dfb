"""Points of known values in the front's half sphere, for the steps that follow the BSDF."""

import numpy as np

from goniotwin.app.campaign.reduction.components import COVERAGE
from goniotwin.app.campaign.reduction.points import BsdfPoints, pack_flags
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics import arc_direction, to_specular


def made_points(
    sigma: float, zenith: Floats, azimuth: Floats, bsdf: Floats, u: float, flags: dict[str, Flags] | None = None
) -> BsdfPoints:
    """Points (n,) of reflected light at 550 nm, measured with the arc at their azimuth, each by another photodiode."""
    theta, phi = to_specular(sigma, arc_direction(zenith, azimuth))
    none, zeros = np.zeros(zenith.size, dtype=bool), np.zeros(zenith.size)
    return BsdfPoints(
        places=np.stack([zeros + 550.0, zeros, zeros + sigma, azimuth, zeros], axis=1),
        place=np.arange(zenith.size, dtype=np.int32),
        photodiode=np.arange(zenith.size),
        zenith_deg=zenith,
        azimuth_deg=azimuth,
        theta_deg=theta,
        phi_deg=phi,
        back=none,
        transmitted=none,
        mirrored=none,
        bsdf=bsdf,
        own={"noise": zeros + u**2},
        common={},
        grouped={},
        stated={},
        marks=pack_flags(flags or {}, zenith.size),
        signature=zeros + np.nan,
        slope_along=zeros + np.nan,
        slope_across=zeros + np.nan,
        field_correction=zeros,
        coverage=np.full((zenith.size, 2), COVERAGE),
        row=np.arange(zenith.size),
        etalon_row=np.arange(zenith.size),
        second_row=np.full(zenith.size, -1),
        gain=np.zeros(zenith.size, dtype=np.int64),
        etalon_gain=np.zeros(zenith.size, dtype=np.int64),
        wavelength_slope=zeros + np.nan,
        band_correction=zeros + np.nan,
        stray_contrast=zeros + np.nan,
    )
