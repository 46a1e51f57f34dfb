"""Totals of a proof over its rigs: coverage by cell with its standard error over rigs, fits, and reflectances.

Values of one rig share its errors, so that in cells that are dominated by them a rig is worth few independent values. All
standard errors are therefore those of the scatter over rigs.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any

import numpy as np

from goniotwin.app.campaign.proof.judgement import BOUND, FAR_U, SIDES, STEEP, Cell, RigResult, table_of
from goniotwin.arrays import Floats, Ints

FAR_PROBABILITY = math.erfc(FAR_U / math.sqrt(2.0))
JUDGED_VALUES = 100
"""Values that a cell needs in all to be the worst one."""
LIMIT_99, TAIL = 2.5758, 0.005
"""The deviate beyond which, on either side of a normal law, is this part."""
QUANTILES = 1000
"""Of a law, in place of the law."""
TABLES = ("decade", *SIDES, "zenith", "sigma", "wavelength", "sample", "sample and decade", "slope")
UNKNOWN_TABLES = tuple(table_of(side, kind) for kind in (BOUND, STEEP) for side in SIDES)
"""Of values whose u is for the most part a limit, or whose slope the directions do not resolve."""


@dataclass(frozen=True)
class CellTotal:
    """A cell over all rigs: coverage and mean deviation with their standard errors over rigs, chi2/n of what a fit leaves.

    `rigs` and `structures` that have values in it; `u_over_scatter` is the median over the structures of u over the scatter: 1
    over the root mean square of z. A standard error is NaN with one rig; chi2/n is NaN where nothing was fitted.
    """

    label: str
    values: int
    coverage: float
    u_coverage: float
    mean: float
    u_mean: float
    chi_square: float
    beyond: int
    rigs: int = 0
    structures: int = 0
    u_over_scatter: float = math.nan

    @property
    def expected_beyond(self) -> float:
        """Values beyond 5 u that a normal law gives."""
        return self.values * FAR_PROBABILITY

    def as_dict(self) -> dict[str, Any]:
        """The cell for JSON."""
        return {
            "label": self.label,
            "values": self.values,
            "coverage_percent": 100.0 * self.coverage,
            "standard_error_percent": 100.0 * self.u_coverage,
            "mean_z": self.mean,
            "standard_error_z": self.u_mean,
            "chi2_independent": self.chi_square,
            "beyond_5u": self.beyond,
            "expected_beyond_5u": self.expected_beyond,
            "rigs": self.rigs,
            "structures": self.structures,
            "u_over_scatter": self.u_over_scatter,
        }


@dataclass(frozen=True)
class ReflectanceTotal:
    """A reflectance over all rigs: chi2/n of its deviates, the limits of 99 %, and u over the scatter over rigs.

    `beyond` is the number of rigs whose deviate is beyond 2.58. `limited` is the share in u^2 (the median over rigs) of
    what the directions do not resolve: all rigs measure the same sample there, so it is drawn once, and the limits are wider.
    """

    label: str
    rigs: int
    chi_square: float
    limits: tuple[float, float]
    u_over_scatter: float
    beyond: int = 0
    limited: float = 0.0

    @property
    def outside(self) -> bool:
        """Whether chi2/n is outside the limits."""
        low, high = self.limits
        return not low <= self.chi_square <= high

    def as_dict(self) -> dict[str, Any]:
        """The reflectance for JSON."""
        return {
            "label": self.label,
            "rigs": self.rigs,
            "chi2": self.chi_square,
            "limits_99": list(self.limits),
            "u_over_scatter": self.u_over_scatter,
            "beyond_99": self.beyond,
            "limited": self.limited,
        }


class Totals:
    """The totals of a proof. Results of rigs that failed count only in `failed`; `structures` are their numbers, by seed."""

    def __init__(self, results: Sequence[RigResult], structures: Mapping[int, int] | None = None) -> None:
        done = [each for each in results if not each.failed]
        of_structure = np.array([0 if structures is None else structures[each.seed] for each in done], dtype=int)
        self.rigs = len(done)
        self.failed = {each.seed: each.failed for each in results if each.failed}
        labels: dict[str, dict[str, None]] = {}
        for each in done:
            for table, cells in each.cells.items():
                labels.setdefault(table, {}).update(dict.fromkeys(cells))
        self.tables = {
            table: [
                _cell_total(label, [each.cells.get(table, {}).get(label, Cell()) for each in done], of_structure)
                for label in _in_order(found)
            ]
            for table, found in labels.items()
        }
        self.inputs = _input_totals(done)
        self.angles = _angle_totals(done)
        self.reflectances = _reflectance_totals(done)
        self.far = {each.seed: each.far for each in done if each.far}

    @property
    def whole(self) -> CellTotal | None:
        """All values; None where there are none."""
        found = self.tables.get("all", [])
        return found[0] if found else None

    @property
    def worst(self) -> tuple[str, CellTotal] | None:
        """The cell with the least coverage, of those with enough values and without the steep ones; after its table's name."""
        judged = [(table, each) for table in TABLES for each in self.tables.get(table, []) if each.values >= JUDGED_VALUES]
        return min((each for each in judged if each[1].label != STEEP), key=lambda each: each[1].coverage, default=None)

    @property
    def variance_shared(self) -> float:
        """Variance of all fitted inputs over their u, over its expectation; NaN where nothing was fitted."""
        squares, expected = np.sum([each[:2] for each in self.inputs.values()], axis=0) if self.inputs else (0.0, 0.0)
        return float(squares / expected) if expected > 0.0 else math.nan

    def as_dict(self) -> dict[str, Any]:
        """The totals for JSON."""
        whole, worst = self.whole, self.worst
        return {
            "simulated": True,
            "rigs": self.rigs,
            "points": whole.values if whole else 0,
            "coverage_percent": 100.0 * whole.coverage if whole else None,
            "standard_error_percent": 100.0 * whole.u_coverage if whole else None,
            "chi2_independent": whole.chi_square if whole else None,
            "variance_shared": self.variance_shared,
            "mean_z": whole.mean if whole else None,
            "worst_cell_percent": 100.0 * worst[1].coverage if worst else None,
            "worst_cell": f"{worst[0]}: {worst[1].label}" if worst else None,
            "beyond_5u": whole.beyond if whole else 0,
            "expected_beyond_5u": whole.expected_beyond if whole else 0.0,
            "tables": self.tables,
            "inputs": {
                kind: {"variance_over_u2": square / expected, "determined": expected / count}
                for kind, (square, expected, count) in self.inputs.items()
                if expected > 0.0
            },
            "angles": {
                name: {"correlation": correlation, "rms_difference_deg": difference}
                for name, (correlation, difference) in self.angles.items()
            },
            "reflectances": self.reflectances,
            "far": self.far,
            "failed": self.failed,
        }


