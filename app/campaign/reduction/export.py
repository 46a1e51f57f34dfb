"""Export of a reduced journal: all points, or one sample's table. Simulated data are marked in each file."""

import math
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from goniotwin.app.campaign.geometry.directions import polar_from_zenith
from goniotwin.app.campaign.reduction.components import INTERVAL_RULE, shared_variance
from goniotwin.app.campaign.reduction.points import FLAGS, BsdfPoints, PointSource
from goniotwin.app.campaign.reduction.reduction import ReducedJournal
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, FormatError, PointStream, registry
from goniotwin.app.formats.content import BsdfFile, ScatteredBsdf, psi_of_gamma
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.formats.specular_grid import SpecularCut, grid_of_points, resample, specular_table
from goniotwin.arrays import Flags, Floats
from goniotwin.twin.optics.geometry.coordinates import HALF_TURN_DEG, round_deg, wrap_azimuth

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
    reduced: ReducedJournal,
    sample: str | None,
    path: Path,
    form: Format,
    light: Literal["reflected", "transmitted"] | None = None,
) -> Exported:
    """Write the points of one sample or of all, or the table of one sample, as the format holds it. Raises UserError.

    `light` takes one part of what was measured. Uncertainties that a table's format cannot hold go to a second file of the same
    grid beside it.
    """
    if light is not None:
        reduced = _part_of_light(reduced, sample, path, light)
    try:
        if Holds.COLUMNS in form.holds:
            stream, count = points_of(reduced, sample, path)
            form.write(path, stream)
            return Exported((path,), count)
        if Holds.POINTS in form.holds:
            content = scattered_of(reduced, sample)
            return Exported(registry.write(path, content, form), sum(part.size for part in content.scattered))
        table, count = table_of(reduced, sample, path, form)
        return Exported(registry.write(path, BsdfFile((table,)), form), count)
    except FormatError as error:
        raise UserError(str(error)) from None


def heading(reduced: ReducedJournal) -> list[str]:
    """The first comment lines of a file: campaign, rig, whether it is simulated, the light's polarisation, and findings."""
    lines = [f"campaign: {reduced.name}", f"rig: {reduced.rig.file.name}"]
    if reduced.simulated:
        lines.append(f"SIMULATED: measured on a virtual rig, seed {reduced.rig.seed}; no value is from a real instrument")
    if reduced.chain:
        lines.append(f"journal: {reduced.chain}")
    return [*lines, *reduced.light, *reduced.findings]


def scattered_of(reduced: ReducedJournal, sample: str | None = None) -> BsdfFile:
    """Every measured point of one sample or of all, in memory, a part each. Raises UserError."""
    chosen: Mapping[str, PointSource] = {sample: _points(reduced, sample)} if sample is not None else reduced.samples
    about = tuple(heading(reduced))
    parts = []
    for name, source in chosen.items():
        columns = [_scattered_columns(points) for points in source.parts(PART_POINTS)]
        joined = {key: np.concatenate([each[key] for each in columns]) for key in columns[0]}
        isotropic = np.unique(joined["psi_deg"]).size == 1
        parts.append(
            ScatteredBsdf(
                **joined, sample=name, isotropic=isotropic, generated=reduced.simulated, comments=(f"sample: {name}",)
            )
        )
    return BsdfFile(tuple(parts), comments=about)


def _scattered_columns(points: BsdfPoints) -> dict[str, np.ndarray]:
    """The columns of scattered values, in the sample's frame; that of one lit on its back is turned about x."""
    psi = psi_of_gamma(points.gamma_deg, points.back)
    checks = np.where(points.mirrored, "mirrored", "")
    return {
        "sigma_deg": np.where(points.back, HALF_TURN_DEG - points.sigma_deg, points.sigma_deg), "psi_deg": psi,
        "polar_deg": polar_from_zenith(points.zenith_deg),
        "azimuth_deg": wrap_azimuth(np.where(points.back, -points.azimuth_deg, points.azimuth_deg) + psi),
        "values": points.bsdf, "u": points.u_bsdf, "u_shared": np.sqrt(shared_variance(points.components)),
        "wavelength_nm": points.wavelength_nm, "transmitted": points.transmitted, "back": points.back,
        "photodiode": points.photodiode, "flags": np.char.strip(np.char.add(np.char.add(_flags(points), " "), checks)),
    }  # fmt: skip


