"""What a campaign says of itself: its symmetry, and photodiodes that saw the same, from a sample's points in any blocks."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.overlaps import OverlapCheck, Overlaps
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.readings import PLACE, RowTable
from goniotwin.app.campaign.reduction.symmetry import SymmetryCheck, SymmetryResult
from goniotwin.app.campaign.schedule.file import ScheduleFile
from goniotwin.app.campaign.schedule.refinement import DEFAULT_ANGLE_UNCERTAINTY_DEG
from goniotwin.app.rig import RigFile


class ConsistencyChecks:
    """Of one sample, whose measurements are `listed`. `common` is the relative uncertainty that all its points share."""

    def __init__(self, schedule: ScheduleFile, rig: RigFile, listed: RowTable, common: float) -> None:
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
        return self._overlaps.result()

    def symmetry(self) -> SymmetryResult | None:
        """Of all that was added; None where the schedule asks for no such check."""
        return None if self._symmetry is None else self._symmetry.result()


@dataclass(frozen=True)
class CheckResults:
    """By sample; the overlaps as they are before any calibration, and whether the values have been `calibrated` by them.
    `trouble` says why nothing can be said, where that is so.
    """

    symmetry: dict[str, SymmetryResult]
    overlaps: dict[str, Overlaps]
    trouble: str = ""
    calibrated: bool = False

    def add(self, name: str, checks: ConsistencyChecks) -> None:
        """What the checks of a sample have come to, which has been given all of its points."""
        self.overlaps[name] = checks.overlaps()
        if (symmetry := checks.symmetry()) is not None:
            self.symmetry[name] = symmetry

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {
            "symmetry": {name: found.as_dict() for name, found in self.symmetry.items()},
            "overlaps": {name: found.as_dict() for name, found in self.overlaps.items() if found.pairs},
            "calibrated": self.calibrated,
            "trouble": self.trouble,
            "told": self.lines,
        }

    @property
    def lines(self) -> list[str]:
        """For people."""
        told = [f"symmetry of {name}: {found}" for name, found in self.symmetry.items()]
        for name, found in self.overlaps.items():
            told += [f"overlaps of {name}: {found}"] if found.pairs else []
            if self.calibrated and (values := found.factors.values):
                told.append(f"overlaps of {name}: values have been multiplied by {min(values):.4f} to {max(values):.4f}")
            if listed := ", ".join(f"{k} by {found.factors.of(k):.4f}" for k in found.factors.significant):
                done = "beyond 4 u" if self.calibrated else "to be multiplied (overlap.calibrate is false, so they are not)"
                told.append(f"overlaps of {name}: values {done}: of photodiode {listed}")
        return told if not self.trouble else [f"the checks cannot be evaluated: {self.trouble}"]

    @property
    def alarms(self) -> list[str]:
        """Those of the lines that say that something is not as it was stated."""
        told = [f"symmetry of {name}: {found}" for name, found in self.symmetry.items() if found.pairs and not found.holds]
        return told + [f"overlaps of {name}: {found}" for name, found in self.overlaps.items() if not found.agree]
