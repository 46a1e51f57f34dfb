"""What a campaign's checks of itself have come to, for whoever has just measured it: symmetry, and overlapping photodiodes."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.checks import Checks
from goniotwin.app.campaign.reduction.overlaps import Overlaps
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.symmetry import Symmetrical
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.errors import UserError


@dataclass(frozen=True)
class Verdicts:
    """By sample; the overlaps as they are before any calibration, and whether the values have been `calibrated` by them.
    `trouble` says why nothing can be said, where that is so.
    """

    symmetry: dict[str, Symmetrical]
    overlaps: dict[str, Overlaps]
    trouble: str = ""
    calibrated: bool = False

    def add(self, name: str, checks: Checks) -> None:
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
    def alarming(self) -> list[str]:
        """Those of the lines that say that something is not as it was stated."""
        told = [f"symmetry of {name}: {found}" for name, found in self.symmetry.items() if found.pairs and not found.holds]
        return told + [f"overlaps of {name}: {found}" for name, found in self.overlaps.items() if not found.agree]


def checked_in(path: Path) -> Verdicts | None:
    """Of a journal, as far as it goes; None where its schedule asks for no such check."""
    try:
        with Journal.open(path) as journal:
            file = parse_schedule(journal.value("schedule"), f"{path} (schedule)").file
            if file.symmetry_check is None and file.overlap is None:
                return None
            reduction = Reduction(journal)
            found = Verdicts({}, {}, calibrated=reduction.calibrates)
            for name in file.samples:
                checks = reduction.checks(name)
                for block in reduction.blocks(name):
                    checks.add(block.points)
                found.add(name, checks)
            return found
    except UserError as error:
        return Verdicts({}, {}, str(error).removeprefix(f"{path}: "))
