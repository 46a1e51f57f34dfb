"""Finer poses where some photodiode looks near the specular direction, or near the one straight through."""

from itertools import chain

import numpy as np

from goniotwin.app.campaign.planning.sides import Side, looking_arcs, polar_deg, rig_sigma_deg
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Floats

MOST_LOOKED_AT = 10_000_000
TINY_DEG = 1e-6


def near_poses(file: ScheduleFile, rig: RigFile, side: Side) -> Floats:
    """Sigma (of the incidence), beta, shift (n, 3) of the schedule's `[near_specular]`, those of the grids among them.

    Raises ValueError where there are too many to look at.
    """
    table = file.near_specular
    if table is None:
        return np.zeros((0, 3))
    betas, shifts = np.array(grid_values(file.beta_deg)), np.array(grid_values(file.shift_deg))
    if table.beta_step_deg is not None:
        steps = (betas.max() - betas.min()) / table.beta_step_deg
        _refuse_too_many(len(grid_values(file.sigma_deg)), steps, len(shifts))
        betas = np.union1d(betas, np.round(betas.min() + table.beta_step_deg * np.arange(int(steps + 1e-6) + 1), 9))
    if table.shift_deg is not None:
        shifts = np.union1d(shifts, grid_values(table.shift_deg))
    _refuse_too_many(len(grid_values(file.sigma_deg)), len(betas), len(shifts))
    found = []
    for sigma in grid_values(file.sigma_deg):
        arcs = looking_arcs(file, rig_sigma_deg(sigma, side))
        polar = sorted(set(chain.from_iterable(polar_deg(rig, arc) for arc in arcs)))
        k, j = np.nonzero(_closest_deg(sigma, betas, shifts, polar, table.within_deg) <= table.within_deg + TINY_DEG)
        found.append(np.stack([np.full(len(k), sigma), betas[k], shifts[j]], axis=1))
    return np.concatenate(found)


def _closest_deg(sigma_deg: float, beta_deg: Floats, shift_deg: Floats, polar_deg: list[float], within_deg: float) -> Floats:
    """How near to the specular direction some photodiode looks, by beta and shift; infinite where far beyond `within_deg`."""
    closest = np.full((len(beta_deg), len(shift_deg)), np.inf)
    sigma = np.radians(sigma_deg)
    for polar in polar_deg:
        # Two directions are never nearer to each other than their zenith angles are.
        if not np.any(np.abs(np.abs(polar + shift_deg) - sigma_deg) <= within_deg + TINY_DEG):
            continue
        zenith = np.radians(polar + shift_deg)
        cosine = np.cos(zenith) * np.cos(sigma) - np.sin(zenith) * np.sin(sigma) * np.cos(np.radians(beta_deg))[:, None]
        np.minimum(closest, np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))), out=closest)
    return closest


def _refuse_too_many(sigmas: int, betas: float, shifts: int) -> None:
    if sigmas * betas * shifts > MOST_LOOKED_AT:
        raise ValueError(
            f"near_specular: {sigmas} sigma_deg x {betas:.0f} beta x {shifts} shift would have to be looked at; "
            "take greater steps"
        )
