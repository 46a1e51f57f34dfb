"""A lobe in the light of an illumination unit with deviations of its own (paper, section 3.3, between Tables 1 and 2).

The paper records the rays of the illumination unit once, at the worst combination of its deviations, and sends these rays
through mirrors, sample and sensors with all combinations of theirs. Here the light of a unit is the exact image of its slit
with the radiance along each ray to the arc, the limit of a rayset of ever more rays. So it can also be evaluated anew for each
combination.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from goniotwin.app.simulation.corner_search import WorstCombination
from goniotwin.app.simulation.paper.gaussian_cut import relative_deviation
from goniotwin.app.simulation.tolerances.light import IlluminationLight
from goniotwin.app.simulation.tolerances.lobe import GaussianLobe
from goniotwin.app.simulation.tolerances.stages import Combinations, ReportShare, Response, evaluate_draws, worst_combination
from goniotwin.app.simulation.tolerances.study import (
    LIGHTS,
    FluxTable,
    GaussianTable,
    IlluminationTable,
    Light,
    Parameter,
    StudyFile,
    component_matrix,
    levels_of_parameters,
    limits_of,
    parameters_of,
)
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.twin.optics import Deviation, Instrument, Pose, Scenes, lambertian
from goniotwin.twin.optics.geometry.instrument import COMPONENTS, ILLUMINATION_ELEMENTS
from goniotwin.twin.optics.illumination.unit import unit_of

FREE_DEG, WHOLE_DEG = 20.0, 10.0
"""Polar angle of a detector of the etalon, at the azimuth away from mirror 1, and its field: it has all of the hole in view."""
ROUNDS = 4
"""Most searches over the unit's deviations, then over the others, in turn."""


@dataclass(frozen=True, eq=False)
class CombinationsInLight:
    """The study's combinations in one light; `light` is its name.

    `flux` (n,) is that through the sample's hole relative to the flux without any deviation. `worst` is the worst corner that
    was found, over the study's deviations and, where they are free, those of the unit; `flux_at_worst` is its flux.
    """

    light: Light
    combinations: Combinations
    flux: Floats
    worst: WorstCombination
    flux_at_worst: float


@dataclass(frozen=True, eq=False)
class LightComparison:
    """The same combinations in several lights, and what differs.

    `parameters` are the deviations of the unit, `frozen` the combination of theirs with the largest change of the flux, and
    `frozen_flux` the flux into the central 5 x 5 mm that it leaves.
    """

    parameters: tuple[Parameter, ...]
    frozen: WorstCombination
    frozen_flux: float
    lights: tuple[CombinationsInLight, ...]

    def of(self, light: Light) -> CombinationsInLight | None:
        """The combinations in one light, if the study has it."""
        return next((each for each in self.lights if each.light == light), None)

    @property
    def difference(self) -> "Difference | None":
        """Frozen minus anew; None if the study has only one of them."""
        anew, frozen = self.of("anew"), self.of("frozen")
        if anew is None or frozen is None:
            return None
        percents, within = (frozen.combinations.percent, anew.combinations.percent), anew.combinations.within
        shares = []
        for limit in within:
            change = (percents[0] <= limit).astype(np.float64) - (percents[1] <= limit)
            shares.append((float(change.mean()), float(change.std() / math.sqrt(change.size))))
        return Difference(
            median_percent=float(np.median(percents[0]) - np.median(percents[1])),
            largest_percent=float(np.abs(percents[0] - percents[1]).max()),
            worst_percent=frozen.worst.percent - anew.worst.percent,
            shares=tuple(shares),
            median_flux=float(np.median(frozen.flux) - np.median(anew.flux)),
            least_flux=float(frozen.flux.min() - anew.flux.min()),
        )


