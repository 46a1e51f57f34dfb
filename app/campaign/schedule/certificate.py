"""The etalon's certificate: its radiance factor over wavelength and angles, how well it is known, and how long it holds.

A CSV table: a heading, then one line for every combination of the values of the columns that it has of `wavelength_nm`,
`incidence_deg`, `zenith_deg`, `azimuth_deg`; `radiance_factor` (1 is the ideal diffuser) and `relative_uncertainty` (standard)
are always there. Angles are the etalon's own: from its normal on the side that is lit, the azimuth from the light's, to
either side alike. Between the lines it is interpolated linearly; beyond them it says nothing, and what it has no
column for it holds for at all values. Lines that begin with # are comments.
"""

import csv
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field

from goniotwin.app.errors import UserError
from goniotwin.app.rig.file import refuse_percentage
from goniotwin.app.toml_file import TomlTable
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.protocols.clock import calendar_stamp

INPUT_COLUMNS = ("wavelength_nm", "incidence_deg", "zenith_deg", "azimuth_deg")
VALUE_COLUMNS = ("radiance_factor", "relative_uncertainty")
TOLERANCE = 1e-6


class CertificateTable(TomlTable):
    """The etalon's certificate, in place of the rig file's `[etalon]`: a CSV `file` beside the schedule, which holds until
    the end of the day `expires`. `accept_expired_by` is the name of who answers for using it after that.
    """

    file: Annotated[str, Field(min_length=1)]
    expires: date
    accept_expired_by: Annotated[str, Field(min_length=1)] | None = None


@dataclass(frozen=True)
class Certificate:
    """A table on a grid: ascending values of each of INPUT_COLUMNS (none where the certificate has no such column), and on
    their product the radiance factor and its relative standard uncertainty.
    """

    grid: tuple[Floats, ...]
    factor: Floats
    relative_uncertainty: Floats

    def interpolate(
        self, wavelength_nm: float, incidence_deg: float, zenith_deg: Floats, azimuth_deg: Floats
    ) -> tuple[Floats, Floats]:
        """Radiance factor and relative uncertainty for directions of observation (n,); NaN where it says nothing."""
        n = np.shape(zenith_deg)
        asked = [np.broadcast_to(each, n) for each in (wavelength_nm, incidence_deg, zenith_deg, _folded(azimuth_deg))]
        factor, relative = np.zeros(n), np.zeros(n)
        for place, weight in _corners(self.grid, asked):
            factor += weight * self.factor[place]
            relative += weight * self.relative_uncertainty[place]
        return factor, relative

    def covers(self, axis: str, values: Floats) -> Flags:
        """At which `values` of one of INPUT_COLUMNS it says something; azimuths at any turn and to either side."""
        return _within(self.grid[INPUT_COLUMNS.index(axis)], _folded(values) if axis == "azimuth_deg" else values)

    def __str__(self) -> str:
        """What it is about: its columns, from where to where."""
        ranges = [
            f"{axis} {values[0]:g}{f' to {values[-1]:g}' if values.size > 1 else ' alone'}"
            for axis, values in zip(INPUT_COLUMNS, self.grid, strict=True)
            if values.size
        ]
        return ", ".join(ranges) or "all wavelengths and directions"


def constant_certificate(radiance_factor: float, relative_uncertainty: float) -> Certificate:
    """One that says the same of everything."""
    shape = (1, 1, 1, 1)
    return Certificate((np.zeros(0),) * 4, np.full(shape, radiance_factor), np.full(shape, relative_uncertainty))


def parse_certificate(text: str, name: str) -> Certificate:
    """A table's text. Raises UserError: file, line, reason."""
    numbered = enumerate(text.splitlines(), 1)
    lines = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    if not lines:
        raise UserError(f"{name}: is empty; a certificate begins with a line of {', '.join((*INPUT_COLUMNS, *VALUE_COLUMNS))}")
    heading = [column.strip() for column in next(csv.reader([lines[0][1]]))]
    unknown = [column for column in heading if column not in (*INPUT_COLUMNS, *VALUE_COLUMNS)]
    missing = [column for column in VALUE_COLUMNS if column not in heading]
    if unknown or missing or len(set(heading)) != len(heading):
        twice = "a column is there twice"
        said = f"there is no column {unknown[0]!r}" if unknown else f"{missing[0]} is missing" if missing else twice
        raise UserError(f"{name}: line {lines[0][0]}: {said}; the columns are {', '.join((*INPUT_COLUMNS, *VALUE_COLUMNS))}")
    rows: dict[tuple[float, ...], tuple[float, float]] = {}
    for number, line in lines[1:]:
        found = _numbers(line, heading, f"{name}: line {number}")
        key = tuple(found.get(axis, 0.0) for axis in INPUT_COLUMNS)
        if key in rows:
            raise UserError(f"{name}: line {number}: is the second one for the same wavelength and angles; keep one")
        rows[key] = (found[VALUE_COLUMNS[0]], found[VALUE_COLUMNS[1]])
    return _gridded(rows, heading, name)


