"""How much of an estimator's work is wanted."""

import math
from dataclasses import dataclass
from typing import Literal

from goniotwin.app.errors import UserError

Kind = Literal["fast", "forward"]
MOST_RAYS = 1 << 15
MOST_PATHS = 1 << 34


@dataclass(frozen=True)
class Effort:
    """How an estimator is to be run: with so many `rays` a detector, so many `paths`, or to an error in percent.

    The error is the median relative standard error of the ratios, over the directions that have at least a hundredth of
    the largest. Raises UserError for what does not belong to the estimator.
    """

    kind: Kind = "fast"
    rays: int | None = None
    paths: int | None = None
    error_percent: float | None = None
    seed: int = 1

    def __post_init__(self) -> None:
        """Checks."""
        if self.kind == "fast" and self.paths is not None:
            raise UserError("--paths: the fast estimator has rays; give --rays, or --estimator forward")
        if self.kind == "forward" and self.rays is not None:
            raise UserError("--rays: the forward estimator has paths; give --paths, or --estimator fast")
        given = [name for name in ("rays", "paths") if getattr(self, name) is not None]
        if given and self.error_percent is not None:
            raise UserError(f"--error and --{given[0]}: give one of them; the other follows from it")
        if self.rays is not None and not (8 <= self.rays <= MOST_RAYS and self.rays % 8 == 0):
            raise UserError(f"--rays: {self.rays} will not do; give a multiple of 8, from 8 to {MOST_RAYS}")
        if self.paths is not None and not 1000 <= self.paths <= MOST_PATHS:
            raise UserError(f"--paths: {self.paths} will not do; give 1000 to {MOST_PATHS}")
        if self.error_percent is not None and not (math.isfinite(self.error_percent) and self.error_percent > 0.0):
            raise UserError(f"--error: {self.error_percent:g} will not do; give a percentage above 0")
        if not 0 <= self.seed < 2**63:
            raise UserError(f"--seed: {self.seed} will not do; give a whole number from 0")
