"""The schedule file: what is measured, where and how; one TOML file for each campaign. See docs/operate/schedule.md."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

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
from goniotwin.app.campaign.schedule.certificate import (
    Certificate,
    CertificateTable,
    ValidityTable,
    constant_certificate,
    parse_certificate,
    read_certificate,
    refuse_expired,
    today,
)
from goniotwin.app.campaign.schedule.grids import Grid, grid_values, refuse_duplicates
from goniotwin.app.campaign.schedule.metadata import MetadataTable
from goniotwin.app.campaign.schedule.refinement import NearSpecularTable, OverlapTable, StatedSymmetry, SymmetryCheckTable
from goniotwin.app.errors import UserError
from goniotwin.app.rig.file import EtalonTable, check_geometry, refuse_percentage
from goniotwin.app.toml_file import Day, TomlTable, parse_toml, read_toml, validate_table

HIGHEST_SIGMA_DEG = 87.0
"""Largest incidence of a campaign, deg. An error of incidence e changes the light on the sample by e tan(sigma).

The tolerance of 0.05 deg is 1.7 % at 87 deg and 5 % at 89, the limit that the paper's formula 5 has for everything. A
simulation has no such errors and may go further (`SIGMA_END_DEG`).
"""
LOOP_NAMES = ("gamma", "sigma", "beta", "shift", "wavelength")
"""Quantities of the loops of a measurement, in the order of the columns of a point."""

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
PositiveFraction = Annotated[float, Field(gt=0.0, lt=1.0)]
Policy = Literal["retry", "reconnect", "skip", "ask", "stop"]

KEYWORDS = {"order": ("fastest", "all five loops, the innermost first"), "gains_v_per_a": ("automatic", "gains")}
"""By key, the word that may stand in place of a list, and what the list has."""


class AveragingTable(TomlTable):
    """`[averaging]`: averaging to a target uncertainty.

    At each gain a row is read until every photodiode with light has the standard uncertainty `relative_uncertainty` (of noise
    alone), for at most `longest_s`. The schedule's `readings` is then the least number of readings.
    """

    relative_uncertainty: PositiveFraction
    longest_s: PositiveFloat = 10.0


class WarmUpTable(TomlTable):
    """`[warm_up]`: the campaign begins with a wait for the lamp, with open shutter.

    It ends when the monitor changes by no more than `percent_per_10min`, or after `longest_s`.
    """

    percent_per_10min: PositiveFloat
    longest_s: PositiveFloat = 3600.0


class DriftTable(TomlTable):
    """`[drift]`: drift checks. Every `every_s` the signal at one pose is measured again.

    The pose is `sigma_deg`, `gamma_deg`, `beta_deg` and `shift_deg`, with `wavelength_nm`. If the signal over the monitor
    differs from the first check by more than the fraction `limit`, the rows between the checks are flagged; with "stop" for
    `on_excess` the run also stops.
    """

    every_s: PositiveFloat
    sigma_deg: float
    beta_deg: float
    shift_deg: float = 0.0
    gamma_deg: float = 0.0
    wavelength_nm: PositiveFloat
    limit: PositiveFraction = 0.005
    on_excess: Literal["flag", "stop"] = "flag"


class OpenBeamTable(TomlTable):
    """`[open_beam]`: the scan of the open beam: the absolute scale that `goniotwin closure` compares with the etalon.

    At each sigma of 10 deg or more, without a sample, the photodiode in the specular direction scans the beam at `poses` by
    `poses` poses, `step_deg` apart along the arc and across it, at `wavelength_nm` (without it the middle one). At all other
    wavelengths it is read in the middle pose. With `sigma_deg` it is scanned at these of the schedule's sigmas alone. `scale`
    is that of transmitted light.
    """

    sigma_deg: Grid | None = None
    poses: Annotated[int, Field(ge=5, le=51)] = 13
    step_deg: Annotated[float, Field(ge=0.02, le=1.0)] = 0.2
    wavelength_nm: PositiveFloat | None = None
    scale: Literal["etalon", "open beam"] = "etalon"

    @field_validator("poses")
    @classmethod
    def _check_middle(cls, value: int) -> int:
        if value % 2 == 0:
            raise ValueError(f"{value} is even, so that there is no middle pose; write {value + 1}")
        return value


OpenBeamSetting = Annotated[
    Annotated[bool, Tag("bool")] | Annotated[OpenBeamTable, Tag("table")],
    Discriminator(lambda value: "bool" if isinstance(value, bool) else "table"),
]


class SecondStandardTable(ValidityTable):
    """`[second_standard]`: a second reference standard `name`, which is measured after the etalon at all of its poses.

    The two are compared, and values are scaled by both. Its certificate is `radiance_factor` (1 is the ideal diffuser) with
    its standard `relative_uncertainty`, and with `geometry`, `shape` and `calibrated` as those of `[etalon]` in the rig file;
    or `table`, the lines of a certificate's CSV file. `expires` and `accept_expired_by` are as in `[certificate]`. With
    `turned` it is the etalon itself, taken out, turned and mounted again: its certificate is the etalon's.
    """

    name: Name
    turned: bool = False
    radiance_factor: PositiveFloat | None = None
    relative_uncertainty: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    geometry: str | None = None
    shape: Annotated[float, Field(ge=0.0, lt=1.0)] | None = None
    calibrated: Day | None = None
    table: Annotated[str, Field(min_length=1)] | None = None

    @field_validator("geometry")
    @classmethod
    def _check_geometry(cls, value: str | None) -> str | None:
        check_geometry(value)
        return value

    @field_validator("radiance_factor")
    @classmethod
    def _check_factor(cls, value: float | None) -> float | None:
        if value is not None:
            refuse_percentage(value)
        return value

    @model_validator(mode="after")
    def _check_certificate(self) -> "SecondStandardTable":
        constant = {key: getattr(self, key) for key in ("radiance_factor", "relative_uncertainty")}
        given = [key for key in (*constant, "geometry", "shape", "calibrated", "table") if getattr(self, key) is not None]
        if self.expires is not None and self.turned:
            given.append("expires")
        if self.turned and given:
            raise ValueError(f"{given[0]}: a turned etalon has the etalon's certificate; remove {given[0]}, or turned")
        if self.table is not None:
            if others := [key for key in given if key != "table"]:
                raise ValueError(f"{others[0]}: the table has the certificate; remove one of them")
            try:
                parse_certificate(self.table, "table")
            except UserError as error:
                raise ValueError(str(error)) from None
        elif not self.turned and (missing := [key for key, value in constant.items() if value is None]):
            raise ValueError(
                f"{missing[0]} is missing: give radiance_factor and relative_uncertainty of its certificate, or its table; "
                "or turned = true for the etalon itself, mounted once more"
            )
        return self

    def certificate(self, of_etalon: Certificate) -> Certificate:
        """Its certificate, which is that of the etalon if it is this, turned."""
        if self.table is not None:
            return parse_certificate(self.table, "second_standard.table")
        if self.turned:
            return of_etalon
        keys = ("radiance_factor", "relative_uncertainty", "geometry", "shape", "calibrated")
        given = {key: getattr(self, key) for key in keys}
        return constant_certificate(EtalonTable(**{key: value for key, value in given.items() if value is not None}))


class StopTable(TomlTable):
    """`[stop]`: conditions that end a run in good order before its last row; it can be resumed.

    `longest_s`: time on the rig's clock in one session. `skipped_rows`: number of rows that a session may skip after faults.
    `lamp_below`: fraction of its first value at that wavelength to which the monitor's current may fall.
    """

    longest_s: PositiveFloat | None = None
    skipped_rows: PositiveInt | None = None
    lamp_below: PositiveFraction | None = None


class TargetTable(TomlTable):
    """`[target]`: what is asked of the campaign. `check` and `rehearse` warn where they predict something worse.

    `relative_u` is the largest relative standard uncertainty u (k = 1, not the expanded U) of the values that are at least the
    share `above_peak_share` of their peak. The peak is the largest value at a wavelength, sigma, gamma and side. `longest_h` is
    the longest machine time in hours, without the time to mount samples.
    """

    relative_u: PositiveFraction | None = None
    above_peak_share: PositiveFraction = 0.01
    longest_h: PositiveFloat | None = None


class FaultsTable(TomlTable):
    """`[faults]`: what happens to a row where a device fails, by the kind of fault; without this table the defaults apply.

    Kinds. `wire`: no reply, or a wrong one. `reset`: a device has lost its settings. `refused`: a device refuses a command.
    `axis`: an axis is unreferenced, or did not arrive.

    Policies. `retry`: repeat the row after `wait_s`. `reconnect`: connect the devices again, home unreferenced axes, and repeat
    the row. `skip`: skip the row and flag it. `ask`: wait until the operator has fixed the fault. `stop`: stop the run.
    A row has at most `attempts` attempts; after the last one `then` applies.
    """

    wire: Policy = "reconnect"
    reset: Policy = "reconnect"
    refused: Policy = "retry"
    axis: Policy = "stop"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    wait_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 1.0
    then: Literal["skip", "ask", "stop"] = "stop"


class ScheduleFile(TomlTable):
    """The whole file: the campaign `name`. Angles are in degrees, wavelengths in nanometres, times in seconds.

    `samples` are in the order of mounting, after the reference standard `etalon` and a `second_standard`, if any. `side` is the
    side that is lit, `light` whether reflected or transmitted light, or both, is measured, and `symmetry` that of the samples.
    The grids are `sigma_deg` (incidence, 0 to 87), `gamma_deg` (rotation of the sample), `beta_deg` (rotation of the arc),
    `shift_deg` (polar shift of the arc) and `wavelength_nm`. `near_specular` adds finer poses, `symmetry_check` mirrored ones,
    `overlap` those at which photodiodes look where their neighbours look. With `signature` the etalon's poses are measured with
    no sample as well, with `open_beam` the beam itself: in one pose with `true`, scanned with a table. `repeats` is the number
    of scans within a mounting.

    `order` is the order of the loops, and with `back_and_forth` a loop may turn round at its end. `gains_v_per_a` are the gains
    of each row, or "automatic". `readings` is their number at each gain, `dark_readings` that of a dark reading, which is no
    older than `dark_every_s`. `averaging` takes more readings in faint light. `warm_up` waits for the lamp. `drift` measures
    one pose again and again. `target` is the uncertainty and the machine time that are asked for. `stop` ends a run before its
    last row. `faults` is what happens to a row where a device fails.
    `certificate` is the etalon's. `align` is a sample with a narrow lobe by which the campaign is aligned: all values are
    corrected for the rig's misalignments as that lobe shows them. `diattenuation` is, by sample, how far the values for light
    of the sample's s and of its p are apart, over their sum: with it the polarisation of the light is in the uncertainty.
    `metadata` is what a person states about the campaign, for reports and archives.
    """

    name: Name
    side: Literal["front", "back", "both"] = "front"
    light: Literal["reflected", "transmitted", "both"] = "reflected"
    samples: Annotated[list[Name], Field(min_length=1), AfterValidator(refuse_duplicates)]
    etalon: Name
    second_standard: SecondStandardTable | None = None
    symmetry: StatedSymmetry = "isotropic"
    sigma_deg: Grid
    gamma_deg: Grid = [0.0]
    beta_deg: Grid
    shift_deg: Grid = [0.0]
    wavelength_nm: Grid
    near_specular: NearSpecularTable | None = None
    symmetry_check: SymmetryCheckTable | None = None
    overlap: OverlapTable | None = None
    signature: bool = False
    open_beam: OpenBeamSetting = False
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
    target: TargetTable | None = None
    stop: StopTable | None = None
    faults: FaultsTable | None = None
    certificate: CertificateTable | None = None
    align: Name | None = None
    diattenuation: dict[Name, Annotated[float, Field(ge=0.0, le=1.0)]] = {}
    metadata: MetadataTable = MetadataTable()

    @field_validator("sigma_deg")
    @classmethod
    def _refuse_grazing(cls, value: Grid) -> Grid:
        outside = [each for each in grid_values(value) if not 0.0 <= each <= HIGHEST_SIGMA_DEG]
        if outside:
            raise ValueError(
                f"{outside[0]:g} deg is not from 0 to {HIGHEST_SIGMA_DEG:g}: closer to grazing, a tilt of 0.05 deg changes "
                "the light on the sample by more than 1.7 %. For light from behind "
                'set side = "back", with sigma from the normal of the back'
            )
        return value

    @model_validator(mode="after")
    def _check_names(self) -> "ScheduleFile":
        if self.etalon in self.samples:
            raise ValueError(
                f"samples: the etalon {self.etalon!r} is among the samples; it is always measured, so remove it there"
            )
        for key, named in (("diattenuation", {*self.diattenuation}), ("metadata.samples", {*self.metadata.samples})):
            if unknown := sorted(named - {*self.samples}):
                raise ValueError(f"{key}: {unknown[0]!r} is not among the samples; name one of them, or remove it")
        if self.align is not None and self.align not in self.samples:
            raise ValueError(f"align: {self.align!r} is not among the samples; name one of them, or remove it")
        if self.second_standard is not None and self.second_standard.name in (self.etalon, *self.samples):
            raise ValueError(
                f"second_standard.name: {self.second_standard.name!r} is the etalon or a sample already; give it a name of its "
                "own, also if it is the etalon turned"
            )
        if NO_SAMPLE in self.mounted:
            raise ValueError(f"{NO_SAMPLE!r} is the name of the empty sample unit; give the sample another name")
        return self

    @model_validator(mode="after")
    def _check_open_beam(self) -> "ScheduleFile":
        scan = self.open_beam_scan
        wavelengths = grid_values(self.wavelength_nm)
        if scan is not None and scan.wavelength_nm not in (None, *wavelengths):
            raise ValueError(f"open_beam.wavelength_nm: {scan.wavelength_nm:g} is not in wavelength_nm; choose one of these")
        if unknown := sorted({*self.scanned_sigmas_deg} - {*grid_values(self.sigma_deg)}):
            raise ValueError(f"open_beam.sigma_deg: {unknown[0]:g} is not in sigma_deg; choose one of these")
        return self

    @property
    def standards(self) -> tuple[str, ...]:
        """The names of the reference standards: the etalon, and the second one if there is one."""
        return (self.etalon,) if self.second_standard is None else (self.etalon, self.second_standard.name)

    @property
    def standard_factors(self) -> dict[str, float | None]:
        """The mean radiance factor of each standard by the certificate in the schedule; None for that of the etalon."""
        second = self.second_standard
        if second is None:
            return {self.etalon: None}
        certificate = None if second.turned else second.certificate(constant_certificate(EtalonTable()))
        return {self.etalon: None, second.name: None if certificate is None else float(certificate.factor.mean())}

    @property
    def mounted(self) -> tuple[str, ...]:
        """The names of all that is mounted, in this order: the standards, then the samples."""
        return (*self.standards, *self.samples)

    @property
    def scanned_sigmas_deg(self) -> tuple[float, ...]:
        """The sigmas at which the open beam is to be scanned, where it can be."""
        scan = self.open_beam_scan
        return grid_values(self.sigma_deg if scan is None or scan.sigma_deg is None else scan.sigma_deg)

    @property
    def open_beam_scan(self) -> OpenBeamTable | None:
        """The table of the scan of the open beam, if there is one."""
        return self.open_beam if isinstance(self.open_beam, OpenBeamTable) else None

    @field_validator("order", "gains_v_per_a", mode="before")
    @classmethod
    def _check_keyword(cls, value: object, info: ValidationInfo) -> object:
        word, content = KEYWORDS[str(info.field_name)]
        if isinstance(value, str) and value != word:
            raise ValueError(f"should be {word!r} or a list of {content}, not {value!r}")
        return value

    @field_validator("order")
    @classmethod
    def _check_loops(cls, value: OrderSetting) -> OrderSetting:
        if value != "fastest" and sorted(value) != sorted(LOOP_NAMES):
            raise ValueError(f"must list each of {', '.join(LOOP_NAMES)} once, the innermost first")
        return value

    @model_validator(mode="after")
    def _check_symmetry(self) -> "ScheduleFile":
        if self.symmetry_check is not None and self.symmetry == "anisotropic":
            raise ValueError(
                "symmetry_check: an anisotropic sample has no symmetry to check; remove [symmetry_check], or change symmetry"
            )
        return self


@dataclass(frozen=True)
class ScheduleDescription:
    """A schedule: its text, the parsed file, the file's name, and the text of the certificate that it names."""

    text: str
    file: ScheduleFile
    name: str
    certificate: str | None = None


