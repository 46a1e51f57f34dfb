"""Certificate of the etalon: radiance factor and relative uncertainty over wavelength and angles, with an expiry date.

The file is a CSV table: a heading, then one line for every combination of the values in its columns. The columns
`wavelength_nm`, `incidence_deg`, `zenith_deg`, `azimuth_deg` are optional; `radiance_factor` (1 is the ideal diffuser) and
`relative_uncertainty` (standard) are required. Incidence and zenith are from the normal of the lit side of the etalon. The
azimuth is from the half plane of the incident light; both sides of the plane of incidence are alike. Values between the lines
are interpolated linearly; outside the table there is no value. A certificate without one of the optional columns is valid at
all values of this quantity. Lines that begin with # are comments.

Before the heading there may be lines KEY = VALUE (TOML) on what the errors of the table have in common: see
`CertificateKeys`. Without them the smallest uncertainty of the table is common to all values, and the rest is by entry.
"""

import csv
import itertools
import math
import re
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from goniotwin.app.errors import UserError
from goniotwin.app.rig.file import SHAPE, EtalonTable, check_geometry, refuse_percentage
from goniotwin.app.toml_file import Day, TomlTable, parse_toml, read_text, validate_table
from goniotwin.arrays import Flags, Floats, Ints
from goniotwin.keys import Fraction
from goniotwin.protocols.clock import calendar_stamp
from goniotwin.twin.optics.geometry.coordinates import DECIMALS, fold_azimuth

INPUT_COLUMNS = ("wavelength_nm", "incidence_deg", "zenith_deg", "azimuth_deg")
VALUE_COLUMNS = ("radiance_factor", "relative_uncertainty")
UNITS = {"wavelength_nm": "nm", "incidence_deg": "deg incidence", "zenith_deg": "deg zenith", "azimuth_deg": "deg azimuth"}
MOST_BYTES = 4_000_000
"""A hundred thousand lines."""
LONGEST_LINE = 1000
LARGEST = 1e6
"""Magnitude of a number; more than any wavelength in nm."""
TOLERANCE = 10.0**-DECIMALS
"""Values beyond the first or last of the table by no more than this are inside, in nm or degrees."""
KEY_LINE = re.compile(r"\s*([A-Za-z_]\w*)\s*=")
DAYS_OF_A_YEAR = 365.25
ROUNDING = 1e-9


class ValidityTable(TomlTable):
    """The validity of a certificate.

    `expires`: last day on which it is valid. `accept_expired_by`: name of the person responsible for its use after that day.
    """

    expires: Day | None = None
    accept_expired_by: Annotated[str, Field(min_length=1)] | None = None


class CertificateTable(ValidityTable):
    """`[certificate]`: the certificate of the etalon, in place of the rig file's `[etalon]`.

    `file`: name of its CSV file, beside the schedule.
    """

    file: Annotated[str, Field(min_length=1)]
    expires: Day


class CertificateKeys(TomlTable):
    """What a certificate states besides its table; relative standard uncertainties of errors that are common to its values.

    `level` is that of all values alike. `wavelength` and `angle` are slopes, over the wavelengths and the zenith angles of the
    table: the errors at its first and last value, of opposite sign. What these three leave of `relative_uncertainty` is by
    entry. Without `level` it is as large as the table allows.

    `geometry` is that of the certificate's measurement, if it was not a table over angles: "8:d", "0:45". The values are then
    taken for all directions, and `shape` is the uncertainty of the etalon's deviation from the ideal diffuser, at the normal.
    `calibrated` is the day of the calibration.
    """

    level: Fraction | None = None
    wavelength: Fraction = 0.0
    angle: Fraction = 0.0
    geometry: str | None = None
    shape: Fraction = SHAPE
    calibrated: Day | None = None

    @field_validator("geometry")
    @classmethod
    def _check_geometry(cls, value: str | None) -> str | None:
        check_geometry(value)
        return value


