"""Consistency checks of a campaign: the stated symmetry, and the agreement of photodiodes that measured the same direction."""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.overlaps import Overlaps, overlap_check
from goniotwin.app.campaign.reduction.points import PLACE, BsdfPoints
from goniotwin.app.campaign.reduction.reading_inputs import monitor_variance
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.studies.closure import ClosureReport
from goniotwin.app.campaign.studies.symmetry import SymmetryCheck, SymmetryResult


class ConsistencyChecks:
    """The checks of one sample; its points are added in blocks."""

    def __init__(self, reduction: Reduction, sample: str) -> None:
        settings, schedule = reduction.settings, reduction.schedule
        table = reduction.measurements.row_table(sample)
        self._overlaps = overlap_check(settings)
        self._symmetry: SymmetryCheck | None = None
        if schedule.symmetry_check is not None:
            mirrored = table[table["mirrored"]]
            poses = np.stack([mirrored[name] for name in PLACE[1:]], axis=1)
            angle = schedule.symmetry_check.angle_deg
            monitor = math.sqrt(monitor_variance(settings.rig))
            self._symmetry = SymmetryCheck(schedule.symmetry, poses, angle, common=settings.certificate.level, monitor=monitor)

    def add(self, points: BsdfPoints) -> None:
        """Take more points: whole pairs of opposite half planes."""
        self._overlaps.add(points)
        if self._symmetry is not None:
            self._symmetry.add(points)

    def overlaps(self) -> Overlaps:
        """The overlaps of all points that were added."""
        return self._overlaps.result()

    def symmetry(self) -> SymmetryResult | None:
        """The symmetry of all points that were added; None if the schedule does not ask for this check."""
        return None if self._symmetry is None else self._symmetry.result()


@dataclass(frozen=True)
class CheckResults:
    """The results of the checks by sample; the overlaps as they are before a calibration.

    `calibrated`: whether the values have been multiplied by the calibration factors. `findings` state what is wrong with the
    instrument, `closure` is that of the open beam, if the schedule has its scan. `trouble` is the reason why the checks cannot
    be evaluated, or empty.
    """

    symmetry: dict[str, SymmetryResult] = field(default_factory=dict)
    overlaps: dict[str, Overlaps] = field(default_factory=dict)
    trouble: str = ""
    calibrated: bool = False
    findings: tuple[str, ...] = ()
    closure: ClosureReport | None = None

    def add(self, name: str, checks: ConsistencyChecks) -> None:
        """Add the results of a sample, after all of its points."""
        self.overlaps[name] = checks.overlaps()
        if (symmetry := checks.symmetry()) is not None:
            self.symmetry[name] = symmetry

    def as_dict(self) -> dict[str, Any]:
        """The results for JSON."""
        return {
            "symmetry": self.symmetry,
            "overlaps": {name: result for name, result in self.overlaps.items() if result.pairs},
            "calibrated": self.calibrated,
            "findings": self.findings,
            **({} if self.closure is None else {"closure": self.closure}),
            "trouble": self.trouble,
            "told": self.lines,
        }

    @property
    def lines(self) -> list[str]:
        """The results as lines of text."""
        if self.trouble:
            return [f"the checks cannot be evaluated: {self.trouble}"]
        lines = [f"symmetry of {name}: {result}" for name, result in self.symmetry.items()]
        for name, result in self.overlaps.items():
            factors = result.factors
            lines += [f"overlaps of {name}: {result}"] if result.pairs else []
            if self.calibrated and factors.values:
                low, high = min(factors.values), max(factors.values)
                lines.append(f"overlaps of {name}: values have been multiplied by {low:.4f} to {high:.4f}")
            if listed := ", ".join(f"photodiode {k}: {factors.of(k):.4f}" for k in factors.significant):
                applied = "applied" if self.calibrated else "NOT applied, because overlap.calibrate is false"
                lines.append(f"overlaps of {name}: calibration factors beyond 4 u from 1 ({applied}): {listed}")
        return lines if self.closure is None else [*lines, f"closure: {self.closure.verdict}"]

    @property
    def alarms(self) -> list[str]:
        """The lines of the checks that have failed, and the findings."""
        alarms = [f"symmetry of {name}: {each}" for name, each in self.symmetry.items() if each.pairs and not each.holds]
        alarms += [f"overlaps of {name}: {each}" for name, each in self.overlaps.items() if not each.agree]
        return [*alarms, *self.findings]
