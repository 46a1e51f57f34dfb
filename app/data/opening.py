"""Opening of data: a journal is reduced, a file is read by the registry, and each becomes a dataset in memory."""

import os
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.points import BsdfPoints
from goniotwin.app.campaign.reduction.readings import order_by_setting
from goniotwin.app.campaign.studies.evaluation import Evaluation, evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import reduce_to_memory
from goniotwin.app.data.dataset import Dataset
from goniotwin.app.data.export import scattered_points
from goniotwin.app.data.parts import remarks_of, samples_of, with_files_beside
from goniotwin.app.data.values import Measured, SampleData, flag, quoted, with_names
from goniotwin.app.errors import UserError
from goniotwin.app.formats import registry
from goniotwin.app.formats.content import (
    ANGLES,
    ISOTROPIC,
    BsdfFile,
)
from goniotwin.app.formats.file import SQLITE, StrPath, read_head
from goniotwin.twin.optics.geometry.coordinates import round_deg

LONG_ROWS = 3_000
"""Rows of samples from which on a journal is long: it takes a second or more to reduce."""


@with_names
def open_dataset(path: StrPath, *, without_damaged: bool = False) -> Dataset:
    """Open a journal, or any file that can be read, as a dataset in memory. Nothing stays open.

    The content decides what the file is, not its name. A damaged journal gives a dataset only with `without_damaged`; its
    damaged rows then have no values. A wrong path or file raises GoniotwinError.
    """
    if not isinstance(path, str | os.PathLike):
        raise UserError(f"{quoted(path)} is not a path; give the name of a journal or of a file")
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


def open_in_parts(path: Path) -> Iterator[Dataset]:
    """The dataset of a journal or a file; of a long journal first that of one setting, which takes less time.

    That has the first sample, sigma and gamma, at the middle wavelength, and its u has no share of the other wavelengths.
    Raises as `open_dataset` does.
    """
    if _is_folder(path) or read_head(path, len(SQLITE)) != SQLITE:
        yield open_dataset(path)
        return
    with Journal.open(path) as journal:
        evaluation = evaluate_journal(journal)
        if (first := _first_setting(evaluation)) is not None:
            yield first
        yield dataset_of_evaluation(evaluation)


def _first_setting(evaluation: Evaluation) -> Dataset | None:
    """The dataset of the setting that `open_in_parts` gives first; None of a journal that is not long."""
    reduction = evaluation.reduction
    tables = {name: reduction.measurements.row_table(name) for name in reduction.schedule.samples}
    if sum(map(len, tables.values())) < LONG_ROWS or reduction.settings.calibrates:
        return None
    name, table = next((name, table) for name, table in tables.items() if len(table))
    order, edges, lights = order_by_setting(table)
    of_light = edges[edges < lights[1]]
    k = int(np.searchsorted(edges, of_light[of_light.size // 2]))
    points = reduction.points_of_rows(name, order[edges[k] : edges[k + 1]])
    if points is None:
        return None
    points, simulated = reduction.finish(name, points, None), reduction.journal.simulated
    isotropic = reduction.schedule.symmetry == "isotropic"
    data = sample_of_points(points, name, isotropic=isotropic, generated=simulated)
    data = replace(data, measured=Measured(points, replace(reduction.settings, sample=name)))
    notes = ("one setting; the others are being read, and its u has no share of theirs",)
    return Dataset(reduction.journal.value("name"), "journal", {name: data}, notes)


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


def dataset_of_file(content: BsdfFile, name: str, origin: str = "file") -> Dataset:
    """The dataset of a file's content; `origin` is the name of its format."""
    return Dataset(name, origin, samples_of(content), remarks_of(content), file=content)
