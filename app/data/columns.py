"""The columns of a DataFrame, or arrays by name, as what a file holds: a CSV of the same columns is read by the same rules."""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from goniotwin.app.data.values import quoted
from goniotwin.app.errors import UserError
from goniotwin.app.formats.content import BsdfFile, psi_of_gamma
from goniotwin.app.formats.points import SIMULATED, Points, content_of_points
from goniotwin.arrays import Flags

IN_CSV = {
    "bsdf": "bsdf_per_sr",
    "u": "u_bsdf_per_sr",
    "u_shared": "u_shared_per_sr",
    "low95": "low95_per_sr",
    "high95": "high95_per_sr",
}
"""The columns of a dataset that have another name in a CSV, where the unit is part of it; a table may have either name."""
POLAR = {"sigma_deg": 90.0, "polar_deg": 90.0, "theta_deg": 180.0}
ANGLES = {**POLAR, **dict.fromkeys(("psi_deg", "phi_deg", "azimuth_deg"), math.inf)}
"""The angles, with the largest that there is."""
NOT_NEGATIVE = ("u", "u_shared", "wavelength_nm")
NUMBERS = ("bsdf", *NOT_NEGATIVE, "low95", "high95", "photodiode")
TEXTS = ("sample", "channel", "flags", "interval")
SIDES = {"transmitted": ("light", "transmitted", "reflected"), "back": ("side", "back", "front")}
KNOWN = (*ANGLES, *NUMBERS, *TEXTS, *SIDES)


def content_of_columns(table: Any, *, name: str, simulated: bool | None, isotropic: bool | None) -> BsdfFile:
    """The content of a file with columns (n,), see `Dataset.from_table`. Raises UserError."""
    try:
        given = {str(each): np.array(table[each]) for each in list(table)}
    except Exception:  # noqa: BLE001  (an object of any class may raise anything)
        raise UserError(f"from_table: {quoted(type(table).__name__)}: give a DataFrame, or a dictionary of arrays") from None
    if not given:
        raise UserError("from_table: there are no columns; give bsdf, sigma_deg, theta_deg and phi_deg at least")
    lengths = {column.shape for column in given.values()}
    if len(lengths) > 1 or len(next(iter(lengths))) != 1:
        shapes = ", ".join(f"{each} {column.shape}" for each, column in given.items())
        raise UserError(f"from_table: the columns have the shapes {shapes}; give lists, all of the same length")
    attributes = getattr(table, "attrs", {})
    simulated = bool(attributes.get("simulated", False)) if simulated is None else simulated
    columns = _of_csv(given) if IN_CSV["bsdf"] in given else _of_dataset(given)
    columns.setdefault("sample", np.full(next(iter(lengths)), str(attributes.get("sample", ""))))
    content = content_of_points(name, Points((f"{SIMULATED}as the table states",) if simulated else (), columns))
    if isotropic is not None:
        content = replace(content, parts=tuple(replace(each, isotropic=isotropic) for each in content.scattered))
    return content


def _of_csv(given: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The columns of a CSV that another program has read; of these the reader of CSV takes the ones that it knows."""
    return {name: column.astype(np.float64) if column.dtype.kind in "iuf" else _texts(column) for name, column in given.items()}


def _of_dataset(given: Mapping[str, npt.NDArray[Any]]) -> dict[str, Any]:
    """The columns of a CSV from those of a dataset, each of which is checked. Raises UserError."""
    if unknown := [each for each in given if each not in KNOWN]:
        raise UserError(f"from_table: there is no column {quoted(unknown[0])}; there are {', '.join(KNOWN)}")
    _refuse_missing(given)
    if not given["bsdf"].size:
        raise UserError("from_table: the columns are empty; give at least one value")
    columns: dict[str, Any] = {each: _numbers(each, given[each]) for each in (*ANGLES, *NUMBERS) if each in given}
    columns |= {each: _texts(given[each]) for each in TEXTS if each in given}
    for each, (column, yes, no) in SIDES.items():
        if each in given:
            columns[column] = np.where(_flags(each, given[each]), yes, no)
    psi = columns.pop("psi_deg", np.zeros(columns["bsdf"].size))
    if {"polar_deg", "azimuth_deg"} <= columns.keys():
        columns["psi_deg"] = psi
    else:  # a CSV then has the sample's rotation in the rig
        columns["gamma_deg"] = psi_of_gamma(psi, columns["side"] == "back" if "side" in columns else False)
    return {IN_CSV.get(each, each): column for each, column in columns.items()}


def _refuse_missing(given: Mapping[str, Any]) -> None:
    if not {"polar_deg", "azimuth_deg"} <= given.keys() and not {"theta_deg", "phi_deg"} <= given.keys():
        missing = [each for each in ("theta_deg", "phi_deg") if each not in given]
        if "polar_deg" in given or "azimuth_deg" in given:
            missing = [each for each in ("polar_deg", "azimuth_deg") if each not in given]
        raise UserError(
            f"from_table: the column {missing[0]} is missing; give the direction by theta_deg and phi_deg, or by polar_deg and "
            "azimuth_deg"
        )
    for each, what in (("sigma_deg", "the incidence, deg"), ("bsdf", "the values, 1/sr")):
        if each not in given:
            raise UserError(f"from_table: the column {each} is missing; give {what}")


def _numbers(name: str, column: npt.NDArray[Any]) -> npt.NDArray[np.float64]:
    try:
        found = column.astype(np.float64)
    except (TypeError, ValueError):
        raise UserError(f"from_table: the column {name} has something that is no number; give numbers, NaN for none") from None
    most = ANGLES.get(name, math.inf)
    wrong = np.isinf(found) | (np.isnan(found) & (name in ANGLES))
    if name in NOT_NEGATIVE or most < math.inf:
        wrong |= (found < 0.0) | (found > most)
    if wrong.any():
        k = int(np.argmax(wrong))
        to = f"from 0 to {most:g}" if most < math.inf else "that are finite" if name not in NOT_NEGATIVE else "from 0 on"
        raise UserError(f"from_table: the column {name} has {found[k]:g} in row {k}; give numbers {to}")
    return found


def _texts(column: npt.NDArray[Any]) -> npt.NDArray[np.str_]:
    return np.array(["" if each is None or each != each else str(each) for each in column.tolist()], dtype=np.str_)


def _flags(name: str, column: npt.NDArray[Any]) -> Flags:
    if column.dtype.kind != "b" and not all(isinstance(each, bool) for each in column.tolist()):
        raise UserError(f"from_table: the column {name} has something else than True and False")
    return column.astype(bool)
