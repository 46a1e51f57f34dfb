"""The comparison of two reference standards: the same photodiodes see both in the same poses, each over its certificate.

The etalon's rows are reduced as those of a sample, by the second standard alone: E_1 rho_2 / E_2, which is to be rho_1. What
the two have in common (gains, monitor, linearity, the rig's angles) cancels in the effects of the values; their certificates,
mountings, positions and readings do not. All values together give one ratio, by generalised least squares. Where the slit's
image has an edge in the hole, a standard that lies higher has another share of the light: a further input of each incidence.
"""

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.planning.plan import NewPlan
from goniotwin.app.campaign.reduction.angles import add_pose
from goniotwin.app.campaign.reduction.components import ADDED, Signal, total_variance
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.etalon import ReferenceSignals
from goniotwin.app.campaign.reduction.optical_paths import incidence_deg
from goniotwin.app.campaign.reduction.pipeline import reduce_rows
from goniotwin.app.campaign.reduction.points import BsdfPoints, plausible
from goniotwin.app.campaign.reduction.readings import row_places
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.row_signals import RowSignals
from goniotwin.app.campaign.reduction.settings import ReductionSettings, reduction_settings
from goniotwin.app.campaign.studies.closure import AGREES, DIFFERS, SMALLEST_U, TROUBLES, signed
from goniotwin.arrays import Floats, Ints
from goniotwin.twin.optics.geometry.coordinates import round_deg

MOST_ROWS, MOST_VALUES = 96, 600
"""Rows of the etalon, and values in them, that are compared; of more, so many are taken evenly."""
RESOLVED = 0.1
"""Largest share of noise in a value that is compared: the logarithm of a darker one is that of noise."""


@dataclass(frozen=True)
class Ratio:
    """A `ratio` of the second standard's light to the etalon's, each over its certificate, with its relative uncertainty `u`.

    It is the best mean of so many `values`, at `wavelength_nm` and the incidence `sigma_deg`, None of all of them.
    """

    ratio: float
    u: float
    values: int
    wavelength_nm: float | None = None
    sigma_deg: float | None = None

    @property
    def z(self) -> float:
        """The logarithm of the ratio in its uncertainties."""
        return math.log(self.ratio) / max(self.u, SMALLEST_U)

    def as_dict(self) -> dict[str, Any]:
        """The ratio for JSON."""
        return {**vars(self), "z": self.z}


@dataclass(frozen=True)
class StandardsReport:
    """The comparison of the second standard `name` with the `etalon`: of all values `together`, None with the reason `missing`.

    `by_light` has it for each wavelength and incidence, and `chi_square` is that of these about the common one.
    """

    etalon: str
    name: str
    together: Ratio | None
    by_light: tuple[Ratio, ...] = ()
    chi_square: float = 0.0
    missing: str = ""

    @property
    def differs(self) -> bool:
        """Whether they are apart by more than is expected: half of the difference is then in the scale's uncertainty."""
        return self.together is not None and abs(self.together.z) > AGREES

    @property
    def difference(self) -> float:
        """The difference that is in the scale's uncertainty, relative; 0 where they agree.

        Where it is not the same at all wavelengths and incidences, the largest of these.
        """
        if self.together is None or not (self.differs or self.apart):
            return 0.0
        lights = () if self.alike else self.by_light
        return max((each.ratio - 1.0 for each in (self.together, *lights)), key=abs)

    @property
    def apart(self) -> bool:
        """Whether they certainly do not agree: in level, or from one wavelength or incidence to another."""
        return self.together is not None and (abs(self.together.z) > DIFFERS or not self.alike)

    @property
    def alike(self) -> bool:
        """Whether the ratio is the same at all wavelengths and incidences, within what chance allows."""
        return plausible(len(self.by_light), self.chi_square, 0.0)

    @property
    def alarms(self) -> list[str]:
        """What was not compared, and a comparison that is not as chance allows, as warnings."""
        if self.together is None:
            return [f"standards: not compared: {self.missing}"]
        return [f"standards: {self.verdict}"] if self.apart or self.differs else []

    @property
    def verdict(self) -> str:
        """The comparison in words."""
        if self.together is None:
            return f"{self.name} and {self.etalon} were not compared: {self.missing}"
        found = self.together
        text = (
            f"{self.name} / {self.etalon}: {found.ratio:.4f} of the expected signal (u {100.0 * found.u:.2f} %, "
            f"z {signed(found.z)}; chi-square of {len(self.by_light)} by wavelength and incidence {self.chi_square:.1f})"
        )
        if self.differs:
            word = "they do NOT agree" if abs(found.z) > DIFFERS else "more than expected"
            text += f": {word}, and either may be wrong: half of the difference is in u"
        elif not self.apart:
            return f"{text}: they agree"
        if not self.alike:
            text += "; over wavelengths and incidences they do NOT agree: half of the largest difference is in u"
        return text

    def as_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        return {
            "etalon": self.etalon,
            "second": self.name,
            "together": self.together,
            "by_light": self.by_light,
            "chi_square": self.chi_square,
            "apart": self.apart,
            "difference": self.difference,
            "verdict": self.verdict,
        }


