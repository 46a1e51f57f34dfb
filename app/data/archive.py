"""The archive of a journal: every point with all that its uncertainty is made of, tables, and what was recorded.

With it the uncertainty of a value, the covariance of two values, of two samples too, and that of a reflectance are rebuilt from
the file alone (docs/exchange/archive.md). An input's effect on a value is stored in the value's unit, for one standard
uncertainty of the input: what has one name is one input in the whole file, so a covariance is a sum of products.
"""

import itertools
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.measurement_model.inputs import InputQuantity
from goniotwin.app.campaign.reduction.effects_of_points import effects_of
from goniotwin.app.campaign.reduction.points import BsdfPoints, PointSource
from goniotwin.app.campaign.reduction.reduction import Reduction
from goniotwin.app.campaign.reduction.settings import ReductionSettings
from goniotwin.app.campaign.studies.budget import FILLED, INTERPOLATION
from goniotwin.app.campaign.studies.budget import reflectance as reflectance_budget
from goniotwin.app.campaign.studies.evaluation import evaluate_journal
from goniotwin.app.campaign.studies.reduced_journal import ReducedJournal
from goniotwin.app.campaign.studies.reflectance import Setting, integration_settings, quadrature
from goniotwin.app.data.export import WIDEST_GAP_DEG, heading, scattered_of, scattered_points
from goniotwin.app.formats import archive
from goniotwin.app.formats.content import COLUMNS, BsdfFile, ScatteredBsdf, gap_line
from goniotwin.app.formats.file import check_writable
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.holes import Fill
from goniotwin.app.formats.metadata import Metadata, common_metadata
from goniotwin.app.formats.table import BsdfTable

CHUNK_POINTS = 10_000
"""Points whose effects are in memory together: some hundred numbers each."""
MORE = (
    "gamma_deg",
    "beta_deg",
    "shift_deg",
    "zenith_deg",
    "theta_deg",
    "phi_deg",
    "mirrored",
    "signature",
    "slope_along",
    "slope_across",
    "field_correction",
    "row",
    "etalon_row",
    "second_row",
    "gain",
    "etalon_gain",
    "wavelength_slope",
    "band_correction",
    "stray_contrast",
    "good",
)
"""What a point of a journal has besides the columns of scattered values."""


@dataclass(frozen=True)
class Archived:
    """The number of measured values in an archive, its tables, and why there is none of a sample's light."""

    values: int
    tables: tuple[BsdfTable, ...]
    without_table: tuple[str, ...]


def write_archive(
    journal: JournalReader, reduced: ReducedJournal, path: Path, *, fill: Fill = "hold", without_damaged: bool = False
) -> Archived:
    """Write the archive of a journal and its reduction, completely or not at all. Raises UserError and FormatError.

    Points with what their uncertainty is made of are in memory in parts; the scattered values of one sample are as a whole.
    """
    check_writable(path)
    reduction = evaluate_journal(journal, without_damaged=without_damaged).reduction
    tables, missing, good = [], [], 0
    for name, source in reduced.samples.items():
        good += sum(int(points.good.sum()) for points in source.parts(CHUNK_POINTS))
        for part in scattered_of(reduced, name).scattered:
            for light, side in itertools.product((False, True), repeat=2):
                chosen = part.where(np.asarray((part.transmitted == light) & (part.back == side)))
                if not chosen.size:
                    continue
                about = (*heading(reduced), *part.comments)
                try:
                    found = grid_table(chosen, fill=fill, comments=about)
                except ValueError as error:
                    what = f"{'transmitted' if light else 'reflected'} light of {name}, {'back' if side else 'front'}"
                    missing.append(f"no table of the {what}: {error}")
                else:
                    tables.append(found)

    def put(entry: h5py.Group) -> Iterator[None]:
        inputs = _Inputs()
        for k, (name, source) in enumerate(reduced.samples.items(), 1):
            group = archive.put_part(entry, f"part_{k}", _empty(reduced, name))
            group["metadata"] = json.dumps(reduced.metadata[name].as_dict(), ensure_ascii=False)
            yield from _put_points(group, name, source, reduction, inputs)
        for k, table in enumerate(tables, 1 + len(reduced.samples)):
            archive.put_part(entry, f"part_{k}", table)
            yield
        comments = dict.fromkeys([*heading(reduced), *reduced.notes, *missing])
        about = common_metadata(reduced.metadata.values()) if reduced.metadata else Metadata(title=reduced.name)
        archive.put_about(entry, BsdfFile((), about, tuple(comments)))
        entry.attrs.update({"simulated": reduced.simulated, "default": "part_1"})
        inputs.put(entry.create_group("inputs"))
        yield from _put_journal(entry.create_group("journal"), journal, reduction)

    archive.write_entry(path, put)
    return Archived(good, tuple(tables), tuple(missing))


def _empty(reduced: ReducedJournal, name: str) -> ScatteredBsdf:
    none = np.zeros(0)
    about = (gap_line(WIDEST_GAP_DEG), *([f"symmetry: {reduced.symmetry[name]}"] if name in reduced.symmetry else []))
    return ScatteredBsdf(
        none, none, none, none, none, sample=name, isotropic=reduced.isotropic, generated=reduced.simulated, comments=about
    )


