"""Opening of data: a journal is reduced, a file is read by the registry, and each becomes a dataset in memory."""

import os
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.studies.evaluation import Evaluation, evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_to_memory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.export import scattered_points
from goniotwin.app.data.values import Measured, SampleData, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats import registry
from goniotwin.app.formats.content import (
    ANGLES,
    HORIZON_DEG,
    ISOTROPIC,
    BsdfFile,
    Part,
    RegularTable,
    ScatteredBsdf,
    axes_of_nodes,
    nodes,
)
from goniotwin.app.formats.file import SQLITE, FormatError, StrPath, read_head
from goniotwin.app.formats.registry import Format
from goniotwin.app.formats.table import BsdfTable
from goniotwin.arrays import Floats
from goniotwin.twin.optics import from_specular
from goniotwin.twin.optics.geometry.coordinates import round_deg, zenith_and_azimuth


@with_names
def open_dataset(path: StrPath, *, without_damaged: bool = False) -> Dataset:
    """Open a journal, or any file that can be read, as a dataset in memory; nothing stays open.

    What the file is, is found by its content. Of a damaged journal only `without_damaged` gives a dataset: its damaged rows
    then have no values. Raises GoniotwinError for whatever a path or a file can have wrong.
    """
    if not isinstance(path, str | os.PathLike):
        raise UserError(f"open: {quoted(path)} is not a path; give the name of a journal or of a file")
    without_damaged = bool(flag("without_damaged", without_damaged))
    file = Path(path)
    if not _is_folder(file) and read_head(file, len(SQLITE)) == SQLITE:
        return open_journal(file, without_damaged=without_damaged)
    found = registry.recognise(file)
    return dataset_of_file(with_files_beside(file, found.read(file), found), file.name, found.name)


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:  # a name that is too long
        return False


# ---- journals ----


def open_journal(path: Path, *, without_damaged: bool = False) -> Dataset:
    """The dataset of a journal, as far as it goes. Raises UserError."""
    with Journal.open(path) as journal:
        return dataset_of_evaluation(evaluate_journal(journal, without_damaged=without_damaged))


def dataset_of_evaluation(evaluation: Evaluation) -> Dataset:
    """The dataset of a journal that is open; the journal may be closed afterwards. Raises UserError."""
    reduced = reduce_to_memory(evaluation)
    settings = evaluation.reduction.settings
    if settings.history is not None:
        settings.history.read()
    data = {
        name: replace(
            sample_of_points(points, name, isotropic=reduced.isotropic, generated=reduced.simulated),
            measured=Measured(points, settings),
            metadata=reduced.metadata[name],
        )
        for name, points in reduced.samples.items()
    }
    notes = (*reduced.notes, *([ISOTROPIC] if reduced.isotropic else []))
    return Dataset(reduced.name, "journal", data, notes, reduced.findings, reduced=reduced)


def sample_of_points(points: BsdfPoints, sample: str, *, isotropic: bool, generated: bool) -> SampleData:
    """The values of reduced points; equal angles are equal numbers."""
    values = scattered_points(points, sample, isotropic=isotropic, generated=generated)
    rounded: dict[str, Any] = {name: round_deg(getattr(values, name)) for name in ANGLES}
    u = np.where(np.isfinite(points.bsdf), points.u_bsdf, np.nan)
    values = replace(values, **rounded, u=u)
    return SampleData(values, round_deg(points.theta_deg), round_deg(points.phi_deg))


# ---- files ----


def with_files_beside(path: Path, content: BsdfFile, found: Format) -> BsdfFile:
    """A file's content with the uncertainties and the mask in the files beside it, where its format has no room for them.

    Raises FormatError for a file that has uncertainties or a mask in the place of values.
    """
    if (described := registry.described_table(content)) is not None:
        raise FormatError(path, f"it has {described}, not values", "give the table itself")
    parts, comments = list(content.parts), content.comments
    for about, beside in registry.files_beside(path, found).items():
        if not beside.is_file() or about.encode() not in read_head(beside, registry.HEAD_BYTES):
            continue
        others = found.read(beside).parts
        for k, part in enumerate(parts):
            other = next((each for each in others if _on_one_grid(part, each)), None)
            if other is None:
                comments = (*comments, f"{beside.name} is beside it, and has not the same grid: it is not used")
            elif about == registry.ABOUT_UNCERTAINTY:
                parts[k] = replace(part, u=other.values)
            elif isinstance(part, BsdfTable):
                parts[k] = replace(part, known=other.values == 0.0)
    return replace(content, parts=tuple(parts), comments=comments)


def _on_one_grid(part: Part, other: Part) -> bool:
    """Whether two parts have their values at the same places."""
    axes = {
        BsdfTable: ("psi_deg", "sigma_deg", "phi_deg", "theta_deg"),
        RegularTable: ("psi_deg", "sigma_deg"),
        ScatteredBsdf: ("sigma_deg", "psi_deg", "polar_deg", "azimuth_deg"),
    }[type(part)]
    same = ("sample", "transmitted", "back", "wavelengths_nm", "colours") if type(part) is not ScatteredBsdf else ("sample",)
    return (
        type(part) is type(other)
        and all(np.array_equal(getattr(part, name), getattr(other, name)) for name in axes)
        and all(getattr(part, name) == getattr(other, name) for name in same)
    )


def dataset_of_file(content: BsdfFile, name: str, origin: str = "file") -> Dataset:
    """The dataset of a file's content; `origin` is the name of its format."""
    data = {sample: _sample_of_parts(content.of(sample)) for sample in content.samples}
    notes = tuple(dict.fromkeys([*content.comments, *(each for part in content.parts for each in part.comments)]))
    return Dataset(name, origin, data, notes, file=content)


def _sample_of_parts(content: BsdfFile) -> SampleData:
    """The parts of one sample as one list of values."""
    content = content.of_points()
    pieces = [*map(_sample_of_table, content.tables), *map(_sample_of_scattered, content.scattered)]
    joined = SampleData.join(pieces) if pieces else _sample_of_scattered(_no_values(content.regular))
    return replace(
        joined, gridded=bool(content.tables) and not content.scattered, regular=content.regular, metadata=content.metadata
    )


def _sample_of_table(table: BsdfTable) -> SampleData:
    values = nodes(table)
    _, _, sigma, phi, theta = axes_of_nodes(table)
    polar, _ = zenith_and_azimuth(from_specular(sigma, theta, phi))
    above = polar <= HORIZON_DEG
    return SampleData(values, round_deg(theta[above]), round_deg(phi[above]))


def _sample_of_scattered(values: ScatteredBsdf) -> SampleData:
    theta, phi = values.specular()
    phi = round_deg(phi)
    return SampleData(values, round_deg(theta), np.where(phi >= 360.0, 0.0, phi))


def _no_values(regular: Iterable[RegularTable]) -> ScatteredBsdf:
    some = next(iter(regular))
    none: Floats = np.zeros(0)
    return ScatteredBsdf(none, none, none, none, none, sample=some.sample, generated=some.generated)
