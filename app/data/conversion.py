"""Conversion of what a file or a journal holds to what another format holds: one code for `convert` and `export`.

A format may hold one sample, one kind of light, or one side: where there are several, one is chosen. A table is made of
scattered values where the format holds no others, and scattered values are the nodes of a table. What is omitted has a note.
"""

import os
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.studies.reduced_journal import ReducedJournal
from goniotwin.app.data.archive import write_archive
from goniotwin.app.data.export import part_of_light, part_of_wavelength, points_of, scattered_of, wavelengths_of
from goniotwin.app.data.parts import with_files_beside
from goniotwin.app.data.values import EQUAL, listed, neighbours
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, registry, writing
from goniotwin.app.formats.content import (
    CHECK,
    UNTRUSTED,
    BsdfFile,
    Part,
    RegularTable,
    ScatteredBsdf,
    flagged,
    nodes,
)
from goniotwin.app.formats.coverage import scattered_share
from goniotwin.app.formats.file import SQLITE, read_head
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.holes import FILLS, Fill, fill_holes, refuse_holes, unmeasured_share
from goniotwin.app.formats.metadata import common_metadata
from goniotwin.app.formats.numerals import NotANumber, format_number, parse_number
from goniotwin.app.formats.registry import Format, Holds
from goniotwin.app.formats.specular_grid import ABOUT_SHARE, share_lines
from goniotwin.arrays import Floats

Light = Literal["reflected", "transmitted"]
Side = Literal["front", "back"]


@dataclass(frozen=True)
class Remedies:
    """How a sample, the back, one light or one wavelength is chosen, in messages."""

    sample: str = "choose one with --sample"
    back: str = "--side back writes them"
    light: str = "choose it with --light reflected or --light transmitted"
    wavelength: str = "choose one with --wavelength, write a file of each with --wavelength all"


IN_PYTHON = Remedies(
    sample='choose one with d["NAME"].save(...)',
    back="d.select(back=True).save(...) writes them",
    light="choose it with d.select(transmitted=False) or d.select(transmitted=True)",
    wavelength="choose one with d.select(wavelength_nm=...)",
)
"""Those of `Dataset.save`."""


@dataclass(frozen=True)
class Choice:
    """What of several samples, lights, sides and wavelengths is written, and how holes are filled. None: all, or the only one.

    `wavelength_nm` "all": each wavelength in a file of its own.
    """

    sample: str | None = None
    light: Light | None = None
    side: Side | None = None
    wavelength_nm: float | Literal["all"] | None = None
    fill: Fill = "hold"
    remedies: Remedies = Remedies()

    @property
    def everything(self) -> bool:
        """Whether no choice is made."""
        return (self.sample, self.light, self.side, self.wavelength_nm) == (None, None, None, None)


def parse_wavelength(text: str | None) -> float | Literal["all"] | None:
    """The choice of a wavelength in words: a number of nm, or "all". Raises UserError."""
    if text is None:
        return None
    if text == "all":
        return "all"
    try:
        return parse_number(text.strip().removesuffix("nm").strip())
    except NotANumber:
        raise UserError(f"--wavelength {text!r}: give one wavelength in nm, such as 550, or all") from None


@dataclass(frozen=True)
class Share:
    """The share of the scattered light, 0 to 1, that was not measured at one incidence of a table, and is filled."""

    sample: str
    channel: str
    psi_deg: float
    sigma_deg: float
    share: float


