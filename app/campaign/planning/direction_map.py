"""The directions of a plan for a picture of it: measured, blocked, omitted by symmetry, and measured to check the symmetry."""

from dataclasses import dataclass

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcDirections, observed_directions
from goniotwin.app.campaign.geometry.directions import round_azimuth
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.planning.poses import sample_poses
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import incidence_deg, is_lit_from_behind, round_deg


@dataclass(frozen=True, eq=False)
class DirectionMap:
    """The directions of one incidence and arc: polar angle from the arc's own pole and azimuth from the light's, (n, 2) deg.

    `measured` ones are not `blocked` by the mirror unit. Those `omitted` are in the schedule's grids, and their values follow
    from its symmetry; `checks` are measured all the same to check that. `images`: what an isotropic sample has further on the
    other side of the plane of incidence.
    """

    sigma_deg: float
    back: bool
    transmitted: bool
    measured: Floats
    blocked: Floats
    omitted: Floats
    checks: Floats
    images: Floats


def direction_maps(plan: NewPlan) -> list[DirectionMap]:
    """The directions of a plan's samples by incidence and arc."""
    file, rig, poses = plan.schedule.file, plan.rig.file, plan.of_samples.poses
    without = file.model_copy(update={"symmetry": "anisotropic", "symmetry_check": None})
    every, checks = (
        {(each.sigma_deg, each.arc): each for each in observed_directions(file, rig, angles)}
        for angles in (sample_poses(without, rig).angles, poses.angles[poses.mirrored])
    )
    return [
        _map(
            each,
            every.get((each.sigma_deg, each.arc)),
            checks.get((each.sigma_deg, each.arc)),
            isotropic=file.symmetry == "isotropic",
        )
        for each in observed_directions(file, rig, poses.angles[~poses.mirrored])
    ]


def _map(found: ArcDirections, every: ArcDirections | None, checks: ArcDirections | None, *, isotropic: bool) -> DirectionMap:
    none = np.zeros((0, 2))
    blocked, grids = found.blocked_at_sample | found.blocked_at_etalon, none if every is None else every.angles_deg
    images = found.angles_deg[~blocked] * (1.0, -1.0) if isotropic else none
    images[:, 1] = round_azimuth(images[:, 1])
    return DirectionMap(
        incidence_deg(found.sigma_deg),
        is_lit_from_behind(found.sigma_deg),
        found.transmitted,
        found.angles_deg[~blocked],
        found.angles_deg[blocked],
        _without(grids, found.angles_deg),
        none if checks is None else _without(checks.angles_deg, found.angles_deg),
        _without(images, np.concatenate([grids, found.angles_deg])),
    )


def _without(angles: Floats, others: Floats) -> Floats:
    """The angles (n, 2) that are not among others."""
    known = set(map(tuple, round_deg(others).tolist()))
    return angles[[tuple(each) not in known for each in round_deg(angles).tolist()]]
