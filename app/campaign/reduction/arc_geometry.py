"""What the arcs of a rig see in a pose, and what the errors of angles do there."""

from collections import defaultdict
from collections.abc import Iterator, Sequence

import numpy as np

from goniotwin.app.campaign.geometry.arcs import ArcView, polar_deg, views_at_sigma
from goniotwin.app.campaign.geometry.directions import ARCS, Arc, PoseAngles
from goniotwin.app.campaign.geometry.shadow import blocked_by_mirrors
from goniotwin.app.campaign.measurement_model.lit_share import RigLaw, height_effects, height_inputs
from goniotwin.app.campaign.measurement_model.pose import (
    POSITIONS,
    Displacement,
    Views,
    lifted_inputs,
    moments,
    mounting_inputs,
    pose_effects,
    position_u_deg,
    rig_inputs,
    standard_uncertainties,
)
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.plant.disturbances import ETALON, SAMPLE

MOST_POSES = 4096
"""Poses whose geometry is kept: some 10 MB."""


class ArcGeometry:
    """What the arcs of a rig see in a pose; kept for some thousand poses, because every wavelength has the same ones."""

    def __init__(self, rig: RigFile) -> None:
        self._rig = rig
        self._kept: dict[PoseAngles, list[tuple[ArcView, Flags]]] = {}
        self._sums: dict[PoseAngles, Floats] = {}

    def views(self, pose: PoseAngles) -> list[tuple[ArcView, Flags]]:
        """The views of the arcs, with the photodiodes whose light the mirror unit blocks at the sample or at the etalon."""
        return self.views_at([pose])[0]

    def views_at(self, poses: Sequence[PoseAngles]) -> list[list[tuple[ArcView, Flags]]]:
        """The same at many poses, which together take a tenth of the time."""
        missing = [pose for pose in dict.fromkeys(poses) if pose not in self._kept]
        if missing and len(self._kept) + len(missing) > MOST_POSES:
            self._kept.clear()
            missing = list(dict.fromkeys(poses))
        alike: dict[tuple[float, float], list[PoseAngles]] = defaultdict(list)
        for pose in missing:
            alike[pose[0], pose[1]].append(pose)
        for same in alike.values():
            self._kept.update((pose, []) for pose in same)
            for arc in ARCS:
                if polar_deg(self._rig, arc):
                    for pose, view, blocked in self._views_of(same, arc):
                        self._kept[pose].append((view, blocked))
        return [self._kept[pose] for pose in poses]

    def _views_of(self, poses: Sequence[PoseAngles], arc: Arc) -> Iterator[tuple[PoseAngles, ArcView, Flags]]:
        """The views of an arc at poses of one gamma and sigma, and what is blocked."""
        gamma, sigma, *_ = poses[0]
        views = views_at_sigma(
            self._rig, sigma, np.array([pose[2] for pose in poses]), np.array([pose[3] for pose in poses]), arc
        )
        zenith, azimuth = (np.stack([getattr(view, name) for view in views]) for name in ("zenith", "azimuth"))
        # For transmitted light the mirror unit has another position at the etalon, and blocks other directions there.
        sigmas = {sigma, views[0].etalon_pose(poses[0])[1]}
        blocked = np.any([blocked_by_mirrors(self._rig, at, zenith, azimuth, gamma) for at in sigmas], axis=0)
        return zip(poses, views, blocked, strict=True)

    def pose_sums(self, poses: Sequence[PoseAngles]) -> Floats:
        """What the variances by the errors of angles need at poses, whatever the slopes: (poses, photodiodes, 2, 6).

        Of the dense inputs, and of the axes' positions: see `moments`. NaN for photodiodes without an arc.
        """
        missing = [pose for pose in dict.fromkeys(poses) if pose not in self._sums]
        if len(self._sums) + len(missing) > MOST_POSES:
            self._sums.clear()
            missing = list(dict.fromkeys(poses))
        if missing:
            seen = enumerate(zip(missing, self.views_at(missing), strict=True))
            views = [(k, pose, view) for k, (pose, arcs) in seen for view, _ in arcs]
            sums = np.full((len(missing), self._rig.photodiodes.count, 2, 6), np.nan)
            at = np.concatenate([np.full(view.channels.size, k) for k, _, view in views])
            sums[at, np.concatenate([view.channels for _, _, view in views])] = _pose_moments(self._rig, views_of_arcs(views))
            self._sums.update(zip(missing, sums, strict=True))
        return np.stack([self._sums[pose] for pose in poses])


def views_of_arcs(views: Sequence[tuple[int, PoseAngles, ArcView]]) -> Views:
    """The directions of all photodiodes of views, one after the other."""
    each = [view.channels.size for _, _, view in views]
    beta = np.repeat([pose[2] for _, pose, _ in views], each)
    azimuth = np.concatenate([view.azimuth for _, _, view in views])
    return Views(
        sigma_deg=np.repeat([pose[1] for _, pose, _ in views], each),
        gamma_deg=np.repeat([pose[0] for _, pose, _ in views], each),
        polar=np.radians(np.concatenate([view.polar for _, _, view in views])),
        azimuth=np.radians(azimuth),
        lower=np.repeat([view.transmitted != view.back for _, _, view in views], each),
        transmitted=np.repeat([view.transmitted for _, _, view in views], each),
        reverse=np.cos(np.radians(azimuth - beta)) < 0.0,
    )


def _pose_moments(rig: RigFile, views: Views) -> Floats:
    """What the variances need at `views`, (n, 2, 6): of the dense inputs of pose, and of the axes' positions."""
    table, effects = rig.uncertainty, pose_effects(nominal_instrument(rig), views)
    dense = [(effects.common, standard_uncertainties(rig_inputs(table)))]
    by_image = height_effects(RigLaw.of(rig), views)
    for kind, own in ((SAMPLE, effects.sample), (ETALON, effects.etalon)):
        none = np.zeros_like(by_image[kind])
        parts = (
            (own, mounting_inputs),
            (effects.lifted, lifted_inputs),
            (Displacement(none, none, by_image[kind]), height_inputs),
        )
        dense += [(part, standard_uncertainties(inputs(table, kind, ""))) for part, inputs in parts]
    position = np.full(len(POSITIONS), position_u_deg(table))
    return np.stack([moments(*dense), moments((effects.position, position), (effects.etalon_position, position))], axis=1)
