"""Shadow maps of the mirror unit as a file: a CSV of every direction, or a picture of both arcs."""

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from goniotwin.app.errors import UserError
from goniotwin.app.formats import PointStream
from goniotwin.app.formats.registry import Holds
from goniotwin.app.simulation.files import check_suffix, write_content, write_figure
from goniotwin.twin.optics import Instrument, ShadowMap, shadow_map

DOTS_PER_INCH = 130


def shadow_maps(instrument: Instrument, sigma_deg: list[float], step_deg: float) -> list[ShadowMap]:
    """The maps of the upper and the lower arc at each sigma. Raises UserError for a step that does not divide the range."""
    try:
        return [shadow_map(instrument, sigma, step_deg, lower=lower) for sigma in sigma_deg for lower in (False, True)]
    except ValueError as error:
        raise UserError(f"--step: {error}") from None


def write_shadows(maps: list[ShadowMap], path: Path) -> None:
    """Write one file of all maps, in the format of its suffix. Raises UserError."""
    check_suffix(path, Holds.COLUMNS, ".png")
    if path.suffix.lower() == ".png":
        _draw(maps, path)
        return
    write_content(path, Holds.COLUMNS, PointStream(_heading(maps), [_columns(maps)]))


def _heading(maps: list[ShadowMap]) -> list[str]:
    shadow = "blocks light on its way to the detectors" if maps[0].obstruction else "is switched off, and blocks no light"
    return [
        "SIMULATED: fraction of each detector's rays that no mirror blocks (1 is free, 0 is blocked)",
        f"The mirror unit {shadow}.",
        "polar and azimuth: direction of the photodiode, with arc shift and beta; sigma: angle of the mirror unit; degrees",
    ]


def _columns(maps: list[ShadowMap]) -> dict[str, np.ndarray]:
    columns: dict[str, list[np.ndarray]] = {name: [] for name in ("sigma_deg", "arc", "polar_deg", "azimuth_deg", "visible")}
    for each in maps:
        polar, azimuth = np.meshgrid(each.polar_deg, each.azimuth_deg, indexing="ij")
        columns["sigma_deg"].append(np.full(polar.size, each.sigma_deg))
        columns["arc"].append(np.full(polar.size, "lower" if each.lower else "upper"))
        columns["polar_deg"].append(polar.ravel())
        columns["azimuth_deg"].append(azimuth.ravel())
        columns["visible"].append(each.visible.ravel())
    return {name: np.concatenate(parts) for name, parts in columns.items()}


def _draw(maps: list[ShadowMap], path: Path) -> None:
    count = len(maps) // 2
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(2.9 * count + 0.8, 6.6), layout="constrained")
        mesh = None
        for k, each in enumerate(maps):
            axes = figure.add_subplot(2, count, 1 + k // 2 + (count if each.lower else 0), projection="polar")
            assert isinstance(axes, PolarAxes)
            visible = each.visible[:-1, :-1]
            mesh = axes.pcolormesh(
                np.radians(each.azimuth_deg), each.polar_deg, visible, cmap="gray", vmin=0.0, vmax=1.0, rasterized=True
            )
            axes.set_theta_zero_location("W")  # the light is left, as in a map of values
            axes.set_title(f"{'lower' if each.lower else 'upper'} arc, sigma {each.sigma_deg:g} deg", fontsize=9)
            axes.set_yticks([30.0, 60.0, 90.0], ["30", "60", "90 deg"], fontsize=7, color="#0b5394")
            axes.grid(alpha=0.25)
        assert mesh is not None
        figure.colorbar(mesh, ax=figure.axes, shrink=0.6, label="fraction of a detector's rays that no mirror blocks")
        off = "" if maps[0].obstruction else ", switched off"
        figure.suptitle(f"SIMULATED: the shadow of the mirror unit{off} (azimuth is the arc's beta)", fontsize=10)
        write_figure(figure, path, DOTS_PER_INCH)