@dataclass(frozen=True, eq=False)
class Difference:
    """The light frozen minus that evaluated anew, in percentage points and in parts of the flux.

    `largest_percent` is the largest change of the criterion of one combination. `shares` are changes of the shares within each
    limit, with standard errors: the combinations are the same ones.
    """

    median_percent: float
    largest_percent: float
    worst_percent: float
    shares: tuple[tuple[float, float], ...]
    median_flux: float
    least_flux: float


class LobeInLight:
    """A lobe as `GaussianLobe`, whose light comes from an illumination unit with deviations of its own.

    Values (n, k) have the lobe's deviations first, then those of the unit, `unit_parameters`. With `lit_everywhere` of the
    instrument the hole is evenly lit, whatever the unit does.
    """

    def __init__(
        self,
        instrument: Instrument,
        criterion: GaussianTable,
        parameters: Sequence[Parameter],
        unit_parameters: Sequence[Parameter],
    ) -> None:
        self.lobe = GaussianLobe(instrument, criterion, parameters)
        self._count = len(self.lobe.parameters)
        self._matrix = component_matrix(unit_parameters, ILLUMINATION_ELEMENTS)
        self._poses = [Pose(each.sigma_deg, each.axes) for each in self.lobe.directions]
        # The etalon's signal is the light through the hole, but for the cosines of the tilts, if no mirror hides the detector.
        tilt = math.radians(FREE_DEG)
        self._free = [Pose(self.lobe.directions[0].sigma_deg, np.array([[0.0, math.sin(tilt), math.cos(tilt)]]))]
        self._aligned = float(self._flux(np.zeros((1, self._count)), np.zeros(len(unit_parameters)))[0])

    def residuals(self, values: Floats) -> Floats:
        """Relative deviations (n, m) from the formula about the nominal specular direction."""
        found = np.empty((len(values), self.lobe.theory.size))
        for unit, places in self._units(values):
            scenes = Scenes(self._instrument(unit), self._poses, [self.lobe.sample])
            found[places] = scenes.ratios(self.lobe.deviations(values[places, : self._count]))[:, 0, 0]
        return relative_deviation(found, self.lobe.theory)

    def flux(self, values: Floats) -> Floats:
        """Flux (n,) through the sample's hole relative to that without deviations."""
        found = np.empty(len(values))
        for unit, places in self._units(values):
            found[places] = self._flux(values[places, : self._count], unit)
        return found / self._aligned

    def _flux(self, values: Floats, unit: Floats) -> Floats:
        instrument = replace(self._instrument(unit), field_deg=WHOLE_DEG)
        scenes = Scenes(instrument, self._free, [lambertian()])
        return np.asarray(scenes.throughputs(self.lobe.deviations(values))[:, 0, 0, 0])

    def _units(self, values: Floats) -> list[tuple[Floats, Ints]]:
        """Each different unit's deviations, and the places of its rows."""
        units, numbers = np.unique(values[:, self._count :], axis=0, return_inverse=True)
        order = np.argsort(numbers.ravel(), kind="stable")
        pieces = np.split(order, np.cumsum(np.bincount(numbers.ravel(), minlength=len(units)))[:-1])
        return list(zip(units, pieces, strict=True))

    def _instrument(self, unit: Floats) -> Instrument:
        rows = (unit @ self._matrix).reshape(len(ILLUMINATION_ELEMENTS), len(COMPONENTS))
        named = zip(ILLUMINATION_ELEMENTS, rows.tolist(), strict=True)
        return replace(self.lobe.instrument, illumination={name: Deviation(*row) for name, row in named if any(row)})


class PartHeld:
    """A response of which some deviations are held at `values` (k,): those that are not `free` (k,)."""

    def __init__(self, response: Response, values: Floats, free: Flags) -> None:
        self._response, self._values, self._free = response, values, np.flatnonzero(free)

    def whole(self, values: Floats) -> Floats:
        """All values (n, k) for the free ones."""
        found = np.repeat(self._values[None], len(values), axis=0)
        found[:, self._free] = values
        return found

    def residuals(self, values: Floats) -> Floats:
        """Residuals (n, m) of the free deviations' values."""
        return self._response.residuals(self.whole(values))


