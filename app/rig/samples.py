"""`[twin.samples]`: what the virtual rig's back door can mount, as people write it, and the scattering model it makes.

A sample in one line: models with their keys, added up with `+`.

gaussian:width_deg=5,form=half_width
lambertian:reflectance=0.5+gaussian:width_deg=3,reflectance=0.3
lambertian:reflectance=0.5+regular:reflectance=0.04
table:paint.bsdf,side=back

A model acts on light from the front; `side=back` makes it act on light from the back, `side=both` on either.

A sample in one line, as `goniotwin simulate` takes it, as the table that a rig file has for it.
"""

import re
from pathlib import Path
from typing import Annotated, Any, Literal, cast, get_args

import numpy as np
from pydantic import Field, model_validator

from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, FormatError, bsdf, read_ddr
from goniotwin.app.formats.zemax import ZemaxBsdf, read_zemax
from goniotwin.app.toml_file import TomlTable, validate_table
from goniotwin.twin.optics import Scatterer, gaussian, lambertian, regular, spectral_table, sum_samples, table_sample

Side = Literal["front", "back", "both"]


class LambertianTable(TomlTable):
    """A perfect diffuser of some reflectance, and of some transmittance."""

    model: Literal["lambertian"]
    reflectance: float = 1.0
    transmittance: float = 0.0
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_diffuser(self) -> "LambertianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The diffuser. Raises ValueError for shares of the light that are none."""
        return lambertian(self.reflectance, self.transmittance, self.side)


class GaussianTable(TomlTable):
    """A Gaussian lobe round the specular direction (the paper's formula 6), or round the transmitted one."""

    model: Literal["gaussian"]
    width_deg: float
    form: Literal["one_over_e", "half_width"] = "one_over_e"
    quantity: Literal["luminance", "intensity"] = "luminance"
    peak: float | None = None
    reflectance: float | None = None
    transmits: bool = False
    refraction: float = 1.0
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_lobe(self) -> "GaussianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The lobe. Raises ValueError for a width or a height that is none."""
        return gaussian(
            self.width_deg, self.form, self.quantity, self.peak, self.reflectance, self.transmits, self.refraction, self.side
        )


class RegularTable(TomlTable):
    """A mirror or a clear sheet: a share of the light, or a list of shares over the incidences `sigma_deg`."""

    model: Literal["regular"]
    reflectance: float | list[float] = 1.0
    sigma_deg: list[float] | None = None
    transmits: bool = False
    side: Side = "front"

    @model_validator(mode="after")
    def _makes_a_mirror(self) -> "RegularTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The mirror. Raises ValueError for shares that are none, or a list that does not fit."""
        return regular(self.reflectance, self.transmits, self.side, self.sigma_deg)


class MeasuredTable(TomlTable):
    """A table of a Zemax `.bsdf` file, named from where the rig file is; a BTDF transmits."""

    model: Literal["zemax"]
    file: str
    side: Side = "front"


LobeTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable, Field(discriminator="model")]


class SumTable(TomlTable):
    """Several models at once, each scattering its share."""

    model: Literal["sum"]
    lobes: Annotated[list[LobeTable], Field(min_length=1)]


SampleTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable | SumTable, Field(discriminator="model")]


def scatterer(sample: SampleTable, folder: Path, place: str) -> Scatterer:
    """The model; files are looked for from `folder`. Raises UserError that begins with `place`, the sample's in its file."""
    if isinstance(sample, SumTable):
        return sum_samples(*[scatterer(lobe, folder, f"{place}.lobes.{i}") for i, lobe in enumerate(sample.lobes)])
    if not isinstance(sample, MeasuredTable):
        return sample.scatterer()
    try:
        return _from_zemax(read_zemax(folder / sample.file), sample.side)
    except (FormatError, ValueError) as error:
        raise UserError(f"{place}: {error}") from None


