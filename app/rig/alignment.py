"""The alignment file: what `goniotwin align` has found of a rig's misalignments, and the key of the rig file that names it.

Many inputs (a mirror's tilt, a zero) cannot be distinguished by any measurement of a rig; sums of them can. The file has these
combinations, each with its value, its standard uncertainty and the coefficients of the inputs in it, and their covariance.
What it leaves unknown stays as `[uncertainty]` of the rig file states it.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import with_config

from goniotwin.app.errors import UserError
from goniotwin.app.rig.inputs import element_deviations, pose_names
from goniotwin.app.toml_file import TABLE, parse_toml, read_text, validate_table
from goniotwin.keys import NonNegative
from goniotwin.twin.plant import TwinModel

MOST_BYTES = 1_000_000
DIGITS = 9
"""Significant digits of the numbers in a file."""
ROUNDED = 1e-6
"""Numbers that agree so far, over their u, are equal: a file has fewer digits than the program."""
DROPPED = 1e-3
"""Share of a combination's terms that small coefficients may have, which a file does not have."""
LEAST_SHOWN = 0.1
"""Terms below this share of the largest one are not in a combination's words."""
SMALLEST = 1e-20
"""A smaller covariance is none: it is far below the rounding of the others."""
DOUBTED_CHI_SQUARE = 1.5
"""Residuals beyond this, per degree of freedom, are not only those of displaced lobes: uncertainties are widened."""
REFUSED_CHI_SQUARE = 5.0
"""Residuals beyond this are those of no displaced lobe, and make no alignment.

Inputs with a rectangular distribution that are all at its ends give 3, the largest that displacements within what is stated
can give. Up to 5 there is room for the noise of few values: with 3 degrees of freedom it exceeds that once in 500 campaigns.
"""


@dataclass(frozen=True)
class AlignmentTable:
    """The alignment of this rig: its misalignments as far as they are known.

    `file`: name of the file that `goniotwin align` has written, beside the rig file.
    """

    file: str


@dataclass(frozen=True)
class Combination:
    """A combination of inputs that the data determine: its `value` and `u` (standard), both in degrees.

    It is the sum of the inputs, each in deg or mm, times their `coefficients`, by name. `prior_u` is its uncertainty
    before: by `[uncertainty]`, or by the alignment that the rig named.
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


def residual_words(chi_square: float) -> str:
    """What residuals with a chi-square beyond those of displaced lobes can come from."""
    return (
        f"the residuals are not those of a lobe that is displaced (chi-square {chi_square:.3g} per degree of freedom): the "
        "beam is clipped, or light misses the hole, or the lobe is not round; or noise or positions are worse than stated"
    )


def residual_findings(chi_square: float) -> tuple[str, ...]:
    """What is stated of an alignment with such residuals, wherever it is used; empty for those of displaced lobes."""
    if chi_square <= DOUBTED_CHI_SQUARE:
        return ()
    return (f"{residual_words(chi_square)}; the uncertainties of the alignment are {math.sqrt(chi_square):.2g} times as large",)


@with_config(TABLE)
@dataclass(frozen=True, kw_only=True)
class AlignmentFile:
    """An alignment file. `simulated` states whether it is of a virtual rig, with that rig's `seed`.

    `rig` is the name of the rig, and `rig_sha256` the hash of its file. `geometry_sha256` is that of the dimensions and nominal
    angles that the alignment depends on, `tables_sha256` those of the file's other tables without addresses; files of earlier
    versions have none. `campaign` is the name of the campaign, `journal` the tip of its data file's chain of checksums, and
    `measured` the day on which it began; `before` names the alignment that was known. `sample` and its `mountings` have tilts
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
    before: str | None = None
    geometry_sha256: str | None = None
    tables_sha256: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        count = len(self.combinations)
        if len(self.covariance) != count or any(len(each) != count for each in self.covariance):
            raise ValueError(f"covariance: should have {count} rows of {count} numbers, as there are combinations")

    @property
    def source(self) -> str:
        """The file in words, for notes: the campaign that it is from, and its day."""
        return f"[alignment] {self.campaign}, {self.measured or 'undated'}"


