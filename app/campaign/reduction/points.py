"""The points of a reduction: a BSDF at the measured directions, with flags; their counts, slope and mutual agreement.

Two values of one direction, or of a direction and its mirror image, differ by more than noise where the lobe is steep and the
angles have errors. `steepness` is the slope that turns an angular error into an error of the value. Without it, checks and
calibrations would find a fault in every narrow lobe.
"""

import math
from dataclasses import dataclass, field, fields

import numpy as np

from goniotwin.app.campaign.schedule.grids import HALF_TURN_DEG, TURN_DEG
from goniotwin.arrays import Flags, Floats, Ints

DECIMALS = 3
"""Directions closer than a thousandth of a degree are one direction."""
FLAG_ORDER = ("shadowed", "uncertified", "no-etalon", "clipped", "dead", "drift")
"""Flags by which a tally counts a point: the first one that it has."""
CHANCE = 1e-6
"""Probability that the largest of all differences exceeds its limit, where the uncertainties are right."""
DEVIATIONS = 5.0
"""Limit of chi-square, in standard deviations of its distribution."""


@dataclass(frozen=True)
class BsdfPoints:
    """A BSDF at the measured directions; arrays of one length, an element for each point.

    Angles in degrees: `zenith` and `azimuth` of the observation in the rig's frame, `theta` and `phi` about the specular
    direction (for transmitted light: about the direction of regular transmission). `back`: the sample is lit from behind,
    sigma is beyond 90 deg. `bsdf` and its standard uncertainty `u_bsdf` are in 1/sr. Where there is no value they are NaN, and
    a flag gives the reason:

    - `shadowed`: blocked by the mirror unit, wholly or in part, at the sample or at the etalon that scales it; a value from
      the remaining light may be there, but it is not the sample's;
    - `clipped`: saturated at every gain, for sample, etalon or signature;
    - `no_etalon`: the etalon's signal is too low to divide by;
    - `dead`: the same, although the photodiode should have a signal; or the photodiode has lost its dark current;
    - `uncertified`: the etalon's certificate does not cover this wavelength or direction;
    - `drifted`: between drift checks one of which was beyond its limit; the value is there, and may be wrong;
    - `under_range`: the sample's signal is lost in its noise, or in the uncertainty of the signature: the value is right, but
      its relative uncertainty is large;
    - `field`: the effect of the finite field of view cannot be estimated from the values nearby, and is not in `u_bsdf`.

    `signature` is the instrument signature's share of the sample's signal, already subtracted; NaN where it was not measured.
    `mirrored`: measured to check the stated symmetry; a good value, but not one that the schedule's grid asks for.
    `u_field` is the field's component of `u_bsdf`, 1/sr; NaN where it cannot be estimated.
    """

    wavelength_nm: Floats
    sigma_deg: Floats
    gamma_deg: Floats
    beta_deg: Floats
    shift_deg: Floats
    photodiode: Ints
    zenith_deg: Floats
    azimuth_deg: Floats
    theta_deg: Floats
    phi_deg: Floats
    bsdf: Floats
    u_bsdf: Floats
    shadowed: Flags
    clipped: Flags
    no_etalon: Flags
    dead: Flags
    uncertified: Flags
    drifted: Flags
    under_range: Flags
    back: Flags
    transmitted: Flags
    signature: Floats
    mirrored: Flags
    u_field: Floats

    def where(self, chosen: Flags | Ints) -> "BsdfPoints":
        """A selection of the points, or all in another order."""
        return BsdfPoints(*(getattr(self, each.name)[chosen] for each in fields(self)))

    @property
    def good(self) -> Flags:
        """The points with a trusted value."""
        return np.isfinite(self.bsdf) & ~self.shadowed & ~self.drifted & ~self.dead

    @property
    def front(self) -> "BsdfPoints":
        """The points of light reflected on the front."""
        return self.where(~self.back & ~self.transmitted)

    @property
    def in_plane(self) -> Flags:
        """The points in the plane of incidence, within 1e-6 deg."""
        offset = np.mod(self.azimuth_deg, 180.0)
        return (np.minimum(offset, 180.0 - offset) < 1e-6) | (self.zenith_deg < 1e-6)

    @property
    def aspecular_deg(self) -> Floats:
        """Aspecular angle: theta, positive towards the normal (phi = 0) and negative towards grazing."""
        towards_normal = np.cos(np.radians(self.phi_deg)) > 0.0
        signed: Floats = np.where(towards_normal, self.theta_deg, -self.theta_deg)
        return signed

    @property
    def luminance_factor(self) -> Floats:
        """pi times the BSDF: 1 for the ideal diffuser."""
        return math.pi * self.bsdf

    @property
    def flags(self) -> dict[str, Flags]:
        """The flags by their names in files."""
        return {
            "shadowed": self.shadowed,
            "clipped": self.clipped,
            "no-etalon": self.no_etalon,
            "dead": self.dead,
            "uncertified": self.uncertified,
            "drift": self.drifted,
            "under-range": self.under_range,
            "field": self.good & np.isnan(self.u_field),
        }