@dataclass(frozen=True)
class Certificate:
    """A table on a grid.

    `grid` has ascending values for each of INPUT_COLUMNS, none where the certificate has no such column. `factor` (radiance
    factor) and `relative_uncertainty` (standard) are on the product of these values, with length 1 for a missing column.
    `level`, `wavelength` and `angle` are the uncertainties that its values share: see `CertificateKeys`.
    """

    grid: tuple[Floats, ...]
    factor: Floats
    relative_uncertainty: Floats
    level: float
    wavelength: float = 0.0
    angle: float = 0.0
    geometry: str | None = None
    shape: float = 0.0
    calibrated: date | None = None

    def slope(self, column: str, values: Floats) -> Floats:
        """Where `values` are between the first (-1) and the last (1) of a column's; 0 for a column of fewer than two."""
        known = self.grid[INPUT_COLUMNS.index(column)]
        if known.size < 2:
            return np.zeros(np.shape(values))
        return np.asarray((2.0 * values - known[0] - known[-1]) / (known[-1] - known[0]))

    def common_variance(self, wavelength_nm: Floats, zenith_deg: Floats) -> Floats:
        """Relative variance of the errors that the certificate's values share."""
        of_wavelength = self.wavelength * self.slope("wavelength_nm", wavelength_nm)
        return self.level**2 + of_wavelength**2 + (self.angle * self.slope("zenith_deg", zenith_deg)) ** 2

    def nearest(self, wavelength_nm: Floats, incidence_deg: Floats, zenith_deg: Floats, azimuth_deg: Floats) -> Ints:
        """The number of the table's entry that is nearest in each of the columns, in the order of the table's array."""
        index = np.zeros(np.shape(zenith_deg), dtype=np.int64)
        for values, wanted in zip(
            self.grid, (wavelength_nm, incidence_deg, zenith_deg, fold_azimuth(azimuth_deg)), strict=True
        ):
            if values.size:
                middles = 0.5 * (values[1:] + values[:-1])
                index = index * values.size + np.searchsorted(middles, wanted)
        return index

    def entry(self, number: int) -> str:
        """The place of an entry of the table in words, by its number."""
        at = np.unravel_index(number, self.factor.shape)
        words = [
            f"{values[k]:g} {UNITS[column]}"
            for column, values, k in zip(INPUT_COLUMNS, self.grid, at, strict=True)
            if values.size
        ]
        return ", ".join(words) or "all"

    def years(self, measured: date) -> float | None:
        """Years between the calibration and a measurement; None where the certificate has no such date."""
        return None if self.calibrated is None else abs((measured - self.calibrated).days) / DAYS_OF_A_YEAR

    def interpolate(
        self, wavelength_nm: float | Floats, incidence_deg: float | Floats, zenith_deg: Floats, azimuth_deg: Floats
    ) -> tuple[Floats, Floats]:
        """Radiance factor and relative uncertainty for directions of observation; NaN outside the table.

        The result has the shape of `zenith_deg`.
        """
        n = np.shape(zenith_deg)
        coordinates = [
            np.broadcast_to(each, n) for each in (wavelength_nm, incidence_deg, zenith_deg, fold_azimuth(azimuth_deg))
        ]
        factor, relative = np.zeros(n), np.zeros(n)
        for index, weight in _corners(self.grid, coordinates):
            factor += weight * self.factor[index]
            relative += weight * self.relative_uncertainty[index]
        return factor, relative

    def covers(self, column: str, values: Floats) -> Flags:
        """Which `values` of one of INPUT_COLUMNS are inside the table; azimuths may be any angle, on either side."""
        return _within(self.grid[INPUT_COLUMNS.index(column)], fold_azimuth(values) if column == "azimuth_deg" else values)

    def __str__(self) -> str:
        """The range of each column."""
        ranges = [
            f"{column} {values[0]:g}{f' to {values[-1]:g}' if values.size > 1 else ' alone'}"
            for column, values in zip(INPUT_COLUMNS, self.grid, strict=True)
            if values.size
        ]
        return ", ".join(ranges) or "all wavelengths and directions"


def constant_certificate(etalon: EtalonTable) -> Certificate:
    """The certificate of a rig file: the same values at all wavelengths and in all directions."""
    one = np.ones((1, 1, 1, 1))
    return Certificate(
        (np.zeros(0),) * 4,
        etalon.radiance_factor * one,
        etalon.relative_uncertainty * one,
        etalon.relative_uncertainty,
        geometry=etalon.geometry,
        shape=0.0 if etalon.geometry is None else etalon.shape,
        calibrated=etalon.calibrated,
    )