def read_alignment(folder: Path, table: AlignmentTable) -> str:
    """The text of the alignment file that a rig file in a folder names, checked. Raises UserError."""
    path = folder / table.file
    text = read_text(path, MOST_BYTES)
    parse_alignment(text, str(path))
    return text


def is_alignment(content: bytes) -> bool:
    """Whether a file is an alignment file: in a rig file `alignment` is a table."""
    try:
        return isinstance(parse_toml(content.decode("utf-8-sig"), "").get("alignment"), int)
    except (UnicodeDecodeError, UserError):
        return False


def parse_alignment(text: str, name: str) -> AlignmentFile:
    """The content of an alignment file. Raises UserError: file, key, reason."""
    content = parse_toml(text, name)
    if "alignment" not in content:
        raise UserError(f"{name}: is not an alignment file; give one that goniotwin align has written")
    return validate_table(AlignmentFile, content, name)


def refused_residuals(file: AlignmentFile) -> str | None:
    """Why a file is no alignment, by the residuals that it states; None for one that is."""
    return residual_words(file.chi_square) if not 0.0 <= file.chi_square <= REFUSED_CHI_SQUARE else None


@dataclass(frozen=True)
class RigIdentity:
    """What an alignment states of its rig: its `name`, whether it is `simulated`, with which `seed`.

    `geometry` is the digest of dimensions and nominal angles, `tables` are those of the other tables of its file, by name.
    """

    name: str
    simulated: bool
    seed: int | None
    geometry: str
    tables: Mapping[str, str]


def check_alignment(text: str, name: str, rig: RigIdentity) -> None:
    """Refuse an alignment that is damaged, of another rig or of another geometry, or of no lobe. Raises UserError."""
    file, place = parse_alignment(text, f"{name}: alignment.file"), f"{name}: alignment.file"
    if (reason := refused_residuals(file)) is not None:
        raise UserError(f"{place}: {reason}; name another one, or remove [alignment]")
    if (wrong := _damage(file)) is not None:
        raise UserError(f"{place}: {wrong}; the file is damaged: write it again with goniotwin align")
    remedy = "name one that was measured on it"
    if file.simulated and not rig.simulated:
        raise UserError(f"{place}: is SIMULATED, of a virtual rig, and this rig is real; {remedy}")
    if rig.simulated and not file.simulated:
        raise UserError(f"{place}: is of a real rig, and this rig is SIMULATED; {remedy}")
    if file.rig != rig.name:
        raise UserError(f"{place}: is of the rig {file.rig!r}, not of {rig.name!r}; {remedy}")
    if file.seed != rig.seed:
        raise UserError(f"{place}: is of the virtual rig of seed {file.seed}, not of seed {rig.seed}; {remedy}")
    if file.geometry_sha256 not in (None, rig.geometry):
        raise UserError(
            f"{place}: is of another geometry: [geometry], the photodiodes' angles, or gear, sense or zero_offset_deg of an "
            "axis have changed since; measure it again, or restore them"
        )


def alignment_notes(file: AlignmentFile, rig: RigIdentity) -> list[str]:
    """What is stated of an alignment wherever it is used: doubtful residuals, and what of the rig file has changed since."""
    source = file.source
    notes = [f"{source}: {each}" for each in residual_findings(file.chi_square)]
    if file.geometry_sha256 is None:
        return [*notes, f"{source}: was written by an earlier version, without the rig's geometry, which is not compared"]
    names = sorted(file.tables_sha256.keys() | rig.tables.keys())
    changed = [f"[{each}]" for each in names if file.tables_sha256.get(each) != rig.tables.get(each)]
    if changed:
        notes.append(f"{source}: {', '.join(changed)} of the rig file changed after it")
    return notes