def points_of(reduced: ReducedJournal, sample: str | None, path: Path) -> tuple[PointStream, int]:
    """Every measured point of one sample or of all, in parts, and their number. Raises UserError."""
    chosen: Mapping[str, PointSource] = {sample: _points(reduced, sample)} if sample is not None else reduced.samples
    if not chosen:
        raise UserError(f"{path}: no sample has been measured yet, so there is nothing to write")
    about = [
        *heading(reduced),
        "sigma: incidence; theta, phi: observation about the specular direction, phi 0 towards the normal; degrees",
        "bsdf with its standard uncertainty u_bsdf in 1/sr; luminance_factor is pi times bsdf",
        "side: the lit side, front or back; light: reflected or transmitted",
        "check: mirrored, for a direction measured only to check the stated symmetry",
        "signature_share: the instrument signature's share of the signal, already subtracted; empty where not measured",
        INTERVAL_RULE,
        "field_correction: what the correction of the finite field of view has added to the logarithm of bsdf",
        "u_field_per_sr: what is left of the field of view in u_bsdf; empty where it cannot be estimated",
        f"flags: {', '.join(f'{name} ({flag.meaning})' for name, flag in FLAGS.items())}",
        *(note for note in reduced.notes if note not in (*reduced.light, *reduced.findings)),
        *(f"overlaps of {name}: {each}" for name, each in reduced.overlaps.items() if name in chosen and each.pairs),
    ]
    parts = (_columns(name, points) for name, source in chosen.items() for points in source.parts(PART_POINTS))
    return PointStream(about, parts), sum(source.size for source in chosen.values())


def table_of(reduced: ReducedJournal, sample: str | None, path: Path, form: Format) -> tuple[BsdfTable, int]:
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
    source = _points(reduced, sample)
    wavelengths_of, gammas_of = defaultdict[Holds, set[float]](set), defaultdict[Holds, set[float]](set)
    for light in (Holds.REFLECTED, Holds.TRANSMITTED):
        for points in _OnFront(source, light).settings():
            wavelengths_of[light].add(float(points.wavelength_nm[0]))
            gammas_of[light].update(np.unique(points.gamma_deg).tolist())
    lights = set(wavelengths_of)
    if not lights:
        raise UserError(f"{path}: {sample} was not measured with light on its front; use {of_points}")
    if len(lights & form.holds) > 1:
        wrong = f"{sample} has reflected and transmitted light, of which a {form.name} table holds one"
        raise UserError(f"{path}: {wrong}; choose it with --light reflected or --light transmitted")
    light = min(lights & form.holds, default=min(lights))
    if len(gammas_of[light]) > 1:
        raise UserError(f"{path}: {sample} was measured at several gamma, of which export makes no table; use {of_points}")
    wavelengths, front = tuple(sorted(wavelengths_of[light])), _OnFront(source, light)
    registry.check_holds(path, form, {Holds.GRID, light, Holds.SIGMAS, *([Holds.WAVELENGTHS] if len(wavelengths) > 1 else [])})
    try:
        grids = [regrid(front, wavelength) for wavelength in wavelengths]
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
    return table, sum(int(points.good.sum()) for points in front.settings())


