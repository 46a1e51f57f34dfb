"""A whole tolerance study: the paper's stages, the variants beside them, and what goes beyond the paper."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from goniotwin.app.errors import UserError
from goniotwin.app.simulation.corner_search import WorstCombination, rms_percent
from goniotwin.app.simulation.tolerances.beam_on_sample import LIT_SIDE_MM, BeamOnSample, Scaled
from goniotwin.app.simulation.tolerances.drawing import Distribution, draw_deviations
from goniotwin.app.simulation.tolerances.light import Evenness, IlluminationLight, LightByRays
from goniotwin.app.simulation.tolerances.lobe import GaussianLobe, LobeSurrogate, Recentred
from goniotwin.app.simulation.tolerances.stages import (
    Combinations,
    LimitsAlone,
    ReducedLimits,
    ReportShare,
    Response,
    all_combinations,
    evaluate_draws,
    limits_alone,
    random_corners,
    reduce_limits,
    worst_combination,
)
from goniotwin.app.simulation.tolerances.study import (
    DeviationsTable,
    GaussianTable,
    InstrumentTable,
    Parameter,
    StudyFile,
    VariantTable,
    levels_of_parameters,
    limits_of,
    parameters_of,
)
from goniotwin.arrays import Floats
from goniotwin.twin.optics import IlluminationUnit

INCIDENCE_LIMIT_DEG = 0.1
"""The instrument's least angular step (paper, section 2): incidence is taken as wrong beyond it."""
PEAK_STEP = 0.1
"""Share of its limit by which a deviation is moved for a sensitivity."""


@dataclass(frozen=True, eq=False)
class Case:
    """The paper's stages with one set of deviations: the study itself (no name) or a variant of it.

    `aligned_percent` is the criterion without deviations, `worst` the worst combination found by search. `common` are the
    limits reduced by one factor until no combination fails. `individual` are the limits alone, reduced in the same way: what an
    element does not need is left to it.
    """

    name: str
    parameters: tuple[Parameter, ...]
    limits: Floats
    aligned_percent: float
    alone: LimitsAlone
    combinations: Combinations
    worst: WorstCombination
    common: ReducedLimits
    individual: ReducedLimits

    @property
    def worst_alone(self) -> tuple[Parameter, float]:
        """The deviation with the largest criterion alone at its limit, and that criterion."""
        largest = self.alone.percent.max(axis=1)
        place = int(np.argmax(largest))
        return self.parameters[place], float(largest[place])

    @property
    def worst_values(self) -> Floats:
        """Values (k,) of the worst combination, deg or mm."""
        return np.asarray(self.worst.levels * self.limits)


@dataclass(frozen=True, eq=False)
class Sensitivities:
    """Changes by a deviation of 1 deg or 1 mm, (k,) each: of the measured peak and of the incidence in deg, of the place in mm.

    The peak moves in the plane of incidence. The place is the length of the shift of the lit square on the sample, across the
    beam.
    """

    peak_deg: Floats
    incidence_deg: Floats
    place_mm: Floats


@dataclass(frozen=True, eq=False)
class Limitation:
    """One quantity over all combinations: its worst value, its limit, and the factor of all limits with which it keeps it."""

    name: str
    unit: str
    limit: float
    worst: float
    factor: float


@dataclass(frozen=True, eq=False)
class AfterRecentring:
    """The lobe about its measured peak: the criterion without deviations, at the worst corner of the study, and at its own.

    `limitations` are what then limits the deviations.
    """

    aligned_percent: float
    at_worst_percent: float
    peak_at_worst_deg: float
    worst: WorstCombination
    limitations: tuple[Limitation, ...]


@dataclass(frozen=True, eq=False)
class Uniformity:
    """Uniformity of the light: without deviations, at the worst corner of the flux, and at its own worst corner.

    `by_rays` is the light at the worst corner of the flux by random rays.
    """

    aligned: float
    at_worst: float
    lowest: float
    flux_at_worst: float
    by_rays: LightByRays


@dataclass(frozen=True, eq=False)
class StudyResult:
    """All numbers of a study. `yields` are by distribution."""

    study: StudyFile
    case: Case
    variants: tuple[Case, ...]
    yields: dict[Distribution, Combinations]
    sensitivities: Sensitivities | None
    recentred: AfterRecentring | None
    uniformity: Uniformity | None

    @property
    def cases(self) -> tuple[Case, ...]:
        """The study itself, then its variants."""
        return (self.case, *self.variants)


def compute_study(study: StudyFile, report: ReportShare = lambda _share, _step: None) -> StudyResult:
    """Compute a study. Raises UserError for an instrument without a value where nothing deviates."""
    steps = len(study.variants) + 2
    case, response = _compute_case(study, None, _part(report, 0, steps))
    variants = tuple(
        _compute_case(study, variant, _part(report, number, steps))[0] for number, variant in enumerate(study.variants, 1)
    )
    last = _part(report, steps - 1, steps)
    limits, within = limits_of(case.parameters), case.combinations.within
    yields = {}
    for number, name in enumerate(study.yields.distributions):
        draws = draw_deviations(name, limits, study.yields.draws, study.yields.seed, study.yields.limit_sigmas)
        done = _part(last, number, len(study.yields.distributions) + 1)
        yields[name] = evaluate_draws(response, draws, within, _named(done, f"yield, {name}"))
    result = StudyResult(
        study=study,
        case=case,
        variants=variants,
        yields=yields,
        sensitivities=_sensitivities(response, limits) if isinstance(response, GaussianLobe) else None,
        recentred=_recentre(response, case) if isinstance(response, GaussianLobe) else None,
        uniformity=_uniformity(response, case) if isinstance(response, IlluminationLight) else None,
    )
    report(1.0, "done")
    return result