def _in_order(labels: dict[str, None]) -> list[str]:
    """Labels by their first number, then as text; decades from the peak down."""

    def key(label: str) -> tuple[float, str]:
        first = label.split()[0]
        try:
            number = float(first)
        except ValueError:
            return (math.inf, label)
        return (-math.log10(number) if "e" in first else number, label)

    return sorted(labels, key=key)


def _cell_total(label: str, cells: list[Cell], structure: Ints) -> CellTotal:
    values, covered, deviation, square, beyond = (
        np.array([getattr(each, name) for each in cells], dtype=float)
        for name in ("values", "covered", "deviation", "square", "beyond")
    )
    n = max(float(values.sum()), 1.0)
    coverage, mean = float(covered.sum()) / n, float(deviation.sum()) / n
    freedom = math.fsum(each.freedom for each in cells)
    _, which = np.unique(structure, return_inverse=True)
    counts, squares = (np.bincount(which, weights=each) for each in (values, square))
    known = (counts > 0.0) & (squares > 0.0)
    return CellTotal(
        label,
        int(values.sum()),
        coverage,
        _ratio_error(covered, values, coverage),
        mean,
        _ratio_error(deviation, values, mean),
        math.fsum(each.chi_square for each in cells) / freedom if freedom > 0.0 else math.nan,
        int(beyond.sum()),
        int(np.sum(values > 0.0)),
        int(np.sum(counts > 0.0)),
        float(np.median(np.sqrt(counts[known] / squares[known]))) if known.any() else math.nan,
    )


