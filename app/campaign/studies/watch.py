"""The watch: a misalignment that begins in the middle of a run, found in the residuals of a narrow lobe and named.

What the values are beside the prediction is compared with what each misalignment would do to them from some row on: the
sensitivities and the covariance of the alignment, by generalised least squares. All that is stated is in that covariance:
constant misalignments by their uncertainties (or by the alignment that the rig file names), the positions of the axes, the
lobe's form. The light may change at the same row: its scale is free. So only what moves the lobe counts, and only as far as
nothing that is stated explains it.

The largest of the statistics, each standard normal without a misalignment, is compared with the quantile for a stated share
of false alarms over a whole campaign, by the number of tests (Bonferroni): of patterns, of rows at which one may begin, and
of looks at a campaign in progress.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from statistics import NormalDist
from typing import Any

import numpy as np

from goniotwin.app.campaign.measurement_model.fit import ValuesCovariance
from goniotwin.app.campaign.measurement_model.pose import LIGHT, MOUNTED, VIEW
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.studies.alignment import TERMS, LobeFit, PoseSensitivities, Step, fit_lobe
from goniotwin.app.campaign.studies.evaluation import Evaluation
from goniotwin.app.campaign.studies.sample_alignment import light_seen, sample_lobe
from goniotwin.app.campaign.wording import concise
from goniotwin.app.rig import RigFile, nominal_instrument
from goniotwin.app.rig.alignment import DOUBTED_CHI_SQUARE, REFUSED_CHI_SQUARE
from goniotwin.arrays import Flags, Floats, Ints

FALSE_ALARMS = 0.01
"""Share of the campaigns without a misalignment in which the watch names one, at most."""
LOOKS = 32
"""Looks at a campaign in progress, at most."""
PLACES = 32
"""Rows at which a misalignment may begin, for the test; after an alarm each row is compared."""
LEAST_ROWS = 8
"""Rows of a sample before the first look."""
ROWS_WITHIN = 4.0
"""Rows whose squared statistic is so near to the largest one may be that of the beginning."""
POSSIBLE = 0.7
"""Patterns whose largest statistic by places is above this share of the largest of all are compared row by row."""
ALIKE = 9.0
"""Patterns whose largest squared statistic is so near to the largest of all are named too."""


LEAST_LEFT = 1e-6
"""Share of the information about a pattern that has to be left beside a change of the light."""


@dataclass(frozen=True)
class Pattern:
    """What a misalignment does: `words` name it, `causes` what it can come from; `unit` is that of its size.

    It acts as the `input` of the rig, or of the sample's mounting where `mounting` is set.
    """

    input: str
    words: str
    causes: str
    unit: str = "deg"
    mounting: bool = False


PATTERNS = (
    Pattern(
        "sigma_zero",
        "light against arc in the plane of incidence",
        "sigma's zero, a mirror or the arc: the open beam distinguishes them",
    ),
    Pattern("mirror_2_tilt_x", "light across the plane of incidence", "a mirror or the beam"),
    Pattern("arc_tilt_x", "arc about x", "the arc"),
    Pattern("beta_zero", "arc about the normal", "beta's zero or the arc"),
    Pattern("shift_zero", "photodiodes along the arc", "the zero of the shift, or the photodiodes' angles"),
    Pattern("illumination_shift_x", "exit pupil along x", "the illumination unit", "mm"),
    Pattern("illumination_shift_z", "exit pupil along z", "the illumination unit", "mm"),
    Pattern("tilt_x", "tilt of the sample about its x", "the sample's mounting", mounting=True),
    Pattern("tilt_y", "tilt of the sample about its y", "the sample's mounting", mounting=True),
)
"""The misalignments that are distinguished: those of mirrors, arc and zeros that do the same to a lobe are one."""


@dataclass(frozen=True)
class Misalignment:
    """A misalignment of `size` with the standard uncertainty `u`, in the unit of the pattern, since `row`.

    The beginning is between the rows `earliest` and `latest`, with some 95 %. `always`: it is that of all rows of the sample.
    `statistic` is compared with `limit`. `alike` are patterns that explain the residuals nearly as well. `chi_square` is that
    of the residuals beside it, per degree of freedom: where it is that of no displaced lobe, there is nothing to watch.
    """

    sample: str
    pattern: Pattern
    size: float
    u: float
    row: int
    earliest: int
    latest: int
    always: bool
    statistic: float
    limit: float
    alike: tuple[Pattern, ...]
    chi_square: float

    @property
    def text(self) -> str:
        """The misalignment in plain words."""
        rows = f" ({self.earliest} to {self.latest})" if self.latest > self.earliest else ""
        since = f"in all rows of {self.sample}" if self.always else f"since row {self.row}{rows}"
        alike = "".join(f"; or {each.words}: {each.causes}" for each in self.alike)
        size = f"{concise(abs(self.size), self.u)} {self.pattern.unit}"
        return f"{self.pattern.words}: off by {size} {since}; {self.pattern.causes}{alike}"

    def as_dict(self) -> dict[str, Any]:
        """The misalignment for JSON."""
        return {
            "sample": self.sample,
            "pattern": self.pattern.words,
            "causes": self.pattern.causes,
            "size": self.size,
            "u": self.u,
            "unit": self.pattern.unit,
            "row": self.row,
            "rows": [self.earliest, self.latest],
            "all_rows": self.always,
            "statistic": self.statistic,
            "limit": self.limit,
            "chi2": self.chi_square,
            "alike": [each.words for each in self.alike],
            "text": self.text,
        }


@dataclass(frozen=True)
class WatchResult:
    """What the watch has found, at most one misalignment of a sample; `simulated`: of a virtual rig.

    `clear` are samples whose residuals show none, `without` those without a lobe that could be watched, so far.
    """

    misalignments: tuple[Misalignment, ...]
    clear: tuple[str, ...]
    without: tuple[str, ...]
    simulated: bool

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        return {
            "simulated": self.simulated,
            "misalignments": self.misalignments,
            "clear": list(self.clear),
            "without_lobe": list(self.without),
            "false_alarms": FALSE_ALARMS,
        }


def alarm_limit(samples: int) -> float:
    """The statistic beyond which a misalignment is named, with so many samples that are watched."""
    tests = len(PATTERNS) * PLACES * LOOKS * samples
    return NormalDist().inv_cdf(1.0 - 0.5 * FALSE_ALARMS / tests)


def find_misalignment(lobe: LobeFit, refit: Callable[[Step], LobeFit], sample: str, samples: int = 1) -> Misalignment | None:
    """The misalignment that the residuals of a lobe show; None where they show none.

    `refit` fits the same lobe with a step in it. `samples` is the number of samples of the campaign that are watched.
    """
    rows, which = np.unique(lobe.points.row, return_inverse=True)
    if rows.size < LEAST_ROWS:
        return None
    covariance, limit = ValuesCovariance(lobe.effects), alarm_limit(samples)
    columns = [_column(each, lobe.sensitivities, lobe.residual.size) for each in PATTERNS]
    edges = np.unique(np.linspace(0, rows.size, PLACES + 1)[:-1].astype(np.int64))
    found = _since(covariance, lobe.residual, columns, np.searchsorted(edges, which, side="right") - 1)
    if np.max(np.abs(found.statistic)) <= limit:
        return None
    # A pattern that begins between two places has less than it explains: those that may be the largest are compared row by row.
    largest = np.max(np.abs(found.statistic), axis=1)
    possible = np.flatnonzero(largest > POSSIBLE * largest.max()).tolist()
    beginnings = [
        _beginning(covariance, lobe.residual, columns[k], which, edges, int(np.argmax(np.abs(found.statistic[k]))))
        for k in possible
    ]
    first = max(range(len(possible)), key=lambda k: abs(beginnings[k].statistic[beginnings[k].row]))
    best, begin = possible[first], beginnings[first].first
    k, statistic = beginnings[first].row, beginnings[first].statistic
    squared = [float(np.max(each.statistic**2)) for each in beginnings]
    alike = [each for each, own in zip(possible, squared, strict=True) if each != best and own > squared[first] - ALIKE]
    # Sums with the sensitivities fail at second order: the size is that of a fit with the step in it.
    pattern, row = PATTERNS[best], int(rows[begin + k])
    within = begin + np.flatnonzero(statistic**2 > statistic[k] ** 2 - ROWS_WITHIN)
    # A row without values of the lobe shows nothing: it may have begun there.
    earliest = int(rows[within[0] - 1]) + 1 if within[0] > 0 else int(rows[0])
    names = [f"sample_{pattern.input}@{each}" for each in lobe.mountings] if pattern.mounting else [pattern.input]
    stepped = refit(Step(tuple(names), row))
    size, u = stepped.step
    if stepped.chi_square > DOUBTED_CHI_SQUARE:
        limit, u = (math.sqrt(stepped.chi_square) * each for each in (limit, u))
    if stepped.chi_square <= REFUSED_CHI_SQUARE and abs(statistic[k]) <= limit:
        return None
    return Misalignment(
        sample,
        pattern,
        size,
        u,
        row,
        earliest,
        int(rows[within[-1]]),
        begin + k == 0,
        float(statistic[k]),
        limit,
        tuple(PATTERNS[each] for each in alike),
        stepped.chi_square,
    )


def watch_samples(evaluation: Evaluation, names: Sequence[str] | None = None) -> WatchResult:
    """What the residuals show of misalignments that no alignment or uncertainty of the rig states, by each sample's lobe.

    The rows so far are enough. Raises UserError.
    """
    reduction, closure = evaluation.reduction, evaluation.closure
    found: list[Misalignment] = []
    clear: list[str] = []
    without: list[str] = []
    for sample in names or reduction.schedule.samples:
        points = sample_lobe(reduction, sample)
        if points is None or points.size < TERMS:
            without.append(sample)
            continue
        settings = replace(reduction.settings, sample=sample, alignment=evaluation.known_alignment)
        seen = light_seen(reduction, closure)
        lobe = fit_lobe(points, settings, closure.beams, seen=seen)
        refit = partial(fit_lobe, points, settings, closure.beams, "", seen=seen)
        misalignment = find_misalignment(lobe, refit, sample, len(reduction.schedule.samples))
        beside = lobe.chi_square if misalignment is None else misalignment.chi_square
        if beside > REFUSED_CHI_SQUARE or not _determines(lobe, settings, reduction.rig.file):
            without.append(sample)
        elif misalignment is None:
            clear.append(sample)
        else:
            found.append(misalignment)
    return WatchResult(tuple(found), tuple(clear), tuple(without), reduction.journal.simulated)


def _determines(lobe: LobeFit, settings: ReductionSettings, rig: RigFile) -> bool:
    """Whether the values of a lobe determine a misalignment by themselves, beside what is known and without the scans."""
    if settings.alignment is not None or lobe.scans:
        lobe = fit_lobe(lobe.points, replace(settings, alignment=None))
    return bool(lobe.alignment.combinations(nominal_instrument(rig))[0])


@dataclass(frozen=True)
class _Beginning:
    """The statistic (n,) of a pattern since each of some rows, of which the sample's row `first` is the first one."""

    first: int
    statistic: Floats

    @property
    def row(self) -> int:
        """The place of the row with the largest one."""
        return int(np.argmax(np.abs(self.statistic)))


