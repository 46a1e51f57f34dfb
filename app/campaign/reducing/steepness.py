"""How steep a measured BSDF is along the arc: what an error of an angle makes of its value.

Two values of one direction, or of a direction and its mirror image, differ by more than noise where the lobe is steep and the
angles are not quite what they are said to be. Checks and calibrations that did not know this would find fault with every
narrow lobe.
"""

import numpy as np

from goniotwin.app.campaign.reducing.points import BsdfPoints
from goniotwin.arrays import Floats

DECIMALS = 3
"""Directions that are nearer than a thousandth of a degree are one."""
HALF_TURN_DEG = 180.0


def steepness(points: BsdfPoints) -> Floats:
    """Relative change per degree along the arc, the greater of those to the neighbour on either side; 0 where none is known.

    Neighbours are the nearest directions of the same half planes that have a value above zero, whichever photodiode and shift
    they were seen with.
    """
    found = np.zeros(points.bsdf.size)
    usable = np.isfinite(points.bsdf) & (points.bsdf > 0.0) & ~points.shadowed
    if not usable.any():
        return found
    here = points.where(usable)
    plane = np.mod(here.beta_deg, HALF_TURN_DEG)
    polar = np.minimum(here.zenith_deg, HALF_TURN_DEG - here.zenith_deg)
    signed = np.where(np.abs(np.mod(here.azimuth_deg, 2.0 * HALF_TURN_DEG) - plane) < 1e-6, polar, -polar)
    keys = [here.wavelength_nm, here.sigma_deg, here.gamma_deg, plane, here.transmitted, signed]
    places, which = np.unique(np.round(np.stack(keys, axis=1), DECIMALS), axis=0, return_inverse=True)
    which = which.ravel()
    logs = np.bincount(which, weights=np.log(here.bsdf)) / np.bincount(which)
    same = np.all(places[1:, :-1] == places[:-1, :-1], axis=1)
    slope = np.abs(np.diff(logs)) / np.where(same, np.diff(places[:, -1]), np.inf)
    found[usable] = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))[which]
    return found