def _damage(file: AlignmentFile) -> str | None:
    """What contradicts itself in a file; None for one that is whole."""
    of_sample = {f"sample_{each}@{name}" for each in ("tilt_x", "tilt_y", "height") for name in file.mountings}
    for k, each in enumerate(file.combinations):
        for name in each.coefficients:
            if name not in pose_names() | of_sample:
                return f"combinations.{k}.coefficients: there is no input {name!r}"
    for name in file.inputs:
        if name not in pose_names():
            return f"inputs: there is no input {name!r}"
    if not file.combinations:
        return None
    return _damaged_covariance(file) or _contradiction(file)


def _damaged_covariance(file: AlignmentFile) -> str | None:
    covariance, u = np.array(file.covariance), np.array([each.u for each in file.combinations])
    if np.any(np.diag(covariance) < 0.0):
        return "covariance: has a negative variance"
    unit = np.where(u > 0.0, u, 1.0)
    correlation = covariance / np.outer(unit, unit)
    if not np.allclose(np.diag(correlation), u**2 / unit**2, atol=ROUNDED):
        return "covariance: its diagonal is not the square of the combinations' u"
    if not np.allclose(correlation, correlation.T, atol=ROUNDED):
        return "covariance: is not symmetric"
    if np.linalg.eigvalsh(correlation)[0] < -ROUNDED:
        return "covariance: is not that of any quantities (a combination would have a negative variance)"
    return None


def _contradiction(file: AlignmentFile) -> str | None:
    """Combinations that `inputs` do not make, whatever the tilts of the sample are, which the file does not have."""
    names = sorted({name for each in file.combinations for name in each.coefficients} - pose_names())
    terms = [{n: c * file.inputs.get(n, 0.0) for n, c in each.coefficients.items()} for each in file.combinations]
    left = np.array([each.value - math.fsum(own.values()) for each, own in zip(file.combinations, terms, strict=True)])
    size = np.array([math.fsum(map(abs, own.values())) for own in terms])
    allowed = np.array([each.u for each in file.combinations]) + DROPPED * np.maximum(size, np.max(size)) + ROUNDED
    columns = np.array([[each.coefficients.get(n, 0.0) for n in names] for each in file.combinations])
    over = left / allowed
    if names:
        over = over - columns / allowed[:, None] @ np.linalg.lstsq(columns / allowed[:, None], over, rcond=None)[0]
    worst = int(np.argmax(np.abs(over)))
    return f"inputs: do not make the value of combinations.{worst}" if abs(over[worst]) > 1.0 else None


def aligned_model(model: TwinModel, file: AlignmentFile) -> TwinModel:
    """The model of a virtual rig that is off by what an alignment has found, in place of deviations of its own."""
    instrument = replace(model.instrument, deviations=element_deviations(file.inputs, model.instrument.pupil_distance_mm))
    axes = {
        name: replace(each, zero_deg=each.zero_deg + file.inputs.get(f"{name}_zero", 0.0)) for name, each in model.axes.items()
    }
    return replace(model, instrument=instrument, axes=axes)


def alignment_text(file: AlignmentFile) -> str:
    """The text of an alignment file."""
    # Loads 11 modules, tomlkit among them: 10 ms, which `check` does without.
    import tomlkit

    document = tomlkit.document()
    document.add(tomlkit.comment("An alignment by goniotwin align. To use it, name this file in the rig file:"))
    document.add(tomlkit.comment("    [alignment]"))
    document.add(tomlkit.comment('    file = "..."'))
    if file.simulated:
        document.add(tomlkit.comment("SIMULATED: of a virtual rig."))
    document.add(tomlkit.comment("Values and u (standard) of combinations are in deg; coefficients are per deg or per mm."))
    lists = ("combinations", "covariance", "inputs", "tables_sha256")
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
    document["tables_sha256"] = file.tables_sha256
    return tomlkit.dumps(document)


def _rounded(value: Any) -> Any:
    if not isinstance(value, float):
        return value
    return 0.0 if abs(value) < SMALLEST else float(f"{value:.{DIGITS}g}")
