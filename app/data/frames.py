"""A sample's values as a DataFrame of pandas or a Dataset of xarray, which are extras."""

from collections.abc import Mapping
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any

import numpy as np

from goniotwin.app.data.values import COLUMNS, SampleData
from goniotwin.app.errors import MissingPackage
from goniotwin.app.formats.content import INTERVAL_COLUMNS, ScatteredBsdf

if TYPE_CHECKING:
    import pandas
    import xarray

UNITS = {name: column.unit or "1" for name, column in {**ScatteredBsdf.declared(), **SampleData.declared()}.items()}
UNITS["bsdf"] = UNITS.pop("values")
LONG_NAMES = {
    "bsdf": "BSDF",
    "u": "standard uncertainty of the BSDF",
    "u_shared": "part of the standard uncertainty that neighbouring values share",
    "low95": "lower end of the interval of 95 %",
    "high95": "upper end of the interval of 95 %",
    "interval": "law of the interval of 95 %",
    "flags": "flags",
    "channel": "colour",
    "wavelength_nm": "wavelength",
    "sigma_deg": "incidence",
    "psi_deg": "azimuth of the light in the sample's frame",
    "theta_deg": "aspecular angle",
    "phi_deg": "azimuth about the specular direction",
    "polar_deg": "polar angle of observation",
    "azimuth_deg": "azimuth of observation in the sample's frame",
    "transmitted": "whether the light is transmitted",
    "back": "whether the sample is lit on its back",
    "photodiode": "number of the photodiode",
}
RANGES = ("bsdf", "u", "wavelength_nm", "sigma_deg", "psi_deg", "theta_deg", "phi_deg", "polar_deg", "azimuth_deg")
"""Columns whose ranges a notebook shows."""
AXES = ("channel", "wavelength_nm", "psi_deg", "sigma_deg", "phi_deg", "theta_deg")
"""Axes of a grid; a table has a channel or a wavelength, or neither."""
ON_GRID = ("bsdf", "u", "flags")


def to_dataframe(data: SampleData, attributes: dict[str, Any]) -> "pandas.DataFrame":
    """One row for each value, and the columns of the dataset. Raises MissingPackage where pandas is not installed."""
    columns = {name: np.array(data.column(name)) for name in COLUMNS}
    frame: pandas.DataFrame = _extra("pandas", "to_dataframe").DataFrame(columns)
    frame.attrs.update(attributes)
    return frame


def to_xarray(data: SampleData, attributes: dict[str, Any]) -> "xarray.Dataset":
    """The values over the axes of their grid if they are those of one table, else over `value`, their number.

    Raises MissingPackage where xarray is not installed.
    """
    library = _extra("xarray", "to_xarray")
    made = _on_grid(data, library) if data.gridded and _is_one_table(data) else _flat(data, library)
    for name, each in made.variables.items():
        each.attrs.update({"long_name": LONG_NAMES[str(name)], "units": UNITS[str(name)]})
    result: xarray.Dataset = made.assign_attrs(attributes)
    return result


def html_of(name: str, origin: str, samples: Mapping[str, SampleData], *, simulated: bool) -> str:
    """A small table of each sample for a notebook: numbers of values, and ranges with units."""
    mark = "<b>SIMULATED</b>, " if simulated else ""
    return f"<div>{escape(name)}: {mark}{escape(origin)}{''.join(_rows(*each) for each in samples.items())}</div>"


def _rows(sample: str, data: SampleData) -> str:
    parts = [("values", "1", f"{data.values.size}, {int(data.good.sum())} of them trusted")]
    for name in RANGES:
        column = data.column(name)[data.good] if name in ("bsdf", "u") else data.column(name)
        known = column[np.isfinite(column)]
        if known.size:
            low, high = (f"{each:.6g}" for each in (known.min(), known.max()))
            text = low if low == high else f"{low} to {high}, {np.unique(known).size} different"
            parts.append((f"{LONG_NAMES[name]} ({name})", UNITS[name], text))
    if colours := [each for each in np.unique(data.column("channel")).tolist() if each]:
        parts.append(("colours", "1", ", ".join(colours)))
    if data.regular:
        parts.append(("tables of regular factors", "1", str(len(data.regular))))
    cells = "".join(
        f"<tr><td>{escape(what)}</td><td>{escape(text)}</td><td>{'' if unit == '1' else unit}</td></tr>"
        for what, unit, text in parts
    )
    return f"<table><caption>{escape(sample or 'a sample without a name')}</caption>{cells}</table>"


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
    columns = {name: ("value", np.array(data.column(name))) for name in COLUMNS}
    variables = {name: columns.pop(name) for name in (*ON_GRID, "u_shared", *INTERVAL_COLUMNS)}
    return library.Dataset(variables, coords=columns)
