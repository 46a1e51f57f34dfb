"""The light of a rig: `[light]` of the rig file."""

from dataclasses import dataclass
from typing import Annotated

from annotated_types import Ge, Le, Lt

from goniotwin.keys import Share


@dataclass(frozen=True)
class LightTable:
    """The light of the rig: the monochromator's band, and the polarisation.

    `bandwidth_nm`: full width at half maximum of the monochromator's triangular band. Values are corrected for it. Without it,
    their uncertainty includes the effect of a band of 5 nm. `polarisation`: degree of linear polarisation of the light before
    the mirrors. `azimuth_deg`: angle of the plane of polarisation from the vertical, towards the side of growing sigma.
    `mirror_s`: reflectance of one mirror for light polarised across its plane of incidence. The default is aluminium's at 45
    deg. `mirror_p`: reflectance of one mirror for light polarised in its plane of incidence.
    """

    bandwidth_nm: Annotated[float, Ge(0.0), Le(100.0)] | None = None
    polarisation: Annotated[float, Ge(0.0), Le(1.0)] = 0.0
    azimuth_deg: Annotated[float, Ge(-180.0), Lt(180.0)] = 0.0
    mirror_s: Share = 0.94
    mirror_p: Share = 0.88
