"""What a campaign comes to: a BSDF at the directions in which it was measured.

What a sample's points come to when they themselves are gone: how many there are, how many are good, what the others lack.

How steep a measured BSDF is along the arc: what an error of an angle makes of its value.

Two values of one direction, or of a direction and its mirror image, differ by more than noise where the lobe is steep and the
angles are not quite what they are said to be. Checks and calibrations that did not know this would find fault with every
narrow lobe.
"""

import math
from dataclasses import dataclass, field, fields

import numpy as np

from goniotwin.arrays import Flags, Floats, Ints


@dataclass(frozen=True)
class BsdfPoints:
    """A BSDF at the directions in which it was measured; arrays of one length, a point each.

    Angles in degrees: `zenith` and `azimuth` of the observation in the rig's frame, `theta` and `phi` about the specular
    direction (of transmitted light: about the direction straight on). `back`: the light came from behind, sigma is beyond 90
    deg. `bsdf` and its standard uncertainty `u_bsdf` in 1/sr; NaN where there is no value, and then a flag says why:

    - `shadowed` by the mirror unit, wholly or in part, at the sample or at the etalon that scales it: a value where there was
      light, but not the sample's;
    - `clipped`: over the range at every gain, of sample, etalon or signature;
    - `no_etalon`: the etalon gave nothing to divide by;
    - `dead`: although it should have, or the photodiode's dark current is gone;
    - `uncertified`: the etalon's certificate says nothing of this wavelength or direction;
    - `drifted`: between drift checks one of which was beyond its limit; the value is there, and may be wrong;
    - `under_range`: the sample's signal is lost in its noise, or in what is uncertain of the signature: the value is right, and
      says little;
    - `field`: what the finite field of view does to the value cannot be told from those about it, and is not in `u_bsdf`.

    `signature` is the instrument's own share of the sample's signal, which has been subtracted; NaN where it was not measured.
    `mirrored`: measured to check the stated symmetry; good, but no part of the table that was asked for.
    `u_field` is the field's part of `u_bsdf`, 1/sr; NaN where it cannot be told.
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
        """Some of the points, or all in another order."""
        return BsdfPoints(*(getattr(self, field.name)[chosen] for field in fields(self)))

    @property
    def good(self) -> Flags:
        """Which have a value that may be trusted."""
        return np.isfinite(self.bsdf) & ~self.shadowed & ~self.drifted & ~self.dead

    @property
    def front(self) -> "BsdfPoints":
        """Reflection of light from the front."""
        return self.where(~self.back & ~self.transmitted)

    @property
    def in_plane(self) -> Flags:
        """Which lie in the plane of incidence, within 1e-6 deg."""
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
        """By their names in files."""
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


def joined(blocks: list[BsdfPoints]) -> BsdfPoints:
    """The points of all blocks, in order."""
    return BsdfPoints(*(np.concatenate([getattr(block, field.name) for block in blocks]) for field in fields(BsdfPoints)))


FIRST = ("shadowed", "uncertified", "no-etalon", "clipped", "dead", "drift")
"""Flags by which a point is counted: the first that it has."""


@dataclass
class Tally:
    """`under_range` are good ones lost in their noise; `flagged` how many of all have a flag, by the first; `trusted` the
    photodiodes of good values that are not lost in noise; `freed` whether the instrument's own light was subtracted anywhere.
    """

    directions: int = 0
    good: int = 0
    under_range: int = 0
    flagged: dict[str, int] = field(default_factory=dict)
    trusted: set[int] = field(default_factory=set)
    transmitted: bool = False
    freed: bool = False

    def add(self, points: BsdfPoints) -> None:
        """Some more points."""
        good = points.good
        self.directions += points.bsdf.size
        self.good += int(good.sum())
        self.under_range += int((good & points.under_range).sum())
        self.trusted.update(np.unique(points.photodiode[good & ~points.under_range]).tolist())
        self.transmitted |= bool(points.transmitted.any())
        self.freed |= bool(np.isfinite(points.signature).any())
        left = np.ones(points.bsdf.size, dtype=bool)
        for flag in FIRST:
            here = left & points.flags[flag]
            self.flagged[flag] = self.flagged.get(flag, 0) + int(here.sum())
            left &= ~here


DECIMALS = 3
"""Directions that are nearer than a thousandth of a degree are one."""
HALF_TURN_DEG = 180.0


def steepness(points: BsdfPoints) -> Floats:
    """Relative change per degree along the arc, the greater of those to the neighbour on either side; 0 where none is known.

    Neighbours are the nearest directions of the same half planes that have a value above zero, whichever photodiode and shift
    they were seen with.
    """
    found = np.zeros(points.bsdf.size)
    usable = np.isfinite(points.bsdf) & (points.bsdf > 0.0) & ~points.shadowed
    if not usable.any():
        return found
    here = points.where(usable)
    plane = np.mod(here.beta_deg, HALF_TURN_DEG)
    polar = np.minimum(here.zenith_deg, HALF_TURN_DEG - here.zenith_deg)
    signed = np.where(np.abs(np.mod(here.azimuth_deg, 2.0 * HALF_TURN_DEG) - plane) < 1e-6, polar, -polar)
    keys = [here.wavelength_nm, here.sigma_deg, here.gamma_deg, plane, here.transmitted, signed]
    places, which = np.unique(np.round(np.stack(keys, axis=1), DECIMALS), axis=0, return_inverse=True)
    which = which.ravel()
    logs = np.bincount(which, weights=np.log(here.bsdf)) / np.bincount(which)
    same = np.all(places[1:, :-1] == places[:-1, :-1], axis=1)
    slope = np.abs(np.diff(logs)) / np.where(same, np.diff(places[:, -1]), np.inf)
    found[usable] = np.maximum(np.append(slope, 0.0), np.insert(slope, 0, 0.0))[which]
    return found


CHANCE = 1e-6
"""Of the worst of all differences, where the uncertainties are right."""
DEVIATIONS = 5.0
"""Of the chi-square distribution."""


def plausible(pairs: int, chi_square: float, worst: float) -> bool:
    """Whether `chi_square` of so many `pairs` is within five standard deviations of its distribution, and the `worst` of
    them, in its standard uncertainties, no worse than chance allows.
    """
    if not pairs:
        return True
    most = math.sqrt(2.0 * math.log(pairs / CHANCE))
    return chi_square <= pairs + DEVIATIONS * math.sqrt(2.0 * pairs) and worst <= most