def parse_certificate(text: str, name: str) -> Certificate:
    """Parse the text of a certificate. Raises UserError: file, line, reason."""
    numbered = enumerate(text.splitlines(), 1)
    lines = [(k, line) for k, line in numbered if line.strip() and not line.lstrip().startswith("#")]
    keyed = dict(itertools.takewhile(lambda each: KEY_LINE.match(each[1]), lines))
    keys = _parse_keys(keyed, name)
    lines = lines[len(keyed) :]
    if not lines:
        raise UserError(f"{name}: is empty; a certificate begins with a line of {', '.join((*INPUT_COLUMNS, *VALUE_COLUMNS))}")
    for k, line in lines:
        if len(line) > LONGEST_LINE:
            raise UserError(f"{name}: line {k}: has {len(line)} characters, more than {LONGEST_LINE}; correct the line")
    heading = [column.strip() for column in next(csv.reader([lines[0][1]]))]
    unknown = [column for column in heading if column not in (*INPUT_COLUMNS, *VALUE_COLUMNS)]
    missing = [column for column in VALUE_COLUMNS if column not in heading]
    if unknown or missing or len(set(heading)) != len(heading):
        duplicate = "a column appears twice"
        reason = f"unknown column {unknown[0]!r}" if unknown else f"{missing[0]} is missing" if missing else duplicate
        columns = ", ".join((*INPUT_COLUMNS, *VALUE_COLUMNS))
        raise UserError(f"{name}: line {lines[0][0]}: {reason}; the columns are {columns}")
    rows: dict[tuple[float, ...], tuple[float, float]] = {}
    for number, line in lines[1:]:
        values = _parse_line(line, heading, f"{name}: line {number}")
        key = tuple(values.get(column, 0.0) for column in INPUT_COLUMNS)
        if key in rows:
            raise UserError(f"{name}: line {number}: is the second line for the same wavelength and angles; remove one")
        rows[key] = (values[VALUE_COLUMNS[0]], values[VALUE_COLUMNS[1]])
    return _make_grid(rows, heading, keys, name)


def read_certificate(folder: Path, table: CertificateTable) -> str:
    """The text of the certificate that a schedule in `folder` names.

    Raises UserError if it cannot be read or parsed, and if it has expired without `accept_expired_by`.
    """
    path = folder / table.file
    try:
        text = read_text(path, MOST_BYTES)
    except UserError as error:
        raise UserError(f"{error} (it is the etalon's certificate: [certificate] file)") from None
    parse_certificate(text, str(path))
    refuse_expired(table, today(), str(path))
    return text


def today() -> date:
    """The day, by this computer."""
    return date.fromisoformat(calendar_stamp()[:10])


def refuse_expired(table: ValidityTable, day: date, name: str, standard: str = "etalon", section: str = "certificate") -> None:
    """Raises UserError if a certificate has expired on a day, unless `accept_expired_by` names a responsible person."""
    if table.expires is not None and day > table.expires and table.accept_expired_by is None:
        raise UserError(
            f"{name}: the {standard}'s certificate expired on {table.expires}; have the {standard} calibrated again, or put "
            f'accept_expired_by = "NAME" of the responsible person into [{section}]'
        )


def _parse_keys(lines: dict[int, str], name: str) -> CertificateKeys:
    """The lines with keys, by their numbers. Raises UserError with the line of a syntax error, or with the key."""
    text = "\n".join(lines.get(k, "") for k in range(1, 1 + max(lines, default=0)))
    return validate_table(CertificateKeys, parse_toml(text, name), name)


def _parse_line(line: str, heading: list[str], place: str) -> dict[str, float]:
    """Numbers of a line by column. Raises UserError."""
    cells = next(csv.reader([line]))
    if len(cells) != len(heading):
        raise UserError(f"{place}: has {len(cells)} columns, the heading {len(heading)}; correct the line")
    try:
        values = {column: float(cell) for column, cell in zip(heading, cells, strict=True)}
    except ValueError as error:
        raise UserError(f"{place}: {error}; correct the line") from None
    if not all(abs(value) <= LARGEST for value in values.values()):
        raise UserError(f"{place}: a number is not finite, or beyond {LARGEST:g}; correct the line")
    if values["radiance_factor"] <= 0.0 or not 0.0 <= values["relative_uncertainty"] < 1.0:
        raise UserError(
            f"{place}: radiance_factor must be above 0, and relative_uncertainty at least 0 and below 1; correct the line"
        )
    try:
        refuse_percentage(values["radiance_factor"], values.get("zenith_deg", 0.0))
    except ValueError as error:
        raise UserError(f"{place}: {error}") from None
    return values


