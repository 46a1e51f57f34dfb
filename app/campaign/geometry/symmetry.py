"""Symmetry of a sample: poses that measure the same, its mirror images.

In the sample's frame the light comes from the azimuth -gamma, and the azimuth of observation is beta - gamma. A plane-symmetric
sample has a plane of symmetry through its normal, at its azimuth 0: (gamma, beta) measures what (-gamma, -beta) measures. For
an isotropic sample all gammas are alike, and beta measures what -beta measures.
"""

import numpy as np

from goniotwin.app.campaign.geometry.directions import round_azimuth
from goniotwin.app.campaign.schedule.refinement import StatedSymmetry
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import fold_azimuth, round_deg


def unique_pose_mask(poses: Floats, symmetry: StatedSymmetry) -> Flags:
    """Which of poses (n, 4) to measure: the first of each set of mirror images, and of equal poses."""
    columns = [np.unique(column, return_inverse=True)[1] for column in canonical_poses(poses, symmetry).T]
    key = np.zeros(len(poses), dtype=np.int64)
    for ranks in columns:
        key = key * (int(ranks.max(initial=0)) + 1) + ranks
    _, first = np.unique(key, return_index=True)
    mask = np.zeros(len(poses), dtype=bool)
    mask[first] = True
    return mask


def mirror_images(poses: Floats, symmetry: StatedSymmetry, turn_deg: float) -> Floats:
    """The mirror images of poses (n, 4), angles from 0 to 360 deg; for an isotropic sample gamma also turns by `turn_deg`."""
    mirrored = poses.copy()
    mirrored[:, 0] = round_azimuth(poses[:, 0] + turn_deg if symmetry == "isotropic" else -poses[:, 0])
    mirrored[:, 2] = round_azimuth(-poses[:, 2])
    return mirrored


def canonical_poses(poses: Floats, symmetry: StatedSymmetry) -> Floats:
    """For each of poses (n, 4) the same pose for all that are mirror images of each other."""
    canonical = poses.copy()
    gamma, beta = round_azimuth(poses[:, 0]), round_azimuth(poses[:, 2])
    if symmetry == "isotropic":
        canonical[:, 0], canonical[:, 2] = 0.0, fold_azimuth(beta)
    elif symmetry == "plane-symmetric":
        other_gamma, other_beta = round_azimuth(-gamma), round_azimuth(-beta)
        swap = (other_gamma < gamma) | ((other_gamma == gamma) & (other_beta < beta))
        canonical[:, 0], canonical[:, 2] = np.where(swap, other_gamma, gamma), np.where(swap, other_beta, beta)
    return round_deg(canonical)
