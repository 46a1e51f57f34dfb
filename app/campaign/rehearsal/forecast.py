"""The forecast from a rehearsal's journal: the predicted uncertainty of each direction, and the consistency checks.

The points are processed in blocks, which are not kept in memory.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.journal.block_sizes import DEFAULT_SIZES, BlockSizes
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.components import COVERAGE
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.schedule.file import TargetTable
from goniotwin.app.campaign.studies.checks import CheckResults, ConsistencyChecks
from goniotwin.app.campaign.studies.decades import (
    TargetInDecade,
    UncertaintyByDecade,
    UncertaintySummary,
    peak_shares,
    relative_uncertainty,
)
from goniotwin.app.campaign.studies.evaluation import Evaluation, evaluate_journal
from goniotwin.app.campaign.studies.reflectance import integration_settings
from goniotwin.app.campaign.studies.theory import deviations_in_u, true_bsdf
from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError, PointStream
from goniotwin.app.formats.registry import Holds, format_for
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Scatterer

POINT_COLUMNS = (
    "wavelength_nm",
    "sigma_deg",
    "gamma_deg",
    "beta_deg",
    "shift_deg",
    "photodiode",
    "zenith_deg",
    "azimuth_deg",
    "theta_deg",
    "phi_deg",
)
COMMENTS = (
    "in the order of sigma, gamma, wavelength and half planes",
    "relative_uncertainty: the predicted standard uncertainty over the value; empty where there is no value",
    "trusted: 0 where a direction is blocked by the mirror unit, or its value is flagged for another reason",
)


MOST_BELOW = 0.5
"""Share of the trusted values of a setting below the detection limit, above which the setting is named."""


@dataclass(frozen=True)
class MostlyBelow:
    """A setting in words with so many trusted `values`, more than half of which are `below` the detection limit."""

    setting: str
    values: int
    below: int


@dataclass(frozen=True)
class SpreadSummary(UncertaintySummary):
    """The relative uncertainties of a sample's values, its numbers of directions, and the distance from a known truth.

    `below_detection` is the number of trusted values below the detection limit, and `mostly_below` has the settings where most
    are. `largest` is the component with the largest mean `share` of u squared near the peak; empty without a value.
    `coverage` is the share of the trusted values within their 95 % interval of the truth, `worst_u` the largest deviation in u;
    NaN without a truth.
    """

    directions: int
    trusted: int
    below_detection: int
    mostly_below: list[MostlyBelow]
    largest: str
    share: float
    coverage: float
    worst_u: float


@dataclass
class UncertaintySpread:
    """Relative uncertainties of one sample, `known` by decade below the peak, and shares of u squared from `peak_share` on.

    `truth` is the sample's model, where there is one; `deviations` of the trusted values from it are in their u.
    """

    truth: Scatterer | None = None
    peak_share: float = TargetTable().above_peak_share
    tally: Tally = field(default_factory=Tally)
    known: UncertaintyByDecade = field(default_factory=UncertaintyByDecade)
    deviations: list[Floats] = field(default_factory=list)
    mostly_below: list[MostlyBelow] = field(default_factory=list)
    shares: dict[str, float] = field(default_factory=dict)

    def add(self, points: BsdfPoints) -> None:
        """Take more points."""
        self.tally.add(points)
        self.known.add(points)
        below = points.flag("under-range")
        for each in integration_settings(points):
            trusted = each.index[points.good[each.index]]
            if (lost := int(below[trusted].sum())) > MOST_BELOW * trusted.size:
                self.mostly_below.append(MostlyBelow(str(each), trusted.size, lost))
        near = points.where(points.good & ~below)
        near = near.where(peak_shares(near, near.bsdf) >= self.peak_share)
        squared = near.u_bsdf**2
        for name, variance in near.components.items():
            self.shares[name] = self.shares.get(name, 0.0) + float(np.sum(variance / squared))
        if self.truth is not None:
            good = points.where(points.good)
            self.deviations.append(deviations_in_u(good, true_bsdf(self.truth, good)))

    def summary(self) -> SpreadSummary:
        """The summary of all points that were added."""
        z = np.abs(np.concatenate(self.deviations)) if self.deviations else np.zeros(0)
        (largest, share), total = (
            max(self.shares.items(), key=lambda each: each[1], default=("", 0.0)),
            sum(self.shares.values()),
        )
        return SpreadSummary(
            **vars(self.known.summary()),
            directions=self.tally.directions,
            trusted=self.tally.good,
            below_detection=self.tally.under_range,
            mostly_below=self.mostly_below,
            largest=largest if total else "",
            share=share / total if total else 0.0,
            coverage=float(np.mean(z <= COVERAGE)) if z.size else math.nan,
            worst_u=float(np.max(z)) if z.size else math.nan,
        )


@dataclass(frozen=True)
class Forecast:
    """`spread` and `tallies` by sample; `trouble` is the reason why there are none.

    `unchecked` are, by the mounted sample, the photodiodes that its drift checks do not cover. `target` are the values of each
    sample against the schedule's `[target]`; empty without a target of u.
    """

    spread: dict[str, SpreadSummary]
    check_results: CheckResults
    trouble: str = ""
    tallies: dict[str, Tally] = field(default_factory=dict)
    unchecked: dict[str, tuple[int, ...]] = field(default_factory=dict)
    target: dict[str, list[TargetInDecade]] = field(default_factory=dict)


def forecast(
    path: Path,
    points: Path | None = None,
    about: Sequence[str] = (),
    sizes: BlockSizes = DEFAULT_SIZES,
    truth: Mapping[str, Scatterer] | None = None,
) -> Forecast:
    """The forecast from the journal `path`; each direction is written to the CSV `points`, with the comments `about`.

    `truth` are the models of the samples by name: the values are then compared with them.
    Raises UserError where the CSV cannot be written, or there are no points for it.
    """
    try:
        with Journal.open(path, sizes) as journal:
            found = forecast_of(evaluate_journal(journal), points, about, truth or {})
    except FormatError:
        raise
    except UserError as error:
        trouble = str(error).removeprefix(f"{path}: ")
        if points is not None:
            raise UserError(f"{points}: no sample has a value, so there is nothing to write: {trouble}") from None
        return Forecast({}, CheckResults(trouble=trouble), trouble)
    if points is not None and not found.spread:
        raise UserError(f"{points}: no sample has a value, so there is nothing to write")
    return found


def forecast_of(
    evaluation: Evaluation,
    points: Path | None = None,
    about: Sequence[str] = (),
    truth: Mapping[str, Scatterer] = MappingProxyType({}),
) -> Forecast:
    """The forecast from the evaluation of a journal that is open; see `forecast`. Raises UserError."""
    spreads: dict[str, UncertaintySpread] = {}
    reduction = evaluation.reduction
    closure = None if reduction.schedule.open_beam_scan is None else evaluation.closure
    results = CheckResults(calibrated=reduction.settings.calibrates, findings=tuple(evaluation.findings), closure=closure)
    parts = _parts(reduction, spreads, results, truth)
    first = next(parts, None)
    if points is None or first is None:
        for _ in parts:
            pass
    else:
        stream = PointStream([*about, *COMMENTS], itertools.chain([first], parts))
        format_for(points, {Holds.COLUMNS}).write(points, stream)
    tallies, target = {name: each.tally for name, each in spreads.items()}, reduction.schedule.target
    asked = {} if target is None or target.relative_u is None else {k: v.known.against(target) for k, v in spreads.items()}
    spread = {name: each.summary() for name, each in spreads.items()}
    return Forecast(spread, results, tallies=tallies, unchecked=reduction.unchecked(tallies), target=asked)


def _parts(
    reduction: Reduction,
    spreads: dict[str, UncertaintySpread],
    check_results: CheckResults,
    truth: Mapping[str, Scatterer],
) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """The columns of a CSV, block by block; fills `spreads` and `check_results`."""
    for name in reduction.schedule.samples:
        checks, overlaps = ConsistencyChecks(reduction, name), reduction.overlaps(name)
        for block in reduction.blocks(name):
            checks.add(block.points)
            points = reduction.finish(name, block.points, overlaps)
            if name not in spreads:
                target = reduction.schedule.target or TargetTable()
                spreads[name] = UncertaintySpread(truth.get(name), target.above_peak_share)
            spreads[name].add(points)
            columns: dict[str, npt.NDArray[Any]] = {"sample": np.full(points.bsdf.size, name)}
            columns |= {column: getattr(points, column) for column in POINT_COLUMNS}
            columns |= {"bsdf_per_sr": points.bsdf, "relative_uncertainty": relative_uncertainty(points)}
            yield columns | {"trusted": points.good}
        if name in spreads:
            check_results.add(name, checks)
