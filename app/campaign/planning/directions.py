"""Where the photodiodes look in a plan: how many directions, which the mirror unit hides, which two photodiodes share."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from app.campaign.planning.shadow import may_be_shadowed, shadowed
from app.campaign.planning.sides import HALF_TURN_DEG, Arc, incidence_deg, lit_arc, looking_arcs, polar_deg
from app.campaign.planning.symmetry import turned
from app.campaign.schedule.file import ScheduleFile
from app.campaign.schedule.grids import DECIMALS
from app.rig import RigFile

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
AWAY_FROM_THE_LIGHT_DEG = 180.0


@dataclass(frozen=True)
class Seen:
    """What one arc sees at one sigma: distinct directions and those of them that two photodiodes see; angles of the hidden
    ones (n, 2), zenith from the arc's own pole and azimuth in degrees; whether the specular direction is among them.
    """

    sigma_deg: float
    arc: Arc
    directions: int
    shared: int
    hidden_deg: Floats
    hides_specular: bool


def directions_seen(file: ScheduleFile, rig: RigFile, poses: Floats) -> list[Seen]:
    """Of the arcs that the schedule is about, sigma by sigma; poses (n, 4)."""
    return list(_seen(file, rig, poses))


def _seen(file: ScheduleFile, rig: RigFile, poses: Floats) -> Iterator[Seen]:
    for sigma in np.unique(poses[:, 1]).tolist():
        at = poses[poses[:, 1] == sigma]
        for arc in looking_arcs(file, sigma):
            zenith, azimuth, seen_by = _distinct(at[:, 2], at[:, 3], np.array(polar_deg(rig, arc)))
            hidden = _hidden(rig, sigma, arc, zenith, azimuth)
            specular = arc == lit_arc(sigma) and bool(
                _hidden(rig, sigma, arc, np.array([incidence_deg(sigma)]), np.array([AWAY_FROM_THE_LIGHT_DEG]))[0]
            )
            angles = np.stack([zenith[hidden], azimuth[hidden]], axis=1)
            yield Seen(sigma, arc, len(zenith), int((seen_by > 1).sum()), angles, specular)


def _hidden(rig: RigFile, sigma_deg: float, arc: Arc, zenith_deg: Floats, azimuth_deg: Floats) -> npt.NDArray[np.bool_]:
    from_the_front = zenith_deg if arc == "upper" else HALF_TURN_DEG - zenith_deg
    hidden = may_be_shadowed(rig, sigma_deg, from_the_front, azimuth_deg)
    hidden[hidden] = shadowed(rig, sigma_deg, from_the_front[hidden], azimuth_deg[hidden])
    return hidden


def _distinct(beta_deg: Floats, shift_deg: Floats, polar_deg: Floats) -> tuple[Floats, Floats, Ints]:
    """Zenith and azimuth of the distinct directions, and how many photodiodes see each.

    The arc beyond its pole looks at the other side, and at the pole itself all azimuths are one. Every pair of a zenith
    and an azimuth is a place in a table, which each photodiode ticks off: sorting would take far longer.
    """
    betas, which_beta = np.unique(np.round(beta_deg, DECIMALS), return_inverse=True)
    shifts, which_shift = np.unique(np.round(shift_deg, DECIMALS), return_inverse=True)
    pairs = np.unique(which_beta.ravel() * len(shifts) + which_shift.ravel())
    signed = np.round(polar_deg[:, None] + shifts, DECIMALS)
    zeniths, where_zenith = np.unique(np.abs(signed), return_inverse=True)
    where_zenith = where_zenith.reshape(signed.shape)
    azimuths, where_azimuth = np.unique(np.stack([turned(betas), turned(betas + 180.0)]), return_inverse=True)
    where_azimuth = where_azimuth.reshape(2, len(betas))
    seen_by = np.zeros((len(zeniths), len(azimuths)), dtype=np.int64)
    beta, shift = np.divmod(pairs, len(shifts))
    for k in range(len(polar_deg)):
        azimuth = where_azimuth[(signed[k, shift] < 0.0).astype(int), beta]
        azimuth = np.where(signed[k, shift] == 0.0, 0, azimuth)
        mine = np.zeros_like(seen_by, dtype=bool)
        mine[where_zenith[k, shift], azimuth] = True
        seen_by += mine
    zenith, azimuth = np.nonzero(seen_by)
    return zeniths[zenith], azimuths[azimuth], seen_by[zenith, azimuth]
