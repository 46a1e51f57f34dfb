"""The poses of a schedule on a rig: grids, what is finer near the specular direction, less what the symmetry repeats."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.planning.crosschecks import mirror_images, overlap_poses
from goniotwin.app.campaign.planning.near import near_poses
from goniotwin.app.campaign.planning.sides import Side, etalon_sigmas_deg, lit_sides, rig_sigma_deg
from goniotwin.app.campaign.planning.symmetry import one_of_each
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats

MOST_FURTHER = 4_000_000


@dataclass(frozen=True)
class Poses:
    """Poses (n, 4) in rig angles: gamma, sigma, beta, shift; which of them are only there to check the symmetry, and how
    many more the grids have that are mirror images of these.
    """

    angles: Floats
    mirrored: Flags
    left_out: int


def sample_poses(file: ScheduleFile, rig: RigFile) -> Poses:
    """Of each sample. Raises ValueError, naming the key, for what the rig cannot do."""
    sides = [_of_side(file, rig, side) for side in lit_sides(file)]
    angles = np.concatenate([angles for angles, _ in sides])
    checks = mirror_images(file, rig, angles)
    mirrored = np.arange(len(angles) + len(checks)) >= len(angles)
    return Poses(np.concatenate([angles, checks]), mirrored, sum(left_out for _, left_out in sides))


def etalon_poses(file: ScheduleFile, of_samples: Poses) -> Poses:
    """Of the etalon: each photodiode at each of the samples' poses, lit on the side that it looks at."""
    if file.light == "reflected":
        return of_samples
    blocks, mirrored = [], []
    for there in np.unique(of_samples.angles[:, 1]).tolist():
        chosen = of_samples.angles[:, 1] == there
        for sigma in etalon_sigmas_deg(file, there):
            block = of_samples.angles[chosen].copy()
            block[:, 1] = sigma
            blocks.append(block)
            mirrored.append(of_samples.mirrored[chosen])
    angles, flags = np.concatenate(blocks), np.concatenate(mirrored)
    kept = one_of_each(angles, "anisotropic")
    return Poses(angles[kept], flags[kept], 0)


def _of_side(file: ScheduleFile, rig: RigFile, side: Side) -> tuple[Floats, int]:
    """Poses of one lit side, and how many of its grids are left out."""
    gammas, betas = np.array(grid_values(file.gamma_deg)), np.array(grid_values(file.beta_deg))
    sigmas, shifts = np.array(grid_values(file.sigma_deg)), np.array(grid_values(file.shift_deg))
    planned = len(gammas) * len(betas) * len(sigmas) * len(shifts)
    if file.symmetry == "isotropic":
        gammas = gammas[:1]
    turns = np.zeros((len(gammas) * len(betas), 4))
    turns[:, 0], turns[:, 2] = np.repeat(gammas, len(betas)), np.tile(betas, len(gammas))
    turns = turns[one_of_each(turns, file.symmetry)]
    tilts = np.array([(sigma, shift) for sigma in sigmas for shift in shifts])
    poses = np.repeat(turns, len(tilts), axis=0)
    poses[:, [1, 3]] = np.tile(tilts, (len(turns), 1))
    further = np.concatenate([near_poses(file, rig, side), overlap_poses(file, rig)])
    if len(gammas) * len(further) > MOST_FURTHER:
        raise ValueError(
            f"near_specular: {len(gammas)} gamma_deg x {len(further)} = {len(gammas) * len(further)} poses; take greater steps"
        )
    if len(further):
        beside = np.zeros((len(gammas) * len(further), 4))
        beside[:, 0], beside[:, 1:] = np.repeat(gammas, len(further)), np.tile(further, (len(gammas), 1))
        poses = np.concatenate([poses, beside])
        poses = poses[one_of_each(poses, file.symmetry)]
    left_out = planned - len(turns) * len(tilts)
    for sigma in sigmas.tolist():
        poses[poses[:, 1] == sigma, 1] = rig_sigma_deg(sigma, side)
    return poses, left_out
