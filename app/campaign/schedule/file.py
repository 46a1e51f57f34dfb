"""The schedule: what the operator wants measured, one TOML file a campaign."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    AfterValidator,
    Discriminator,
    Field,
    PositiveFloat,
    PositiveInt,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from goniotwin.app.campaign.row import NO_SAMPLE
from goniotwin.app.campaign.schedule.certificate import CertificateTable, read_certificate
from goniotwin.app.campaign.schedule.grids import Grid, grid_values, refuse_duplicates
from goniotwin.app.campaign.schedule.refinement import NearSpecularTable, OverlapTable, Symmetry, SymmetryCheckTable
from goniotwin.app.toml_file import TomlTable, parse_toml, read_toml, validate_table

HIGHEST_SIGMA_DEG = 87.0
LOOP_NAMES = ("gamma", "sigma", "beta", "shift", "wavelength")
"""What the loops of a measurement go over."""

Name = Annotated[str, Field(min_length=1, pattern=r"^[^/\s][^/\r\n\t]*$")]
GainsSetting = Annotated[
    Annotated[Literal["automatic"], Tag("automatic")]
    | Annotated[list[PositiveFloat], Field(min_length=1), AfterValidator(refuse_duplicates), Tag("list")],
    Discriminator(lambda value: "automatic" if isinstance(value, str) else "list"),
]
OrderSetting = Annotated[
    Annotated[Literal["fastest"], Tag("fastest")]
    | Annotated[list[Literal["gamma", "sigma", "beta", "shift", "wavelength"]], Tag("list")],
    Discriminator(lambda value: "fastest" if isinstance(value, str) else "list"),
]

Fraction = Annotated[float, Field(gt=0.0, lt=1.0)]
Policy = Literal["retry", "reconnect", "skip", "ask", "stop"]

KEYWORDS = {"order": ("fastest", "all five loops, the innermost first"), "gains_v_per_a": ("automatic", "gains")}
"""What may stand in place of a list."""


class AveragingTable(TomlTable):
    """Each row is read on, at each of its gains, until every photodiode that has light knows it to `relative_uncertainty`
    (standard, of noise alone), or for `longest_s`. The schedule's `readings` are then the fewest.
    """

    relative_uncertainty: Fraction
    longest_s: PositiveFloat = 10.0


class WarmUpTable(TomlTable):
    """The campaign begins with a wait for the lamp, with open shutter: until the monitor changes by no more than
    `percent_per_10min`, or for `longest_s`.
    """

    percent_per_10min: PositiveFloat
    longest_s: PositiveFloat = 3600.0


class DriftTable(TomlTable):
    """Every `every_s` the light at one pose is measured again. Where it, over the monitor's, is another than it was at first
    by more than `limit` (a share), the rows between the checks are flagged, or the run stops as well.
    """

    every_s: PositiveFloat
    sigma_deg: float
    beta_deg: float
    shift_deg: float = 0.0
    gamma_deg: float = 0.0
    wavelength_nm: PositiveFloat
    limit: Fraction = 0.005
    on_excess: Literal["flag", "stop"] = "flag"


class StopTable(TomlTable):
    """What ends a run before its last row, in good order: it can be gone on with.

    `longest_s` is of the rig's time in one session; `skipped_rows` how many rows of a session may be skipped for faults;
    `lamp_below` the share to which the monitor's current may fall of what it was at first at that wavelength.
    """

    longest_s: PositiveFloat | None = None
    skipped_rows: PositiveInt | None = None
    lamp_below: Fraction | None = None


class FaultsTable(TomlTable):
    """What is done where a device fails in a row, by the kind of fault; without this table the run stops safely.

    `wire`: no answer, or a wrong one. `reset`: a device has lost its settings. `refused`: it will not, or cannot. `axis`: it is
    in doubt where an axis is, or it did not arrive. The policies: `retry`: the row again, after `wait_s`. `reconnect`: the
    devices are connected again, axes in doubt are homed, and the row is done again. `skip`: the row is left out and flagged.
    `ask`: somebody is asked to mend it. `stop`. A row is begun `attempts` times at most; `then` is what follows.
    """

    wire: Policy = "reconnect"
    reset: Policy = "reconnect"
    refused: Policy = "retry"
    axis: Policy = "stop"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    wait_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 1.0
    then: Literal["skip", "ask", "stop"] = "stop"


class ScheduleFile(TomlTable):
    """The whole file. Angles in degrees, wavelengths in nanometres, times in seconds."""

    name: Name
    side: Literal["front", "back", "both"] = "front"
    light: Literal["reflected", "transmitted", "both"] = "reflected"
    samples: Annotated[list[Name], Field(min_length=1), AfterValidator(refuse_duplicates)]
    etalon: Name
    symmetry: Symmetry = "isotropic"
    sigma_deg: Grid
    gamma_deg: Grid = [0.0]
    beta_deg: Grid
    shift_deg: Grid = [0.0]
    wavelength_nm: Grid
    near_specular: NearSpecularTable | None = None
    symmetry_check: SymmetryCheckTable | None = None
    overlap: OverlapTable | None = None
    signature: bool = False
    open_beam: bool = False
    repeats: Annotated[int, Field(ge=1, le=1000)] = 1
    order: OrderSetting = "fastest"
    back_and_forth: bool = True
    gains_v_per_a: GainsSetting
    readings: Annotated[int, Field(ge=1, le=10_000)] = 4
    dark_every_s: PositiveFloat = 60.0
    dark_readings: Annotated[int, Field(ge=4, le=10_000)] = 16
    averaging: AveragingTable | None = None
    warm_up: WarmUpTable | None = None
    drift: DriftTable | None = None
    stop: StopTable | None = None
    faults: FaultsTable | None = None
    certificate: CertificateTable | None = None

    @field_validator("sigma_deg")
    @classmethod
    def _not_grazing(cls, value: Grid) -> Grid:
        outside = [each for each in grid_values(value) if not 0.0 <= each <= HIGHEST_SIGMA_DEG]
        if outside:
            raise ValueError(
                f"{outside[0]:g} deg is not from 0 to {HIGHEST_SIGMA_DEG:g}: beyond, light only grazes the sample; "
                'for light from behind say side = "back", and count from the back\'s own normal'
            )
        return value

    @model_validator(mode="after")
    def _etalon_is_no_sample(self) -> "ScheduleFile":
        if self.etalon in self.samples:
            raise ValueError(f"the etalon {self.etalon!r} stands among the samples; it is measured anyway, so remove it")
        if NO_SAMPLE in (self.etalon, *self.samples):
            raise ValueError(f"{NO_SAMPLE!r} is what an empty sample unit is called; give the sample another name")
        return self

    @field_validator("order", "gains_v_per_a", mode="before")
    @classmethod
    def _word_or_list(cls, value: object, info: ValidationInfo) -> object:
        word, listed = KEYWORDS[str(info.field_name)]
        if isinstance(value, str) and value != word:
            raise ValueError(f"should be {word!r} or a list of {listed}, not {value!r}")
        return value

    @field_validator("order")
    @classmethod
    def _every_loop_once(cls, value: OrderSetting) -> OrderSetting:
        if value != "fastest" and sorted(value) != sorted(LOOP_NAMES):
            raise ValueError(f"must name each of {', '.join(LOOP_NAMES)} once, the innermost first")
        return value

    @model_validator(mode="after")
    def _symmetry_to_check(self) -> "ScheduleFile":
        if self.symmetry_check is not None and self.symmetry == "anisotropic":
            raise ValueError("symmetry_check: there is nothing to check where symmetry is anisotropic; remove one of them")
        return self


@dataclass(frozen=True)
class ScheduleDescription:
    """A schedule file that has been read: its text, what it says, and the text of the etalon's certificate that it names."""

    text: str
    file: ScheduleFile
    name: str
    certificate: str | None = None


def read_schedule(path: Path) -> ScheduleDescription:
    """A schedule file. Raises UserError: file, key, reason."""
    text, content = read_toml(path)
    file = validate_table(ScheduleFile, content, str(path))
    certificate = None if file.certificate is None else read_certificate(path.parent, file.certificate)
    return ScheduleDescription(text, file, str(path), certificate)


def parse_schedule(text: str, name: str) -> ScheduleDescription:
    """A schedule's text, such as a journal holds. Raises UserError."""
    return ScheduleDescription(text, validate_table(ScheduleFile, parse_toml(text, name), name), name)