def compare_lights(
    study: StudyFile, table: IlluminationTable, parameters: Sequence[Parameter], report: ReportShare
) -> LightComparison:
    """Random combinations of a study's deviations in each light, and the worst corner of each."""
    assert isinstance(study.criterion, GaussianTable)
    instrument, within = study.instrument.instrument(), tuple(study.criterion.within_percent)
    unit_parameters = parameters_of(table.deviations, instrument)
    limits, unit_limits = limits_of(parameters), limits_of(unit_parameters)
    random = np.random.Generator(np.random.Philox(table.seed))
    rigs = np.stack([random.choice(each, table.draws) for each in levels_of_parameters(parameters)], axis=1)
    units = unit_limits * random.choice(np.array([-1.0, 1.0]), (table.draws, len(unit_parameters)))
    report(0.0, "the unit's worst corner")
    alone = IlluminationLight(unit_of(replace(instrument, illumination={})), FluxTable(kind="flux"), unit_parameters)
    held = worst_combination(alone, unit_limits)
    held_values = held.levels * unit_limits

    even = LobeInLight(replace(instrument, lit_everywhere=True), study.criterion, parameters, unit_parameters)
    lit = LobeInLight(replace(instrument, lit_everywhere=False), study.criterion, parameters, unit_parameters)
    lights: list[tuple[Light, LobeInLight, Floats]] = [
        ("even", even, 0.0 * units),
        ("aligned", lit, 0.0 * units),
        ("frozen", lit, np.repeat(held_values[None], table.draws, axis=0)),
        ("anew", lit, units),
    ]
    chosen = [each for each in lights if each[0] in ("even", "aligned", *table.light)]
    every, found = np.concatenate([limits, unit_limits]), []
    free = np.arange(every.size) < limits.size
    for number, (light, lobe, drawn_units) in enumerate(chosen):

        def done(share: float, step: str, number: int = number, light: Light = light) -> None:
            report((number + 0.7 * share) / len(chosen), f"light {LIGHTS[light]}: {step}")

        values = np.concatenate([rigs, drawn_units], axis=1)
        drawn = evaluate_draws(lobe, values, within, done)
        done(1.0, "worst corner")
        start = held_values if light in ("frozen", "anew") else 0.0 * unit_limits
        worst = worst_combination(PartHeld(lobe, np.concatenate([0.0 * limits, start]), free), limits)
        levels = np.concatenate([worst.levels, (start / unit_limits).round().astype(np.int64)])
        worst = replace(worst, levels=levels)
        if light == "anew":
            worst = worst_in_turn(lobe, every, worst, ~free)
        flux = lobe.flux(np.concatenate([values, (worst.levels * every)[None]]))
        found.append(CombinationsInLight(light, drawn, flux[:-1], worst, float(flux[-1])))
    return LightComparison(unit_parameters, held, float(alone.relative(held_values[None])[0][0]), tuple(found))


def worst_in_turn(response: Response, limits: Floats, first: WorstCombination, unit: Flags) -> WorstCombination:
    """The worst combination from `first` on: over the unit's deviations, where `unit` (k,), then over the others, in turn.

    A combination of the unit costs fifty times one of the others, and both together are too many for a search.
    """
    levels, percent, evaluated = first.levels.copy(), first.percent, first.evaluated
    for number in range(ROUNDS):
        free = unit if number % 2 == 0 else ~unit
        held = PartHeld(response, levels * limits, free)
        found = worst_combination(held, limits[free])
        evaluated += found.evaluated
        if number and found.percent <= percent * (1.0 + 1e-9):
            break
        if found.percent > percent:
            levels[free], percent = found.levels, found.percent
    return WorstCombination(levels, percent, first.linear_percent, evaluated)