def _make_grid(
    rows: dict[tuple[float, ...], tuple[float, float]], heading: list[str], keys: CertificateKeys, name: str
) -> Certificate:
    """The certificate of lines, by their values of INPUT_COLUMNS. Raises UserError if a combination is missing."""
    if not rows:
        raise UserError(f"{name}: has a heading and no line below it; add at least one line")
    coordinates = np.array(sorted(rows))
    axes = [np.unique(coordinates[:, k]) for k in range(len(INPUT_COLUMNS))]
    shape = tuple(axis.size for axis in axes)
    if len(rows) != math.prod(shape):
        product = " x ".join(str(size) for size in shape if size > 1)
        raise UserError(f"{name}: has {len(rows)} lines, but {product} combinations of its values; add the missing lines")
    values = np.array([rows[tuple(key)] for key in coordinates.tolist()])
    grid = tuple(axis if column in heading else np.zeros(0) for axis, column in zip(axes, INPUT_COLUMNS, strict=True))
    certificate = Certificate(
        grid,
        values[:, 0].reshape(shape),
        values[:, 1].reshape(shape),
        keys.level or 0.0,
        keys.wavelength,
        keys.angle,
        keys.geometry,
        0.0 if keys.geometry is None else keys.shape,
        keys.calibrated,
    )
    _check_keys(certificate, name)
    at = coordinates.T
    left = values[:, 1] ** 2 - certificate.common_variance(
        at[INPUT_COLUMNS.index("wavelength_nm")], at[INPUT_COLUMNS.index("zenith_deg")]
    )
    if (left < -ROUNDING * values[:, 1] ** 2).any():
        worst = int(np.argmin(left))
        common = math.sqrt(values[worst, 1] ** 2 - left[worst])
        raise UserError(
            f"{name}: level, wavelength and angle make {common:.3g} at {certificate.entry(worst)}, more than its "
            f"relative_uncertainty of {values[worst, 1]:g}; lower them, or correct the line"
        )
    return certificate if keys.level is not None else replace(certificate, level=math.sqrt(max(0.0, float(left.min()))))


def _check_keys(certificate: Certificate, name: str) -> None:
    """Raise UserError for a slope over a column without two values, and a geometry of a table over angles."""
    for key, column in (("wavelength", "wavelength_nm"), ("angle", "zenith_deg")):
        if getattr(certificate, key) and certificate.grid[INPUT_COLUMNS.index(column)].size < 2:
            raise UserError(f"{name}: {key}: is a slope over {column}, of which the table has less than two; remove {key}")
    angles = [column for column, values in zip(INPUT_COLUMNS, certificate.grid, strict=True) if values.size]
    if certificate.geometry is not None and (known := [column for column in angles if column != "wavelength_nm"]):
        raise UserError(
            f"{name}: geometry: {certificate.geometry} is a measurement of one geometry, but the table has {known[0]}; "
            "remove one of them"
        )


def _corners(grid: tuple[Floats, ...], coordinates: list[Floats]) -> list[tuple[tuple[Ints, ...], Floats]]:
    """Indices of the 16 table entries around each direction, with their weights; the weights are NaN outside the table."""
    corners: list[tuple[tuple[Ints, ...], Floats]] = [((), np.ones(coordinates[0].shape))]
    for values, wanted in zip(grid, coordinates, strict=True):
        if not values.size:
            both = [(np.zeros(wanted.shape, dtype=np.int64), np.ones(wanted.shape))]
        else:
            low = np.clip(np.searchsorted(values, wanted, side="right") - 1, 0, max(0, values.size - 2))
            high = np.minimum(low + 1, values.size - 1)
            step = np.where(high > low, values[high] - values[low], 1.0)
            fraction = np.where(_within(values, wanted), np.clip((wanted - values[low]) / step, 0.0, 1.0), np.nan)
            both = [(low, 1.0 - fraction), (high, fraction)]
        corners = [((*index, each), weight * part) for index, weight in corners for each, part in both]
    return corners


def _within(values: Floats, wanted: Floats) -> Flags:
    """Which of `wanted` are between the first and the last of ascending `values`; all if there are no values."""
    if not values.size:
        return np.ones(np.shape(wanted), dtype=bool)
    return np.asarray((wanted >= values[0] - TOLERANCE) & (wanted <= values[-1] + TOLERANCE))