def _part(report: ReportShare, number: int, count: int) -> ReportShare:
    return lambda share, step: report((number + share) / count, step)


def _named(report: ReportShare, step: str) -> ReportShare:
    return lambda share, _step: report(share, step)


def _compute_case(study: StudyFile, variant: VariantTable | None, report: ReportShare) -> tuple[Case, Response]:
    name = "" if variant is None else variant.name
    title = name or "the study"
    table: InstrumentTable = study.instrument if variant is None else variant.instrument or study.instrument
    response = _response(study, study.of_variant(variant), table)
    parameters, limits = response.parameters, limits_of(response.parameters)
    within = tuple(study.criterion.within_percent)
    aligned = float(rms_percent(response.residuals(np.zeros((1, limits.size))))[0])
    if not math.isfinite(aligned):
        raise UserError(f"{title}: the instrument gives no value without deviations; correct its dimensions, or obstruction")
    report(0.0, f"{title}: deviations alone")
    largest = np.array([study.alone.largest_deg if each.unit == "deg" else study.alone.largest_mm for each in parameters])
    alone = limits_alone(response, limits, largest, within)
    report(0.1, f"{title}: worst corner")
    worst = worst_combination(response, limits)
    common = reduce_limits(response, limits, within[0], worst)
    report(0.2, f"{title}: limits alone, reduced")
    individual = reduce_limits(response, np.minimum(alone.permitted[:, 0], largest), within[0])

    def done(share: float, step: str) -> None:
        report(0.3 + 0.7 * share, f"{title}: {step}")

    levels, settings = levels_of_parameters(parameters), study.combinations
    if math.prod(each.size for each in levels) <= settings.enumerate_up_to:
        surrogate = None
        if isinstance(response, GaussianLobe) and settings.evaluator == "surrogate":
            try:
                surrogate = LobeSurrogate(response, limits)
            except ValueError as error:
                raise UserError(f'combinations.evaluator: {error}; write "exact"') from None
        combinations = all_combinations(response, levels, within, done, surrogate)
    else:
        combinations = evaluate_draws(response, random_corners(limits, settings.draws, settings.seed), within, done)
    return Case(name, parameters, limits, aligned, alone, combinations, worst, common, individual), response


def _response(study: StudyFile, groups: list[DeviationsTable], table: InstrumentTable) -> GaussianLobe | IlluminationLight:
    instrument = table.instrument()
    parameters = parameters_of(groups, instrument)
    if isinstance(study.criterion, GaussianTable):
        return GaussianLobe(instrument, study.criterion, parameters)
    return IlluminationLight(IlluminationUnit(), study.criterion, parameters)


def _sensitivities(lobe: GaussianLobe, limits: Floats) -> Sensitivities:
    steps = PEAK_STEP * np.diag(limits)
    beam = BeamOnSample(lobe, lobe.directions[0].sigma_deg)
    plus, minus = (lobe.peaks(lobe.factors(sign * steps))[0][:, 0, 0] for sign in (1.0, -1.0))
    across = PEAK_STEP * limits
    places = beam.place_mm(steps) - beam.place_mm(-steps)
    return Sensitivities(
        peak_deg=(plus - minus) / (2.0 * across),
        incidence_deg=(beam.incidence_deg(steps) - beam.incidence_deg(-steps)) / (2.0 * across),
        place_mm=np.hypot(*places.T) / (2.0 * across),
    )


def _recentre(lobe: GaussianLobe, case: Case) -> AfterRecentring:
    recentred, limits = Recentred(lobe), case.limits
    beam = BeamOnSample(lobe, lobe.directions[0].sigma_deg)
    rows = np.stack([np.zeros(limits.size), case.worst_values])
    aligned, at_worst = rms_percent(recentred.residuals(rows))
    places, _ = lobe.peaks(lobe.factors(rows))
    worst = worst_combination(recentred, limits)
    within = case.combinations.within[0]
    limitations = [
        Limitation("relative RMS", "%", within, case.worst.percent, case.common.factor),
        Limitation("relative RMS about the measured peak", "%", within, worst.percent, _factor(recentred, limits, within)),
    ]
    margin_mm = 0.5 * (LIT_SIDE_MM - lobe.instrument.spot_side_mm)
    quantities: tuple[tuple[str, str, float, Callable[[Floats], Floats]], ...] = (
        ("incidence", "deg", INCIDENCE_LIMIT_DEG, beam.incidence_deg),
        ("place of the light on the sample", "mm", margin_mm, lambda values: np.abs(beam.place_mm(values)).max(axis=1)),
        ("light that misses the sample's hole", "%", within, lambda values: 100.0 * (1.0 - beam.lit_share(values))),
    )
    for name, unit, limit, quantity in quantities:
        response = Scaled(quantity, limit)
        largest = 0.01 * limit * worst_combination(response, limits).percent
        limitations.append(Limitation(name, unit, limit, largest, _factor(response, limits, 100.0)))
    return AfterRecentring(
        float(aligned), float(at_worst), float(np.hypot(*(places[1, 0] - places[0, 0]))), worst, tuple(limitations)
    )


def _factor(response: Response, limits: Floats, within: float) -> float:
    """Factor of the limits with which no combination exceeds `within`; above 1 where they could be larger."""
    wide = 64.0
    return wide * reduce_limits(response, wide * limits, within).factor


def _uniformity(light: IlluminationLight, case: Case) -> Uniformity:
    flux, uniformity = light.relative(case.worst_values[None])
    evenness = Evenness(light)
    worst = worst_combination(evenness, case.limits)
    lowest = light.relative((worst.levels * case.limits)[None])[1]
    by_rays = light.by_rays(case.worst_values)
    return Uniformity(light.uniformity, float(uniformity[0]), float(lowest[0]), float(flux[0]), by_rays)
