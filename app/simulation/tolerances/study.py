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

    `elements` are those of the criterion: of the instrument (pupil, mirror_1 to mirror_3, mirror_unit, sample, arc, sensor, and
    beam, the light turned about the sample), or of the illumination unit (arc, reflector, input_condenser, slit,
    output_condenser, unit). `angles` of rx, ry, rz are within +-`limit_deg`, in steps of `step_deg`; `shifts` of x, y, z within
    +-`limit_mm`, in steps of `step_mm`. Without a step there are three values: minus the limit, zero, and the limit.
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
    """The criterion of `kind` "flux": the flux into the central 5 x 5 mm of the sample, relative to that without deviations.

    A combination passes if the flux differs by no more than `within_percent`; the first limit decides, shares are stated for
    all. Every combination is evaluated by a quadrature; the worst is confirmed by `rays` adjoint rays, with random numbers of
    `seed`.
    """

    kind: Literal["flux"]
    within_percent: Within = [5.0, 10.0]
    rays: Annotated[int, Field(ge=100, le=100_000_000)] = 1_000_000
    seed: Seed = 0


class GaussianTable(TomlTable):
    """The criterion of `kind` "gaussian": formula 5 between a Gaussian sample, simulated, and its formula.

    A combination passes if the relative RMS is at most `within_percent`; the first limit decides, shares are stated for all.
    The Gaussian has `width_deg` in the meaning of `form`. The range of i in formula 5: every angle `sigma_deg`, and the
    `directions`, in the "plane" of incidence or in the whole "lobe", up to `widths` widths from the specular direction, in
    steps of `step_deg`, with a zenith angle below 85 deg.
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
    """`[instrument]`: dimensions of the instrument in mm and deg; without it those of the program.

    The exit pupil has `pupil_radius_mm`, at `pupil_distance_mm` from the sample, over the mirrors. With `collimated` it is at
    infinity, with the same divergence, and the mirrors are 60 mm wide: each mirror then turns the light in full. The mirrors
    are `mirror_side_mm` wide, the spot is `spot_side_mm`. The detectors are discs of `detector_diameter_mm` at `arc_radius_mm`
    with a field of `field_deg`. With `obstruction` the mirror unit blocks some directions; the paper's virtual detectors are
    not blocked. With `lit_everywhere`, as in the paper, tilts take no light from the hole; without it a lobe is seen in the
    light that the slit's image leaves there.
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
    """`[combinations]`: how many combinations are evaluated.

    All combinations of the steps if there are no more than `enumerate_up_to`. Otherwise `draws` random corners, every deviation
    at one of its limits, counted with a standard error. `seed` is that of the random numbers.

    `evaluator` of all combinations: "exact", or for a Gaussian a "surrogate" to the second order of the deviations, whose worst
    combinations are evaluated exactly and whose error is measured and stated.
    """

    evaluator: Literal["exact", "surrogate"] = "exact"
    enumerate_up_to: Annotated[int, Field(ge=0, le=50_000_000)] = 1_000_000
    draws: Draws = 20_000
    seed: Seed = 1


class YieldsTable(TomlTable):
    """`[yields]`: the share of instruments that pass if their deviations are distributed, counted with its standard error.

    `distributions`: "uniform" within the limits, or "normal" with the limits at `limit_sigmas` standard deviations. `draws`
    instruments are drawn with random numbers of `seed`.
    """

    distributions: list[Distribution] = ["uniform", "normal"]
    limit_sigmas: PositiveFloat = 2.0
    draws: Draws = 20_000
    seed: Seed = 2


class AloneTable(TomlTable):
    """`[alone]`: how far a deviation alone is increased to find its limit: up to `largest_deg` or `largest_mm`."""

    largest_deg: Annotated[float, Field(gt=0.0, le=LARGEST_DEG)] = 2.0
    largest_mm: Annotated[float, Field(gt=0.0, le=LARGEST_MM)] = 3.0


class IlluminationTable(TomlTable):
    """`[illumination]`: combinations of the study again, in the light of an illumination unit whose elements deviate as well.

    `light`: "anew", for each combination a unit with deviations of its own, at random limits; "frozen", as in the paper: all
    combinations have the unit at the worst corner of its deviations, as a rayset recorded there; or both, with their
    difference. An evenly lit hole and a unit without deviations are beside them. `deviations` are those of the unit, as in a
    study with the criterion "flux". `draws` combinations of the study's steps, the same for every light, are drawn with random
    numbers of `seed`.
    """

    light: Annotated[list[Literal["anew", "frozen"]], Field(min_length=1)] = ["anew", "frozen"]
    deviations: Annotated[list[DeviationsTable], Field(min_length=1)]
    draws: Draws = 10_000
    seed: Seed = 3


class VariantTable(TomlTable):
    """`[[variants]]`: the study again with something else, beside it under its `name`.

    `without` are elements whose deviations are not in it, `deviations` are further ones, `instrument` replaces that of the
    file.
    """

    name: Annotated[str, Field(min_length=1)]
    without: list[str] = []
    deviations: list[DeviationsTable] = []
    instrument: InstrumentTable | None = None


class StudyFile(TomlTable):
    """The whole file: the `name` of the study, and `paper`, the number of the paper's table beside it (1 or 2).

    `criterion` is what a combination of deviations has to keep, `deviations` which elements deviate and by how much. For a
    Gaussian criterion `instrument` has the dimensions, and `illumination` the deviations of the light. `alone`, `combinations`
    and `yields` are settings of the stages. `variants` are studies beside this one.
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
