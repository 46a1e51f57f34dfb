"""Arcs: which arc sees which light, what its photodiodes look at in a pose, and the directions that they cover in a plan.

The arc on the lit side sees reflected light, the other arc transmitted light.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.directions import (
    ARCS,
    Arc,
    LitSide,
    PoseAngles,
    rig_sigma_deg,
    round_azimuth,
    zenith_deg,
)
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors, may_be_blocked
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import (
    HALF_TURN_DEG,
    SPECULAR_AZIMUTH_DEG,
    arc_direction,
    incidence_deg,
    is_lit_from_behind,
    mirror_in_sample_plane,
    opposite_sigma_deg,
    polar_and_azimuth,
    round_deg,
    to_specular,
    turn_about_x,
)


def lit_sides(file: ScheduleFile) -> tuple[LitSide, ...]:
    """The sides of the sample that a schedule measures with light on them."""
    return ("front", "back") if file.side == "both" else (file.side,)


def lit_side(rig_sigma_deg: float) -> LitSide:
    """The lit side of the sample."""
    return "back" if is_lit_from_behind(rig_sigma_deg) else "front"


def lit_arc(rig_sigma_deg: float) -> Arc:
    """The arc on the lit side."""
    return "lower" if is_lit_from_behind(rig_sigma_deg) else "upper"


def far_arc(rig_sigma_deg: float) -> Arc:
    """The arc on the side that is not lit."""
    return "upper" if is_lit_from_behind(rig_sigma_deg) else "lower"


def observing_arcs(file: ScheduleFile, rig_sigma_deg: float) -> Iterator[Arc]:
    """The arcs that see the light that a schedule is about: reflected, transmitted, or both."""
    if file.light in ("reflected", "both"):
        yield lit_arc(rig_sigma_deg)
    if file.light in ("transmitted", "both"):
        yield far_arc(rig_sigma_deg)


def polar_deg(rig: RigFile, arc: Arc) -> tuple[float, ...]:
    """Polar angles of an arc's photodiodes at shift 0, from its own pole."""
    return tuple(rig.photodiodes.upper_deg if arc == "upper" else rig.photodiodes.lower_deg)


def arc_channels(rig: RigFile, arc: Arc) -> Ints:
    """Numbers of an arc's photodiodes: those of the upper arc come first."""
    upper, lower = (len(polar_deg(rig, each)) for each in ARCS)
    return np.arange(upper) if arc == "upper" else upper + np.arange(lower)


def etalon_sigma_deg(sigma_deg: float, arc: Arc) -> float:
    """Sigma of the rig at the etalon that scales what an arc measures at a sigma of the rig: light on the arc's own side."""
    return rig_sigma_deg(incidence_deg(sigma_deg), "front" if arc == "upper" else "back")


def etalon_sigmas_deg(file: ScheduleFile, sigma_deg: float) -> tuple[float, ...]:
    """Sigmas of the rig at the etalon that scales what a schedule measures at a sigma of the rig.

    The etalon only reflects. So the light is on the side of each observing arc: for transmitted light on the other side than
    at the sample.
    """
    return tuple(etalon_sigma_deg(sigma_deg, arc) for arc in observing_arcs(file, sigma_deg))


@dataclass(frozen=True)
class ArcView:
    """One arc in one pose; arrays have one element for each photodiode, angles are in degrees.

    `channels` are the numbers of the photodiodes. `zenith` and `azimuth` are the directions of observation in the frame of the
    rig, `polar` the polar angles from the normal of the side that the arc is on. `theta` and `phi` are specular coordinates:
    about the specular direction or, if `transmitted`, about the direction straight through. `back`: the light is on the back;
    `theta` and `phi` are then those of the sample turned about the x axis, so that they belong to its back.
    """

    channels: Ints
    zenith: Floats
    azimuth: Floats
    theta: Floats
    phi: Floats
    polar: Floats
    back: bool
    transmitted: bool

    def etalon_pose(self, pose: PoseAngles) -> PoseAngles:
        """The pose in which this arc sees the etalon as it sees the sample, with the light on the arc's own side."""
        gamma, sigma, beta, shift = pose
        return (gamma, opposite_sigma_deg(sigma), beta, shift) if self.transmitted else pose


def arc_views(rig: RigFile, pose: PoseAngles) -> list[ArcView]:
    """Views of the upper and of the lower arc, without an arc that has no photodiodes."""
    return [arc_view(rig, pose, arc) for arc in ARCS if polar_deg(rig, arc)]


def arc_view(rig: RigFile, pose: PoseAngles, arc: Arc) -> ArcView:
    """The view of one arc."""
    _, sigma, beta, shift = pose
    return views_at_sigma(rig, sigma, np.array([beta]), np.array([shift]), arc)[0]


def views_at_sigma(rig: RigFile, sigma_deg: float, beta_deg: Floats, shift_deg: Floats, arc: Arc) -> list[ArcView]:
    """The views of one arc in poses of one sigma, with these beta and shifts (poses,)."""
    angles = np.array(polar_deg(rig, arc), dtype=float)
    polar, azimuth = polar_and_azimuth(angles + shift_deg[:, None], beta_deg[:, None])
    back = is_lit_from_behind(sigma_deg)
    transmitted = arc != lit_arc(sigma_deg)
    direction = arc_direction(polar, azimuth, lower=arc == "lower")
    if back:
        direction = turn_about_x(direction)
    if transmitted:
        direction = mirror_in_sample_plane(direction)
    theta, phi = to_specular(incidence_deg(sigma_deg), direction)
    each = zip(zenith_deg(polar, arc), azimuth, theta, phi, polar, strict=True)
    channels = arc_channels(rig, arc)
    return [ArcView(channels, *columns, back, transmitted) for columns in each]