def join_points(blocks: list[BsdfPoints]) -> BsdfPoints:
    """The points of all blocks, in order."""
    return BsdfPoints(*(np.concatenate([getattr(block, each.name) for block in blocks]) for each in fields(BsdfPoints)))


@dataclass
class Tally:
    """Streaming counts of points by flag.

    `under_range` counts good points that are lost in their noise; `flagged` all points by their first flag. `trusted` are the
    photodiodes of good values above their noise; `signature_subtracted` is true if the signature was subtracted anywhere.
    """

    directions: int = 0
    good: int = 0
    under_range: int = 0
    flagged: dict[str, int] = field(default_factory=dict)
    trusted: set[int] = field(default_factory=set)
    transmitted: bool = False
    signature_subtracted: bool = False

    def add(self, points: BsdfPoints) -> None:
        """Count more points."""
        good = points.good
        self.directions += points.bsdf.size
        self.good += int(good.sum())
        self.under_range += int((good & points.under_range).sum())
        self.trusted.update(np.unique(points.photodiode[good & ~points.under_range]).tolist())
        self.transmitted |= bool(points.transmitted.any())
        self.signature_subtracted |= bool(np.isfinite(points.signature).any())
        left = np.ones(points.bsdf.size, dtype=bool)
        for flag in FLAG_ORDER:
            here = left & points.flags[flag]
            self.flagged[flag] = self.flagged.get(flag, 0) + int(here.sum())
            left &= ~here


def steepness(points: BsdfPoints) -> Floats:
    """Relative change of the BSDF per degree along the arc (n,): the larger of the slopes on either side, 0 where unknown.

    Neighbours are the nearest directions of the same half planes with a value above zero, from any photodiode and shift.
    """
    result = np.zeros(points.bsdf.size)
    usable = np.isfinite(points.bsdf) & (points.bsdf > 0.0) & ~points.shadowed
    if not usable.any():
        return result
    here = points.where(usable)
    plane = np.mod(here.beta_deg, HALF_TURN_DEG)
    polar = np.minimum(here.zenith_deg, HALF_TURN_DEG - here.zenith_deg)
    signed = np.where(np.abs(np.mod(here.azimuth_deg, TURN_DEG) - plane) < 1e-6, polar, -polar)
    keys = [here.wavelength_nm, here.sigma_deg, here.gamma_deg, plane, here.transmitted, signed]
    places, which = np.unique(np.round(np.stack(keys, axis=1), DECIMALS), axis=0, return_inverse=True)
    which = which.ravel()
    logs = np.bincount(which, weights=np.log(here.bsdf)) / np.bincount(which)
    same = np.all(places[1:, :-1] == places[:-1, :-1], axis=1)
    slope = np.abs(np.diff(logs)) / np.where(same, np.diff(places[:, -1]), np.inf)
    result[usable] = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))[which]
    return result


def plausible(pairs: int, chi_square: float, worst: float) -> bool:
    """Whether differences of pairs of values are as their uncertainties allow: one rule for all consistency checks.

    `chi_square` has to be within five standard deviations of its distribution for so many `pairs`, and `worst`, the largest
    difference in its standard uncertainties, below a limit that it exceeds with a probability of 1e-6.
    """
    if not pairs:
        return True
    most = math.sqrt(2.0 * math.log(pairs / CHANCE))
    return chi_square <= pairs + DEVIATIONS * math.sqrt(2.0 * pairs) and worst <= most
