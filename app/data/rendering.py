"""Pictures of a sphere with a BSDF, by Mitsuba 3 (the extra `render`): two beside each other, and figure 14 of the paper.

The sphere is in a box with walls of a checkerboard, under a rectangular light. Both pictures have the same random numbers, so
that noise is nearly the same in both, and their difference is that of the BSDFs. Mitsuba reads the tensor file of
app/formats/rgl.py, which only its spectral variants do.
"""

import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import import_module
from pathlib import Path
from shlex import quote
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from goniotwin.app.data.opening import dataset_of_file
from goniotwin.app.errors import MissingPackage, UserError
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import BsdfFile
from goniotwin.app.formats.file import SQLITE, read_head
from goniotwin.app.formats.rgl import write_table
from goniotwin.app.simulation.files import bsdf_table
from goniotwin.app.simulation.paper.explanation import WIDTHS_DEG
from goniotwin.app.simulation.paper.worst_corner import tilts, with_deviations, with_shifts, worst_corner
from goniotwin.app.simulation.simulate import Task, simulate
from goniotwin.arrays import Floats
from goniotwin.twin.optics import Instrument, gaussian

VARIANT = "scalar_spectral"
"""Of Mitsuba: without LLVM, and spectral, because no other has measured materials."""
MISSING = "render: mitsuba is not installed; run pip install 'goniotwin[render]'"
SIZE, RAYS, SEED = 128, 64, 1
MOST_NODES = 8_000_000
"""Values of a material, four bytes each: a pixel averages over more than the cells of such a grid."""
CORNER_SIGMA_DEG = 30.0
"""The incidence at which the deviations of figure 14 are the worst combination."""
FIGURE_SIGMAS_DEG = (0.0, 15.0, 30.0, 45.0, 60.0, 75.0)
DIFFERENCE = 0.05
"""The difference, as a share of the brightest white, at which its colours end."""
WHITE_PERCENTILE = 95.0
"""Of the light of all pixels: the light source itself, three hundredths of the picture, is brighter than white."""


@dataclass(frozen=True)
class DifferenceFigures:
    """The difference of two pictures, in percent of white, and the reflectances of their tables."""

    title: str
    mean_percent_of_white: float
    rms_percent_of_white: float
    largest_percent_of_white: float
    reflectances: tuple[float | None, float | None]


@dataclass(frozen=True, eq=False)
class Pair:
    """Two pictures (rows, columns, 3) of linear light in the same unit; `white` is what is shown as white.

    `reflectances` are those of the two tables at the first incidence of each; None where a table has not the half sphere.
    """

    title: str
    first: Floats
    second: Floats
    reflectances: tuple[float | None, float | None] = (None, None)

    @property
    def white(self) -> float:
        """The light that is shown as white, of both pictures."""
        return max(float(np.percentile(self.first, WHITE_PERCENTILE)), 1e-12)

    @property
    def difference(self) -> Floats:
        """Second less first (rows, columns), the mean of the colours, as a share of white."""
        return np.asarray((self.second - self.first).mean(axis=2) / self.white)

    @property
    def figures(self) -> DifferenceFigures:
        """Figures of the difference."""
        found = 100.0 * self.difference
        mean, rms, largest = float(found.mean()), float(np.sqrt(np.mean(found**2))), float(np.abs(found).max())
        return DifferenceFigures(self.title, mean, rms, largest, self.reflectances)


def load_mitsuba() -> Any:
    """Mitsuba with its variant. Raises MissingPackage where it is not installed."""
    try:
        mitsuba = import_module("mitsuba")
    except ImportError:
        raise MissingPackage(MISSING) from None
    mitsuba.set_variant(VARIANT)
    return mitsuba


