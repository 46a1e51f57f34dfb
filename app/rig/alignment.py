"""The alignment file: what `goniotwin align` has found of a rig's misalignments, and the key of the rig file that names it.

Many inputs (a mirror's tilt, a zero) cannot be distinguished by any measurement of a rig; sums of them can. The file has these
combinations, each with its value, its standard uncertainty and the coefficients of the inputs in it, and their covariance.
What it leaves unknown stays as `[uncertainty]` of the rig file states it.
"""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import tomlkit
from pydantic import with_config

from goniotwin.app.errors import UserError
from goniotwin.app.toml_file import FILE, parse_toml, read_text, validate_table
from goniotwin.keys import NonNegative
from goniotwin.twin.plant import TwinModel
from goniotwin.twin.plant.disturbances import element_deviations

MOST_BYTES = 1_000_000
DIGITS = 9
"""Significant digits of the numbers in a file."""
LEAST_SHOWN = 0.1
"""Terms below this share of the largest one are not in a combination's words."""
SMALLEST = 1e-20
"""A smaller covariance is none: it is far below the rounding of the others."""


@dataclass(frozen=True)
class AlignmentTable:
    """The alignment of this rig: the name of the `file` that `goniotwin align` has written, beside the rig file."""

    file: str


@dataclass(frozen=True)
class Combination:
    """A combination of inputs that the data determine: its `value` and `u` (standard), both in degrees.

    It is the sum of the inputs, each in deg or mm, times their `coefficients`, by name. `prior_u` is its uncertainty by
    `[uncertainty]` alone.
    """

    value: float
    u: NonNegative
    prior_u: NonNegative
    coefficients: dict[str, float]

    @property
    def words(self) -> str:
        """The sum of its largest terms, as text."""
        terms = sorted(self.coefficients.items(), key=lambda term: -abs(term[1]))
        least = LEAST_SHOWN * abs(terms[0][1]) if terms else 0.0
        shown = [f"{'+' if c > 0.0 else '-'} {abs(c):.2f} {name}" for name, c in terms if abs(c) >= least]
        return " ".join([*shown, *(["+ ..."] if len(shown) < len(terms) else [])]).removeprefix("+ ")


@with_config(FILE)
@dataclass(frozen=True, kw_only=True)
class AlignmentFile:
    """An alignment file. `simulated` states whether it is of a virtual rig, with that rig's `seed`.

    `rig` is the name of the rig, and `rig_sha256` the hash of its file; `campaign` is the name of the campaign, `journal` the
    tip of its data file's chain of checksums, and `measured` the day on which it began. `sample` and its `mountings` have tilts
    of their own: these hold for them alone. `values` is the number of measured values, and `chi_square` that of the residuals
    of the predictions, over its expectation. `open_beam` is the number of its scans that were used. `combinations` are those
    that the data determine, with their `covariance`, in deg^2. `inputs` are values of the rig's inputs that make these
    combinations, the least that do: the twin predicts with them, and they are no statement about a single element.
    """

    alignment: Literal[1]
    simulated: bool
    seed: int | None = None
    rig: str
    rig_sha256: str
    campaign: str
    journal: str
    measured: str
    sample: str
    mountings: tuple[str, ...]
    values: int
    chi_square: float
    open_beam: int
    combinations: tuple[Combination, ...]
    covariance: tuple[tuple[float, ...], ...]
    inputs: dict[str, float]

    def __post_init__(self) -> None:
        count = len(self.combinations)
        if len(self.covariance) != count or any(len(each) != count for each in self.covariance):
            raise ValueError(f"covariance: should have {count} rows of {count} numbers, as there are combinations")


def read_alignment(folder: Path, table: AlignmentTable) -> str:
    """The text of the alignment file that a rig file in a folder names, checked. Raises UserError."""
    path = folder / table.file
    text = read_text(path, MOST_BYTES)
    parse_alignment(text, str(path))
    return text


def parse_alignment(text: str, name: str) -> AlignmentFile:
    """The content of an alignment file. Raises UserError: file, key, reason."""
    content = parse_toml(text, name)
    if "alignment" not in content:
        raise UserError(f"{name}: is not an alignment file; give one that goniotwin align has written")
    return validate_table(AlignmentFile, content, name)


def check_alignment(text: str, name: str, rig: str, *, simulated: bool) -> None:
    """Refuse the alignment of another rig, and that of a virtual rig for a real one. Raises UserError."""
    file = parse_alignment(text, f"{name}: alignment.file")
    if file.simulated and not simulated:
        raise UserError(
            f"{name}: alignment.file: is SIMULATED, of a virtual rig, and this rig is real; name one that was measured on it"
        )
    if file.rig != rig:
        raise UserError(f"{name}: alignment.file: is of the rig {file.rig!r}, not of {rig!r}; name one that was measured on it")


def aligned_model(model: TwinModel, file: AlignmentFile) -> TwinModel:
    """The model of a virtual rig that is off by what an alignment has found, in place of deviations of its own."""
    instrument = replace(model.instrument, deviations=element_deviations(file.inputs, model.instrument.pupil_distance_mm))
    axes = {
        name: replace(each, zero_deg=each.zero_deg + file.inputs.get(f"{name}_zero", 0.0)) for name, each in model.axes.items()
    }
    return replace(model, instrument=instrument, axes=axes)


def alignment_text(file: AlignmentFile) -> str:
    """The text of an alignment file."""
    document = tomlkit.document()
    document.add(tomlkit.comment("An alignment by goniotwin align. To use it, name this file in the rig file:"))
    document.add(tomlkit.comment("    [alignment]"))
    document.add(tomlkit.comment('    file = "..."'))
    if file.simulated:
        document.add(tomlkit.comment("SIMULATED: of a virtual rig."))
    document.add(tomlkit.comment("Values and u (standard) of combinations are in deg; coefficients are per deg or per mm."))
    lists = ("combinations", "covariance", "inputs")
    for key, value in vars(file).items():
        if value is not None and key not in lists:
            document[key] = _rounded(list(value) if isinstance(value, tuple) else value)
    rows = tomlkit.array()
    rows.multiline(True)
    for row in file.covariance:
        rows.append([_rounded(each) for each in row])
    document["covariance"] = rows
    combinations = tomlkit.aot()
    for each in file.combinations:
        table = tomlkit.table()
        for key in ("value", "u", "prior_u"):
            table[key] = _rounded(getattr(each, key))
        inputs = tomlkit.table()
        for name, coefficient in sorted(each.coefficients.items(), key=lambda pair: -abs(pair[1])):
            inputs[name] = _rounded(coefficient)
        table["coefficients"] = inputs
        combinations.append(table)
    document["combinations"] = combinations
    inputs = tomlkit.table()
    for name, value in file.inputs.items():
        inputs[name] = _rounded(value)
    document["inputs"] = inputs
    return tomlkit.dumps(document)


def _rounded(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return 0.0 if abs(value) < SMALLEST else float(f"{value:.{DIGITS}g}")
