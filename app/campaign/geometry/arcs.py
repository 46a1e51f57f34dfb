"""Sides and arcs: which way the mirror unit turns for a side of the sample, and which arc sees its light.

A schedule's sigma is the incidence on the side that is lit, so for the back the rig turns to 180 - sigma. The arc on the lit
side sees what is reflected, the other what goes through. Upper and lower arc are each other's mirror images in the sample's
plane, and so are the two sides: about its own normal everything looks as it does from the front.
"""

from collections.abc import Iterator
from typing import Literal

from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.grids import DECIMALS
from goniotwin.app.rig import RigFile

Side = Literal["front", "back"]
Arc = Literal["upper", "lower"]
HALF_TURN_DEG = 180.0


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


def looking_arcs(file: ScheduleFile, rig_sigma_deg: float) -> Iterator[Arc]:
    """The arcs whose photodiodes see what the schedule is about."""
    if file.light in ("reflected", "both"):
        yield lit_arc(rig_sigma_deg)
    if file.light in ("transmitted", "both"):
        yield far_arc(rig_sigma_deg)


def polar_deg(rig: RigFile, arc: Arc) -> tuple[float, ...]:
    """Polar angles of an arc's photodiodes at shift 0, from its own pole."""
    return tuple(rig.photodiodes.upper_deg if arc == "upper" else rig.photodiodes.lower_deg)


def lighting_deg(there_deg: float, arc: Arc) -> float:
    """Where the mirror unit goes for the etalon that scales what an arc sees at a sigma: to the arc's own side."""
    return rig_sigma_deg(incidence_deg(there_deg), "front" if arc == "upper" else "back")


def etalon_sigmas_deg(file: ScheduleFile, there_deg: float) -> tuple[float, ...]:
    """Where the mirror unit goes for the etalon that scales what is measured at a sigma.

    The etalon only reflects. So it is lit on the side of each arc that looks: for transmitted light from the other side.
    """
    return tuple(lighting_deg(there_deg, arc) for arc in looking_arcs(file, there_deg))