def regrid(points: PointSource, wavelength_nm: float | None = None) -> tuple[tuple[Floats, Floats, Floats], list[SpecularCut]]:
    """Points of one wavelength and one gamma on a grid: sigma, phi, theta, and the cut at each sigma.

    theta goes from 0 to 180 in the finest step of the zenith angles; phi is 0 and 180 where only the plane of incidence was
    measured. Raises ValueError where no point has a value.
    """
    in_plane, sigmas, polar, some = True, [], np.zeros(0), False
    for here in points.settings(wavelength_nm):
        good = here.where(here.good)
        sigmas.append(float(here.sigma_deg[0]))
        polar = np.union1d(polar, round_deg(polar_from_zenith(good.zenith_deg)))
        in_plane &= bool(good.in_plane.all())
        some |= good.size > 0
    if not some:
        raise ValueError("no direction has a value")
    phi = np.array([0.0, 180.0]) if in_plane else np.arange(0.0, 180.0 + 1e-9, PHI_STEP_DEG)
    apart = np.diff(polar)
    step = max(FINEST_DEG, float(apart.min())) if apart.size else PHI_STEP_DEG
    theta = np.linspace(0.0, 180.0, 1 + math.ceil(180.0 / step - 1e-6))
    return (np.array(sigmas), phi, theta), [_cut(here, phi, theta) for here in points.settings(wavelength_nm)]


def _cut(points: BsdfPoints, phi: Floats, theta: Floats) -> SpecularCut:
    """Points of one wavelength, sigma and gamma at the nodes (phi, theta). Raises ValueError where none has a value."""
    sigma = float(points.sigma_deg[0])
    good = points.where(points.good)
    if not good.size:
        raise ValueError(f"at sigma {sigma:g} no direction has a value")
    of_all = shared_variance(good.components)
    own, shared = np.sqrt(np.maximum(good.u_bsdf**2 - of_all, 0.0)), np.sqrt(of_all)
    grid = grid_of_points(polar_from_zenith(good.zenith_deg), good.azimuth_deg, good.bsdf, own, shared)
    cut = resample(grid, sigma, phi, theta, widest_gap_deg=WIDEST_GAP_DEG)
    if not cut.known.any():
        raise ValueError(f"at sigma {sigma:g} no node of the grid has measured directions around it")
    return cut


@dataclass(frozen=True)
class _PartOfLight:
    """The points of a source that are of reflected light, or of transmitted light."""

    source: PointSource
    light: Holds

    @property
    def size(self) -> int:
        """Number of points."""
        return sum(points.size for points in self.parts(PART_POINTS))

    def parts(self, points: int) -> Iterator[BsdfPoints]:
        """The points in order of time."""
        return self._chosen(self.source.parts(points))

    def settings(self, wavelength_nm: float | None = None) -> Iterator[BsdfPoints]:
        """The points of each wavelength, or of one, and sigma."""
        return self._chosen(self.source.settings(wavelength_nm))

    def _chosen(self, parts: Iterator[BsdfPoints]) -> Iterator[BsdfPoints]:
        return (chosen for points in parts if (chosen := points.where(self._is_chosen(points))).size)

    def _is_chosen(self, points: BsdfPoints) -> Flags:
        return np.asarray(points.transmitted == (self.light is Holds.TRANSMITTED))


class _OnFront(_PartOfLight):
    """Of these the points that a table can have: lit on the front, and not only to check the symmetry."""

    def _is_chosen(self, points: BsdfPoints) -> Flags:
        return super()._is_chosen(points) & ~points.back & ~points.mirrored


def _part_of_light(reduced: ReducedJournal, sample: str | None, path: Path, light: str) -> ReducedJournal:
    """The samples that were measured in this light, with its points alone. Raises UserError for none."""
    asked: Mapping[str, PointSource] = reduced.samples if sample is None else {sample: _points(reduced, sample)}
    of_light = {
        name: _PartOfLight(source, Holds.TRANSMITTED if light == "transmitted" else Holds.REFLECTED)
        for name, source in asked.items()
    }
    kept = {name: source for name, source in of_light.items() if source.size}
    if not kept:
        raise UserError(f"{path}: no {light} light of {sample or 'any sample'} has been measured; leave --light out")
    return ReducedJournal(**{**vars(reduced), "samples": kept})


def _points(reduced: ReducedJournal, sample: str) -> PointSource:
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
    columns["field_correction"] = points.field_correction
    columns["u_field_per_sr"] = points.u_field
    columns["flags"] = _flags(points)
    return columns


def _flags(points: BsdfPoints) -> np.ndarray:
    named = points.flags.items()
    return np.array([" ".join(name for name, flag in named if flag[k]) for k in range(points.bsdf.size)])