class _Inputs:
    """All inputs of an archive, each once by its name."""

    def __init__(self) -> None:
        self._known: dict[str, tuple[int, InputQuantity]] = {}

    def number(self, each: InputQuantity) -> int:
        """The number of an input."""
        return self._known.setdefault(each.name, (len(self._known), each))[0]

    def put(self, group: h5py.Group) -> None:
        """Write names, units and sources, in the order of the numbers."""
        group.attrs["NX_class"] = "NXcollection"
        inputs = [each for _, each in self._known.values()]
        for text in ("name", "unit", "distribution", "shared_by", "source", "origin"):
            archive.put_texts(group, text, [str(getattr(each, text)) for each in inputs])
        for number in ("u", "degrees_of_freedom"):
            archive.put_array(group, number, np.array([getattr(each, number) for each in inputs]))


def _put_points(group: h5py.Group, name: str, source: PointSource, reduction: Reduction, inputs: _Inputs) -> Iterator[None]:
    """Fill a part with the points of a sample, in the order of wavelength and sigma, and what their uncertainty is made of."""
    columns: dict[str, archive.Column] = {}
    words: dict[str, dict[str, int]] = {column: {} for column in archive.WORDS}
    for column in COLUMNS:
        del group["values_errors" if column == "u" else column]
    for column in archive.WORDS:
        del group[f"{column}_words"]
    effects = _EffectRows(group, inputs)
    components = archive.Rows(group, "components", "<f8")
    begin, integrals = 0, 0
    for points in source.settings():
        for part in points.parts(CHUNK_POINTS):
            stated = {each: bool(group.attrs[each]) for each in ("isotropic", "generated")}
            scattered = scattered_points(part, name, **stated)
            found: dict[str, npt.NDArray[Any]] = {each: getattr(scattered, each) for each in COLUMNS}
            found["values_errors"] = found.pop("u")
            for each in archive.WORDS:
                distinct, number = archive.distinct(found[each])
                known = words[each]
                numbers = np.array([known.setdefault(word, len(known)) for word in distinct.tolist()], dtype=np.int32)
                found[each] = numbers[number]
            found |= {each: getattr(part, each) for each in MORE}
            for each, values in found.items():
                if each not in columns:
                    columns[each] = archive.Column(group, each, values.dtype)
                columns[each].add(values)
            components.add(part.size, part.budget)
            effects.add(part, reduction.settings)
            yield
        for setting in integration_settings(points):
            if _put_reflectance(group, f"reflectance_{integrals + 1}", name, begin, points, setting, reduction.settings):
                integrals += 1
        begin += points.size
    for each, known in words.items():
        archive.put_texts(group, f"{each}_words", list(known))
    archive.put_texts(group, "component_names", components.keys)
    effects.put_names()


class _EffectRows:
    """The effects of the inputs on points, in 1/sr for one standard uncertainty of each input."""

    def __init__(self, group: h5py.Group, inputs: _Inputs) -> None:
        self._group, self._inputs = group, inputs
        self._independent = archive.Rows(group, "independent", "<f8")
        self._dense = archive.Rows(group, "dense", "<f8")
        self._grouped = archive.Rows(group, "grouped", "<f8")
        self._member = archive.Rows(group, "grouped_input", "<i4", -1)

    def add(self, points: BsdfPoints, settings: ReductionSettings) -> None:
        """Add points; those without a value have no effects."""
        having = np.flatnonzero(np.isfinite(points.bsdf))
        effects = effects_of(points.where(having), settings)
        value = effects.value

        def spread(values: npt.NDArray[Any], empty: float = 0.0) -> npt.NDArray[Any]:
            found = np.full(points.size, empty, dtype=values.dtype)
            found[having] = np.where(np.isfinite(values), values, empty)
            return found

        self._independent.add(
            points.size,
            {name: spread(np.sqrt(variance) * np.abs(value)) for name, variance in effects.independent.items()},
        )
        dense: dict[int, npt.NDArray[Any]] = {}
        for part in effects.dense:
            for k, each in enumerate(part.inputs):
                number = self._inputs.number(each)
                effect = spread(part.sensitivity[:, k] * each.u * value)
                if number in dense or effect.any() or number in self._dense.keys:
                    dense[number] = dense[number] + effect if number in dense else effect
        self._dense.add(points.size, dense)
        grouped: dict[tuple[str, int, int], npt.NDArray[Any]] = {}
        member: dict[tuple[str, int, int], npt.NDArray[Any]] = {}
        seen: dict[str, int] = {}
        for group in effects.groups:
            seen[group.name] = seen.get(group.name, 0) + 1
            keys, place = np.unique(group.member, return_inverse=True)
            known = [-1 if key < 0 else self._inputs.number(group.inputs[key]) for key in keys.tolist()]
            u = np.array([0.0 if key < 0 else group.inputs[key].u for key in keys.tolist()])
            place = place.reshape(group.member.shape)
            for m in range(group.member.shape[1]):
                key = (group.name, seen[group.name], m)
                grouped[key] = spread(group.sensitivity[:, m] * u[place[:, m]] * value)
                member[key] = spread(np.array(known, dtype=np.int32)[place[:, m]], -1)
        self._grouped.add(points.size, grouped)
        self._member.add(points.size, member)

    def put_names(self) -> None:
        """Write what the columns are."""
        archive.put_texts(self._group, "independent_names", self._independent.keys)
        archive.put_array(self._group, "dense_input", np.array(self._dense.keys, dtype=np.int32))
        archive.put_texts(self._group, "grouped_names", [name for name, _, _ in self._grouped.keys])