def _ratio_error(part: Floats, whole: Floats, ratio: float) -> float:
    """Standard error of sum(part) / sum(whole) by the scatter over rigs."""
    rigs = whole.size
    if rigs < 2 or not whole.any():
        return math.nan
    return math.sqrt(float(np.sum((part - ratio * whole) ** 2)) * rigs / (rigs - 1)) / float(whole.sum())


def _input_totals(results: Sequence[RigResult]) -> dict[str, tuple[float, float, int]]:
    """By kind of input: sums of (fitted / u)^2, of their expectations, and the number of rigs."""
    totals: dict[str, tuple[float, float, int]] = {}
    for each in results:
        for kind, (square, expected) in each.inputs.items():
            before = totals.get(kind, (0.0, 0.0, 0))
            totals[kind] = (before[0] + square, before[1] + expected, before[2] + 1)
    return dict(sorted(totals.items()))


def _angle_totals(results: Sequence[RigResult]) -> dict[str, tuple[float, float]]:
    """By sample: correlation of the drawn and the fitted angle in the plane of incidence, and the rms difference, deg."""
    names = dict.fromkeys(name for each in results for name in each.angles)
    totals = {}
    for name in names:
        drawn, fitted = np.array([each.angles[name] for each in results if name in each.angles]).T
        spread = drawn.size > 2 and np.std(drawn) > 0.0 and np.std(fitted) > 0.0
        correlation = float(np.corrcoef(drawn, fitted)[0, 1]) if spread else math.nan
        totals[name] = (correlation, float(np.sqrt(np.mean((drawn - fitted) ** 2))))
    return totals


def _reflectance_totals(results: Sequence[RigResult]) -> list[ReflectanceTotal]:
    totals = []
    for label in sorted(dict.fromkeys(name for each in results for name in each.reflectances)):
        deviation, u, z, limited = np.array([each.reflectances[label] for each in results if label in each.reflectances]).T
        rigs = deviation.size
        scatter = float(np.std(deviation, ddof=1)) if rigs > 1 else math.nan
        over = float(np.sqrt(np.mean(u**2))) / scatter if scatter else math.nan
        beyond = int(np.sum(np.abs(z) > LIMIT_99))
        share = float(np.median(limited))
        limits = mean_square_limits(rigs, share)
        totals.append(ReflectanceTotal(label, rigs, float(np.mean(z**2)), limits, over, beyond, share))
    return totals


def mean_square_limits(count: int, shared: float) -> tuple[float, float]:
    """The limits of 99 % of the mean square of `count` normal deviates that have a `shared` part of their variance in common.

    It is that of their mean, of the variance shared + (1 - shared) / count, and of the rest, chi-square of count - 1.
    """
    deviate = np.array([NormalDist().inv_cdf((k + 0.5) / QUANTILES) for k in range(QUANTILES)])
    alone = (1.0 - shared) / count
    of_mean = (shared + alone) * deviate**2
    rest = alone * chi_square_quantile(count - 1, deviate) if count > 1 else np.zeros(1)
    low, high = np.quantile(np.add.outer(of_mean, rest), [TAIL, 1.0 - TAIL])
    return float(low), float(high)


def chi_square_quantile(freedom: int, deviate: Floats | float) -> Floats:
    """The quantiles of chi-square whose normal deviates are given, by the cube root of Wilson and Hilferty."""
    variance = 2.0 / (9.0 * freedom)
    return np.asarray(freedom * np.maximum(1.0 - variance + deviate * math.sqrt(variance), 0.0) ** 3)
