"""What a campaign comes to: a BSDF at the directions in which it was measured."""

import math
from dataclasses import dataclass, fields

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
