"""What a file is, of what, how complete, and whether it is simulated: for `goniotwin info`."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from goniotwin.app.campaign.journal.summary import CampaignSummary, campaign_summary
from goniotwin.app.campaign.journal.writing import Journal
from goniotwin.app.campaign.reduction.polarisation import light_words
from goniotwin.app.campaign.schedule.file import parse_schedule
from goniotwin.app.campaign.schedule.grids import grid_values
from goniotwin.app.data.conversion import Share, is_journal, shares_of
from goniotwin.app.data.parts import with_files_beside
from goniotwin.app.formats import BsdfTable, registry
from goniotwin.app.formats.content import UNTRUSTED, Part, RegularTable, ScatteredBsdf, flagged
from goniotwin.app.formats.metadata import Metadata
from goniotwin.app.formats.registry import BSDF, Holds
from goniotwin.app.json_document import OPTIONAL_KEY
from goniotwin.app.rig import parse_rig
from goniotwin.arrays import Floats
from goniotwin.twin.optics.geometry.coordinates import round_deg

MOST_LISTED = 12
"""Angles or wavelengths that are listed one by one."""
FEW = 4
"""Incidences for which the polarisation of the light is listed; of more, for the first and the last."""


@dataclass(frozen=True)
class Range:
    """The lowest and the highest of `count` different numbers; without any, neither."""

    first: float | None = field(metadata=OPTIONAL_KEY)
    last: float | None = field(metadata=OPTIONAL_KEY)
    count: int

    def __str__(self) -> str:
        return f"{self.count} from {self.first:g} to {self.last:g}" if self.count else ""


Numbers = list[float] | Range
"""The numbers, each once, or of many their range."""


@dataclass(frozen=True)
class PartInformation:
    """What is known of one part of a file: numbers of values, light and sides, and its angles."""

    sample: str
    kind: str
    light: list[str]
    side: list[str]
    simulated: bool
    values: int
    with_uncertainty: int
    sigma_deg: Numbers
    psi_deg: Numbers


@dataclass(frozen=True)
class PointsInformation(PartInformation):
    """Of scattered points: how many are trusted, and how often each flag is set."""

    measured: int
    flags: dict[str, int]
    wavelengths_nm: Numbers
    colours: list[str]
    polar_deg: Range
    theta_deg: Range


@dataclass(frozen=True)
class TableInformation(PartInformation):
    """Of a table."""

    wavelengths_nm: Numbers
    colours: list[str]


@dataclass(frozen=True)
class GridInformation(TableInformation):
    """Of a table of scattered light; `not_measured` is None where nothing states which values are measured."""

    measured: int
    not_measured: list[Share] | None
    phi_deg: Range
    theta_deg: Range


@dataclass(frozen=True)
class FileInformation:
    """What is known of a file. Only one with a BSDF has more than the first four."""

    file: Path
    format: str
    title: str
    simulated: bool

    def lines(self) -> list[str]:
        """The same in words."""
        return [f"{self.file}: {'SIMULATED, ' if self.simulated else ''}{self.format}, {self.title}"]


@dataclass(frozen=True)
class BsdfInformation(FileInformation):
    """What is known of a file with a BSDF; `stands_for` is what it has in place of values, if so."""

    stands_for: str | None
    parts: list[PartInformation]
    metadata: Metadata
    metadata_of_samples: dict[str, Metadata]
    comments: int

    def lines(self) -> list[str]:
        """The same in words."""
        lines = super().lines()
        if self.stands_for:
            lines.append(f"it has {self.stands_for}, not values")
        for part in self.parts:
            lines += _part_lines(part)
        common = _metadata_lines(self.metadata)
        lines += common
        for name, entries in self.metadata_of_samples.items():
            if own := [line for line in _metadata_lines(entries) if line not in common]:
                lines += [f"{name}:", *own]
        return lines


@dataclass(frozen=True)
class SampleRows:
    """The rows of a sample that are measured, and those that are planned."""

    sample: str
    rows: int
    planned: int


@dataclass(frozen=True)
class JournalInformation:
    """What is known of a journal: the summary of its campaign, and what its schedule measures."""

    file: Path
    format: str
    title: str
    campaign: CampaignSummary
    damage: str
    samples: list[SampleRows]
    etalon: str | None
    second_standard: str | None
    light: list[str]
    side: list[str]
    symmetry: str
    polarisation: str
    sigma_deg: Numbers
    gamma_deg: Numbers
    wavelengths_nm: Numbers

    def as_dict(self) -> dict[str, object]:
        """The fields, with those of the summary in its place."""
        own = {key: value for key, value in vars(self).items() if key != "campaign"}
        head = {key: own.pop(key) for key in ("file", "format", "title")}
        return {**head, **self.campaign.as_dict(), **own}

    def lines(self) -> list[str]:
        """The same in words."""
        found = self.campaign
        left = f", {found.skipped} skipped" if found.skipped else ""
        light = f"{' and '.join(self.light)} light on the {' and '.join(self.side)}"
        lines = [
            f"{self.file}: {'SIMULATED, ' if found.simulated else ''}{self.format}, {self.title}",
            f"campaign {found.name}: {found.state}, {found.rows} of {found.planned} rows measured{left}",
        ]
        for each in self.samples:
            lines.append(f"{each.sample}: {light}, stated as {self.symmetry}, {each.rows} of {each.planned} rows measured")
        for name, numbers, unit in (
            ("sigma", self.sigma_deg, "deg"),
            ("gamma", self.gamma_deg, "deg"),
            ("wavelengths", self.wavelengths_nm, "nm"),
        ):
            lines.append(f"  {name}: {_text(numbers)} {unit}")
        lines.append(f"  {self.polarisation}")
        if self.damage:
            lines.append(f"differs from what was measured: {self.damage}")
        return lines


def information(path: Path) -> FileInformation | JournalInformation:
    """What is known of a file. Raises UserError."""
    if is_journal(path):
        return _of_journal(path)
    found = registry.recognise(path, BSDF | {Holds.RAYS})
    if Holds.RAYS in found.holds:
        found.read(path)  # it is whole
        return FileInformation(path, found.name, found.title, simulated=True)
    content = found.read(path)
    if (described := registry.described_table(content)) is None:
        content = with_files_beside(path, content, found)
    return BsdfInformation(
        file=path,
        format=found.name,
        title=found.title,
        simulated=content.simulated,
        stands_for=described,
        parts=[_of_part(part) for part in content.parts],
        metadata=(content.of(content.samples[0]) if len(content.samples) == 1 else content).metadata,
        metadata_of_samples=content.of_samples,
        comments=sum(len(each.comments) for each in (content, *content.parts)),
    )


def _of_journal(path: Path) -> JournalInformation:
    summary = campaign_summary(path)
    with Journal.open(path) as journal:
        schedule = parse_schedule(journal.value("schedule"), f"{path} (schedule)").file
        rig = parse_rig(journal.value("rig"), Path(), f"{path} (rig)")
        done = journal.committed_numbers()
        rows = [row for row in journal.planned_rows() if row.kind == "measure"]
    sigma = np.array(sorted(grid_values(schedule.sigma_deg)))
    planned, measured = Counter(row.sample for row in rows), Counter(row.sample for row in rows if row.number in done)
    return JournalInformation(
        file=path,
        format="journal",
        title="data file of a campaign",
        campaign=summary,
        damage=summary.damage,
        samples=[SampleRows(name, measured[name], planned[name]) for name in schedule.samples if planned[name]],
        etalon=schedule.etalon,
        second_standard=None if schedule.second_standard is None else schedule.second_standard.name,
        light=["reflected", "transmitted"] if schedule.light == "both" else [schedule.light],
        side=["front", "back"] if schedule.side == "both" else [schedule.side],
        symmetry=schedule.symmetry,
        polarisation=light_words(rig.file.light, sigma if sigma.size <= FEW else sigma[[0, -1]]),
        sigma_deg=_listed(sigma),
        gamma_deg=_listed(np.array(grid_values(schedule.gamma_deg))),
        wavelengths_nm=_listed(np.array(grid_values(schedule.wavelength_nm))),
    )


def _of_part(part: Part) -> PartInformation:
    size = int(part.values.size)
    common = PartInformation(
        sample=part.sample,
        kind=_kind(part),
        light=["transmitted" if each else "reflected" for each in np.unique(part.transmitted).tolist()],
        side=["back" if each else "front" for each in np.unique(part.back).tolist()],
        simulated=part.generated,
        values=size,
        with_uncertainty=0 if part.u is None else int(np.count_nonzero(np.isfinite(part.u))),
        sigma_deg=_listed(part.sigma_deg),
        psi_deg=_listed(part.psi_deg),
    )
    if isinstance(part, ScatteredBsdf):
        trusted = np.isfinite(part.values) & ~flagged(part.flags, UNTRUSTED)
        words, counts = np.unique(
            [word for flags in part.flags[part.flags != ""] for word in flags.split()], return_counts=True
        )
        theta, _ = part.specular()
        return PointsInformation(
            **vars(common),
            measured=int(np.count_nonzero(trusted)),
            flags=dict(zip(words.tolist(), counts.tolist(), strict=True)),
            wavelengths_nm=_listed(part.wavelength_nm[np.isfinite(part.wavelength_nm)]),
            colours=sorted(set(part.channel.tolist()) - {""}),
            polar_deg=_range(part.polar_deg),
            theta_deg=_range(theta),
        )
    table = TableInformation(
        **vars(common), wavelengths_nm=_listed(np.array(part.wavelengths_nm or ())), colours=list(part.colours)
    )
    if not isinstance(part, BsdfTable):
        return table
    return GridInformation(
        **vars(table),
        measured=size if part.known is None else int(np.count_nonzero(part.known)),
        not_measured=None if part.known is None else list(shares_of(part)),
        phi_deg=_range(part.phi_deg),
        theta_deg=_range(part.theta_deg),
    )


def _kind(part: Part) -> str:
    if isinstance(part, RegularTable):
        return "regular"
    return "grid" if isinstance(part, BsdfTable) else "points"


def _listed(values: Floats) -> Numbers:
    distinct = np.unique(round_deg(values))
    return distinct.tolist() if distinct.size <= MOST_LISTED else _range(distinct)


def _range(values: Floats) -> Range:
    distinct = np.unique(round_deg(values))
    if not distinct.size:
        return Range(None, None, 0)
    return Range(float(distinct[0]), float(distinct[-1]), int(distinct.size))


def _part_lines(part: PartInformation) -> list[str]:
    light = f"{' and '.join(part.light)} light on the {' and '.join(part.side)}"
    lines = [f"{part.sample or 'sample without a name'}: {part.kind}, {light}"]
    own = vars(part)
    for name, unit in (("sigma_deg", "deg"), ("psi_deg", "deg"), ("wavelengths_nm", "nm"), ("theta_deg", "deg")):
        if text := _text(own.get(name, [])):
            lines.append(f"  {name.rpartition('_')[0]}: {text} {unit}")
    if isinstance(part, PointsInformation | TableInformation) and part.colours:
        lines.append(f"  colours: {', '.join(part.colours)}")
    known = part.measured if isinstance(part, PointsInformation | GridInformation) else part.values
    measured = f", {known} measured" if known != part.values else ""
    lines.append(f"  {part.values} values{measured}, {part.with_uncertainty} with an uncertainty")
    if isinstance(part, PointsInformation) and part.flags:
        lines.append(f"  flags: {', '.join(f'{name} {count}' for name, count in part.flags.items())}")
    if isinstance(part, GridInformation) and part.not_measured:
        most = max(part.not_measured, key=lambda each: each.share)
        lines.append(f"  not measured: at most {100.0 * most.share:.3g} % of the scattered light, at sigma {most.sigma_deg:g}")
    return lines


def _text(values: Numbers) -> str:
    return str(values) if isinstance(values, Range) else ", ".join(f"{each:g}" for each in values)


def _metadata_lines(entries: Metadata) -> list[str]:
    return [f"  {line}" for line in entries.lines()]