@dataclass(frozen=True)
class Converted:
    """The files that were written, the number of measured values in them, and what was omitted or is not measured.

    `has_points`: the file has the measured points beside its tables.
    """

    files: tuple[Path, ...]
    format: str
    values: int
    simulated: bool
    fill: Fill
    shares: tuple[Share, ...] = ()
    notes: tuple[str, ...] = ()
    widest_gap_deg: float | None = None
    has_points: bool = False

    @property
    def largest(self) -> Share | None:
        """The largest share that was not measured; None where all of it was."""
        found = max(self.shares, key=lambda each: each.share, default=None)
        return found if found is not None and found.share > 0.0 else None

    @property
    def unmeasured_line(self) -> str | None:
        """The share that was not measured, in one line; None where nothing is missing, or the file has the points too."""
        if self.has_points or (found := self.largest) is None:
            return None
        others = [each for each in FILLS if each not in (self.fill, "refuse")]
        text = f"{100.0 * found.share:.3g} % of the scattered light at sigma {found.sigma_deg:g} is at nodes of the table that "
        text += "were not measured"
        if len(self.shares) > 1:
            text += f", the most of {len(self.shares)} incidences"
        if self.widest_gap_deg is not None:
            text += (
                f". Between measured directions more than {self.widest_gap_deg:g} deg apart the table is interpolated, and its "
                f"u is at least the value. To keep the measured values, write a list of points ({_of_points()}), or measure a "
                "finer grid"
            )
        return f"{text}. Gaps are filled by {self.fill} (other ways: --fill {' or '.join(others)})"

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        files = [str(file) for file in self.files]
        return {
            "file": files[0],
            "files": files,
            "format": self.format,
            "values": self.values,
            "simulated": self.simulated,
            "fill": self.fill,
            "not_measured": self.shares,
            "notes": list(self.notes),
        }


# ---- formats ----


def format_to_write(path: Path, name: str | None = None) -> Format:
    """The format of this name, or of the file's suffix, which can hold a BSDF; its files can be written. Raises UserError."""
    found = registry.format_for(path, registry.BSDF) if name is None else registry.format_named(name, registry.BSDF)
    registry.check_files(path, found)
    return found


def is_journal(path: Path) -> bool:
    """Whether a file is a database, as journals are. Raises UserError where there is no such file."""
    return not path.is_dir() and read_head(path, len(SQLITE)) == SQLITE


# ---- conversion ----


def convert_file(source: Path, path: Path, form: Format, choice: Choice) -> Converted:
    """Convert a file of any format, with the uncertainties and the mask beside it. Raises UserError."""
    found = registry.recognise(source)
    return convert_content(with_files_beside(source, found.read(source), found), path, form, choice, source)


def check_samples(journal: JournalReader, path: Path, form: Format, choice: Choice) -> None:
    """Raise UserError, before a journal is reduced, where several of its samples are measured and one is to be written."""
    if choice.sample is not None or Holds.SAMPLES in form.holds:
        return
    done = journal.committed_numbers()
    asked = parse_schedule(journal.value("schedule"), f"{journal.path} (schedule)").file.samples
    measured = {row.sample for row in journal.planned_rows() if row.kind == "measure" and row.number in done}
    names = tuple(name for name in asked if name in measured)
    if len(names) > 1:
        raise _several(path, form, names, choice.remedies)


def convert_reduced(reduced: ReducedJournal, path: Path, form: Format, choice: Choice) -> Converted:
    """Write a reduced journal; a format of columns gets every column of every point, in parts. Raises UserError."""
    if choice.light is not None:
        reduced = part_of_light(reduced, choice.sample, path, choice.light)
    if Holds.COLUMNS in form.holds and choice.side is None:
        return _columns(reduced, path, form, choice)
    if isinstance(choice.wavelength_nm, float):
        _check_wavelength(path, wavelengths_of(reduced, choice.sample), choice.wavelength_nm)
        reduced = part_of_wavelength(reduced, choice.sample, choice.wavelength_nm)
    content = scattered_of(reduced, choice.sample)
    known = {name: reduced.metadata[name] for name in content.samples if name in reduced.metadata}
    if known:
        content = replace(content, metadata=common_metadata(known.values()), of_samples=known)
    return convert_content(content, path, form, choice)


def _columns(reduced: ReducedJournal, path: Path, form: Format, choice: Choice) -> Converted:
    """Write every column of every point, or of those of a wavelength; or a file for each wavelength."""
    if choice.wavelength_nm is None:
        stream, count = points_of(reduced, choice.sample, path)
        form.write(path, stream)
        return Converted((path,), form.name, count, reduced.simulated, choice.fill)
    there = wavelengths_of(reduced, choice.sample)
    every = replace(choice, wavelength_nm=None)
    if choice.wavelength_nm != "all":
        _check_wavelength(path, there, choice.wavelength_nm)
        return _columns(part_of_wavelength(reduced, choice.sample, choice.wavelength_nm), path, form, every)
    return _together(
        [
            _columns(part_of_wavelength(reduced, choice.sample, nm), wavelength_path(path, nm), form, every)
            for nm in there.tolist()
        ]
    )


