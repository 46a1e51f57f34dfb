"""Poses beyond the grids that hold the others to account: mirror images, overlapping photodiodes, the open beam."""

import numpy as np

from goniotwin.app.campaign.planning.sides import far_arc, lit_sides, polar_deg, rig_sigma_deg
from goniotwin.app.campaign.planning.symmetry import images
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import DECIMALS, grid_values
from goniotwin.app.rig import RigFile, arc_clearance
from goniotwin.arrays import Flags, Floats

CHECK_TURNS_DEG = (90.0, -90.0, 0.0)
"""By how much an isotropic sample is turned, besides being mirrored, where its symmetry is checked: the first that can be."""
IN_THE_BEAM_DEG = 180.0


def mirror_images(file: ScheduleFile, rig: RigFile, poses: Floats) -> Floats:
    """The images (n, 4) of as many of the `poses` as `[symmetry_check]` says, spread over all of them.

    Raises ValueError where the rig reaches too few.
    """
    if file.symmetry_check is None:
        return np.zeros((0, 4))
    points = file.symmetry_check.points
    plain = poses[poses[:, 3] == grid_values(file.shift_deg)[0]]
    told: dict[int, str] = {}
    for turn in CHECK_TURNS_DEG:
        mirrored = images(plain, file.symmetry, turn)
        others = np.any(mirrored != plain, axis=1)
        reached = others & _reached(rig, mirrored)
        usable = mirrored[reached & _clear(rig, plain, mirrored)]
        if len(usable) >= points:
            return np.asarray(usable[np.round(np.linspace(0, len(usable) - 1, points)).astype(int)])
        counts = {
            "are their own": int((~others).sum()),
            "beyond the limits of gamma or beta": int((others & ~reached).sum()),
            "behind the incoming beam": int(reached.sum()) - len(usable),
        }
        told.setdefault(len(usable), ", ".join(f"{count} {why}" for why, count in counts.items() if count))
    most = max(told)
    why = f" of {len(plain)} ({told[most]})" if told[most] else ""
    remedy = "take fewer" if most else "leave [symmetry_check] out, or take gammas and betas whose images the rig reaches"
    raise ValueError(f"symmetry_check.points: {points}, but the rig reaches the mirror images of {most} poses{why}; {remedy}")


def _reached(rig: RigFile, poses: Floats) -> Flags:
    gamma, beta = rig.axes.gamma, rig.axes.beta
    return np.asarray(
        (poses[:, 0] >= gamma.lower_deg) & (poses[:, 0] <= gamma.upper_deg)
        & (poses[:, 2] >= beta.lower_deg) & (poses[:, 2] <= beta.upper_deg)
    )  # fmt: skip


def _clear(rig: RigFile, poses: Floats, mirrored: Floats) -> Flags:
    """Which can be reached from some of the poses, at their shift, without sweeping through the beam."""
    clearance = arc_clearance(rig)
    betas, shift = np.unique(poses[:, 2]), float(poses[:, 3].max())
    free = {
        beta: clearance.veto((beta, float(betas[np.abs(betas - beta).argmin()])), (shift,)) is None
        for beta in np.unique(mirrored[:, 2]).tolist()
    }
    return np.array([free[beta] for beta in mirrored[:, 2].tolist()], dtype=bool)


def overlap_poses(file: ScheduleFile, rig: RigFile) -> Floats:
    """Sigma (of the incidence), beta, shift (n, 3) of `[overlap]`. Raises ValueError where no photodiodes can overlap."""
    if file.overlap is None:
        return np.zeros((0, 3))
    base, betas = grid_values(file.shift_deg)[0], grid_values(file.beta_deg)
    step = overlapping_step_deg(rig, base)
    if step is None:
        raise ValueError(
            f"overlap.points: from shift {base:g} deg the axis takes no photodiode to its neighbour's place; leave it out"
        )
    chosen = np.unique(np.round(np.linspace(0, len(betas) - 1, file.overlap.points)).astype(int))
    return np.array(
        [(sigma, betas[k], shift) for sigma in grid_values(file.sigma_deg) for k in chosen for shift in (base, base + step)]
    )


def overlapping_step_deg(rig: RigFile, base_deg: float) -> float | None:
    """The least change of the shift after which most photodiodes look where others did at `base_deg`; None: there is none."""
    counts: dict[float, int] = {}
    for arc in (rig.photodiodes.upper_deg, rig.photodiodes.lower_deg):
        for one in arc:
            for other in arc:
                step = round(other - one, DECIMALS)
                if step != 0.0 and rig.axes.shift.lower_deg <= base_deg + step <= rig.axes.shift.upper_deg:
                    counts[step] = counts.get(step, 0) + 1
    return min(counts, key=lambda step: (-counts[step], abs(step), step), default=None)


def open_beam_poses(file: ScheduleFile, rig: RigFile) -> Floats:
    """Poses (n, 4) at which a photodiode of the far arc looks straight into the beam. Raises ValueError where none can."""
    poses = []
    lower, upper = rig.axes.shift.lower_deg, rig.axes.shift.upper_deg
    for side in lit_sides(file):
        for sigma in grid_values(file.sigma_deg):
            there = rig_sigma_deg(sigma, side)
            shifts = [round(sigma - polar, DECIMALS) for polar in polar_deg(rig, far_arc(there))]
            possible = sorted((abs(shift), shift) for shift in shifts if lower <= shift <= upper)
            if not possible:
                raise ValueError(
                    f"open_beam: at sigma {sigma:g} deg no photodiode of the {far_arc(there)} arc comes into the beam; "
                    "take that sigma out, or set open_beam = false"
                )
            poses.append((grid_values(file.gamma_deg)[0], there, IN_THE_BEAM_DEG, possible[0][1]))
    return np.array(poses)
