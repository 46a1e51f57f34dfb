"""Which poses see the same by a sample's stated symmetry: their mirror images.

In the sample's frame light comes from the azimuth -gamma and is observed at the azimuth beta - gamma. A plane-symmetric
sample has a plane of symmetry through its normal, at its azimuth 0: (gamma, beta) sees what (-gamma, -beta) sees. To an
isotropic one all gammas are alike, and beta is what -beta is.
"""

import numpy as np

from goniotwin.app.campaign.schedule.grids import DECIMALS
from goniotwin.app.campaign.schedule.refinement import Symmetry
from goniotwin.arrays import Flags, Floats

TURN_DEG = 360.0


def unique_pose_mask(poses: Floats, symmetry: Symmetry) -> Flags:
    """Which of poses (n, 4) to measure: the first of each set of mirror images, and of what stands there twice."""
    columns = [np.unique(column, return_inverse=True)[1] for column in canonical_poses(poses, symmetry).T]
    key = np.zeros(len(poses), dtype=np.int64)
    for ranks in columns:
        key = key * (int(ranks.max(initial=0)) + 1) + ranks
    _, first = np.unique(key, return_index=True)
    kept = np.zeros(len(poses), dtype=bool)
    kept[first] = True
    return kept


def mirror_images(poses: Floats, symmetry: Symmetry, turn_deg: float) -> Floats:
    """Where else a sample of that symmetry looks the same, angles from 0 to 360 deg; an isotropic one is turned as well."""
    mirrored = poses.copy()
    mirrored[:, 0] = wrap_azimuth(poses[:, 0] + turn_deg if symmetry == "isotropic" else -poses[:, 0])
    mirrored[:, 2] = wrap_azimuth(-poses[:, 2])
    return mirrored


def wrap_azimuth(angles_deg: Floats) -> Floats:
    """The same directions from 0 to below 360 deg."""
    found = np.round(np.mod(angles_deg, TURN_DEG), DECIMALS)
    return np.asarray(np.where(found == TURN_DEG, 0.0, found))


def canonical_poses(poses: Floats, symmetry: Symmetry) -> Floats:
    """The same pose (n, 4) for all that are mirror images of each other."""
    found = poses.copy()
    gamma, beta = wrap_azimuth(poses[:, 0]), wrap_azimuth(poses[:, 2])
    if symmetry == "isotropic":
        found[:, 0], found[:, 2] = 0.0, np.minimum(beta, TURN_DEG - beta)
    elif symmetry == "plane-symmetric":
        other_gamma, other_beta = wrap_azimuth(-gamma), wrap_azimuth(-beta)
        swap = (other_gamma < gamma) | ((other_gamma == gamma) & (other_beta < beta))
        found[:, 0], found[:, 2] = np.where(swap, other_gamma, gamma), np.where(swap, other_beta, beta)
    return np.asarray(np.round(found, DECIMALS))