def archive_journal(
    journal: JournalReader, reduced: ReducedJournal, path: Path, choice: Choice, *, without_damaged: bool = False
) -> Converted:
    """Write the archive of a journal, with all that its uncertainties are made of and what was recorded. Raises UserError."""
    done = write_archive(journal, reduced, path, fill=choice.fill, without_damaged=without_damaged)
    shares = tuple(share for table in done.tables for share in shares_of(table))
    notes, simulated = done.without_table, reduced.simulated
    return Converted((path,), "archive", done.values, simulated, choice.fill, shares, notes, has_points=True)


def convert_content(content: BsdfFile, path: Path, form: Format, choice: Choice, source: Path | None = None) -> Converted:
    """Write what a format holds of a content. Raises UserError and FormatError, in words, where that is not possible.

    `source` is a file that must not be overwritten.
    """
    notes: list[str] = []
    if not form.holds.issuperset({Holds.GRID, Holds.POINTS}):
        content = content.of_points()
    chosen = _of_sample(content, path, form, choice)
    chosen = _of_side(chosen, path, form, choice, notes)
    chosen = _of_light(chosen, path, form, choice, notes)
    chosen = _of_kind(chosen, path, form, notes)
    if choice.wavelength_nm != "all":
        chosen = _of_wavelength(chosen, path, form, choice, notes)
        negative = tuple(_negative_lines(chosen))
        converted = _write(chosen, path, form, choice, notes)
        return replace(converted, notes=(*converted.notes, *negative))
    if not (there := wavelengths_nm(chosen)).size:
        raise UserError(f"{path}: its values have no wavelength; leave --wavelength out")
    negative = tuple(_negative_lines(chosen))
    files = [wavelength_path(path, nm) for nm in there.tolist()]
    for each in files:
        refuse_itself(source, each, form)
    results = []
    for nm, each in zip(there.tolist(), files, strict=True):
        of_each = [*notes]
        results.append(
            _write(_of_wavelength(chosen, each, form, replace(choice, wavelength_nm=nm), of_each), each, form, choice, of_each)
        )
    together = _together(results)
    return replace(together, notes=(*together.notes, *negative))


def _negative_lines(content: BsdfFile) -> Iterator[str]:
    """A line on the negative values of each quantity, of those that were measured."""
    found: dict[str, list[Floats]] = {}
    for part in content.parts:
        known = part.known if isinstance(part, BsdfTable) and part.known is not None else np.isfinite(part.values)
        words = ("regular reflectance", "regular transmittance") if isinstance(part, RegularTable) else ("BRDF", "BTDF")
        transmitted = np.broadcast_to(part.transmitted, part.values.shape)
        for word, of_light in zip(words, (~transmitted, transmitted), strict=True):
            found.setdefault(word, []).append(part.values[known & of_light])
    for quantity, pieces in found.items():
        values = np.concatenate([each.ravel() for each in pieces])
        count = int(np.count_nonzero(values < 0.0))
        if count:
            unit = " 1/sr" if quantity in ("BRDF", "BTDF") else ""
            yield (
                f"{count} of {values.size} values of the {quantity} are negative, the least {values.min():.3g}{unit}: they are "
                "written as they are"
            )


def _write(chosen: BsdfFile, path: Path, form: Format, choice: Choice, notes: list[str]) -> Converted:
    """Write what was chosen of a content."""
    measured = sum(_measured(part, UNTRUSTED if Holds.POINTS in form.holds else {*UNTRUSTED, CHECK}) for part in chosen.parts)
    before = chosen
    if Holds.GRID in form.holds:
        chosen = _gridded(chosen, path, form, choice.fill)
    else:
        chosen = _as_points(chosen, form, notes)
    shares = tuple(share for table in chosen.tables for share in shares_of(table))
    notes += _impossible(chosen.tables)
    widest = next((part.widest_gap_deg for part in before.scattered if part.widest_gap_deg is not None), None)
    parts = tuple(replace(part, comments=(*part.comments, *notes)) for part in chosen.parts)
    files = writing.write(path, replace(chosen, parts=parts), form, notes)
    return Converted(files, form.name, measured, chosen.simulated, choice.fill, shares, tuple(notes), widest)


