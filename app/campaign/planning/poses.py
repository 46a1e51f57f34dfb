"""Poses of a schedule on a rig: those of the grids without mirror images of others, and poses beside the grids.

Beside the grids there are finer poses near the specular direction or the direction straight through, poses at which photodiodes
overlap, mirror images that check the symmetry, and poses of the open beam.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np

from goniotwin.app.campaign.geometry.arcs import etalon_sigmas_deg, far_arc, lit_sides, observing_arcs, polar_deg
from goniotwin.app.campaign.geometry.collision import reachable_poses
from goniotwin.app.campaign.geometry.directions import LitSide, PoseAngles, rig_sigma_deg
from goniotwin.app.campaign.geometry.symmetry import mirror_images, unique_pose_mask
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import WHOLE, evenly_spaced, grid_values
from goniotwin.app.rig import RigFile, arc_clearance
from goniotwin.arrays import Flags, Floats
from goniotwin.drivers.motion import within_limits
from goniotwin.twin.optics.geometry.coordinates import SPECULAR_AZIMUTH_DEG, TOLERANCE_DEG, round_deg

CHECK_TURNS_DEG = (90.0, -90.0, 0.0)
"""Turns of gamma for the symmetry check of an isotropic sample, besides the mirroring: the first possible one is taken."""
MAX_NEAR_CANDIDATES = 10_000_000
"""Limit of the poses that are tested for nearness to the specular direction."""
MAX_FURTHER_POSES = 4_000_000
"""Limit of the poses of near_specular and overlap, before equal ones are removed."""


@dataclass(frozen=True)
class Poses:
    """Poses `angles` (n, 4) in angles of the rig: gamma, sigma, beta, shift.

    `mirrored` (n,): poses that only check the symmetry. `left_out`: number of poses of the grids that are mirror images of
    these and are not measured.
    """

    angles: Floats
    mirrored: Flags
    left_out: int


def sample_poses(file: ScheduleFile, rig: RigFile) -> Poses:
    """The poses of each sample. Raises ValueError, with the key, for what the rig cannot do."""
    sides = [_side_poses(file, rig, side) for side in lit_sides(file)]
    angles = np.concatenate([angles for angles, _ in sides])
    checks = symmetry_check_poses(file, rig, angles)
    mirrored = np.arange(len(angles) + len(checks)) >= len(angles)
    return Poses(np.concatenate([angles, checks]), mirrored, sum(left_out for _, left_out in sides))


def etalon_poses(file: ScheduleFile, of_samples: Poses, further: Sequence[PoseAngles] = ()) -> Poses:
    """The poses of the etalon: each photodiode as at the samples, with the light on the side that the photodiode sees.

    `further` are those that the scan of the open beam is compared with; some of them are poses of the samples.
    """
    poses = _poses_as_at_samples(file, of_samples)
    known = {tuple(each) for each in round_deg(poses.angles).tolist()}
    added = [each for each in further if tuple(round_deg(each).tolist()) not in known]
    if not added:
        return poses
    angles = np.concatenate([poses.angles, np.array(added)])
    return Poses(angles, np.concatenate([poses.mirrored, np.zeros(len(added), dtype=bool)]), 0)


def _poses_as_at_samples(file: ScheduleFile, of_samples: Poses) -> Poses:
    if file.light == "reflected":
        return of_samples
    blocks, mirrored = [], []
    for sample_sigma in np.unique(of_samples.angles[:, 1]).tolist():
        chosen = of_samples.angles[:, 1] == sample_sigma
        for sigma in etalon_sigmas_deg(file, sample_sigma):
            block = of_samples.angles[chosen].copy()
            block[:, 1] = sigma
            blocks.append(block)
            mirrored.append(of_samples.mirrored[chosen])
    angles, flags = np.concatenate(blocks), np.concatenate(mirrored)
    mask = unique_pose_mask(angles, "anisotropic")
    return Poses(angles[mask], flags[mask], 0)


def open_beam_poses(file: ScheduleFile, rig: RigFile) -> Floats:
    """Poses (n, 4) at which a photodiode of the far arc looks straight into the beam. Raises ValueError if there is none."""
    poses = []
    for side in lit_sides(file):
        for sigma in grid_values(file.sigma_deg):
            rig_sigma = rig_sigma_deg(sigma, side)
            shifts = round_deg(np.subtract(sigma, polar_deg(rig, far_arc(rig_sigma)))).tolist()
            possible = sorted((abs(shift), shift) for shift in shifts if within_limits(rig.axes.shift, shift))
            if not possible:
                raise ValueError(
                    f"open_beam: at sigma {sigma:g} deg no photodiode of the {far_arc(rig_sigma)} arc reaches the beam; "
                    "remove that sigma, or set open_beam = false"
                )
            poses.append((grid_values(file.gamma_deg)[0], rig_sigma, SPECULAR_AZIMUTH_DEG, possible[0][1]))
    return np.array(poses)


def _side_poses(file: ScheduleFile, rig: RigFile, side: LitSide) -> tuple[Floats, int]:
    """Poses of one lit side, and the number of poses of the grids that are omitted."""
    gammas, betas = np.array(grid_values(file.gamma_deg)), np.array(grid_values(file.beta_deg))
    sigmas, shifts = np.array(grid_values(file.sigma_deg)), np.array(grid_values(file.shift_deg))
    planned = len(gammas) * len(betas) * len(sigmas) * len(shifts)
    if file.symmetry == "isotropic":
        gammas = gammas[:1]
    turns = np.zeros((len(gammas) * len(betas), 4))
    turns[:, 0], turns[:, 2] = np.repeat(gammas, len(betas)), np.tile(betas, len(gammas))
    turns = turns[unique_pose_mask(turns, file.symmetry)]
    tilts = np.array([(sigma, shift) for sigma in sigmas for shift in shifts])
    poses = np.repeat(turns, len(tilts), axis=0)
    poses[:, [1, 3]] = np.tile(tilts, (len(turns), 1))
    further = np.concatenate([near_specular_poses(file, rig, side), overlap_poses(file, rig)])
    if len(gammas) * len(further) > MAX_FURTHER_POSES:
        raise ValueError(
            f"near_specular: {len(gammas)} gamma_deg x {len(further)} = {len(gammas) * len(further)} poses; take greater steps"
        )
    if len(further):
        beside = np.zeros((len(gammas) * len(further), 4))
        beside[:, 0], beside[:, 1:] = np.repeat(gammas, len(further)), np.tile(further, (len(gammas), 1))
        poses = np.concatenate([poses, beside])
        poses = poses[unique_pose_mask(poses, file.symmetry)]
    left_out = planned - len(turns) * len(tilts)
    for sigma in sigmas.tolist():
        poses[poses[:, 1] == sigma, 1] = rig_sigma_deg(sigma, side)
    return poses, left_out


def near_specular_poses(file: ScheduleFile, rig: RigFile, side: LitSide) -> Floats:
    """Incidence, beta, shift (n, 3) of `[near_specular]`; some of them are poses of the grids.

    Raises ValueError if there are too many candidates.
    """
    table = file.near_specular
    if table is None:
        return np.zeros((0, 3))
    betas, shifts = np.array(grid_values(file.beta_deg)), np.array(grid_values(file.shift_deg))
    if table.beta_step_deg is not None:
        steps = (betas.max() - betas.min()) / table.beta_step_deg
        _refuse_too_many(len(grid_values(file.sigma_deg)), steps, len(shifts))
        betas = np.union1d(betas, evenly_spaced(float(betas.min()), table.beta_step_deg, int(steps + WHOLE)))
    if table.shift_deg is not None:
        shifts = np.union1d(shifts, grid_values(table.shift_deg))
    _refuse_too_many(len(grid_values(file.sigma_deg)), len(betas), len(shifts))
    blocks = []
    for sigma in grid_values(file.sigma_deg):
        arcs = observing_arcs(file, rig_sigma_deg(sigma, side))
        polar = sorted(set(chain.from_iterable(polar_deg(rig, arc) for arc in arcs)))
        k, j = np.nonzero(_closest_deg(sigma, betas, shifts, polar, table.within_deg) <= table.within_deg + TOLERANCE_DEG)
        blocks.append(np.stack([np.full(len(k), sigma), betas[k], shifts[j]], axis=1))
    return np.concatenate(blocks)


def _closest_deg(sigma_deg: float, beta_deg: Floats, shift_deg: Floats, polar_deg: list[float], within_deg: float) -> Floats:
    """Angle from the specular direction to the nearest photodiode (betas, shifts); infinite where far above `within_deg`."""
    closest = np.full((len(beta_deg), len(shift_deg)), np.inf)
    sigma = np.radians(sigma_deg)
    for polar in polar_deg:
        # Two directions are at least as far apart as their zenith angles.
        if not np.any(np.abs(np.abs(polar + shift_deg) - sigma_deg) <= within_deg + TOLERANCE_DEG):
            continue
        zenith = np.radians(polar + shift_deg)
        cosine = np.cos(zenith) * np.cos(sigma) - np.sin(zenith) * np.sin(sigma) * np.cos(np.radians(beta_deg))[:, None]
        np.minimum(closest, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), out=closest)
    return closest


def _refuse_too_many(sigmas: int, betas: float, shifts: int) -> None:
    if sigmas * betas * shifts > MAX_NEAR_CANDIDATES:
        raise ValueError(
            f"near_specular: {sigmas} sigma_deg x {betas:.0f} beta x {shifts} shift are more than {MAX_NEAR_CANDIDATES} poses; "
            "take greater steps"
        )


def overlap_poses(file: ScheduleFile, rig: RigFile) -> Floats:
    """Incidence, beta, shift (n, 3) of `[overlap]`. Raises ValueError if no photodiodes can overlap."""
    if file.overlap is None:
        return np.zeros((0, 3))
    base, betas = grid_values(file.shift_deg)[0], grid_values(file.beta_deg)
    step = overlapping_step_deg(rig, base)
    if step is None:
        raise ValueError(
            f"overlap.points: from shift {base:g} deg the axis moves no photodiode to the position of another; remove [overlap]"
        )
    chosen = np.unique(np.round(np.linspace(0, len(betas) - 1, file.overlap.points)).astype(int))
    return np.array(
        [(sigma, betas[k], shift) for sigma in grid_values(file.sigma_deg) for k in chosen for shift in (base, base + step)]
    )


def overlapping_step_deg(rig: RigFile, base_deg: float) -> float | None:
    """The smallest step of the shift after which most photodiodes look where others did at `base_deg`; None without one."""
    counts: dict[float, int] = {}
    for arc in (rig.photodiodes.upper_deg, rig.photodiodes.lower_deg):
        for step in round_deg(np.subtract.outer(arc, arc)).ravel().tolist():
            if step != 0.0 and within_limits(rig.axes.shift, base_deg + step):
                counts[step] = counts.get(step, 0) + 1
    return min(counts, key=lambda step: (-counts[step], abs(step), step), default=None)


def symmetry_check_poses(file: ScheduleFile, rig: RigFile, poses: Floats) -> Floats:
    """Mirror images (n, 4) of the `poses` for `[symmetry_check]`, spread over all of them.

    Raises ValueError if the rig reaches fewer than `points`.
    """
    if file.symmetry_check is None:
        return np.zeros((0, 4))
    points = file.symmetry_check.points
    plain = poses[poses[:, 3] == grid_values(file.shift_deg)[0]]
    reasons: dict[int, str] = {}
    for turn in CHECK_TURNS_DEG:
        mirrored = mirror_images(plain, file.symmetry, turn)
        others = np.any(mirrored != plain, axis=1)
        within = others & within_limits(rig.axes.gamma, mirrored[:, 0]) & within_limits(rig.axes.beta, mirrored[:, 2])
        usable = mirrored[within & reachable_poses(arc_clearance(rig), plain, mirrored)]
        if len(usable) >= points:
            return np.asarray(usable[np.round(np.linspace(0, len(usable) - 1, points)).astype(int)])
        counts = {
            "equal their mirror image": int((~others).sum()),
            "beyond the limits of gamma or beta": int((others & ~within).sum()),
            "behind the incoming beam": int(within.sum()) - len(usable),
        }
        reasons.setdefault(len(usable), ", ".join(f"{count} {reason}" for reason, count in counts.items() if count))
    most = max(reasons)
    reason = f" ({reasons[most]})" if reasons[most] else ""
    remedy = "take fewer" if most else "remove [symmetry_check], or take gammas and betas whose mirror images the rig reaches"
    raise ValueError(
        f"symmetry_check.points: {points}, but the rig reaches the mirror images of {most} of {len(plain)} poses{reason}; "
        f"{remedy}"
    )
