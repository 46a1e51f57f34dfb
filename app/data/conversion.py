"""Conversion of what a file or a journal holds to what another format holds: one code for `convert` and `export`.

A format may hold one sample, one kind of light, or one side: where there are several, one is chosen. A table is made of
scattered values where the format holds no others, and scattered values are the nodes of a table. What is omitted has a note.
"""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from goniotwin.app.campaign.journal.reading import JournalReader
from goniotwin.app.campaign.reduction.archive import write_archive
from goniotwin.app.campaign.reduction.export import WIDEST_GAP_DEG, part_of_light, points_of, scattered_of
from goniotwin.app.campaign.reduction.reduction import ReducedJournal
from goniotwin.app.data.opening import with_files_beside
from goniotwin.app.errors import UserError
from goniotwin.app.formats import BsdfTable, FormatError, registry
from goniotwin.app.formats.content import (
    CHECK,
    UNTRUSTED,
    BsdfFile,
    Part,
    RegularTable,
    ScatteredBsdf,
    flagged,
    nodes,
    separate,
)
from goniotwin.app.formats.file import SQLITE, read_head
from goniotwin.app.formats.gridding import grid_table
from goniotwin.app.formats.holes import FILLS, Fill, fill_holes, refuse_holes, unmeasured_share
from goniotwin.app.formats.registry import Format, Holds

Light = Literal["reflected", "transmitted"]
Side = Literal["front", "back"]


