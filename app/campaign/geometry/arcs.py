"""Sides and arcs: which way the mirror unit turns for a side of the sample, and which arc sees its light.

A schedule's sigma is the incidence on the side that is lit, so for the back the rig turns to 180 - sigma. The arc on the lit
side sees what is reflected, the other what goes through. Upper and lower arc are each other's mirror images in the sample's
plane, and so are the two sides: about its own normal everything looks as it does from the front.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors, may_be_blocked
from goniotwin.app.campaign.geometry.symmetry import wrap_azimuth
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import DECIMALS
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints

Side = Literal["front", "back"]
Arc = Literal["upper", "lower"]
HALF_TURN_DEG = 180.0
SPECULAR_AZIMUTH_DEG = 180.0


def lit_sides(file: ScheduleFile) -> tuple[Side, ...]:
    """The sides that a schedule has lit."""
    return ("front", "back") if file.side == "both" else (file.side,)


def rig_sigma_deg(sigma_deg: float, side: Side) -> float:
    """Where the mirror unit goes for an incidence on a side."""
    return sigma_deg if side == "front" else round(HALF_TURN_DEG - sigma_deg, DECIMALS)


def incidence_deg(rig_sigma_deg: float) -> float:
    """The incidence, from the normal of the side that is lit."""
    return min(rig_sigma_deg, round(HALF_TURN_DEG - rig_sigma_deg, DECIMALS))


def lit_arc(rig_sigma_deg: float) -> Arc:
    """The arc on the side that is lit."""
    return "upper" if rig_sigma_deg <= 0.5 * HALF_TURN_DEG else "lower"


def far_arc(rig_sigma_deg: float) -> Arc:
    """The other."""
    return "lower" if lit_arc(rig_sigma_deg) == "upper" else "upper"


def observing_arcs(file: ScheduleFile, rig_sigma_deg: float) -> Iterator[Arc]:
    """The arcs whose photodiodes see what the schedule is about."""
    if file.light in ("reflected", "both"):
        yield lit_arc(rig_sigma_deg)
    if file.light in ("transmitted", "both"):
        yield far_arc(rig_sigma_deg)


def polar_deg(rig: RigFile, arc: Arc) -> tuple[float, ...]:
    """Polar angles of an arc's photodiodes at shift 0, from its own pole."""
    return tuple(rig.photodiodes.upper_deg if arc == "upper" else rig.photodiodes.lower_deg)


def etalon_sigma_deg(there_deg: float, arc: Arc) -> float:
    """Where the mirror unit goes for the etalon that scales what an arc sees at a sigma: to the arc's own side."""
    return rig_sigma_deg(incidence_deg(there_deg), "front" if arc == "upper" else "back")


def etalon_sigmas_deg(file: ScheduleFile, there_deg: float) -> tuple[float, ...]:
    """Where the mirror unit goes for the etalon that scales what is measured at a sigma.

    The etalon only reflects. So it is lit on the side of each arc that looks: for transmitted light from the other side.
    """
    return tuple(etalon_sigma_deg(there_deg, arc) for arc in observing_arcs(file, there_deg))


@dataclass(frozen=True)
class ArcDirections:
    """What one arc sees at one sigma: the distinct directions (n, 2), zenith from the arc's own pole and azimuth in degrees;
    how many of them two photodiodes see; which are hidden (n,) at the sample, and which at the etalon that scales them;
    whether the specular direction is among them, or, on the far side, the one straight through.
    """

    sigma_deg: float
    arc: Arc
    angles_deg: Floats
    shared: int
    blocked_at_sample: Flags
    blocked_at_etalon: Flags
    specular_blocked: bool

    @property
    def directions(self) -> int:
        """How many there are."""
        return len(self.angles_deg)

    @property
    def blocked_deg(self) -> Floats:
        """Those that the sample's pose hides or the etalon's."""
        return self.angles_deg[self.blocked_at_sample | self.blocked_at_etalon]

    @property
    def blocked_only_at_etalon(self) -> int:
        """How many of them the sample's pose leaves free."""
        return int((self.blocked_at_etalon & ~self.blocked_at_sample).sum())

    @property
    def transmitted(self) -> bool:
        """Whether the arc is on the far side of the light."""
        return etalon_sigma_deg(self.sigma_deg, self.arc) != self.sigma_deg


def observed_directions(file: ScheduleFile, rig: RigFile, poses: Floats) -> list[ArcDirections]:
    """Of the arcs that the schedule is about, sigma by sigma; poses (n, 4)."""
    return list(_seen(file, rig, poses))


def _seen(file: ScheduleFile, rig: RigFile, poses: Floats) -> Iterator[ArcDirections]:
    for sigma in np.unique(poses[:, 1]).tolist():
        at = poses[poses[:, 1] == sigma]
        for arc in observing_arcs(file, sigma):
            zenith, azimuth, seen_by = _distinct(at[:, 2], at[:, 3], np.array(polar_deg(rig, arc)))
            angles = np.stack([zenith, azimuth], axis=1)
            straight = np.array([incidence_deg(sigma)]), np.array([SPECULAR_AZIMUTH_DEG])
            there = etalon_sigma_deg(sigma, arc)
            blocked_at_sample = blocked_at_etalon = _hidden(rig, sigma, arc, zenith, azimuth)
            hides = bool(_hidden(rig, sigma, arc, *straight)[0])
            if there != sigma:
                blocked_at_etalon = _hidden(rig, there, arc, zenith, azimuth)
                hides |= bool(_hidden(rig, there, arc, *straight)[0])
            yield ArcDirections(sigma, arc, angles, int((seen_by > 1).sum()), blocked_at_sample, blocked_at_etalon, hides)


def _hidden(rig: RigFile, sigma_deg: float, arc: Arc, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
    from_the_front = zenith_deg if arc == "upper" else HALF_TURN_DEG - zenith_deg
    hidden = may_be_blocked(rig, sigma_deg, from_the_front, azimuth_deg)
    hidden[hidden] = blocked_by_mirrors(rig, sigma_deg, from_the_front[hidden], azimuth_deg[hidden])
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
    azimuths, where_azimuth = np.unique(np.stack([wrap_azimuth(betas), wrap_azimuth(betas + 180.0)]), return_inverse=True)
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