@dataclass(frozen=True)
class ArcDirections:
    """The directions that one arc measures at one sigma of the rig in a plan.

    `angles_deg` (n, 2): the distinct directions, polar angle from the arc's own pole and azimuth. `shared`: how many of them
    two photodiodes measure. `blocked_at_sample` (n,) and `blocked_at_etalon` (n,): blocked by the mirror unit in the pose of
    the sample, and of the etalon that scales it. `specular_blocked`: whether the specular direction is blocked or, on the far
    arc, the direction straight through.
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
        """Number of directions."""
        return len(self.angles_deg)

    @property
    def blocked_deg(self) -> Floats:
        """Directions (m, 2) that are blocked at the sample or at the etalon."""
        return self.angles_deg[self.blocked_at_sample | self.blocked_at_etalon]

    @property
    def blocked_only_at_etalon(self) -> int:
        """Number of directions that are blocked at the etalon only."""
        return int((self.blocked_at_etalon & ~self.blocked_at_sample).sum())

    @property
    def transmitted(self) -> bool:
        """Whether the arc sees transmitted light."""
        return self.arc != lit_arc(self.sigma_deg)


def observed_directions(file: ScheduleFile, rig: RigFile, poses: Floats) -> list[ArcDirections]:
    """The directions that poses (n, 4) cover, by sigma of the rig and observing arc."""
    return list(_observed(file, rig, poses))


def _observed(file: ScheduleFile, rig: RigFile, poses: Floats) -> Iterator[ArcDirections]:
    straight = np.array([SPECULAR_AZIMUTH_DEG])
    for sigma in np.unique(poses[:, 1]).tolist():
        at = poses[poses[:, 1] == sigma]
        for arc in observing_arcs(file, sigma):
            polar, azimuth, photodiodes = _distinct(at[:, 2], at[:, 3], np.array(polar_deg(rig, arc)))
            angles = np.stack([polar, azimuth], axis=1)
            specular = np.array([incidence_deg(sigma)])
            sigma_of_etalon = etalon_sigma_deg(sigma, arc)
            at_sample = at_etalon = _blocked(rig, sigma, arc, polar, azimuth)
            specular_blocked = bool(_blocked(rig, sigma, arc, specular, straight)[0])
            if sigma_of_etalon != sigma:
                at_etalon = _blocked(rig, sigma_of_etalon, arc, polar, azimuth)
                specular_blocked |= bool(_blocked(rig, sigma_of_etalon, arc, specular, straight)[0])
            yield ArcDirections(sigma, arc, angles, int((photodiodes > 1).sum()), at_sample, at_etalon, specular_blocked)


def _blocked(rig: RigFile, sigma_deg: float, arc: Arc, polar_deg: Floats, azimuth_deg: Floats) -> Flags:
    zenith = zenith_deg(polar_deg, arc)
    blocked = may_be_blocked(rig, sigma_deg, zenith, azimuth_deg)
    blocked[blocked] = blocked_by_mirrors(rig, sigma_deg, zenith[blocked], azimuth_deg[blocked])
    return blocked


def _distinct(beta_deg: Floats, shift_deg: Floats, polar_deg: Floats) -> tuple[Floats, Floats, Ints]:
    """Polar angle and azimuth of the distinct directions, and the number of photodiodes that measure each.

    At the pole itself all azimuths are one. Every pair of a polar angle and an azimuth is an entry of a table, and each
    photodiode marks its entries: sorting would take far longer.
    """
    betas, which_beta = np.unique(round_deg(beta_deg), return_inverse=True)
    shifts, which_shift = np.unique(round_deg(shift_deg), return_inverse=True)
    pairs = np.unique(which_beta.ravel() * len(shifts) + which_shift.ravel())
    signed = round_deg(polar_deg[:, None] + shifts)
    polars, polar_index = np.unique(np.abs(signed), return_inverse=True)
    polar_index = polar_index.reshape(signed.shape)
    both_sides = np.stack([round_azimuth(betas), round_azimuth(betas + HALF_TURN_DEG)])
    azimuths, azimuth_index = np.unique(both_sides, return_inverse=True)
    azimuth_index = azimuth_index.reshape(2, len(betas))
    photodiodes = np.zeros((len(polars), len(azimuths)), dtype=np.int64)
    beta, shift = np.divmod(pairs, len(shifts))
    for k in range(len(polar_deg)):
        azimuth = azimuth_index[(signed[k, shift] < 0.0).astype(int), beta]
        azimuth = np.where(signed[k, shift] == 0.0, 0, azimuth)
        marked = np.zeros_like(photodiodes, dtype=bool)
        marked[polar_index[k, shift], azimuth] = True
        photodiodes += marked
    polar, azimuth = np.nonzero(photodiodes)
    return polars[polar], azimuths[azimuth], photodiodes[polar, azimuth]
