"""Export of a reduced journal: all points, or one sample's table. Simulated data are marked in each file."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.components import shared_variance
from goniotwin.app.campaign.reduction.points import FLAGS, BsdfPoints
from goniotwin.app.campaign.reduction.reduction import BsdfDataset
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, FormatError, PointStream, registry
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.formats.specular_grid import SpecularCut, grid_of_points, resample, specular_table
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

PART_POINTS = 20_000
"""Points written in one part: as text a point takes one or two kilobytes."""
FINEST_DEG = 0.1
PHI_STEP_DEG = 5.0
WIDEST_GAP_DEG = 3.0
"""There is no interpolation between measured directions that are further apart."""


@dataclass(frozen=True)
class Exported:
    """The files of an export, and the number of measured values in them."""

    files: tuple[Path, ...]
    values: int


def export_format(name: str) -> Format:
    """The format of this name, which can hold a BSDF. Raises UserError."""
    try:
        return registry.format_named(name, {Holds.GRID, Holds.POINTS})
    except FormatError as error:
        raise UserError(str(error)) from None


def check_files(path: Path, form: Format) -> None:
    """Raise UserError, before a long reduction, if the files of an export cannot be written."""
    try:
        registry.check_files(path, form)
    except FormatError as error:
        raise UserError(str(error)) from None


def export(
    reduced: BsdfDataset, sample: str | None, path: Path, form: Format, light: Literal["reflected", "transmitted"] | None = None
) -> Exported:
    """Write the points of one sample or of all, or the table of one sample, as the format holds it. Raises UserError.

    `light` takes one part of what was measured. Uncertainties that a table's format cannot hold go to a second file of the same
    grid beside it.
    """
    if light is not None:
        reduced = _part_of_light(reduced, sample, path, light)
    try:
        if Holds.POINTS in form.holds:
            stream, count = points_of(reduced, sample, path)
            form.write(path, stream)
            return Exported((path,), count)
        table, count = table_of(reduced, sample, path, form)
        return Exported(registry.write_table(path, table, form), count)
    except FormatError as error:
        raise UserError(str(error)) from None


def heading(reduced: BsdfDataset) -> list[str]:
    """The first comment lines of a file: campaign, rig, and whether it is simulated."""
    lines = [f"campaign: {reduced.name}", f"rig: {reduced.rig.file.name}"]
    if reduced.simulated:
        lines.append(f"SIMULATED: measured on a virtual rig, seed {reduced.rig.seed}; no value is from a real instrument")
    if reduced.chain:
        lines.append(f"journal: {reduced.chain}")
    return lines


def points_of(reduced: BsdfDataset, sample: str | None, path: Path) -> tuple[PointStream, int]:
    """Every measured point of one sample or of all, in parts, and their number. Raises UserError."""
    chosen = {sample: _points(reduced, sample)} if sample is not None else reduced.samples
    if not chosen:
        raise UserError(f"{path}: no sample has been measured yet, so there is nothing to write")
    about = [
        *heading(reduced),
        "sigma: incidence; theta, phi: observation about the specular direction, phi 0 towards the normal; degrees",
        "bsdf with its standard uncertainty u_bsdf in 1/sr; luminance_factor is pi times bsdf",
        "side: the lit side, front or back; light: reflected or transmitted",
        "check: mirrored, for a direction measured only to check the stated symmetry",
        "signature_share: the instrument signature's share of the signal, already subtracted; empty where not measured",
        "u_field_per_sr: the component of u_bsdf from the finite field of view; empty where it cannot be estimated",
        f"flags: {', '.join(f'{name} ({flag.meaning})' for name, flag in FLAGS.items())}",
        *reduced.notes,
        *(f"overlaps of {name}: {each}" for name, each in reduced.overlaps.items() if name in chosen and each.pairs),
    ]
    parts = (
        _columns(name, points.where(np.arange(begin, min(begin + PART_POINTS, points.bsdf.size))))
        for name, points in chosen.items()
        for begin in range(0, points.bsdf.size, PART_POINTS)
    )
    return PointStream(about, parts), sum(points.bsdf.size for points in chosen.values())


def table_of(reduced: BsdfDataset, sample: str | None, path: Path, form: Format) -> tuple[BsdfTable, int]:
    """One sample's BSDF on a grid of specular coordinates, and the number of measured values in it.

    The light is that which the format holds: reflected or transmitted, of the lit front. Raises UserError and FormatError.
    """
    if sample is None:
        if len(reduced.samples) != 1:
            known = ", ".join(reduced.samples) or "none"
            wrong = f"a {form.name} file has one sample, and the journal has: {known}"
            raise UserError(f"{path}: {wrong}; choose one with --sample")
        sample = next(iter(reduced.samples))
    of_points = registry.join_words(map(str, registry.writers(Holds.POINTS)))
    points = _points(reduced, sample)
    points = points.where(~points.back & ~points.mirrored)
    lights = {
        light for light in (Holds.REFLECTED, Holds.TRANSMITTED) if np.any(points.transmitted == (light is Holds.TRANSMITTED))
    }
    if not lights:
        raise UserError(f"{path}: {sample} was not measured with light on its front; use {of_points}")
    if len(lights & form.holds) > 1:
        wrong = f"{sample} has reflected and transmitted light, of which a {form.name} table holds one"
        raise UserError(f"{path}: {wrong}; choose it with --light reflected or --light transmitted")
    light = min(lights & form.holds, default=min(lights))
    points = points.where(points.transmitted == (light is Holds.TRANSMITTED))
    if np.unique(points.gamma_deg).size > 1:
        raise UserError(f"{path}: {sample} was measured at several gamma, of which export makes no table; use {of_points}")
    wavelengths = tuple(np.unique(points.wavelength_nm).tolist())
    registry.check_holds(path, form, {Holds.GRID, light, Holds.SIGMAS, *([Holds.WAVELENGTHS] if len(wavelengths) > 1 else [])})
    try:
        grids = [regrid(points.where(points.wavelength_nm == wavelength)) for wavelength in wavelengths]
    except ValueError as error:
        raise UserError(f"{path}: {sample}: {error}, so there is nothing to write") from None
    if len({tuple(axis.tobytes() for axis in axes) for axes, _ in grids}) > 1:
        wrong = f"{sample} was not measured in the same directions at all wavelengths"
        raise UserError(f"{path}: {wrong}; use {of_points}")
    checked = [f"symmetry: {reduced.symmetry[sample]}"] if sample in reduced.symmetry else []
    gaps = f"nodes between measured directions more than {WIDEST_GAP_DEG:g} deg apart count as not measured"
    table = specular_table(
        *grids[0][0], [cuts for _, cuts in grids], wavelengths,
        transmitted=light is Holds.TRANSMITTED, generated=reduced.simulated, done="measured",
        comments=[*heading(reduced), f"sample: {sample}", *checked, gaps],
    )  # fmt: skip
    return table, int(points.good.sum())


def regrid(points: BsdfPoints) -> tuple[tuple[Floats, Floats, Floats], list[SpecularCut]]:
    """Points of one wavelength and one gamma on a grid: sigma, phi, theta, and the cut at each sigma.

    theta goes from 0 to 180 in the finest step of the zenith angles; phi is 0 and 180 where only the plane of incidence was
    measured. Raises ValueError where no point has a value.
    """
    good = points.where(points.good)
    if not good.bsdf.size:
        raise ValueError("no direction has a value")
    polar = polar_from_zenith(good.zenith_deg)
    phi = np.array([0.0, 180.0]) if good.in_plane.all() else np.arange(0.0, 180.0 + 1e-9, PHI_STEP_DEG)
    apart = np.diff(np.unique(round_deg(polar)))
    step = max(FINEST_DEG, float(apart.min())) if apart.size else PHI_STEP_DEG
    theta = np.linspace(0.0, 180.0, 1 + math.ceil(180.0 / step - 1e-6))
    of_all = shared_variance(good.components)
    own, shared = np.sqrt(np.maximum(good.u_bsdf**2 - of_all, 0.0)), np.sqrt(of_all)
    sigmas, cuts = np.unique(points.sigma_deg), []
    for sigma in sigmas.tolist():
        here = good.sigma_deg == sigma
        if not here.any():
            raise ValueError(f"at sigma {sigma:g} no direction has a value")
        grid = grid_of_points(polar[here], good.azimuth_deg[here], good.bsdf[here], own[here], shared[here])
        cuts.append(resample(grid, sigma, phi, theta, widest_gap_deg=WIDEST_GAP_DEG))
        if not cuts[-1].known.any():
            raise ValueError(f"at sigma {sigma:g} no node of the grid has measured directions around it")
    return (sigmas, phi, theta), cuts


def _part_of_light(reduced: BsdfDataset, sample: str | None, path: Path, light: str) -> BsdfDataset:
    """The samples that were measured in this light, with its points alone. Raises UserError for none."""
    asked = reduced.samples if sample is None else {sample: _points(reduced, sample)}
    of_light = {name: points.where(points.transmitted == (light == "transmitted")) for name, points in asked.items()}
    kept = {name: points for name, points in of_light.items() if points.bsdf.size}
    if not kept:
        raise UserError(f"{path}: no {light} light of {sample or 'any sample'} has been measured; leave --light out")
    return replace(reduced, samples=kept)


def _points(reduced: BsdfDataset, sample: str) -> BsdfPoints:
    """The points of a sample. Raises UserError for an unknown name."""
    if sample not in reduced.samples:
        known = ", ".join(reduced.samples) or "none"
        raise UserError(f"the journal has no measured sample {sample!r}; it has: {known}")
    return reduced.samples[sample]


def _columns(name: str, points: BsdfPoints) -> dict[str, np.ndarray]:
    """The columns of a CSV for points of one sample."""
    columns: dict[str, np.ndarray] = {"sample": np.full(points.bsdf.size, name)}
    for column in (
        "wavelength_nm", "sigma_deg", "gamma_deg", "beta_deg", "shift_deg", "photodiode", "zenith_deg", "azimuth_deg",
        "theta_deg", "phi_deg", "bsdf", "u_bsdf", "luminance_factor",
    ):  # fmt: skip
        unit = "_per_sr" if column in ("bsdf", "u_bsdf") else ""
        columns[column + unit] = getattr(points, column)
    columns["side"] = np.where(points.back, "back", "front")
    columns["light"] = np.where(points.transmitted, "transmitted", "reflected")
    columns["check"] = np.where(points.mirrored, "mirrored", "")
    columns["signature_share"] = points.signature
    columns["u_field_per_sr"] = points.u_field
    columns["flags"] = _flags(points)
    return columns


def _flags(points: BsdfPoints) -> np.ndarray:
    named = points.flags.items()
    return np.array([" ".join(name for name, flag in named if flag[k]) for k in range(points.bsdf.size)])