def _impossible(tables: Sequence[BsdfTable]) -> list[str]:
    """A line on each table with filled nodes that scatters more light than it receives."""
    return [
        f"{table.sample or 'the table'}: scatters {highest:.3g} times the light that it receives, with the nodes that were not "
        "measured: do not use this table, and measure a finer grid"
        for table in tables
        if table.known is not None and not table.known.all() and (highest := float(scattered_share(table).max())) > 1.0
    ]


def refuse_itself(source: Path | None, path: Path, form: Format) -> None:
    """Raise UserError where a result, or a file beside it, would replace the file that it is made of."""
    if source is not None and os.path.realpath(source) in {
        os.path.realpath(each) for each in (path, *registry.files_beside(path, form).values())
    }:
        raise UserError(f"{path}: is the {'journal' if is_journal(source) else 'file'} itself; choose another name")


def wavelength_path(path: Path, wavelength_nm: float) -> Path:
    """The file of one wavelength, where each has its own: NAME.550nm.bsdf for NAME.bsdf."""
    return path.with_suffix(f".{format_number(wavelength_nm)}nm{path.suffix}")


def _together(results: Sequence[Converted]) -> Converted:
    """The result of several files."""
    return replace(
        results[0],
        files=tuple(file for each in results for file in each.files),
        values=sum(each.values for each in results),
        shares=tuple(share for each in results for share in each.shares),
        notes=tuple(dict.fromkeys(note for each in results for note in each.notes)),
    )


def shares_of(table: BsdfTable) -> Iterator[Share]:
    """The share that was not measured, at each incidence of a table at which something was; none for a table without a mask."""
    if table.known is None:
        return
    shares = unmeasured_share(table.sigma_deg, table.phi_deg, table.theta_deg, table.values, table.known)
    names = table.colours or tuple(f"{each:g} nm" for each in table.wavelengths_nm or ()) or ("",)
    for c, p, s in np.argwhere(table.known.any(axis=(3, 4))).tolist():
        yield Share(table.sample, names[c], float(table.psi_deg[p]), float(table.sigma_deg[s]), float(shares[c, p, s]))


def _several(path: Path, form: Format, samples: tuple[str, ...], remedies: Remedies) -> UserError:
    wrong = f"the format {form.name} has one sample, and there are: {_names(samples)}"
    return UserError(f"{path}: {wrong}; {remedies.sample}")


def _names(samples: Iterable[str]) -> str:
    return ", ".join(repr(name) if "," in name else name or "one without a name" for name in samples)


def _of_sample(content: BsdfFile, path: Path, form: Format, choice: Choice) -> BsdfFile:
    sample = choice.sample
    if sample is not None:
        if sample not in content.samples:
            raise UserError(f"{path}: there is no sample {sample!r}; there are: {_names(content.samples)}")
        return content.of(sample)
    if len(content.samples) > 1 and Holds.SAMPLES not in form.holds:
        raise _several(path, form, content.samples, choice.remedies)
    return content.of(content.samples[0]) if len(content.samples) == 1 else content


def _parts(content: BsdfFile, attribute: str, wanted: bool) -> BsdfFile:
    """What is of a light (`transmitted`) or a side (`back`)."""
    kept: list[Part] = []
    for part in content.parts:
        found = getattr(part, attribute)
        if isinstance(part, ScatteredBsdf):
            if (found == wanted).any():
                kept.append(part.where(found == wanted))
        elif found == wanted:
            kept.append(part)
    return replace(content, parts=tuple(kept))


def _both(content: BsdfFile, attribute: str) -> set[bool]:
    """The lights, or the sides, of a content."""
    return {bool(each) for part in content.parts for each in np.unique(getattr(part, attribute))}


def _of_side(content: BsdfFile, path: Path, form: Format, choice: Choice, notes: list[str]) -> BsdfFile:
    side, sides = choice.side, _both(content, "back")
    if side is not None:
        chosen = _parts(content, "back", side == "back")
        if not chosen.parts:
            raise UserError(f"{path}: nothing was measured with light on the {side}; leave --side out")
        return chosen
    if len(sides) > 1 and Holds.SIDES not in form.holds:
        notes.append(f"the values of the back are omitted; {choice.remedies.back}")
        return _parts(content, "back", False)
    return content


