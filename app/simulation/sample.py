"""A sample in one line: models with their keys, added up with `+`.

gaussian:width_deg=5,form=half_width
lambertian:reflectance=0.5+gaussian:width_deg=3,reflectance=0.3
table:paint.bsdf
"""

import re
from pathlib import Path
from typing import Any

import numpy as np

from app.errors import UserError
from app.formats import DdrTable, FormatError, bsdf, read_ddr
from app.rig.sample_table import GaussianTable, LambertianTable, MeasuredTable, scatterer
from app.tables import Table, checked
from twin.optics import Scatterer, spectral_table, summed, tabulated

FORMULAS: dict[str, type[GaussianTable] | type[LambertianTable]] = {"gaussian": GaussianTable, "lambertian": LambertianTable}
MODELS = "gaussian:width_deg=5, lambertian:reflectance=0.9, table:FILE (.bsdf or .ddr), and sums of them with +"
# A plus that begins a model, not one of a number (1e+1) or of a file's name.
PLUS = re.compile(r"\+(?=\s*(?:[A-Za-z_-]+\s*:|(?:gaussian|lambertian|table)\s*(?:\+|$)))")
NOT_HERE = ("model", "side")
"""Keys of a rig file's samples that say nothing here: the light comes from the front."""
ALL_OF_THE_LIGHT = 1.001


def parse_sample(text: str) -> Scatterer:
    """The scattering model that the text says; its name is the text.

    Raises UserError of one line for an unknown model, key or value, for a file that cannot be read, and for models of
    formulas that together give back more light than they get.
    """
    parts = [part.strip() for part in PLUS.split(text)]
    models = [_model(part) for part in parts]
    sample = summed(*models, name=text.strip())
    if len(parts) > 1 or not parts[0].startswith("table"):
        _check_light(sample)
    return sample


def table_files(text: str) -> list[Path]:
    """The files that a sample is read from."""
    parts = [part.strip() for part in PLUS.split(text)]
    return [Path(part.partition(":")[2].strip()) for part in parts if part.partition(":")[0].strip() == "table"]


def _model(part: str) -> Scatterer:
    name, colon, rest = part.partition(":")
    name, rest = name.strip(), rest.strip()
    place = f"--sample {name or part!r}"
    if name == "table":
        if not rest:
            raise UserError(f"{place}: names no file; write table:FILE")
        return _table(Path(rest), place)
    if name not in FORMULAS:
        raise UserError(f"--sample: there is no model {name!r}; give {MODELS}")
    if colon and not rest:
        raise UserError(f"{place}: nothing follows the colon; keys are {_keys(FORMULAS[name])}")
    entries = _entries(rest, FORMULAS[name], place)
    try:
        return checked(FORMULAS[name], {"model": name, **entries}, place).scatterer()
    except UserError as error:
        raise UserError(str(error).replace(": the file: ", ": ", 1)) from None


def _entries(text: str, model: type[Table], place: str) -> dict[str, Any]:
    entries: dict[str, Any] = {}
    for entry in text.split(",") if text else ():
        key, equals, value = (word.strip() for word in entry.partition("="))
        if not equals or not value:
            raise UserError(f"{place}: {entry.strip()!r} is not key=value; keys are {_keys(model)}")
        if key in NOT_HERE or key not in model.model_fields:
            raise UserError(f"{place}: there is no key {key!r}; keys are {_keys(model)}")
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


def _keys(model: type[Table]) -> str:
    return ", ".join(key for key in model.model_fields if key not in NOT_HERE)


def _table(path: Path, place: str) -> Scatterer:
    if path.suffix.lower() not in (".ddr", ".ddt"):
        return scatterer(MeasuredTable(model="zemax", file=str(path)), Path(), place)
    try:
        return _from_ddr(read_ddr(path), path)
    except FormatError as error:
        raise UserError(f"{place}: {error}") from None
    except ValueError as error:
        raise UserError(f"{place}: {path}: {error}") from None


def _from_ddr(table: DdrTable, path: Path) -> Scatterer:
    values = bsdf(table)
    psi = table.psi_deg if table.psi_deg.size > 1 else None
    if psi is None:
        values = values[:, 0]
    transmits = path.suffix.lower() == ".ddt"
    axes = (table.sigma_deg, table.phi_deg, table.theta_deg)
    if table.channels == (None,):
        return tabulated(*axes, values[0], path.name, psi, transmits=transmits)
    return spectral_table([nm or 0.0 for nm in table.channels], *axes, values, path.name, psi, transmits=transmits)


def _check_light(sample: Scatterer) -> None:
    """Raises UserError where more light is given back than arrives, at any wavelength.

    At normal incidence: away from it the lobes of the formulas give back less.
    """
    spectrum = sample.spectrum
    weights = np.ones((len(sample.lobes), 1)) if spectrum is None else spectrum.weights
    shares = np.array([lobe.albedo(0.0) if lobe.incident == 1 else 0.0 for lobe in sample.lobes])
    most = float(np.max(shares @ weights))
    if most > ALL_OF_THE_LIGHT:
        raise UserError(
            f"--sample {sample.name!r}: gives back {most:.3g} times the light that it gets at normal incidence; "
            "lower its reflectances (a gaussian has 0.9 unless told)"
        )
