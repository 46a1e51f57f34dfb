"""The study file of `goniotwin tolerances`: which deviations, their ranges and steps, and the criterion. One TOML file.

See docs/physics/tolerances.md.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Discriminator, Field, PositiveFloat, Tag, model_validator

from goniotwin.app.simulation.paper.table3 import collimated
from goniotwin.app.simulation.tolerances.drawing import Distribution
from goniotwin.app.simulation.tolerances.stages import levels_of
from goniotwin.app.toml_file import TomlTable, read_toml, validate_table
from goniotwin.arrays import Floats
from goniotwin.keys import Positive
from goniotwin.twin.optics import Dimensions, Instrument
from goniotwin.twin.optics.bsdf.analytic_samples import Form
from goniotwin.twin.optics.geometry.instrument import COMPONENTS
from goniotwin.twin.optics.geometry.instrument import ELEMENTS as INSTRUMENT_ELEMENTS
from goniotwin.twin.optics.illumination.unit import ELEMENTS as ILLUMINATION_ELEMENTS

BEAM = "beam"
"""The whole illumination unit, turned about the sample."""
Light = Literal["even", "aligned", "anew", "frozen"]
LIGHTS: dict[Light, str] = {
    "even": "evenly lit hole",
    "aligned": "aligned unit",
    "frozen": "frozen",
    "anew": "anew",
}
"""An evenly lit hole, the light of a unit without deviations, of another unit for each combination, or of the worst unit."""
MOST_DEVIATIONS = 60
MOST_LEVELS = 101
LARGEST_DEG, LARGEST_MM = 20.0, 50.0
"""Limits beyond these are not deviations of an instrument any more."""

Angle = Literal["rx", "ry", "rz"]
Shift = Literal["x", "y", "z"]
Percent = Annotated[float, Field(gt=0.0, lt=100.0)]
Within = Annotated[list[Percent], Field(min_length=1, max_length=4)]
Draws = Annotated[int, Field(ge=100, le=10_000_000)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]


@dataclass(frozen=True)
class Parameter:
    """One deviation of one element: its range is +-`limit` in steps of `step`, in deg or mm.

    `moves` has the components of elements that it moves, and how far for a value of 1: its own, but for a tilt of the beam.
    """

    element: str
    component: str
    limit: float
    step: float
    moves: tuple[tuple[str, str, float], ...]

    @property
    def name(self) -> str:
        """Name of the deviation without its unit, such as rx."""
        return self.component.partition("_")[0]

    @property
    def title(self) -> str:
        """Element and deviation, as text."""
        return f"{self.element.replace('_', ' ')} {self.name}"

    @property
    def unit(self) -> str:
        """Unit of its value: deg or mm."""
        return self.component.partition("_")[2]


class DeviationsTable(TomlTable):
    """`[[deviations]]`: deviations of some elements, all with the same range.

    `elements`: the elements that deviate. Those of the instrument are pupil, mirror_1 to mirror_3, mirror_unit, sample, arc and
    sensor, and beam, the light turned about the sample. Those of the illumination unit are arc, reflector, input_condenser,
    slit, output_condenser and unit. `angles`: axes about which they are turned. `shifts`: axes along which they are shifted.
    `limit_deg`: largest angle, in both directions. `step_deg`: step of the angles; without it there are three: minus the limit,
    zero, and the limit. `limit_mm`: largest shift, in both directions. `step_mm`: step of the shifts; without it there are
    three: minus the limit, zero, and the limit.
    """

    elements: Annotated[list[str], Field(min_length=1)]
    angles: list[Angle] = []
    shifts: list[Shift] = []
    limit_deg: PositiveFloat | None = None
    step_deg: PositiveFloat | None = None
    limit_mm: PositiveFloat | None = None
    step_mm: PositiveFloat | None = None

    @model_validator(mode="after")
    def _check_limits(self) -> "DeviationsTable":
        for names, key, limit, step in (
            (self.angles, "deg", self.limit_deg, self.step_deg),
            (self.shifts, "mm", self.limit_mm, self.step_mm),
        ):
            if names and limit is None:
                raise ValueError(f"limit_{key}: is missing; give the range of the {'angles' if key == 'deg' else 'shifts'}")
            if not names and (limit is not None or step is not None):
                raise ValueError(
                    f"limit_{key}: has no {'angles' if key == 'deg' else 'shifts'} to limit; name these, or remove it"
                )
            largest = {"deg": LARGEST_DEG, "mm": LARGEST_MM}[key]
            if limit is not None and limit > largest:
                raise ValueError(f"limit_{key}: {limit:g} is more than {largest:g} {key}, no deviation; give a smaller one")
            if limit is not None and step is not None and not limit / (MOST_LEVELS // 2) <= step <= limit:
                raise ValueError(
                    f"step_{key}: {step:g} is not from {limit / (MOST_LEVELS // 2):g} to the limit of {limit:g}; correct it"
                )
        if not self.angles and not self.shifts:
            raise ValueError('angles: is missing, and so is shifts; name at least one, such as angles = ["rx"]')
        return self

    def parameters(self) -> list[Parameter]:
        """The deviations, element by element."""
        found = []
        for element in self.elements:
            for name, unit, limit, step in (
                *((each, "deg", self.limit_deg, self.step_deg) for each in self.angles),
                *((each, "mm", self.limit_mm, self.step_mm) for each in self.shifts),
            ):
                assert limit is not None  # checked above
                component = f"{name}_{unit}"
                found.append(Parameter(element, component, limit, step or limit, ((element, component, 1.0),)))
        return found


class FluxTable(TomlTable):
    """The criterion "flux": the flux into the central 5 x 5 mm of the sample, relative to that without deviations.

    `kind`: name of this criterion: "flux". `within_percent`: largest change of the flux with which a combination passes. The
    first value decides; the report states the fraction for each. `rays`: number of adjoint rays that confirm the worst
    combination. All combinations are evaluated by a quadrature. `seed`: seed of the random numbers of the rays.
    """

    kind: Literal["flux"]
    within_percent: Within = [5.0, 10.0]
    rays: Annotated[int, Field(ge=100, le=100_000_000)] = 1_000_000
    seed: Seed = 0


class GaussianTable(TomlTable):
    """The criterion "gaussian": formula 5 between a Gaussian sample, simulated, and its formula.

    `kind`: name of this criterion: "gaussian". `within_percent`: largest relative RMS with which a combination passes. The
    first value decides; the report states the fraction for each. `sigma_deg`: the incidences in formula 5. `width_deg`: width
    of the Gaussian. `form`: what the width is: where the Gaussian has fallen to 1/e, or to one half. `widths`: range of the
    directions in formula 5, in widths from the specular direction. Their zenith angle is below 85 deg. `step_deg`: step of the
    directions in formula 5. `directions`: whether these directions are in the "plane" of incidence, or in the whole "lobe".
    """

    kind: Literal["gaussian"]
    within_percent: Within = [5.0]
    sigma_deg: Annotated[list[Annotated[float, Field(ge=0.0, le=87.0)]], Field(min_length=1)] = [30.0]
    width_deg: PositiveFloat = 5.0
    form: Form = "one_over_e"
    widths: PositiveFloat = 2.0
    step_deg: PositiveFloat = 0.5
    directions: Literal["plane", "lobe"] = "plane"

    @model_validator(mode="after")
    def _check_directions(self) -> "GaussianTable":
        reach = self.widths * self.width_deg
        if not reach / 200.0 <= self.step_deg <= reach:
            raise ValueError(
                f"step_deg: {self.step_deg:g} is not from {reach / 200.0:g} to the range of {reach:g} deg; correct it"
            )
        return self


CriterionTable = Annotated[Annotated[FluxTable, Tag("flux")] | Annotated[GaussianTable, Tag("gaussian")], Discriminator("kind")]


class InstrumentTable(TomlTable):
    """`[instrument]`: dimensions of the instrument. The defaults are the program's.

    `pupil_radius_mm`: radius of the exit pupil. `pupil_distance_mm`: distance of the exit pupil from the sample, over the
    mirrors. `mirror_side_mm`: side of the square mirrors. `spot_side_mm`: side of the square spot on the sample.
    `arc_radius_mm`: radius of the arc with the detectors. `detector_diameter_mm`: diameter of a detector, which is a disc.
    `field_deg`: full width of its acceptance cone. `collimated`: whether the exit pupil is at infinity, with the same
    divergence. The mirrors are then 60 mm wide, so that each turns all of the light. `obstruction`: whether the mirror unit
    blocks some directions; the paper's virtual detectors are not blocked. `lit_everywhere`: whether tilts take no light from
    the hole, as in the paper. Otherwise a lobe is seen in the light that the slit's image leaves there.
    """

    pupil_radius_mm: Positive = Dimensions.pupil_radius_mm
    pupil_distance_mm: Annotated[float, Field(gt=3.0 * Dimensions.mirror_distance_mm, le=100_000.0)] = 800.0
    mirror_side_mm: Positive = Dimensions.mirror_side_mm
    spot_side_mm: Positive = Dimensions.spot_side_mm
    arc_radius_mm: Positive = Dimensions.arc_radius_mm
    detector_diameter_mm: Positive = Dimensions.detector_diameter_mm
    field_deg: Annotated[float, Field(gt=0.0, lt=180.0)] = Dimensions.field_deg
    collimated: bool = False
    obstruction: bool = False
    lit_everywhere: bool = True

    def instrument(self) -> Instrument:
        """The instrument without deviations."""
        own = self.model_dump(exclude={"pupil_distance_mm", "collimated"})
        near = Instrument(**own, pupil_to_mirror_mm=self.pupil_distance_mm - 3.0 * Dimensions.mirror_distance_mm)
        return collimated(near) if self.collimated else near


class CombinationsTable(TomlTable):
    """`[combinations]`: how many combinations are evaluated, and how.

    `evaluator`: how all combinations are evaluated: "exact", or for a Gaussian by a "surrogate" to the second order of the
    deviations. Its worst combinations are evaluated exactly, and its error is measured and stated. `enumerate_up_to`: up to
    this number of combinations of the steps, all of them are evaluated. `draws`: number of random corners that are evaluated
    otherwise, counted with a standard error. At a corner every deviation is at one of its limits. `seed`: seed of the random
    corners.
    """

    evaluator: Literal["exact", "surrogate"] = "exact"
    enumerate_up_to: Annotated[int, Field(ge=0, le=50_000_000)] = 1_000_000
    draws: Draws = 20_000
    seed: Seed = 1


class YieldsTable(TomlTable):
    """`[yields]`: the fraction of instruments that pass if their deviations are distributed, counted with its standard error.

    `distributions`: distributions of the deviations: "uniform" within the limits, or "normal". `limit_sigmas`: limit of a
    normal distribution, in standard deviations. Its tails go beyond the limit. `draws`: number of instruments that are drawn.
    `seed`: seed of the drawn instruments.
    """

    distributions: list[Distribution] = ["uniform", "normal"]
    limit_sigmas: PositiveFloat = 2.0
    draws: Draws = 20_000
    seed: Seed = 2


class AloneTable(TomlTable):
    """`[alone]`: how far a deviation alone is increased to find its limit.

    `largest_deg`: largest angle. `largest_mm`: largest shift.
    """

    largest_deg: Annotated[float, Field(gt=0.0, le=LARGEST_DEG)] = 2.0
    largest_mm: Annotated[float, Field(gt=0.0, le=LARGEST_MM)] = 3.0


class IlluminationTable(TomlTable):
    """`[illumination]`: combinations of the study again, in the light of an illumination unit whose elements deviate as well.
    An evenly lit hole and a unit without deviations are beside them.

    `light`: "anew" has a unit with deviations of its own for each combination, at random limits. "frozen" has the unit at the
    worst corner of its deviations for all, as a rayset recorded there. With both, the difference is stated. `deviations`:
    deviations of the unit, as in a study with the criterion "flux". `draws`: number of combinations of the study's steps that
    are drawn; they are the same for every light. `seed`: seed of the drawn combinations.
    """

    light: Annotated[list[Literal["anew", "frozen"]], Field(min_length=1)] = ["anew", "frozen"]
    deviations: Annotated[list[DeviationsTable], Field(min_length=1)]
    draws: Draws = 10_000
    seed: Seed = 3


class VariantTable(TomlTable):
    """`[[variants]]`: the study again with something else, beside it.

    `name`: name of the variant. `without`: elements whose deviations it does not have. `deviations`: further deviations.
    `instrument`: its instrument; without it that of the file.
    """

    name: Annotated[str, Field(min_length=1)]
    without: list[str] = []
    deviations: list[DeviationsTable] = []
    instrument: InstrumentTable | None = None


class StudyFile(TomlTable):
    """A tolerance study: deviations of an instrument, and the criterion that their combinations have to meet.

    `name`: name of the study. `paper`: number of the paper's table that is shown beside it, 1 or 2. `criterion`: what a
    combination of deviations has to meet. `deviations`: which elements deviate, and by how much. `variants`: studies beside
    this one.
    """

    name: Annotated[str, Field(min_length=1)]
    paper: Literal[1, 2] | None = None
    criterion: CriterionTable
    deviations: Annotated[list[DeviationsTable], Field(min_length=1)]
    instrument: InstrumentTable = InstrumentTable()
    alone: AloneTable = AloneTable()
    combinations: CombinationsTable = CombinationsTable()
    yields: YieldsTable = YieldsTable()
    illumination: IlluminationTable | None = None
    variants: list[VariantTable] = []

    @model_validator(mode="after")
    def _check_elements(self) -> "StudyFile":
        flux = self.criterion.kind == "flux"
        if flux and self.combinations.evaluator == "surrogate":
            raise ValueError('combinations.evaluator: a flux has no surrogate; write "exact", or remove it')
        self._check_light(flux)
        known = ILLUMINATION_ELEMENTS if flux else (*INSTRUMENT_ELEMENTS, BEAM)
        groups = [(f"deviations.{k}", each) for k, each in enumerate(self.deviations)]
        groups += [
            (f"variants.{v}.deviations.{k}", each)
            for v, variant in enumerate(self.variants)
            for k, each in enumerate(variant.deviations)
        ]
        for place, group in groups:
            _check_known(place, group, known, f'with the criterion "{self.criterion.kind}"')
            for element in group.elements:
                if element == BEAM and (group.shifts or "ry" in group.angles):
                    raise ValueError(f"{place}: the beam turns about the sample by rx and rz alone; remove what else it has")
        self._check_largest([group for _, group in groups])
        self._check_variants()
        for variant in (None, *self.variants):
            name = "the study" if variant is None else f"the variant {variant.name!r}"
            titles = [each.title for group in self.of_variant(variant) for each in group.parameters()]
            if twice := sorted({each for each in titles if titles.count(each) > 1}):
                raise ValueError(f"deviations: {name} has {twice[0]} twice; remove one of them")
            if not 1 <= len(titles) <= MOST_DEVIATIONS:
                raise ValueError(f"deviations: {name} has {len(titles)} of them; give 1 to {MOST_DEVIATIONS}")
        return self

    def _check_largest(self, groups: Sequence[DeviationsTable]) -> None:
        """Raise ValueError where a deviation alone is not increased as far as its range."""
        for key, largest in (("deg", self.alone.largest_deg), ("mm", self.alone.largest_mm)):
            limit = max((getattr(group, f"limit_{key}") or 0.0 for group in groups), default=0.0)
            if largest < limit:
                raise ValueError(f"alone.largest_{key}: {largest:g} is less than a limit, {limit:g} {key}; give at least that")

    def _check_variants(self) -> None:
        """Raise ValueError for variants of one name, and for one that is the study itself."""
        names = [each.name for each in self.variants]
        own = {element for group in self.deviations for element in group.elements}
        for number, variant in enumerate(self.variants):
            if variant.name in names[:number]:
                raise ValueError(f"variants.{number}.name: {variant.name!r} is the name of another variant; give another one")
            if missing := [each for each in variant.without if each not in own]:
                raise ValueError(f"variants.{number}.without: the study has no deviation of {missing[0]!r}; remove it")
            if not (variant.without or variant.deviations or variant.instrument):
                raise ValueError(f"variants.{number}: {variant.name!r} is the study itself; change something, or remove it")

    def _check_light(self, flux: bool) -> None:
        instruments = [("instrument", self.instrument)]
        instruments += [
            (f"variants.{v}.instrument", each.instrument) for v, each in enumerate(self.variants) if each.instrument
        ]
        for place, each in instruments:
            if self.combinations.evaluator == "surrogate" and not each.lit_everywhere:
                raise ValueError(
                    f"{place}.lit_everywhere: the surrogate knows no edge of the slit's image; "
                    'write combinations.evaluator = "exact", or lit_everywhere = true'
                )
        if self.illumination is None:
            return
        if flux:
            raise ValueError('illumination: a study with the criterion "flux" is that of the unit itself; remove it')
        if self.instrument.collimated:
            raise ValueError("illumination: a collimated beam has no illumination unit; remove it, or collimated")
        for k, group in enumerate(self.illumination.deviations):
            _check_known(f"illumination.deviations.{k}", group, ILLUMINATION_ELEMENTS, "of the illumination unit")
        titles = [each.title for group in self.illumination.deviations for each in group.parameters()]
        if twice := sorted({each for each in titles if titles.count(each) > 1}):
            raise ValueError(f"illumination.deviations: {twice[0]} is in it twice; remove one of them")
        if len(titles) > MOST_DEVIATIONS:
            raise ValueError(f"illumination.deviations: there are {len(titles)} of them; give 1 to {MOST_DEVIATIONS}")

    def of_variant(self, variant: VariantTable | None) -> list[DeviationsTable]:
        """The deviations of a variant, or without one those of the file."""
        if variant is None:
            return self.deviations
        kept = []
        for group in self.deviations:
            elements = [each for each in group.elements if each not in variant.without]
            if elements:
                kept.append(group.model_copy(update={"elements": elements}))
        return [*kept, *variant.deviations]


def _check_known(place: str, group: DeviationsTable, known: Sequence[str], kind: str) -> None:
    for element in group.elements:
        if element not in known:
            raise ValueError(f"{place}.elements: there is no {element!r} {kind}; known are {', '.join(known)}")


def parameters_of(groups: Sequence[DeviationsTable], instrument: Instrument) -> tuple[Parameter, ...]:
    """The deviations of some tables. A tilt of the beam about the sample turns the exit pupil, and shifts it."""
    lever_mm = float(np.radians(instrument.pupil_distance_mm))
    # The pupil is at -y: turned by rz it moves along x, turned by rx against z.
    shifted = {"rz_deg": ("x_mm", lever_mm), "rx_deg": ("z_mm", -lever_mm)}
    return tuple(
        replace(each, moves=(("pupil", each.component, 1.0), ("pupil", *shifted[each.component])))
        if each.element == BEAM
        else each
        for group in groups
        for each in group.parameters()
    )


def limits_of(parameters: Sequence[Parameter]) -> Floats:
    """Limits (k,), deg or mm."""
    return np.array([each.limit for each in parameters])


def levels_of_parameters(parameters: Sequence[Parameter]) -> list[Floats]:
    """The values of each deviation, in its steps."""
    return [levels_of(each.limit, each.step) for each in parameters]


def component_matrix(parameters: Sequence[Parameter], elements: Sequence[str]) -> Floats:
    """Matrix (k, elements * 6) from values of the deviations to components of the elements, in the order of `Deviation`."""
    matrix = np.zeros((len(parameters), len(elements), len(COMPONENTS)))
    for row, parameter in zip(matrix, parameters, strict=True):
        for element, component, factor in parameter.moves:
            row[elements.index(element), COMPONENTS.index(component)] = factor
    return matrix.reshape(len(parameters), -1)


def read_study(path: Path) -> StudyFile:
    """Read a study file. Raises UserError: file, key, reason; a syntax error with its line."""
    _, content = read_toml(path)
    return validate_table(StudyFile, content, str(path))