def _from_zemax(table: ZemaxBsdf, side: Side) -> Scatterer:
    """An isotropic sample from a Zemax table. Raises ValueError for one that is not."""
    if len(table.sample_rotation_deg) != 1:
        raise ValueError(f"it has {len(table.sample_rotation_deg)} sample rotations; a sample here needs exactly one")
    transmits = table.scatter_type.upper() == "BTDF"
    axes = (table.incidence_deg, table.azimuth_deg, table.radial_deg)
    return table_sample(*axes, table.values[0], side=side, transmits=transmits)


FORMULAS: dict[str, type[GaussianTable] | type[LambertianTable] | type[RegularTable]] = {
    "gaussian": GaussianTable,
    "lambertian": LambertianTable,
    "regular": RegularTable,
}
MODELS = (
    "gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, table:FILE (.bsdf or .ddr), "
    "and sums of them with +"
)
# A plus that begins a model, not one of a number (1e+1) or of a file's name.
PLUS = re.compile(rf"\+(?=\s*(?:[A-Za-z_-]+\s*:|(?:{'|'.join(FORMULAS)}|table)\s*(?:\+|$)))")
# What may follow a file's name, which may have commas of its own.
FILE_SIDE = re.compile(r",\s*side\s*=\s*(\w*)\s*$")
NOT_HERE = {"gaussian": ("model",), "lambertian": ("model",), "regular": ("model", "sigma_deg")}
"""Keys of a rig file's samples that are not for one line: a list has no place in it."""
ALL_OF_THE_LIGHT = 1.001
MEASURED_LIGHT = 1.5
"""What is measured may be wrong by much, and is simulated all the same; beyond this it is no reflectance at all."""


def parse_sample(text: str) -> Scatterer:
    """The scattering model that the text says; its name is the text.

    Raises UserError of one line for an unknown model, key or value, for a file that cannot be read, and for models of
    formulas that together give back more light than they get.
    """
    parts = [part.strip() for part in PLUS.split(text)]
    models = [_model(part) for part in parts]
    sample = sum_samples(*models, name=text.strip())
    _check_light(sample, MEASURED_LIGHT if any(part.startswith("table") for part in parts) else ALL_OF_THE_LIGHT)
    return sample


def table_files(text: str) -> list[Path]:
    """The files that a sample is read from."""
    parts = [part.strip() for part in PLUS.split(text)]
    return [_file_and_side(part)[0] for part in parts if part.partition(":")[0].strip() == "table"]


def _file_and_side(part: str) -> tuple[Path, str]:
    rest = part.partition(":")[2].strip()
    side = FILE_SIDE.search(rest)
    return (Path(rest), "front") if side is None else (Path(rest[: side.start()].strip()), side[1])


def _model(part: str) -> Scatterer:
    name, colon, rest = part.partition(":")
    name, rest = name.strip(), rest.strip()
    place = f"--sample {name or part!r}"
    if name == "table":
        if not rest:
            raise UserError(f"{place}: names no file; write table:FILE")
        path, side = _file_and_side(part)
        if side not in get_args(Side):
            raise UserError(f"{place}: side is {side!r}; give {', '.join(get_args(Side))}: where the light comes from")
        return _table(path, cast(Side, side), place)
    if name not in FORMULAS:
        raise UserError(f"--sample: there is no model {name!r}; give {MODELS}")
    if colon and not rest:
        raise UserError(f"{place}: nothing follows the colon; keys are {_keys(name)}")
    entries = _entries(rest, name, place)
    try:
        return validate_table(FORMULAS[name], {"model": name, **entries}, place).scatterer()
    except UserError as error:
        raise UserError(str(error).replace(": the file: ", ": ", 1)) from None