def compare_standards(reduction: Reduction) -> StandardsReport | None:
    """The comparison of a journal's two standards; None where the schedule has one. Raises UserError."""
    settings = _by_second_alone(reduction.settings)
    if settings is None or settings.second is None:
        return None
    names = settings.sample, settings.second.name
    table = reduction.measurements.row_table(settings.sample)
    chosen = _spread(row_places(table))
    points = replace(reduction, settings=settings).points_of_rows(settings.sample, chosen)
    if reduction.second is None or not len(reduction.second) or points is None:
        return StandardsReport(*names, None, missing=f"{names[1]} has not been measured")
    found = _compared(points, settings)
    return found or StandardsReport(*names, None, missing="no photodiode has light of both that their certificates cover")


def standards_text(report: StandardsReport) -> str:
    """A report as lines of text: a table by wavelength and incidence, and the verdict."""
    lines = [f"  {report.name} over {report.etalon}, each over its certificate"] if report.by_light else []
    if report.by_light:
        lines.append("  sigma      nm  values   ratio    u %      z")
    lines += [
        f"  {each.sigma_deg:5.1f}  {each.wavelength_nm:6.1f}  {each.values:6d}  {each.ratio:6.4f}  {100.0 * each.u:5.2f}  "
        f"{signed(each.z):>5}"
        for each in report.by_light
    ]
    return "\n".join([*lines, report.verdict])


@dataclass(frozen=True)
class ExpectedComparison:
    """What a plan's comparison of two standards will find: the relative standard uncertainty `u` of their ratio."""

    u: float

    def as_dict(self) -> dict[str, Any]:
        """The comparison for JSON."""
        return {"u": self.u, "noticed": AGREES * self.u, "found": DIFFERS * self.u}

    def __str__(self) -> str:
        return (
            f"u of their ratio {100.0 * self.u:.2f} % (without noise): a difference of {100.0 * DIFFERS * self.u:.1f} % is "
            f"certainly detected ({DIFFERS:g} u), a difference of {100.0 * AGREES * self.u:.1f} % is noticed ({AGREES:g} u)"
        )


def expected_comparison(plan: NewPlan) -> ExpectedComparison | None:
    """The comparison of a plan's standards, by what rig file and schedule state; None where there is one standard."""
    schedule, rig = plan.schedule, plan.rig
    given = reduction_settings(rig.file, schedule.file, schedule.certificate, schedule.name, alignment=rig.alignment)
    settings = _by_second_alone(given)
    if settings is None:
        return None
    parts = []
    for k in range(2):
        (one, *_) = plan.mountings[k]
        wavelengths = one.grid.wavelengths_nm
        places = np.column_stack(
            [np.tile(wavelengths, len(one.poses.angles)), np.repeat(one.poses.angles, len(wavelengths), 0)]
        )
        places = places[_spread(places)]
        hours = plan.seconds / 3600.0 * (k + 0.5) / len(plan.mountings)
        parts.append(_even_light(places, np.arange(len(places)) + k * len(places), hours, rig.file.photodiodes.count))
    etalon, second = parts
    reduced = reduce_rows(etalon, ReferenceSignals(etalon, None, second), settings)
    found = None if reduced is None else _compared(reduced[1], settings)
    return None if found is None or found.together is None else ExpectedComparison(found.together.u)