@dataclass(frozen=True)
class Choice:
    """What of several samples, lights and sides is written, and how holes are filled. None: all, or the only one."""

    sample: str | None = None
    light: Light | None = None
    side: Side | None = None
    fill: Fill = "hold"


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
    """The files that were written, the number of measured values in them, and what was omitted or is not measured."""

    files: tuple[Path, ...]
    format: str
    values: int
    simulated: bool
    fill: Fill
    shares: tuple[Share, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def largest(self) -> Share | None:
        """The largest share that was not measured; None where all of it was."""
        found = max(self.shares, key=lambda each: each.share, default=None)
        return found if found is not None and found.share > 0.0 else None

    @property
    def unmeasured_line(self) -> str | None:
        """The share that was not measured, in one line."""
        if (found := self.largest) is None:
            return None
        others = [each for each in FILLS if each not in (self.fill, "refuse")]
        text = f"not measured: {100.0 * found.share:.3g} % of the light at sigma {found.sigma_deg:g}"
        if len(self.shares) > 1:
            text += f", the most of {len(self.shares)} incidences"
        return f"{text}; filled by {self.fill} (--fill {' or '.join(others)} are other ways)"

    def as_dict(self) -> dict[str, Any]:
        """The result for JSON."""
        files = [str(file) for file in self.files]
        return {
            "file": files[0], "files": files, "format": self.format, "values": self.values, "simulated": self.simulated,
            "fill": self.fill, "not_measured": [vars(each) for each in self.shares], "notes": list(self.notes),
        }  # fmt: skip


# ---- formats ----


def format_to_write(path: Path, name: str | None = None) -> Format:
    """The format of this name, or of the file's suffix, which can hold a BSDF; its files can be written. Raises UserError."""
    with user_errors():
        found = registry.format_for(path, registry.BSDF) if name is None else registry.format_named(name, registry.BSDF)
        registry.check_files(path, found)
        return found


@contextmanager
def user_errors() -> Iterator[None]:
    """Raise a FormatError as the error of this program's commands."""
    try:
        yield
    except FormatError as error:
        raise UserError(str(error)) from None


def is_journal(path: Path) -> bool:
    """Whether a file is a database, as journals are. Raises UserError where there is no such file."""
    with user_errors():
        return not path.is_dir() and read_head(path, len(SQLITE)) == SQLITE


# ---- conversion ----


def convert_file(source: Path, path: Path, form: Format, choice: Choice) -> Converted:
    """Convert a file of any format, with the uncertainties and the mask beside it. Raises UserError."""
    with user_errors():
        found = registry.recognise(source)
        return convert_content(with_files_beside(source, found.read(source), found), path, form, choice)


def convert_reduced(reduced: ReducedJournal, path: Path, form: Format, choice: Choice) -> Converted:
    """Write a reduced journal; a format of columns gets every column of every point, in parts. Raises UserError."""
    if choice.light is not None:
        reduced = part_of_light(reduced, choice.sample, path, choice.light)
    with user_errors():
        if Holds.COLUMNS in form.holds and choice.side is None:
            stream, count = points_of(reduced, choice.sample, path)
            form.write(path, stream)
            return Converted((path,), form.name, count, reduced.simulated, choice.fill)
        sample = choice.sample
        if sample is None and len(reduced.samples) > 1 and Holds.SAMPLES not in form.holds:
            raise _several(path, form, tuple(reduced.samples))
        content = scattered_of(reduced, sample)
        known = [reduced.metadata[name] for name in content.samples if name in reduced.metadata]
        return convert_content(replace(content, metadata=known[0]) if known else content, path, form, choice, WIDEST_GAP_DEG)


def archive_journal(
    journal: JournalReader, reduced: ReducedJournal, path: Path, choice: Choice, *, without_damaged: bool = False
) -> Converted:
    """Write the archive of a journal, with all that its uncertainties are made of and what was recorded. Raises UserError."""
    with user_errors():
        done = write_archive(journal, reduced, path, fill=choice.fill, without_damaged=without_damaged)
    shares = tuple(share for table in done.tables for share in shares_of(table))
    return Converted((path,), "archive", done.values, reduced.simulated, choice.fill, shares, done.without_table)


def convert_content(
    content: BsdfFile, path: Path, form: Format, choice: Choice, widest_gap_deg: float | None = None
) -> Converted:
    """Write what a format holds of a content. Raises UserError and FormatError, in words, where that is not possible.

    `widest_gap_deg`: see `gridding.grid_table`.
    """
    notes: list[str] = []
    if not form.holds.issuperset({Holds.GRID, Holds.POINTS}):
        content = content.of_tables() if Holds.GRID in form.holds else content.of_points()
    chosen = _of_sample(content, path, form, choice.sample)
    chosen = _of_side(chosen, path, form, choice.side, notes)
    chosen = _of_light(chosen, path, form, choice.light)
    chosen = _of_kind(chosen, path, form, notes)
    measured = sum(_measured(part, UNTRUSTED if Holds.POINTS in form.holds else {*UNTRUSTED, CHECK}) for part in chosen.parts)
    if Holds.GRID in form.holds:
        chosen = _gridded(chosen, path, form, choice.fill, widest_gap_deg)
    else:
        chosen = _as_points(chosen, form, notes)
    shares = tuple(share for table in chosen.tables for share in shares_of(table))
    parts = tuple(replace(part, comments=(*part.comments, *notes)) for part in chosen.parts)
    files = registry.write(path, replace(chosen, parts=parts), form, notes)
    return Converted(files, form.name, measured, chosen.simulated, choice.fill, shares, tuple(notes))


def shares_of(table: BsdfTable) -> Iterator[Share]:
    """The share that was not measured, at each incidence of a table at which something was; none for a table without a mask."""
    if table.known is None:
        return
    shares = unmeasured_share(table.sigma_deg, table.phi_deg, table.theta_deg, table.values, table.known)
    names = table.colours or tuple(f"{each:g} nm" for each in table.wavelengths_nm or ()) or ("",)
    for c, p, s in np.argwhere(table.known.any(axis=(3, 4))).tolist():
        yield Share(table.sample, names[c], float(table.psi_deg[p]), float(table.sigma_deg[s]), float(shares[c, p, s]))


def _several(path: Path, form: Format, samples: tuple[str, ...]) -> UserError:
    known = ", ".join(name or "one without a name" for name in samples)
    return UserError(f"{path}: a {form.name} file has one sample, and there are: {known}; choose one with --sample")


def _of_sample(content: BsdfFile, path: Path, form: Format, sample: str | None) -> BsdfFile:
    if sample is not None:
        if sample not in content.samples:
            raise UserError(f"{path}: there is no sample {sample!r}; it has: {', '.join(content.samples)}")
        return content.of(sample)
    if len(content.samples) > 1 and Holds.SAMPLES not in form.holds:
        raise _several(path, form, content.samples)
    return content


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


def _of_side(content: BsdfFile, path: Path, form: Format, side: Side | None, notes: list[str]) -> BsdfFile:
    sides = _both(content, "back")
    if side is not None:
        chosen = _parts(content, "back", side == "back")
        if not chosen.parts:
            raise UserError(f"{path}: nothing was measured with light on the {side}; leave --side out")
        return chosen
    if len(sides) > 1 and Holds.SIDES not in form.holds:
        notes.append("the values of the back are omitted; --side back writes them")
        return _parts(content, "back", False)
    return content


def _of_light(content: BsdfFile, path: Path, form: Format, light: Light | None) -> BsdfFile:
    lights = {Holds.TRANSMITTED if each else Holds.REFLECTED for each in _both(content, "transmitted")}
    if light is not None:
        chosen = _parts(content, "transmitted", light == "transmitted")
        if not chosen.parts:
            raise UserError(f"{path}: no {light} light has been measured; leave --light out")
        return chosen
    if len(lights) > 1 and Holds.LIGHTS not in form.holds:
        if len(lights & form.holds) > 1:
            wrong = "there is reflected and transmitted light, of which a " + f"{form.name} file holds one"
            raise UserError(f"{path}: {wrong}; choose it with --light reflected or --light transmitted")
        return _parts(content, "transmitted", Holds.TRANSMITTED in form.holds)
    return content


def _of_kind(content: BsdfFile, path: Path, form: Format, notes: list[str]) -> BsdfFile:
    """Without regular factors where the format does not hold them, and with nothing else where it holds only these."""
    others = tuple(part for part in content.parts if not isinstance(part, RegularTable))
    if not form.holds & {Holds.GRID, Holds.POINTS}:
        if not content.regular:
            raise UserError(f"{path}: a {form.name} file holds {Holds.REGULAR}, which is not there; use another format")
        if others:
            notes.append("the scattered part is omitted: it is in a file of its own")
        return replace(content, parts=content.regular)
    if content.regular and Holds.REGULAR not in form.holds and others:
        notes.append("the regular part is omitted: it is in a file of its own")
        return replace(content, parts=others)
    return content


def _measured(part: Part, without: Collection[str]) -> int:
    """Number of measured values that have none of these flags."""
    if isinstance(part, ScatteredBsdf):
        return int(np.count_nonzero(np.isfinite(part.values) & ~flagged(part.flags, without)))
    known = part.known if isinstance(part, BsdfTable) else None
    return int(part.values.size if known is None else np.count_nonzero(known))


def _gridded(
    content: BsdfFile, path: Path, form: Format, fill: Fill, widest_gap_deg: float | None
) -> BsdfFile:  # fmt: skip
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
        for one in separate(part):
            if not both:
                needs = registry.content_needs(BsdfFile((one,))) - {Holds.POINTS} | {Holds.GRID, Holds.SIGMAS}
                registry.check_holds(path, form, needs)
            try:
                parts.append(_table(one, content.comments, fill, widest_gap_deg))
            except ValueError as error:
                if both:  # the values themselves are there
                    continue
                remedy = "choose another --fill" if fill == "refuse" else f"use {_of_points()}"
                raise UserError(f"{path}: {part.sample or 'the sample'}: {error}; {remedy}") from None
    return replace(content, parts=tuple(parts), comments=content.comments if content.scattered == () or both else ())


def _of_points() -> str:
    return registry.join_words(map(str, registry.writers(Holds.POINTS)))


def _table(part: ScatteredBsdf, comments: tuple[str, ...], fill: Fill, widest_gap_deg: float | None) -> BsdfTable:
    about = [*comments, *part.comments]
    if widest_gap_deg is not None:
        about.append(f"nodes between measured directions more than {widest_gap_deg:g} deg apart count as not measured")
    return grid_table(part, fill=fill, widest_gap_deg=widest_gap_deg, comments=about)


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
    u = None if table.u is None else np.where(table.known, table.u, np.maximum(table.u, np.abs(values)))
    return replace(table, values=values, u=u, comments=(*table.comments, f"holes filled again by {fill}"))


def _as_points(content: BsdfFile, form: Format, notes: list[str]) -> BsdfFile:
    """Scattered values instead of tables; without flags those that are not to be trusted are omitted."""
    parts: list[Part] = [nodes(part) if isinstance(part, BsdfTable) else part for part in content.parts]
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
