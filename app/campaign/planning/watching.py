"""Photodiodes that the drift checks cannot watch, as far as geometry tells: hidden at their pose, or away from its light.

How much light a sample sends to each at that pose only a rehearsal knows: see app.campaign.reducing.watching.
"""

from collections.abc import Iterator

import numpy as np

from goniotwin.app.campaign.planning.directions import Seen
from goniotwin.app.campaign.planning.plan import Plan
from goniotwin.app.campaign.planning.shadow import shadowed
from goniotwin.app.campaign.planning.sides import HALF_TURN_DEG, Arc, far_arc, polar_deg
from goniotwin.app.campaign.schedule.measuring import DriftTable
from goniotwin.app.campaign.spoken import numbers
from goniotwin.app.rig import RigFile
from goniotwin.arrays import Ints


def unwatched(plan: Plan, seen: list[Seen]) -> Iterator[str]:
    """A warning for each reason."""
    table = plan.schedule.file.drift
    if table is None:
        return
    rig, arcs = plan.rig.file, {each.arc for each in seen}
    dark = far_arc(table.sigma_deg)
    if dark in arcs:
        other = (
            f"a [drift] sigma_deg of {HALF_TURN_DEG - table.sigma_deg:g} lights them"
            if len(arcs) == 1
            else "measure transmitted light in a schedule of its own, with drift checks from that side"
        )
        yield (
            f"the drift checks at sigma {table.sigma_deg:g} deg do not light the side of the etalon that photodiodes "
            f"{numbers(_channels(rig, dark))} look at: a fault of theirs while the etalon is measured would pass; {other}"
        )
    hidden = np.concatenate([_hidden(rig, table, arc) for arc in sorted(arcs)])
    if hidden.size:
        yield (
            f"at the pose of the drift checks the mirror unit hides photodiodes {numbers(hidden)}: a fault of theirs would "
            "pass; take a [drift] pose that is free"
        )


def _channels(rig: RigFile, arc: Arc) -> Ints:
    first = 0 if arc == "upper" else len(rig.photodiodes.upper_deg)
    return first + np.arange(len(polar_deg(rig, arc)))


def _hidden(rig: RigFile, table: DriftTable, arc: Arc) -> Ints:
    signed = np.array(polar_deg(rig, arc), dtype=float) + table.shift_deg
    azimuth = table.beta_deg + np.where(signed < 0.0, HALF_TURN_DEG, 0.0)
    zenith = np.abs(signed) if arc == "upper" else HALF_TURN_DEG - np.abs(signed)
    return _channels(rig, arc)[shadowed(rig, table.sigma_deg, zenith, azimuth, table.gamma_deg)]
