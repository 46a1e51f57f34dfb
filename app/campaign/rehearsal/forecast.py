"""What a rehearsal's journal foretells: the uncertainty of each direction, and the checks. In blocks that are not kept."""

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.checks import Verdicts
from goniotwin.app.campaign.reduction.points import BsdfPoints, Tally
from goniotwin.app.campaign.reduction.reduction import ROWS_AT_ONCE, Reduction
from goniotwin.app.errors import UserError
from goniotwin.app.formats import FormatError, write_points_csv
from goniotwin.arrays import Floats

PERCENTILES = (5, 50, 95)
WELL_KNOWN = 0.1
OF_POINTS = (
    "wavelength_nm", "sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "photodiode", "zenith_deg", "azimuth_deg", "theta_deg",
    "phi_deg",
)  # fmt: skip
ABOUT = (
    "in the order of wavelength, sigma, gamma and half planes",
    "relative_uncertainty: the standard uncertainty foretold for a value, over the value; nothing where there is no value",
    "trusted: 0 where a direction is hidden, or its value otherwise not to be trusted",
)


@dataclass
class Spread:
    """Of one sample: how many directions there are, how many may be trusted, and the relative uncertainties of those of them
    that have a value above zero.
    """

    directions: int = 0
    trusted: int = 0
    known: list[Floats] = field(default_factory=list)

    def add(self, points: BsdfPoints) -> None:
        """Some more points."""
        good = points.good
        found = relative(points)[good]
        self.directions += int(points.bsdf.size)
        self.trusted += int(good.sum())
        self.known.append(found[np.isfinite(found)])

    def as_dict(self) -> dict[str, Any]:
        """Percentiles, and how many are known to a tenth of their value."""
        known = np.concatenate(self.known)
        found = np.percentile(known, PERCENTILES).tolist() if known.size else [None] * len(PERCENTILES)
        return {
            **{f"p{each:02d}": value for each, value in zip(PERCENTILES, found, strict=True)},
            "directions": self.directions,
            "trusted": self.trusted,
            "above_zero": int(known.size),
            "to_a_tenth": int(np.sum(known <= WELL_KNOWN)),
        }


@dataclass(frozen=True)
class Forecast:
    """`spread` and `tallies` by sample; `trouble` says why there are none. `unwatched` are photodiodes, by what was mounted, of
    which drift checks could tell nothing.
    """

    spread: dict[str, dict[str, Any]]
    verdicts: Verdicts
    trouble: str = ""
    tallies: dict[str, Tally] = field(default_factory=dict)
    unwatched: dict[str, tuple[int, ...]] = field(default_factory=dict)


def forecast(path: Path, points: Path | None = None, about: Sequence[str] = (), rows_at_once: int = ROWS_AT_ONCE) -> Forecast:
    """Of a journal; each direction is written to the CSV `points`, with the comments `about`. Raises UserError where that
    cannot be, or has nothing in it.
    """
    spreads: dict[str, Spread] = {}
    try:
        with Journal.open(path) as journal:
            reduction = Reduction(journal)
            verdicts = Verdicts({}, {}, calibrated=reduction.calibrates)
            parts = _parts(reduction, spreads, verdicts, rows_at_once)
            first = next(parts, None)
            if points is None or first is None:
                for _ in parts:
                    pass
            else:
                write_points_csv(points, [*about, *ABOUT], itertools.chain([first], parts))
            unwatched = reduction.unwatched()
    except FormatError as error:
        raise UserError(str(error)) from None
    except UserError as error:
        trouble = str(error).removeprefix(f"{path}: ")
        if points is not None:
            raise UserError(f"{points}: no sample has come to a value, so there is nothing to write: {trouble}") from None
        return Forecast({}, Verdicts({}, {}, trouble), trouble)
    if points is not None and not spreads:
        raise UserError(f"{points}: no sample has come to a value, so there is nothing to write")
    spread = {name: spread.as_dict() for name, spread in spreads.items()}
    return Forecast(spread, verdicts, tallies=reduction.tallies, unwatched=unwatched)


def relative(points: BsdfPoints) -> Floats:
    """Relative standard uncertainties; NaN where there is no value above zero."""
    value = np.where(points.bsdf > 0.0, points.bsdf, np.nan)
    found: Floats = points.u_bsdf / value
    return found


def _parts(
    reduction: Reduction, spreads: dict[str, Spread], verdicts: Verdicts, rows_at_once: int
) -> Iterator[dict[str, npt.NDArray[Any]]]:
    """The columns of a CSV, block by block; fills `spreads` and `verdicts`."""
    for name in reduction.schedule.samples:
        checks, overlaps = reduction.checks(name), reduction.overlaps(name, rows_at_once)
        for block in reduction.blocks(name, rows_at_once):
            checks.add(block.points)
            found = reduction.finished(block.points, overlaps)
            spreads.setdefault(name, Spread()).add(found)
            columns: dict[str, npt.NDArray[Any]] = {"sample": np.full(found.bsdf.size, name)}
            columns |= {column: getattr(found, column) for column in OF_POINTS}
            yield columns | {"bsdf_per_sr": found.bsdf, "relative_uncertainty": relative(found), "trusted": found.good}
        if name in spreads:
            verdicts.add(name, checks)