def _beginning(
    covariance: ValuesCovariance, residual: Floats, column: Floats, which: Ints, edges: Ints, place: int
) -> _Beginning:
    """A pattern since each row near a place, and beside them since all others at once."""
    rows = int(which.max()) + 1
    begin, end = int(edges[max(place - 1, 0)]), int(edges[place + 2]) if place + 2 < edges.size else rows
    every = _since(covariance, residual, [column], np.clip(which, begin - 1, end) - (begin - 1))
    return _Beginning(begin, every.statistic[0, 1 : 1 + end - begin])


def _column(pattern: Pattern, sensitivities: PoseSensitivities, count: int) -> Floats:
    """What a pattern of size 1 does to the values, and not to the scans of the open beam: (count,)."""
    if pattern.mounting:
        column = sensitivities.mounting[:, MOUNTED.index(pattern.input)]
    else:
        column = sensitivities.rig[:, (*LIGHT, *VIEW).index(pattern.input)]
    return np.append(column, np.zeros(count - column.size))


@dataclass(frozen=True)
class _Since:
    """For each pattern and each beginning (patterns, places): statistic, size and its u, beside a change of the light."""

    statistic: Floats
    size: Floats
    u: Floats


def _since(covariance: ValuesCovariance, residual: Floats, patterns: Sequence[Floats], place: Ints) -> _Since:
    """The patterns since each place; `place` (m,) are those of the values, which come first among the residuals (n,)."""
    places, count = int(place.max()) + 1, len(patterns)
    here: Flags = np.zeros((residual.size, places), dtype=bool)
    here[np.arange(place.size), place] = True
    acting = np.stack([*patterns, np.ones(residual.size)])
    parts = np.where(here[:, None, :], acting.T[:, :, None], 0.0).reshape(residual.size, -1)
    solved = covariance.solve(parts)

    def onwards(each: Floats, axis: int) -> Floats:
        return np.flip(np.cumsum(np.flip(each, axis), axis), axis)

    b = onwards((solved.T @ residual).reshape(count + 1, places), 1)
    gram = (parts.T @ solved).reshape(count + 1, places, count + 1, places)
    gram = onwards(onwards(gram, 1), 3)
    at = np.arange(places)
    own = np.stack([gram[k, at, k, at] for k in range(count + 1)])
    light = np.stack([gram[k, at, count, at] for k in range(count)])
    share = light / own[count]
    information = np.maximum(own[:count] - share * light, np.finfo(float).eps)
    size = (b[:count] - share * b[count]) / information
    # There is no statistic where no value distinguishes the pattern from a change of the light.
    known = information > LEAST_LEFT * np.maximum(own[:count], np.finfo(float).eps)
    size = np.where(known, size, 0.0)
    u = 1.0 / np.sqrt(information)
    return _Since(size / u, size, u)
