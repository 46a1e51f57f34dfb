"""Export of a reduced journal: all points as CSV, one sample's table as .ddr. Simulated data are marked in each file."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.reduction.reduction import BsdfDataset, BsdfPoints
from goniotwin.app.campaign.reduction.specular_grid import SpecularTable, regrid
from goniotwin.app.errors import UserError
from goniotwin.app.formats import DdrTable, FormatError, write_ddr, write_points_csv

Exporter = Callable[[BsdfDataset, str | None, Path], int]
MAX_LISTED_RANGES = 2000
"""Ranges listed in the comments of a table."""
PART_POINTS = 20_000
"""Points written in one part: as text a point takes one or two kilobytes."""
SQLITE = b"SQLite format 3\0"


def heading(reduced: BsdfDataset) -> list[str]:
    """The first comment lines of a file: campaign, rig, and whether it is simulated."""
    lines = [f"campaign: {reduced.name}", f"rig: {reduced.rig.file.name}"]
    if reduced.simulated:
        lines.append(f"SIMULATED: measured on a virtual rig, seed {reduced.rig.seed}; no value is from a real instrument")
    return lines


def export_csv(reduced: BsdfDataset, sample: str | None, path: Path) -> int:
    """Write every measured point of one sample or of all; returns their number. Raises UserError."""
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
        "flags: shadowed (blocked by the mirror unit), clipped (saturated at every gain), no-etalon (etalon signal too low),",
        "dead (the photodiode), uncertified (not covered by the etalon's certificate), drift (beyond its limit),",
        "under-range (lost in its noise), field (the effect of the field of view cannot be estimated, and is not in u_bsdf)",
        *reduced.notes,
        *(f"overlaps of {name}: {each}" for name, each in reduced.overlaps.items() if name in chosen and each.pairs),
    ]
    parts = (
        _columns(name, points.where(np.arange(begin, min(begin + PART_POINTS, points.bsdf.size))))
        for name, points in chosen.items()
        for begin in range(0, points.bsdf.size, PART_POINTS)
    )
    _write(path, lambda: write_points_csv(path, about, parts))
    return sum(points.bsdf.size for points in chosen.values())


def export_ddr(reduced: BsdfDataset, sample: str | None, path: Path) -> int:
    """Write one sample's luminance factors in specular coordinates; returns the number of measured points. Raises UserError."""
    if sample is None:
        if len(reduced.samples) != 1:
            known = ", ".join(reduced.samples) or "none"
            raise UserError(f"{path}: a .ddr file has one sample, and the journal has: {known}; choose one with --sample")
        sample = next(iter(reduced.samples))
    points = _points(reduced, sample).front
    points = points.where(~points.mirrored)
    if np.unique(points.gamma_deg).size > 1:
        raise UserError(f"{path}: {sample} was measured at several gamma, which the .ddr export does not support; use csv")
    wavelengths = np.unique(points.wavelength_nm)
    try:
        grids = [regrid(points.where(points.wavelength_nm == wavelength)) for wavelength in wavelengths]
    except ValueError as error:
        raise UserError(f"{path}: {sample}: {error}, so there is nothing to write") from None
    if len({(grid.bsdf.shape, grid.theta_deg[1], grid.sigma_deg.tobytes()) for grid in grids}) > 1:
        raise UserError(f"{path}: {sample} was not measured in the same directions at all wavelengths; use csv")
    sigmas, bsdf = _extend_sigma(grids)
    checked = [f"symmetry: {reduced.symmetry[sample]}"] if sample in reduced.symmetry else []
    about = [*heading(reduced), f"sample: {sample}", *checked, *_continued_ranges(grids, wavelengths)]
    table = DdrTable(
        source="Measured" if not reduced.simulated else "Generated",
        symmetry="PlaneSymmetrical",
        psi_deg=np.array([0.0]),
        sigma_deg=sigmas,
        phi_deg=grids[0].phi_deg,
        theta_deg=grids[0].theta_deg,
        channels=tuple(float(wavelength) for wavelength in wavelengths),
        values=np.pi * bsdf[:, None],
        comments=tuple(about),
    )
    _write(path, lambda: write_ddr(path, table))
    return int(points.good.sum())


FORMATS: dict[str, Exporter] = {"ddr": export_ddr, "csv": export_csv}


def _extend_sigma(grids: list[SpecularTable]) -> tuple[np.ndarray, np.ndarray]:
    """Sigma and BSDF from 0 to 90 deg: the first and last tables are repeated at the ends, because readers extrapolate."""
    sigmas = grids[0].sigma_deg
    bsdf = np.array([grid.bsdf for grid in grids])
    if sigmas[0] > 0.0:
        sigmas, bsdf = np.concatenate([[0.0], sigmas]), np.concatenate([bsdf[:, :1], bsdf], axis=1)
    if sigmas[-1] < 90.0:
        sigmas, bsdf = np.concatenate([sigmas, [90.0]]), np.concatenate([bsdf, bsdf[:, -1:]], axis=1)
    return sigmas, bsdf


def _continued_ranges(grids: list[SpecularTable], wavelengths: np.ndarray) -> list[str]:
    """Comments on the nodes that were not measured."""
    sigmas = ", ".join(f"{sigma:g}" for sigma in grids[0].sigma_deg)
    lines = [
        f"measured at sigma {sigmas} deg only; the first and the last table are repeated to sigma 0 and 90",
        "nodes that were not measured (blocked by the mirror unit, beyond the last photodiode, below the horizon) are",
        "interpolated along theta between measured ones, or have the value of the nearest, or, in a row without any, the",
        "mean of the other rows; nodes between measured directions more than 3 deg apart count as not measured; in degrees:",
    ]
    gaps = [
        f"{wavelength:g} nm, sigma {sigma:g}, phi {phi:g}: theta {start:g} to {stop:g}"
        for grid, wavelength in zip(grids, wavelengths, strict=True)
        for k, sigma in enumerate(grid.sigma_deg)
        for m, phi in enumerate(grid.phi_deg)
        for start, stop in _runs(grid.theta_deg, ~grid.measured[k, m])
    ]
    more = [f"and {len(gaps) - MAX_LISTED_RANGES} more such ranges"] if len(gaps) > MAX_LISTED_RANGES else []
    return [*lines, *gaps[:MAX_LISTED_RANGES], *more]


def _runs(values: np.ndarray, chosen: np.ndarray) -> list[tuple[float, float]]:
    """First and last value of each run of chosen values."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]]).astype(int)))
    return [(float(values[start]), float(values[stop - 1])) for start, stop in edges.reshape(-1, 2)]


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


def _is_journal(path: Path) -> bool:
    try:
        with path.open("rb") as file:
            return file.read(len(SQLITE)) == SQLITE
    except OSError:
        return False


def _write(path: Path, write: Callable[[], None]) -> None:
    if _is_journal(path):
        raise UserError(f"{path} is a data file (journal) or another database, and is not overwritten; choose another name")
    try:
        write()
    except FormatError as error:
        raise UserError(str(error)) from None
