"""The light of a rig: `[light]` of the rig file."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le, Lt

from goniotwin.keys import Share


@dataclass(frozen=True)
class LightTable:
    """What the monochromator gives, and the mirrors make of its polarisation.

    `bandwidth_nm` is the full width at half maximum of the monochromator's triangular band. Where it is given, values are
    corrected for the band; where it is not, they have the effect of 5 nm in their uncertainty. `polarisation` is the degree of
    the light's linear polarisation before the mirrors, and `azimuth_deg` the angle of its plane from the vertical, towards the
    side of growing sigma; without it the light counts as unpolarised there. `mirror_s` and `mirror_p` are the reflectances of
    one mirror for light polarised across its plane of incidence and in it; the default is aluminium's at 45 deg.
    """

    bandwidth_nm: Annotated[float, Ge(0.0), Le(100.0)] | None = None
    polarisation: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    azimuth_deg: Annotated[float, Ge(-180.0), Lt(180.0)] = 0.0
    mirror_s: Share = 0.94
    mirror_p: Share = 0.88
