"""Samples of a virtual rig: `[twin.samples]` of a rig file, the same in one line of text, and the scattering models they give.

In one line, models are separated by `+`, and the keys of a model by commas:

gaussian:width_deg=5,form=half_width
lambertian:reflectance=0.5+gaussian:width_deg=3,reflectance=0.3
lambertian:reflectance=0.5+regular:reflectance=0.04
table:paint.bsdf,side=back

A model acts on light from the front; with `side=back` on light from the back, with `side=both` on both.
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
    """An ideal diffuser, with a reflectance and a transmittance."""

    model: Literal["lambertian"]
    reflectance: float = 1.0
    transmittance: float = 0.0
    side: Side = "front"

    @model_validator(mode="after")
    def _is_possible(self) -> "LambertianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The diffuser. Raises ValueError for an impossible reflectance or transmittance."""
        return lambertian(self.reflectance, self.transmittance, self.side)


class GaussianTable(TomlTable):
    """A Gaussian lobe about the specular direction (paper, formula 6), or about the transmitted one."""

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
    def _is_possible(self) -> "GaussianTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The lobe. Raises ValueError for an impossible width or height."""
        return gaussian(
            self.width_deg, self.form, self.quantity, self.peak, self.reflectance, self.transmits, self.refraction, self.side
        )


class RegularTable(TomlTable):
    """A mirror or a clear sheet: its reflectance (or transmittance), or a list of them over the incidences `sigma_deg`."""

    model: Literal["regular"]
    reflectance: float | list[float] = 1.0
    sigma_deg: list[float] | None = None
    transmits: bool = False
    side: Side = "front"

    @model_validator(mode="after")
    def _is_possible(self) -> "RegularTable":
        self.scatterer()
        return self

    def scatterer(self) -> Scatterer:
        """The mirror. Raises ValueError for an impossible reflectance, or a list that does not fit `sigma_deg`."""
        return regular(self.reflectance, self.transmits, self.side, self.sigma_deg)


class MeasuredTable(TomlTable):
    """A table of a Zemax `.bsdf` file; its path is relative to the rig file. A BTDF transmits."""

    model: Literal["zemax"]
    file: str
    side: Side = "front"


LobeTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable, Field(discriminator="model")]


class SumTable(TomlTable):
    """A sum of several models."""

    model: Literal["sum"]
    lobes: Annotated[list[LobeTable], Field(min_length=1)]


SampleTable = Annotated[LambertianTable | GaussianTable | RegularTable | MeasuredTable | SumTable, Field(discriminator="model")]

FORMULAS: dict[str, type[GaussianTable] | type[LambertianTable] | type[RegularTable]] = {
    "gaussian": GaussianTable,
    "lambertian": LambertianTable,
    "regular": RegularTable,
}
MODELS = (
    "gaussian:width_deg=5, lambertian:reflectance=0.9, regular:reflectance=0.04, table:FILE (.bsdf or .ddr), "
    "and sums of them with +"
)
# A plus that separates models, not one in a number (1e+1) or in a file name.
PLUS = re.compile(rf"\+(?=\s*(?:[A-Za-z_-]+\s*:|(?:{'|'.join(FORMULAS)}|table)\s*(?:\+|$)))")
# The side after a file name, which may itself contain commas.
FILE_SIDE = re.compile(r",\s*side\s*=\s*(\w*)\s*$")
FILE_ONLY_KEYS = {"gaussian": ("model",), "lambertian": ("model",), "regular": ("model", "sigma_deg")}
"""Keys of a rig file that have no form in one line of text, because their values are lists."""
HIGHEST_ALBEDO = 1.001
HIGHEST_MEASURED_ALBEDO = 1.5
"""A measured table may be wrong by much, and can be simulated; above this limit it is not a reflectance at all."""


def sample_scatterer(sample: SampleTable, folder: Path, place: str) -> Scatterer:
    """The scattering model of a table; paths of files are relative to `folder`.

    Raises UserError for a file that cannot be read; it begins with `place`, the key of the sample.
    """
    if isinstance(sample, SumTable):
        return sum_samples(*[sample_scatterer(lobe, folder, f"{place}.lobes.{i}") for i, lobe in enumerate(sample.lobes)])
    if not isinstance(sample, MeasuredTable):
        return sample.scatterer()
    try:
        return _zemax_sample(read_zemax(folder / sample.file), sample.side)
    except (FormatError, ValueError) as error:
        raise UserError(f"{place}: {error}") from None


def parse_sample(text: str) -> Scatterer:
    """The scattering model of a sample in one line; its name is the text.

    Raises UserError of one line for an unknown model, key or value, for a file that cannot be read, and for a sample that
    returns more light than it receives.
    """
    parts = _parts(text)
    sample = sum_samples(*[_model(part) for part in parts], name=text.strip())
    _check_albedo(sample, HIGHEST_MEASURED_ALBEDO if any(part.startswith("table") for part in parts) else HIGHEST_ALBEDO)
    return sample