def _of_light(content: BsdfFile, path: Path, form: Format, choice: Choice, notes: list[str]) -> BsdfFile:
    light = choice.light
    lights = {Holds.TRANSMITTED if each else Holds.REFLECTED for each in _both(content, "transmitted")}
    if light is not None:
        chosen = _parts(content, "transmitted", light == "transmitted")
        if not chosen.parts:
            raise UserError(f"{path}: no {light} light has been measured; leave --light out")
        return chosen
    if len(lights) > 1 and Holds.LIGHTS not in form.holds:
        if len(lights & form.holds) > 1:
            wrong = f"there is reflected and transmitted light, and the format {form.name} holds one of them"
            raise UserError(f"{path}: {wrong}; {choice.remedies.light}")
        transmitted = Holds.TRANSMITTED in form.holds
        other = Holds.REFLECTED if transmitted else Holds.TRANSMITTED
        notes.append(f"the {other} is omitted: the format {form.name} has no room for it")
        return _parts(content, "transmitted", transmitted)
    return content


def wavelengths_nm(content: BsdfFile) -> Floats:
    """The wavelengths of a content, ascending; none for grey values and colours."""
    found = [
        part.wavelength_nm if isinstance(part, ScatteredBsdf) else np.array(part.wavelengths_nm or (), dtype=np.float64)
        for part in content.parts
    ]
    every = np.concatenate([np.zeros(0), *found])
    return np.unique(every[np.isfinite(every)])


def _check_wavelength(path: Path, there: Floats, wavelength_nm: float) -> None:
    if not (np.abs(there - wavelength_nm) <= EQUAL).any():
        has = f"there are {listed(there, 'nm')}; {neighbours(there, wavelength_nm)}" if there.size else "its values have none"
        raise UserError(f"{path}: there is no wavelength {wavelength_nm:g} nm: {has}")


def _of_wavelength(content: BsdfFile, path: Path, form: Format, choice: Choice, notes: list[str]) -> BsdfFile:
    there, wavelength_nm = wavelengths_nm(content), choice.wavelength_nm
    if wavelength_nm is None or wavelength_nm == "all":
        if there.size > 1 and Holds.WAVELENGTHS not in form.holds:
            wrong = f"the format {form.name} has one wavelength, and there are {listed(there, 'nm')}"
            others = registry.others(writing.content_needs(content))
            raise UserError(f"{path}: {wrong}; {choice.remedies.wavelength}, or use {others}")
        return content
    _check_wavelength(path, there, wavelength_nm)
    kept: list[Part] = []
    for part in content.parts:
        if isinstance(part, ScatteredBsdf):
            chosen = part.where(np.abs(part.wavelength_nm - wavelength_nm) <= EQUAL)
            kept += [chosen] if chosen.size else []
            if chosen.size < part.size and not np.isfinite(part.wavelength_nm).all():
                notes.append("the values without a wavelength are omitted")
            continue
        if isinstance(part, RegularTable) and not part.wavelengths_nm and not part.colours:
            kept.append(part)  # of every wavelength
            continue
        at = np.flatnonzero(np.abs(np.array(part.wavelengths_nm or ()) - wavelength_nm) <= EQUAL)
        if at.size:
            arrays = {each: getattr(part, each, None) for each in ("values", "u", "known")}
            taken = {each: array[at] for each, array in arrays.items() if array is not None}
            kept.append(replace(part, wavelengths_nm=(np.array(part.wavelengths_nm)[at[0]].item(),), **taken))
        else:
            what = "regular part" if isinstance(part, RegularTable) else "table"
            notes.append(f"a {what} is omitted: it has no values at {wavelength_nm:g} nm")
    return replace(content, parts=tuple(kept))


def _of_kind(content: BsdfFile, path: Path, form: Format, notes: list[str]) -> BsdfFile:
    """Without regular factors where the format does not hold them, and with nothing else where it holds only these."""
    others = tuple(part for part in content.parts if not isinstance(part, RegularTable))
    if not form.holds & {Holds.GRID, Holds.POINTS}:
        if not content.regular:
            wrong = f"the format {form.name} holds {Holds.REGULAR}, which is not there"
            raise UserError(f"{path}: {wrong}; use {registry.others(writing.content_needs(content))}")
        if others:
            notes.append(f"the scattered part is omitted: the format {form.name} has no room for it")
        return replace(content, parts=content.regular)
    if content.regular and Holds.REGULAR not in form.holds and others:
        notes.append(f"the regular part is omitted: the format {form.name} has no room for it; .sdr, .ssdd and .h5 have")
        return replace(content, parts=others)
    return content