def _even_light(places: Floats, numbers: Ints, hours: float, photodiodes: int) -> RowSignals:
    """Rows in which all photodiodes have the same light, without noise."""
    shape, one = (len(places), photodiodes), np.ones(len(places))
    signal = Signal(np.ones(shape), gain=np.zeros(shape, dtype=np.int64))
    flags = dict.fromkeys(TROUBLES, np.zeros(shape, dtype=bool))
    return RowSignals(numbers, places, np.zeros(len(places), dtype=bool), signal, flags, hours * one, 0.0 * one)


def _by_second_alone(settings: ReductionSettings) -> ReductionSettings | None:
    """The settings by which the etalon's rows are values of the second standard's scale; None without one."""
    if settings.second is None:
        return None
    return replace(
        settings, sample=settings.schedule.etalon, second=replace(settings.second, share=1.0, difference=0.0), absolute={}
    )


def _spread(places: Floats) -> Ints:
    """Some rows of those at places (n, 5), evenly of each wavelength and incidence."""
    _, which = np.unique(round_deg(places[:, [0, 2]]), axis=0, return_inverse=True)
    kinds = np.unique(which.ravel())
    kinds = kinds[_evenly(kinds.size, MOST_ROWS)]
    found = [np.flatnonzero(which.ravel() == k) for k in kinds.tolist()]
    return np.sort(np.concatenate([each[_evenly(each.size, max(1, MOST_ROWS // kinds.size))] for each in found]))


def _evenly(count: int, most: int) -> Ints:
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def _compared(points: BsdfPoints, settings: ReductionSettings) -> StandardsReport | None:
    """The comparison by points of the etalon in the scale of the second standard alone; None without a value."""
    points = points.where(points.good & ~points.transmitted & ~points.mirrored & (points.second_row >= 0))
    noise = total_variance({name: each for name, each in points.components.items() if name in ADDED})
    points = points.where(np.sqrt(noise) < RESOLVED * points.bsdf)
    if not points.size or settings.second is None:
        return None
    points = add_pose(points.where(_evenly(points.size, MOST_VALUES)), settings)
    incidence, every = incidence_deg(points), np.arange(points.size)
    polar = polar_from_zenith(points.zenith_deg)
    certified, _ = settings.certificate.interpolate(points.wavelength_nm, incidence, polar, points.azimuth_deg)
    logarithm = -np.log(points.bsdf * math.pi / certified)
    covariance = effects_of(points, settings).covariance(every, every) / np.outer(points.bsdf, points.bsdf)
    covariance += SMALLEST_U**2 * np.eye(points.size)
    places, which = np.unique(round_deg(np.stack([points.wavelength_nm, incidence], axis=1)), axis=0, return_inverse=True)
    parts = [np.flatnonzero(which.ravel() == k) for k in range(len(places))]
    weights = np.zeros((len(places), points.size))
    for weight, at in zip(weights, parts, strict=True):
        weight[at] = _best(covariance[np.ix_(at, at)])
    means, of_means = weights @ logarithm, weights @ covariance @ weights.T
    best = _best(covariance)
    mean = float(best @ logarithm)
    left = means - _best(of_means) @ means
    return StandardsReport(
        settings.sample,
        settings.second.name,
        Ratio(math.exp(mean), math.sqrt(best @ covariance @ best), points.size),
        tuple(
            Ratio(math.exp(each), math.sqrt(variance), at.size, *place)
            for each, variance, at, place in zip(means, np.diag(of_means), parts, places.tolist(), strict=True)
        ),
        float(left @ np.linalg.solve(of_means, left)),
    )


def _best(covariance: Floats) -> Floats:
    """The weights (n,) of the best mean of values with a covariance (n, n)."""
    weight = np.linalg.solve(covariance, np.ones(len(covariance)))
    return np.asarray(weight / weight.sum())