def _entries(text: str, name: str, place: str) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for entry in text.split(",") if text else ():
        key, equals, value = (word.strip() for word in entry.partition("="))
        if not equals or not value:
            raise UserError(f"{place}: {entry.strip()!r} is not key=value; keys are {_keys(name)}")
        if key in NOT_HERE[name] or key not in FORMULAS[name].model_fields:
            raise UserError(f"{place}: there is no key {key!r}; keys are {_keys(name)}")
        if key in entries:
            raise UserError(f"{place}: {key} is given twice; leave one of them")
        entries[key] = _value(value)
    return entries


def _value(text: str) -> bool | float | str:
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text


def _keys(name: str) -> str:
    return ", ".join(key for key in FORMULAS[name].model_fields if key not in NOT_HERE[name])


def _table(path: Path, side: Side, place: str) -> Scatterer:
    if path.suffix.lower() not in (".ddr", ".ddt"):
        return scatterer(MeasuredTable(model="zemax", file=str(path), side=side), Path(), place)
    try:
        return _from_ddr(read_ddr(path), path, side)
    except FormatError as error:
        raise UserError(f"{place}: {error}") from None
    except ValueError as error:
        raise UserError(f"{place}: {path}: {error}") from None


def _from_ddr(table: DdrTable, path: Path, side: Side) -> Scatterer:
    values = bsdf(table)
    psi = table.psi_deg if table.psi_deg.size > 1 else None
    if psi is None:
        values = values[:, 0]
    transmits = path.suffix.lower() == ".ddt"
    axes = (table.sigma_deg, table.phi_deg, table.theta_deg)
    if table.channels == (None,):
        return table_sample(*axes, values[0], path.name, psi, side=side, transmits=transmits)
    wavelengths = [nm or 0.0 for nm in table.channels]
    return spectral_table(wavelengths, *axes, values, path.name, psi, side=side, transmits=transmits)


def _check_light(sample: Scatterer, limit: float) -> None:
    """Raises UserError where more than `limit` times the light that arrives is given back, at any wavelength.

    At normal incidence: away from it the lobes of the formulas give back less.
    """
    spectrum = sample.spectrum
    weights = np.ones((len(sample.lobes), 1)) if spectrum is None else spectrum.weights
    # From the front in the first row, from the back in the second.
    shares = np.array(
        [[lobe.albedo(0.0) if lobe.incident == incident else 0.0 for lobe in sample.lobes] for incident in (1, -1)]
    )
    most = float(np.max(shares @ weights))
    if most > limit:
        raise UserError(
            f"--sample {sample.name!r}: gives back {most:.3g} times the light that it gets at normal incidence; "
            "lower its reflectances (a gaussian has 0.9 unless told), or look what quantity and unit a table has"
        )


def sample_table(text: str) -> dict[str, Any]:
    """The entries of `[twin.samples.NAME]`. Raises UserError for a model that is none, or that a rig file cannot name."""
    parse_sample(text)  # says in its own words what is wrong with it
    lobes = [_lobe(part.strip()) for part in PLUS.split(text)]
    return lobes[0] if len(lobes) == 1 else {"model": "sum", "lobes": lobes}


def _lobe(part: str) -> dict[str, Any]:
    name, _, rest = (word.strip() for word in part.partition(":"))
    if name == "table":
        return _file(rest)
    entries = (entry.partition("=") for entry in rest.split(",") if rest)
    return {"model": name, **{key.strip(): _toml_value(value.strip()) for key, _, value in entries}}


def _file(text: str) -> dict[str, Any]:
    side = FILE_SIDE.search(text)
    path = Path(text if side is None else text[: side.start()].strip())
    if path.suffix.lower() in (".ddr", ".ddt"):
        raise UserError(f"--sample table:{path}: a virtual rig's samples are .bsdf tables; convert it, or give a formula")
    return {"model": "zemax", "file": str(path.absolute()), **({} if side is None else {"side": side[1]})}


def _toml_value(text: str) -> bool | float | str:
    if text in ("true", "false"):
        return text == "true"
    try:
        return float(text)
    except ValueError:
        return text