def read_schedule(path: Path) -> ScheduleDescription:
    """Read a schedule file, and the certificate that it names. Raises UserError: file, key, reason; and if one has expired."""
    text, content = read_toml(path)
    return _described(text, content, path)


def schedule_at(text: str, path: Path) -> ScheduleDescription:
    """The schedule that a text is as the file at a path, which has another text or none yet. Raises as `read_schedule`."""
    return _described(text, parse_toml(text, str(path)), path)


def _described(text: str, content: dict[str, Any], path: Path) -> ScheduleDescription:
    if "axes" in content and "sigma_deg" not in content:
        raise UserError(f"{path}: looks like a rig file, not like a schedule; open it as a rig")
    file = validate_table(ScheduleFile, content, str(path))
    certificate = None if file.certificate is None else read_certificate(path.parent, file.certificate)
    if file.second_standard is not None:
        refuse_expired(file.second_standard, today(), f"{path}: second_standard", "second standard", "second_standard")
    return ScheduleDescription(text, file, str(path), certificate)


def parse_schedule(text: str, name: str) -> ScheduleDescription:
    """Parse the text of a schedule, such as a journal has it; without the certificate. Raises UserError."""
    return ScheduleDescription(text, validate_table(ScheduleFile, parse_toml(text, name), name), name)