def read_certificate(folder: Path, table: CertificateTable) -> str:
    """The text of the certificate that a schedule in `folder` names. Raises UserError, too, for one that has expired and for
    which nobody answers.
    """
    path = folder / table.file
    try:
        text = path.read_text(encoding="utf-8-sig")  # spreadsheets begin with a mark
    except (OSError, UnicodeDecodeError) as error:
        raise UserError(f"{path}: the etalon's certificate cannot be read: {error}; check [certificate] file") from None
    parse_certificate(text, str(path))
    refuse_expired(table, date.fromisoformat(calendar_stamp()[:10]), str(path))
    return text


def refuse_expired(table: CertificateTable, day: date, name: str) -> None:
    """Raises UserError where a certificate does not hold any more on a day, unless somebody answers for it."""
    if day > table.expires and table.accept_expired_by is None:
        raise UserError(
            f"{name}: the etalon's certificate expired on {table.expires}; have the etalon measured again, or put "
            'accept_expired_by = "NAME" of who answers for it into [certificate]'
        )


def _numbers(line: str, heading: list[str], where: str) -> dict[str, float]:
    cells = next(csv.reader([line]))
    if len(cells) != len(heading):
        raise UserError(f"{where}: has {len(cells)} columns, the heading {len(heading)}; mend it")
    try:
        found = {column: float(cell) for column, cell in zip(heading, cells, strict=True)}
    except ValueError as error:
        raise UserError(f"{where}: {error}; mend it") from None
    if not all(np.isfinite(value) for value in found.values()):
        raise UserError(f"{where}: a number is not finite; mend it")
    if found["radiance_factor"] <= 0.0 or not 0.0 <= found["relative_uncertainty"] < 1.0:
        raise UserError(f"{where}: a radiance factor is above 0, its relative uncertainty from 0 to 1; mend it")
    try:
        refuse_percentage(found["radiance_factor"], found.get("zenith_deg", 0.0))
    except ValueError as error:
        raise UserError(f"{where}: {error}") from None
    return found


def _gridded(rows: dict[tuple[float, ...], tuple[float, float]], heading: list[str], name: str) -> Certificate:
    if not rows:
        raise UserError(f"{name}: has a heading and no line below it; a certificate has one at least")
    given = np.array(sorted(rows))
    axes = [np.unique(given[:, k]) for k in range(len(INPUT_COLUMNS))]
    shape = tuple(axis.size for axis in axes)
    if len(rows) != int(np.prod(shape)):
        told = " x ".join(str(size) for size in shape if size > 1)
        raise UserError(f"{name}: has {len(rows)} lines, and {told} combinations of its values; each must be there once")
    values = np.array([rows[tuple(key)] for key in given.tolist()])
    grid = tuple(axis if column in heading else np.zeros(0) for axis, column in zip(axes, INPUT_COLUMNS, strict=True))
    return Certificate(grid, values[:, 0].reshape(shape), values[:, 1].reshape(shape))


def _corners(grid: tuple[Floats, ...], asked: list[Floats]) -> list[tuple[tuple[Ints, ...], Floats]]:
    """The 16 places of the table around each direction, with weights; NaN where one is outside."""
    corners: list[tuple[tuple[Ints, ...], Floats]] = [((), np.ones(asked[0].shape))]
    for values, wanted in zip(grid, asked, strict=True):
        if not values.size:
            both = [(np.zeros(wanted.shape, dtype=np.int64), np.ones(wanted.shape))]
        else:
            low = np.clip(np.searchsorted(values, wanted, side="right") - 1, 0, max(0, values.size - 2))
            high = np.minimum(low + 1, values.size - 1)
            step = np.where(high > low, values[high] - values[low], 1.0)
            share = np.where(_within(values, wanted), np.clip((wanted - values[low]) / step, 0.0, 1.0), np.nan)
            both = [(low, 1.0 - share), (high, share)]
        corners = [((*place, each), weight * part) for place, weight in corners for each, part in both]
    return corners


def _within(values: Floats, wanted: Floats) -> Flags:
    """Which are between the first and the last of a table's ascending values; all, where it has none."""
    if not values.size:
        return np.ones(np.shape(wanted), dtype=bool)
    return np.asarray((wanted >= values[0] - TOLERANCE) & (wanted <= values[-1] + TOLERANCE))


def _folded(azimuth_deg: Floats) -> Floats:
    """Azimuths from 0 to 180 deg, both sides of the plane of incidence alike."""
    turned = np.mod(azimuth_deg, 360.0)
    return np.asarray(np.minimum(turned, 360.0 - turned))
