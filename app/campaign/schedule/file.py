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
    """`[averaging]`: readings until a target uncertainty is reached. The schedule's `readings` is then their least number.

    `relative_uncertainty`: target for every photodiode with light: the relative standard uncertainty by noise alone.
    `longest_s`: longest time that a row is read at one gain, even if the target is not reached.
    """

    relative_uncertainty: PositiveFraction
    longest_s: PositiveFloat = 10.0


class WarmUpTable(TomlTable):
    """`[warm_up]`: wait for the lamp at the start of the campaign, with open shutter and no sample.

    `percent_per_10min`: the wait ends when the monitor changes by no more than this in 10 minutes. `longest_s`: longest wait;
    after it the campaign continues, and the row is flagged.
    """

    percent_per_10min: PositiveFloat
    longest_s: PositiveFloat = 3600.0


class DriftTable(TomlTable):
    """`[drift]`: drift checks, which measure one pose again and again. They compare the signal over the monitor with the first
    check of the mounting.

    `every_s`: time between two checks. There is also one after each mounting and one before the next. `sigma_deg`: the rig's
    sigma at the pose of the checks; beyond 90 deg the light comes from behind. `beta_deg`: beta at the pose of the checks.
    `shift_deg`: shift of the arc at this pose. `gamma_deg`: gamma at this pose. `wavelength_nm`: wavelength of the checks.
    `limit`: largest permitted change, as a fraction. If it is exceeded, the rows between the checks are flagged. `on_excess`:
    "stop" also ends the run if the limit is exceeded; "flag" does not.
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
    """`[open_beam]`: scan of the open beam, with no sample mounted. It gives the absolute scale that `goniotwin closure`
    compares with the etalon. At each sigma of 10 deg or more, the photodiode in the specular direction scans the beam.

    `sigma_deg`: the schedule's sigmas at which the beam is scanned; without it all from 10 deg on. `poses`: number of poses
    along the arc, and also of those across it; odd, so that there is a middle pose. `step_deg`: distance of two poses.
    `wavelength_nm`: wavelength of the scan; without it the middle one of the schedule. At the other wavelengths the beam is
    read in the middle pose alone. `scale`: which scale transmitted values have: that of the etalon, or that of the open beam.
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
    """`[second_standard]`: a second reference standard, measured after the etalon at all of its poses. The two are compared,
    and values are scaled by both.

    `name`: name of the second standard, which no sample has. `turned`: whether it is the etalon itself, taken out, turned and
    mounted again. It then has the etalon's certificate. `radiance_factor`: its certified radiance factor; 1 is the ideal
    diffuser. `relative_uncertainty`: relative standard uncertainty of the radiance factor. `geometry`: geometry of the
    certificate's measurement, such as "8:d". The value is taken for all directions, and the uncertainty then includes `shape`.
    `shape`: relative standard uncertainty of its deviation from the ideal diffuser, at the normal; 0.03 if it is not given.
    `calibrated`: day of the calibration. `table`: the lines of a certificate's CSV file, in place of these keys of a
    certificate.
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
    """`[stop]`: conditions that end a run in good order before its last row. It can be resumed.

    `longest_s`: longest duration of a session, on the rig's clock. `skipped_rows`: number of rows, skipped after faults in this
    session, at which the run ends. `lamp_below`: the run ends when the monitor's current is below this fraction of its first
    value at the wavelength.
    """

    longest_s: PositiveFloat | None = None
    skipped_rows: PositiveInt | None = None
    lamp_below: PositiveFraction | None = None


class TargetTable(TomlTable):
    """`[target]`: what is asked of the campaign. `check` and `rehearse` warn where they predict something worse.

    `relative_u`: largest relative standard uncertainty u (k = 1, not the expanded U) of the values near the peak.
    `above_peak_share`: share of the peak from which on values count. The peak is the largest value at a wavelength, sigma,
    gamma and side. `longest_h`: longest machine time in hours, without the time to mount samples.
    """

    relative_u: PositiveFraction | None = None
    above_peak_share: PositiveFraction = 0.01
    longest_h: PositiveFloat | None = None


class FaultsTable(TomlTable):
    """`[faults]`: what happens to a row when a device fails, by the kind of fault. Without this table the defaults apply.
    "retry" repeats the row after a wait. "reconnect" connects the devices again, homes unreferenced axes and repeats the row.
    "skip" flags the row and continues with the next one. "ask" waits until the operator has fixed the fault. "stop" ends the
    run.

    `wire`: what happens after a reply that is missing or wrong. `reset`: what happens if a device has lost its settings.
    `refused`: what happens if a device refuses a command. `axis`: what happens if an axis is unreferenced or did not arrive.
    `attempts`: largest number of attempts of a row. `wait_s`: wait before "retry" repeats the row. `then`: what happens after
    the last attempt.
    """

    wire: Policy = "reconnect"
    reset: Policy = "reconnect"
    refused: Policy = "retry"
    axis: Policy = "stop"
    attempts: Annotated[int, Field(ge=1, le=100)] = 3
    wait_s: Annotated[float, Field(ge=0.0, le=3600.0)] = 1.0
    then: Literal["skip", "ask", "stop"] = "stop"


class ScheduleFile(TomlTable):
    """A schedule: what a campaign measures, where and how. Angles are in degrees, wavelengths in nanometres, times in seconds.

    `name`: name of the campaign. `side`: side of the samples that is lit. `light`: whether reflected or transmitted light is
    measured, or both. Both arcs are read in any case; this decides from which side the etalon is lit. `samples`: names of the
    samples, in the order of mounting. `etalon`: name of the reference standard, which is mounted before them. `symmetry`:
    symmetry of the samples. Poses that are mirror images of others are not measured. `sigma_deg`: angles of incidence from the
    normal of the lit side, 0 to 87. `gamma_deg`: rotations of the sample about its normal. `beta_deg`: rotations of the arc
    about the vertical axis: the azimuths of observation. `shift_deg`: polar shifts of the arc along itself. `wavelength_nm`:
    wavelengths of the monochromator.

    `signature`: whether the poses of the etalon are also measured with no sample mounted. `open_beam`: a table scans the beam
    with no sample mounted; `true` reads it in one pose, which gives no scale. `repeats`: number of scans within a mounting.

    `order`: order of the loops, the innermost first; "fastest" chooses the one that takes the least time. `back_and_forth`:
    whether a loop may turn round at its end, so that every second pass runs backwards. `gains_v_per_a`: gains at which each row
    is read. "automatic" begins with the highest, and lowers it until no photodiode is saturated. `readings`: number of readings
    of a row at each gain. `dark_every_s`: greatest age of a dark reading at the end of a row. `dark_readings`: number of
    readings in a dark reading.

    `align`: name of a sample with a narrow lobe. All values are corrected for the misalignments of the rig that this lobe
    shows. `diattenuation`: for each sample, the difference of its values for light polarised in s and in p, over their sum. The
    uncertainty then includes the polarisation of the light.
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