def sample_table(text: str) -> dict[str, Any]:
    """The entries of `[twin.samples.NAME]` for a sample in one line.

    Raises UserError for an invalid sample, and for a table file that a rig file cannot have.
    """
    parse_sample(text)
    lobes = [_lobe_table(part) for part in _parts(text)]
    return lobes[0] if len(lobes) == 1 else {"model": "sum", "lobes": lobes}


def table_files(text: str) -> list[Path]:
    """The files of a sample in one line."""
    return [_file_and_side(part)[0] for part in _parts(text) if part.partition(":")[0].strip() == "table"]


def _parts(text: str) -> list[str]:
    return [part.strip() for part in PLUS.split(text)]


def _model(part: str) -> Scatterer:
    name, colon, rest = (word.strip() for word in part.partition(":"))
    place = f"--sample {name or part!r}"
    if name == "table":
        if not rest:
            raise UserError(f"{place}: has no file; write table:FILE")
        path, given = _file_and_side(part)
        side = "front" if given is None else given
        if side not in get_args(Side):
            raise UserError(f"{place}: side is {side!r}; give {', '.join(get_args(Side))}: the side that the light is on")
        return _table_sample(path, cast(Side, side), place)
    if name not in FORMULAS:
        raise UserError(f"--sample: there is no model {name!r}; give {MODELS}")
    if colon and not rest:
        raise UserError(f"{place}: nothing follows the colon; keys are {_keys(name)}")
    entries = _entries(rest, name, place)
    try:
        return validate_table(FORMULAS[name], {"model": name, **entries}, place).scatterer()
    except UserError as error:
        raise UserError(str(error).replace(": the file: ", ": ", 1)) from None


def _lobe_table(part: str) -> dict[str, Any]:
    name, _, rest = (word.strip() for word in part.partition(":"))
    if name != "table":
        return {"model": name, **_entries(rest, name, f"--sample {name}")}
    path, side = _file_and_side(part)
    if path.suffix.lower() in (".ddr", ".ddt"):
        raise UserError(f"--sample table:{path}: a virtual rig reads only .bsdf tables; convert the table, or give a formula")
    return {"model": "zemax", "file": str(path.absolute()), **({} if side is None else {"side": side})}


def _file_and_side(part: str) -> tuple[Path, str | None]:
    rest = part.partition(":")[2].strip()
    side = FILE_SIDE.search(rest)
    return (Path(rest), None) if side is None else (Path(rest[: side.start()].strip()), side[1])


def _entries(text: str, name: str, place: str) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for entry in text.split(",") if text else ():
        key, equals, value = (word.strip() for word in entry.partition("="))
        if not equals or not value:
            raise UserError(f"{place}: {entry.strip()!r} is not key=value; keys are {_keys(name)}")
        if key in FILE_ONLY_KEYS[name] or key not in FORMULAS[name].model_fields:
            raise UserError(f"{place}: there is no key {key!r}; keys are {_keys(name)}")
        if key in entries:
            raise UserError(f"{place}: {key} is given twice; remove one of them")
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
    return ", ".join(key for key in FORMULAS[name].model_fields if key not in FILE_ONLY_KEYS[name])


def _table_sample(path: Path, side: Side, place: str) -> Scatterer:
    if path.suffix.lower() not in (".ddr", ".ddt"):
        return sample_scatterer(MeasuredTable(model="zemax", file=str(path), side=side), Path(), place)
    try:
        return _ddr_sample(read_ddr(path), path, side)
    except FormatError as error:
        raise UserError(f"{place}: {error}") from None
    except ValueError as error:
        raise UserError(f"{place}: {path}: {error}") from None


def _zemax_sample(table: ZemaxBsdf, side: Side) -> Scatterer:
    """An isotropic sample of a Zemax table. Raises ValueError for a table with several sample rotations."""
    if len(table.sample_rotation_deg) != 1:
        raise ValueError(f"it has {len(table.sample_rotation_deg)} sample rotations; give a table with exactly one")
    transmits = table.scatter_type.upper() == "BTDF"
    axes = (table.incidence_deg, table.azimuth_deg, table.radial_deg)
    return table_sample(*axes, table.values[0], side=side, transmits=transmits)


def _ddr_sample(table: DdrTable, path: Path, side: Side) -> Scatterer:
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


def _check_albedo(sample: Scatterer, limit: float) -> None:
    """Raise UserError if the albedo at normal incidence is above `limit` at any wavelength.

    At other incidences the lobes of the formulas return less light.
    """
    spectrum = sample.spectrum
    weights = np.ones((len(sample.lobes), 1)) if spectrum is None else spectrum.weights
    # Light on the front in the first row, on the back in the second.
    albedos = np.array(
        [[lobe.albedo(0.0) if lobe.incident == incident else 0.0 for lobe in sample.lobes] for incident in (1, -1)]
    )
    highest = float(np.max(albedos @ weights))
    if highest > limit:
        raise UserError(
            f"--sample {sample.name!r}: returns {highest:.3g} times the light that it receives at normal incidence; lower its "
            "reflectances (the default of a gaussian is 0.9), or check the quantity and the unit of a table"
        )