def _measured(part: Part, without: Collection[str]) -> int:
    """Number of measured values that have none of these flags."""
    if isinstance(part, ScatteredBsdf):
        return int(np.count_nonzero(np.isfinite(part.values) & ~flagged(part.flags, without)))
    known = part.known if isinstance(part, BsdfTable) else None
    return int(part.values.size if known is None else np.count_nonzero(known))


def _gridded(content: BsdfFile, path: Path, form: Format, fill: Fill) -> BsdfFile:
    """Tables instead of scattered values, or beside them in a format that holds both; and holes filled.

    A table has the comments on the whole file, too.
    """
    both = Holds.POINTS in form.holds
    parts: list[Part] = []
    for part in content.parts:
        if isinstance(part, BsdfTable):
            parts.append(_refilled(part, path, fill))
        elif isinstance(part, RegularTable) or both:
            parts.append(part)
        if not isinstance(part, ScatteredBsdf) or (both and content.tables):
            continue
        for one in part.separate():
            if not both:
                needs = writing.content_needs(BsdfFile((one,))) - {Holds.POINTS} | {Holds.GRID, Holds.SIGMAS}
                registry.check_holds(path, form, needs)
            try:
                parts.append(grid_table(one, fill=fill, comments=(*content.comments, *one.comments)))
            except ValueError as error:
                if both:  # the values themselves are there
                    continue
                remedy = "choose another --fill" if fill == "refuse" else f"use {_of_points()}"
                raise UserError(f"{path}: {part.sample or 'the sample'}: {error}; {remedy}") from None
    return replace(content, parts=tuple(parts), comments=content.comments if content.scattered == () or both else ())


def _of_points() -> str:
    return registry.join_words(map(str, registry.writers(Holds.POINTS)))


def _refilled(table: BsdfTable, path: Path, fill: Fill) -> BsdfTable:
    """A table with a mask, its holes filled as asked for; "hold" leaves them as they are."""
    if table.known is None or fill == "hold":
        return table
    axes = (table.sigma_deg, table.phi_deg, table.theta_deg)
    if fill == "refuse":
        some = table.known.any(axis=(0, 1, 3, 4))
        try:
            refuse_holes(axes[0][some], axes[1], axes[2], table.values[:, :, some], table.known[:, :, some])
        except ValueError as error:
            raise UserError(f"{path}: {error}; choose another --fill") from None
    values = fill_holes(table.theta_deg, table.sigma_deg, table.values, table.known, fill)
    measured = np.flatnonzero(table.known.any(axis=(0, 1, 3, 4)))
    for s, nearest in ((0, measured[0]), (-1, measured[-1])) if measured.size else ():
        if np.array_equal(table.values[:, :, s], table.values[:, :, nearest]):  # repeated, because readers extrapolate
            values[:, :, s] = values[:, :, nearest]
    shares = unmeasured_share(*axes, values, table.known)[:, :, measured]
    names = table.colours or tuple(f"{each:g} nm" for each in table.wavelengths_nm or ()) or ("",)
    comments = (
        *(line for line in table.comments if not line.startswith(ABOUT_SHARE)),
        *share_lines(shares, axes[0][measured], names, table.psi_deg, "measured"),
        f"holes filled again by {fill}",
    )
    u = None if table.u is None else np.where(table.known, table.u, np.maximum(table.u, np.abs(values)))
    return replace(table, values=values, u=u, comments=comments)


def _as_points(content: BsdfFile, form: Format, notes: list[str]) -> BsdfFile:
    """Scattered values instead of tables; without flags those that are not to be trusted are omitted."""
    once = Holds.FLAGS not in form.holds
    parts: list[Part] = [nodes(part, once=once) if isinstance(part, BsdfTable) else part for part in content.parts]
    if Holds.FLAGS in form.holds:
        return replace(content, parts=tuple(parts))
    omitted = 0
    for k, part in enumerate(parts):
        if isinstance(part, ScatteredBsdf):
            kept = np.isfinite(part.values) & ~flagged(part.flags, UNTRUSTED)
            omitted += int(np.count_nonzero(~kept))
            parts[k] = part if kept.all() else part.where(kept)
    if omitted:
        notes.append(f"{omitted} directions without a trusted value are omitted")
    return replace(content, parts=tuple(parts))
