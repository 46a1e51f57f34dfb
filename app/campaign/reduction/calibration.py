"""The calibration of photodiodes against each other, by the directions that several of them measured."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from goniotwin.app.campaign.reduction.points import BsdfPoints

CERTAIN = 4.0
"""A factor is significant if it differs from 1 by so many standard uncertainties."""


@dataclass(frozen=True)
class CalibrationFactors:
    """Factors for the values of the `photodiodes`, each with its standard uncertainty, from so many `pairs`.

    `unconnected` are photodiodes with values that no overlap connects with another: their factor is 1. `widening` is the factor
    by which the scatter of the residuals has widened the uncertainties.
    """

    photodiodes: tuple[int, ...]
    values: tuple[float, ...]
    uncertainties: tuple[float, ...]
    unconnected: tuple[int, ...]
    pairs: int
    widening: float

    @property
    def significant(self) -> list[int]:
        """Photodiodes whose factor differs from 1 by more than four standard uncertainties."""
        factors = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        return [k for k, value, u in factors if abs(value - 1.0) > CERTAIN * u]

    def of(self, photodiode: int) -> float:
        """The factor of a photodiode; 1 if it has none."""
        return dict(zip(self.photodiodes, self.values, strict=True)).get(photodiode, 1.0)

    def sentences(self, applied: bool) -> Iterator[str]:
        """The factors as text; `applied`: whether the values have been multiplied by them."""
        if not self.photodiodes:
            yield "no overlap is known well enough to calibrate photodiodes against each other; all factors are 1"
            return
        state = "applied to the values" if applied else "not applied, as [overlap] calibrate is false"
        factors = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        listed = ", ".join(f"{k}: {value:.5f} (u {u:.5f})" for k, value, u in factors)
        yield f"{self.pairs} overlaps calibrate photodiodes against each other. Factors by photodiode, {state}: {listed}"
        if self.significant:
            yield f"beyond {CERTAIN:.0f} u from 1: photodiodes {', '.join(str(k) for k in self.significant)}"
        if self.unconnected:
            yield f"not connected by overlaps, factor 1: photodiodes {', '.join(str(k) for k in self.unconnected)}"

    def apply(self, points: BsdfPoints, first: int) -> BsdfPoints:
        """Multiply the points by the factors, and add the component `calibration` of their uncertainty.

        `first` is the number of the input of photodiode 0.
        """
        factor, u = np.ones(points.bsdf.size), np.zeros(points.bsdf.size)
        for k, value, uncertainty in zip(self.photodiodes, self.values, self.uncertainties, strict=True):
            of_photodiode = points.photodiode == k
            factor[of_photodiode], u[of_photodiode] = value, uncertainty
        scaled = points.scaled(factor)
        member = (points.photodiode + first).astype(np.int32)[:, None]
        return scaled.with_quantity(scaled.quantity.with_grouped("calibration", member, (points.bsdf * u)[:, None]))

    def as_dict(self) -> dict[str, Any]:
        """The factors for JSON, by the photodiodes' numbers."""
        factors = zip(self.photodiodes, self.values, self.uncertainties, strict=True)
        each = {str(k): {"factor": value, "u": u} for k, value, u in factors}
        return {"factors": each, "unconnected": list(self.unconnected), "pairs": self.pairs, "significant": self.significant}
