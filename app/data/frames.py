"""A sample's values as a DataFrame of pandas or a Dataset of xarray, which are extras."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from goniotwin.app.data.values import COLUMNS, SampleData
from goniotwin.app.errors import MissingPackage
from goniotwin.app.formats.content import INTERVAL_COLUMNS

if TYPE_CHECKING:
    import pandas
    import xarray

UNITS = {"bsdf": "1/sr", "u": "1/sr", "u_shared": "1/sr", "low95": "1/sr", "high95": "1/sr", "wavelength_nm": "nm"}
AXES = ("channel", "wavelength_nm", "psi_deg", "sigma_deg", "phi_deg", "theta_deg")
"""Axes of a grid; a table has a channel or a wavelength, or neither."""
ON_GRID = ("bsdf", "u", "flags")


def to_dataframe(data: SampleData) -> "pandas.DataFrame":
    """One row for each value, and the columns of the dataset. Raises MissingPackage where pandas is not installed."""
    frame: pandas.DataFrame = _extra("pandas", "to_dataframe").DataFrame({name: data.column(name) for name in COLUMNS})
    return frame


def to_xarray(data: SampleData, attributes: dict[str, Any]) -> "xarray.Dataset":
    """The values over the axes of their grid if they are those of one table, else over `value`, their number.

    Raises MissingPackage where xarray is not installed.
    """
    library = _extra("xarray", "to_xarray")
    made = _on_grid(data, library) if data.gridded and _is_one_table(data) else _flat(data, library)
    for name, each in made.variables.items():
        unit = UNITS.get(str(name), "deg" if str(name).endswith("_deg") else "")
        if unit:
            each.attrs["units"] = unit
    result: xarray.Dataset = made.assign_attrs(attributes)
    return result


def _extra(module: str, method: str) -> Any:
    try:
        return import_module(module)
    except ImportError:
        raise MissingPackage(f"{method}: {module} is not installed; run pip install 'goniotwin[xarray]'") from None


def _is_one_table(data: SampleData) -> bool:
    """Whether values are of one light and one side, each node once."""
    one = all(np.unique(data.column(name)).size == 1 for name in ("transmitted", "back"))
    keys = np.stack([np.unique(data.column(name), return_inverse=True)[1].ravel() for name in AXES], axis=1)
    return bool(one and len(np.unique(keys, axis=0)) == data.values.size)


def _on_grid(data: SampleData, library: Any) -> Any:
    axes, places = {}, []
    for name in AXES:
        nodes, place = np.unique(data.column(name), return_inverse=True)
        if name in ("channel", "wavelength_nm") and (nodes.size == 1 and not (nodes[0] != "" and nodes[0] == nodes[0])):
            continue  # neither colours nor wavelengths
        axes[name] = nodes
        places.append(place.ravel())
    shape = tuple(each.size for each in axes.values())
    variables = {}
    for name in ON_GRID:
        column = data.column(name)
        grid = np.full(shape, "" if column.dtype.kind == "U" else np.nan, dtype=column.dtype)
        grid[tuple(places)] = column  # below the horizon a table has no value
        variables[name] = (tuple(axes), grid)
    sides = {name: bool(data.column(name)[0]) for name in ("transmitted", "back")}
    return library.Dataset(variables, coords={**axes, **sides})


def _flat(data: SampleData, library: Any) -> Any:
    columns = {name: ("value", data.column(name)) for name in COLUMNS}
    variables = {name: columns.pop(name) for name in (*ON_GRID, "u_shared", *INTERVAL_COLUMNS)}
    return library.Dataset(variables, coords=columns)
