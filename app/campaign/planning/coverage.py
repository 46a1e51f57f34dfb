"""Where the photodiodes look in a plan: how many directions, which the mirror unit hides, which two photodiodes share.

What of a plan the etalon's certificate says nothing of: told before the start, and refused where that is everything.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.arcs import HALF_TURN_DEG, Arc, incidence_deg, lighting_deg, looking_arcs, polar_deg
from goniotwin.app.campaign.geometry.shadow import may_be_shadowed, shadowed
from goniotwin.app.campaign.geometry.symmetry import turned
from goniotwin.app.campaign.schedule.certificate import Certificate, parse_certificate
from goniotwin.app.campaign.schedule.file import ScheduleDescription, ScheduleFile
from goniotwin.app.campaign.schedule.grids import DECIMALS, grid_values
from goniotwin.app.errors import UserError
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints

AWAY_FROM_THE_LIGHT_DEG = 180.0


@dataclass(frozen=True)
class Seen:
    """What one arc sees at one sigma: the distinct directions (n, 2), zenith from the arc's own pole and azimuth in degrees;
    how many of them two photodiodes see; which are hidden (n,) at the sample, and which at the etalon that scales them;
    whether the specular direction is among them, or, on the far side, the one straight through.
    """

    sigma_deg: float
    arc: Arc
    angles_deg: Floats
    shared: int
    at_sample: Flags
    at_etalon: Flags
    hides_specular: bool

    @property
    def directions(self) -> int:
        """How many there are."""
        return len(self.angles_deg)

    @property
    def hidden_deg(self) -> Floats:
        """Those that the sample's pose hides or the etalon's."""
        return self.angles_deg[self.at_sample | self.at_etalon]

    @property
    def only_etalon(self) -> int:
        """How many of them the sample's pose leaves free."""
        return int((self.at_etalon & ~self.at_sample).sum())

    @property
    def transmitted(self) -> bool:
        """Whether the arc is on the far side of the light."""
        return lighting_deg(self.sigma_deg, self.arc) != self.sigma_deg


def directions_seen(file: ScheduleFile, rig: RigFile, poses: Floats) -> list[Seen]:
    """Of the arcs that the schedule is about, sigma by sigma; poses (n, 4)."""
    return list(_seen(file, rig, poses))


def _seen(file: ScheduleFile, rig: RigFile, poses: Floats) -> Iterator[Seen]:
    for sigma in np.unique(poses[:, 1]).tolist():
        at = poses[poses[:, 1] == sigma]
        for arc in looking_arcs(file, sigma):
            zenith, azimuth, seen_by = _distinct(at[:, 2], at[:, 3], np.array(polar_deg(rig, arc)))
            angles = np.stack([zenith, azimuth], axis=1)
            straight = np.array([incidence_deg(sigma)]), np.array([AWAY_FROM_THE_LIGHT_DEG])
            there = lighting_deg(sigma, arc)
            at_sample = at_etalon = _hidden(rig, sigma, arc, zenith, azimuth)
            hides = bool(_hidden(rig, sigma, arc, *straight)[0])
            if there != sigma:
                at_etalon = _hidden(rig, there, arc, zenith, azimuth)
                hides |= bool(_hidden(rig, there, arc, *straight)[0])
            yield Seen(sigma, arc, angles, int((seen_by > 1).sum()), at_sample, at_etalon, hides)


def _hidden(rig: RigFile, sigma_deg: float, arc: Arc, zenith_deg: Floats, azimuth_deg: Floats) -> Flags:
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


def uncovered(schedule: ScheduleDescription, seen: list[Seen]) -> Iterator[str]:
    """A warning where some of the directions, at some of the wavelengths, will have no value for want of a certificate."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    wavelengths = np.array(grid_values(file.wavelength_nm))
    within = certificate.covers("wavelength_nm", wavelengths)
    directions, total = _covered(certificate, seen), sum(each.directions for each in seen)
    outside = [
        *([f"{(~within).sum()} of {within.size} wavelengths"] if not within.all() else []),
        *([f"{total - directions} of {total} directions"] if directions < total else []),
    ]
    if outside:
        yield (
            f"the etalon's certificate {file.certificate.file} says nothing of {' and '.join(outside)}, which will have no "
            f"value (uncertified): it holds for {certificate}; take one that holds for all, or measure less"
        )


def refuse_uncertified(schedule: ScheduleDescription, rig: RigFile, poses: Floats) -> None:
    """Raises UserError where the certificate says nothing of any direction, or wavelength; `poses` (n, 4) of the samples."""
    file = schedule.file
    if schedule.certificate is None or file.certificate is None:
        return
    certificate = parse_certificate(schedule.certificate, file.certificate.file)
    within = certificate.covers("wavelength_nm", np.array(grid_values(file.wavelength_nm)))
    what = "wavelengths"
    if within.any():
        what = "directions"
        if _covered(certificate, directions_seen(file, rig, poses)):
            return
    raise UserError(
        f"{schedule.name}: certificate.file: {file.certificate.file} says nothing of any of the schedule's {what}, so that "
        f"nothing would have a value: it holds for {certificate}; name one that holds for what is measured"
    )


def _covered(certificate: Certificate, seen: list[Seen]) -> int:
    """How many directions it says something of, at the wavelengths that it has."""
    count = 0
    for each in seen:
        if certificate.covers("incidence_deg", np.array([incidence_deg(each.sigma_deg)])).all():
            zenith, azimuth = each.angles_deg.T
            count += int((certificate.covers("zenith_deg", zenith) & certificate.covers("azimuth_deg", azimuth)).sum())
    return count