def read_table(path: Path) -> BsdfTable:
    """The one table of reflected light on the front in a file of any format. Raises UserError."""
    if not path.is_dir() and read_head(path, len(SQLITE)) == SQLITE:
        raise UserError(f"{path}: is a journal; make a table of it: goniotwin convert {quote(str(path))} OUT.ddr")
    content: BsdfFile = registry.read(path)
    found = [table for table in content.tables if not (table.transmitted or table.back)]
    if len(found) == 1:
        return found[0]
    points = [each for each in content.scattered if not np.logical_or(each.transmitted, each.back).all()]
    if not found and not points:
        raise UserError(f"{path}: has no values in 1/sr of light that its front reflects, and a picture is of these")
    samples = {*(each.sample for each in found), *(each.sample for each in points)}
    if len(found) > 1 and len(samples) < len(found):
        raise UserError(f"{path}: has {len(found)} tables of light that its front reflects, and a picture is of one")
    options = [
        *([f"--sample {quote(min(samples))}"] if len(content.samples) > 1 else []),
        *(["--light reflected"] if any(np.any(each.transmitted) for each in content.parts) else []),
        *(["--side front"] if any(np.any(each.back) for each in content.parts) else []),
    ]
    what = f"has {len(found)} tables" if found else "has points and no table"
    command = " ".join(["goniotwin convert", quote(str(path)), "OUT.ddr", *options])
    raise UserError(f"{path}: {what} of light that its front reflects; make one: {command}")


def render(table: BsdfTable, size: int = SIZE, rays: int = RAYS, seed: int = SEED) -> Floats:
    """The picture (size, size, 3) of a sphere with this BSDF, in linear light of red, green and blue. Raises UserError.

    `rays` is the number of paths of a pixel. Values below zero, as noise makes them, are none here.
    """
    mitsuba = load_mitsuba()
    table = replace(table, values=np.maximum(table.values, 0.0), u=None, known=None)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sphere.bsdf"
        write_table(path, table, MOST_NODES)
        scene = mitsuba.load_dict(_scene(mitsuba, path, size, rays))
        return np.array(mitsuba.render(scene, seed=seed, spp=rays), dtype=np.float64)


def _scene(mitsuba: Any, path: Path, size: int, rays: int) -> dict[str, Any]:
    """The box from -1 to 1, open towards the camera; the sphere in its middle, the light below its ceiling."""
    turn = mitsuba.ScalarTransform4f

    def grey(reflectance: float) -> dict[str, Any]:
        return {"type": "spectrum", "value": reflectance}

    def wall(axis: Sequence[float], angle: float, place: Sequence[float]) -> dict[str, Any]:
        checks = {
            "type": "checkerboard",
            "color0": grey(0.15),
            "color1": grey(0.7),
            "to_uv": turn().scale([4.0, 4.0, 1.0]),
        }
        to_world = turn().translate(list(place)).rotate(list(axis), angle)
        bsdf = {"type": "twosided", "bsdf": {"type": "diffuse", "reflectance": checks}}
        return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}

    camera = turn().look_at(origin=[0.0, -3.9, 0.0], target=[0.0, 0.0, 0.0], up=[0.0, 0.0, 1.0])
    film = {
        "type": "hdrfilm",
        "width": size,
        "height": size,
        "pixel_format": "rgb",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 6},
        "sensor": {
            "type": "perspective",
            "fov": 38.0,
            "to_world": camera,
            "film": film,
            "sampler": {"type": "independent", "sample_count": rays},
        },
        "floor": wall([1, 0, 0], 0.0, [0, 0, -1]),
        "ceiling": wall([1, 0, 0], 180.0, [0, 0, 1]),
        "back": wall([1, 0, 0], 90.0, [0, 1, 0]),
        "left": wall([0, 1, 0], 90.0, [-1, 0, 0]),
        "right": wall([0, 1, 0], -90.0, [1, 0, 0]),
        "light": {
            "type": "rectangle",
            "to_world": turn().translate([0, 0, 0.99]).rotate([1, 0, 0], 180.0).scale([0.5, 0.35, 1.0]),
            "emitter": {"type": "area", "radiance": grey(10.0)},
        },
        "sphere": {"type": "sphere", "radius": 0.6, "bsdf": {"type": "measured", "filename": str(path)}},
    }


