"""The columns of a DataFrame, or arrays by name, as what a file holds: a CSV of the same columns is read by the same rules."""

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.data.values import quoted
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.points import RANGES, SIMULATED, ColumnError, Points, content_of_points

IN_CSV = {
    "bsdf": "bsdf_per_sr",
    "u": "u_bsdf_per_sr",
    "u_shared": "u_shared_per_sr",
    "low95": "low95_per_sr",
    "high95": "high95_per_sr",
    "transmitted": "light",
    "back": "side",
}
"""The columns of a dataset that have another name in a CSV, where the unit is part of it; a table may have either name."""
SIDES = {"transmitted": ("transmitted", "reflected"), "back": ("back", "front")}
"""The words of a CSV for True and False."""
ANGLES = ("sigma_deg", "polar_deg", "theta_deg", "psi_deg", "phi_deg", "azimuth_deg")
TEXTS = ("sample", "channel", "flags", "interval")
KNOWN = (*ANGLES, *IN_CSV, "wavelength_nm", "photodiode", *TEXTS)


def content_of_columns(table: Any, *, name: str, simulated: bool | None, isotropic: bool | None) -> BsdfFile:
    """The content of a file with columns (n,), see `Dataset.from_table`. Raises UserError."""
    given = _given(table)
    attributes = getattr(table, "attrs", {})
    simulated = bool(attributes.get("simulated", False)) if simulated is None else simulated
    of_csv = IN_CSV["bsdf"] in given
    if not of_csv and (unknown := [each for each in given if each not in KNOWN]):
        raise UserError(f"from_table: there is no column {quoted(unknown[0])}; there are {', '.join(KNOWN)}")
    titles: dict[str, str] = {}
    for each in given:
        other = titles.setdefault(IN_CSV.get(each, each), each)
        if other != each:
            raise UserError(f"from_table: {other} and {each} are one column; give one of them")
    _refuse_missing(titles)
    size = next(iter(given.values())).size
    if not size:
        raise UserError("from_table: the columns are empty; give at least one value")
    try:
        columns = {column: _column(column, title, given[title]) for column, title in titles.items()}
        columns.setdefault("sample", np.full(size, str(attributes.get("sample", ""))))
        if {"polar_deg", "azimuth_deg"} <= columns.keys():
            columns.setdefault("psi_deg", np.zeros(size))
        points = Points((f"{SIMULATED}as the table states",) if simulated else (), columns)
        content = content_of_points(name, points, titles)
    except ColumnError as error:
        raise UserError(f"from_table: {error}") from None
    if isotropic is not None:
        content = replace(content, parts=tuple(replace(each, isotropic=isotropic) for each in content.scattered))
    return content


def _given(table: Any) -> dict[str, npt.NDArray[Any]]:
    """The columns of a table by name, as copies; what is masked is None. Raises UserError."""
    try:
        held = {str(each): table[each] for each in list(table)}
    except Exception:  # noqa: BLE001  (an object of any class may raise anything)
        raise UserError(f"from_table: {quoted(type(table).__name__)}: give a DataFrame, or a dictionary of arrays") from None
    if not held:
        raise UserError("from_table: there are no columns; give bsdf, sigma_deg, theta_deg and phi_deg at least")
    given = {}
    for name, column in held.items():
        masked = np.ma.isMaskedArray(column) and np.ma.getmaskarray(column).any()
        try:
            given[name] = np.array(np.where(column.mask, None, column.data.astype(object)) if masked else column)
        except Exception:  # noqa: BLE001
            what = "is not a list with one number or text for each row"
            raise UserError(f"from_table: the column {name} {what}; give one, all of the same length") from None
    if len({column.shape for column in given.values()}) > 1 or next(iter(given.values())).ndim != 1:
        shapes = ", ".join(f"{each} {column.shape}" for each, column in given.items())
        raise UserError(f"from_table: the columns have the shapes {shapes}; give lists, all of the same length")
    return given


def _refuse_missing(given: Collection[str]) -> None:
    if not {"polar_deg", "azimuth_deg"} <= set(given) and not {"theta_deg", "phi_deg"} <= set(given):
        missing = [each for each in ("theta_deg", "phi_deg") if each not in given]
        if ("polar_deg" in given or "azimuth_deg" in given) and len(missing) == 2:
            missing = [each for each in ("polar_deg", "azimuth_deg") if each not in given]
        raise UserError(
            f"from_table: the column {missing[0]} is missing; give the direction by theta_deg and phi_deg, or by polar_deg and "
            "azimuth_deg"
        )
    for each, what in (("sigma_deg", "the incidence, deg"), ("bsdf", "the values, 1/sr")):
        if IN_CSV.get(each, each) not in given:
            raise UserError(f"from_table: the column {each} is missing; give {what}")


def _column(name: str, title: str, column: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A column as a reader of CSV has it: of numbers, or of texts."""
    if title in SIDES:
        for k, each in enumerate(column.tolist()):
            if not isinstance(each, bool | np.bool_):
                raise ColumnError(title, k, quoted(each), "give True or False")
        return np.where(column.astype(bool), *SIDES[title])
    if name in RANGES:
        return _numbers(title, column)
    if column.dtype.kind in "iuf":
        return column.astype(np.float64)
    return np.array(["" if each is None or each != each else str(each) for each in column.tolist()], dtype=np.str_)


def _numbers(title: str, column: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    try:
        if column.dtype.kind not in "cmM":
            return column.astype(np.float64)
    except (TypeError, ValueError):
        pass
    row = next((k for k, each in enumerate(column.tolist()) if not _is_number(each)), 0)
    raise ColumnError(title, row, quoted(column.tolist()[row]), "give numbers, NaN for none", "which is no number")


def _is_number(value: object) -> bool:
    try:
        np.array([value], dtype=object).astype(np.float64)
    except (TypeError, ValueError):
        return False
    return True