def _put_reflectance(
    group: h5py.Group,
    title: str,
    name: str,
    begin: int,
    points: BsdfPoints,
    setting: Setting,
    settings: ReductionSettings,
) -> bool:
    """Write a reflectance with the weights of its values; nothing where the directions do not cover the half sphere."""
    here = points.where(setting.index)
    rule = quadrature(here, settings.schedule.symmetry)
    if not rule.hemisphere:
        return False
    budget = reflectance_budget(settings, name, points, setting)
    used = np.flatnonzero(rule.weight != 0.0)
    own = {each.name: each.u for each in budget.components if each.name in (INTERPOLATION, FILLED)}
    found = group.create_group(title)
    found.attrs.update(
        {
            "NX_class": "NXcollection",
            "wavelength_nm": setting.wavelength_nm,
            "sigma_deg": setting.sigma_deg,
            "gamma_deg": setting.gamma_deg,
            "transmitted": setting.transmitted,
            "value": budget.value,
            "u": budget.u,
            "u_interpolation": own.get(INTERPOLATION, 0.0),
            "u_filled": own.get(FILLED, 0.0),
        }
    )
    archive.put_array(found, "index", begin + setting.index[used])
    archive.put_array(found, "weight", rule.weight[used])
    return True


def _put_journal(group: h5py.Group, journal: JournalReader, reduction: Reduction) -> Iterator[None]:
    """Write the files of a campaign as they were, its rows, and the raw counts."""
    group.attrs["NX_class"] = "NXcollection"
    files: Mapping[str, str] = {key: journal.value(key) for key in ("name", "rig", "schedule", "versions")}
    for key, text in files.items():
        group[key] = text.replace("\0", "")
    if reduction.schedule.certificate is not None:
        group["certificate"] = journal.value("certificate").replace("\0", "")
    rows = {each: archive.Column(group, f"row_{each}", kind) for each, kind in ROW.items()}
    readings = {each: archive.Column(group, f"reading_{each}", kind) for each, kind in READING.items()}
    counts, begin = archive.Column(group, "counts", "<u2"), 0
    of_rows: list[tuple[Any, ...]] = []
    of_readings: list[tuple[Any, ...]] = []
    raw: list[npt.NDArray[np.uint16]] = []

    def flush() -> None:
        for columns, entries in ((rows, of_rows), (readings, of_readings)):
            for column, values in zip(columns.values(), zip(*entries, strict=True), strict=False):
                column.add(np.array(values, dtype=object if isinstance(values[0], str) else None))
            entries.clear()
        counts.add(np.concatenate([np.zeros(0, dtype=np.uint16), *raw]))
        raw.clear()

    for committed in journal.rows():
        row, data = committed.row, committed.data
        pose = row.pose or (math.nan,) * 4
        wavelength = math.nan if row.wavelength_nm is None else row.wavelength_nm
        texts = (row.kind, row.sample, row.identity, json.dumps(data.positions), " ".join(data.flags))
        of_rows.append((row.number, *texts, wavelength, *pose, data.started_s, data.ended_s))
        for each in data.readings:
            about = (row.number, each.gain_v_per_a, each.first_s, each.period_s, each.monitor_a)
            of_readings.append((*about, begin, *each.counts.shape))
            raw.append(each.counts.ravel())
            begin += each.counts.size
        if len(of_rows) >= ROWS_TOGETHER:
            flush()
            yield
    flush()
    yield


ROWS_TOGETHER = 1000
ROW = {
    "number": "<i8",
    "kind": archive.TEXT,
    "sample": archive.TEXT,
    "identity": archive.TEXT,
    "positions": archive.TEXT,
    "flags": archive.TEXT,
    "wavelength_nm": "<f8",
    "gamma_deg": "<f8",
    "sigma_deg": "<f8",
    "beta_deg": "<f8",
    "shift_deg": "<f8",
    "started_s": "<f8",
    "ended_s": "<f8",
}
READING = {
    "row": "<i8",
    "gain_v_per_a": "<f8",
    "first_s": "<f8",
    "period_s": "<f8",
    "monitor_a": "<f8",
    "begin": "<i8",
    "readings": "<i8",
    "photodiodes": "<i8",
}
"""Columns of the rows and of the readings: `begin` is the place of the first count, of readings times photodiodes."""