def render_pair(first: BsdfTable, second: BsdfTable, title: str, size: int = SIZE, rays: int = RAYS, seed: int = SEED) -> Pair:
    """Two pictures with the same random numbers. Raises UserError."""
    one, other = (render(table, size, rays, seed) for table in (first, second))
    return Pair(title, one, other, (reflectance(first), reflectance(second)))


def reflectance(table: BsdfTable) -> float | None:
    """The reflectance at the first incidence of a table; None where it has not the half sphere, or several wavelengths."""
    try:
        found = dataset_of_file(BsdfFile((table,)), "table").reflectance(sigma_deg=float(table.sigma_deg[0]))
    except UserError:
        return None
    return float(found.value)


# ---- figure 14 ----


def figure14_tables(width_deg: float) -> tuple[BsdfTable, BsdfTable]:
    """The BSDF of a Gaussian of this width by formula 6, and as the virtual prototype measures it.

    Both are on the same grid. The prototype has the worst combination of all deviations of Table 2 at a sigma of 30 deg.
    """
    instrument = Instrument(obstruction=False)
    corner = worst_corner(instrument, CORNER_SIGMA_DEG, width_deg, tilts(instrument))
    corner = with_shifts(instrument, CORNER_SIGMA_DEG, width_deg, corner)
    sample = gaussian(width_deg)
    step = width_deg / 20.0
    theta = np.concatenate([np.arange(0.0, 3.5 * width_deg, step), np.arange(3.5 * width_deg, 180.0, 5.0)])
    task = Task(
        sample=sample,
        sigma_deg=np.array(FIGURE_SIGMAS_DEG),
        theta_deg=theta[theta < 180.0],
        instrument=with_deviations(instrument, corner.tolerances, corner.signs),
    )
    measured = bsdf_table(simulate(task))
    peak, exponent = (float(each) for each in sample.lobes[0].params[:2])
    row = peak * np.exp(-exponent * np.radians(measured.theta_deg) ** 2)
    theory = replace(measured, values=np.broadcast_to(row, measured.values.shape), u=None, known=None)
    return theory, measured


def figure14(
    report: Callable[[str], None] = lambda _: None, size: int = SIZE, rays: int = RAYS, seed: int = SEED
) -> list[Pair]:
    """The pairs of figure 14, theory and measured, for the four widths; `report` gets the name of each step."""
    pairs = []
    load_mitsuba()
    for width in WIDTHS_DEG:
        report(f"width {width:g} deg")
        pairs.append(render_pair(*figure14_tables(width), f"{width:g} deg", size, rays, seed))
    return pairs


# ---- pictures ----


def picture(pairs: Sequence[Pair], names: tuple[str, str]) -> Figure:
    """A figure with a column for each pair: the first, the second, and their difference."""
    figure = Figure(figsize=(0.9 + 2.3 * len(pairs), 7.4), layout="constrained")
    axes = figure.subplots(3, len(pairs), squeeze=False)
    image = None
    for column, pair in zip(axes.T, pairs, strict=True):
        column[0].set_title(pair.title)
        for axis, light in zip(column, (pair.first, pair.second), strict=False):
            axis.imshow(_display(light / pair.white), interpolation="nearest")
        image = column[2].imshow(
            100.0 * pair.difference, cmap="RdBu_r", vmin=-100.0 * DIFFERENCE, vmax=100.0 * DIFFERENCE, interpolation="nearest"
        )
        for axis in column:
            axis.set_xticks([])
            axis.set_yticks([])
    for axis, name in zip(axes[:, 0], (*names, "difference"), strict=True):
        axis.set_ylabel(name)
    if image is not None:
        bar = figure.colorbar(image, ax=axes[2].tolist(), location="bottom", shrink=0.6, extend="both")
        bar.set_label("second less first, % of white")
    return figure


def _display(linear: Floats) -> Floats:
    """Linear light, 1 for white, as a screen shows it (sRGB, IEC 61966-2-1)."""
    clipped = np.clip(linear, 0.0, 1.0)
    return np.where(clipped <= 0.0031308, 12.92 * clipped, 1.055 * clipped ** (1.0 / 2.4) - 0.055)
