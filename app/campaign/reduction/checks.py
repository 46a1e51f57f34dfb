"""What a campaign says of itself: its symmetry, and photodiodes that saw the same, from a sample's points in any blocks."""

import math

import numpy as np

from goniotwin.app.campaign.reduction.overlaps import OverlapCheck, Overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.readings import PLACE, Listed
from goniotwin.app.campaign.reduction.symmetry import Symmetrical, SymmetryCheck
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.refinement import DEFAULT_ANGLE_UNCERTAINTY_DEG
from goniotwin.app.rig import RigFile


class Checks:
    """Of one sample, whose measurements are `listed`. `common` is the relative uncertainty that all its points share."""

    def __init__(self, schedule: ScheduleFile, rig: RigFile, listed: Listed, common: float) -> None:
        monitor = math.sqrt(2.0) * rig.monitor.relative_uncertainty
        self._overlaps = OverlapCheck(
            common, monitor, DEFAULT_ANGLE_UNCERTAINTY_DEG if schedule.overlap is None else schedule.overlap.angle_deg
        )
        self._symmetry: SymmetryCheck | None = None
        if schedule.symmetry_check is not None:
            mirrored = listed[listed["mirrored"]]
            poses = np.stack([mirrored[name] for name in PLACE[1:]], axis=1)
            angle = schedule.symmetry_check.angle_deg
            self._symmetry = SymmetryCheck(schedule.symmetry, poses, angle, common=common, monitor=monitor)

    def add(self, points: BsdfPoints) -> None:
        """Some more points, whole pairs of opposite half planes."""
        self._overlaps.add(points)
        if self._symmetry is not None:
            self._symmetry.add(points)

    def overlaps(self) -> Overlaps:
        """Of all that was added."""
        return self._overlaps.verdict()

    def symmetry(self) -> Symmetrical | None:
        """Of all that was added; None where the schedule asks for no such check."""
        return None if self._symmetry is None else self._symmetry.verdict()
